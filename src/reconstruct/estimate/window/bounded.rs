//! Linear algebra of the window: a Gauss-Newton step within bounds, and marginalisation.

use nalgebra::{DMatrix, DVector};

/// Largest number of pivots in one step, against cycling; two dozen phases need fewer.
const MOST_PIVOTS: usize = 1000;

/// The minimum of a quadratic model within bounds, and the gradient against the active bounds.
pub struct BoundedStep {
    /// Change of each unknown.
    pub step: DVector<f64>,
    /// Remaining gradient of the unknowns held at a bound; 0 for the others.
    pub push: DVector<f64>,
}

/// The step that minimises `1/2 s^T C s - g^T s` while the phases (unknowns from number `first` on) stay within
/// 0..1. Phases that would leave this range are held at its end, and the others are solved for given that.
/// Principal pivoting on the last violation each time, which terminates (Murty, "Note on a Bard-type scheme for
/// solving the complementarity problem", 1974). `None` if `C` is not positive definite.
pub fn bounded(
    curvature: &DMatrix<f64>,
    gradient: &DVector<f64>,
    at: &DVector<f64>,
    first: usize,
) -> Option<BoundedStep> {
    let count = at.len();
    // The end of the range at which each phase is held, if any.
    let mut ends: Vec<Option<f64>> = vec![None; count];
    for pivots in 0.. {
        // Solve for the free unknowns, with the held ones at their ends.
        let free: Vec<usize> = (0..count).filter(|&k| ends[k].is_none()).collect();
        let mut step = DVector::from_fn(count, |k, _| ends[k].map_or(0.0, |end| end - at[k]));
        let rest = gradient - curvature * &step;
        let solution = curvature.select_rows(&free).select_columns(&free).cholesky()?.solve(&rest.select_rows(&free));
        free.iter().zip(solution.iter()).for_each(|(&k, &value)| step[k] = value);
        // The remaining gradient pushes the held ones against their ends.
        let left = gradient - curvature * &step;
        let push = DVector::from_fn(count, |k, _| if ends[k].is_some() { left[k] } else { 0.0 });
        // A free phase outside 0..1 or a held one that is pushed back inside is wrong: pivot on it.
        let is_wrong = |k: &usize| match ends[*k] {
            None => !(0.0..=1.0).contains(&(at[*k] + step[*k])),
            Some(end) => push[*k] * (end - 0.5) < 0.0,
        };
        // The limit on pivots: rounding may make a phase exactly at an end flip back and forth.
        let wrong = (first..count).rev().find(is_wrong).filter(|_| pivots < MOST_PIVOTS);
        let Some(wrong) = wrong else { return Some(BoundedStep { step, push }) };
        ends[wrong] = if ends[wrong].is_none() { Some((at[wrong] + step[wrong]).clamp(0.0, 1.0)) } else { None };
    }
    None
}

/// Information about the other unknowns once unknown number `k` is marginalised: Schur's complement
/// `H_oo - H_ok H_ko / H_kk`.
pub fn marginalised(mut information: DMatrix<f64>, k: usize) -> DMatrix<f64> {
    let column = information.column(k).clone_owned();
    information -= &column * column.transpose() / column[k];
    information.remove_row(k).remove_column(k)
}
