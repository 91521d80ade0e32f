//! Discs on the triangles of a deforming mesh, and the backward pass of their gradients.
//!
//! Centre: `sum_j lambda_j v_j`, `lambda = softmax(logits)` (RESPIRE, Eq. 2). Axes, either
//! - [`DiscFrame::InheritStretch`]: two tangents, perpendicular unit vectors on the triangle *at rest*, are carried
//!   by the triangle's affine map, so that discs stretch, turn and shear with the tissue (as in GaMeS, Waczynska et
//!   al. 2024); `axis_k = exp(s_k) (a_k e1 + b_k e2)` with the edges `e1, e2` of the triangle as it is now; or
//! - [`DiscFrame::NormalOnly`]: BridgeSplat's released code, the shortest-arc rotation from +z to the normal, no
//!   stretch, `exp(s)` capped at twice its initial value.
//!
//! Triangles without area give discs without area, and no gradient through their normal.

use rayon::prelude::*;

use crate::base::{Error, Result};

use super::number::{Dual, Real, cross, dot};
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
#[derive(Clone, Debug, PartialEq)]
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
}

/// The mesh that carries the anchors, in one of its states; the faces are those that the anchors were made with.
#[derive(Clone, Copy, Debug)]
pub struct Carrier<'a, T> {
    /// Positions in mm.
    pub vertices: &'a [[T; 3]],
    /// Corner indices.
    pub faces: &'a [[u32; 3]],
}

