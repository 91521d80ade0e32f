//! `respire-bench stress`: the numerical-stability table. A fixed matrix of scenes that go wrong in single precision, each
//! rendered and differentiated in f32 (fastest kernels) and in f64 (plain twin), and the image metrics on frames without
//! contrast against their closed form.

use std::path::PathBuf;

use clap::Args;
use glam::DAffine3;
use serde::Serialize;

use super::Terminal;
use crate::base::random::{CounterRng, Stage};
use crate::base::{Camera, Error, ErrorKind, Image, Result, files};
use crate::score::image_quality::ssim;
use crate::splat::{Gaussians, Gradients, ImageGradient, Rasterizer, Real, Settings, Shape, View, Wanted};

/// Largest relative error (L2) of an image that passes.
const IMAGE_LIMIT: f64 = 1e-3;
/// The same for the worst group of gradients.
const GRADIENT_LIMIT: f64 = 2e-2;

/// Arguments of `stress`.
#[derive(Args)]
#[command(
    after_help = "Writes stress.csv into DIR when given. Fails when a number is not finite or an error is larger than\n\
    1e-3 (image) or 2e-2 (worst group of gradients) relative to double precision; of values of 3e38, which single\n\
    precision cannot square, only finite results are asked.\n\
    Example: respire-bench stress --out /tmp/stress"
)]
pub struct Arguments {
    /// Folder for the table
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Leave out the items with a million Gaussians and 4096x4096 pixels
    #[arg(long)]
    small: bool,
    /// The table as JSON
    #[arg(long)]
    json: bool,
}

/// One line of the table.
#[derive(Clone, Serialize)]
struct Row {
    item: String,
    image_error: f64,
    gradient_error: f64,
    worst_group: &'static str,
    not_finite: usize,
    passed: bool,
}

/// What an item must show.
#[derive(Clone, Copy, PartialEq)]
enum Demand {
    /// The numbers of double precision.
    Accuracy,
    /// Finite numbers: its values overflow in single precision, where their Gaussians are left out, and not in double.
    Finite,
}

/// A scene of the matrix.
struct Item {
    demand: Demand,
    name: String,
    scene: Gaussians<f32>,
    view: View,
    settings: Settings,
}

fn view(width: u32, height: u32) -> View {
    View::new(Camera::pinhole(width, height, 90f64.to_radians()), DAffine3::IDENTITY)
}

/// `n` discs on a wall 4 to 9 mm before the camera, of about `size` mm.
fn wall(n: usize, size: f64, seed: u64) -> Gaussians<f32> {
    let r = &mut CounterRng::new(seed, Stage::Test, &[n as u64]);
    let mut scene = Gaussians::<f32>::discs(n, 1, 0.8);
    let mut axes = Vec::with_capacity(n);
    for position in &mut scene.positions {
        let z = r.range(4.0, 9.0);
        *position = [z * r.range(-1.1, 1.1), z * r.range(-1.1, 1.1), z].map(|v| v as f32);
        let mut axis = || [0, 1, 2].map(|_| (size * r.normal()) as f32);
        axes.push([axis(), axis()]);
    }
    scene.shape = Shape::Discs { axes };
    scene.sh.iter_mut().for_each(|v| *v = (0.3 * r.normal()) as f32);
    scene
}

fn axes_of(scene: &mut Gaussians<f32>) -> &mut [[[f32; 3]; 2]] {
    match &mut scene.shape {
        Shape::Discs { axes } => axes,
        Shape::Ellipsoids { .. } => &mut [],
    }
}

fn scaled(factor: f32) -> Item {
    let mut scene = wall(400, 0.5, 1);
    scene.positions.iter_mut().flatten().for_each(|v| *v *= factor);
    axes_of(&mut scene).iter_mut().flatten().flatten().for_each(|v| *v *= factor);
    let near_mm = 0.2 * f64::from(factor);
    Item { settings: Settings { near_mm, ..Settings::default() }, ..item(&format!("scene scale {factor:e}"), scene) }
}

fn item(name: &str, scene: Gaussians<f32>) -> Item {
    Item { demand: Demand::Accuracy, name: name.into(), scene, view: view(96, 80), settings: Settings::default() }
}

/// A scene of `wall` after a change.
fn changed(name: &str, seed: u64, change: impl Fn(&mut Gaussians<f32>, &mut CounterRng)) -> Item {
    let mut scene = wall(400, 0.5, seed);
    change(&mut scene, &mut CounterRng::new(seed, Stage::Test, &[99]));
    item(name, scene)
}

