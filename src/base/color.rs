//! Colour: linear RGB inside, 8-bit sRGB at the edge (IEC 61966-2-1).

/// Exponent of the power law `linear^(1 / 2.2)`, in which pictures are compared: it is close to sRGB, and a gain is a gain
/// in it however dark a place is.
pub const POWER_LAW: f32 = 2.2;

/// Linear value up to which the sRGB transfer curve is a line.
pub const SRGB_LINEAR_BELOW: f32 = 0.003_130_8;

/// sRGB transfer curve: linear value in [0, 1] to encoded value in [0, 1]; clamps, and maps NaN to 0.
pub fn srgb_from_linear(linear: f32) -> f32 {
    let v = if linear > 0.0 { linear.min(1.0) } else { 0.0 };
    if v <= SRGB_LINEAR_BELOW { 12.92 * v } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 }
}

/// Inverse of [`srgb_from_linear`] on [0, 1].
pub fn linear_from_srgb(encoded: f32) -> f32 {
    if encoded <= 0.040_45 { encoded / 12.92 } else { ((encoded + 0.055) / 1.055).powf(2.4) }
}

/// Linear value to the nearest 8-bit sRGB code.
pub fn srgb8_from_linear(linear: f32) -> u8 {
    (srgb_from_linear(linear) * 255.0 + 0.5) as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_code_survives_the_round_trip() {
        for code in 0..=255u8 {
            assert_eq!(srgb8_from_linear(linear_from_srgb(code as f32 / 255.0)), code);
        }
        assert_eq!(srgb8_from_linear(f32::NAN), 0);
    }
}
