//! Projection, compositing, exact discs and the chain to the Gaussians, vectorised: C++ through cxx
//! (`cpp/splat/rasterize.cpp`), which calls the kernels of one instruction set, chosen at run time:
//!
//! | here | kernel |
//! |---|---|
//! | [`project`], [`recolor`], [`velocities`] | `cpp/splat/project.cpp` |
//! | `forward`, `backward` | `cpp/splat/kernel.cpp` |
//! | [`disc_forward`], [`disc_backward`] | `cpp/splat/disc.cpp` |
//! | [`chain`] | `cpp/splat/chain.cpp` |
//!
//! All functions panic if tables do not fit together: that is a defect of this crate, never of the input.

use std::marker::PhantomData;

use cxx::{ExternType, kind, type_id};

use crate::ffi::isa::Isa;

#[cxx::bridge(namespace = "respire")]
#[allow(missing_docs, unused_qualifications)]
mod bridge {
    /// A camera in single precision, from which `View` of `cpp/splat/kernel.h` is filled.
    #[derive(Clone, Debug, Default)]
    struct SplatCamera {
        /// From world to camera axes, row by row.
        rotation: [f32; 9],
        /// Centre of projection in the world (mm).
        eye: [f32; 3],
        /// Focal lengths (pixels).
        focal: [f32; 2],
        /// Principal point (pixels).
        center: [f32; 2],
        /// Least `x / z` and `y / z` at which the Jacobian of a pinhole is evaluated.
        low: [f32; 2],
        /// Largest ones.
        high: [f32; 2],
        /// Width and height of the image (pixels).
        size: [f32; 2],
        /// Smallest z-depth of a visible centre (mm).
        near: f32,
        /// Variance that the screen-space filter adds (px^2).
        dilation: f32,
        /// Whether a splat's extent depends on its opacity.
        extent_by_opacity: bool,
        /// Whether groups beside the image are skipped before their covariance is known.
        skip_beside: bool,
        /// Whether opacities are multiplied by `sqrt(det / det dilated)`.
        compensate: bool,
        /// A fisheye (OpenCV's model), or else a pinhole.
        fisheye: bool,
        /// Distortion `k1` to `k4` of a fisheye.
        distortion: [f32; 4],
        /// Cosine of the half angle of the cone around a fisheye's field of view; 0 for none.
        cone_cosine: f32,
        /// Sine of that half angle.
        cone_sine: f32,
        /// How far beyond the cone splats reach, per standard deviation times 3.34.
        cone_reach: f32,
    }

    /// The same camera in double precision, for centres that are rounded once.
    #[derive(Clone, Debug, Default)]
    struct SplatExactCamera {
        rotation: [f64; 9],
        eye: [f64; 3],
        focal: [f64; 2],
        center: [f64; 2],
        /// All 0 for a pinhole.
        distortion: [f64; 4],
    }

