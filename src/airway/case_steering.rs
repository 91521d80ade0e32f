//! `[trajectory.steering]`: how the scope leaves the middle of the airway. 0 switches a part off.

use serde::{Deserialize, Serialize};

/// A hand that steers: smooth seeded motion about the route (PROTOCOL 2: a scope that is carried along the centreline
/// tells the breathing phase by its position alone).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SteeringSettings {
    /// Largest distance from the route, as a part of the room that the lumen leaves there (at most 0.8).
    pub sideways: f64,
    /// Largest angle in degrees between the optical axis and the route.
    pub tilt_deg: f64,
    /// Largest roll about the optical axis in degrees.
    pub roll_deg: f64,
    /// How unevenly the scope advances: 0 at one speed; at 1 it also stops and goes back a little.
    pub speed_variation: f64,
}

impl Default for SteeringSettings {
    fn default() -> Self {
        SteeringSettings { sideways: 0.6, tilt_deg: 20.0, roll_deg: 25.0, speed_variation: 1.0 }
    }
}

impl SteeringSettings {
    /// A scope that is threaded along the middle of the airway at one speed.
    pub const NONE: SteeringSettings =
        SteeringSettings { sideways: 0.0, tilt_deg: 0.0, roll_deg: 0.0, speed_variation: 0.0 };
}
