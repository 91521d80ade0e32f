//! The one place that knows a metric's name, unit, direction, definition and range. Tables, plots, CSV columns, the
//! gate and `explain` all read from here; `docs/metrics.md` says the same in prose.

use serde::Serialize;

/// Which way a metric gets better.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Goal {
    /// Larger is better.
    Higher,
    /// Smaller is better.
    Lower,
}

impl Goal {
    /// `higher` or `lower`, as in `results.csv`.
    pub fn word(self) -> &'static str {
        match self {
            Goal::Higher => "higher",
            Goal::Lower => "lower",
        }
    }

    /// True when `a` is strictly better than `b`. False as soon as one of them is not a number.
    pub fn better(self, a: f64, b: f64) -> bool {
        match self {
            Goal::Higher => a > b,
            Goal::Lower => a < b,
        }
    }

    /// How much worse `value` is than `reference`, in the metric's unit; negative when it is better.
    pub fn loss(self, value: f64, reference: f64) -> f64 {
        match self {
            Goal::Higher => reference - value,
            Goal::Lower => value - reference,
        }
    }
}

/// The paper's column groups (its Table 1), and navigation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Group {
    /// PSNR, SSIM.
    Rendering,
    /// RMSE, delta < 1.25.
    Depth,
    /// Phase MAE and correlation.
    Breathing,
    /// Contour and target error at the final frame.
    Target,
    /// Targets in the camera's axes.
    Navigation,
    /// Seconds.
    Runtime,
}

impl Group {
    /// Heading in tables.
    pub fn title(self) -> &'static str {
        match self {
            Group::Rendering => "Rendering",
            Group::Depth => "Depth",
            Group::Breathing => "Breathing",
            Group::Target => "Target",
            Group::Navigation => "Navigation",
            Group::Runtime => "Runtime",
        }
    }
}

/// Whether a metric is one of the paper's ten columns.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Standing {
    /// A column of the paper's Table 1 and of `comparison.csv`.
    Paper,
    /// An addition of ours.
    Extra,
}

/// The frames over which the number is taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Split {
    /// Every frame, rendered after it was fitted (the paper's protocol).
    Online,
    /// Every eighth frame, rendered before the method read its image.
    Ahead,
    /// Every eighth frame, seen by a second camera whose picture no method is given.
    Novel,
    /// The last frame alone.
    Final,
}

impl Split {
    /// As in `results.csv`.
    pub fn word(self) -> &'static str {
        match self {
            Split::Online => "online",
            Split::Ahead => "ahead",
            Split::Novel => "novel",
            Split::Final => "final",
        }
    }
}

/// One metric.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Metric {
    /// Name in every file.
    pub id: &'static str,
    /// Short heading in tables.
    pub label: &'static str,
    /// Unit; empty for a pure number.
    pub unit: &'static str,
    /// Which way is better.
    pub direction: Goal,
    /// What it is, in full.
    pub definition: &'static str,
    /// Goes up when the definition changes; results of different versions are never compared.
    pub version: u32,
    /// Lowest and highest value it can take (`null` in JSON: unbounded).
    pub range: [Option<f64>; 2],
    /// Its value when truth itself is the prediction; `None` for PSNR (status `identical` or `copied`), and where the truth has none
    /// (times, error bars).
    pub perfect: Option<f64>,
    /// Decimals in tables.
    pub digits: usize,
    /// Column group.
    pub group: Group,
    /// One of the paper's columns or an extra.
    pub standing: Standing,
    /// The frames over which it is taken.
    pub split: Split,
    /// To which predictions it applies.
    pub applies_to: &'static str,
}

impl Metric {
    /// `id/version`, the `definition` column of `results.csv`.
    pub fn definition_id(&self) -> String {
        format!("{}/{}", self.id, self.version)
    }

    /// Heading with unit: `Depth RMSE [mm]`.
    pub fn heading(&self) -> String {
        if self.unit.is_empty() { self.label.to_owned() } else { format!("{} [{}]", self.label, self.unit) }
    }