    /// The arrays of the Gaussians, and the camera.
    struct SplatScene<'a> {
        camera: SplatCamera,
        exact_camera: SplatExactCamera,
        /// 3 numbers a Gaussian.
        positions: &'a [f32],
        /// 6 numbers (two axes) a disc, 4 (a quaternion) an ellipsoid.
        shape: &'a [f32],
        /// 3 numbers an ellipsoid; empty for discs.
        scales: &'a [f32],
        opacities: &'a [f32],
        /// Coefficients of the colours: `3 (sh_degree + 1)^2` a Gaussian.
        sh: &'a [f32],
        sh_degree: u32,
        /// The Gaussians that take part, unless `all` do.
        active: &'a [u32],
        all: bool,
    }

    /// Velocities of all Gaussians (empty if the quantity does not move), or of the camera.
    struct SplatMotion<'a> {
        positions: &'a [f32],
        /// 6 numbers a disc, 9 an ellipsoid: the columns of the square root of its covariance.
        shape: &'a [f32],
        colors: &'a [f32],
        /// Rotation and translation of the camera, 6 numbers; empty where the Gaussians move.
        pose: &'a [f32],
    }

    /// Where the splats of a chunk of Gaussians go, as many as `visible` has room for.
    struct SplatChunk<'a> {
        /// Number of the first among the active Gaussians.
        first: usize,
        /// Columns as in `cpp/splat/kernel.h`; written where visible, as the next two are.
        rows: &'a mut [AlignedRow],
        /// Tiles that the splat meets: `x0 | y0 << 16` and `x1 | y1 << 16`, inclusive.
        boxes: &'a mut [[u32; 2]],
        /// Sort keys: the bits of the z-depth.
        keys: &'a mut [u32],
        visible: &'a mut [bool],
        /// Velocities of the visible splats along a motion; empty where none are wanted.
        velocities: &'a mut [[f32; 8]],
    }

    /// Moments of the splats of a chunk of Gaussians.
    struct SplatMoments<'a> {
        /// Number of the first among the active Gaussians.
        first: usize,
        /// The moments of number `first + k` are the sum over `slots[starts[k]..starts[k + 1]]`.
        starts: &'a [u32],
        slots: &'a [AlignedRow],
        /// Of each slot, whether its moments are of this pass; those of the others are 0.
        live: &'a [bool],
        /// Bits of `ParameterGroup` (`cpp/splat/kernel.h`).
        wanted: u32,
    }

    /// Where the gradients of a chunk of Gaussians go; see [`super::ChainOutput`].
    struct SplatGradients<'a> {
        positions: &'a mut [f32],
        shape: &'a mut [f32],
        scales: &'a mut [f32],
        opacities: &'a mut [f32],
        sh: &'a mut [f32],
        written: &'a [bool],
        heard: &'a mut [bool],
    }

    /// Gradient by the camera, summed over a chunk; 0 where not wanted.
    #[derive(Clone, Copy, Debug, Default)]
    struct SplatCameraGradient {
        pose: [f64; 6],
        /// Focal lengths, then the principal point.
        intrinsics: [f64; 4],
    }

    /// One tile of 16x16 pixels to composite.
    struct SplatForward<'a> {
        /// All splats.
        rows: &'a [AlignedRow],
        /// Those of the tile, front to back.
        entries: &'a [u32],
        /// Out, or in with the bit `KNOWN_MASKS`: the 4x4 blocks that each entry may touch.
        masks: &'a mut [u16],
        /// Upper left corner in pixels.
        corner: [f32; 2],
        /// Bits of `Part` (`cpp/splat/kernel.h`).
        parts: u32,
        /// Out: 5 planes of 256 pixels.
        state: &'a mut [f32],
        /// One row per splat and direction, direction by direction.
        velocities: &'a [[f32; 8]],
        /// Out: 4 planes of 256 pixels for each direction, up to four of them.
        moving: &'a mut [f32],
    }

    /// One tile whose image gradient goes to the slots of its entries.
    struct SplatBackward<'a> {
        /// All splats.
        rows: &'a [AlignedRow],
        /// Those of the tile, front to back.
        entries: &'a [u32],
        /// Blocks of each.
        masks: &'a [u16],
        /// Slot of each.
        targets: &'a [u32],
        /// Upper left corner in pixels.
        corner: [f32; 2],
        /// Bits of `Part` (`cpp/splat/kernel.h`).
        parts: u32,
        /// Gradients of the first four planes of the state, then `behind` (`src/splat/plain/tile.rs`).
        adjoint: &'a [f32],
    }

    /// The exact discs of one tile; see `DiscTile` of `cpp/splat/kernel.h`.
    struct SplatDiscs<'a> {
        rows: &'a [AlignedRow],
        discs: &'a [AlignedRow],
        /// Those of the tile, front to back.
        entries: &'a [u32],
        /// Upper left corner of the tile in pixels.
        x: u32,
        y: u32,
        /// Size of the image.
        width: u32,
        height: u32,
        /// Ray of each pixel of the image, row by row.
        rays: &'a [[f32; 3]],
        pinhole: bool,
        /// 1 / focal length of a pinhole.
        per_px: [f32; 2],
        /// Smallest z-depth at which a ray meets a disc (mm).
        near: f32,
        /// 1 / variance of the screen filter (1/px^2), 0 for none.
        filter: f32,
    }

    // SAFETY: every function declared safe checks all indices and lengths before it reads or writes
    // (`cpp/splat/rasterize.cpp`) and throws where they do not fit, which becomes an `Err`; none keeps a pointer, calls
    // back into Rust, or writes what it was not given as `&mut`. The numbers themselves may be anything, NaN included:
    // they choose no address. Flags that come back are written as 0 or 1. `splat_backward` cannot check that no other
    // thread writes the same slots, hence it is unsafe to call.
    unsafe extern "C++" {
        include!("cpp/splat/rasterize.h");

        type AlignedRow = super::AlignedRow;

        fn splat_project(
            isa: u8,
            scene: &SplatScene,
            tiles: [u32; 2],
            chunk: SplatChunk,
            motion: &SplatMotion,
        ) -> Result<()>;
        fn splat_recolor(
            isa: u8,
            scene: &SplatScene,
            first: usize,
            visible: &[bool],
            rows: &mut [AlignedRow],
        ) -> Result<bool>;
        fn splat_velocities(
            isa: u8,
            scene: &SplatScene,
            first: usize,
            visible: &[bool],
            motion: &SplatMotion,
            rows: &mut [[f32; 8]],
        ) -> Result<()>;
        fn splat_chain(
            isa: u8,
            scene: &SplatScene,
            moments: &SplatMoments,
            gradients: SplatGradients,
        ) -> Result<SplatCameraGradient>;
        fn splat_forward(isa: u8, tile: SplatForward) -> Result<()>;
        unsafe fn splat_backward(
            isa: u8,
            tile: &SplatBackward,
            slots: *mut AlignedRow,
            live: *mut bool,
            slot_count: usize,
        ) -> Result<()>;
        fn splat_disc_forward(isa: u8, discs: &SplatDiscs, with_depth: bool, state: &mut [f32]) -> Result<()>;
        fn splat_disc_backward(
            isa: u8,
            discs: &SplatDiscs,
            adjoint: &[f32],
            parts: u32,
            sums: &mut [f32],
        ) -> Result<()>;
    }
}

