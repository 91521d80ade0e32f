//! Discs on a mesh, each in its face at barycentric coordinates that are a softmax of three logits (paper, Eq.
//! 1): all their parameters, and the compact copy ("patch") of those visible in one frame, on which the
//! optimiser works. Frozen or unseen parameters cost nothing.

use glam::DVec3;
use rayon::prelude::*;

use crate::base::random::{CounterRng, Stage};
use crate::base::{Result, TriangleMesh};
use crate::splat::{Anchors, Carrier, DiscFrame, Gaussians, Gradients, Wanted};

use super::optimiser::{AdamConstants, RowAdam, StepCounter};
use crate::reconstruct::geometry::neighbours;
use crate::reconstruct::settings::{AnchoredAppearance, DiscLayout};

/// SH degree of all methods here.
pub const SH_DEGREE: u8 = 1;
/// Values of SH per Gaussian.
pub const SH_VALUES: usize = 12;
/// First SH basis function.
pub const SH_C0: f32 = 0.282_094_8;

/// Factor by which the number of discs on a face grows at a time.
const SPLIT: usize = 4;

/// How the discs of a fresh surface lie in their faces, and their colour.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Start {
    /// Logits normal, colours uniform at random: the released BridgeSplat.
    Random,
    /// Spread evenly over the face, mid grey.
    Even,
}

/// All discs of a mesh.
pub struct Surface {
    /// Faces of the mesh.
    pub faces: Vec<[u32; 3]>,
    rest: Vec<[f32; 3]>,
    frame: DiscFrame,
    /// Discs that each face starts with: face `f` has those from `f * per_face` on.
    pub per_face: usize,
    /// Discs added later, per face.
    added: Vec<Vec<u32>>,
    opacity: f32,
    logits: Vec<[f32; 3]>,
    log_scales: Vec<[f32; 2]>,
    initial_log_scales: Vec<[f32; 2]>,
    cap: f64,
    /// SH, 12 values per disc.
    pub sh: Vec<f32>,
}

/// Positions in f32.
pub fn to_f32(vertices: &[DVec3]) -> Vec<[f32; 3]> {
    vertices.iter().map(|v| v.as_vec3().to_array()).collect()
}

/// Barycentric coordinates of disc `k` of `n` in its face: the R2 sequence folded into the triangle, kept off
/// its rim.
fn even_barycentrics(k: usize, n: usize) -> [f64; 3] {
    if n == 1 {
        return [1.0 / 3.0; 3];
    }
    let (mut u, mut v) = ((0.5 + k as f64 * 0.754_877_666) % 1.0, (0.5 + k as f64 * 0.569_840_291) % 1.0);
    if u + v > 1.0 {
        (u, v) = (1.0 - u, 1.0 - v);
    }
    [u, v, 1.0 - u - v].map(|b| 0.04 + 0.88 * b)
}

fn softmax(logits: [f32; 3]) -> [f32; 3] {
    let e = logits.map(f32::exp);
    e.map(|v| v / (e[0] + e[1] + e[2]))
}

/// Discs per task, at least, in loops with little work per disc.
const PIECE: usize = 4096;
/// Random numbers that the three logits of a disc take.
const LOGIT_DRAWS: u64 = 6;

fn every_disc(count: usize) -> impl IndexedParallelIterator<Item = usize> {
    (0..count).into_par_iter().with_min_len(PIECE)
}

impl Surface {
    /// Discs on `mesh` at rest.
    pub fn new(mesh: &TriangleMesh, layout: impl Into<DiscLayout>, frame: DiscFrame, start: Start, seed: u64) -> Self {
        let layout = layout.into();
        let per_face = layout.per_face.resolve(mesh.faces.len(), layout.budget);
        let n = mesh.faces.len() * per_face;
        let rng = CounterRng::new(seed, Stage::Method, &[1]);
        let logits: Vec<[f64; 3]> = every_disc(n)
            .map(|i| match start {
                Start::Random => {
                    let mut rng = rng.after(LOGIT_DRAWS * i as u64);
                    std::array::from_fn(|_| rng.normal())
                }
                Start::Even => even_barycentrics(i % per_face, per_face).map(f64::ln),
            })
            .collect();
        let centres: Vec<DVec3> = every_disc(n)
            .map(|i| {
                let e = logits[i].map(f64::exp);
                let [a, b, c] = mesh.corners(i / per_face);
                (a * e[0] + b * e[1] + c * e[2]) / (e[0] + e[1] + e[2])
            })
            .collect();
        let spacing = neighbours::spacing(&centres);
        let log_scales: Vec<[f32; 2]> =
            every_disc(n).map(|i| [(spacing[i] * layout.initial_scale).ln() as f32; 2]).collect();
        let mut sh = vec![0.0; n * SH_VALUES];
        if start == Start::Random {
            let colors = sh.par_chunks_exact_mut(SH_VALUES).enumerate().with_min_len(PIECE);
            colors.for_each(|(i, sh)| {
                let mut rng = rng.after(LOGIT_DRAWS * n as u64 + 3 * i as u64);
                sh[..3].fill_with(|| (rng.uniform() as f32 - 0.5) / SH_C0);
            });
        }
        Surface {
            faces: mesh.faces.clone(),
            rest: to_f32(&mesh.vertices),
            frame,
            per_face,
            added: vec![Vec::new(); mesh.faces.len()],
            opacity: layout.opacity as f32,
            logits: every_disc(n).map(|i| logits[i].map(|v| v as f32)).collect(),
            initial_log_scales: log_scales.clone(),
            log_scales,
            cap: layout.scale_cap,
            sh,
        }
    }