    /// The metric of the same pictures, depths or phases that tells whether they equal the truth: a share of pixels that
    /// are near enough does not, nor would an SSIM of nearly 1. `None` where it tells itself.
    pub fn told_by(&self) -> Option<&'static Metric> {
        metric(match self.id {
            "ssim" | "ssim_padded" => "psnr_db",
            "novel_ssim" => "novel_psnr_db",
            "depth_delta_1_25" => "depth_rmse_mm",
            "novel_depth_delta_1_25" => "novel_depth_rmse_mm",
            "phase_pearson_r" => "phase_mae",
            _ => return None,
        })
    }

    /// Times differ from run to run and stay out of `results.csv`.
    pub fn is_runtime(&self) -> bool {
        self.group == Group::Runtime
    }

    /// `value` with the metric's decimals.
    pub fn format(&self, value: f64) -> String {
        format!("{value:.*}", self.digits)
    }
}

// The predictions to which a metric applies, in words.
const ALL: &str = "every prediction";
const WITH_DEPTH: &str = "predictions with depth images";
const WITH_PHASE: &str = "predictions with phase.csv: methods that model the respiratory state";
const WITH_PHASE_SD: &str = "predictions whose phase.csv states phase_sd in every row";
const WITH_MESH: &str = "predictions with mesh/final.ply: methods that keep an explicit surface";
const WITH_POSES: &str = "methods that estimate poses";
const WITH_NOVEL: &str = "predictions with novel/NNNNNN.png for every second camera";
const WITH_NOVEL_DEPTH: &str = "predictions with novel_depth/ for every second camera";
const WITH_TARGETS: &str = "predictions with targets.csv";
const WITH_TARGETS_AND_DISTURBANCES: &str =
    "predictions with targets.csv, of films with a cough or a touch of the wall";
const WITH_TARGET_COVARIANCE: &str = "predictions with target_covariance.csv";
const WITH_CPU_TIME: &str = "predictions with time_cpu_s in timing.json";
const WITH_TIME: &str = "predictions with timing.json";

const fn base(id: &'static str, label: &'static str, unit: &'static str, direction: Goal, group: Group) -> Metric {
    Metric {
        id,
        label,
        unit,
        direction,
        definition: "",
        version: 1,
        range: [Some(0.0), None],
        perfect: Some(0.0),
        digits: 2,
        group,
        standing: Standing::Extra,
        split: Split::Online,
        applies_to: ALL,
    }
}

