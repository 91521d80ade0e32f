//! A scene in single precision against the same scene in double precision.

use super::row::StressRow;
use super::scenes::{Demand, StressItem};
use crate::base::Result;
use crate::base::random::{CounterRng, Stage};
use crate::experiments::difference::{gradient_groups, relative_l2, widened};
use crate::splat::{Footprint, ImageGradient, Rasterizer, SplatKernels, Wanted};

/// Largest relative error (L2) of an image that passes.
const IMAGE_LIMIT: f64 = 1e-3;
/// The same for the worst group of gradients.
const GRADIENT_LIMIT: f64 = 2e-2;

/// The depth image among the groups: checked for finite numbers with the rest; it is a quotient, and has no error of
/// its own to bound.
const DEPTH: &str = "depth";

/// The values of a group of gradients, with its name.
type NamedValues = (&'static str, Vec<f64>);

/// Image and gradients of one precision.
fn pass<T: SplatKernels>(item: &StressItem, rasterizer: &mut Rasterizer<T>) -> Result<(Vec<f64>, Vec<NamedValues>)> {
    let scene = item.scene.cast::<T>();
    let image = rasterizer.render(&scene, &item.view, &item.settings, None)?;
    let shown = [widened(&image.color), widened(&image.alpha)].concat();
    let depth = widened(&image.depth);
    // Independent of each other: weights that repeat cancel over large discs, and leave no gradient to compare.
    let r = &mut CounterRng::new(31, Stage::Test, &[]);
    let weights: Vec<T> = image.color.iter().map(|_| T::of(f64::from(r.range(-1.0, 1.0) as f32))).collect();
    let gradient = ImageGradient { color: &weights, ..ImageGradient::default() };
    // With the intrinsics wanted, the chain runs in the plain twin; without, in the vectorised kernels. Both are tried.
    let exact_fisheye = item.settings.footprint == Footprint::Disc && item.view.camera.fisheye.is_some();
    let lens = if exact_fisheye { [0.0; 4] } else { rasterizer.backward(&scene, &gradient, Wanted::LENS)?.lens };
    let gradients = rasterizer.backward(&scene, &gradient, Wanted::ALL)?;
    let mut groups = gradient_groups(gradients);
    groups.extend([("gain", gradients.gain.to_vec()), ("lens", lens.to_vec()), (DEPTH, depth)]);
    Ok((shown, groups))
}

/// The row of an item.
pub(super) fn compare(item: &StressItem) -> Result<StressRow> {
    let (image, found) = pass::<f32>(item, &mut Rasterizer::new())?;
    let (true_image, truth) = pass::<f64>(item, &mut Rasterizer::new())?;
    let lists = found.iter().map(|g| &g.1).chain([&image]);
    let not_finite = lists.flatten().filter(|v| !v.is_finite()).count();
    let image_error = relative_l2(&image, &true_image);
    let gradients = found.iter().zip(&truth).filter(|(group, _)| group.0 != DEPTH);
    let errors = gradients.map(|(group, truth)| (relative_l2(&group.1, &truth.1), group.0));
    let (gradient_error, worst_group) = errors.fold((0.0, "-"), |worst, e| if e.0 > worst.0 { e } else { worst });
    let near = image_error <= IMAGE_LIMIT && gradient_error <= GRADIENT_LIMIT;
    let accurate = item.demand == Demand::Accuracy;
    let passed = not_finite == 0 && (near || !accurate);
    Ok(StressRow { item: item.name.clone(), image_error, gradient_error, worst_group, not_finite, passed, accurate })
}
