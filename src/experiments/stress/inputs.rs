//! What the core must refuse in one sentence that names the element: numbers that are not finite where nothing can be
//! left out.

use glam::DVec3;

use super::row::StressRow;
use super::scenes::{view, wall};
use crate::base::{Camera, Result};
use crate::splat::{Direction, ImageGradient, Rasterizer, Settings, View, Wanted};

/// A change of the view and the settings, by name.
type Damage = (&'static str, fn(&mut Camera, &mut View, &mut Settings));

/// A row per bad input.
pub(super) fn refusals() -> Result<Vec<StressRow>> {
    let mut rows = Vec::new();
    let scene = wall(50, 0.5, 90);
    let damages: [Damage; 8] = [
        ("fl_x of 0", |c, _, _| c.fl_x = 0.0),
        ("NaN in fl_y", |c, _, _| c.fl_y = f64::NAN),
        ("inf in cx", |c, _, _| c.cx = f64::INFINITY),
        ("NaN in the pose", |_, v, _| v.camera_from_world.matrix3.x_axis = DVec3::NAN),
        ("inf in the pose", |_, v, _| v.camera_from_world.translation.z = f64::INFINITY),
        ("NaN in the gain", |_, _, s| s.gain[1] = f64::NAN),
        ("inf in the background", |_, _, s| s.background[2] = f64::INFINITY),
        ("near plane at 0", |_, _, s| s.near_mm = 0.0),
    ];
    for (name, damage) in damages {
        let (mut seen, mut settings) = (view(32, 24), Settings::default());
        let mut camera = seen.camera;
        damage(&mut camera, &mut seen, &mut settings);
        seen.camera = camera;
        let refused = Rasterizer::<f32>::new().render(&scene, &seen, &settings, None).is_err();
        rows.push(StressRow::of_claim(format!("{name} is refused"), refused));
    }
    let mut rasterizer = Rasterizer::<f32>::new();
    rasterizer.render(&scene, &view(32, 24), &Settings::default(), None)?;
    for poison in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let mut plane = vec![0.0; 32 * 24];
        plane[5 * 32 + 7] = poison;
        let color: Vec<f32> = plane.iter().flat_map(|&v| [0.0, v, 0.0]).collect();
        let none = ImageGradient::default();
        let gradients = [
            ("colour", ImageGradient { color: &color, ..none }),
            ("depth", ImageGradient { depth: &plane, ..none }),
            ("alpha", ImageGradient { alpha: &plane, ..none }),
        ];
        for (name, gradient) in gradients {
            let found = rasterizer.backward(&scene, &gradient, Wanted::ALL).err().map(|e| e.to_string());
            let named = found.is_some_and(|sentence| sentence.contains("pixel (7, 5)"));
            rows.push(StressRow::of_claim(format!("{poison} in the {name} gradient is refused by its pixel"), named));
        }
        let mut features = vec![0.5; 50 * 2];
        features[2 * 31 + 1] = poison;
        let found = rasterizer.render_channels(&features, 2).err().map(|e| e.to_string());
        let named = found.is_some_and(|sentence| sentence.contains("Gaussian 31, channel 1"));
        rows.push(StressRow::of_claim(format!("{poison} in a feature is refused by its Gaussian"), named));
        let directions = [Direction::Pose([0.0, 0.0, f64::from(poison), 0.0, 0.0, 0.0])];
        let refused =
            rasterizer.render_tangent(&scene, &view(32, 24), &Settings::default(), None, &directions).is_err();
        rows.push(StressRow::of_claim(format!("{poison} in a direction of the camera is refused"), refused));
        rasterizer.render(&scene, &view(32, 24), &Settings::default(), None)?;
    }
    Ok(rows)
}