    /// How many discs there are.
    pub fn len(&self) -> usize {
        self.logits.len()
    }

    /// The discs of a face.
    pub fn discs_of(&self, face: u32) -> impl Iterator<Item = u32> {
        let n = self.per_face as u32;
        (face * n..(face + 1) * n).chain(self.added[face as usize].iter().copied())
    }

    /// Gives each of `faces` at least `wanted` discs (one number per face; a face never loses any). Where more are
    /// needed, their number is multiplied by [`SPLIT`] until it suffices, all discs of the face shrink so that they
    /// cover it as before, and each new one starts as a copy of the nearest old one. Returns the old disc of each new
    /// one; new ones are numbered from the former [`Surface::len`] on.
    pub fn refine(&mut self, faces: &[u32], wanted: &[f32]) -> Vec<u32> {
        let mut parents = Vec::new();
        for (&f, &wanted) in faces.iter().zip(wanted) {
            let old: Vec<u32> = self.discs_of(f).collect();
            let mut n = old.len();
            while (n as f32) < wanted {
                n *= SPLIT;
            }
            if n == old.len() {
                continue;
            }
            let shrink = 0.5 * (old.len() as f32 / n as f32).ln();
            for &i in &old {
                let i = i as usize;
                self.log_scales[i] = self.log_scales[i].map(|s| s + shrink);
                self.initial_log_scales[i] = self.initial_log_scales[i].map(|s| s + shrink);
            }
            let places: Vec<[f32; 3]> = old.iter().map(|&i| softmax(self.logits[i as usize])).collect();
            for k in old.len()..n {
                let place = even_barycentrics(k, n).map(|b| b as f32);
                let apart = |p: &[f32; 3]| (0..3).map(|c| (p[c] - place[c]).powi(2)).sum::<f32>();
                let nearest = (0..old.len()).min_by(|&a, &b| apart(&places[a]).total_cmp(&apart(&places[b])));
                let parent = old[nearest.expect("a face starts with a disc")] as usize;
                self.added[f as usize].push(self.logits.len() as u32);
                self.logits.push(place.map(f32::ln));
                self.log_scales.push(self.log_scales[parent]);
                self.initial_log_scales.push(self.initial_log_scales[parent]);
                self.sh.extend_from_within(parent * SH_VALUES..(parent + 1) * SH_VALUES);
                parents.push(parent as u32);
            }
        }
        parents
    }

    /// Copies the discs of `faces` (ascending) and the vertices they need.
    pub fn patch(&self, faces: &[u32]) -> Result<Patch> {
        let mut local = vec![u32::MAX; self.rest.len()];
        let mut vertices = Vec::new();
        let mut local_faces = Vec::with_capacity(faces.len());
        for &f in faces {
            local_faces.push(self.faces[f as usize].map(|v| {
                if local[v as usize] == u32::MAX {
                    local[v as usize] = vertices.len() as u32;
                    vertices.push(v);
                }
                local[v as usize]
            }));
        }
        let (mut discs, mut face) = (Vec::new(), Vec::new());
        for (local, &f) in faces.iter().enumerate() {
            discs.extend(self.discs_of(f));
            face.resize(discs.len(), local as u32);
        }
        let rest: Vec<[f32; 3]> = vertices.iter().map(|&v| self.rest[v as usize]).collect();
        let take = |i: &u32| *i as usize;
        let mut anchors = Anchors::new(
            self.frame,
            face,
            discs.par_iter().with_min_len(PIECE).map(|i| self.logits[take(i)]).collect(),
            discs.par_iter().with_min_len(PIECE).map(|i| self.log_scales[take(i)]).collect(),
            Carrier { vertices: &rest, faces: &local_faces },
        )?;
        if self.cap > 0.0 {
            let room = (self.cap as f32).ln();
            anchors.log_scale_limits =
                discs.iter().map(|i| self.initial_log_scales[take(i)].map(|s| s + room)).collect();
        }
        let mut gaussians = Gaussians::discs(discs.len(), SH_DEGREE, self.opacity);
        let colors = gaussians.sh.par_chunks_exact_mut(SH_VALUES).zip(&discs).with_min_len(PIECE);
        colors.for_each(|(to, i)| to.copy_from_slice(&self.sh[take(i) * SH_VALUES..][..SH_VALUES]));
        Ok(Patch {
            discs,
            vertices,
            faces: local_faces,
            anchors,
            gaussians,
            logit_step: Vec::new(),
            scale_step: Vec::new(),
        })
    }

