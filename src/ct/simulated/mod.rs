//! Two CT scans of a case whose truth is known: what a scanner would show of its airway at both breath holds.
//!
//! ```text
//! case --> airway surfaces --> wall -------------+
//!   |                                            |
//!   +----> breathing field --> body motion ------+--> chest at a breath hold --> scanner --> HU
//!   |                                            |
//!   +----> thorax, vessels, texture of tissue ---+
//! ```
//!
//! Tissue (parenchyma, vessels, fissures, heart) is drawn at its place at full inspiration and carried by the case's own
//! field; the chest wall stays, so lungs slide along it. The density of the parenchyma rises as it shrinks: mass is
//! conserved through the Jacobian. Vessels keep their density. Left out: beam hardening, motion within a breath hold,
//! heartbeat, disease.

pub mod airway_wall;
pub mod body_motion;
pub mod chest;
pub mod node_grid;
pub mod protocol;
pub mod scan_truth;
pub mod scanner;
pub mod texture;
pub mod thorax;
pub mod vessels;
