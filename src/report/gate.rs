//! The gate: absolute limits, and limits against a baseline run. Everything that is not shown to be good enough
//! fails: a missing case, method or metric, an empty value, a NaN, one out of its range, a definition that changed, a film
//! that is unknown, a limit that no row meets.
//!
//! ```toml
//! profile = "smoke"                    # whose runs these are limits of; any profile's when absent
//! cases = ["case1"]                    # must be there
//! methods = ["ours"]                   # must be there
//! [[absolute]]                         # every case of the method, or with over = "mean" the mean over cases
//! metric = "psnr_db"                   # the limit is a minimum or a maximum as the metric's direction says
//! method = "ours"
//! limit = 20.0
//! [[relative]]                         # against the baseline, case by case; methods = all unless named
//! metric = "psnr_db"
//! worse_by = 0.1                       # in the metric's unit, and / or
//! worse_by_percent = 2.0               # of the baseline's value: the larger of the two allowances holds
//! advisory = true                      # a note instead of a failure (times)
//! ```

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::read::{CaseFacts, Key, ResultEntry, Results, unfit};
use super::run::{EVALUATION, PROFILES_BETWEEN};
use crate::base::range::{KeyRanges, NumberRange};
use crate::base::{Error, Result, files};
use crate::score::{Metric, Status, metric, statistics};

/// Relative limits beside a baseline.
pub const LIMITS_FILE: &str = "limits.toml";
/// Ranges of a thresholds file.
const RANGES: KeyRanges = KeyRanges(&[
    ("absolute.limit", NumberRange::new(-1e9, 1e9)),
    ("relative.worse_by", NumberRange::new(0.0, 1e9)),
    ("relative.worse_by_percent", NumberRange::new(0.0, 1e6)),
]);

/// The thresholds file.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Thresholds {
    /// Profile whose runs these are limits of; any profile's when absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub profile: Option<String>,
    /// Cases that must be there.
    #[serde(default)]
    pub cases: Vec<String>,
    /// Methods that must be there.
    #[serde(default)]
    pub methods: Vec<String>,
    /// Limits on values.
    #[serde(default)]
    pub absolute: Vec<Absolute>,
    /// Limits on losses against a baseline.
    #[serde(default)]
    pub relative: Vec<Relative>,
}

/// Over what an absolute limit holds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Over {
    /// Each case and seed.
    #[default]
    Each,
    /// The mean over cases.
    Mean,
}

/// A limit on a value.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Absolute {
    /// Metric id.
    pub metric: String,
    /// Method id.
    pub method: String,
    /// Least or most, as the metric's direction says.
    pub limit: f64,
    /// Each case or their mean.
    #[serde(default)]
    pub over: Over,
    /// A note instead of a failure.
    #[serde(default)]
    pub advisory: bool,
}

/// A limit on the loss against the baseline.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Relative {
    /// Metric id.
    pub metric: String,
    /// Method id; all methods when absent.
    pub method: Option<String>,
    /// Allowed loss in the metric's unit.
    #[serde(default)]
    pub worse_by: f64,
    /// Allowed loss in percent of the baseline's value.
    #[serde(default)]
    pub worse_by_percent: f64,
    /// A note instead of a failure.
    #[serde(default)]
    pub advisory: bool,
}

impl Thresholds {
    /// Refuses results of another profile, a merged run's among them; predictions that `evaluate` scored are of none.
    pub fn check_profile(&self, results: &Results) -> Result<()> {
        let Some(wanted) = self.profile.as_deref().filter(|_| !results.profile.is_empty()) else { return Ok(()) };
        match results.profile.split(PROFILES_BETWEEN).find(|profile| ![wanted, EVALUATION].contains(profile)) {
            None => Ok(()),
            Some(other) => Err(Error::usage(format!(
                "are limits of the profile `{wanted}`, and the results are of `{other}`: name a file with limits of yours \
                 (--thresholds; docs/statistics.md has its keys)"
            ))),
        }
    }
}

impl Relative {
    fn concerns(&self, key: &Key) -> bool {
        self.metric == key.metric && self.method.as_ref().is_none_or(|method| *method == key.method)
    }
}

