//! The one place that knows a metric: its name, unit, direction, definition, range, what it needs of a prediction and
//! how it is computed. Tables, plots, CSV columns, scoring, `check`, the gate and `explain` all read from here;
//! `docs/metrics.md` says the same in prose.

use super::measures;
use super::metric::Computation::{Film, Frames};
use super::metric::Goal::{Higher, Lower};
use super::metric::{Computation, Goal, Group, Metric, Needs, Split, Standing, Trace};

/// A metric as most are, with a first definition and in the online frames. There is none without a computation.
const fn base(
    id: &'static str,
    label: &'static str,
    unit: &'static str,
    direction: Goal,
    group: Group,
    computation: Computation,
) -> Metric {
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
        applies_to: Needs::Pictures,
        computation,
        trace: Trace::None,
        told_by: None,
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
        ..base("psnr_db", "PSNR", "dB", Higher, Group::Rendering, Frames(measures::psnr, measures::mean_psnr))
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
        told_by: Some("psnr_db"),
        ..base("ssim", "SSIM", "", Higher, Group::Rendering, Frames(measures::ssim, measures::mean_ssim))
    },
    Metric {
        definition: "Root mean square of predicted minus true z-depth per frame over the pixels whose true depth is above 0, \
            no scale or shift alignment, then the mean over frames. Where a predicted depth is absent (0, negative or not \
            finite) the error is the farthest true depth of the frame.",
        version: 2,
        digits: 2,
        standing: Standing::Paper,
        applies_to: Needs::Depth,
        ..base(
            "depth_rmse_mm",
            "Depth RMSE",
            "mm",
            Lower,
            Group::Depth,
            Frames(measures::depth_rmse, measures::mean_depth),
        )
    },
    Metric {
        definition: "Share of the pixels with true depth above 0 where max(predicted / true, true / predicted) < 1.25, per \
            frame, no alignment, then the mean over frames. An absent predicted depth counts as wrong.",
        range: [Some(0.0), Some(1.0)],
        perfect: Some(1.0),
        digits: 3,
        standing: Standing::Paper,
        applies_to: Needs::Depth,
        told_by: Some("depth_rmse_mm"),
        ..base(
            "depth_delta_1_25",
            "δ<1.25",
            "",
            Higher,
            Group::Depth,
            Frames(measures::depth_delta, measures::mean_depth),
        )
    },
    Metric {
        definition: "Mean over all frames of |predicted phase - true phase|; phase 0 is full inspiration, 1 full expiration.",
        digits: 3,
        standing: Standing::Paper,
        applies_to: Needs::Phase,
        ..base("phase_mae", "Phase MAE", "", Lower, Group::Breathing, Frames(measures::phase_error, measures::mean))
    },
    Metric {
        definition: "Pearson correlation of predicted and true phase over all frames. A trajectory without variance has none: \
            empty, status `degenerate`.",
        range: [Some(-1.0), Some(1.0)],
        perfect: Some(1.0),
        digits: 3,
        standing: Standing::Paper,
        applies_to: Needs::Phase,
        trace: Trace::Phases,
        told_by: Some("phase_mae"),
        ..base("phase_pearson_r", "Pearson r", "", Higher, Group::Breathing, Film(measures::phase_correlation))
    },
    Metric {
        definition: "Distance between predicted and true centre of the camera, mean over all frames.",
        digits: 2,
        applies_to: Needs::Poses,
        ..base("pose_error_mm", "Pose", "mm", Lower, Group::Breathing, Frames(measures::pose_distance, measures::mean))
    },
    Metric {
        definition: "Angle of the rotation between predicted and true orientation of the camera, mean over all frames.",
        range: [Some(0.0), Some(180.0)],
        digits: 2,
        applies_to: Needs::Poses,
        ..base(
            "pose_error_deg",
            "Pose angle",
            "deg",
            Lower,
            Group::Breathing,
            Frames(measures::pose_angle, measures::mean),
        )
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
        applies_to: Needs::Surface,
        ..base("contour_rmse_mm", "Contour RMSE", "mm", Lower, Group::Target, Film(measures::contour))
    },
    Metric {
        definition: "Distance in 3D between one vertex of the true contour (see contour_rmse_mm; chosen by seed, the same for \
            every method) and the same material point of the predicted surface (same mesh edge, same fraction along it). If the \
            predicted surface has other faces, correspondence.csv says where the edge's ends are on it; without that the row \
            counts with the case's worst, status `no_correspondence`.",
        version: 2,
        standing: Standing::Paper,
        split: Split::Final,
        applies_to: Needs::Surface,
        ..base("target_error_mm", "Target error", "mm", Lower, Group::Target, Film(measures::target))
    },
    Metric {
        definition: "Wall time of the method alone for all frames: no reading, writing or scoring.",
        perfect: None,
        digits: 1,
        standing: Standing::Paper,
        applies_to: Needs::Time,
        ..base("time_total_s", "Time", "s", Lower, Group::Runtime, Film(measures::time_total))
    },
    Metric {
        definition: "time_total_s divided by the number of frames.",
        perfect: None,
        digits: 3,
        standing: Standing::Paper,
        applies_to: Needs::Time,
        trace: Trace::TotalTime,
        ..base("time_per_frame_s", "Time per frame", "s", Lower, Group::Runtime, Film(measures::time_per_frame))
    },
    Metric {
        definition: "psnr_db over the views of the second cameras, whose pictures no method is given: rendered after the frame \
            of the same instant was fitted, from novel/NNNNNN.png.",
        perfect: None,
        split: Split::Novel,
        applies_to: Needs::Novel,
        ..base(
            "novel_psnr_db",
            "Novel PSNR",
            "dB",
            Higher,
            Group::Rendering,
            Frames(measures::novel_psnr, measures::mean_novel_psnr),
        )
    },
    Metric {
        definition: "ssim over the views of the second cameras.",
        range: [Some(-1.0), Some(1.0)],
        perfect: Some(1.0),
        digits: 3,
        split: Split::Novel,
        applies_to: Needs::Novel,
        told_by: Some("novel_psnr_db"),
        ..base(
            "novel_ssim",
            "Novel SSIM",
            "",
            Higher,
            Group::Rendering,
            Frames(measures::novel_ssim, measures::mean_novel_ssim),
        )
    },
    Metric {
        definition: "depth_rmse_mm over the views of the second cameras, from novel_depth/.",
        split: Split::Novel,
        applies_to: Needs::NovelDepth,
        ..base(
            "novel_depth_rmse_mm",
            "Novel depth RMSE",
            "mm",
            Lower,
            Group::Depth,
            Frames(measures::novel_depth_rmse, measures::mean_depth),
        )
    },
    Metric {
        definition: "depth_delta_1_25 over the views of the second cameras, from novel_depth/.",
        range: [Some(0.0), Some(1.0)],
        perfect: Some(1.0),
        digits: 3,
        split: Split::Novel,
        applies_to: Needs::NovelDepth,
        told_by: Some("novel_depth_rmse_mm"),
        ..base(
            "novel_depth_delta_1_25",
            "Novel δ<1.25",
            "",
            Higher,
            Group::Depth,
            Frames(measures::novel_depth_delta, measures::mean_depth),
        )
    },
    Metric {
        definition: "Distance between predicted and true place of the navigation targets (peripheral branch tips, and points of \
            the tissue a centimetre beside them, planned on the inspiration CT and carried by the true motion), mean over all \
            frames and targets.",
        applies_to: Needs::Targets,
        ..base(
            "target_mean_mm",
            "Target, all frames",
            "mm",
            Lower,
            Group::Target,
            Frames(measures::targets_distance, measures::mean),
        )
    },
    Metric {
        definition: "95th percentile (linear between ranks) over all frames and targets of the distance of target_mean_mm.",
        applies_to: Needs::Targets,
        ..base("target_p95_mm", "Target p95, all frames", "mm", Lower, Group::Target, Film(measures::targets_p95))
    },
    Metric {
        definition: "psnr_db over the frames rendered before their image was looked at (every eighth), from ahead/NNNNNN.png.",
        perfect: None,
        split: Split::Ahead,
        applies_to: Needs::Ahead,
        ..base(
            "psnr_ahead_db",
            "PSNR ahead",
            "dB",
            Higher,
            Group::Rendering,
            Frames(measures::psnr_ahead, measures::mean_psnr_ahead),
        )
    },
    Metric {
        definition: "As ssim, but averaged over all pixels with zeros outside the image, as the Gaussian-splatting code bases \
            compute it; for comparison with their numbers only.",
        range: [Some(-1.0), Some(1.0)],
        perfect: Some(1.0),
        digits: 3,
        told_by: Some("psnr_db"),
        ..base("ssim_padded", "SSIM zero-padded", "", Higher, Group::Rendering, Film(measures::ssim_padded))
    },
    Metric {
        definition: "Share of the pixels with true depth above 0 for which a depth was predicted, mean over frames.",
        range: [Some(0.0), Some(1.0)],
        perfect: Some(1.0),
        digits: 3,
        applies_to: Needs::Depth,
        ..base("depth_coverage", "Depth coverage", "", Higher, Group::Depth, Film(measures::depth_coverage))
    },
    Metric {
        definition: "Share of the frames whose error of the phase is at most one standard deviation as stated in phase.csv, \
            in percent; 68 where the error bars are right and errors are normal. It rises with the width beside it \
            (phase_sd_mean), so alone it ranks nobody.",
        range: [Some(0.0), Some(100.0)],
        perfect: None,
        digits: 1,
        applies_to: Needs::PhaseDeviation,
        ..base(
            "phase_coverage_1sd_pct",
            "Within 1 sd",
            "%",
            Higher,
            Group::Breathing,
            Frames(measures::phase_within_1sd, measures::mean),
        )
    },
    Metric {
        definition: "As phase_coverage_1sd_pct, for two standard deviations; 95 where the error bars are right.",
        range: [Some(0.0), Some(100.0)],
        perfect: None,
        digits: 1,
        applies_to: Needs::PhaseDeviation,
        ..base(
            "phase_coverage_2sd_pct",
            "Within 2 sd",
            "%",
            Higher,
            Group::Breathing,
            Frames(measures::phase_within_2sd, measures::mean),
        )
    },
    Metric {
        definition: "Mean over all frames of the standard deviation of the phase as stated in phase.csv.",
        perfect: None,
        digits: 3,
        applies_to: Needs::PhaseDeviation,
        ..base(
            "phase_sd_mean",
            "Phase sd",
            "",
            Lower,
            Group::Breathing,
            Frames(measures::phase_deviation, measures::mean),
        )
    },
    Metric {
        definition: "CPU seconds of the method alone for all frames, of all its threads, user and system; measured for this \
            program's methods, stated by others.",
        perfect: None,
        digits: 1,
        applies_to: Needs::CpuTime,
        ..base("time_cpu_s", "CPU time", "s", Lower, Group::Runtime, Film(measures::time_cpu))
    },
    Metric {
        definition: "Mean over all vertices of the true contour of the error that target_error_mm takes at one of them.",
        version: 2,
        split: Split::Final,
        applies_to: Needs::Surface,
        ..base("target_error_mean_mm", "Target error mean", "mm", Lower, Group::Target, Film(measures::target_mean))
    },
    Metric {
        definition: "95th percentile (linear between ranks) over all vertices of the true contour of the error that \
            target_error_mm takes at one of them.",
        version: 2,
        split: Split::Final,
        applies_to: Needs::Surface,
        ..base("target_error_p95_mm", "Target error p95", "mm", Lower, Group::Target, Film(measures::target_p95))
    },
    Metric {
        definition: "Distance between predicted and true place of the targets of target_mean_mm in the camera's axes, mean over \
            all frames and targets: with the predicted pose (poses.csv; the told one without it) the predicted place, with \
            the true pose the true one, so that errors of pose and deformation count together.",
        applies_to: Needs::Targets,
        ..base(
            "navigation_error_mm",
            "Navigation",
            "mm",
            Lower,
            Group::Navigation,
            Frames(measures::navigation_error, measures::mean),
        )
    },
    Metric {
        definition: "95th percentile (linear between ranks) over all frames and targets of the distance of navigation_error_mm.",
        applies_to: Needs::Targets,
        ..base(
            "navigation_error_p95_mm",
            "Navigation p95",
            "mm",
            Lower,
            Group::Navigation,
            Film(measures::navigation_p95),
        )
    },
    Metric {
        definition: "Share of the frames whose navigation error, mean over targets, is more than 5 mm, in percent.",
        range: [Some(0.0), Some(100.0)],
        digits: 1,
        applies_to: Needs::Targets,
        ..base("lost_pct", "Lost", "%", Lower, Group::Navigation, Frames(measures::lost, measures::mean))
    },
    Metric {
        definition: "Share of the frames that are lost (lost_pct) while the error bar that the method states for them \
            (square root of the trace of target_covariance.csv, mean over targets) is below 2.5 mm, in percent.",
        range: [Some(0.0), Some(100.0)],
        digits: 1,
        applies_to: Needs::TargetCovariance,
        ..base(
            "silent_pct",
            "Lost in silence",
            "%",
            Lower,
            Group::Navigation,
            Frames(measures::lost_in_silence, measures::mean),
        )
    },
    Metric {
        definition: "Share of the coughs and touches of the wall (stretches of frames in which clinical.csv has an effort or a \
            weight of .1 or more) after which the targets are found again: navigation error, mean over targets, of at most \
            5 mm at a frame at most 1 s after the last disturbed one, in percent. One that ends less than a second before \
            the film, and is not found until then, does not count.",
        range: [Some(0.0), Some(100.0)],
        perfect: Some(100.0),
        digits: 1,
        applies_to: Needs::DisturbedTargets,
        ..base(
            "recovered_pct",
            "Found again",
            "%",
            Higher,
            Group::Navigation,
            Frames(measures::recovered, measures::mean),
        )
    },
    Metric {
        definition: "Share of the targets' coordinates in the camera's axes, over all frames, that are off by at most one \
            standard deviation as stated in target_covariance.csv, in percent; 68 where the error bars are right and errors \
            are normal. It rises with the width beside it (navigation_sd_mm), so alone it ranks nobody.",
        range: [Some(0.0), Some(100.0)],
        perfect: None,
        digits: 1,
        applies_to: Needs::TargetCovariance,
        ..base(
            "navigation_coverage_1sd_pct",
            "Navigation within 1 sd",
            "%",
            Higher,
            Group::Navigation,
            Frames(measures::navigation_within_1sd, measures::mean),
        )
    },
    Metric {
        definition: "As navigation_coverage_1sd_pct, for two standard deviations; 95 where the error bars are right.",
        range: [Some(0.0), Some(100.0)],
        perfect: None,
        digits: 1,
        applies_to: Needs::TargetCovariance,
        ..base(
            "navigation_coverage_2sd_pct",
            "Navigation within 2 sd",
            "%",
            Higher,
            Group::Navigation,
            Frames(measures::navigation_within_2sd, measures::mean),
        )
    },
    Metric {
        definition: "Error bar of a target's place in the camera's axes: square root of the trace of its covariance as stated \
            in target_covariance.csv, mean over all frames and targets.",
        perfect: None,
        applies_to: Needs::TargetCovariance,
        ..base(
            "navigation_sd_mm",
            "Navigation sd",
            "mm",
            Lower,
            Group::Navigation,
            Frames(measures::navigation_bar, measures::mean),
        )
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

/// The metric that tells whether the pictures, depths or phases of `m` equal the truth (its `told_by`); `None`
/// where it tells itself.
pub fn told_by(m: &Metric) -> Option<&'static Metric> {
    m.told_by.and_then(metric)
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
            assert_eq!(told_by(m).map(|other| other.id), m.told_by, "{}", m.id);
        }
    }

    #[test]
    fn a_value_that_is_no_number_is_never_better() {
        for direction in [Higher, Lower] {
            assert!(!direction.better(f64::NAN, 1.0) && !direction.better(1.0, f64::NAN));
        }
        assert_eq!(Higher.loss(20.0, 21.0), 1.0);
        assert_eq!(Lower.loss(20.0, 21.0), -1.0);
    }
}