/// The shapes, places and opacities of the matrix.
fn geometry() -> Vec<Item> {
    let mut items: Vec<Item> = [1e-3, 1e-2, 0.1, 1.0, 10.0, 100.0, 1e3].map(scaled).into();
    items
        .push(changed("needles, 1:10000", 2, |s, _| axes_of(s).iter_mut().for_each(|a| a[1] = a[1].map(|v| v * 1e-4))));
    items.push(changed("no area", 3, |s, _| axes_of(s).iter_mut().for_each(|a| a[1] = a[0])));
    items.push(changed("no extent", 4, |s, _| axes_of(s).fill([[0.0; 3]; 2])));
    items.push(changed("coincident", 5, |s, _| {
        let place = s.positions[0];
        s.positions.fill([0.3, 0.2, place[2]]);
    }));
    items.push(changed("depth ties", 6, |s, _| s.positions.iter_mut().for_each(|p| p[2] = 5.0)));
    items.push(changed("behind the camera", 7, |s, _| s.positions.iter_mut().for_each(|p| p[2] = -p[2])));
    items.push(changed("on and across the near plane", 8, |s, r| {
        s.positions.iter_mut().for_each(|p| p[2] = [0.2, 0.199, 0.201, 0.25, 3.0][r.index(5)]);
        axes_of(s).iter_mut().flatten().flatten().for_each(|v| *v *= 0.05);
    }));
    items.push(changed("camera touches the wall", 9, |s, _| {
        s.positions.iter_mut().for_each(|p| *p = [0.05 * p[0], 0.05 * p[1], 0.2 + 0.05 * p[2]]);
        axes_of(s).iter_mut().flatten().flatten().for_each(|v| *v *= 0.05);
    }));
    items.push(changed("edge-on", 10, |s, _| {
        let places = s.positions.clone();
        for (axes, p) in axes_of(s).iter_mut().zip(places) {
            // One axis along the ray: the disc is a line.
            axes[0] = p.map(|v| 0.1 * v);
        }
    }));
    items.push(changed("smaller than a pixel", 11, |s, _| {
        axes_of(s).iter_mut().flatten().flatten().for_each(|v| *v *= 1e-3);
    }));
    items.push(changed("fills the screen", 12, |s, _| {
        axes_of(s).iter_mut().flatten().flatten().for_each(|v| *v *= 40.0);
    }));
    for opacity in [0.0, 1.0 / 255.0, 0.999, 1.0] {
        items.push(changed(&format!("opacity {opacity:.4}"), 13, |s, _| s.opacities.fill(opacity)));
    }
    items
}

/// Sizes of scene and image.
fn sizes(small: bool) -> Vec<Item> {
    let mut items = vec![item("one Gaussian", wall(1, 2.0, 20)), item("no Gaussian", wall(0, 1.0, 21))];
    items.push(Item { view: view(1, 1), ..item("1x1 pixel", wall(400, 0.5, 22)) });
    if !small {
        items.push(item("1000000 Gaussians", wall(1_000_000, 0.02, 23)));
        items.push(Item { view: view(4096, 4096), ..item("4096x4096 pixels", wall(400, 0.5, 24)) });
    }
    items
}

/// Every poison in every array.
fn poisons() -> Vec<Item> {
    let values = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e-40, 3e38];
    let mut items = Vec::new();
    for (k, value) in values.into_iter().enumerate() {
        let poisoned = |name: &str, place: fn(&mut Gaussians<f32>, usize, f32)| {
            let demand = if value == 3e38 { Demand::Finite } else { Demand::Accuracy };
            let scene = changed(&format!("{value:e} in {name}"), 30 + k as u64, |s, r| {
                (0..40).for_each(|_| place(s, r.index(400), value));
            });
            Item { demand, ..scene }
        };
        items.push(poisoned("positions", |s, i, v| s.positions[i][i % 3] = v));
        items.push(poisoned("axes", |s, i, v| axes_of(s)[i][i % 2][i % 3] = v));
        items.push(poisoned("opacities", |s, i, v| s.opacities[i] = v));
        items.push(poisoned("SH", |s, i, v| s.sh[12 * i + i % 12] = v));
    }
    items
}