static REGISTRY: &[Metric] = &[
    Metric {
        definition: "10 log10(1 / MSE) per frame on 8-bit sRGB codes divided by 255, MSE over all pixels and the three \
            channels, then the mean over frames. A frame equal to the truth counts with the PSNR of the smallest error that \
            8 bits can show (one code in one value). Where more than one in a hundred of the pictures are the input, to the bit \
            or nearly (above 65 dB), there is no value, status `copied`: no estimate equals it, noise and all.",
        perfect: None,
        standing: Standing::Paper,
        ..base("psnr_db", "PSNR", "dB", Goal::Higher, Group::Rendering)
    },
    Metric {
        definition: "Structural similarity per frame on encoded sRGB in [0, 1], per channel: Gaussian window 11x11 with sigma \
            1.5, K1 = 0.01, K2 = 0.03, population moments, averaged over the windows that lie wholly in the image (5 pixels \
            cropped) and the three channels, then the mean over frames (Wang et al. 2004; equals scikit-image with \
            gaussian_weights, sigma 1.5, use_sample_covariance off).",
        range: [Some(-1.0), Some(1.0)],
        perfect: Some(1.0),
        digits: 3,
        standing: Standing::Paper,
        ..base("ssim", "SSIM", "", Goal::Higher, Group::Rendering)
    },
    Metric {
        definition: "Root mean square of predicted minus true z-depth per frame over the pixels whose true depth is above 0, \
            no scale or shift alignment, then the mean over frames. Where a predicted depth is absent (0, negative or not \
            finite) the error is the farthest true depth of the frame.",
        version: 2,
        digits: 2,
        standing: Standing::Paper,
        applies_to: WITH_DEPTH,
        ..base("depth_rmse_mm", "Depth RMSE", "mm", Goal::Lower, Group::Depth)
    },
    Metric {
        definition: "Share of the pixels with true depth above 0 where max(predicted / true, true / predicted) < 1.25, per \
            frame, no alignment, then the mean over frames. An absent predicted depth counts as wrong.",
        range: [Some(0.0), Some(1.0)],
        perfect: Some(1.0),
        digits: 3,
        standing: Standing::Paper,
        applies_to: WITH_DEPTH,
        ..base("depth_delta_1_25", "δ<1.25", "", Goal::Higher, Group::Depth)
    },
    Metric {
        definition: "Mean over all frames of |predicted phase - true phase|; phase 0 is full inspiration, 1 full expiration.",
        digits: 3,
        standing: Standing::Paper,
        applies_to: WITH_PHASE,
        ..base("phase_mae", "Phase MAE", "", Goal::Lower, Group::Breathing)
    },
    Metric {
        definition: "Pearson correlation of predicted and true phase over all frames. A trajectory without variance has none: \
            empty, status `degenerate`.",
        range: [Some(-1.0), Some(1.0)],
        perfect: Some(1.0),
        digits: 3,
        standing: Standing::Paper,
        applies_to: WITH_PHASE,
        ..base("phase_pearson_r", "Pearson r", "", Goal::Higher, Group::Breathing)
    },
    Metric {
        definition: "Distance between predicted and true centre of the camera, mean over all frames.",
        digits: 2,
        applies_to: WITH_POSES,
        ..base("pose_error_mm", "Pose", "mm", Goal::Lower, Group::Breathing)
    },
    Metric {
        definition: "Angle of the rotation between predicted and true orientation of the camera, mean over all frames.",
        range: [Some(0.0), Some(180.0)],
        digits: 2,
        applies_to: WITH_POSES,
        ..base("pose_error_deg", "Pose angle", "deg", Goal::Lower, Group::Breathing)
    },
    Metric {
        definition: "True and predicted surface at the last frame are cut by the plane through the last camera's centre, normal \
            to its optical axis. Of each, the contour around the camera is kept (smallest enclosed area). Both are resampled \
            every 0.05 mm; the value is sqrt((mean d^2 from truth to prediction + mean d^2 from prediction to truth) / 2), d the \
            distance of a point to the other contour. Of a prediction with the truth's faces, cuts that come nearer to a \
            contour than the other one does join that one, on both sides, until there is none: a plane through a bifurcation \
            joins or parts branches. If no predicted contour encloses the camera, the one nearest to it is taken, status \
            `camera_outside`. If the plane misses the surface, the row counts with the case's worst, status `no_contour`.",
        version: 3,
        standing: Standing::Paper,
        split: Split::Final,
        applies_to: WITH_MESH,
        ..base("contour_rmse_mm", "Contour RMSE", "mm", Goal::Lower, Group::Target)
    },
    Metric {
        definition: "Distance in 3D between one vertex of the true contour (see contour_rmse_mm; chosen by seed, the same for \
            every method) and the same material point of the predicted surface (same mesh edge, same fraction along it). If the \
            predicted surface has other faces, correspondence.csv says where the edge's ends are on it; without that the row \
            counts with the case's worst, status `no_correspondence`.",
        version: 2,
        standing: Standing::Paper,
        split: Split::Final,
        applies_to: WITH_MESH,
        ..base("target_error_mm", "Target error", "mm", Goal::Lower, Group::Target)
    },
    Metric {
        definition: "Wall time of the method alone for all frames: no reading, writing or scoring.",
        perfect: None,
        digits: 1,
        standing: Standing::Paper,
        applies_to: WITH_TIME,
        ..base("time_total_s", "Time", "s", Goal::Lower, Group::Runtime)
    },
    Metric {
        definition: "time_total_s divided by the number of frames.",
        perfect: None,
        digits: 3,
        standing: Standing::Paper,
        applies_to: WITH_TIME,
        ..base("time_per_frame_s", "Time per frame", "s", Goal::Lower, Group::Runtime)
    },
    Metric {
        definition: "psnr_db over the views of the second cameras, whose pictures no method is given: rendered after the frame \
            of the same instant was fitted, from novel/NNNNNN.png.",
        perfect: None,
        split: Split::Novel,
        applies_to: WITH_NOVEL,
        ..base("novel_psnr_db", "Novel PSNR", "dB", Goal::Higher, Group::Rendering)
    },
    Metric {
        definition: "ssim over the views of the second cameras.",
        range: [Some(-1.0), Some(1.0)],
        perfect: Some(1.0),
        digits: 3,
        split: Split::Novel,
        applies_to: WITH_NOVEL,
        ..base("novel_ssim", "Novel SSIM", "", Goal::Higher, Group::Rendering)
    },
    Metric {
        definition: "depth_rmse_mm over the views of the second cameras, from novel_depth/.",
        split: Split::Novel,
        applies_to: WITH_NOVEL_DEPTH,
        ..base("novel_depth_rmse_mm", "Novel depth RMSE", "mm", Goal::Lower, Group::Depth)
    },
    Metric {
        definition: "depth_delta_1_25 over the views of the second cameras, from novel_depth/.",
        range: [Some(0.0), Some(1.0)],
        perfect: Some(1.0),
        digits: 3,
        split: Split::Novel,
        applies_to: WITH_NOVEL_DEPTH,
        ..base("novel_depth_delta_1_25", "Novel δ<1.25", "", Goal::Higher, Group::Depth)
    },
    Metric {
        definition: "Distance between predicted and true place of the navigation targets (peripheral branch tips, and points of \
            the tissue a centimetre beside them, planned on the inspiration CT and carried by the true motion), mean over all \
            frames and targets.",
        applies_to: WITH_TARGETS,
        ..base("target_mean_mm", "Target, all frames", "mm", Goal::Lower, Group::Target)
    },
    Metric {
        definition: "95th percentile (linear between ranks) over all frames and targets of the distance of target_mean_mm.",
        applies_to: WITH_TARGETS,
        ..base("target_p95_mm", "Target p95, all frames", "mm", Goal::Lower, Group::Target)
    },
    Metric {
        definition: "psnr_db over the frames rendered before their image was looked at (every eighth), from ahead/NNNNNN.png.",
        perfect: None,
        split: Split::Ahead,
        applies_to: "predictions with an ahead folder",
        ..base("psnr_ahead_db", "PSNR ahead", "dB", Goal::Higher, Group::Rendering)
    },
    Metric {
        definition: "As ssim, but averaged over all pixels with zeros outside the image, as the Gaussian-splatting code bases \
            compute it; for comparison with their numbers only.",
        range: [Some(-1.0), Some(1.0)],
        perfect: Some(1.0),
        digits: 3,
        ..base("ssim_padded", "SSIM zero-padded", "", Goal::Higher, Group::Rendering)
    },
    Metric {
        definition: "Share of the pixels with true depth above 0 for which a depth was predicted, mean over frames.",
        range: [Some(0.0), Some(1.0)],
        perfect: Some(1.0),
        digits: 3,
        applies_to: WITH_DEPTH,
        ..base("depth_coverage", "Depth coverage", "", Goal::Higher, Group::Depth)
    },
    Metric {
        definition: "Share of the frames whose error of the phase is at most one standard deviation as stated in phase.csv, \
            in percent; 68 where the error bars are right and errors are normal. It rises with the width beside it \
            (phase_sd_mean), so alone it ranks nobody.",
        range: [Some(0.0), Some(100.0)],
        perfect: None,
        digits: 1,
        applies_to: WITH_PHASE_SD,
        ..base("phase_coverage_1sd_pct", "Within 1 sd", "%", Goal::Higher, Group::Breathing)
    },
    Metric {
        definition: "As phase_coverage_1sd_pct, for two standard deviations; 95 where the error bars are right.",
        range: [Some(0.0), Some(100.0)],
        perfect: None,
        digits: 1,
        applies_to: WITH_PHASE_SD,
        ..base("phase_coverage_2sd_pct", "Within 2 sd", "%", Goal::Higher, Group::Breathing)
    },
    Metric {
        definition: "Mean over all frames of the standard deviation of the phase as stated in phase.csv.",
        perfect: None,
        digits: 3,
        applies_to: WITH_PHASE_SD,
        ..base("phase_sd_mean", "Phase sd", "", Goal::Lower, Group::Breathing)
    },
    Metric {
        definition: "CPU seconds of the method alone for all frames, of all its threads, user and system; measured for this \
            program's methods, stated by others.",
        perfect: None,
        digits: 1,
        applies_to: WITH_CPU_TIME,
        ..base("time_cpu_s", "CPU time", "s", Goal::Lower, Group::Runtime)
    },
    Metric {
        definition: "Mean over all vertices of the true contour of the error that target_error_mm takes at one of them.",
        version: 2,
        split: Split::Final,
        applies_to: WITH_MESH,
        ..base("target_error_mean_mm", "Target error mean", "mm", Goal::Lower, Group::Target)
    },
    Metric {
        definition: "95th percentile (linear between ranks) over all vertices of the true contour of the error that \
            target_error_mm takes at one of them.",
        version: 2,
        split: Split::Final,
        applies_to: WITH_MESH,
        ..base("target_error_p95_mm", "Target error p95", "mm", Goal::Lower, Group::Target)
    },
    Metric {
        definition: "Distance between predicted and true place of the targets of target_mean_mm in the camera's axes, mean over \
            all frames and targets: with the predicted pose (poses.csv; the told one without it) the predicted place, with \
            the true pose the true one, so that errors of pose and deformation count together.",
        applies_to: WITH_TARGETS,
        ..base("navigation_error_mm", "Navigation", "mm", Goal::Lower, Group::Navigation)
    },
    Metric {
        definition: "95th percentile (linear between ranks) over all frames and targets of the distance of navigation_error_mm.",
        applies_to: WITH_TARGETS,
        ..base("navigation_error_p95_mm", "Navigation p95", "mm", Goal::Lower, Group::Navigation)
    },
    Metric {
        definition: "Share of the frames whose navigation error, mean over targets, is more than 5 mm, in percent.",
        range: [Some(0.0), Some(100.0)],
        digits: 1,
        applies_to: WITH_TARGETS,
        ..base("lost_pct", "Lost", "%", Goal::Lower, Group::Navigation)
    },
    Metric {
        definition: "Share of the frames that are lost (lost_pct) while the error bar that the method states for them \
            (square root of the trace of target_covariance.csv, mean over targets) is below 2.5 mm, in percent.",
        range: [Some(0.0), Some(100.0)],
        digits: 1,
        applies_to: WITH_TARGET_COVARIANCE,
        ..base("silent_pct", "Lost in silence", "%", Goal::Lower, Group::Navigation)
    },
    Metric {
        definition: "Share of the coughs and touches of the wall (stretches of frames in which clinical.csv has an effort or a \
            weight of .1 or more) after which the targets are found again: navigation error, mean over targets, of at most \
            5 mm at a frame at most 1 s after the last disturbed one, in percent. One that ends less than a second before \
            the film, and is not found until then, does not count.",
        range: [Some(0.0), Some(100.0)],
        perfect: Some(100.0),
        digits: 1,
        applies_to: WITH_TARGETS_AND_DISTURBANCES,
        ..base("recovered_pct", "Found again", "%", Goal::Higher, Group::Navigation)
    },
    Metric {
        definition: "Share of the targets' coordinates in the camera's axes, over all frames, that are off by at most one \
            standard deviation as stated in target_covariance.csv, in percent; 68 where the error bars are right and errors \
            are normal. It rises with the width beside it (navigation_sd_mm), so alone it ranks nobody.",
        range: [Some(0.0), Some(100.0)],
        perfect: None,
        digits: 1,
        applies_to: WITH_TARGET_COVARIANCE,
        ..base("navigation_coverage_1sd_pct", "Navigation within 1 sd", "%", Goal::Higher, Group::Navigation)
    },
    Metric {
        definition: "As navigation_coverage_1sd_pct, for two standard deviations; 95 where the error bars are right.",
        range: [Some(0.0), Some(100.0)],
        perfect: None,
        digits: 1,
        applies_to: WITH_TARGET_COVARIANCE,
        ..base("navigation_coverage_2sd_pct", "Navigation within 2 sd", "%", Goal::Higher, Group::Navigation)
    },
    Metric {
        definition: "Error bar of a target's place in the camera's axes: square root of the trace of its covariance as stated \
            in target_covariance.csv, mean over all frames and targets.",
        perfect: None,
        applies_to: WITH_TARGET_COVARIANCE,
        ..base("navigation_sd_mm", "Navigation sd", "mm", Goal::Lower, Group::Navigation)
    },
];