    /// Writes back what a frame has learned.
    pub fn absorb(&mut self, patch: &Patch) {
        for (k, &i) in patch.discs.iter().enumerate() {
            let i = i as usize;
            self.logits[i] = patch.anchors.logits[k];
            self.log_scales[i] = patch.anchors.log_scales[k];
            self.sh[i * SH_VALUES..][..SH_VALUES].copy_from_slice(&patch.gaussians.sh[k * SH_VALUES..][..SH_VALUES]);
        }
    }
}

/// The discs of a [`Surface`] that are visible in one frame.
pub struct Patch {
    /// Index of each disc in the surface, face by face.
    pub discs: Vec<u32>,
    /// Index of each vertex in the mesh.
    pub vertices: Vec<u32>,
    faces: Vec<[u32; 3]>,
    anchors: Anchors<f32>,
    /// The discs, placed by [`Patch::place`].
    pub gaussians: Gaussians<f32>,
    logit_step: Vec<[f32; 3]>,
    scale_step: Vec<[f32; 2]>,
}

impl Patch {
    /// Picks this patch's entries of a per-vertex array of the mesh.
    pub fn pick(&self, all: &[[f32; 3]]) -> Vec<[f32; 3]> {
        self.vertices.par_iter().with_min_len(PIECE).map(|&v| all[v as usize]).collect()
    }

    fn carrier<'a>(&'a self, vertices: &'a [[f32; 3]]) -> Carrier<'a, f32> {
        Carrier { vertices, faces: &self.faces }
    }

    /// Puts the discs on the local `vertices`.
    pub fn place(&mut self, vertices: &[[f32; 3]]) -> Result<()> {
        let carrier = Carrier { vertices, faces: &self.faces };
        self.anchors.place(carrier, None, &mut self.gaussians)
    }

    /// Velocities of centres and axes while the local `vertices` move by `displacement` per unit of phase.
    pub fn place_tangent(
        &self,
        vertices: &[[f32; 3]],
        displacement: &[[f32; 3]],
        positions: &mut Vec<[f32; 3]>,
        axes: &mut Vec<[[f32; 3]; 2]>,
    ) -> Result<()> {
        self.anchors.place_tangent(self.carrier(vertices), displacement, None, positions, axes)
    }

    /// dL/dphase for vertices that move by `displacement` per unit of phase.
    pub fn phase_derivative(
        &self,
        gradients: &Gradients<f32>,
        vertices: &[[f32; 3]],
        displacement: &[[f32; 3]],
    ) -> Result<f64> {
        self.anchors.phase_pullback(gradients, self.carrier(vertices), None, displacement)
    }

    /// dL/dvertex, local vertices.
    pub fn vertex_gradient(
        &self,
        gradients: &Gradients<f32>,
        vertices: &[[f32; 3]],
        out: &mut Vec<[f32; 3]>,
    ) -> Result<()> {
        self.anchors.vertex_pullback(gradients, self.carrier(vertices), None, out)
    }

