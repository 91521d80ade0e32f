//! Discs on the triangles of a deforming mesh, and the backward pass of their gradients.
//!
//! Centre: `sum_j lambda_j v_j`, `lambda = softmax(logits)` (RESPIRE, Eq. 1). Axes, either
//! - [`DiscFrame::InheritStretch`]: two tangents, perpendicular unit vectors on the triangle *at rest*, are carried
//!   by the triangle's affine map, so that discs stretch, turn and shear with the tissue (as in GaMeS, Waczynska et
//!   al. 2024); `axis_k = exp(s_k) (a_k e1 + b_k e2)` with the edges `e1, e2` of the triangle as it is now; or
//! - [`DiscFrame::NormalOnly`]: BridgeSplat's released code, the shortest-arc rotation from +z to the normal, no
//!   stretch, `exp(s)` capped at twice its initial value.
//!
//! Triangles without area give discs without area, and no gradient through their normal.

use rayon::prelude::*;

use crate::base::{Error, Result};

use super::number::{Dual, Each, Real, cross, dot};
use super::pass::cut;
use super::types::{Gaussians, Gradients, Shape};

/// Anchors per task; sums over anchors go in these chunks.
const CHUNK: usize = 512;

/// What a disc inherits from its triangle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DiscFrame {
    /// Translation, rotation and stretch.
    InheritStretch,
    /// Translation and the direction of the normal.
    NormalOnly,
}

/// Discs tied to triangles.
#[derive(Clone, Debug)]
pub struct Anchors<T> {
    /// Triangle of each disc; checked once, at construction.
    face: Vec<u32>,
    /// How many faces and vertices the mesh has.
    topology: [usize; 2],
    /// Barycentric logits.
    pub logits: Vec<[T; 3]>,
    /// Logarithms of the two half axes (mm, standard deviations).
    pub log_scales: Vec<[T; 2]>,
    /// What is inherited.
    pub frame: DiscFrame,
    /// `(a_k, b_k)` of the two rest tangents in the edges of the rest triangle; for `InheritStretch`.
    pub tangents: Vec<[[T; 2]; 2]>,
    /// Upper limits of `log_scales`; empty for none.
    pub log_scale_limits: Vec<[T; 2]>,
    /// Form of each anchor when it was last placed: exponentials are most of the work, and few anchors change.
    forms: Vec<AnchorForm<T>>,
}

/// What follows from the parameters of an anchor alone, with the parameters that it was made of.
#[derive(Clone, Copy, Debug)]
struct AnchorForm<T> {
    logits: [T; 3],
    /// Within their limits.
    log_scales: [T; 2],
    weights: [T; 3],
    scales: [T; 2],
}

impl<T: Real> AnchorForm<T> {
    fn of(logits: [T; 3], log_scales: [T; 2]) -> Self {
        AnchorForm { logits, log_scales, weights: softmax(logits), scales: [log_scales[0].exp(), log_scales[1].exp()] }
    }
}

/// The mesh that carries the anchors, in one of its states; the faces are those that the anchors were made with.
#[derive(Clone, Copy, Debug)]
pub struct Carrier<'a, T> {
    /// Positions in mm.
    pub vertices: &'a [[T; 3]],
    /// Corner indices.
    pub faces: &'a [[u32; 3]],
}

/// Arrays are compared by a call that is not inlined, here once for each disc and pass.
#[inline(always)]
fn equal<T: Real, const N: usize>(a: [T; N], b: [T; N]) -> bool {
    let mut equal = true;
    for k in 0..N {
        equal &= a[k] == b[k];
    }
    equal
}

