//! Ranges of the numbers of all method files. Kinds share keys, and a key means the same to each.
//!
//! They keep out what has no meaning or no end (no step at all of a search, a standard deviation of 0, a million
//! iterations), not what is unwise.

use crate::base::range::{KeyRanges, NumberRange, SHARE};

/// Iterations of a stage, before a profile's `iteration_scale`.
const ITERATIONS: NumberRange = NumberRange::new(0.0, 1e5);
/// Sweeps and Gauss-Newton steps.
const STEPS: NumberRange = NumberRange::new(0.0, 1e4);
/// Weights of a loss.
const WEIGHT: NumberRange = NumberRange::new(0.0, 1e6);
/// Adam's rates.
const RATE: NumberRange = NumberRange::new(0.0, 100.0);
/// Rates that fall geometrically, for which none may be 0.
const GEOMETRIC_RATE: NumberRange = NumberRange::new(1e-9, 100.0);
/// Standard deviations.
const DEVIATION: NumberRange = NumberRange::new(1e-9, 1e3);
/// Factors that are not 0.
const FACTOR: NumberRange = NumberRange::new(1e-3, 1e3);
/// Powers and shares of light.
const LIGHT_PART: NumberRange = NumberRange::new(0.0, 10.0);
/// How far a gain may lie below 1; it may rise to the inverse of what is left, so that something must be.
const GAIN_LIMIT: NumberRange = NumberRange::new(0.0, 0.99);
/// Steps of a grid over the phase.
const GRID_STEPS: NumberRange = NumberRange::new(2.0, 1e4);
/// Share of the last change that is repeated.
const VELOCITY: NumberRange = NumberRange::new(0.0, 2.0);
/// Gaussians on a face.
const PER_FACE: NumberRange = NumberRange::new(1.0, 100.0);
/// Gaussians in all.
const BUDGET: NumberRange = NumberRange::new(1.0, 1e7);
/// Opacities; below 1/255 nothing is seen.
const OPACITY: NumberRange = NumberRange::new(0.005, 1.0);
/// Frames that are remembered.
const MEMORY_FRAMES: NumberRange = NumberRange::new(0.0, 1e6);

