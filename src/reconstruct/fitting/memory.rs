//! Memory of the wall's colours over many frames. The shown colours follow every frame closely, so a phase measured
//! against them is measured against the last frame alone, and its small errors accumulate. The phase is therefore
//! measured against remembered colours: per Gaussian the running mean of the fitted colours, without the light of the
//! scope ([`super::scope_light`]), so that early frames hold later ones in place. Ours, not the paper's.

use super::anchored::{SH_C0, SH_VALUES};

/// Offset that makes a spherical harmonic coefficient proportional to colour (colour = SH + 0.5).
pub fn shift(coefficient: usize) -> f32 {
    if coefficient % SH_VALUES < 3 { 0.5 / SH_C0 } else { 0.0 }
}

/// One entry per Gaussian.
#[derive(Clone, Debug, Default)]
pub struct Memory {
    /// Shade contained in the shown colour; 0 if no frame has shown this Gaussian yet.
    pub contained_shade: Vec<f32>,
    /// Remembered spherical harmonics, [`SH_VALUES`] each, at shade 1.
    albedo: Vec<f32>,
    /// Number of frames in each mean.
    frames: Vec<f32>,
}

impl Memory {
    /// Nothing remembered of `n` Gaussians.
    pub fn new(n: usize) -> Self {
        Memory { contained_shade: vec![0.0; n], albedo: vec![0.0; n * SH_VALUES], frames: vec![0.0; n] }
    }

    /// The entries of `ids`.
    pub fn pick(&self, ids: &[u32]) -> Self {
        Memory {
            contained_shade: ids.iter().map(|&i| self.contained_shade[i as usize]).collect(),
            albedo: ids.iter().flat_map(|&i| &self.albedo[i as usize * SH_VALUES..][..SH_VALUES]).copied().collect(),
            frames: ids.iter().map(|&i| self.frames[i as usize]).collect(),
        }
    }

    /// Writes the entries of `ids` back.
    pub fn put(&mut self, ids: &[u32], from: &Self) {
        for (k, &i) in ids.iter().enumerate() {
            let i = i as usize;
            self.contained_shade[i] = from.contained_shade[k];
            self.frames[i] = from.frames[k];
            self.albedo[i * SH_VALUES..][..SH_VALUES].copy_from_slice(&from.albedo[k * SH_VALUES..][..SH_VALUES]);
        }
    }

    /// Adds entries for Gaussians that start as copies of `parents`. Both count as one frame at most, so that they are
    /// learned anew at the closer distance.
    pub fn split(&mut self, parents: &[u32]) {
        for &parent in parents {
            let parent = parent as usize;
            self.frames[parent] = self.frames[parent].min(1.0);
            self.frames.push(self.frames[parent]);
            self.contained_shade.push(self.contained_shade[parent]);
            self.albedo.extend_from_within(parent * SH_VALUES..(parent + 1) * SH_VALUES);
        }
    }

    /// A copy of the shown colours.
    pub fn set_aside(&self, sh: &[f32]) -> ShownColors {
        ShownColors { sh: sh.to_vec(), contained_shade: self.contained_shade.clone() }
    }

    /// Puts the remembered colours into `sh`, at shade 1; Gaussians without memory stay unchanged. Returns the former
    /// colours.
    pub fn recall(&mut self, sh: &mut [f32]) -> ShownColors {
        let shown = self.set_aside(sh);
        for (k, sh) in sh.chunks_exact_mut(SH_VALUES).enumerate() {
            if self.frames[k] > 0.0 {
                sh.copy_from_slice(&self.albedo[k * SH_VALUES..][..SH_VALUES]);
                self.contained_shade[k] = 1.0;
            }
        }
        shown
    }

    /// Undoes [`Memory::recall`].
    pub fn restore(&mut self, shown: ShownColors, sh: &mut [f32]) {
        sh.copy_from_slice(&shown.sh);
        self.contained_shade = shown.contained_shade;
    }

