//! Gradients of a chunk of Gaussians from the moments of their splats: the plain twin of the loop in
//! `cpp/splat/chain.cpp`.

use crate::ffi::splat::rasterize::{Aligned, SplatCameraGradient};
use crate::splat::number::Real;
use crate::splat::types::table::DiscSums;
use crate::splat::types::{Footprint, GaussianSlices, Wanted};

use super::chain::{GaussianGradient, ellipsoid_gradient, gradients_of_splat};
use super::disc_chain::gradients_of_disc;
use super::fault::Faults;
use super::projector::Projector;

/// The output of the tiles' backward pass for a chunk of splats.
#[derive(Clone, Copy)]
pub struct ChunkMoments<'a, T> {
    /// Slots of splat `k` of the chunk: `starts[k]..starts[k + 1]`.
    pub starts: &'a [u32],
    /// Moments of all slots, with `Footprint::Ewa`.
    pub moments: &'a [Aligned<T>],
    /// Of each of these, whether its numbers are of this pass; those of the others count as 0.
    pub live: &'a [bool],
    /// Sums of all slots, with `Footprint::Disc`.
    pub disc_sums: &'a [DiscSums<T>],
}

/// A chunk of Gaussians and the output slices of their gradients (empty where not wanted).
pub struct GradientChunk<'a, T> {
    /// Number of its first one among the active, and how many they are.
    pub first: usize,
    pub count: usize,
    /// Whether any of them is visible.
    pub visible: bool,
    pub positions: &'a mut [[T; 3]],
    pub rotations: &'a mut [[T; 4]],
    pub scales: &'a mut [[T; 3]],
    pub axes: &'a mut [[[T; 3]; 2]],
    pub opacities: &'a mut [T],
    pub sh: &'a mut [T],
    /// Per [`GROUP`](crate::splat::types::GROUP) Gaussians, whether any of these tables may differ from 0 now.
    pub written: &'a [bool],
    /// Whether any may afterwards; `false` when it comes.
    pub heard: &'a mut [bool],
}

impl<T: Real> GradientChunk<'_, T> {
    /// Sets all gradients to 0: those of Gaussians that are not visible.
    pub fn clear(&mut self) {
        let zero = T::zero();
        self.positions.as_flattened_mut().fill(zero);
        self.rotations.as_flattened_mut().fill(zero);
        self.scales.as_flattened_mut().fill(zero);
        self.axes.as_flattened_mut().as_flattened_mut().fill(zero);
        self.opacities.fill(zero);
        self.sh.fill(zero);
    }

    /// Writes the gradients and returns those of the camera.
    pub fn fill(
        &mut self,
        projector: &Projector<T>,
        gaussians: &GaussianSlices<'_, T>,
        active: Option<&[u32]>,
        from: &ChunkMoments<'_, T>,
        wanted: Wanted,
        faults: impl Faults,
    ) -> SplatCameraGradient {
        self.heard.fill(true);
        let stride = gaussians.sh_stride();
        let mut camera = SplatCameraGradient::default();
        for k in 0..self.count {
            let i = active.map_or(self.first + k, |list| list[self.first + k] as usize);
            let slots = from.starts[k] as usize..from.starts[k + 1] as usize;
            let by_sh = self.sh.get_mut(k * stride..(k + 1) * stride).unwrap_or_default();
            let found = match projector.footprint {
                Footprint::Disc => added(slots.map(|slot| &from.disc_sums[slot]))
                    .and_then(|m| gradients_of_disc(projector, gaussians, i, &m, wanted, by_sh, faults)),
                Footprint::Ewa => added(slots.filter(|&slot| from.live[slot]).map(|slot| &from.moments[slot].0))
                    .and_then(|m| gradients_of_splat(projector, gaussians, i, &m, wanted, by_sh, faults)),
            };
            if let Some(found) = found.as_ref().filter(|_| wanted.any(Wanted::POSE | Wanted::LENS)) {
                let sums = camera.pose.iter_mut().chain(&mut camera.intrinsics);
                let parts = found.pose.iter().chain(&found.lens);
                sums.zip(parts).for_each(|(sum, part)| *sum += part.to_f64());
            }
            self.write(k, i, found.as_ref(), gaussians, faults);
            // The coefficients of a visible splat have been written already.
            if wanted.any(Wanted::SH) && found.is_none() {
                self.sh[k * stride..(k + 1) * stride].fill(T::zero());
            }
        }
        camera
    }

    /// Writes the gradients of number `k` of the chunk, which is Gaussian `i`; zeros where there are none.
    fn write(
        &mut self,
        k: usize,
        i: usize,
        found: Option<&GaussianGradient<T>>,
        gaussians: &GaussianSlices<'_, T>,
        faults: impl Faults,
    ) {
        let zero = [T::zero(); 3];
        if let Some(place) = self.positions.get_mut(k) {
            *place = found.map_or(zero, |found| found.position);
        }
        if let Some(place) = self.axes.get_mut(k) {
            *place = found.map_or([zero; 2], |found| [found.columns[0], found.columns[1]]);
        }
        if let (Some(rotation), Some(scale)) = (self.rotations.get_mut(k), self.scales.get_mut(k)) {
            let both = found.map(|found| ellipsoid_gradient(gaussians.shape, i, &found.columns, faults));
            let finite = |both: &([T; 4], [T; 3])| both.0.iter().chain(&both.1).all(|v| v.is_finite());
            (*rotation, *scale) = both.filter(finite).unwrap_or(([T::zero(); 4], zero));
        }
        if let Some(place) = self.opacities.get_mut(k) {
            *place = found.map_or(T::zero(), |found| found.opacity);
        }
    }
}

/// Sum of the moments of one splat over its tiles; `None` when it has none.
fn added<'s, T: Real, const N: usize>(slots: impl Iterator<Item = &'s [T; N]>) -> Option<[T; N]> {
    let mut total: Option<[T; N]> = None;
    for slot in slots {
        match &mut total {
            None => total = Some(*slot),
            Some(sum) => sum.iter_mut().zip(slot).for_each(|(sum, part)| *sum += *part),
        }
    }
    total
}
