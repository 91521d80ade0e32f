//! How to render, and which work a pass skips.

/// Whether the expected depth is composited too (it costs about a twentieth of the forward pass).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DepthOutput {
    /// `Rendered::depth` stays 0.
    Skip,
    /// Mean z-depth of the centres weighted by contribution, divided by alpha.
    Expected,
    /// Mean z-depth of the splats' surfaces along each ray (`plain/surface_depth.rs`); forward only with
    /// `Footprint::Ewa`.
    Surface,
    /// z-depth where the ray meets the first splat behind which the transmittance is at most one half; 0 if there is
    /// none. Forward only.
    Median,
}

/// What the screen-space filter (`Settings::dilation_px2`) does to a splat's peak.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Filter {
    /// 3DGS: the splat grows and keeps its opacity, so that splats smaller than a pixel gain weight.
    #[default]
    Dilate,
    /// Mip-Splatting (Yu et al., 2024; gsplat's `antialiased`): the opacity is multiplied by
    /// `sqrt(det before / det after)` of the covariance on screen, so that the splat keeps its weight.
    Compensate,
}

/// How a Gaussian is projected onto the screen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Footprint {
    /// The affine projection of 3DGS (EWA), vectorised.
    #[default]
    Ewa,
    /// Flat discs that each ray meets exactly (2DGS; `plain/disc.rs`): plain projection, vectorised compositing.
    /// Ellipsoids lose their shortest axis. Expected depth is that of the points met.
    Disc,
}

/// How to render.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// How a Gaussian is projected onto the screen.
    pub footprint: Footprint,
    /// Gaussians with a centre nearer than this z-depth are left out.
    pub near_mm: f64,
    /// Added to the diagonal of the projected covariance (px^2): the screen-space filter of 3DGS. With
    /// `Footprint::Disc` the smallest variance of a disc on screen. 0 means no filter.
    pub dilation_px2: f64,
    /// How that filter changes the opacity.
    pub filter: Filter,
    /// Multiplies the finished image per channel (exposure).
    pub gain: [f64; 3],
    /// Colour behind everything (before the gain).
    pub background: [f64; 3],
    /// Whether depth is wanted.
    pub depth: DepthOutput,
}

impl Default for Settings {
    fn default() -> Self {
        Settings {
            footprint: Footprint::Ewa,
            near_mm: 0.2,
            dilation_px2: 0.3,
            filter: Filter::Dilate,
            gain: [1.0; 3],
            background: [0.0; 3],
            depth: DepthOutput::Expected,
        }
    }
}

impl Settings {
    /// Whether the depth is composited with the colours.
    pub(in crate::splat) fn composites_depth(&self) -> bool {
        match self.footprint {
            Footprint::Ewa => self.depth == DepthOutput::Expected,
            Footprint::Disc => matches!(self.depth, DepthOutput::Expected | DepthOutput::Surface),
        }
    }
}

/// A set of shortcuts that skip invisible work. `respire-bench pareto splat` switches them off one at a time; the
/// kernels have no branch for them in their loops over pixels. Exact discs have none of these switches.
///
/// Other optional work has settings of its own: groups of gradients ([`crate::splat::Wanted`]), inactive Gaussians
/// (`active`), reused lists ([`crate::splat::Reuse`]), depth ([`crate::splat::DepthOutput`]).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Skips(u8);

impl Skips {
    /// Extents end where a splat's alpha falls below 1/255; without, where that of an opaque one would (3.33 standard
    /// deviations). The image is the same.
    pub const EXTENTS: Skips = Skips(1);
    /// Only the 4x4 blocks of a tile that a splat's ellipse can touch are composited; without, the whole tile. The
    /// image is the same.
    pub const BLOCKS: Skips = Skips(2);
    /// Groups of Gaussians beside the image are skipped before their covariance is computed (vectorised projection).
    /// The image is the same.
    pub const BESIDE: Skips = Skips(4);
    /// A pixel stops when its transmittance would fall to 1e-4 or below; without, it blends all its splats. The image
    /// changes by at most that share.
    pub const STOP: Skips = Skips(8);
    /// All of them: the default.
    pub const ALL: Skips = Skips(15);

    /// These without `others`.
    pub fn without(self, others: Skips) -> Skips {
        Skips(self.0 & !others.0)
    }

    /// True if any of `others` is among these.
    pub fn any(self, others: Skips) -> bool {
        self.0 & others.0 != 0
    }
}

impl Default for Skips {
    fn default() -> Self {
        Skips::ALL
    }
}