/// The outcome of one check.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// Good enough.
    Pass,
    /// Not shown to be good enough.
    Fail,
    /// Reported, not a failure.
    Note,
}

impl Verdict {
    /// For tables.
    pub fn word(self) -> &'static str {
        match self {
            Verdict::Pass => "pass",
            Verdict::Fail => "FAIL",
            Verdict::Note => "note",
        }
    }
}

/// One check.
#[derive(Clone, Debug)]
pub struct Check {
    /// Case, or `mean`.
    pub case: String,
    /// Method, empty for a check of the run as a whole.
    pub method: String,
    /// Metric, empty likewise.
    pub metric: String,
    /// Its outcome.
    pub verdict: Verdict,
    /// The numbers and the limit.
    pub sentence: String,
}

/// Reads and checks a thresholds file: unknown metrics and limits out of range are errors.
pub fn read_thresholds(path: &Path) -> Result<Thresholds> {
    let thresholds: Thresholds = files::read_toml(path)?;
    let known =
        |id: &str| metric(id).map(|_| ()).ok_or_else(|| Error::input(format!("there is no metric `{id}`")).at(path));
    for id in thresholds.absolute.iter().map(|a| &a.metric).chain(thresholds.relative.iter().map(|r| &r.metric)) {
        known(id)?;
    }
    RANGES.check("", &thresholds).map_err(|e| e.at(path))?;
    Ok(thresholds)
}

/// The limits that come with a baseline, beside those of every baseline: both must hold. The spread of seeds and samplings
/// is wide where a method is fragile, and a build that changes nothing gives the same bytes. The runs that they were
/// computed from may have had more methods than the baseline.
pub fn with_limits_of(mut thresholds: Thresholds, baseline: &Results, folder: &Path) -> Result<Thresholds> {
    let file = folder.join(LIMITS_FILE);
    if file.exists() {
        let methods = baseline.methods();
        let is_known = |limit: &Relative| limit.method.as_ref().is_none_or(|method| methods.contains(&method.as_str()));
        thresholds.relative.extend(read_thresholds(&file)?.relative.into_iter().filter(is_known));
    }
    Ok(thresholds)
}

/// All checks, in a fixed order.
pub fn judge(results: &Results, thresholds: &Thresholds, baseline: Option<&Results>) -> Vec<Check> {
    let mut checks = presence(results, thresholds);
    checks.extend(soundness(results));
    for limit in &thresholds.absolute {
        checks.extend(match limit.over {
            Over::Each => each(results, thresholds, limit),
            Over::Mean => vec![mean(results, thresholds, limit)],
        });
    }
    if let Some(baseline) = baseline {
        checks.extend(against(results, thresholds, baseline));
    }
    checks.extend(thresholds.relative.iter().filter_map(|limit| idle(limit, results, baseline)));
    let is_remark = |c: &Check| c.verdict == Verdict::Note && c.metric.is_empty();
    if checks.iter().all(is_remark) {
        checks.push(check(("", "", ""), Verdict::Fail, "no limit applies, so that nothing was checked".into()));
    }
    checks
}

/// That two definitions of a metric are not one.
pub(super) fn redefinition(from: &str, to: &str) -> String {
    format!("the definition changed from {from} to {to}: not comparable")
}

fn check(key: (&str, &str, &str), verdict: Verdict, sentence: String) -> Check {
    Check { case: key.0.into(), method: key.1.into(), metric: key.2.into(), verdict, sentence }
}

fn or_note(advisory: bool) -> Verdict {
    if advisory { Verdict::Note } else { Verdict::Fail }
}

