//! Free Gaussians: placed on the inspiration surface at first, tied to nothing afterwards. As with the discs, a frame
//! works on a compact copy of the visible ones.

use glam::DVec3;

use crate::base::TriangleMesh;
use crate::base::random::{CounterRng, Stage};
use crate::splat::{Gaussians, Gradients, Shape};

use super::anchored::{Rates, SH_C0, SH_DEGREE, SH_VALUES};
use super::optimiser::{AdamConstants, RowAdam, StepCounter};
use crate::reconstruct::geometry::neighbours;
use crate::reconstruct::settings::{FreeAppearance, GaussianSettings, PerFace};

/// All free Gaussians.
pub struct Free {
    /// Centres in mm, without the motion added to them.
    pub centres: Vec<[f32; 3]>,
    rotations: Vec<[f32; 4]>,
    log_scales: Vec<[f32; 3]>,
    opacity: f32,
    /// SH, 12 values each.
    pub sh: Vec<f32>,
}

impl Free {
    /// One at each face centroid if `gaussians_per_face` is 1, else that many per face at random points of the surface.
    pub fn new(mesh: &TriangleMesh, settings: &GaussianSettings, color: f32, seed: u64) -> Self {
        let centres: Vec<DVec3> = match *settings.gaussians_per_face {
            PerFace::Count(1) => {
                let centroid = |f: usize| mesh.corners(f).iter().sum::<DVec3>() / 3.0;
                (0..mesh.faces.len()).map(centroid).collect()
            }
            per_face => {
                let n = mesh.faces.len() * per_face.resolve(mesh.faces.len(), *settings.gaussian_budget);
                random_points(mesh, n, seed)
            }
        };
        let n = centres.len();
        let spacing = neighbours::spacing(&centres);
        let mut sh = vec![0.0; n * SH_VALUES];
        sh.chunks_exact_mut(SH_VALUES).for_each(|s| s[..3].fill((color - 0.5) / SH_C0));
        Free {
            centres: super::anchored::to_f32(&centres),
            rotations: vec![[1.0, 0.0, 0.0, 0.0]; n],
            log_scales: spacing.iter().map(|s| [(s * *settings.initial_scale).ln() as f32; 3]).collect(),
            opacity: *settings.opacity as f32,
            sh,
        }
    }

    /// Two standard deviations of each along its longest axis, in mm.
    pub fn sizes_mm(&self) -> Vec<f32> {
        self.log_scales.iter().map(|s| 2.0 * s[0].max(s[1]).max(s[2]).exp()).collect()
    }

    /// Copies those with the indices `ids` (ascending).
    pub fn patch(&self, ids: Vec<u32>) -> FreePatch {
        let at = |i: &u32| *i as usize;
        let log_scales: Vec<[f32; 3]> = ids.iter().map(|i| self.log_scales[at(i)]).collect();
        let sh = ids.iter().flat_map(|i| self.sh[at(i) * SH_VALUES..][..SH_VALUES].iter().copied()).collect();
        FreePatch {
            centres: ids.iter().map(|i| self.centres[at(i)]).collect(),
            rotations: ids.iter().map(|i| self.rotations[at(i)]).collect(),
            gaussians: Gaussians {
                positions: vec![[0.0; 3]; ids.len()],
                shape: Shape::Ellipsoids {
                    rotations: ids.iter().map(|i| self.rotations[at(i)]).collect(),
                    scales: log_scales.iter().map(|s| s.map(f32::exp)).collect(),
                },
                opacities: vec![self.opacity; ids.len()],
                sh,
                sh_degree: SH_DEGREE,
            },
            log_scales,
            ids,
        }
    }

    /// Writes back what a frame has learned.
    pub fn absorb(&mut self, patch: &FreePatch) {
        for (k, &i) in patch.ids.iter().enumerate() {
            let i = i as usize;
            self.centres[i] = patch.centres[k];
            self.rotations[i] = patch.rotations[k];
            self.log_scales[i] = patch.log_scales[k];
            self.sh[i * SH_VALUES..][..SH_VALUES].copy_from_slice(&patch.gaussians.sh[k * SH_VALUES..][..SH_VALUES]);
        }
    }
}

/// `n` points spread by area, face after face: stratified along the sum of areas, uniform within the face.
fn random_points(mesh: &TriangleMesh, n: usize, seed: u64) -> Vec<DVec3> {
    let mut rng = CounterRng::new(seed, Stage::Method, &[2]);
    let mut ends = Vec::with_capacity(mesh.faces.len());
    let mut sum = 0.0;
    for f in 0..mesh.faces.len() {
        sum += mesh.area_normal(f).length();
        ends.push(sum);
    }
    let mut points = Vec::with_capacity(n);
    let mut face = 0;
    for i in 0..n {
        let target = (i as f64 + rng.uniform()) / n as f64 * sum;
        while face + 1 < ends.len() && ends[face] < target {
            face += 1;
        }
        let (u, v) = (rng.uniform().sqrt(), rng.uniform());
        let [a, b, c] = mesh.corners(face);
        points.push(a * (1.0 - u) + b * (u * (1.0 - v)) + c * (u * v));
    }
    points
}

