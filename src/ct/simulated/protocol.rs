//! How a scanner is set: voxels, sharpness, noise.

/// A protocol of chest CT, by the thickness of its slices.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ScanProtocol {
    /// Slices of 0.7 mm, a sharp kernel: what airways are measured in.
    Thin,
    /// Slices of 2.5 mm, a medium kernel: what 4D-CT and many archives have.
    Thick,
}

impl ScanProtocol {
    /// Both, in order.
    pub const ALL: [ScanProtocol; 2] = [ScanProtocol::Thin, ScanProtocol::Thick];

    /// The name on the command line and in tables.
    pub fn name(self) -> &'static str {
        match self {
            ScanProtocol::Thin => "thin",
            ScanProtocol::Thick => "thick",
        }
    }

    /// The settings. Voxels after ATM'22 (0.5 to 0.9 mm in plane, slices from 0.5 mm; Zhang et al., MedIA 90:102957,
    /// 2023) and after 4D-CT (2.5 mm). A point spread of 1.0 and 1.2 mm is that of kernels with 10 % modulation at 8 and
    /// 7 line pairs per cm; noise is the standard deviation in soft tissue at about 3 and 5 mGy.
    pub fn settings(self) -> ScannerSettings {
        match self {
            ScanProtocol::Thin => ScannerSettings {
                pixel_mm: 0.7,
                slice_mm: 0.7,
                thickness_mm: 0.9,
                point_spread_mm: 1.0,
                noise_hu: 38.0,
                fine_slices: 1,
            },
            ScanProtocol::Thick => ScannerSettings {
                pixel_mm: 0.7,
                slice_mm: 2.5,
                thickness_mm: 2.5,
                point_spread_mm: 1.2,
                noise_hu: 15.0,
                fine_slices: 4,
            },
        }
    }
}

/// What a protocol means.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScannerSettings {
    /// Edge of a pixel in mm.
    pub pixel_mm: f64,
    /// Distance of slices in mm.
    pub slice_mm: f64,
    /// Full width at half maximum of the slice profile in mm.
    pub thickness_mm: f64,
    /// Full width at half maximum of the point spread in the plane, mm.
    pub point_spread_mm: f64,
    /// Standard deviation of the noise in the middle of the body, HU.
    pub noise_hu: f64,
    /// Slices that are computed for each that is written.
    pub fine_slices: usize,
}
