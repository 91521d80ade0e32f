//! Forward-mode derivative of the images along a motion of the mesh, dI/dphase: the whole chain (anchors, projection,
//! compositing) run in dual numbers, with the decisions of the plain render. For Gauss-Newton on one scalar.

use crate::base::{Error, Result};

use super::anchors::{Anchors, Carrier};
use super::dual::Dual;
use super::rasterizer::Rasterizer;
use super::real::Real;
use super::types::{Gaussians, Rendered, Settings, View};

/// Renders images together with their derivatives; keep it and use it again.
#[derive(Debug, Default)]
pub struct PhaseTangent<T: Real> {
    rasterizer: Rasterizer<Dual<T>>,
}

impl<T: Real> PhaseTangent<T> {
    /// A new one.
    pub fn new() -> Self {
        PhaseTangent { rasterizer: Rasterizer::new() }
    }

    /// Images of the discs of `anchors` on `carrier` (colours and opacities from `gaussians`), each value with its
    /// derivative for a mesh that moves by `displacement` per unit of phase.
    ///
    /// Errors: as [`Rasterizer::render`] and [`Anchors::place`].
    pub fn render(
        &mut self,
        anchors: &Anchors<T>,
        gaussians: &Gaussians<T>,
        carrier: Carrier<'_, T>,
        displacement: &[[T; 3]],
        view: &View,
        settings: &Settings,
        active: Option<&[u32]>,
    ) -> Result<&Rendered<Dual<T>>> {
        if displacement.len() != carrier.vertices.len() {
            return Err(Error::input("one displacement per vertex is needed"));
        }
        let moving: Vec<[Dual<T>; 3]> =
            carrier.vertices.iter().zip(displacement).map(|(v, d)| [0, 1, 2].map(|k| Dual::new(v[k], d[k]))).collect();
        let mut discs = gaussians.cast::<Dual<T>>();
        let carrier = Carrier { vertices: &moving, faces: carrier.faces };
        anchors.cast::<Dual<T>>().place(carrier, active, &mut discs)?;
        self.rasterizer.render(&discs, view, settings, active)
    }
}
