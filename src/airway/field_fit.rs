//! Fits a [`BreathingField`] to landmark pairs: penalised regression with a thin-plate kernel on few centres.
//!
//!   minimise  sum_i m_i |u(x_i) - d_i|^2 + lambda * sum_axis w^T K w,   K_jk = phi(|c_j - c_k|),   P^T w = 0
//!
//! after Wood (J R Stat Soc B 65:95, 2003; thin-plate regression splines with knots) and Hardy's multiquadric. The side
//! condition P^T w = 0 (weights orthogonal to 1, x, y, z) is solved exactly through w = Z v with Z an orthonormal basis
//! of the null space. lambda is the one of a fixed ladder that predicts held-out landmarks best (five folds, every
//! fifth pair). Anchors (`mass` m_i > 1) hold the top of the trachea. Left out: reweighting of outliers.

use glam::DVec3;
use nalgebra::{DMatrix, DVector};

use super::field::{BreathingField, UNIT_MM};
use crate::base::range::COORDINATE_MM;
use crate::base::{Error, Result};
use crate::formats::landmarks::LandmarkPair;

/// Candidates for the smoothing strength lambda.
pub const LAMBDAS: [f64; 10] = [1e-3, 3e-3, 1e-2, 3e-2, 1e-1, 3e-1, 1.0, 3.0, 10.0, 30.0];

/// A point whose motion is stated rather than measured.
#[derive(Clone, Copy, Debug)]
pub struct Anchor {
    /// Where, at inspiration, mm.
    pub position_mm: DVec3,
    /// Motion to expiration, mm.
    pub motion_mm: DVec3,
    /// Weight relative to a landmark.
    pub mass: f64,
}

/// Inputs of a fit besides the landmarks.
#[derive(Clone, Debug)]
pub struct FitSettings {
    /// Written to the case file: data set, citation, placement.
    pub source: String,
    /// Centres of the kernel, mm; none may be a landmark itself.
    pub centers_mm: Vec<DVec3>,
    /// Softening length of the kernel in mm.
    pub softening_mm: f64,
    /// Points of stated motion.
    pub anchors: Vec<Anchor>,
}

/// How well a fit describes the landmarks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FitQuality {
    /// Smoothing strength used.
    pub lambda: f64,
    /// Mean motion of the landmarks, mm.
    pub motion_mm: f64,
    /// Mean distance between fitted and true motion of the landmarks fitted to, mm.
    pub fitted_mm: f64,
    /// The same for landmarks that were held out (five folds), mm.
    pub held_out_mm: f64,
    /// What the best affine field leaves of held-out landmarks, mm.
    pub affine_held_out_mm: f64,
}

/// Grid points of `spacing_mm` near the landmarks or the airway, thinned to `count` by farthest-point choice.
pub fn choose_centers(near: &[DVec3], spacing_mm: f64, reach_mm: f64, count: usize) -> Vec<DVec3> {
    let (low, high) =
        near.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), &p| (low.min(p), high.max(p)));
    let steps = ((high - low) / spacing_mm).floor();
    let mut candidates = Vec::new();
    for i in 0..=steps.x as usize {
        for j in 0..=steps.y as usize {
            for k in 0..=steps.z as usize {
                let rest = (high - low - steps * spacing_mm) / 2.0;
                let p = low + rest + DVec3::new(i as f64, j as f64, k as f64) * spacing_mm;
                if near.iter().any(|q| q.distance_squared(p) < reach_mm * reach_mm) {
                    candidates.push(p);
                }
            }
        }
    }
    let mut distance2 = vec![f64::INFINITY; candidates.len()];
    let mut chosen = Vec::new();
    let mut next = 0;
    while chosen.len() < count.min(candidates.len()) {
        let center = candidates[next];
        // The case file keeps tenths of a millimetre.
        chosen.push((center * 10.0).round() / 10.0);
        for (d, c) in distance2.iter_mut().zip(&candidates) {
            *d = d.min(c.distance_squared(center));
        }
        next = (0..candidates.len()).fold(0, |best, c| if distance2[c] > distance2[best] { c } else { best });
    }
    chosen
}

