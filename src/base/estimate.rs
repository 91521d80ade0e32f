//! What work would cost, said before it begins.
//!
//! Whoever knows the size of the work makes an [`Estimate`] from a simple model (so many bytes a pixel, so many
//! nanoseconds a sample) and shows it to [`super::Progress::accepts`]. The command line refuses work above the limits
//! here unless the user has said `--yes`. Models are within a factor of 3 or so on the machines of
//! `docs/performance.md`: they tell minutes from days.
//!
//! Tables whose size is known only in the middle of the work are checked by [`demand_memory`] before they are made.

use std::fmt;

use super::error::{Error, Result};

/// Work that starts anew when it is stopped is asked about above this many seconds: half an hour.
pub const ASK_SECONDS: f64 = 1800.0;
/// Work that resumes where it was stopped is asked about above this many seconds: a day. `smoke` and `quick` stay
/// below.
pub const ASK_RESUMABLE_SECONDS: f64 = 86_400.0;
/// Work is asked about when it takes more than this part of the memory that the machine has left.
pub const ASK_MEMORY_SHARE: f64 = 0.5;
/// Tables below this many bytes are made without a look at the machine's memory, which costs some microseconds.
const SMALL_BYTES: f64 = 256e6;

/// Memory and time of some work.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Estimate {
    /// Largest memory at any time, in bytes.
    pub memory_bytes: f64,
    /// Wall clock in seconds on this machine's threads.
    pub seconds: f64,
    /// Whether the same command goes on where it was stopped.
    pub resumable: bool,
}

impl Estimate {
    /// One after the other: the larger memory, the sum of the times.
    pub fn then(self, next: Estimate) -> Estimate {
        Estimate {
            memory_bytes: self.memory_bytes.max(next.memory_bytes),
            seconds: self.seconds + next.seconds,
            resumable: self.resumable && next.resumable,
        }
    }

    /// Why the user has to be asked, if so: one sentence.
    pub fn question(&self) -> Option<String> {
        self.question_with(available_memory_bytes())
    }

    fn question_with(&self, available_bytes: Option<f64>) -> Option<String> {
        let longest_s = if self.resumable { ASK_RESUMABLE_SECONDS } else { ASK_SECONDS };
        let memory = available_bytes.filter(|available| self.memory_bytes > ASK_MEMORY_SHARE * available);
        // A time that is no number is too long.
        let brief = self.seconds <= longest_s;
        if memory.is_none() && brief {
            return None;
        }
        let left = memory.map_or_else(String::new, |bytes| format!(" (this machine has {} left)", shown_bytes(bytes)));
        Some(format!("this would take {self}{left}; say --yes, or make it smaller"))
    }
}

impl fmt::Display for Estimate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} and about {}", shown_bytes(self.memory_bytes), shown_seconds(self.seconds))
    }
}

fn shown_bytes(bytes: f64) -> String {
    match bytes {
        b if b < 1e9 => format!("{:.0} MB", (b / 1e6).max(1.0)),
        b if b < 1e10 => format!("{:.1} GB", b / 1e9),
        b => format!("{:.0} GB", b / 1e9),
    }
}

fn shown_seconds(seconds: f64) -> String {
    match seconds {
        s if s < 90.0 => format!("{:.0} seconds", s.max(1.0)),
        s if s < 90.0 * 60.0 => format!("{:.0} minutes", s / 60.0),
        s if s < 48.0 * 3600.0 => format!("{:.0} hours", s / 3600.0),
        s if s < 1000.0 * 86_400.0 => format!("{:.0} days", s / 86_400.0),
        s => format!("{:.0} years", s / (365.25 * 86_400.0)),
    }
}

/// Refuses a table that this machine has no memory left for. `what` names it: "the lists of the tiles".
///
/// Errors: one sentence with both sizes.
pub fn demand_memory(what: impl fmt::Display, bytes: f64) -> Result<()> {
    if bytes <= SMALL_BYTES {
        return Ok(());
    }
    demand_memory_with(what, bytes, available_memory_bytes())
}

fn demand_memory_with(what: impl fmt::Display, bytes: f64, available_bytes: Option<f64>) -> Result<()> {
    match available_bytes {
        Some(available) if bytes > available => {
            let (wanted, left) = (shown_bytes(bytes), shown_bytes(available));
            Err(Error::input(format!("{what} would take {wanted}, and this machine has {left} left")))
        }
        _ => Ok(()),
    }
}