fn presence(results: &Results, thresholds: &Thresholds) -> Vec<Check> {
    let (cases, methods) = (results.cases(), results.methods());
    let mut checks = Vec::new();
    if results.entries.is_empty() {
        checks.push(check(("", "", ""), Verdict::Fail, "the results hold no row".into()));
    }
    let found = |is_there: bool, what: &str| match is_there {
        true => (Verdict::Pass, format!("the {what} is there")),
        false => (Verdict::Fail, format!("the {what} is missing")),
    };
    for case in &thresholds.cases {
        let (verdict, sentence) = found(cases.contains(&case.as_str()), "case");
        checks.push(check((case, "", ""), verdict, sentence));
    }
    for method in &thresholds.methods {
        let (verdict, sentence) = found(methods.contains(&method.as_str()), "method");
        checks.push(check(("", method, ""), verdict, sentence));
        if verdict == Verdict::Pass {
            let ran: BTreeSet<&str> =
                (results.entries.keys()).filter(|k| k.method == *method).map(|k| k.case.as_str()).collect();
            let wanted = wanted_cases(results, thresholds);
            let lacking = wanted.iter().filter(|case| cases.contains(case) && !ran.contains(*case));
            checks
                .extend(lacking.map(|case| check((case, method, ""), Verdict::Fail, "the method did not run".into())));
        }
    }
    // A cell that failed has rows, and each says so; one check for each is enough.
    let failed: BTreeMap<(&str, &str, u64), ()> = results
        .entries
        .iter()
        .filter(|(_, e)| e.status == Status::Failed.word())
        .map(|(k, _)| ((k.case.as_str(), k.method.as_str(), k.seed), ()))
        .collect();
    for (case, method, seed) in failed.into_keys() {
        checks.push(check((case, method, ""), Verdict::Fail, format!("the cell failed (seed {seed})")));
    }
    checks
}

/// Cases that must be there, or without such a list all that are.
fn wanted_cases<'a>(results: &'a Results, thresholds: &'a Thresholds) -> Vec<&'a str> {
    if thresholds.cases.is_empty() { results.cases() } else { thresholds.cases.iter().map(String::as_str).collect() }
}

/// What no table that this program wrote has: a value out of its metric's range, a status without meaning or one that says
/// that there is no value beside it, a case whose rows are of several films or of an unknown one.
fn soundness(results: &Results) -> Vec<Check> {
    let broken = |(key, entry): (&Key, &ResultEntry)| {
        let m = metric(&key.metric)?;
        let sentence = match (Status::of_word(&entry.status), entry.value) {
            (None, _) => Some(format!("`{}` is no status", entry.status)),
            (Some(Status::NotApplicable | Status::Failed), Some(_)) => {
                Some(format!("a value is there, and the status says `{}`", entry.status))
            }
            (_, value) => value.and_then(|value| unfit(m, value)),
        };
        Some(check((&key.case, &key.method, &key.metric), Verdict::Fail, sentence?))
    };
    let film = |(case, facts): (&String, &CaseFacts)| {
        let sentence = match facts.film_contents.len() {
            _ if facts.film().is_some() => return None,
            // Every cell failed, and each says so.
            0 => return None,
            1 => "no row tells which film it is of (film_content)",
            _ => "its rows are not all of one film (film_content)",
        };
        Some(check((case, "", ""), Verdict::Fail, sentence.to_owned()))
    };
    results.facts.iter().filter_map(film).chain(results.entries.iter().filter_map(broken)).collect()
}

/// A relative limit that no row meets says nothing: its method or metric is misspelt, or has left the tables.
fn idle(limit: &Relative, results: &Results, baseline: Option<&Results>) -> Option<Check> {
    let meets = |key: &Key| limit.concerns(key) && results.facts.contains_key(&key.case);
    if baseline.unwrap_or(results).entries.keys().any(meets) {
        return None;
    }
    let whose = if baseline.is_some() { "the baseline" } else { "the results" };
    let place = ("", limit.method.as_deref().unwrap_or(""), limit.metric.as_str());
    Some(check(place, or_note(limit.advisory), format!("no row of {whose} meets this limit")))
}

/// Cases, with the seed where there is one, in which the limit's method lacks a row of its metric: it did not run there, or
/// the row was taken out.
fn lacking(results: &Results, thresholds: &Thresholds, limit: &Absolute) -> Vec<String> {
    let of_method = results.entries.keys().filter(|k| k.method == limit.method);
    let cells: BTreeSet<(&str, u64)> = of_method.map(|k| (k.case.as_str(), k.seed)).collect();
    let has = |&(case, seed): &(&str, u64)| {
        let (case, method, metric) = (case.to_owned(), limit.method.clone(), limit.metric.clone());
        results.entries.contains_key(&Key { case, method, seed, metric })
    };
    let wanted = wanted_cases(results, thresholds).into_iter();
    let absent = wanted.filter(|case| cells.range((*case, 0)..=(*case, u64::MAX)).next().is_none());
    let mut lacking: Vec<String> = absent.map(str::to_owned).collect();
    lacking.extend(cells.iter().filter(|cell| !has(cell)).map(|(case, _)| (*case).to_owned()));
    lacking.dedup();
    lacking
}