#[inline(always)]
fn subtract<T: Real>(a: [T; 3], b: [T; 3]) -> [T; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// `a x + b y`.
#[inline(always)]
fn mix<T: Real>(a: T, x: [T; 3], b: T, y: [T; 3]) -> [T; 3] {
    [0, 1, 2].each(|k| a * x[k] + b * y[k])
}

#[inline(always)]
fn softmax<T: Real>(logits: [T; 3]) -> [T; 3] {
    let top = logits[0].maximum(logits[1]).maximum(logits[2]);
    let e = [0, 1, 2].each(|k| (logits[k] - top).exp());
    let sum = e[0] + e[1] + e[2];
    [0, 1, 2].each(|k| e[k] / sum)
}

/// Unit normal and 1 / length of the cross product; length 0 where there is no area.
#[inline(always)]
fn unit_normal<T: Real>(e1: [T; 3], e2: [T; 3]) -> ([T; 3], T) {
    let n = cross(e1, e2);
    let inverse = T::one() / dot(n, n).sqrt();
    if inverse.is_finite() { (n.each(|v| v * inverse), inverse) } else { ([T::zero(), T::zero(), T::one()], T::zero()) }
}

/// True where the shortest arc from +z to `n` is undefined; a half turn about the x axis replaces it.
#[inline(always)]
fn points_back<T: Real>(n: [T; 3]) -> bool {
    n[2] < T::of(-0.999999)
}

/// First two columns of the shortest-arc rotation from +z to `n`.
#[inline(always)]
fn shortest_arc<T: Real>(n: [T; 3]) -> [[T; 3]; 2] {
    let (zero, one) = (T::zero(), T::one());
    if points_back(n) {
        return [[one, zero, zero], [zero, -one, zero]];
    }
    let h = one / (one + n[2]);
    let shared = -n[0] * n[1] * h;
    [[one - n[0] * n[0] * h, shared, -n[0]], [shared, one - n[1] * n[1] * h, -n[1]]]
}

/// Gradient with respect to `n` of a loss with gradients `g` of the columns of [`shortest_arc`].
#[inline(always)]
fn shortest_arc_pullback<T: Real>(n: [T; 3], g: [[T; 3]; 2]) -> [T; 3] {
    if points_back(n) {
        return [T::zero(); 3];
    }
    let h = T::one() / (T::one() + n[2]);
    let (two, shared) = (T::of(2.0), g[0][1] + g[1][0]);
    [
        -two * n[0] * h * g[0][0] - n[1] * h * shared - g[0][2],
        -two * n[1] * h * g[1][1] - n[0] * h * shared - g[1][2],
        h * h * (n[0] * n[0] * g[0][0] + n[0] * n[1] * shared + n[1] * n[1] * g[1][1]),
    ]
}

/// A triangle that carries anchors, with what they all inherit from it.
#[derive(Clone, Copy)]
struct PlacedFace<T> {
    face: u32,
    corners: [[T; 3]; 3],
    edges: [[T; 3]; 2],
    /// Unit normal and 1 / length of the cross product of the edges, and the shortest arc to it; for `NormalOnly`.
    normal: ([T; 3], T),
    arc: [[T; 3]; 2],
}

impl<T: Real> PlacedFace<T> {
    fn new(frame: DiscFrame, face: u32, carrier: Carrier<'_, T>) -> Self {
        let corners = carrier.faces[face as usize].each(|v| carrier.vertices[v as usize]);
        let edges = [subtract(corners[1], corners[0]), subtract(corners[2], corners[0])];
        let (normal, arc) = match frame {
            DiscFrame::InheritStretch => (([T::zero(); 3], T::zero()), [[T::zero(); 3]; 2]),
            DiscFrame::NormalOnly => {
                let normal = unit_normal(edges[0], edges[1]);
                (normal, shortest_arc(normal.0))
            }
        };
        PlacedFace { face, corners, edges, normal, arc }
    }
}

/// The face of one anchor after another: anchors of a face stand together, so that it is seldom made anew.
struct FaceWalk<'a, T> {
    frame: DiscFrame,
    carrier: Carrier<'a, T>,
    at: Option<PlacedFace<T>>,
}

impl<'a, T: Real> FaceWalk<'a, T> {
    fn new(frame: DiscFrame, carrier: Carrier<'a, T>) -> Self {
        FaceWalk { frame, carrier, at: None }
    }

    #[inline(always)]
    fn to(&mut self, face: u32) -> &PlacedFace<T> {
        if self.at.as_ref().is_none_or(|at| at.face != face) {
            self.at = None;
        }
        self.at.get_or_insert_with(|| PlacedFace::new(self.frame, face, self.carrier))
    }
}

/// True where a loss does not depend on an anchor: then no parameter and no vertex gets anything from it.
#[inline(always)]
fn silent<T: Real>(position: &[T; 3], axes: &[[T; 3]; 2]) -> bool {
    let zero = |v: &[T; 3]| (v[0] == T::zero()) & (v[1] == T::zero()) & (v[2] == T::zero());
    zero(position) & zero(&axes[0]) & zero(&axes[1])
}