/// Rejects landmark lists that are too short for any field, and landmarks that lie in no scanner.
pub fn check_pairs(pairs: &[LandmarkPair]) -> Result<()> {
    for (number, pair) in pairs.iter().enumerate() {
        let coordinates = pair.inspiration_mm.to_array().into_iter().chain(pair.expiration_mm.to_array());
        coordinates
            .into_iter()
            .try_for_each(|v| COORDINATE_MM.check(v))
            .map_err(|e| e.element(format!("pair {number}")))?;
    }
    if pairs.len() < 10 {
        return Err(Error::input(format!("{} landmark pairs are too few for a breathing field (10)", pairs.len())));
    }
    Ok(())
}

/// The best field for `pairs`. `min_lambda` forbids less smoothing (0 allows all).
pub fn fit(pairs: &[LandmarkPair], settings: &FitSettings, min_lambda: f64) -> Result<(BreathingField, FitQuality)> {
    check_pairs(pairs)?;
    let origin = pairs.iter().map(|p| p.inspiration_mm).sum::<DVec3>() / pairs.len() as f64;
    let basis = Basis::new((origin * 10.0).round() / 10.0, settings)?;
    let ladder: Vec<f64> = LAMBDAS.iter().copied().filter(|l| *l >= min_lambda).collect();
    let mut best: Option<(f64, f64)> = None;
    for &lambda in &ladder {
        let error = held_out_error(pairs, &basis, settings, lambda)?;
        if best.is_none_or(|(_, e)| error < e) {
            best = Some((lambda, error));
        }
    }
    let (lambda, held_out_mm) =
        best.ok_or_else(|| Error::input(format!("no smoothing strength is left above {min_lambda}")))?;
    // The affine comparison leaves out the anchors, which no affine motion could follow.
    let unanchored = FitSettings { anchors: vec![], ..settings.clone() };
    let affine_held_out_mm = held_out_error(pairs, &basis, &unanchored, 1e9)?;
    let field = basis.solve(pairs, settings, lambda)?;
    let count = pairs.len() as f64;
    let quality = FitQuality {
        lambda,
        motion_mm: pairs.iter().map(|p| p.motion_mm().length()).sum::<f64>() / count,
        fitted_mm: pairs.iter().map(|p| miss_mm(&field, p)).sum::<f64>() / count,
        held_out_mm,
        affine_held_out_mm,
    };
    Ok((field, quality))
}

fn miss_mm(field: &BreathingField, pair: &LandmarkPair) -> f64 {
    (field.displacement(pair.inspiration_mm) - pair.motion_mm()).length()
}

/// Mean error of five-fold cross-validation: on every fifth pair, fitted to the other four fifths.
fn held_out_error(pairs: &[LandmarkPair], basis: &Basis, settings: &FitSettings, lambda: f64) -> Result<f64> {
    let mut sum = 0.0;
    for fold in 0..5 {
        let kept: Vec<LandmarkPair> = (0..pairs.len()).filter(|i| i % 5 != fold).map(|i| pairs[i]).collect();
        let field = basis.solve(&kept, settings, lambda)?;
        sum += (fold..pairs.len()).step_by(5).map(|i| miss_mm(&field, &pairs[i])).sum::<f64>();
    }
    Ok(sum / pairs.len() as f64)
}

/// The kernel's centres and the null space of their affine moments.
struct Basis {
    origin: DVec3,
    centers: Vec<DVec3>,
    soft2: f64,
    /// Orthonormal columns that span all weights w with P^T w = 0.
    null_space: DMatrix<f64>,
    /// Z^T K Z.
    penalty: DMatrix<f64>,
}

