//! What skipping saves: each thing that the core or the optimiser leaves out switched off, one at a time, turn by turn with
//! the default: CPU time without the skip over that with it, and how far image and gradients are from the default's.

use super::pareto_splat::relative;
use crate::base::Result;
use crate::ffi::system::cpu_time_s;
use crate::reconstruct::optimiser::{AdamConstants, RowAdam, StepCounter};
use crate::splat::{
    DepthOutput, Direction, Gaussians, Gradients, ImageGradient, Motion, Rasterizer, Reuse, Settings, Skips, View,
    Wanted, tube,
};

/// First line of `skipping.csv`.
pub(super) const HEADER: &str =
    "subject,skipped,measured,with_skip_cpu_s,without_cpu_s,ratio,image_change,gradient_change\n";

/// One skip.
pub(super) struct Row {
    skipped: &'static str,
    measured: &'static str,
    cpu_s: [f64; 2],
    /// Relative L2 of image and gradients (worst group) to those with the skip.
    change: [f64; 2],
}

impl Row {
    /// As a line of the table.
    pub fn line(&self, subject: &str) -> String {
        let [with, without] = self.cpu_s;
        let (ratio, [image, gradients]) = (without / with, self.change);
        let Row { skipped, measured, .. } = self;
        format!("{subject},{skipped},{measured},{with:.6},{without:.6},{ratio:.3},{image:.2e},{gradients:.2e}\n")
    }
}

/// Medians of the CPU seconds of two pieces of work, turn by turn after one of each to warm up.
fn turn_by_turn(repeat: usize, work: &mut dyn FnMut(usize) -> Result<()>) -> Result<[f64; 2]> {
    let mut times = [Vec::new(), Vec::new()];
    for turn in 0..=repeat.max(1) {
        for (which, times) in times.iter_mut().enumerate() {
            let start = cpu_time_s();
            work(which)?;
            if turn > 0 {
                times.push(cpu_time_s() - start);
            }
        }
    }
    Ok(times.map(|mut t| {
        t.sort_by(f64::total_cmp);
        t[t.len() / 2]
    }))
}

/// A scene and everything around it.
struct Bench<'a> {
    scene: &'a Gaussians<f32>,
    view: View,
    settings: Settings,
    weights: Vec<f32>,
    repeat: usize,
}

fn wide(v: &[f32]) -> Vec<f64> {
    v.iter().map(|&v| f64::from(v)).collect()
}

fn groups(g: &Gradients<f32>) -> Vec<Vec<f64>> {
    let (rotations, scales) = (wide(g.rotations.as_flattened()), wide(g.scales.as_flattened()));
    vec![wide(g.positions.as_flattened()), rotations, scales, wide(&g.opacities), wide(&g.sh), g.pose.to_vec()]
}

/// Image and the worst group of gradients of the second rasteriser against the first.
fn change([with, without]: &[Rasterizer<f32>; 2]) -> [f64; 2] {
    let image = relative(&wide(&without.rendered().color), &wide(&with.rendered().color));
    let (found, truth) = (groups(without.gradients()), groups(with.gradients()));
    let asked = found.iter().zip(&truth).filter(|(_, truth)| truth.iter().any(|v| *v != 0.0));
    let worst = asked.map(|(found, truth)| relative(found, truth));
    [image, worst.fold(0.0, f64::max)]
}

