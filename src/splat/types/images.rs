//! The images of a pass, and derivatives with respect to them.

/// The images of one forward pass.
#[derive(Clone, Debug, Default)]
pub struct Rendered<T> {
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
    /// `height * width * 3`, with background and gain.
    pub color: Vec<T>,
    /// `height * width`: z-depth in mm as asked for (`DepthOutput`); the means are divided by alpha, 0 where it is 0.
    pub depth: Vec<T>,
    /// `height * width`: 1 minus the transmittance.
    pub alpha: Vec<T>,
    /// One flag per active Gaussian (in the order of `active`): its ellipse of alpha >= 1/255 touches the image.
    pub visible: Vec<bool>,
    /// How many flags are set.
    pub visible_count: usize,
    /// Entries in the lists of all tiles: pairs of a tile and a splat whose ellipse may contain a pixel centre of the
    /// tile.
    pub intersections: usize,
}

/// Derivatives of a loss with respect to the images of the last forward pass. An empty slice is all zeros.
#[derive(Clone, Copy, Debug, Default)]
pub struct ImageGradient<'a, T> {
    /// Like `Rendered::color`.
    pub color: &'a [T],
    /// Like `Rendered::depth`.
    pub depth: &'a [T],
    /// Like `Rendered::alpha`.
    pub alpha: &'a [T],
    /// Like the image of `Rasterizer::render_channels`.
    pub channels: &'a [T],
}