pub use bridge::{
    SplatBackward, SplatCamera, SplatCameraGradient, SplatChunk, SplatDiscs, SplatExactCamera, SplatForward,
    SplatMoments, SplatMotion, SplatScene,
};

/// Sixteen numbers that begin at a cache line.
#[repr(C, align(64))]
#[derive(Clone, Copy, Debug, Default)]
pub struct Aligned<T>(pub [T; 16]);

impl<T> AsRef<[T; 16]> for Aligned<T> {
    fn as_ref(&self) -> &[T; 16] {
        &self.0
    }
}

/// A row of the tables that C++ shares: the columns of a splat or a disc, or the moments of an entry.
pub type AlignedRow = Aligned<f32>;

// SAFETY: `respire::AlignedRow` (`cpp/splat/rasterize.h`) is the same struct: sixteen floats aligned to 64 bytes,
// without padding (a static_assert there holds the size). It is plain data, hence trivially movable.
unsafe impl ExternType for AlignedRow {
    type Id = type_id!("respire::AlignedRow");
    type Kind = kind::Trivial;
}

/// The caller's invariant: breaking it is a defect of this crate, never of the input.
const AGREE: &str = "the rasteriser hands over tables that belong together";

/// Projects the Gaussians of a chunk onto an image of `tiles` (columns, rows) of 16x16 pixels. Where the chunk has room
/// for velocities, those of the visible splats along `motion` too.
pub fn project(isa: Isa, scene: &SplatScene<'_>, tiles: [usize; 2], chunk: SplatChunk<'_>, motion: &SplatMotion<'_>) {
    bridge::splat_project(isa.code(), scene, tiles.map(|n| n as u32), chunk, motion).expect(AGREE);
}