impl<T: Real> Anchors<T> {
    /// Anchors on the mesh at rest. The first tangent runs along the first edge of the triangle.
    ///
    /// Errors: arrays that differ in length, a face or vertex that does not exist.
    pub fn new(
        frame: DiscFrame,
        face: Vec<u32>,
        logits: Vec<[T; 3]>,
        log_scales: Vec<[T; 2]>,
        rest: Carrier<'_, T>,
    ) -> Result<Self> {
        let topology = [rest.faces.len(), rest.vertices.len()];
        if let Some(&face) = face.iter().find(|&&f| f as usize >= rest.faces.len()) {
            return Err(Error::input("an anchor names a face that does not exist").element(format!("face {face}")));
        }
        let vertices = rest.vertices.len();
        if let Some(face) = rest.faces.iter().position(|f| f.iter().any(|&v| v as usize >= vertices)) {
            return Err(Error::input("a face names a vertex that does not exist").element(format!("face {face}")));
        }
        let tangents = face
            .iter()
            .map(|&f| {
                let [a, b, c] = rest.faces[f as usize].each(|v| rest.vertices[v as usize]);
                let (e1, e2) = (subtract(b, a), subtract(c, a));
                let inverse = T::one() / dot(e1, e1).sqrt();
                let along = dot(e1, e2) * inverse * inverse;
                let across = mix(T::one(), e2, -along, e1);
                let inverse_across = T::one() / dot(across, across).sqrt();
                let tangents = [[inverse, T::zero()], [-along * inverse_across, inverse_across]];
                let usable = tangents.iter().flatten().all(|v| v.is_finite());
                if usable { tangents } else { [[T::zero(); 2]; 2] }
            })
            .collect();
        let (log_scale_limits, forms) = (Vec::new(), Vec::new());
        let anchors = Anchors { face, topology, logits, log_scales, frame, tangents, log_scale_limits, forms };
        anchors.check(rest)?;
        Ok(anchors)
    }

    /// Triangle of each disc.
    pub fn faces(&self) -> &[u32] {
        &self.face
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.face.len()
    }

    /// True when there is none.
    pub fn is_empty(&self) -> bool {
        self.face.is_empty()
    }

    /// Checks lengths only, since this runs at every call and inactive anchors must cost nothing.
    fn check(&self, carrier: Carrier<'_, T>) -> Result<()> {
        let n = self.len();
        let limits = self.log_scale_limits.len();
        if [self.logits.len(), self.log_scales.len(), self.tangents.len()] != [n; 3] || (limits != 0 && limits != n) {
            return Err(Error::input("the arrays of the anchors differ in length"));
        }
        if [carrier.faces.len(), carrier.vertices.len()] != self.topology {
            return Err(Error::input("the mesh has another number of faces or vertices than at rest"));
        }
        Ok(())
    }

    fn check_gradients(&self, gradients: &Gradients<T>, carrier: Carrier<'_, T>, active: Option<&[u32]>) -> Result<()> {
        self.check(carrier)?;
        let n = check_active(active, self.len())?;
        if gradients.positions.len() != n || gradients.axes.len() != n {
            return Err(Error::input(
                "anchors need the gradients of positions and disc axes of the same active Gaussians",
            ));
        }
        Ok(())
    }

    /// The log scales of anchor `i` within their limits, and which of them are at them.
    #[inline(always)]
    fn limited(&self, i: usize) -> ([T; 2], [bool; 2]) {
        let scales = self.log_scales[i];
        let Some(limits) = self.log_scale_limits.get(i) else { return (scales, [false; 2]) };
        let limited = [scales[0].minimum(limits[0]), scales[1].minimum(limits[1])];
        (limited, [scales[0] > limits[0], scales[1] > limits[1]])
    }

    /// The form of anchor `i`, from `known` if that was made of the same parameters.
    #[inline(always)]
    fn form(&self, i: usize, known: Option<&AnchorForm<T>>) -> AnchorForm<T> {
        let (logits, log_scales) = (self.logits[i], self.limited(i).0);
        match known {
            Some(form) if equal(form.logits, logits) & equal(form.log_scales, log_scales) => *form,
            _ => AnchorForm::of(logits, log_scales),
        }
    }

