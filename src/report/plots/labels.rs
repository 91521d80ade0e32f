//! Places for labels beside dots, so that none covers another or a dot.

use super::canvas::Pen;

/// Pixels that something covers.
#[derive(Clone, Copy)]
pub struct Taken {
    /// Upper left corner.
    pub low: (i32, i32),
    /// Lower right corner.
    pub high: (i32, i32),
}

impl Taken {
    /// A square around a point.
    pub fn around((x, y): (i32, i32), radius: i32) -> Self {
        Taken { low: (x - radius, y - radius), high: (x + radius, y + radius) }
    }

    /// A thin box around a line that runs along an axis.
    pub fn between([a, b]: [(i32, i32); 2]) -> Self {
        Taken { low: (a.0.min(b.0) - 1, a.1.min(b.1) - 1), high: (a.0.max(b.0) + 1, a.1.max(b.1) + 1) }
    }

    /// The nearest point of it, where that is more than `reach` from (`x`, `y`).
    pub fn far_from(&self, (x, y): (i32, i32), reach: i32) -> Option<(i32, i32)> {
        let near = (x.clamp(self.low.0, self.high.0), y.clamp(self.low.1, self.high.1));
        let (right, down) = (near.0 - x, near.1 - y);
        (right * right + down * down > reach * reach).then_some(near)
    }

    /// Whether they overlap.
    pub fn meets(&self, other: &Taken) -> bool {
        self.low.0 < other.high.0 && other.low.0 < self.high.0 && self.low.1 < other.high.1 && other.low.1 < self.high.1
    }
}

/// What labels of a panel have to do with.
pub struct LabelRoom {
    /// Where they must stay.
    pub inside: Taken,
    /// Dots and labels, which they never cover.
    pub taken: Vec<Taken>,
    /// Thin lines, which they cross only where there is no other place.
    pub lines: Vec<Taken>,
}

/// Where the label of a dot goes without covering anything: how far its upper left corner is from the dot. To the
/// right, above or below, then farther away, never outside the room; beside the dot, pushed into the room, where nothing
/// is free.
pub fn free_spot(
    (x, y): (i32, i32),
    [width, height]: [i32; 2],
    pen: Pen,
    LabelRoom { inside: room, taken, lines }: &LabelRoom,
) -> ((i32, i32), Taken) {
    let gap = pen.at(6.0);
    let shifts = (0..16).flat_map(|away| {
        let lines = away * height;
        let (above, below) = (-height - gap / 2 - lines, gap / 2 + lines);
        [
            (gap, above),
            (gap, below),
            (-width - gap, above),
            (-width - gap, below),
            (gap + gap / 2, -height / 2 - lines),
            (-width - gap - gap / 2, -height / 2 - lines),
            (-width / 2, above - gap),
            (-width / 2, below + gap),
        ]
    });
    let spot =
        |(right, down): (i32, i32)| Taken { low: (x + right, y + down), high: (x + right + width, y + down + height) };
    let spots = shifts.map(|shift| (shift, spot(shift)));
    let inside = |spot: &Taken| {
        (spot.low.0 >= room.low.0 && spot.low.1 >= room.low.1)
            && (spot.high.0 <= room.high.0 && spot.high.1 <= room.high.1)
    };
    let is_free = |spot: &Taken, of: &[Taken]| !of.iter().any(|other| other.meets(spot));
    let mut allowed = spots.filter(|(_, spot)| inside(spot) && is_free(spot, taken));
    let first = allowed.clone().next();
    let free = allowed.find(|(_, spot)| is_free(spot, lines)).or(first);
    free.unwrap_or_else(|| {
        let push = |from: i32, low: i32, high: i32| from.min(high).max(low);
        let right = push(x + gap, room.low.0, room.high.0 - width) - x;
        let down = push(y - height, room.low.1, room.high.1 - height) - y;
        ((right, down), spot((right, down)))
    })
}

/// Thin boxes along a line that runs along no axis: what labels avoid of it.
pub fn along([a, b]: [(i32, i32); 2]) -> Vec<Taken> {
    // Pixels of a box: a letter is no smaller.
    const STEP: i32 = 6;
    let steps = ((b.0 - a.0).abs().max((b.1 - a.1).abs()) / STEP).max(1);
    let at = |k: i32| (a.0 + (b.0 - a.0) * k / steps, a.1 + (b.1 - a.1) * k / steps);
    (0..steps).map(|k| Taken::between([at(k), at(k + 1)])).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_label_that_is_far_from_its_dot_knows_its_nearest_point() {
        let spot = Taken { low: (20, 10), high: (60, 22) };
        assert_eq!(spot.far_from((0, 0), 15), Some((20, 10)));
        assert_eq!(spot.far_from((30, 5), 15), None);
        assert_eq!(Taken::between([(40, 7), (10, 7)]).far_from((25, 7), 1), None);
    }

    #[test]
    fn labels_of_dots_in_one_place_cover_nothing_and_stay_inside() {
        let room = Taken { low: (0, 0), high: (400, 300) };
        let mut room = LabelRoom { inside: room, taken: vec![Taken::around((390, 150), 5)], lines: Vec::new() };
        for _ in 0..20 {
            let (_, spot) = free_spot((390, 150), [40, 12], Pen::PLAIN, &room);
            assert!(spot.high.0 <= 400 && spot.low.1 >= 0 && spot.high.1 <= 300);
            assert!(room.taken.iter().all(|other| !other.meets(&spot)));
            room.taken.push(spot);
        }
    }

    #[test]
    fn a_label_that_finds_no_place_stays_in_the_room() {
        let inside = Taken { low: (0, 0), high: (100, 100) };
        let room = LabelRoom { inside, taken: vec![inside], lines: Vec::new() };
        let ((right, down), spot) = free_spot((90, 4), [60, 12], Pen::PLAIN, &room);
        assert_eq!((spot.low, spot.high), ((40, 0), (100, 12)));
        assert_eq!((90 + right, 4 + down), spot.low);
        // One that is wider than the room begins where that begins.
        assert_eq!(free_spot((90, 4), [160, 12], Pen::PLAIN, &room).1.low.0, 0);
    }

    #[test]
    fn boxes_along_a_line_leave_room_beside_it() {
        let boxes = along([(0, 0), (60, 60)]);
        let spot = |x: i32, y: i32| Taken { low: (x, y), high: (x + 8, y + 8) };
        assert!(boxes.iter().any(|part| part.meets(&spot(30, 30))));
        assert!(!boxes.iter().any(|part| part.meets(&spot(50, 10))));
        assert_eq!(along([(5, 5), (5, 5)]).len(), 1);
    }

    #[test]
    fn a_label_crosses_a_line_rather_than_a_label() {
        let inside = Taken { low: (0, 0), high: (100, 100) };
        let place = |taken: &[Taken], lines: &[Taken]| {
            let room = LabelRoom { inside, taken: taken.to_vec(), lines: lines.to_vec() };
            free_spot((10, 50), [60, 12], Pen::PLAIN, &room).1
        };
        // Nothing to its right but a line from top to bottom, and another label above and below.
        let line = Taken::between([(40, 0), (40, 100)]);
        let label = Taken { low: (16, 30), high: (76, 49) };
        let spot = place(&[label], &[line]);
        assert!(!spot.meets(&label) && spot.meets(&line) && spot.low.1 > 50, "{:?} {:?}", spot.low, spot.high);
        // A line that can be avoided is.
        let line = Taken::between([(40, 53), (40, 100)]);
        assert!(!place(&[], &[line]).meets(&line));
    }
}
