//! The last stage of the backward pass: from the moments of all splats to the gradients of the active Gaussians and the
//! camera, in chunks whose sums are added in their order.

use rayon::prelude::*;

use crate::ffi::splat::rasterize::ChainOutput;

use crate::splat::kernels::Numbers;
use crate::splat::number::real::Real;
use crate::splat::pass::bins::cut;
use crate::splat::pass::pool::piece_of;
use crate::splat::pass::rasterizer::{CHUNK, Rasterizer};
use crate::splat::plain::chain::{One, ellipsoid_gradient, gradients_of_one};
use crate::splat::plain::disc_chain::gradients_of_disc;
use crate::splat::plain::fault::Faults;
use crate::splat::plain::project::Projector;
use crate::splat::types::scene::{Footprint, Gaussians, Shape, Wanted};

impl<T: Real> Rasterizer<T> {
    /// Gradients of the wanted groups from the moments in the slots.
    pub(in crate::splat) fn chain(
        &mut self,
        gaussians: &Gaussians<T>,
        projector: &Projector<T>,
        wanted: Wanted,
        faults: impl Faults,
    ) {
        let n = self.rendered.visible.len();
        let stride = gaussians.sh_stride();
        let has_axes = matches!(gaussians.shape, Shape::Discs { .. });
        let size = |group: Wanted| if wanted.any(group) { n } else { 0 };
        let out = &mut self.gradients;
        let zero = [T::zero(); 3];
        out.positions.resize(size(Wanted::POSITIONS), zero);
        out.rotations.resize(if has_axes { 0 } else { size(Wanted::SHAPES) }, [T::zero(); 4]);
        out.scales.resize(if has_axes { 0 } else { size(Wanted::SHAPES) }, zero);
        out.axes.resize(if has_axes { size(Wanted::SHAPES) } else { 0 }, [zero; 2]);
        out.opacities.resize(size(Wanted::OPACITIES), T::zero());
        out.sh.resize(size(Wanted::SH) * stride, T::zero());
        (out.pose, out.lens) = ([0.0; 6], [0.0; 4]);
        let of_gaussians = Wanted::POSITIONS | Wanted::SHAPES | Wanted::OPACITIES | Wanted::SH;
        if !wanted.any(of_gaussians | Wanted::POSE | Wanted::LENS) {
            return;
        }
        let chunks = n.div_ceil(CHUNK);
        // A chunk that nobody sees and whose gradients are zero already costs nothing.
        let layout = (n, stride, has_axes, wanted);
        if self.written_layout != Some(layout) {
            self.written_layout = Some(layout);
            self.written = vec![true; chunks];
        }
        let lengths = |group: usize, per: usize| {
            (0..chunks).map(move |c| if group == 0 { 0 } else { per * (CHUNK.min(n - c * CHUNK)) })
        };
        let starts = &self.bins.starts;
        let shown = |first: usize, count: usize| starts[first] != starts[first + count];
        let written = &mut self.written;
        let tasks: Vec<Task<'_, T>> = cut(&mut out.positions, lengths(size(Wanted::POSITIONS), 1))
            .into_iter()
            .zip(cut(&mut out.rotations, lengths(if has_axes { 0 } else { size(Wanted::SHAPES) }, 1)))
            .zip(cut(&mut out.scales, lengths(if has_axes { 0 } else { size(Wanted::SHAPES) }, 1)))
            .zip(cut(&mut out.axes, lengths(if has_axes { size(Wanted::SHAPES) } else { 0 }, 1)))
            .zip(cut(&mut out.opacities, lengths(size(Wanted::OPACITIES), 1)))
            .zip(cut(&mut out.sh, lengths(size(Wanted::SH), stride)))
            .enumerate()
            .map(|(chunk, (((((positions, rotations), scales), axes), opacities), sh))| Task {
                first: chunk * CHUNK,
                count: CHUNK.min(n - chunk * CHUNK),
                seen: shown(chunk * CHUNK, CHUNK.min(n - chunk * CHUNK)),
                positions,
                rotations,
                scales,
                axes,
                opacities,
                sh,
            })
            .filter(|task| {
                let before = &mut written[task.first / CHUNK];
                std::mem::replace(before, task.seen) || task.seen
            })
            .collect();
        let active = self.active.as_deref();
        let mut numbers = Numbers::default();
        let native =
            if faults.is_sound() { T::native(self.isa, gaussians, projector, &mut numbers, active) } else { None };
        let (slots, sums) = (&self.slots, &self.disc_slots);
        let piece = piece_of(tasks.len());
        let discs = projector.footprint() == Footprint::Disc;
        let cameras: Vec<([f64; 6], [f64; 4])> = tasks
            .into_par_iter()
            .with_max_len(piece)
            .map(|mut task| {
                if !task.seen {
                    task.clear();
                    return ([0.0; 6], [0.0; 4]);
                }
                let starts = &starts[task.first..=task.first + task.count];
                if let Some(native) = &native {
                    let mut camera = [0.0; 10];
                    native.chain(task.first, starts, slots, wanted, task.outputs(&mut camera));
                    let (pose, lens) = camera.split_at(6);
                    return (std::array::from_fn(|k| pose[k]), std::array::from_fn(|k| lens[k]));
                }
                task.plain(active, gaussians, wanted, faults, |k, i, by_sh| {
                    let entries = starts[k] as usize..starts[k + 1] as usize;
                    if discs {
                        let m = added(entries.map(|e| &sums[e]))?;
                        return gradients_of_disc(projector, gaussians, i, &m, wanted, by_sh, faults);
                    }
                    let m = added(entries.map(|e| &slots[e].0))?;
                    gradients_of_one(projector, gaussians, i, &m, wanted, by_sh, faults)
                })
            })
            .collect();
        for (pose, lens) in cameras {
            self.gradients.pose.iter_mut().zip(pose).for_each(|(sum, part)| *sum += part);
            self.gradients.lens.iter_mut().zip(lens).for_each(|(sum, part)| *sum += part);
        }
    }
}