/// All values of all groups, by name.
fn groups<T: Real>(g: &Gradients<T>) -> [(&'static str, Vec<f64>); 6] {
    let wide = |v: &[T]| v.iter().map(|v| v.to_f64()).collect::<Vec<f64>>();
    [
        ("positions", wide(g.positions.as_flattened())),
        ("axes", wide(g.axes.as_flattened().as_flattened())),
        ("opacities", wide(&g.opacities)),
        ("sh", wide(&g.sh)),
        ("pose", g.pose.to_vec()),
        ("gain", g.gain.to_vec()),
    ]
}

/// `|a - b| / |b|`, L2; 0 where both vanish.
fn relative(a: &[f64], b: &[f64]) -> f64 {
    let norm = b.iter().map(|v| v * v).sum::<f64>().sqrt();
    let difference = a.iter().zip(b).map(|(x, y)| (x - y).powi(2)).sum::<f64>().sqrt();
    if difference == 0.0 { 0.0 } else { difference / norm }
}

/// Image and gradients of one precision.
fn pass<T: Real>(item: &Item, rasterizer: &mut Rasterizer<T>) -> Result<(Vec<f64>, Vec<(&'static str, Vec<f64>)>)> {
    let scene = item.scene.cast::<T>();
    let image = rasterizer.render(&scene, &item.view, &item.settings, None)?;
    let all: Vec<f64> = image.color.iter().chain(&image.alpha).map(|v| v.to_f64()).collect();
    let depths: Vec<f64> = image.depth.iter().map(|v| v.to_f64()).collect();
    let weights: Vec<T> = (0..image.color.len()).map(|k| T::of(((k * 7919) % 1009) as f64 / 504.0 - 1.0)).collect();
    let gradient = ImageGradient { color: &weights, ..ImageGradient::default() };
    let gradients = rasterizer.backward(&scene, &gradient, Wanted::ALL)?;
    let mut groups: Vec<_> = groups(gradients).into();
    // Depth is checked for finite numbers with the rest; it is a quotient, and has no error of its own to bound.
    groups.push(("depth", depths));
    Ok((all, groups))
}

fn measure(item: &Item) -> Result<Row> {
    let (image, found) = pass::<f32>(item, &mut Rasterizer::new())?;
    let (true_image, truth) = pass::<f64>(item, &mut Rasterizer::new())?;
    let lists = found.iter().map(|g| &g.1).chain([&image]);
    let not_finite = lists.flatten().filter(|v| !v.is_finite()).count();
    let image_error = relative(&image, &true_image);
    let errors = found.iter().zip(&truth).filter(|(f, _)| f.0 != "depth").map(|(f, t)| (relative(&f.1, &t.1), f.0));
    let (gradient_error, worst_group) = errors.fold((0.0, "-"), |worst, e| if e.0 > worst.0 { e } else { worst });
    let accurate = image_error <= IMAGE_LIMIT && gradient_error <= GRADIENT_LIMIT;
    let passed = not_finite == 0 && (accurate || item.demand == Demand::Finite);
    Ok(Row { item: item.name.clone(), image_error, gradient_error, worst_group, not_finite, passed })
}

/// SSIM of two constant frames against its closed form, `(2ab + C1) / (a^2 + b^2 + C1)`.
fn flat_frames(a: u8, b: u8) -> Result<Row> {
    let frame = |code: u8| Image { width: 32, height: 24, channels: 3, data: vec![code; 32 * 24 * 3] };
    let found = ssim(&frame(a), &frame(b))?.valid.unwrap_or(f64::NAN);
    let (x, y) = (f64::from(a) / 255.0, f64::from(b) / 255.0);
    let truth = (2.0 * x * y + 1e-4) / (x * x + y * y + 1e-4);
    let image_error = (found / truth - 1.0).abs();
    let not_finite = usize::from(!found.is_finite());
    Ok(Row {
        item: format!("SSIM of constant frames {a} and {b}"),
        image_error,
        gradient_error: 0.0,
        worst_group: "-",
        not_finite,
        passed: not_finite == 0 && image_error <= 1e-6,
    })
}

fn table(rows: &[Row]) -> String {
    let mut text = "item,image_error,gradient_error,worst_group,not_finite,passed\n".to_string();
    for r in rows {
        let (image, gradient) = (r.image_error, r.gradient_error);
        text += &format!("{},{image:e},{gradient:e},{},{},{}\n", r.item, r.worst_group, r.not_finite, r.passed);
    }
    text
}

/// Runs the command.
pub fn run(arguments: Arguments, terminal: &Terminal) -> Result<()> {
    let mut rows = Vec::new();
    for item in geometry().into_iter().chain(sizes(arguments.small)).chain(poisons()) {
        terminal.stage(&item.name);
        rows.push(measure(&item)?);
    }
    for (a, b) in [(0, 0), (255, 255), (0, 255), (128, 128), (1, 0)] {
        rows.push(flat_frames(a, b)?);
    }
    if let Some(folder) = &arguments.out {
        files::write_bytes(&folder.join("stress.csv"), table(&rows).replace(", ", " ").as_bytes())?;
    }
    if arguments.json {
        terminal.json(&rows)?;
    } else {
        terminal.line(format!("{:<34} {:>9} {:>9} {:<10} not finite", "item", "image", "gradient", "worst"));
        for r in &rows {
            let mark = if r.passed { "" } else { "  FAILED" };
            let (image, gradient) = (r.image_error, r.gradient_error);
            terminal.line(format!(
                "{:<34} {image:>9.1e} {gradient:>9.1e} {:<10} {}{mark}",
                r.item, r.worst_group, r.not_finite
            ));
        }
    }
    let failed = rows.iter().filter(|r| !r.passed).count();
    if failed > 0 {
        return Err(Error::new(ErrorKind::CellFailed, format!("{failed} of {} items failed", rows.len())));
    }
    Ok(())
}
