//! The vectorised compositing kernels of the rasteriser: C++ (`cpp/splat/kernel.cpp`), compiled once per instruction
//! set and chosen at run time, through cxx.

use std::marker::PhantomData;

use crate::ffi::isa::Isa;

#[cxx::bridge(namespace = "respire")]
#[allow(missing_docs, unused_qualifications)]
mod bridge {
    /// Gaussians as they lie in memory; see `Scene` of `cpp/splat/kernel.h`.
    struct SplatScene<'a> {
        view: &'a [f32],
        positions: &'a [f32],
        shape: &'a [f32],
        scales: &'a [f32],
        opacities: &'a [f32],
        sh: &'a [f32],
        sh_degree: u32,
        active: &'a [u32],
        all: bool,
        exact: &'a [f64],
    }

    /// Velocities of all Gaussians, or of the camera.
    struct SplatMotion<'a> {
        positions: &'a [f32],
        shape: &'a [f32],
        colors: &'a [f32],
        pose: &'a [f32],
    }

    /// The exact discs of one tile; see `DiscTile` of `cpp/splat/kernel.h`.
    struct SplatDiscs<'a> {
        rows: &'a [f32],
        discs: &'a [f32],
        entries: &'a [u32],
        x: u32,
        y: u32,
        width: u32,
        height: u32,
        blocks: u16,
        rays: &'a [f32],
        pinhole: bool,
        per_px: [f32; 2],
        near: f32,
        filter: f32,
    }

    unsafe extern "C++" {
        include!("cpp/splat/rasterize.h");
        fn splat_project(
            isa: u8,
            scene: &SplatScene,
            first: usize,
            tiles_x: u32,
            tiles_y: u32,
            side: u32,
            rows: &mut [f32],
            boxes: &mut [u32],
            keys: &mut [u32],
            visible: &mut [bool],
            motion: &SplatMotion,
            velocities: &mut [f32],
        ) -> Result<()>;
        fn splat_recolor(isa: u8, scene: &SplatScene, first: usize, visible: &[bool], rows: &mut [f32])
        -> Result<bool>;
        fn splat_velocities(
            isa: u8,
            scene: &SplatScene,
            first: usize,
            visible: &[bool],
            motion: &SplatMotion,
            rows: &mut [f32],
        ) -> Result<()>;
        fn splat_chain(
            isa: u8,
            scene: &SplatScene,
            first: usize,
            starts: &[u32],
            slots: &[f32],
            wanted: u32,
            positions: &mut [f32],
            shape: &mut [f32],
            scales: &mut [f32],
            opacities: &mut [f32],
            sh: &mut [f32],
            camera: &mut [f64],
        ) -> Result<()>;
        fn splat_forward(
            isa: u8,
            rows: &[f32],
            entries: &[u32],
            masks: &mut [u16],
            x: f32,
            y: f32,
            blocks: u16,
            state: &mut [f32],
            parts: u32,
            velocities: &[f32],
            moving: &mut [f32],
        ) -> Result<()>;
        fn splat_disc_forward(isa: u8, discs: &SplatDiscs, with_depth: bool, state: &mut [f32]) -> Result<()>;
        fn splat_disc_backward(
            isa: u8,
            discs: &SplatDiscs,
            adjoint: &[f32],
            parts: u32,
            sums: &mut [f32],
        ) -> Result<()>;
        unsafe fn splat_backward(
            isa: u8,
            rows: &[f32],
            entries: &[u32],
            masks: &[u16],
            targets: &[u32],
            x: f32,
            y: f32,
            adjoint: &[f32],
            slots: *mut f32,
            slot_count: usize,
            parts: u32,
        ) -> Result<()>;
    }
}

pub use bridge::{SplatDiscs, SplatMotion, SplatScene};

/// Sixteen numbers that begin at a cache line.
#[repr(C, align(64))]
#[derive(Clone, Copy, Debug, Default)]
pub struct Aligned<T>(pub [T; 16]);

impl<T> AsRef<[T; 16]> for Aligned<T> {
    fn as_ref(&self) -> &[T; 16] {
        &self.0
    }
}

fn flat(rows: &[Aligned<f32>]) -> &[f32] {
    // SAFETY: `Aligned<f32>` is 64 bytes without padding, exactly its 16 floats.
    unsafe { std::slice::from_raw_parts(rows.as_ptr().cast(), rows.len() * 16) }
}

fn flat_mut(rows: &mut [Aligned<f32>]) -> &mut [f32] {
    // SAFETY: as in `flat`; the borrow is exclusive.
    unsafe { std::slice::from_raw_parts_mut(rows.as_mut_ptr().cast(), rows.len() * 16) }
}

/// What the caller never breaks: it is a defect of this crate, never of the input.
const AGREE: &str = "the rasteriser hands over tables that belong together";

/// Splats of the Gaussians number `first..first + visible.len()` of the active ones; see `cpp/splat/kernel.h` for the
/// tables; the image has so many tiles (columns, rows) of so many pixels a side. Where `velocities` has room (8 numbers each), those of the
/// visible splats along `motion`, too. Panics (as all of these) when the tables do not belong together.
pub fn project(
    isa: Isa,
    scene: &SplatScene<'_>,
    first: usize,
    (tiles, side): ([usize; 2], usize),
    rows: &mut [Aligned<f32>],
    boxes: &mut [[u32; 2]],
    keys: &mut [u32],
    visible: &mut [bool],
    motion: &SplatMotion<'_>,
    velocities: &mut [[f32; 8]],
) {
    let (x, y, side) = (tiles[0] as u32, tiles[1] as u32, side as u32);
    bridge::splat_project(
        isa.code(),
        scene,
        first,
        x,
        y,
        side,
        flat_mut(rows),
        boxes.as_flattened_mut(),
        keys,
        visible,
        motion,
        velocities.as_flattened_mut(),
    )
    .expect(AGREE);
}