/// Rows of the limit's metric and method. A case without a row is a failure, not a pass.
fn each(results: &Results, thresholds: &Thresholds, limit: &Absolute) -> Vec<Check> {
    let Some(m) = metric(&limit.metric) else { return Vec::new() };
    let mut checks: Vec<Check> = results
        .entries
        .iter()
        .filter(|(k, _)| k.metric == m.id && k.method == limit.method)
        .map(|(k, entry)| absolute(m, limit, &k.case, shown_value(m, entry)))
        .collect();
    if checks.is_empty() {
        checks.push(check(("", &limit.method, m.id), or_note(limit.advisory), "no case has this metric".into()));
        return checks;
    }
    let lost = |case: String| check((&case, &limit.method, m.id), or_note(limit.advisory), "no row".into());
    checks.extend(lacking(results, thresholds, limit).into_iter().map(lost));
    checks
}

fn mean(results: &Results, thresholds: &Thresholds, limit: &Absolute) -> Check {
    let m = metric(&limit.metric).expect("thresholds were checked when they were read");
    let of_method = |k: &&Key| k.metric == m.id && k.method == limit.method;
    let cells = results.entries.keys().filter(of_method).count();
    let rows: Vec<&ResultEntry> = results.entries.iter().filter(|(k, _)| of_method(k)).map(|(_, e)| e).collect();
    let values: Vec<f64> = results.case_values(&limit.method, m.id).into_iter().map(|(_, v)| v).collect();
    // A mean that silently leaves a case out would pass when the worst case loses its value. What is identical to the truth
    // has no value and is no worse for it.
    let counts = |entry: &&ResultEntry| match shown_value(m, entry) {
        Value::Number(value) => value.is_finite(),
        Value::Identical => true,
        Value::None(_) => false,
    };
    if cells == 0 || !lacking(results, thresholds, limit).is_empty() || !rows.iter().all(counts) {
        let sentence = "not every case has a value, so there is no mean".to_owned();
        return check(("mean", &limit.method, m.id), or_note(limit.advisory), sentence);
    }
    absolute(m, limit, "mean", statistics::mean(&values).map_or(Value::Identical, Value::Number))
}

/// A value for comparison.
enum Value {
    Number(f64),
    /// Equal to the truth: better than any number.
    Identical,
    /// The status word.
    None(String),
}

/// Only a ratio to no error at all is better than any number; elsewhere the status is no value.
fn shown_value(m: &Metric, entry: &ResultEntry) -> Value {
    match entry.value {
        _ if entry.status == Status::Identical.word() && m.unit == "dB" => Value::Identical,
        Some(value) => Value::Number(value),
        None => Value::None(entry.status.clone()),
    }
}

/// A value with the metric's unit, where it has one.
fn with_unit(m: &Metric, value: f64) -> String {
    format!("{} {}", m.format(value), m.unit).trim_end().to_owned()
}

fn absolute(m: &Metric, limit: &Absolute, case: &str, value: Value) -> Check {
    let key = (case, limit.method.as_str(), m.id);
    let bound = if m.direction.word() == "higher" { "at least" } else { "at most" };
    match value {
        Value::Identical => check(key, Verdict::Pass, "identical to the truth".into()),
        Value::None(status) if status == Status::Ok.word() => {
            check(key, or_note(limit.advisory), "the value is empty".into())
        }
        Value::None(status) => check(key, or_note(limit.advisory), format!("no value ({status})")),
        Value::Number(v) => {
            // NaN fails: the question is whether the loss is shown to be no more than 0.
            let good = m.direction.loss(v, limit.limit) <= 0.0;
            let verdict = if good { Verdict::Pass } else { or_note(limit.advisory) };
            check(key, verdict, format!("{}; {bound} {} is wanted", with_unit(m, v), limit.limit))
        }
    }
}