    /// Restores the colours `sh` of Gaussian `k` from `shown`, at its current shade; does nothing if no frame had
    /// shown it then.
    pub fn put_back(&self, k: usize, sh: &mut [f32], shown: &ShownColors) {
        if shown.contained_shade[k] > 0.0 {
            let ratio = self.contained_shade[k] / shown.contained_shade[k];
            for (i, (value, was)) in sh.iter_mut().zip(&shown.sh[k * SH_VALUES..]).enumerate() {
                *value = (was + shift(i)) * ratio - shift(i);
            }
        }
    }

    /// Adds the colours `sh` of Gaussian `k`, at its contained shade, to its mean. The first `most_frames` count alike;
    /// after that the newest counts `1 / most_frames`.
    pub fn add(&mut self, k: usize, sh: &[f32], most_frames: f32) {
        self.frames[k] = (self.frames[k] + 1.0).min(most_frames);
        let (share, shade) = (1.0 / self.frames[k], self.contained_shade[k]);
        let remembered = &mut self.albedo[k * SH_VALUES..][..SH_VALUES];
        for (i, (value, &shown)) in remembered.iter_mut().zip(sh).enumerate() {
            let albedo = (shown + shift(i)) / shade - shift(i);
            *value += (albedo - *value) * share;
        }
    }
}

/// Colours set aside by [`Memory::set_aside`].
pub struct ShownColors {
    sh: Vec<f32>,
    contained_shade: Vec<f32>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_memory_is_the_mean_of_the_first_frames_free_of_light() {
        let mut memory = Memory::new(1);
        let sh_of = |color: f32| -> Vec<f32> {
            (0..SH_VALUES).map(|i| if i < 3 { (color - 0.5) / SH_C0 } else { 0.0 }).collect()
        };
        for (color, shade) in [(0.2, 0.5), (0.6, 1.0), (1.0, 2.0)] {
            memory.contained_shade[0] = shade;
            memory.add(0, &sh_of(color), 8.0);
        }
        let mut sh = sh_of(0.9);
        let shown = memory.recall(&mut sh);
        let color = sh[0] * SH_C0 + 0.5;
        assert!((color - (0.4 + 0.6 + 0.5) / 3.0).abs() < 1e-6, "{color}");
        assert_eq!(memory.contained_shade[0], 1.0);
        memory.restore(shown, &mut sh);
        assert_eq!((sh, memory.contained_shade[0]), (sh_of(0.9), 2.0));
    }

    /// A memory of two frames moves half of the way to each later one; and what was shown comes back at the light of now.
    #[test]
    fn the_memory_has_an_end_and_colours_come_back_in_the_light_of_now() {
        let sh_of = |color: f32| -> Vec<f32> {
            (0..SH_VALUES).map(|i| if i < 3 { (color - 0.5) / SH_C0 } else { 0.0 }).collect()
        };
        let color = |sh: &[f32]| sh[0] * SH_C0 + 0.5;
        let mut memory = Memory::new(1);
        memory.contained_shade[0] = 1.0;
        [0.2, 0.6, 1.0].into_iter().for_each(|shown| memory.add(0, &sh_of(shown), 2.0));
        let mut sh = sh_of(0.3);
        let before = memory.set_aside(&sh);
        memory.recall(&mut sh);
        assert!((color(&sh) - 0.7).abs() < 1e-6, "{}", color(&sh));
        memory.contained_shade[0] = 2.0;
        memory.put_back(0, &mut sh, &before);
        assert!((color(&sh) - 0.6).abs() < 1e-6, "{}", color(&sh));
    }

    #[test]
    fn what_nobody_saw_keeps_its_colour_and_entries_travel_by_index() {
        let mut all = Memory::new(3);
        let mut part = all.pick(&[2, 0]);
        part.contained_shade[0] = 1.0;
        part.add(0, &[0.3; SH_VALUES], 4.0);
        all.put(&[2, 0], &part);
        let mut sh = vec![0.1; 3 * SH_VALUES];
        all.recall(&mut sh);
        assert_eq!(&sh[..2 * SH_VALUES], &[0.1; 2 * SH_VALUES]);
        assert!(sh[2 * SH_VALUES..].iter().all(|v| (v - 0.3).abs() < 1e-6));
    }
}
