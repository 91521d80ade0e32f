//! Cost against error of many settings: the points of a chart, and which of them no other beats (the Pareto front).

/// Whether a point is the program's default setting.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SettingRole {
    /// One of the others.
    #[default]
    Alternative,
    /// The default.
    Default,
}

/// One measured setting.
#[derive(Clone, Debug, PartialEq)]
pub struct ParetoPoint {
    /// What was measured on (a scene, a case): one panel each.
    pub subject: String,
    /// Family of settings: one colour each.
    pub mode: String,
    /// The setting within the family, shown beside the point.
    pub setting: String,
    /// What it costs, in the chart's unit; above 0.
    pub cost: f64,
    /// Its error, in the chart's unit; zero or negative where it lies within the reference's noise.
    pub error: f64,
    /// The default or not.
    pub role: SettingRole,
    /// Further columns of the CSV; the same names in every point.
    pub extra: Vec<(&'static str, f64)>,
}

/// A set of measured settings and what their numbers mean.
#[derive(Clone, Debug, PartialEq)]
pub struct ParetoChart {
    /// Axis of the costs with its unit, for example "CPU seconds per frame".
    pub cost: &'static str,
    /// Axis of the errors with its unit.
    pub error: &'static str,
    /// All settings; panels and colours in the order of their first appearance.
    pub points: Vec<ParetoPoint>,
}

/// For every point: whether no other point of its subject costs less, or the same, and errs less.
pub fn on_front(points: &[ParetoPoint]) -> Vec<bool> {
    let beats = |a: &ParetoPoint, b: &ParetoPoint| {
        a.subject == b.subject && a.cost <= b.cost && a.error <= b.error && (a.cost < b.cost || a.error < b.error)
    };
    points.iter().map(|p| !points.iter().any(|other| beats(other, p))).collect()
}