    /// Directions of the two axes, before the scales.
    #[inline(always)]
    fn directions(&self, i: usize, face: &PlacedFace<T>) -> [[T; 3]; 2] {
        match self.frame {
            DiscFrame::InheritStretch => self.stretched(i, face.edges),
            DiscFrame::NormalOnly => face.arc,
        }
    }

    /// The tangents of anchor `i` at rest, carried along by `edges`.
    #[inline(always)]
    fn stretched(&self, i: usize, edges: [[T; 3]; 2]) -> [[T; 3]; 2] {
        let [[a0, b0], [a1, b1]] = self.tangents[i];
        [mix(a0, edges[0], b0, edges[1]), mix(a1, edges[0], b1, edges[1])]
    }

    /// Puts the active discs onto the mesh: writes their positions and axes (nothing else) in `gaussians`.
    ///
    /// Errors: other lengths than the Gaussians', a shape other than discs, indices that do not exist.
    pub fn place(
        &mut self,
        carrier: Carrier<'_, T>,
        active: Option<&[u32]>,
        gaussians: &mut Gaussians<T>,
    ) -> Result<()> {
        self.check(carrier)?;
        let n = check_active(active, self.len())?;
        let Shape::Discs { axes } = &mut gaussians.shape else {
            return Err(Error::input("anchors place discs, not ellipsoids"));
        };
        if gaussians.positions.len() != self.len() || axes.len() != self.len() {
            return Err(Error::input("as many Gaussians as anchors are needed"));
        }
        let index = |j: usize| active.map_or(j, |list| list[j] as usize);
        let mut forms = std::mem::take(&mut self.forms);
        if forms.len() != self.len() {
            // Of parameters that equal none.
            let nothing = AnchorForm {
                logits: [T::of(f64::NAN); 3],
                log_scales: [T::zero(); 2],
                weights: [T::zero(); 3],
                scales: [T::zero(); 2],
            };
            forms.clear();
            forms.resize(self.len(), nothing);
        }
        // Ascending indices: the Gaussians of one chunk lie in one stretch of the arrays.
        let chunks = n.div_ceil(CHUNK);
        let end = |c: usize| if c == chunks { self.len() } else { index(c * CHUNK) };
        let start = |c: usize| if c == 0 { 0 } else { end(c) };
        let lengths = || (0..chunks).map(|c| end(c + 1) - start(c));
        let tables = cut(&mut gaussians.positions, lengths()).into_par_iter().zip(cut(axes, lengths()));
        tables.zip(cut(&mut forms, lengths())).enumerate().for_each(|(c, ((positions, axes), forms))| {
            let mut walk = FaceWalk::new(self.frame, carrier);
            for j in c * CHUNK..n.min((c + 1) * CHUNK) {
                let (i, place) = (index(j), index(j) - start(c));
                let face = walk.to(self.face[i]);
                let form = self.form(i, Some(&forms[place]));
                forms[place] = form;
                let (w, [a, b, d]) = (form.weights, face.corners);
                positions[place] = [0, 1, 2].each(|k| w[0] * a[k] + w[1] * b[k] + w[2] * d[k]);
                let [first, second] = self.directions(i, face);
                axes[place] =
                    [[0, 1, 2].each(|k| first[k] * form.scales[0]), [0, 1, 2].each(|k| second[k] * form.scales[1])];
            }
        });
        self.forms = forms;
        Ok(())
    }