impl Bench<'_> {
    fn both(&self, rasterizer: &mut Rasterizer<f32>, scene: &Gaussians<f32>, wanted: Wanted) -> Result<()> {
        rasterizer.render(scene, &self.view, &self.settings, None)?;
        let gradient = ImageGradient { color: &self.weights, ..ImageGradient::default() };
        rasterizer.backward(scene, &gradient, wanted).map(drop)
    }

    /// A switch of the rasteriser.
    fn switch(&self, skipped: &'static str, skip: Skips, scene: &Gaussians<f32>) -> Result<Row> {
        let mut pair = [Rasterizer::<f32>::new(), Rasterizer::<f32>::new()];
        pair[1].skips(Skips::ALL.without(skip));
        let cpu_s = turn_by_turn(self.repeat, &mut |k| self.both(&mut pair[k], scene, Wanted::ALL))?;
        Ok(Row { skipped, measured: "forward + backward", cpu_s, change: change(&pair) })
    }

    /// Groups that a step does not learn.
    fn frozen(&self, skipped: &'static str, wanted: Wanted) -> Result<Row> {
        let mut pair = [Rasterizer::<f32>::new(), Rasterizer::<f32>::new()];
        let cpu_s = turn_by_turn(self.repeat, &mut |k| self.both(&mut pair[k], self.scene, [wanted, Wanted::ALL][k]))?;
        Ok(Row { skipped, measured: "forward + backward", cpu_s, change: [0.0; 2] })
    }

    /// One direction in forward mode, against the gradient of everything that this direction moves.
    fn one_direction(&self) -> Result<Row> {
        let velocities: Vec<[f32; 3]> = self.scene.positions.iter().map(|p| [0.1 * p[0], 0.1 * p[1], 1.0]).collect();
        let directions = [Direction::Motion(Motion { positions: &velocities, ..Motion::default() })];
        let mut pair = [Rasterizer::<f32>::new(), Rasterizer::<f32>::new()];
        let (mut along, mut back) = (0.0f64, 0.0f64);
        let cpu_s = turn_by_turn(self.repeat, &mut |k| {
            if k == 0 {
                let images = pair[0].render_tangent(self.scene, &self.view, &self.settings, None, &directions)?;
                along = images[0].iter().zip(&self.weights).map(|(d, w)| f64::from(d * w)).sum();
            } else {
                self.both(&mut pair[1], self.scene, Wanted::POSITIONS)?;
                let moved = pair[1].gradients().positions.as_flattened().iter().zip(velocities.as_flattened());
                back = moved.map(|(g, v)| f64::from(g * v)).sum();
            }
            Ok(())
        })?;
        let change = [0.0, ((back - along) / along).abs()];
        Ok(Row {
            skipped: "gradients where one direction is asked for (JVP)",
            measured: "forward + derivative",
            cpu_s,
            change,
        })
    }

    /// Lists of before, for new colours on the same geometry.
    fn lists(&self, skipped: &'static str) -> Result<Row> {
        let mut pair = [Rasterizer::<f32>::new(), Rasterizer::<f32>::new()];
        pair[0].reuse(Reuse::Unchanged);
        let mut scenes = [self.scene.clone(), self.scene.clone()];
        let cpu_s = turn_by_turn(self.repeat, &mut |k| {
            let scene = &mut scenes[k];
            scene.sh.iter_mut().for_each(|v| *v *= 0.999);
            self.both(&mut pair[k], scene, Wanted::SH)
        })?;
        Ok(Row { skipped, measured: "forward + backward", cpu_s, change: change(&pair) })
    }

    fn depth(&self) -> Result<Row> {
        let mut pair = [Rasterizer::<f32>::new(), Rasterizer::<f32>::new()];
        let settings = [DepthOutput::Skip, DepthOutput::Expected].map(|depth| Settings { depth, ..self.settings });
        let cpu_s =
            turn_by_turn(self.repeat, &mut |k| pair[k].render(self.scene, &self.view, &settings[k], None).map(drop))?;
        Ok(Row { skipped: "depth that nobody asks for", measured: "forward", cpu_s, change: [change(&pair)[0], 0.0] })
    }

    /// One step of SH on a scene of which a sixth is in sight: rows in sight, or all.
    fn optimiser(&self) -> Result<Row> {
        let hidden = tube::with_hidden(self.scene, 5);
        let mut rasterizer = Rasterizer::<f32>::new();
        self.both(&mut rasterizer, &hidden, Wanted::SH)?;
        let flags = [rasterizer.rendered().visible.clone(), vec![true; hidden.len()]];
        let mut learned = [hidden.sh.clone(), hidden.sh.clone()];
        let mut adams = [(); 2].map(|()| RowAdam::<12>::new(AdamConstants::default()));
        adams.iter_mut().for_each(|adam| adam.begin(hidden.len(), StepCounter::Restarted));
        let gradient = &rasterizer.gradients().sh;
        let cpu_s = turn_by_turn(self.repeat, &mut |k| {
            adams[k].step([1e-3; 12], &mut learned[k], gradient, &flags[k]);
            Ok(())
        })?;
        let change = [0.0, relative(&wide(&learned[1]), &wide(&learned[0]))];
        Ok(Row { skipped: "moments of what is out of sight", measured: "Adam's step of SH", cpu_s, change })
    }
}

/// All skips on one scene.
pub(super) fn rows(scene: &Gaussians<f32>, side: usize, repeat: usize) -> Result<Vec<Row>> {
    let weights = tube::image_gradient(3 * side * side);
    let bench = Bench { scene, view: tube::view(side), settings: tube::settings(), weights, repeat };
    let mut faint = scene.clone();
    faint.opacities.fill(0.1);
    let hidden = tube::with_hidden(scene, 5);
    Ok(vec![
        bench.switch("extents beyond an alpha of 1/255; opacity .95", Skips::EXTENTS, scene)?,
        bench.switch("extents beyond an alpha of 1/255; opacity .1", Skips::EXTENTS, &faint)?,
        bench.switch("blocks that the ellipse does not touch", Skips::BLOCKS, scene)?,
        bench.switch("groups beside the image; five times more out of sight", Skips::BESIDE, &hidden)?,
        bench.switch("splats behind a stopped pixel", Skips::STOP, scene)?,
        bench.frozen("all groups but SH (frozen)", Wanted::SH)?,
        bench.frozen("all groups but positions and shapes (frozen)", Wanted::POSITIONS | Wanted::SHAPES)?,
        bench.one_direction()?,
        bench.lists("splats and lists of unchanged geometry (Unchanged)")?,
        bench.depth()?,
        bench.optimiser()?,
    ])
}
