//! Table 1 of the paper (mean over its nine COPDGene cases), shown beside ours. Its anatomy, images and machine
//! differ from ours, so the comparison is of orders and ratios, not of decimals.

/// One row of the paper's Table 1.
struct PaperRow {
    method: &'static str,
    values: &'static [(&'static str, f64)],
}

/// The table, row by row.
const ROWS: [PaperRow; 4] = [
    PaperRow {
        method: "bridgesplat",
        values: &[
            ("psnr_db", 20.65),
            ("ssim", 0.683),
            ("depth_rmse_mm", 53.8),
            ("depth_delta_1_25", 0.56),
            ("contour_rmse_mm", 5.67),
            ("target_error_mm", 5.61),
            ("time_total_s", 383.4 * 60.0),
            ("time_per_frame_s", 44.24),
        ],
    },
    PaperRow {
        method: "bridgesplat-nomesh",
        values: &[
            ("psnr_db", 27.80),
            ("ssim", 0.846),
            ("depth_rmse_mm", 26.9),
            ("depth_delta_1_25", 0.50),
            ("time_total_s", 96.8 * 60.0),
            ("time_per_frame_s", 11.26),
        ],
    },
    PaperRow {
        method: "ours-nomesh",
        values: &[
            ("psnr_db", 30.71),
            ("ssim", 0.924),
            ("depth_rmse_mm", 5.9),
            ("depth_delta_1_25", 0.79),
            ("phase_mae", 0.162),
            ("phase_pearson_r", 0.811),
            ("time_total_s", 13.4 * 60.0),
            ("time_per_frame_s", 1.73),
        ],
    },
    PaperRow {
        method: "ours",
        values: &[
            ("psnr_db", 27.37),
            ("ssim", 0.821),
            ("depth_rmse_mm", 3.2),
            ("depth_delta_1_25", 0.88),
            ("phase_mae", 0.158),
            ("phase_pearson_r", 0.833),
            ("contour_rmse_mm", 1.24),
            ("target_error_mm", 1.22),
            ("time_total_s", 17.4 * 60.0),
            ("time_per_frame_s", 1.47),
        ],
    },
];

/// The paper's value of a metric for a method, if its Table 1 has one.
pub fn paper_value(method: &str, metric: &str) -> Option<f64> {
    let row = ROWS.iter().find(|r| r.method == method)?;
    row.values.iter().find(|(id, _)| *id == metric).map(|(_, value)| *value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_metric_of_the_table_is_in_the_registry() {
        for row in &ROWS {
            for (id, _) in row.values {
                assert!(crate::score::paper_metrics().any(|m| m.id == *id), "{id}");
            }
        }
        assert_eq!(paper_value("ours", "target_error_mm"), Some(1.22));
        assert_eq!(paper_value("bridgesplat", "phase_mae"), None);
    }
}