    /// Velocities of the positions and axes of the active discs (those of the others stay unchanged) when the
    /// vertices move by `displacement` per unit of phase: the derivative of [`Anchors::place`], for
    /// [`super::Motion`]. `positions` and `axes` get one entry per anchor.
    ///
    /// Errors: as [`Anchors::place`]; another number of displacements than of vertices.
    pub fn place_tangent(
        &self,
        carrier: Carrier<'_, T>,
        displacement: &[[T; 3]],
        active: Option<&[u32]>,
        positions: &mut Vec<[T; 3]>,
        axes: &mut Vec<[[T; 3]; 2]>,
    ) -> Result<()> {
        self.check(carrier)?;
        let n = check_active(active, self.len())?;
        if displacement.len() != carrier.vertices.len() {
            return Err(Error::input("one displacement per vertex is needed"));
        }
        positions.resize(self.len(), [T::zero(); 3]);
        axes.resize(self.len(), [[T::zero(); 3]; 2]);
        let velocity = |j: usize| {
            let i = active.map_or(j, |list| list[j] as usize);
            let form = self.form(i, self.forms.get(i));
            let corners = carrier.faces[self.face[i] as usize];
            let [a, b, c] = corners.each(|v| displacement[v as usize]);
            let w = form.weights;
            let edges = [subtract(b, a), subtract(c, a)];
            let [first, second] = match self.frame {
                DiscFrame::InheritStretch => self.stretched(i, edges),
                DiscFrame::NormalOnly => {
                    let [a, b, c] = corners.each(|v| carrier.vertices[v as usize]);
                    let still = [subtract(b, a), subtract(c, a)];
                    let moving = |e: usize| [0, 1, 2].each(|k| Dual::new(still[e][k], edges[e][k]));
                    shortest_arc(unit_normal(moving(0), moving(1)).0).each(|v| v.each(|d| d.derivative))
                }
            };
            (
                i,
                [0, 1, 2].each(|k| w[0] * a[k] + w[1] * b[k] + w[2] * c[k]),
                [[0, 1, 2].each(|k| first[k] * form.scales[0]), [0, 1, 2].each(|k| second[k] * form.scales[1])],
            )
        };
        let velocities: Vec<_> = (0..n).into_par_iter().with_min_len(CHUNK).map(velocity).collect();
        for (i, position, axis) in velocities {
            (positions[i], axes[i]) = (position, axis);
        }
        Ok(())
    }

    /// Gradients of logits and log scales, one per active anchor, from the gradients of positions and axes.
    pub fn pullback(
        &self,
        gradients: &Gradients<T>,
        carrier: Carrier<'_, T>,
        active: Option<&[u32]>,
        logits: &mut Vec<[T; 3]>,
        log_scales: &mut Vec<[T; 2]>,
    ) -> Result<()> {
        self.check_gradients(gradients, carrier, active)?;
        let n = gradients.positions.len();
        logits.resize(n, [T::zero(); 3]);
        log_scales.resize(n, [T::zero(); 2]);
        logits.par_chunks_mut(CHUNK).zip(log_scales.par_chunks_mut(CHUNK)).enumerate().for_each(
            |(c, (logits, log_scales))| {
                let mut walk = FaceWalk::new(self.frame, carrier);
                for (k, (by_logits, by_scales)) in logits.iter_mut().zip(log_scales).enumerate() {
                    let j = c * CHUNK + k;
                    if gradients.is_unheard(j) || silent(&gradients.positions[j], &gradients.axes[j]) {
                        (*by_logits, *by_scales) = ([T::zero(); 3], [T::zero(); 2]);
                        continue;
                    }
                    let (position, axes) = (gradients.positions[j], gradients.axes[j]);
                    let i = active.map_or(j, |list| list[j] as usize);
                    let face = walk.to(self.face[i]);
                    let form = self.form(i, self.forms.get(i));
                    let by_weights = [0, 1, 2].each(|k| dot(position, face.corners[k]));
                    let mean = dot(form.weights, by_weights);
                    *by_logits = [0, 1, 2].each(|k| form.weights[k] * (by_weights[k] - mean));
                    let (directions, (_, capped)) = (self.directions(i, face), self.limited(i));
                    *by_scales = [0, 1].each(|k| {
                        let slope = form.scales[k] * dot(axes[k], directions[k]);
                        if capped[k] { T::zero() } else { slope }
                    });
                }
            },
        );
        Ok(())
    }

    /// Gradients of the three corners of the triangle of anchor `i`.
    #[inline(always)]
    fn corner_gradients(&self, i: usize, face: &PlacedFace<T>, position: [T; 3], axes: [[T; 3]; 2]) -> [[T; 3]; 3] {
        let form = self.form(i, self.forms.get(i));
        let [s0, s1] = form.scales;
        let scaled = [[0, 1, 2].each(|k| axes[0][k] * s0), [0, 1, 2].each(|k| axes[1][k] * s1)];
        let [e1, e2] = face.edges;
        let by_edges = match self.frame {
            DiscFrame::InheritStretch => {
                let [[a0, b0], [a1, b1]] = self.tangents[i];
                [mix(a0, scaled[0], a1, scaled[1]), mix(b0, scaled[0], b1, scaled[1])]
            }
            DiscFrame::NormalOnly => {
                let (n, inverse) = face.normal;
                let by_n = shortest_arc_pullback(n, scaled);
                let along = dot(by_n, n);
                let by_cross = [0, 1, 2].each(|k| (by_n[k] - along * n[k]) * inverse);
                [cross(e2, by_cross), cross(by_cross, e1)]
            }
        };
        let w = form.weights;
        [
            [0, 1, 2].each(|k| w[0] * position[k] - by_edges[0][k] - by_edges[1][k]),
            [0, 1, 2].each(|k| w[1] * position[k] + by_edges[0][k]),
            [0, 1, 2].each(|k| w[2] * position[k] + by_edges[1][k]),
        ]
    }