/// Writes the colours of the visible splats into their rows; `false` when one is not finite.
pub fn recolor(isa: Isa, scene: &SplatScene<'_>, first: usize, visible: &[bool], rows: &mut [AlignedRow]) -> bool {
    bridge::splat_recolor(isa.code(), scene, first, visible, rows).expect(AGREE)
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
    bridge::splat_velocities(isa.code(), scene, first, visible, motion, rows).expect(AGREE);
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
    /// Per group of Gaussians, whether any of these may differ from 0 now.
    pub written: &'a [bool],
    /// Whether any may afterwards; `false` when it comes.
    pub heard: &'a mut [bool],
}

/// Gradients of the Gaussians of a chunk from the moments of their splats; returns those by the camera.
pub fn chain(
    isa: Isa,
    scene: &SplatScene<'_>,
    moments: &SplatMoments<'_>,
    out: ChainOutput<'_, f32>,
) -> SplatCameraGradient {
    let ChainOutput { positions, shape, scales, opacities, sh, written, heard } = out;
    let gradients = bridge::SplatGradients { positions, shape, scales, opacities, sh, written, heard };
    bridge::splat_chain(isa.code(), scene, moments, gradients).expect(AGREE)
}

/// Composites one tile, with the velocities of its pixels along as many directions as `moving` has room for.
pub fn forward(isa: Isa, tile: SplatForward<'_>) {
    bridge::splat_forward(isa.code(), tile).expect(AGREE);
}

/// Composites one tile of exact discs into `state`.
pub fn disc_forward(isa: Isa, discs: &SplatDiscs<'_>, with_depth: bool, state: &mut [f32]) {
    bridge::splat_disc_forward(isa.code(), discs, with_depth, state).expect(AGREE);
}

/// Backward of [`disc_forward`]: the sums of each entry.
pub fn disc_backward(isa: Isa, discs: &SplatDiscs<'_>, adjoint: &[f32], parts: u32, sums: &mut [f32]) {
    bridge::splat_disc_backward(isa.code(), discs, adjoint, parts, sums).expect(AGREE);
}

/// Slots that several tiles write at the same time, each its own: the entries' targets are all different, since
/// [`super::bin`] numbers them splat by splat and refuses more of them than 32 bits can number (its lists are compared
/// with the plain twin's in `src/splat/pass/`). Each has a flag that says whether it was written. Only this crate can
/// make one, so that nobody else has to keep this.
pub struct Slots<'a> {
    start: *mut AlignedRow,
    live: *mut bool,
    count: usize,
    owner: PhantomData<(&'a mut [AlignedRow], &'a mut [bool])>,
}

// SAFETY: the slots and their flags are plain numbers that nothing else can reach while the exclusive borrow lasts, a `Slots` itself
// gives no access to them, and threads that share one write different slots through [`backward`].
unsafe impl Sync for Slots<'_> {}

impl<'a> Slots<'a> {
    /// As many of `slots` as there are flags in `live`, to be shared among tiles.
    pub(crate) fn new(slots: &'a mut [AlignedRow], live: &'a mut [bool]) -> Self {
        let count = slots.len().min(live.len());
        Slots { start: slots.as_mut_ptr(), live: live.as_mut_ptr(), count, owner: PhantomData }
    }
}

/// Backward of [`forward`]: writes the moments of each entry that has any into its slot and sets its flag. Tiles that run at the same time must have
/// different targets, as the lists of [`super::bin`] have.
pub(crate) fn backward(isa: Isa, tile: &SplatBackward<'_>, slots: &Slots<'_>) {
    // SAFETY: `start` and `live` begin slices of at least `count` that are borrowed exclusively as long as `slots` lives,
    // aligned as their types; C++ checks that every target lies below `count`; tiles that run at the same time have
    // different targets (above), so that no two threads write one slot or flag, and nobody reads one before all tiles
    // are done.
    unsafe { bridge::splat_backward(isa.code(), tile, slots.start, slots.live, slots.count) }.expect(AGREE);
}