impl Basis {
    fn new(origin: DVec3, settings: &FitSettings) -> Result<Self> {
        let count = settings.centers_mm.len();
        if count < 8 {
            return Err(Error::input(format!("{count} centres are too few for a breathing field (8)")));
        }
        let centers: Vec<DVec3> = settings.centers_mm.iter().map(|&c| (c - origin) / UNIT_MM).collect();
        let soft2 = (settings.softening_mm / UNIT_MM).powi(2);
        let moments = DMatrix::from_fn(count, 4, |j, k| affine_terms(centers[j])[k]);
        // The columns of Q after the fourth of a full QR span the orthogonal complement: pad to a square matrix.
        let mut square = DMatrix::<f64>::zeros(count, count + 4);
        square.view_mut((0, 0), (count, 4)).copy_from(&moments);
        square.view_mut((0, 4), (count, count)).copy_from(&DMatrix::identity(count, count));
        let q = square.qr().q();
        let null_space = q.columns(4, count - 4).into_owned();
        let kernel = DMatrix::from_fn(count, count, |j, k| phi(centers[j] - centers[k], soft2));
        let penalty = null_space.transpose() * kernel * &null_space;
        Ok(Basis { origin, centers, soft2, null_space, penalty })
    }

    /// Values of all basis functions at a point: affine terms, then the null-space kernels.
    fn row(&self, point_mm: DVec3) -> DVector<f64> {
        let x = (point_mm - self.origin) / UNIT_MM;
        let kernels = DVector::from_fn(self.centers.len(), |j, _| phi(x - self.centers[j], self.soft2));
        let reduced = self.null_space.transpose() * kernels;
        let affine = affine_terms(x);
        DVector::from_fn(4 + reduced.len(), |k, _| if k < 4 { affine[k] } else { reduced[k - 4] })
    }

    fn solve(&self, pairs: &[LandmarkPair], settings: &FitSettings, lambda: f64) -> Result<BreathingField> {
        let unknowns = 4 + self.null_space.ncols();
        let mut normal = DMatrix::<f64>::zeros(unknowns, unknowns);
        let mut right = DMatrix::<f64>::zeros(unknowns, 3);
        let measured = pairs.iter().map(|p| (p.inspiration_mm, p.motion_mm(), 1.0));
        let stated = settings.anchors.iter().map(|a| (a.position_mm, a.motion_mm, a.mass));
        for (point, motion, mass) in measured.chain(stated) {
            let row = self.row(point);
            normal.ger(mass, &row, &row, 1.0);
            for axis in 0..3 {
                right.column_mut(axis).axpy(mass * motion[axis], &row, 1.0);
            }
        }
        for j in 4..unknowns {
            for k in 4..unknowns {
                normal[(j, k)] += lambda * self.penalty[(j - 4, k - 4)];
            }
        }
        // Points that lie in a plane leave an affine term undetermined: a tiny ridge keeps it at zero.
        for j in 0..unknowns {
            normal[(j, j)] += 1e-9;
        }
        let solution = normal
            .cholesky()
            .ok_or_else(|| Error::input("the landmarks do not determine a smooth breathing field"))?
            .solve(&right);
        let weights = &self.null_space * solution.rows(4, unknowns - 4);
        let centers = self.centers.iter().enumerate().map(|(j, &c)| {
            let c = (c * UNIT_MM * 10.0).round() / 10.0;
            [c.x, c.y, c.z, round(weights[(j, 0)]), round(weights[(j, 1)]), round(weights[(j, 2)])]
        });
        let affine = [0, 1, 2].map(|axis| [0, 1, 2, 3].map(|k| round(solution[(k, axis)])));
        Ok(BreathingField {
            source: settings.source.clone(),
            scale: 1.0,
            softening_mm: settings.softening_mm,
            origin_mm: self.origin.to_array(),
            affine,
            centers: centers.collect(),
        })
    }
}