/// A chunk of Gaussians and the places their gradients go to (empty where not wanted).
struct Task<'a, T> {
    first: usize,
    count: usize,
    /// Whether any of them is visible.
    seen: bool,
    positions: &'a mut [[T; 3]],
    rotations: &'a mut [[T; 4]],
    scales: &'a mut [[T; 3]],
    axes: &'a mut [[[T; 3]; 2]],
    opacities: &'a mut [T],
    sh: &'a mut [T],
}

impl<T: Real> Task<'_, T> {
    /// Gradients of what nobody sees.
    fn clear(&mut self) {
        let zero = T::zero();
        self.positions.as_flattened_mut().fill(zero);
        self.rotations.as_flattened_mut().fill(zero);
        self.scales.as_flattened_mut().fill(zero);
        self.axes.as_flattened_mut().as_flattened_mut().fill(zero);
        self.opacities.fill(zero);
        self.sh.fill(zero);
    }

    fn outputs<'a>(&'a mut self, camera: &'a mut [f64; 10]) -> ChainOutput<'a, T> {
        let discs = self.axes.as_flattened_mut().as_flattened_mut();
        ChainOutput {
            positions: self.positions.as_flattened_mut(),
            shape: if discs.is_empty() { self.rotations.as_flattened_mut() } else { discs },
            scales: self.scales.as_flattened_mut(),
            opacities: self.opacities,
            sh: self.sh,
            camera,
        }
    }

    /// The plain twin of the vectorised chain (`gradients`: number within the chunk, number of the Gaussian, place for
    /// the SH); returns the gradients of pose and intrinsics.
    fn plain(
        &mut self,
        active: Option<&[u32]>,
        gaussians: &Gaussians<T>,
        wanted: Wanted,
        faults: impl Faults,
        gradients: impl Fn(usize, usize, &mut [T]) -> Option<One<T>>,
    ) -> ([f64; 6], [f64; 4]) {
        let stride = gaussians.sh_stride();
        let (mut pose, mut lens) = ([0.0; 6], [0.0; 4]);
        for k in 0..self.count {
            let i = active.map_or(self.first + k, |list| list[self.first + k] as usize);
            let by_sh = self.sh.get_mut(k * stride..(k + 1) * stride).unwrap_or_default();
            let one = gradients(k, i, by_sh);
            if let Some(one) = one.as_ref().filter(|_| wanted.any(Wanted::POSE | Wanted::LENS)) {
                pose.iter_mut().zip(one.pose).for_each(|(sum, part)| *sum += part.to_f64());
                lens.iter_mut().zip(one.lens).for_each(|(sum, part)| *sum += part.to_f64());
            }
            self.write(k, i, one.as_ref(), gaussians, stride, wanted, faults);
        }
        (pose, lens)
    }

    fn write(
        &mut self,
        k: usize,
        i: usize,
        one: Option<&One<T>>,
        gaussians: &Gaussians<T>,
        stride: usize,
        wanted: Wanted,
        faults: impl Faults,
    ) {
        let zero = [T::zero(); 3];
        if let Some(place) = self.positions.get_mut(k) {
            *place = one.map_or(zero, |one| one.position);
        }
        if let Some(place) = self.axes.get_mut(k) {
            *place = one.map_or([zero; 2], |one| [one.columns[0], one.columns[1]]);
        }
        if let (Some(rotation), Some(scale)) = (self.rotations.get_mut(k), self.scales.get_mut(k)) {
            let found = one.map(|one| ellipsoid_gradient(&gaussians.shape, i, &one.columns, faults));
            let finite = |found: &([T; 4], [T; 3])| found.0.iter().chain(&found.1).all(|v| v.is_finite());
            (*rotation, *scale) = found.filter(finite).unwrap_or(([T::zero(); 4], zero));
        }
        if let Some(place) = self.opacities.get_mut(k) {
            *place = one.map_or(T::zero(), |one| one.opacity);
        }
        // The coefficients of a splat that is seen were written in passing.
        if wanted.any(Wanted::SH) && one.is_none() {
            self.sh[k * stride..(k + 1) * stride].fill(T::zero());
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