fn subtract<T: Real>(a: [T; 3], b: [T; 3]) -> [T; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// `a x + b y`.
fn mix<T: Real>(a: T, x: [T; 3], b: T, y: [T; 3]) -> [T; 3] {
    [0, 1, 2].map(|k| a * x[k] + b * y[k])
}

fn softmax<T: Real>(logits: [T; 3]) -> [T; 3] {
    let top = logits[0].maximum(logits[1]).maximum(logits[2]);
    let e = logits.map(|v| (v - top).exp());
    let sum = e[0] + e[1] + e[2];
    e.map(|v| v / sum)
}

/// Unit normal and 1 / length of the cross product; length 0 where there is no area.
fn unit_normal<T: Real>(e1: [T; 3], e2: [T; 3]) -> ([T; 3], T) {
    let n = cross(e1, e2);
    let inverse = T::one() / dot(n, n).sqrt();
    if inverse.is_finite() { (n.map(|v| v * inverse), inverse) } else { ([T::zero(), T::zero(), T::one()], T::zero()) }
}

/// True where the shortest arc from +z to `n` is undefined; a half turn about the x axis replaces it.
fn points_back<T: Real>(n: [T; 3]) -> bool {
    n[2] < T::of(-0.999999)
}

/// First two columns of the shortest-arc rotation from +z to `n`.
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

/// One anchor on its triangle.
struct PlacedAnchor<T> {
    corners: [[T; 3]; 3],
    edges: [[T; 3]; 2],
    weights: [T; 3],
    scales: [T; 2],
    capped: [bool; 2],
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
                let [a, b, c] = rest.faces[f as usize].map(|v| rest.vertices[v as usize]);
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
        let anchors = Anchors { face, topology, logits, log_scales, frame, tangents, log_scale_limits: Vec::new() };
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

    fn on_triangle(&self, i: usize, carrier: Carrier<'_, T>) -> PlacedAnchor<T> {
        let corners = carrier.faces[self.face[i] as usize].map(|v| carrier.vertices[v as usize]);
        let mut capped = [false; 2];
        let mut scales = self.log_scales[i];
        if let Some(limits) = self.log_scale_limits.get(i) {
            for k in 0..2 {
                capped[k] = scales[k] > limits[k];
                scales[k] = scales[k].minimum(limits[k]);
            }
        }
        PlacedAnchor {
            corners,
            edges: [subtract(corners[1], corners[0]), subtract(corners[2], corners[0])],
            weights: softmax(self.logits[i]),
            scales: scales.map(T::exp),
            capped,
        }
    }

    /// Directions of the two axes, before the scales.
    fn directions(&self, i: usize, edges: [[T; 3]; 2]) -> [[T; 3]; 2] {
        match self.frame {
            DiscFrame::InheritStretch => self.tangents[i].map(|[a, b]| mix(a, edges[0], b, edges[1])),
            DiscFrame::NormalOnly => shortest_arc(unit_normal(edges[0], edges[1]).0),
        }
    }

    /// Puts the active discs onto the mesh: writes their positions and axes (nothing else) in `gaussians`.
    ///
    /// Errors: other lengths than the Gaussians', a shape other than discs, indices that do not exist.
    pub fn place(&self, carrier: Carrier<'_, T>, active: Option<&[u32]>, gaussians: &mut Gaussians<T>) -> Result<()> {
        self.check(carrier)?;
        let n = check_active(active, self.len())?;
        let Shape::Discs { axes } = &mut gaussians.shape else {
            return Err(Error::input("anchors place discs, not ellipsoids"));
        };
        if gaussians.positions.len() != self.len() || axes.len() != self.len() {
            return Err(Error::input("as many Gaussians as anchors are needed"));
        }
        let index = |j: usize| active.map_or(j, |list| list[j] as usize);
        // Ascending indices: the Gaussians of one chunk lie in one stretch of the arrays.
        let chunks = n.div_ceil(CHUNK);
        let end = |c: usize| if c == chunks { self.len() } else { index(c * CHUNK) };
        let start = |c: usize| if c == 0 { 0 } else { end(c) };
        let positions = cut(&mut gaussians.positions, (0..chunks).map(|c| end(c + 1) - start(c)));
        let axes = cut(axes, (0..chunks).map(|c| end(c + 1) - start(c)));
        positions.into_par_iter().zip(axes).enumerate().for_each(|(c, (positions, axes))| {
            for j in c * CHUNK..n.min((c + 1) * CHUNK) {
                let i = index(j);
                let anchor = self.on_triangle(i, carrier);
                let [a, b, d] = anchor.corners;
                let w = anchor.weights;
                positions[i - start(c)] = [0, 1, 2].map(|k| w[0] * a[k] + w[1] * b[k] + w[2] * d[k]);
                let directions = self.directions(i, anchor.edges);
                axes[i - start(c)] = [0, 1].map(|k| directions[k].map(|v| v * anchor.scales[k]));
            }
        });
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
            let anchor = self.on_triangle(i, carrier);
            let [a, b, c] = carrier.faces[self.face[i] as usize].map(|v| displacement[v as usize]);
            let w = anchor.weights;
            let edges = [subtract(b, a), subtract(c, a)];
            let directions = match self.frame {
                DiscFrame::InheritStretch => self.directions(i, edges),
                DiscFrame::NormalOnly => {
                    let moving = |e: usize| [0, 1, 2].map(|k| Dual::new(anchor.edges[e][k], edges[e][k]));
                    shortest_arc(unit_normal(moving(0), moving(1)).0).map(|v| v.map(|d| d.derivative))
                }
            };
            (
                i,
                [0, 1, 2].map(|k| w[0] * a[k] + w[1] * b[k] + w[2] * c[k]),
                [0, 1].map(|k| directions[k].map(|v| v * anchor.scales[k])),
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
                for (k, (by_logits, by_scales)) in logits.iter_mut().zip(log_scales).enumerate() {
                    let j = c * CHUNK + k;
                    let i = active.map_or(j, |list| list[j] as usize);
                    let anchor = self.on_triangle(i, carrier);
                    let by_weights = anchor.corners.map(|corner| dot(gradients.positions[j], corner));
                    let mean = dot(anchor.weights, by_weights);
                    *by_logits = [0, 1, 2].map(|k| anchor.weights[k] * (by_weights[k] - mean));
                    let directions = self.directions(i, anchor.edges);
                    *by_scales = [0, 1].map(|k| {
                        let slope = anchor.scales[k] * dot(gradients.axes[j][k], directions[k]);
                        if anchor.capped[k] { T::zero() } else { slope }
                    });
                }
            },
        );
        Ok(())
    }

    /// Gradients of the three corners of the triangle of anchor `i`.
    fn corner_gradients(&self, i: usize, carrier: Carrier<'_, T>, position: [T; 3], axes: [[T; 3]; 2]) -> [[T; 3]; 3] {
        let anchor = self.on_triangle(i, carrier);
        let [s0, s1] = anchor.scales;
        let scaled = [axes[0].map(|v| v * s0), axes[1].map(|v| v * s1)];
        let [e1, e2] = anchor.edges;
        let by_edges = match self.frame {
            DiscFrame::InheritStretch => {
                let [[a0, b0], [a1, b1]] = self.tangents[i];
                [mix(a0, scaled[0], a1, scaled[1]), mix(b0, scaled[0], b1, scaled[1])]
            }
            DiscFrame::NormalOnly => {
                let (n, inverse) = unit_normal(e1, e2);
                let by_n = shortest_arc_pullback(n, scaled);
                let along = dot(by_n, n);
                let by_cross = [0, 1, 2].map(|k| (by_n[k] - along * n[k]) * inverse);
                [cross(e2, by_cross), cross(by_cross, e1)]
            }
        };
        let w = anchor.weights;
        [
            [0, 1, 2].map(|k| w[0] * position[k] - by_edges[0][k] - by_edges[1][k]),
            [0, 1, 2].map(|k| w[1] * position[k] + by_edges[0][k]),
            [0, 1, 2].map(|k| w[2] * position[k] + by_edges[1][k]),
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
        vertices.clear();
        vertices.resize(carrier.vertices.len(), [T::zero(); 3]);
        for (j, (&position, &axes)) in gradients.positions.iter().zip(&gradients.axes).enumerate() {
            let i = active.map_or(j, |list| list[j] as usize);
            let by_corners = self.corner_gradients(i, carrier, position, axes);
            for (&vertex, by_corner) in carrier.faces[self.face[i] as usize].iter().zip(by_corners) {
                for k in 0..3 {
                    vertices[vertex as usize][k] += by_corner[k];
                }
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
                for (k, (&position, &axes)) in positions.iter().zip(axes).enumerate() {
                    let j = c * CHUNK + k;
                    let i = active.map_or(j, |list| list[j] as usize);
                    let by_corners = self.corner_gradients(i, carrier, position, axes);
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