/// Every key that any kind reads.
pub const METHOD_RANGES: KeyRanges = KeyRanges(&[
    // fitting
    ("iterations", ITERATIONS),
    ("settled", SHARE),
    ("first_frame_factor", FACTOR),
    ("color_weight", WEIGHT),
    ("ssim_weight", SHARE),
    ("phase_ssim_weight", SHARE),
    ("temporal_weight", WEIGHT),
    ("exposure_limit", GAIN_LIMIT),
    ("falloff_exponent", LIGHT_PART),
    ("indirect_share", LIGHT_PART),
    ("largest_width", NumberRange::new(8.0, 8192.0)),
    ("contrast_radius", NumberRange::new(1e-3, 1.0)),
    ("calibration_s", NumberRange::new(0.0, 1e6)),
    ("offsets", NumberRange::new(1.0, 1000.0)),
    ("visibility.margin", NumberRange::new(0.0, 10.0)),
    ("visibility.range_mm", NumberRange::new(1.0, 1e4)),
    // the phase
    ("phase_leak", NumberRange::new(1e-6, 1.0)),
    ("theta_rate", GEOMETRIC_RATE),
    ("theta_rate_joint", GEOMETRIC_RATE),
    ("candidates", NumberRange::new(-1.0, 1.0)),
    ("velocity", VELOCITY),
    ("grid_steps", GRID_STEPS),
    ("memory_frames", MEMORY_FRAMES),
    ("window.keyframes", NumberRange::new(0.0, 1000.0)),
    ("window.memory", SHARE),
    ("window.prior_deviation", DEVIATION),
    // Gaussians
    ("pixels_per_disc", NumberRange::new(0.01, 1e6).or_zero()),
    ("most_per_face", NumberRange::new(1.0, 1024.0)),
    ("appearance.gaussians_per_face", PER_FACE),
    ("appearance.gaussian_budget", BUDGET),
    ("appearance.opacity", OPACITY),
    ("appearance.initial_scale", FACTOR),
    ("appearance.scale_cap", NumberRange::new(1e-3, 1e6).or_zero()),
    ("appearance.position_rate", RATE),
    ("appearance.scale_rate", RATE),
    ("appearance.rotation_rate", RATE),
    ("appearance.quiet_share", WEIGHT),
    ("appearance.rate_interval_s", NumberRange::new(1e-3, 10.0).or_zero()),
    ("appearance.sh_dc_rate", RATE),
    ("appearance.sh_rest_rate", RATE),
    // BridgeSplat
    ("sh_from_iteration", ITERATIONS),
    ("unit_mm", NumberRange::new(1e-3, 1e6)),
    ("arap_weight", WEIGHT),
    ("visibility_weight", WEIGHT),
    ("rigid_weight", WEIGHT),
    ("rotation_weight", WEIGHT),
    ("isometry_weight", WEIGHT),
    ("control_subsample", NumberRange::new(1.0, 1e6)),
    ("control_neighbours", NumberRange::new(1.0, 1000.0)),
    ("control_decay", NumberRange::new(0.0, 1e4)),
    ("displacement_rate", RATE),
    // Gauss-Newton
    ("steps", STEPS),
    ("smallest_width", NumberRange::new(1.0, 8192.0)),
    ("huber", FACTOR),
    ("block_share", NumberRange::new(1e-3, 1.0)),
    ("longest_step", NumberRange::new(1e-6, 1.0)),
    ("prior_deviation", DEVIATION),
    ("lost_factor", NumberRange::new(1.0, 1e6)),
    ("appearance_steps", STEPS),
    ("touch_up_steps", STEPS),
    ("pose_deviation", DEVIATION),
    ("pose_drift", DEVIATION),
    ("pose_steady_s", NumberRange::new(1e-3, 1e6)),
    ("pose_caution", FACTOR),
    ("correction_rank", NumberRange::new(0.0, 64.0)),
    ("correction_reach_mm", NumberRange::new(0.1, 1e4)),
    ("correction_deviation_mm", DEVIATION),
    ("hold_pixels", WEIGHT),
    ("window_deviation_factor", FACTOR),
    ("window_deviation_floor", DEVIATION.or_zero()),
    ("surface.flow", NumberRange::new(1e-6, 1e6).or_zero()),
    ("surface.largest_width", NumberRange::new(8.0, 8192.0)),
    ("surface.contrast_radius", NumberRange::new(1e-3, 1.0)),
    ("surface.spacing", NumberRange::new(1e-3, 0.5)),
    // virtual bronchoscopy
    ("pose.reach", NumberRange::new(0.0, 100.0)),
    ("pose.least_correlation", SHARE),
    ("pose.largest_width", NumberRange::new(8.0, 8192.0)),
    ("pose.steps", STEPS),
    ("pose.contrast_radius", NumberRange::new(1e-3, 1.0)),
    ("pose.huber", FACTOR),
    // navigation
    ("sensor.noise", DEVIATION),
    ("sensor.bias", DEVIATION),
    ("sensor.drift", DEVIATION),
    ("sensor.delay_s", NumberRange::new(1e-6, 10.0)),
    ("tip.rate", DEVIATION),
    ("tip.steady_s", NumberRange::new(1e-3, 1e6)),
    ("tissue.start", DEVIATION),
    ("tissue.hold_s", NumberRange::new(0.0, 60.0)),
    ("tissue.unrest", DEVIATION),
    ("tissue.registration_mm", DEVIATION),
    ("tissue.loop_mm", DEVIATION),
    ("tissue.reach_mm", NumberRange::new(0.1, 1e4)),
    ("tissue.rest_mm", DEVIATION),
    ("optics.centre", DEVIATION),
    ("optics.focal", DEVIATION),
    ("optics.lamp_mm", DEVIATION),
    ("matching.largest_width", NumberRange::new(8.0, 8192.0)),
    ("matching.steps", STEPS),
    ("matching.contrast_radius", NumberRange::new(1e-3, 1.0)),
    ("matching.huber", FACTOR),
    ("matching.together_px", FACTOR),
    ("matching.shade", DEVIATION),
    ("matching.shade_s", NumberRange::new(1e-3, 1e6)),
    ("matching.least_correlation", SHARE),
    ("matching.grid_steps", GRID_STEPS),
    ("deviation_factor", FACTOR),
    ("scope.emission_half_angle_deg", NumberRange::new(5.0, 85.0).or_zero()),
    ("scope.vignette", SHARE),
    ("discs.gaussians_per_face", PER_FACE),
    ("discs.gaussian_budget", BUDGET),
    ("discs.opacity", OPACITY),
    ("discs.initial_scale", FACTOR),
]);
