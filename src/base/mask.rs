//! Which pixels of a film hold an image: pixels outside a scope's circular mask count in no metric and no loss.

use super::{Error, Image, Result};

/// Visible and hidden pixels of an image, row-major. At least one is visible.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Mask {
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
    visible: Vec<bool>,
}

impl Mask {
    /// Visible where the first channel of `image` is above 0. Fails where nothing is.
    pub fn from_image(image: &Image<u8>) -> Result<Mask> {
        let visible = image.data.iter().step_by(image.channels).map(|&v| v > 0).collect();
        Mask { width: image.width, height: image.height, visible }.checked()
    }

    fn checked(self) -> Result<Mask> {
        if self.visible.contains(&true) { Ok(self) } else { Err(Error::input("the mask hides every pixel")) }
    }

    /// Hides also what lies within `pixels` of a hidden pixel, sideways, up, down or diagonally. The image's own
    /// border hides nothing. Fails where nothing is left.
    pub fn eroded(&self, pixels: usize) -> Result<Mask> {
        let spread = |visible: &[bool], here: usize, step: usize, count: usize, at: usize| {
            (at.saturating_sub(pixels)..(at + pixels + 1).min(count)).all(|k| visible[here + k * step - at * step])
        };
        let rows: Vec<bool> =
            (0..self.visible.len()).map(|p| spread(&self.visible, p, 1, self.width, p % self.width)).collect();
        let visible = (0..rows.len()).map(|p| spread(&rows, p, self.width, self.height, p / self.width)).collect();
        Mask { visible, ..*self }.checked()
    }

    /// Whether pixel `index` (row-major) is visible.
    pub fn shows(&self, index: usize) -> bool {
        self.visible[index]
    }

    /// Number of visible pixels, at least 1.
    pub fn count(&self) -> usize {
        self.visible.iter().filter(|v| **v).count()
    }

    /// 1 where visible, else 0: weights per pixel.
    pub fn weights<T: From<bool>>(&self) -> Vec<T> {
        self.visible.iter().map(|&v| T::from(v)).collect()
    }

    /// Sets every hidden pixel of `image`, which has the mask's size, to `value` in all channels.
    pub fn hide<T: Copy>(&self, image: &mut Image<T>, value: T) {
        debug_assert_eq!((image.width, image.height), (self.width, self.height));
        for (pixel, _) in image.data.chunks_exact_mut(image.channels).zip(&self.visible).filter(|(_, shown)| !**shown) {
            pixel.fill(value);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mask(rows: &[&str]) -> Result<Mask> {
        let data: Vec<u8> = rows.iter().flat_map(|r| r.bytes()).map(|b| if b == b'#' { 255 } else { 0 }).collect();
        Mask::from_image(&Image { width: rows[0].len(), height: rows.len(), channels: 1, data })
    }

    #[test]
    fn erosion_takes_what_touches_the_hidden_and_leaves_the_border() {
        let whole = mask(&[".####", "#####", "#####", "#####"]).unwrap();
        assert_eq!(whole.eroded(1).unwrap(), mask(&["..###", "..###", "#####", "#####"]).unwrap());
        assert_eq!(whole.eroded(2).unwrap(), mask(&["...##", "...##", "...##", "#####"]).unwrap());
        assert_eq!(whole.eroded(0).unwrap(), whole);
        assert!(whole.eroded(4).is_err());
        assert!(mask(&["...", "..."]).is_err());
    }

    #[test]
    fn hidden_pixels_are_painted_over() {
        let half = mask(&["#.", ".#"]).unwrap();
        let mut image = Image { width: 2, height: 2, channels: 2, data: vec![1, 2, 3, 4, 5, 6, 7, 8] };
        half.hide(&mut image, 0);
        assert_eq!(image.data, [1, 2, 0, 0, 0, 0, 7, 8]);
        assert_eq!((half.count(), half.weights::<u8>()), (2, vec![1, 0, 0, 1]));
        assert!(half.shows(0) && !half.shows(1));
    }
}