/// A tenth of a micrometre is enough, and keeps case files short.
fn round(value: f64) -> f64 {
    (value * 1e4).round() / 1e4
}

fn affine_terms(x: DVec3) -> [f64; 4] {
    [1.0, x.x, x.y, x.z]
}

fn phi(d: DVec3, soft2: f64) -> f64 {
    -(d.length_squared() + soft2).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::random::{CounterRng, Stage};

    fn cloud(count: usize, motion: impl Fn(DVec3) -> DVec3) -> Vec<LandmarkPair> {
        let mut random = CounterRng::new(4, Stage::Test, &[]);
        (0..count)
            .map(|_| {
                let p = DVec3::new(random.range(0.0, 240.0), random.range(0.0, 200.0), random.range(0.0, 260.0));
                LandmarkPair { inspiration_mm: p, expiration_mm: p + motion(p) }
            })
            .collect()
    }

    fn settings(pairs: &[LandmarkPair]) -> FitSettings {
        let near: Vec<DVec3> = pairs.iter().map(|p| p.inspiration_mm).collect();
        let centers_mm = choose_centers(&near, 20.0, 30.0, 56);
        FitSettings { source: "test".into(), centers_mm, softening_mm: 12.0, anchors: vec![] }
    }

    #[test]
    fn an_affine_motion_is_found_exactly() {
        let motion = |p: DVec3| DVec3::new(0.01 * p.x - 2.0, 0.1 * p.y + 0.02 * p.z, 20.0 - 0.07 * p.z);
        let pairs = cloud(200, motion);
        let (field, quality) = fit(&pairs, &settings(&pairs), 0.0).unwrap();
        assert!(quality.held_out_mm < 2e-3, "{quality:?}");
        let probe = DVec3::new(100.0, 30.0, 200.0);
        assert!((field.displacement(probe) - motion(probe)).length() < 2e-3);
    }

    #[test]
    fn a_smooth_non_affine_motion_is_predicted_better_than_by_the_affine_part() {
        let motion = |p: DVec3| DVec3::Z * 25.0 / (1.0 + ((p.z - 60.0) / 40.0).exp()) + DVec3::Y * (p.y / 40.0).sin();
        let pairs = cloud(300, motion);
        let (field, quality) = fit(&pairs, &settings(&pairs), 0.0).unwrap();
        assert!(quality.held_out_mm < 0.35 * quality.affine_held_out_mm, "{quality:?}");
        // Rounding to what the file keeps leaves the side condition in place.
        for axis in 3..6 {
            let total: f64 = field.centers.iter().map(|c| c[axis]).sum();
            assert!(total.abs() < 0.01, "{total}");
        }
    }

    #[test]
    fn more_smoothing_gives_a_stiffer_field_and_anchors_hold() {
        let motion = |p: DVec3| DVec3::Z * 20.0 * (p.x / 30.0).sin();
        let pairs = cloud(300, motion);
        let mut with_anchor = settings(&pairs);
        let top = DVec3::new(120.0, 100.0, 300.0);
        with_anchor.anchors.push(Anchor { position_mm: top, motion_mm: DVec3::Z, mass: 200.0 });
        let (soft, _) = fit(&pairs, &with_anchor, 0.0).unwrap();
        assert!((soft.displacement(top) - DVec3::Z).length() < 1.0);
        let (stiff, quality) = fit(&pairs, &with_anchor, 30.0).unwrap();
        assert_eq!(quality.lambda, 30.0);
        let energy = |f: &BreathingField| f.centers.iter().map(|c| c[5] * c[5]).sum::<f64>();
        assert!(energy(&stiff) < energy(&soft));
    }

    #[test]
    fn too_few_landmarks_are_refused() {
        let pairs = cloud(20, |_| DVec3::Z);
        let settings = settings(&pairs);
        assert!(fit(&pairs[..9], &settings, 0.0).unwrap_err().to_string().contains("9 landmark pairs"));
    }
}