/// Writes the colours of the visible splats into their rows; `false` when one is not finite.
pub fn recolor(isa: Isa, scene: &SplatScene<'_>, first: usize, visible: &[bool], rows: &mut [Aligned<f32>]) -> bool {
    bridge::splat_recolor(isa.code(), scene, first, visible, flat_mut(rows)).expect(AGREE)
}

/// Velocities of the visible splats along a motion, 8 numbers each.
pub fn velocities(
    isa: Isa,
    scene: &SplatScene<'_>,
    first: usize,
    visible: &[bool],
    motion: &SplatMotion<'_>,
    rows: &mut [[f32; 8]],
) {
    bridge::splat_velocities(isa.code(), scene, first, visible, motion, rows.as_flattened_mut()).expect(AGREE);
}

/// Where the gradients of a chunk go; empty where not wanted.
pub struct ChainOutput<'a, T> {
    /// 3 each.
    pub positions: &'a mut [T],
    /// 6 each for discs, 4 for ellipsoids.
    pub shape: &'a mut [T],
    /// 3 each for ellipsoids.
    pub scales: &'a mut [T],
    /// 1 each.
    pub opacities: &'a mut [T],
    /// As in the scene.
    pub sh: &'a mut [T],
    /// Sums over the chunk: six of the pose, four of the intrinsics (0 where not wanted).
    pub camera: &'a mut [f64; 10],
}

/// Gradients of the Gaussians number `first..` from their moments: those of number `first + k` are the sum over
/// `slots[starts[k]..starts[k + 1]]`.
pub fn chain(
    isa: Isa,
    scene: &SplatScene<'_>,
    first: usize,
    starts: &[u32],
    slots: &[Aligned<f32>],
    wanted: u32,
    out: ChainOutput<'_, f32>,
) {
    bridge::splat_chain(
        isa.code(),
        scene,
        first,
        starts,
        flat(slots),
        wanted,
        out.positions,
        out.shape,
        out.scales,
        out.opacities,
        out.sh,
        out.camera,
    )
    .expect(AGREE);
}

/// Composites the `blocks` of one tile, with the velocities of its pixels along up to four directions; see `cpp/splat/kernel.h`.
pub fn forward(
    isa: Isa,
    rows: &[Aligned<f32>],
    entries: &[u32],
    masks: &mut [u16],
    corner: [f32; 2],
    blocks: u16,
    state: &mut [f32],
    parts: u32,
    velocities: &[[f32; 8]],
    moving: &mut [f32],
) {
    let [x, y] = corner;
    let velocities = velocities.as_flattened();
    bridge::splat_forward(isa.code(), flat(rows), entries, masks, x, y, blocks, state, parts, velocities, moving)
        .expect(AGREE);
}

/// Sixteen numbers a row, one row after the other.
pub fn columns(rows: &[Aligned<f32>]) -> &[f32] {
    flat(rows)
}

/// Composites one tile of exact discs into `state`.
pub fn disc_forward(isa: Isa, discs: &SplatDiscs<'_>, with_depth: bool, state: &mut [f32]) {
    bridge::splat_disc_forward(isa.code(), discs, with_depth, state).expect(AGREE);
}

/// Backward of [`disc_forward`]: the sums of each entry.
pub fn disc_backward(isa: Isa, discs: &SplatDiscs<'_>, adjoint: &[f32], parts: u32, sums: &mut [f32]) {
    bridge::splat_disc_backward(isa.code(), discs, adjoint, parts, sums).expect(AGREE);
}

/// Slots that several tiles write at the same time, each its own: the entries' targets are all different
/// (`super::bin`, tested there against the plain twin).
pub struct Slots<'a> {
    start: *mut f32,
    count: usize,
    owner: PhantomData<&'a mut [Aligned<f32>]>,
}

// SAFETY: the slots are plain numbers that nobody else can reach while the exclusive borrow lasts, and threads that share
// a `Slots` write different ones.
unsafe impl Sync for Slots<'_> {}

impl<'a> Slots<'a> {
    /// All of `slots`, to be shared among tiles.
    pub fn new(slots: &'a mut [Aligned<f32>]) -> Self {
        Slots { start: slots.as_mut_ptr().cast(), count: slots.len(), owner: PhantomData }
    }
}

/// One tile whose image gradient goes to the slots of its entries.
pub struct Backward<'a> {
    /// All splats.
    pub rows: &'a [Aligned<f32>],
    /// Those of the tile, front to back.
    pub entries: &'a [u32],
    /// Blocks of each.
    pub masks: &'a [u16],
    /// Slot of each.
    pub targets: &'a [u32],
    /// Upper left corner in pixels.
    pub corner: [f32; 2],
    /// See `cpp/splat/kernel.h`.
    pub adjoint: &'a [f32],
}

/// Backward of [`forward`].
pub fn backward(isa: Isa, tile: &Backward<'_>, slots: &Slots<'_>, parts: u32) {
    let [x, y] = tile.corner;
    // SAFETY: C++ checks that every target lies within the slots, which are borrowed exclusively as long as `slots` lives;
    // tiles that run at the same time have different targets.
    unsafe {
        bridge::splat_backward(
            isa.code(),
            flat(tile.rows),
            tile.entries,
            tile.masks,
            tile.targets,
            x,
            y,
            tile.adjoint,
            slots.start,
            slots.count,
            parts,
        )
    }
    .expect(AGREE);
}