    /// One Adam step of logits, scales and SH: of the groups that `adam` learns, and of the discs that have
    /// had a gradient in the frame.
    pub fn step(&mut self, adam: &mut DiscAdam, gradients: &Gradients<f32>, vertices: &[[f32; 3]]) -> Result<()> {
        let rates = adam.rates;
        if rates.learn_geometry() {
            let (mut logits, mut scales) = (std::mem::take(&mut self.logit_step), std::mem::take(&mut self.scale_step));
            self.anchors.pullback(gradients, self.carrier(vertices), None, &mut logits, &mut scales)?;
            let parameters = self.anchors.logits.as_flattened_mut();
            adam.logits.step([rates.position; 3], parameters, logits.as_flattened(), &gradients.heard);
            let parameters = self.anchors.log_scales.as_flattened_mut();
            adam.scales.step([rates.scale; 2], parameters, scales.as_flattened(), &gradients.heard);
            (self.logit_step, self.scale_step) = (logits, scales);
        }
        if rates.learn_colors() {
            adam.sh.step(rates.sh(), &mut self.gaussians.sh, &gradients.sh, &gradients.heard);
        }
        Ok(())
    }
}

/// Adam rates of appearance.
#[derive(Clone, Copy, Debug)]
pub struct Rates {
    /// Logits, or mm.
    pub position: f64,
    /// Log scales.
    pub scale: f64,
    /// Quaternions.
    pub rotation: f64,
    /// Constant SH.
    pub sh_dc: f64,
    /// Linear SH.
    pub sh_rest: f64,
}

impl Rates {
    /// The rates that settings name, each times `factor`.
    pub fn new(settings: impl Into<Rates>, factor: f64) -> Self {
        let Rates { position, scale, rotation, sh_dc, sh_rest } = settings.into();
        Rates {
            position: position * factor,
            scale: scale * factor,
            rotation: rotation * factor,
            sh_dc: sh_dc * factor,
            sh_rest: sh_rest * factor,
        }
    }

    /// Whether centres, rotations or scales are learned at all.
    pub fn learn_geometry(&self) -> bool {
        self.position > 0.0 || self.rotation > 0.0 || self.scale > 0.0
    }

    /// Whether colours are.
    pub fn learn_colors(&self) -> bool {
        self.sh_dc > 0.0 || self.sh_rest > 0.0
    }

    /// Groups of gradients that a step at these rates needs.
    pub fn groups(&self) -> Wanted {
        let geometry = if self.learn_geometry() { Wanted::POSITIONS | Wanted::SHAPES } else { Wanted::NONE };
        if self.learn_colors() { geometry | Wanted::SH } else { geometry }
    }

    /// The rate of each SH coefficient.
    pub fn sh(&self) -> [f64; SH_VALUES] {
        std::array::from_fn(|k| if k < 3 { self.sh_dc } else { self.sh_rest })
    }
}

impl From<&AnchoredAppearance> for Rates {
    fn from(settings: &AnchoredAppearance) -> Self {
        Rates {
            position: *settings.rates.position_rate,
            scale: *settings.scale_rate,
            rotation: 0.0,
            sh_dc: *settings.rates.sh_dc_rate,
            sh_rest: *settings.rates.sh_rest_rate,
        }
    }
}

/// Adam's constants. With `quiet_share`, a Gaussian that contributes less than a colour that fills this share of the
/// picture moves little; with the published epsilon of 1e-15 it would move at full speed. A share means the same at every
/// size of the picture, since a Gaussian covers more pixels of a larger one.
pub fn adam_constants(quiet_share: f64) -> AdamConstants {
    let (published, channels) = (AdamConstants::default(), 3.0);
    AdamConstants { epsilon: published.epsilon.max(quiet_share * SH_C0 as f64 / channels), ..published }
}

/// Optimiser of a patch.
pub struct DiscAdam {
    /// The rates, which a schedule may change.
    pub rates: Rates,
    counter: StepCounter,
    logits: RowAdam<3>,
    scales: RowAdam<2>,
    sh: RowAdam<SH_VALUES>,
}

impl DiscAdam {
    /// An optimiser with `rates`.
    pub fn new(rates: Rates, counter: StepCounter, constants: AdamConstants) -> Self {
        let (logits, scales) = (RowAdam::new(constants), RowAdam::new(constants));
        DiscAdam { rates, counter, logits, scales, sh: RowAdam::new(constants) }
    }

    /// Zero moments for a patch of `discs` discs, in the groups that are learned.
    pub fn begin(&mut self, discs: usize) {
        if self.rates.learn_geometry() {
            self.logits.begin(discs, self.counter);
            self.scales.begin(discs, self.counter);
        }
        if self.rates.learn_colors() {
            self.sh.begin(discs, self.counter);
        }
    }

    /// [`RowAdam::touched_rows_and_room`] of logits, scales, SH.
    #[cfg(test)]
    pub fn touched_rows_and_room(&self) -> [(usize, usize); 3] {
        [self.logits.touched_rows_and_room(), self.scales.touched_rows_and_room(), self.sh.touched_rows_and_room()]
    }
}