/// All metrics: the paper's ten in the paper's order, then the extras.
pub fn registry() -> &'static [Metric] {
    REGISTRY
}

/// What ranks: views that nobody fitted, the phase, the targets in all frames, and time, by the wall's clock and the
/// processor's.
const RANKING: [&str; 9] = [
    "novel_psnr_db",
    "novel_ssim",
    "novel_depth_rmse_mm",
    "novel_depth_delta_1_25",
    "phase_mae",
    "target_mean_mm",
    "target_p95_mm",
    "time_per_frame_s",
    "time_cpu_s",
];

/// What ranks on the clinical track besides, and stands before the rest: the targets as the scope is steered by them.
const NAVIGATION: [&str; 4] = ["navigation_error_mm", "navigation_error_p95_mm", "lost_pct", "recovered_pct"];
/// Error bars of navigation, which rank nobody.
const NAVIGATION_BARS: [&str; 4] =
    ["silent_pct", "navigation_coverage_1sd_pct", "navigation_coverage_2sd_pct", "navigation_sd_mm"];

/// The columns of navigation that rank.
pub fn navigation_metrics() -> impl Iterator<Item = &'static Metric> {
    NAVIGATION.iter().filter_map(|id| metric(id))
}

/// The columns of navigation that judge error bars and rank nobody.
pub fn navigation_bar_metrics() -> impl Iterator<Item = &'static Metric> {
    NAVIGATION_BARS.iter().filter_map(|id| metric(id))
}

