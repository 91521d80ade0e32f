//! What skipping saves. Each skip of the core and the optimiser is switched off, one at a time, and timed turn by turn
//! with the default: CPU time without the skip over that with it, and the difference of image and gradients from the
//! default's.

use crate::base::Result;
use crate::experiments::difference::{gradient_groups, relative_l2, widened};
use crate::experiments::timing::{Samples, TimedScene, in_turns};
use crate::reconstruct::optimiser::{AdamConstants, RowAdam, StepCounter};
use crate::splat::{DepthOutput, Rasterizer, Reuse, Settings, Skips, Wanted};

/// Columns of `skipping.csv`.
pub const COLUMNS: [&str; 8] =
    ["subject", "skipped", "measured", "with_skip_cpu_s", "without_cpu_s", "ratio", "image_change", "gradient_change"];

/// What one skip saves.
#[derive(Clone, Debug)]
pub struct SkipSaving {
    skipped: &'static str,
    measured: &'static str,
    /// Medians with and without the skip.
    cpu_s: [f64; 2],
    /// Relative L2 of image and gradients (worst group) to those with the skip.
    change: [f64; 2],
}

impl SkipSaving {
    fn new(skipped: &'static str, measured: &'static str, samples: [Samples; 2], change: [f64; 2]) -> SkipSaving {
        SkipSaving { skipped, measured, cpu_s: samples.map(|s| s.cpu().median_s), change }
    }

    /// As a row of the table.
    pub fn row(&self, subject: &str) -> Vec<String> {
        let ([with, without], [image, gradients]) = (self.cpu_s, self.change);
        let words = [subject, self.skipped, self.measured].map(str::to_owned);
        let seconds = [format!("{with:.6}"), format!("{without:.6}"), format!("{:.3}", without / with)];
        words.into_iter().chain(seconds).chain([format!("{image:.2e}"), format!("{gradients:.2e}")]).collect()
    }
}

/// Rasterisers with the skip and without.
fn pair() -> [Rasterizer<f32>; 2] {
    [Rasterizer::new(), Rasterizer::new()]
}

/// Relative differences between the two: image, and worst group of gradients.
fn change([with, without]: &[Rasterizer<f32>; 2]) -> [f64; 2] {
    let image = relative_l2(&widened(&without.rendered().color), &widened(&with.rendered().color));
    let (found, truth) = (gradient_groups(without.gradients()), gradient_groups(with.gradients()));
    let asked = found.iter().zip(&truth).filter(|(_, truth)| truth.1.iter().any(|v| *v != 0.0));
    let worst = asked.map(|(found, truth)| relative_l2(&found.1, &truth.1));
    [image, worst.fold(0.0, f64::max)]
}

/// Name of a timed forward and backward pass.
const BOTH: &str = "forward + backward";

/// A switch of the rasteriser.
fn switch(skipped: &'static str, skip: Skips, scene: &TimedScene, repetitions: usize) -> Result<SkipSaving> {
    let mut pair = pair();
    pair[1].skips(Skips::ALL.without(skip));
    let samples =
        in_turns(repetitions, |k, samples| samples.time(|| scene.forward_backward(&mut pair[k], Wanted::ALL)))?;
    Ok(SkipSaving::new(skipped, BOTH, samples, change(&pair)))
}

/// Leaves out the gradients of groups that a step does not learn.
fn frozen(skipped: &'static str, wanted: Wanted, scene: &TimedScene, repetitions: usize) -> Result<SkipSaving> {
    let mut pair = pair();
    let samples = in_turns(repetitions, |k, samples| {
        samples.time(|| scene.forward_backward(&mut pair[k], [wanted, Wanted::ALL][k]))
    })?;
    Ok(SkipSaving::new(skipped, BOTH, samples, change(&pair)))
}

