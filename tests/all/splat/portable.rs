//! AVX2 and AVX-512 give the same bits (decision 0017): images, gradients of every group, exact discs, derivatives.
//! Signs of zeros aside: a block more in a conservative mask adds +0 to a -0. On a processor without AVX-512 there is
//! nothing to compare, and the tests say so; `scripts/test-processors.sh` compares whole films and fits there.

use respire_bench::splat::{
    Direction, Filter, Footprint, Gradients, Isa, Rasterizer, Rendered, Settings, View, Wanted,
};

use super::scenes::{Kind, Lens, Weights, random, tube, view};
use crate::skip::skip;

/// The bits of numbers, both zeros alike.
fn bits<'a>(values: impl IntoIterator<Item = &'a f32>) -> Vec<u32> {
    values.into_iter().map(|v| (v + 0.0).to_bits()).collect()
}

fn image(r: &Rendered<f32>) -> Vec<u32> {
    bits(r.color.iter().chain(&r.alpha).chain(&r.depth))
}

fn gradients(g: &Gradients<f32>) -> Vec<(&'static str, Vec<u32>)> {
    let doubles = |v: &[f64]| v.iter().flat_map(|v| [v.to_bits() as u32, (v.to_bits() >> 32) as u32]).collect();
    vec![
        ("positions", bits(g.positions.as_flattened())),
        ("rotations", bits(g.rotations.as_flattened())),
        ("scales", bits(g.scales.as_flattened())),
        ("axes", bits(g.axes.as_flattened().as_flattened())),
        ("opacities", bits(&g.opacities)),
        ("sh", bits(&g.sh)),
        ("pose", doubles(&g.pose)),
        ("gain", doubles(&g.gain)),
        ("lens", doubles(&g.lens)),
    ]
}

/// The two instruction sets, or a word that there is only one.
fn both() -> Option<[Isa; 2]> {
    if Isa::Avx512.available().is_ok() {
        return Some([Isa::Avx2, Isa::Avx512]);
    }
    skip("avx512", "this processor has no AVX-512 to compare AVX2 with");
    None
}

/// Everything that a scene gives, by name.
fn results(isa: Isa, seed: u64, settings: &Settings, kind: Kind, lens: Lens) -> Vec<(&'static str, Vec<u32>)> {
    let scene = random(300, kind, 2, seed).cast::<f32>();
    let view = view(lens);
    let mut rasterizer = Rasterizer::<f32>::with_isa(isa).unwrap();
    let mut all = vec![("image", image(rasterizer.render(&scene, &view, settings, None).unwrap()))];
    let weights: Weights<f32> = Weights::new(43 * 29, seed);
    all.extend(gradients(rasterizer.backward(&scene, &weights.gradient(), Wanted::ALL).unwrap()));
    if settings.footprint == Footprint::Ewa {
        let directions: Vec<Direction<'_, f32>> =
            (0..3).map(|k| Direction::Pose(std::array::from_fn(|i| if i == k { 1.0 } else { 0.0 }))).collect();
        let velocities = rasterizer.render_tangent(&scene, &view, settings, None, &directions).unwrap();
        for velocity in velocities {
            all.push(("velocity", bits(velocity)));
        }
    }
    all
}

fn compare(seed: u64, settings: &Settings, kind: Kind, lens: Lens, isas: [Isa; 2]) {
    let [narrow, wide] = isas.map(|isa| results(isa, seed, settings, kind, lens));
    for ((name, narrow), (_, wide)) in narrow.iter().zip(&wide) {
        assert_eq!(narrow.len(), wide.len(), "scene {seed}: {name}");
        let off = narrow.iter().zip(wide).filter(|(a, b)| a != b).count();
        assert_eq!(off, 0, "scene {seed}: {name}: {off} of {} values differ", narrow.len());
    }
}

#[test]
fn instruction_sets_give_the_same_bits() {
    let Some(isas) = both() else { return };
    for seed in 0..24 {
        let settings = Settings {
            background: [0.2, 0.1, 0.4],
            gain: [0.9, 1.1, 1.3],
            filter: if seed % 4 < 2 { Filter::Dilate } else { Filter::Compensate },
            ..Settings::default()
        };
        let kind = if seed % 2 == 0 { Kind::Ellipsoids } else { Kind::Discs };
        let lens = if seed % 3 == 0 { Lens::Fisheye } else { Lens::Pinhole };
        compare(seed, &settings, kind, lens, isas);
    }
}

#[test]
fn instruction_sets_give_the_same_bits_for_exact_discs() {
    let Some(isas) = both() else { return };
    for seed in 0..12 {
        let settings = Settings { footprint: Footprint::Disc, ..Settings::default() };
        compare(seed, &settings, Kind::Discs, if seed % 3 == 0 { Lens::Fisheye } else { Lens::Pinhole }, isas);
    }
}

/// Sums over a hundred and more entries a tile, pixels that stop.
#[test]
fn instruction_sets_give_the_same_bits_in_a_tube() {
    let Some(isas) = both() else { return };
    let Some((scene, view)) = tube("tube_20k.npz", 256) else { return };
    let of = |isa| tube_results(isa, &scene.cast(), &view);
    let [narrow, wide] = isas.map(of);
    for ((name, narrow), (_, wide)) in narrow.iter().zip(&wide) {
        assert!(narrow == wide, "{name} differ");
    }
}

fn tube_results(isa: Isa, scene: &respire_bench::splat::Gaussians<f32>, view: &View) -> Vec<(&'static str, Vec<u32>)> {
    let mut rasterizer = Rasterizer::<f32>::with_isa(isa).unwrap();
    let mut all = vec![("image", image(rasterizer.render(scene, view, &Settings::default(), None).unwrap()))];
    let weights: Weights<f32> = Weights::new((view.camera.width * view.camera.height) as usize, 5);
    all.extend(gradients(rasterizer.backward(scene, &weights.gradient(), Wanted::ALL).unwrap()));
    all
}
