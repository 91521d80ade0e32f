//! Places and poses that are sound and most likely meant in another unit or frame: far from what everybody is given, and
//! near it once they are read otherwise.

use glam::{DAffine3, DMat3, DVec3};

use super::measured::pose_error;
use crate::base::statistics::upper_median;
use crate::formats::prediction::{POSES, TARGETS};

/// How far in mm an estimate may be from what is given, in the median, before another reading is tried: more than lung
/// tissue moves.
const FAR_MM: f64 = 80.0;
/// And the angle in degrees between its cameras and the given ones.
const FAR_DEG: f64 = 60.0;
/// How many times as near another reading must be.
const NEARER: f64 = 4.0;

/// Another way to read numbers: what it is called, and what it makes of them.
type Reading<T> = (&'static str, fn(T) -> T);

const OF_PLACES: [Reading<DVec3>; 4] = [
    ("in metres", |place| place * 1000.0),
    ("in centimetres", |place| place * 10.0),
    ("with x to the right and y to the front (RAS)", |place| DVec3::new(-place.x, -place.y, place.z)),
    ("with x and y exchanged", |place| DVec3::new(place.y, place.x, place.z)),
];

const OF_POSES: [Reading<DAffine3>; 5] = [
    ("in metres", |pose| DAffine3 { translation: pose.translation * 1000.0, ..pose }),
    ("in camera axes of OpenGL (y up, z backwards)", |pose| DAffine3 {
        matrix3: pose.matrix3 * DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0)),
        ..pose
    }),
    ("camera_from_world", |pose| pose.inverse()),
    ("in the axes of RAS (x to the right, y to the front)", |pose| {
        DAffine3::from_mat3(DMat3::from_diagonal(DVec3::new(-1.0, -1.0, 1.0))) * pose
    }),
    ("with a transposed rotation", |pose| DAffine3 { matrix3: pose.matrix3.transpose(), ..pose }),
];

/// What is said of targets, per frame and target, that are far from where they were `planned`.
pub(super) fn targets_warning(found: &[Vec<DVec3>], planned: &[DVec3]) -> Option<String> {
    let far = |read: fn(DVec3) -> DVec3| {
        let of_frame = |places: &Vec<DVec3>| -> Vec<f64> {
            places.iter().zip(planned).map(|(place, plan)| read(*place).distance(*plan)).collect()
        };
        upper_median(found.iter().flat_map(of_frame)).unwrap_or(0.0) / FAR_MM
    };
    let as_is = far(|place| place);
    let sentence = other_reading(as_is, OF_PLACES.map(|(name, read)| (name, far(read))))?;
    let away_mm = as_is * FAR_MM;
    Some(format!(
        "{TARGETS}: the median place is {away_mm:.0} mm from the planned one, {sentence}; mm in the film's frame (LPS) are \
         wanted"
    ))
}

/// What is said of poses that are far from the `given` ones.
pub(super) fn poses_warning(found: &[DAffine3], given: &[DAffine3]) -> Option<String> {
    let away = |read: fn(DAffine3) -> DAffine3| {
        let errors: Vec<[f64; 2]> = found.iter().zip(given).map(|(a, b)| pose_error(&read(*a), b)).collect();
        let median = |part: usize| upper_median(errors.iter().map(|error| error[part])).unwrap_or(0.0);
        (median(0), median(1))
    };
    let far = |(away_mm, angle_deg): (f64, f64)| away_mm / FAR_MM + angle_deg / FAR_DEG;
    let as_is = away(|pose| pose);
    let sentence = other_reading(far(as_is), OF_POSES.map(|(name, read)| (name, far(away(read)))))?;
    Some(format!(
        "{POSES}: the median pose is {:.0} mm and {:.0} degrees from the given one, {sentence}; world_from_camera in mm and \
         in camera axes of OpenCV is wanted",
        as_is.0, as_is.1
    ))
}

/// The reading that is much nearer than the numbers `as_is`, where these are far; distances as parts of what is far.
fn other_reading<const N: usize>(as_is: f64, others: [(&str, f64); N]) -> Option<String> {
    let (name, nearest) = others.into_iter().min_by(|a, b| a.1.total_cmp(&b.1))?;
    match as_is {
        near if near <= 1.0 => None,
        far if NEARER * nearest <= far => Some(format!("as if {name}")),
        far if far > NEARER => Some("as if of another film".to_owned()),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_in_other_units_or_axes_are_told_and_bad_estimates_are_not() {
        let planned = [DVec3::new(-60.0, -130.0, -240.0), DVec3::new(45.0, -160.0, -210.0)];
        let frame = |read: fn(DVec3) -> DVec3| vec![planned.map(|p| read(p + 12.0)).to_vec(); 3];
        assert_eq!(targets_warning(&frame(|place| place), &planned), None);
        assert_eq!(targets_warning(&frame(|place| place + DVec3::Z * 60.0), &planned), None, "a bad estimate");
        for (read, words) in [
            ((|p| p * 1e-3) as fn(DVec3) -> DVec3, "in metres"),
            (|p| p * 0.1, "in centimetres"),
            (|p| DVec3::new(-p.x, -p.y, p.z), "RAS"),
            (|p| DVec3::new(p.y, p.x, p.z), "exchanged"),
            (|p| p + 900.0, "of another film"),
        ] {
            let said = targets_warning(&frame(read), &planned).unwrap();
            assert!(said.contains(words) && said.starts_with("targets.csv: the median"), "{said}");
        }
    }

    #[test]
    fn poses_in_other_units_or_axes_are_told_and_bad_estimates_are_not() {
        let given: Vec<DAffine3> = (0..5)
            .map(|k| {
                let k = f64::from(k);
                let at = DVec3::new(-30.0 + k, -140.0, -180.0 - 9.0 * k);
                DAffine3::from_translation(at)
                    * DAffine3::from_rotation_x(1.8 + 0.05 * k)
                    * DAffine3::from_rotation_z(0.4 + 0.1 * k)
            })
            .collect();
        let said = |read: fn(DAffine3) -> DAffine3| {
            let found: Vec<DAffine3> = given.iter().map(|pose| read(*pose)).collect();
            poses_warning(&found, &given)
        };
        assert_eq!(said(|pose| pose), None);
        assert_eq!(
            said(|pose| DAffine3::from_translation(DVec3::X * 20.0) * pose * DAffine3::from_rotation_y(0.5)),
            None
        );
        for (name, read) in OF_POSES {
            // Each of these readings but metres undoes itself.
            let sentence = match name {
                "in metres" => said(|pose| DAffine3 { translation: pose.translation * 1e-3, ..pose }),
                _ => said(read),
            };
            assert!(sentence.as_ref().is_some_and(|s| s.contains(name)), "{name}: {sentence:?}");
        }
    }
}