/// The Gaussians of [`Free`] that are visible in one frame.
pub struct FreePatch {
    /// Index of each in the whole, ascending.
    pub ids: Vec<u32>,
    /// Own centres (mm).
    pub centres: Vec<[f32; 3]>,
    /// Own quaternions.
    pub rotations: Vec<[f32; 4]>,
    log_scales: Vec<[f32; 3]>,
    /// The Gaussians as placed and rendered.
    pub gaussians: Gaussians<f32>,
}

impl From<&FreeAppearance> for Rates {
    /// Scales are not learned.
    fn from(settings: &FreeAppearance) -> Self {
        Rates {
            position: *settings.rates.position_rate,
            scale: 0.0,
            rotation: *settings.rotation_rate,
            sh_dc: *settings.rates.sh_dc_rate,
            sh_rest: *settings.rates.sh_rest_rate,
        }
    }
}

impl FreePatch {
    /// Puts own centre plus `shift(k)` and own quaternion plus `turn(k)` into the rendered copy.
    pub fn place(&mut self, shift: impl Fn(usize) -> [f32; 3], turn: impl Fn(usize) -> [f32; 4]) {
        let Shape::Ellipsoids { rotations, .. } = &mut self.gaussians.shape else {
            unreachable!("free Gaussians are made as ellipsoids")
        };
        for k in 0..self.ids.len() {
            let (s, t) = (shift(k), turn(k));
            self.gaussians.positions[k] = [0, 1, 2].map(|a| self.centres[k][a] + s[a]);
            rotations[k] = [0, 1, 2, 3].map(|a| self.rotations[k][a] + t[a]);
        }
    }

    /// One Adam step of the own parameters: of the groups that are learned, and of the Gaussians that have had
    /// a gradient in the frame.
    pub fn step(&mut self, adam: &mut FreeAdam, gradients: &Gradients<f32>) {
        let rates = adam.rates;
        if rates.position > 0.0 {
            let (centres, by_centre) = (self.centres.as_flattened_mut(), gradients.positions.as_flattened());
            adam.centres.step([rates.position; 3], centres, by_centre, &gradients.heard);
        }
        if rates.rotation > 0.0 {
            let (rotations, by_rotation) = (self.rotations.as_flattened_mut(), gradients.rotations.as_flattened());
            adam.rotations.step([rates.rotation; 4], rotations, by_rotation, &gradients.heard);
        }
        if rates.scale > 0.0 {
            let by_log: Vec<[f32; 3]> = gradients
                .scales
                .iter()
                .zip(&self.log_scales)
                .map(|(g, s)| [0, 1, 2].map(|k| g[k] * s[k].exp()))
                .collect();
            adam.scales.step(
                [rates.scale; 3],
                self.log_scales.as_flattened_mut(),
                by_log.as_flattened(),
                &gradients.heard,
            );
            if let Shape::Ellipsoids { scales, .. } = &mut self.gaussians.shape {
                scales.iter_mut().zip(&self.log_scales).for_each(|(scale, log)| *scale = log.map(f32::exp));
            }
        }
        if rates.learn_colors() {
            adam.sh.step(rates.sh(), &mut self.gaussians.sh, &gradients.sh, &gradients.heard);
        }
    }
}

/// Optimiser of a [`FreePatch`].
pub struct FreeAdam {
    /// The rates.
    pub rates: Rates,
    counter: StepCounter,
    centres: RowAdam<3>,
    rotations: RowAdam<4>,
    scales: RowAdam<3>,
    sh: RowAdam<SH_VALUES>,
}

impl FreeAdam {
    /// An optimiser with `rates`; a group whose rate is 0 stays as it is.
    pub fn new(rates: Rates, counter: StepCounter, constants: AdamConstants) -> Self {
        FreeAdam {
            rates,
            counter,
            centres: RowAdam::new(constants),
            rotations: RowAdam::new(constants),
            scales: RowAdam::new(constants),
            sh: RowAdam::new(constants),
        }
    }

    /// Zero moments for `n` Gaussians, in the groups that are learned.
    pub fn begin(&mut self, n: usize) {
        let rates = self.rates;
        if rates.position > 0.0 {
            self.centres.begin(n, self.counter);
        }
        if rates.rotation > 0.0 {
            self.rotations.begin(n, self.counter);
        }
        if rates.scale > 0.0 {
            self.scales.begin(n, self.counter);
        }
        if rates.learn_colors() {
            self.sh.begin(n, self.counter);
        }
    }
}