fn against(results: &Results, thresholds: &Thresholds, baseline: &Results) -> Vec<Check> {
    let mut checks = Vec::new();
    let other = results.other_work(baseline);
    if let Some(conditions) = other.conditions {
        let sentence =
            format!("ran under other conditions than the baseline, which makes another task of it: {conditions}");
        checks.push(check(("", "", ""), Verdict::Fail, sentence));
    }
    for method in other.settings {
        let sentence = "its settings are the program's in the results or in the baseline, and not in both";
        checks.push(check(("", &method, ""), Verdict::Note, sentence.into()));
    }
    let (now, before) = (results.cases(), baseline.cases());
    for case in now.iter().filter(|c| !before.contains(c)) {
        checks.push(check((case, "", ""), Verdict::Note, "a new case: the baseline does not have it".into()));
    }
    for case in before.iter().filter(|c| !now.contains(c)) {
        checks.push(check((case, "", ""), Verdict::Fail, "the baseline has this case, the results do not".into()));
    }
    for case in now.iter().filter(|c| before.contains(c)) {
        let film = |results: &Results| results.facts.get(*case).and_then(|facts| facts.film().map(str::to_owned));
        let sentence = match (film(results), film(baseline)) {
            (Some(own), Some(known)) if own != known => {
                "the film is another than the baseline's: where that is meant, make the baseline anew"
            }
            (Some(_), None) => "the baseline does not tell which film it is of: make it anew",
            _ => continue,
        };
        checks.push(check((case, "", ""), Verdict::Fail, sentence.to_owned()));
    }
    for limit in &thresholds.relative {
        let Some(m) = metric(&limit.metric) else { continue };
        for (key, old) in baseline.entries.iter().filter(|(k, _)| limit.concerns(k) && now.contains(&k.case.as_str())) {
            checks.push(relative(m, limit, key, old, results.entries.get(key)));
        }
    }
    checks
}

fn relative(m: &Metric, limit: &Relative, key: &Key, old: &ResultEntry, new: Option<&ResultEntry>) -> Check {
    let place = (key.case.as_str(), key.method.as_str(), m.id);
    let fail = or_note(limit.advisory);
    let Some(new) = new else {
        return check(place, fail, "the baseline has this metric, the results do not".into());
    };
    if new.definition != old.definition {
        return check(place, fail, redefinition(&old.definition, &new.definition));
    }
    match (shown_value(m, old), shown_value(m, new)) {
        (Value::None(_), Value::None(_)) if new.status != old.status => {
            check(place, fail, format!("no value: {}; in the baseline: {}", new.status, old.status))
        }
        (Value::None(_), Value::None(_)) => check(place, Verdict::Pass, "no value, as in the baseline".into()),
        (Value::None(_), _) => check(place, Verdict::Note, "has a value, the baseline has none".into()),
        (_, Value::Identical) => check(place, Verdict::Pass, "identical to the truth".into()),
        (Value::Identical, _) => check(place, fail, "was identical to the truth in the baseline".into()),
        (_, Value::None(status)) => check(place, fail, format!("no value ({status}); the baseline has one")),
        (Value::Number(old), Value::Number(new)) => {
            let allowed = limit.worse_by.max(limit.worse_by_percent / 100.0 * old.abs());
            let loss = m.direction.loss(new, old);
            // What was written in decimals may exceed the allowance by a rounding and no more.
            let verdict = if loss <= allowed * (1.0 + 1e-9) { Verdict::Pass } else { fail };
            if !loss.is_finite() {
                return check(place, fail, format!("{new} is no value, or {old} of the baseline is none"));
            }
            let change = match loss {
                0.0 => "equal".to_owned(),
                _ => format!("{} by {:.4}", if loss > 0.0 { "worse" } else { "better" }, loss.abs()),
            };
            let sentence = format!("{}, baseline {}: {change}, allowed {allowed:.4}", with_unit(m, new), m.format(old));
            check(place, verdict, sentence)
        }
    }
}