    /// Gradient of every mesh vertex (zero for vertices without an active disc), summed in the order of the discs.
    pub fn vertex_pullback(
        &self,
        gradients: &Gradients<T>,
        carrier: Carrier<'_, T>,
        active: Option<&[u32]>,
        vertices: &mut Vec<[T; 3]>,
    ) -> Result<()> {
        self.check_gradients(gradients, carrier, active)?;
        let by_corners = |c: usize, positions: &[[T; 3]], axes: &[[[T; 3]; 2]]| -> Vec<(u32, [[T; 3]; 3])> {
            let mut walk = FaceWalk::new(self.frame, carrier);
            let mut found = Vec::with_capacity(positions.len());
            for (k, (position, axes)) in positions.iter().zip(axes).enumerate() {
                let j = c * CHUNK + k;
                if !gradients.is_unheard(j) && !silent(position, axes) {
                    let i = active.map_or(j, |list| list[j] as usize);
                    let face = self.face[i];
                    found.push((face, self.corner_gradients(i, walk.to(face), *position, *axes)));
                }
            }
            found
        };
        let chunks = gradients.positions.par_chunks(CHUNK).zip(gradients.axes.par_chunks(CHUNK)).enumerate();
        let found: Vec<_> = chunks.map(|(c, (positions, axes))| by_corners(c, positions, axes)).collect();
        vertices.clear();
        vertices.resize(carrier.vertices.len(), [T::zero(); 3]);
        for (face, by_corners) in found.into_iter().flatten() {
            for (&vertex, by_corner) in carrier.faces[face as usize].iter().zip(by_corners) {
                let sum = &mut vertices[vertex as usize];
                *sum = [0, 1, 2].each(|k| sum[k] + by_corner[k]);
            }
        }
        Ok(())
    }

    /// Derivative of the loss along a motion of the mesh: `sum over vertices of gradient . displacement`, without the
    /// gradient of the vertices. With `displacement = expiration - inspiration` this is dL/dphase.
    pub fn phase_pullback(
        &self,
        gradients: &Gradients<T>,
        carrier: Carrier<'_, T>,
        active: Option<&[u32]>,
        displacement: &[[T; 3]],
    ) -> Result<f64> {
        self.check_gradients(gradients, carrier, active)?;
        if displacement.len() != carrier.vertices.len() {
            return Err(Error::input("one displacement per vertex is needed"));
        }
        let sums: Vec<f64> = gradients
            .positions
            .par_chunks(CHUNK)
            .zip(gradients.axes.par_chunks(CHUNK))
            .enumerate()
            .map(|(c, (positions, axes))| {
                let mut sum = 0.0;
                let mut walk = FaceWalk::new(self.frame, carrier);
                for (k, (position, axes)) in positions.iter().zip(axes).enumerate() {
                    let j = c * CHUNK + k;
                    if gradients.is_unheard(j) || silent(position, axes) {
                        continue;
                    }
                    let i = active.map_or(j, |list| list[j] as usize);
                    let by_corners = self.corner_gradients(i, walk.to(self.face[i]), *position, *axes);
                    for (&vertex, by_corner) in carrier.faces[self.face[i] as usize].iter().zip(by_corners) {
                        sum += dot(by_corner, displacement[vertex as usize]).to_f64();
                    }
                }
                sum
            })
            .collect();
        Ok(sums.iter().sum())
    }
}

fn check_active(active: Option<&[u32]>, n: usize) -> Result<usize> {
    let Some(list) = active else { return Ok(n) };
    if list.windows(2).any(|w| w[0] >= w[1]) || list.last().is_some_and(|&last| last as usize >= n) {
        return Err(Error::input("active indices must ascend and name existing anchors"));
    }
    Ok(list.len())
}
