//! The last stage of the backward pass: from the moments of all splats to the gradients of the active Gaussians and the
//! camera, in chunks whose sums are added in their order.

use rayon::prelude::*;

use crate::ffi::splat::rasterize::SplatCameraGradient;
use crate::splat::kernels::{KernelScene, SplatKernels};
use crate::splat::plain::fault::Faults;
use crate::splat::plain::gradient_chunk::{ChunkMoments, GradientChunk};
use crate::splat::types::{GROUP, Gradients, ShapeSlices, Wanted};

use super::backward::Moments;
use super::pool::{CHUNK, cut, piece_of};

/// The gradients of the last pass.
#[derive(Debug, Default)]
pub struct GradientTables<T> {
    pub gradients: Gradients<T>,
    /// [`Gradients::heard`] of the pass before: where it says `false`, the tables are zero already.
    written: Vec<bool>,
    /// The layout of the gradients.
    layout: Option<GradientLayout>,
    /// Whether tables hold numbers of another pass.
    used: bool,
}

/// Number of Gaussians, numbers of SH each, whether they are discs, and the groups.
type GradientLayout = (usize, usize, bool, Wanted);

impl<T: SplatKernels> GradientTables<T> {
    /// Hands the gradients over; the next pass begins new tables.
    pub fn take(&mut self) -> Gradients<T> {
        (self.layout, self.used) = (None, false);
        std::mem::take(&mut self.gradients)
    }

    /// Takes tables back whose numbers nobody needs any more.
    pub fn give_back(&mut self, tables: Gradients<T>) {
        (self.layout, self.used) = (None, true);
        self.gradients = tables;
    }

    /// Gradients of the wanted groups from the moments in the slots; those of splat `k` begin at `starts[k]`.
    pub fn chain(
        &mut self,
        scene: &KernelScene<'_, T>,
        starts: &[u32],
        moments: &Moments<T>,
        wanted: Wanted,
        faults: impl Faults,
    ) {
        let (n, stride) = (scene.count(), scene.gaussians.sh_stride());
        let has_axes = matches!(scene.gaussians.shape, ShapeSlices::Discs { .. });
        self.lay_out((n, stride, has_axes, wanted));
        let of_gaussians = Wanted::POSITIONS | Wanted::SHAPES | Wanted::OPACITIES | Wanted::SH;
        if !wanted.any(of_gaussians | Wanted::POSE | Wanted::LENS) {
            return;
        }
        let tasks = self.tasks(n, starts);
        let piece = piece_of(tasks.len());
        let chain = |mut task: GradientChunk<'_, T>| -> SplatCameraGradient {
            if !task.visible {
                task.clear();
                return SplatCameraGradient::default();
            }
            let starts = &starts[task.first..=task.first + task.count];
            let from =
                ChunkMoments { starts, moments: &moments.splats, live: &moments.live, disc_sums: &moments.discs };
            T::chain(scene, &from, wanted, &mut task, faults)
        };
        let cameras: Vec<SplatCameraGradient> = tasks.into_par_iter().with_max_len(piece).map(chain).collect();
        let out = &mut self.gradients;
        for camera in cameras {
            let sums = out.pose.iter_mut().chain(&mut out.lens);
            sums.zip(camera.pose.iter().chain(&camera.intrinsics)).for_each(|(sum, part)| *sum += part);
        }
    }

    /// Room for the wanted groups, and none for the others.
    fn lay_out(&mut self, layout: GradientLayout) {
        let (n, stride, has_axes, wanted) = layout;
        let size = |group: Wanted| if wanted.any(group) { n } else { 0 };
        let out = &mut self.gradients;
        let zero = [T::zero(); 3];
        resize(&mut out.positions, size(Wanted::POSITIONS), zero);
        resize(&mut out.rotations, if has_axes { 0 } else { size(Wanted::SHAPES) }, [T::zero(); 4]);
        resize(&mut out.scales, if has_axes { 0 } else { size(Wanted::SHAPES) }, zero);
        resize(&mut out.axes, if has_axes { size(Wanted::SHAPES) } else { 0 }, [zero; 2]);
        resize(&mut out.opacities, size(Wanted::OPACITIES), T::zero());
        resize(&mut out.sh, size(Wanted::SH) * stride, T::zero());
        (out.pose, out.lens) = ([0.0; 6], [0.0; 4]);
        if self.layout != Some(layout) {
            // Without a layout the tables are new, and all 0, unless they have been used elsewhere.
            out.heard = vec![self.layout.is_some() || self.used; n.div_ceil(GROUP)];
            self.layout = Some(layout);
        }
        std::mem::swap(&mut self.written, &mut out.heard);
        out.heard.clear();
        out.heard.resize(n.div_ceil(GROUP), false);
    }

    /// The chunks with a visible splat, and those whose gradients are not zero yet.
    fn tasks(&mut self, n: usize, starts: &[u32]) -> Vec<GradientChunk<'_, T>> {
        let out = &mut self.gradients;
        let stride = out.sh.len().checked_div(n).unwrap_or_default();
        let lengths = |total: usize, per: usize| {
            (0..n).step_by(CHUNK).map(move |first| if total == 0 { 0 } else { per * CHUNK.min(n - first) })
        };
        let (positions, rotations, scales) = (out.positions.len(), out.rotations.len(), out.scales.len());
        let (axes, opacities, sh) = (out.axes.len(), out.opacities.len(), out.sh.len());
        let flags = self.written.chunks(CHUNK / GROUP).zip(out.heard.chunks_mut(CHUNK / GROUP));
        cut(&mut out.positions, lengths(positions, 1))
            .into_iter()
            .zip(cut(&mut out.rotations, lengths(rotations, 1)))
            .zip(cut(&mut out.scales, lengths(scales, 1)))
            .zip(cut(&mut out.axes, lengths(axes, 1)))
            .zip(cut(&mut out.opacities, lengths(opacities, 1)))
            .zip(cut(&mut out.sh, lengths(sh, stride)))
            .zip((0..n).step_by(CHUNK))
            .zip(flags)
            .map(|(((((((positions, rotations), scales), axes), opacities), sh), first), (written, heard))| {
                let count = CHUNK.min(n - first);
                let visible = starts[first] != starts[first + count];
                GradientChunk {
                    first,
                    count,
                    visible,
                    positions,
                    rotations,
                    scales,
                    axes,
                    opacities,
                    sh,
                    written,
                    heard,
                }
            })
            .filter(|task| task.visible || task.written.contains(&true))
            .collect()
    }
}

/// Resizes a table; a new one is asked for as zeros, which a large one then is without being written.
fn resize<V: Clone>(table: &mut Vec<V>, n: usize, zero: V) {
    if table.capacity() == 0 {
        *table = vec![zero; n];
    } else {
        table.resize(n, zero);
    }
}