/// Memory in bytes that this process can still get: what the system has left, or what its control group (a container)
/// or its limit of addresses (`ulimit -v`) allows, where that is less. `None` when the system does not say.
pub fn available_memory_bytes() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/meminfo").ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix("MemAvailable:"))?;
    let system = line.trim().trim_end_matches("kB").trim().parse::<f64>().ok()? * 1024.0;
    let limits = [group_bytes(), address_bytes()];
    Some(limits.into_iter().flatten().fold(system, f64::min))
}

/// What the limit of the process's addresses has left.
fn address_bytes() -> Option<f64> {
    let read = |name: &str| std::fs::read_to_string(format!("/proc/self/{name}")).ok();
    let limit = address_limit_bytes(&read("limits")?)?;
    Some((limit - mapped_bytes(&read("status")?)?).max(0.0))
}

/// The soft limit in the text of `/proc/self/limits`; `None` when there is none.
fn address_limit_bytes(limits: &str) -> Option<f64> {
    let line = limits.lines().find_map(|line| line.strip_prefix("Max address space"))?;
    line.split_whitespace().next()?.parse().ok()
}

/// What is mapped, from the text of `/proc/self/status`.
fn mapped_bytes(status: &str) -> Option<f64> {
    let line = status.lines().find_map(|line| line.strip_prefix("VmSize:"))?;
    Some(line.trim().trim_end_matches("kB").trim().parse::<f64>().ok()? * 1024.0)
}

/// What the control group (version 2) has left.
fn group_bytes() -> Option<f64> {
    let read = |name: &str| std::fs::read_to_string(format!("/sys/fs/cgroup/{name}")).ok()?.trim().parse::<f64>().ok();
    Some((read("memory.max")? - read("memory.current")?).max(0.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn work(memory_bytes: f64, seconds: f64, resumable: bool) -> Estimate {
        Estimate { memory_bytes, seconds, resumable }
    }

    #[test]
    fn large_work_is_asked_about_in_one_sentence() {
        let ask = |work: Estimate| work.question_with(Some(10e9));
        assert_eq!(ask(work(1e9, 1500.0, false)), None);
        assert_eq!(
            ask(work(14e9, 2400.0, false)).unwrap(),
            "this would take 14 GB and about 40 minutes (this machine has 10 GB left); say --yes, or make it smaller"
        );
        assert_eq!(
            ask(work(1e6, 2400.0, false)).unwrap(),
            "this would take 1 MB and about 40 minutes; say --yes, or make it smaller"
        );
        assert_eq!(ask(work(1e6, 2400.0, true)), None);
        assert!(ask(work(1e6, 1e6, true)).unwrap().contains("12 days"));
        assert!(ask(work(1e6, f64::NAN, true)).is_some() && ask(work(1e6, f64::INFINITY, false)).is_some());
        // Without a figure for the memory the time alone decides.
        assert_eq!(work(1e15, 1.0, false).question_with(None), None);
        assert_eq!(work(2e9, 10.0, true).then(work(1e9, 5.0, true)), work(2e9, 15.0, true));
    }

    #[test]
    fn a_table_that_does_not_fit_is_refused() {
        let refused = demand_memory_with("the list", 12e9, Some(3e9)).unwrap_err();
        assert_eq!(refused.to_string(), "the list would take 12 GB, and this machine has 3.0 GB left");
        assert_eq!(refused.kind().exit_code(), 4);
        assert!(demand_memory_with("the list", 2e9, Some(3e9)).is_ok());
        assert!(demand_memory("the list", 1e18).is_err());
        assert!(available_memory_bytes().is_some_and(|bytes| bytes > 1e7));
    }

    #[test]
    fn the_limit_of_addresses_is_read() {
        let limits = |soft: &str| {
            format!("Limit    Soft Limit    Hard Limit    Units\nMax address space         {soft}  unlimited  bytes\n")
        };
        assert_eq!(address_limit_bytes(&limits("4294967296")), Some(4294967296.0));
        assert_eq!(address_limit_bytes(&limits("unlimited")), None);
        assert_eq!(mapped_bytes("Name:\tx\nVmPeak:\t 9 kB\nVmSize:\t   2048 kB\n"), Some(2_097_152.0));
        let status = std::fs::read_to_string("/proc/self/status").unwrap();
        assert!(mapped_bytes(&status).is_some_and(|bytes| bytes > 1e6));
    }
}
