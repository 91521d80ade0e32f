//! The lines so far, for pages that are opened late or fall behind: the newest all, older ones thinned evenly, so that a
//! run of any length takes bounded memory and keeps the whole path.

use std::collections::VecDeque;
use std::sync::Arc;

/// Newest lines, which are all kept: a minute and a half at 25 frames a second. A line has about 3 KiB.
pub(super) const RECENT: usize = 2048;
/// Older lines that are kept at most.
pub(super) const PAST: usize = 2048;

/// A line and its number.
pub(super) type NumberedLine = (u64, Arc<str>);

/// Lines with ascending numbers.
pub(super) struct LineHistory {
    /// Those whose number is a multiple of `stride`.
    past: Vec<NumberedLine>,
    recent: VecDeque<NumberedLine>,
    stride: u64,
    /// Number of the next line.
    next: u64,
}

impl LineHistory {
    pub(super) fn new() -> Self {
        LineHistory { past: Vec::new(), recent: VecDeque::new(), stride: 1, next: 0 }
    }

    pub(super) fn push(&mut self, line: Arc<str>) {
        self.recent.push_back((self.next, line));
        self.next += 1;
        if self.recent.len() <= RECENT {
            return;
        }
        self.past.extend(self.recent.pop_front().filter(|(number, _)| number.is_multiple_of(self.stride)));
        if self.past.len() > PAST {
            self.stride *= 2;
            self.past.retain(|(number, _)| number.is_multiple_of(self.stride));
        }
    }

    /// Whether a line of that number or a later one is there.
    pub(super) fn reaches(&self, number: u64) -> bool {
        number < self.next
    }

    /// At most `most` lines from number `from` on.
    pub(super) fn from(&self, from: u64, most: usize) -> Vec<NumberedLine> {
        let past = self.past.partition_point(|(number, _)| *number < from);
        let recent = self.recent.partition_point(|(number, _)| *number < from);
        self.past[past..].iter().chain(self.recent.range(recent..)).take(most).cloned().collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_newest_lines_are_whole_and_older_ones_are_evenly_thinned() {
        let mut history = LineHistory::new();
        let count = 50_000;
        (0..count).for_each(|k| history.push(k.to_string().into()));
        let all = history.from(0, usize::MAX);
        assert!(all.len() <= PAST + RECENT && all.len() > RECENT + PAST / 2 - 1, "{}", all.len());
        assert!(all.iter().all(|(number, line)| number.to_string() == **line));
        let steps: Vec<u64> = all.windows(2).map(|pair| pair[1].0 - pair[0].0).collect();
        assert_eq!((all[0].0, all.last().unwrap().0), (0, count - 1));
        assert!(steps[..PAST / 2 - 1].iter().all(|&step| step == steps[0]), "{steps:?}");
        assert!(steps[steps.len() - RECENT + 1..].iter().all(|&step| step == 1));

        let some = history.from(count - 3, 2);
        assert_eq!(some.iter().map(|(number, _)| *number).collect::<Vec<_>>(), [count - 3, count - 2]);
        assert!(history.from(count, 9).is_empty() && history.reaches(count - 1) && !history.reaches(count));
    }
}
