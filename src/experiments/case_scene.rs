//! A case's airway as a scene of the path tracer, and cameras on the scope's route: what the experiments with the path
//! tracer render.

use glam::{DAffine3, DVec3};

use crate::airway::Anatomy;
use crate::airway::case::Case;
use crate::base::{Camera, Image, Result, mesh};
use crate::render::{Light, RenderSettings, Scene, render};
use crate::simulate::trajectory::Route;
use crate::simulate::{material, scope_light};

/// The breathing airway of a case.
pub struct CaseScene {
    /// The scene at the phase that was set last.
    pub scene: Scene,
    ends: [Vec<DVec3>; 2],
}

impl CaseScene {
    /// At full inspiration.
    pub fn new(case: &Case, anatomy: &Anatomy) -> Result<CaseScene> {
        let [rest, other] = [&anatomy.inspiration, &anatomy.expiration];
        let mut scene = Scene::new(rest, &anatomy.vertex_generation, material(case)?, case.seed)?;
        scene.set_other_end(&other.vertices)?;
        Ok(CaseScene { scene, ends: [rest.vertices.clone(), other.vertices.clone()] })
    }

    /// Deforms the airway to a breathing phase, 0 inspiration to 1 expiration.
    pub fn set_phase(&mut self, phase: f64) -> Result<()> {
        let [rest, other] = &self.ends;
        self.scene.deform(&mesh::interpolate(rest, other, phase))
    }
}

/// A camera on the route with its light.
pub struct Viewpoint {
    /// Square image.
    pub camera: Camera,
    /// World from camera.
    pub pose: DAffine3,
    /// At the camera, with the case's intensity.
    pub light: Light,
}

impl Viewpoint {
    /// `way_mm` from the start of `route` at a breathing phase, `width_px` wide and high.
    pub fn on_route(case: &Case, route: &Route, way_mm: f64, phase: f64, width_px: u32) -> Viewpoint {
        Viewpoint {
            camera: case.camera.camera(width_px, width_px),
            pose: route.pose(way_mm, phase),
            light: Light::at_camera(case.light_intensity),
        }
    }

    /// The same, lit as in the case's films.
    pub fn in_film(case: &Case, route: &Route, way_mm: f64, phase: f64, width_px: u32) -> Viewpoint {
        Viewpoint { light: scope_light(case), ..Viewpoint::on_route(case, route, way_mm, phase, width_px) }
    }

    /// The linear radiance of `scene` from here.
    pub fn radiance(&self, scene: &Scene, settings: &RenderSettings) -> Result<Image<f32>> {
        Ok(render(scene, &self.camera, &self.pose, &self.light, settings)?.radiance)
    }
}