/// One direction in forward mode, against the gradient of everything that this direction moves. The two derivatives of
/// the loss along the direction must agree.
fn one_direction(scene: &TimedScene, repetitions: usize) -> Result<SkipSaving> {
    let velocities = scene.velocities();
    let [mut tangent, mut gradient] = pair();
    let (mut along, mut back) = (0.0, 0.0);
    let samples = in_turns(repetitions, |k, samples| {
        samples.time(|| {
            if k == 0 {
                let images = scene.forward_tangent(&mut tangent, &velocities)?;
                along = images[0].iter().zip(&scene.color_gradient).map(|(d, w)| f64::from(d * w)).sum();
            } else {
                scene.forward_backward(&mut gradient, Wanted::POSITIONS)?;
                let moved = gradient.gradients().positions.as_flattened().iter().zip(velocities.as_flattened());
                back = moved.map(|(g, v)| f64::from(g * v)).sum();
            }
            Ok(())
        })
    })?;
    let change = [0.0, f64::abs((back - along) / along)];
    Ok(SkipSaving::new("gradients where one direction is asked for (JVP)", "forward + derivative", samples, change))
}

/// Reuses the splats and lists of the previous pass for new colours on the same geometry.
fn unchanged_geometry(scene: &TimedScene, repetitions: usize) -> Result<SkipSaving> {
    let mut pair = pair();
    pair[0].reuse(Reuse::Unchanged);
    let mut scenes = [scene.clone(), scene.clone()];
    let samples = in_turns(repetitions, |k, samples| {
        scenes[k].gaussians.sh.iter_mut().for_each(|v| *v *= 0.999);
        samples.time(|| scenes[k].forward_backward(&mut pair[k], Wanted::SH))
    })?;
    Ok(SkipSaving::new("splats and lists of unchanged geometry (Unchanged)", BOTH, samples, change(&pair)))
}

fn depth(scene: &TimedScene, repetitions: usize) -> Result<SkipSaving> {
    let mut pair = pair();
    let scenes = [DepthOutput::Skip, DepthOutput::Expected].map(|depth| {
        let mut scene = scene.clone();
        scene.settings = Settings { depth, ..scene.settings };
        scene
    });
    let samples = in_turns(repetitions, |k, samples| samples.time(|| scenes[k].forward(&mut pair[k])))?;
    Ok(SkipSaving::new("depth that nobody asks for", "forward", samples, [change(&pair)[0], 0.0]))
}

/// One step of SH on a scene of which a sixth is visible: rows with a gradient alone, or all.
fn optimiser(hidden: &TimedScene, repetitions: usize) -> Result<SkipSaving> {
    let count = hidden.gaussians.len();
    let mut rasterizer = Rasterizer::<f32>::new();
    hidden.forward_backward(&mut rasterizer, Wanted::SH)?;
    let mut learned = [hidden.gaussians.sh.clone(), hidden.gaussians.sh.clone()];
    let mut adams = [(); 2].map(|()| RowAdam::<12>::new(AdamConstants::default()));
    adams.iter_mut().for_each(|adam| adam.begin(count, StepCounter::Restarted));
    adams[1].touch_all();
    let gradients = rasterizer.gradients();
    let heard: [&[bool]; 2] = [&gradients.heard, &[]];
    let samples = in_turns(repetitions, |k, samples| {
        samples.time(|| adams[k].step([1e-3; 12], &mut learned[k], &gradients.sh, heard[k]));
        Ok(())
    })?;
    let change = [0.0, relative_l2(&widened(&learned[1]), &widened(&learned[0]))];
    Ok(SkipSaving::new("moments of what has no gradient", "Adam's step of SH", samples, change))
}

/// All skips on one scene.
pub fn savings(scene: &TimedScene, repetitions: usize) -> Result<Vec<SkipSaving>> {
    let mut faint = scene.clone();
    faint.gaussians.opacities.fill(0.1);
    let hidden = scene.with_hidden(5);
    let n = repetitions;
    let geometry = Wanted::POSITIONS | Wanted::SHAPES;
    Ok(vec![
        switch("extents beyond an alpha of 1/255; opacity .95", Skips::EXTENTS, scene, n)?,
        switch("extents beyond an alpha of 1/255; opacity .1", Skips::EXTENTS, &faint, n)?,
        switch("blocks that the ellipse does not touch", Skips::BLOCKS, scene, n)?,
        switch("groups beside the image; five times more out of sight", Skips::BESIDE, &hidden, n)?,
        switch("splats behind a stopped pixel", Skips::STOP, scene, n)?,
        frozen("all groups but SH (frozen)", Wanted::SH, scene, n)?,
        frozen("all groups but positions and shapes (frozen)", geometry, scene, n)?,
        one_direction(scene, n)?,
        unchanged_geometry(scene, n)?,
        depth(scene, n)?,
        optimiser(&hidden, n)?,
    ])
}
