//! Poses as files hold them: a rotation and a translation, or an error.

use glam::{DAffine3, DMat3, DMat4, DVec4};

use super::error::{Error, Result};
use super::range::NumberRange;

/// Largest entry of `M^T M - 1` for the matrix M of a pose in a file: files round to a thousandth.
const ROTATION_SLACK: f64 = 2e-3;
/// Largest difference of the last row of a 4x4 matrix from 0 0 0 1.
const LAST_ROW_SLACK: f64 = 1e-9;
/// Error of a rotation in double precision; below it there is nothing to put right.
const EXACT: f64 = 1e-12;
/// Newton steps from a matrix that [`check`] accepts: the error of 2e-3 is squared in each.
const NEWTON_STEPS: usize = 4;

/// How far the matrix of `pose` is from a rotation: the largest entry of `M^T M - 1`; infinite where it mirrors or is
/// not finite.
pub fn rotation_error(pose: &DAffine3) -> f64 {
    let m = pose.matrix3;
    if !m.is_finite() || m.determinant() <= 0.0 {
        return f64::INFINITY;
    }
    (m.transpose() * m - DMat3::IDENTITY).to_cols_array().iter().fold(0.0, |most: f64, v| most.max(v.abs()))
}

/// Refuses a pose of a file that scales, shears, mirrors or is singular, or whose place is not in `places` along each
/// axis.
pub fn check(pose: &DAffine3, places: NumberRange) -> Result<()> {
    if rotation_error(pose) > ROTATION_SLACK {
        return Err(Error::input("is no rotation and translation (it scales, shears, mirrors or is singular)"));
    }
    let place = pose.translation.to_array();
    place.iter().try_for_each(|&v| places.check(v).map_err(|e| Error::input(format!("lies too far away: {e}"))))
}

/// The pose of a file that [`check`] accepts with the rotation next to its matrix: the orthogonal factor of the polar
/// decomposition, by Newton steps `M <- (M + M^-T) / 2` (Higham 1986). An exact one stays as it is.
pub fn rigid(pose: &DAffine3) -> DAffine3 {
    if rotation_error(pose) < EXACT {
        return *pose;
    }
    let step = |m: DMat3, _| (m + m.inverse().transpose()) * 0.5;
    DAffine3 { matrix3: (0..NEWTON_STEPS).fold(pose.matrix3, step), ..*pose }
}

/// The pose in the rows of a 4x4 matrix. Errors: as [`check`], and a last row that is not 0 0 0 1.
pub fn from_rows(rows: &[[f64; 4]; 4], places: NumberRange) -> Result<DAffine3> {
    let matrix = DMat4::from_cols_array_2d(rows).transpose();
    let off = matrix.row(3) - DVec4::W;
    if !off.is_finite() || off.abs().max_element() > LAST_ROW_SLACK {
        return Err(Error::input("has another last row than 0 0 0 1"));
    }
    let pose = DAffine3::from_mat4(matrix);
    check(&pose, places)?;
    Ok(pose)
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::base::range::COORDINATE_MM;

    #[test]
    fn rotations_with_a_place_are_poses_and_nothing_else_is() {
        let turn = DMat3::from_rotation_z(0.3) * DMat3::from_rotation_x(-1.2);
        let pose = DAffine3::from_mat3_translation(turn, DVec3::new(4.0, -5.0, 6.0));
        let rows = |matrix: DMat4| matrix.transpose().to_cols_array_2d();
        let read = |matrix: DMat4| from_rows(&rows(matrix), COORDINATE_MM);
        assert_eq!(read(DMat4::from(pose)).unwrap(), pose);
        assert!(rotation_error(&pose) < 1e-15);
        let scaled = |by: f64| DMat4::from(pose) * DMat4::from_scale(DVec3::splat(by));
        assert!(read(scaled(1.0004)).is_ok(), "as a file rounds it");
        assert!(rigid(&read(scaled(1.0004)).unwrap()).abs_diff_eq(pose, 1e-12));
        assert_eq!(rigid(&pose), pose);
        assert!(read(scaled(f64::NAN)).is_err());
        for wrong in [1.01, 0.0, -1.0, 1e200] {
            assert!(read(scaled(wrong)).unwrap_err().to_string().contains("no rotation"), "{wrong}");
        }
        let far = DAffine3::from_mat3_translation(turn, DVec3::new(0.0, 1e300, 0.0));
        let said = read(DMat4::from(far)).unwrap_err().to_string();
        assert_eq!(said, "lies too far away: 1e300 must lie in -10000 to 10000");
        // Columns where rows are wanted: the translation stands below.
        assert!(
            from_rows(&DMat4::from(pose).to_cols_array_2d(), COORDINATE_MM)
                .unwrap_err()
                .to_string()
                .contains("0 0 0 1")
        );
        let mut unfinished = rows(DMat4::from(pose));
        unfinished[3][3] = f64::NAN;
        assert!(from_rows(&unfinished, COORDINATE_MM).is_err());
    }
}
