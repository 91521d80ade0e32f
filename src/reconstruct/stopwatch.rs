//! What a method spent: wall and CPU seconds of its own work alone.

use std::iter::Sum;
use std::ops::Add;
use std::time::Instant;

use crate::ffi::system;

/// Seconds of some work.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Spent {
    /// Wall clock.
    pub wall_s: f64,
    /// User and system CPU seconds of all threads of this process: of the method, while it runs alone.
    pub cpu_s: f64,
}

impl Add for Spent {
    type Output = Spent;

    fn add(self, other: Spent) -> Spent {
        Spent { wall_s: self.wall_s + other.wall_s, cpu_s: self.cpu_s + other.cpu_s }
    }
}

impl Sum for Spent {
    fn sum<I: Iterator<Item = Spent>>(parts: I) -> Spent {
        parts.fold(Spent::default(), Add::add)
    }
}

/// A clock that is running.
#[derive(Debug)]
pub struct Stopwatch {
    wall: Instant,
    cpu_s: f64,
}

impl Stopwatch {
    /// Begins now.
    pub fn start() -> Self {
        Stopwatch { wall: Instant::now(), cpu_s: system::cpu_time_s() }
    }

    /// What was spent since.
    pub fn spent(&self) -> Spent {
        Spent { wall_s: self.wall.elapsed().as_secs_f64(), cpu_s: system::cpu_time_s() - self.cpu_s }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn work_costs_both_and_rest_costs_wall_seconds_alone() {
        let clock = Stopwatch::start();
        let mut x = 0u64;
        while clock.spent().cpu_s < 0.02 {
            x = std::hint::black_box(x + 1);
        }
        let worked = clock.spent();
        assert!(worked.cpu_s >= 0.02 && worked.wall_s > 0.0 && x > 0);
        let both: Spent = [worked, worked].into_iter().sum();
        assert_eq!(both, worked + worked);
        assert_eq!(both.cpu_s, 2.0 * worked.cpu_s);
    }
}