/// The columns that rank, in the order of their table.
pub fn ranking_metrics() -> impl Iterator<Item = &'static Metric> {
    RANKING.iter().filter_map(|id| metric(id))
}

/// The paper's ten, in the order of its Table 1 and of `comparison.csv`.
pub fn paper_metrics() -> impl Iterator<Item = &'static Metric> {
    REGISTRY.iter().filter(|m| m.standing == Standing::Paper)
}

/// The metric called `id`.
pub fn metric(id: &str) -> Option<&'static Metric> {
    REGISTRY.iter().find(|m| m.id == id)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ids_are_unique_and_the_papers_columns_come_first() {
        let ids: Vec<&str> = paper_metrics().map(|m| m.id).collect();
        assert_eq!(
            ids,
            [
                "psnr_db",
                "ssim",
                "depth_rmse_mm",
                "depth_delta_1_25",
                "phase_mae",
                "phase_pearson_r",
                "contour_rmse_mm",
                "target_error_mm",
                "time_total_s",
                "time_per_frame_s"
            ]
        );
        assert_eq!(ranking_metrics().count(), RANKING.len());
        assert_eq!(
            navigation_metrics().chain(navigation_bar_metrics()).count(),
            NAVIGATION.len() + NAVIGATION_BARS.len()
        );
        for (index, m) in registry().iter().enumerate() {
            assert!(registry()[..index].iter().all(|other| other.id != m.id));
            assert!(m.definition.len() > 20 && m.definition.ends_with('.'), "{}", m.id);
        }
    }

    #[test]
    fn a_value_that_is_no_number_is_never_better() {
        for direction in [Goal::Higher, Goal::Lower] {
            assert!(!direction.better(f64::NAN, 1.0) && !direction.better(1.0, f64::NAN));
        }
        assert_eq!(Goal::Higher.loss(20.0, 21.0), 1.0);
        assert_eq!(Goal::Lower.loss(20.0, 21.0), -1.0);
    }
}
