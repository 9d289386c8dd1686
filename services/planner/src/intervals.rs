//! Sets of instants, as sorted intervals.
//!
//! A node may hold thousands of bookings, and each new one changes the set. So the intervals lie in blocks: a
//! change touches one block, and a search skips blocks without a long enough interval.

/// The most intervals in a block. Most nodes need one block only.
const MOST_IN_A_BLOCK: usize = 64;

type Interval = (i64, i64);

/// Half-open intervals: sorted, disjoint, not touching, not empty.
#[derive(Clone, Debug, Default)]
pub(crate) struct Intervals {
    /// May be empty, but only if it is the only block. It is apart from the others because most sets have
    /// just one.
    first: Block,
    others: Vec<Block>,
}

#[derive(Clone, Debug, Default)]
struct Block {
    intervals: Vec<(i64, i64)>,
    longest: i64,
}

impl Block {
    fn new(intervals: Vec<(i64, i64)>) -> Self {
        let longest = longest(&intervals);
        Block { intervals, longest }
    }

    #[inline]
    fn end(&self) -> i64 {
        self.intervals.last().map_or(i64::MIN, |last| last.1)
    }
}

#[inline]
fn length((start, end): (i64, i64)) -> i64 {
    end.saturating_sub(start)
}

#[inline]
fn longest(intervals: &[(i64, i64)]) -> i64 {
    intervals.iter().map(|&interval| length(interval)).max().unwrap_or(0)
}

impl Intervals {
    pub fn union(mut intervals: Vec<(i64, i64)>) -> Self {
        intervals.retain(|(start, end)| start < end);
        intervals.sort_unstable();
        let mut joined: Vec<(i64, i64)> = Vec::with_capacity(intervals.len());
        for (start, end) in intervals {
            match joined.last_mut() {
                Some(last) if start <= last.1 => last.1 = last.1.max(end),
                _ => joined.push((start, end)),
            }
        }
        let mut blocks = joined.chunks(MOST_IN_A_BLOCK / 2).map(|chunk| Block::new(chunk.to_vec()));
        Intervals { first: blocks.next().unwrap_or_default(), others: blocks.collect() }
    }

    pub fn iter(&self) -> impl Iterator<Item = (i64, i64)> {
        self.after(i64::MIN)
    }

    /// Intervals that end after this instant.
    #[inline]
    pub fn after(&self, instant: i64) -> Long<'_> {
        self.long_after(instant, 0)
    }

    /// Intervals that end after this instant and are at least this long.
    #[inline]
    pub fn long_after(&self, instant: i64, least: i64) -> Long<'_> {
        let (block, at) = self.first_after(instant);
        let here = self.block(block).intervals[at..].iter();
        Long { least, here, blocks: self.others[block..].iter() }
    }

    /// The last interval that ends at or before this instant.
    #[inline]
    pub fn before(&self, instant: i64) -> Option<(i64, i64)> {
        self.around(instant).0
    }

    /// The last interval that ends at or before this instant, and the next one.
    #[inline]
    pub fn around(&self, instant: i64) -> (Option<Interval>, Option<Interval>) {
        let (block, at) = self.first_after(instant);
        let here = &self.block(block).intervals;
        let before = match (at.checked_sub(1), block.checked_sub(1)) {
            (Some(at), _) => here.get(at),
            (None, Some(block)) => self.block(block).intervals.last(),
            (None, None) => None,
        };
        (before.copied(), here.get(at).copied())
    }

    /// Whether one interval contains all of this time.
    #[inline]
    pub fn contains(&self, start: i64, end: i64) -> bool {
        self.around(start).1.is_some_and(|interval| interval.0 <= start && end <= interval.1)
    }

    /// Removes the time from `start` to just before `end`, whether present or not.
    pub fn take(&mut self, start: i64, end: i64) {
        if start >= end {
            return;
        }
        loop {
            let (block, at) = self.first_after(start);
            let found = self.block(block).intervals.get(at).copied();
            let Some((first, last)) = found.filter(|&(first, _)| first < end) else { return };
            let rest = [(first, start), (end, last)].into_iter().filter(|(start, end)| start < end);
            self.replace(block, at..at + 1, rest);
            if last >= end {
                return;
            }
        }
    }

    /// Adds time that is not in the set. It joins neighbours that it touches.
    pub fn give(&mut self, start: i64, end: i64) {
        if start >= end {
            return;
        }
        let (before, behind) = self.around(start);
        let mut joined = (start, end);
        if let Some(before) = before.filter(|before| before.1 == start) {
            joined.0 = before.0;
            self.take(before.0, before.1);
        }
        if let Some(behind) = behind.filter(|behind| behind.0 == end) {
            joined.1 = behind.1;
            self.take(behind.0, behind.1);
        }
        let (block, at) = self.first_after(joined.0);
        self.replace(block, at..at, [joined].into_iter());
    }

    fn block(&self, index: usize) -> &Block {
        index.checked_sub(1).map_or(&self.first, |other| &self.others[other])
    }

    /// Block and index of the first interval that ends after this instant. Without one, the end of the last
    /// block.
    #[inline]
    fn first_after(&self, instant: i64) -> (usize, usize) {
        let block = if self.others.is_empty() || self.first.end() > instant {
            0
        } else {
            // The search must not go past the last block.
            let others = &self.others[..self.others.len() - 1];
            1 + others.partition_point(|block| block.end() <= instant)
        };
        (block, self.block(block).intervals.partition_point(|interval| interval.1 <= instant))
    }

    /// Replaces intervals of a block. Splits a block that is too long, and removes one that is empty.
    fn replace(&mut self, index: usize, old: std::ops::Range<usize>, new: impl Iterator<Item = (i64, i64)>) {
        let block = match index.checked_sub(1) {
            None => &mut self.first,
            Some(other) => &mut self.others[other],
        };
        block.intervals.splice(old, new);
        block.longest = longest(&block.intervals);
        if block.intervals.len() > MOST_IN_A_BLOCK {
            let behind = block.intervals.split_off(block.intervals.len() / 2);
            block.longest = longest(&block.intervals);
            self.others.insert(index, Block::new(behind));
        } else if block.intervals.is_empty() && !self.others.is_empty() {
            let next = self.others.remove(index.saturating_sub(1));
            if index == 0 {
                self.first = next;
            }
        }
    }
}

/// Iterates over intervals of a minimum length.
pub(crate) struct Long<'a> {
    least: i64,
    here: std::slice::Iter<'a, (i64, i64)>,
    blocks: std::slice::Iter<'a, Block>,
}

impl Iterator for Long<'_> {
    type Item = (i64, i64);

    #[inline]
    fn next(&mut self) -> Option<(i64, i64)> {
        loop {
            for &interval in &mut self.here {
                if length(interval) >= self.least {
                    return Some(interval);
                }
            }
            self.here = self.blocks.find(|block| block.longest >= self.least)?.intervals.iter();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{Intervals, MOST_IN_A_BLOCK};
    use crate::chance::between;

    /// A reference set, instant by instant.
    struct Instants(Vec<bool>);

    impl Instants {
        fn intervals(&self) -> Vec<(i64, i64)> {
            let mut found: Vec<(i64, i64)> = Vec::new();
            for at in (0..self.0.len()).filter(|&at| self.0[at]) {
                match found.last_mut() {
                    Some(last) if last.1 == at as i64 => last.1 += 1,
                    _ => found.push((at as i64, at as i64 + 1)),
                }
            }
            found
        }
    }

    #[test]
    fn whatever_is_taken_and_given_the_intervals_are_those_of_the_instants() {
        const LENGTH: i64 = 2000;
        let mut most = 0;
        for seed in 0..4 {
            let mut instants = Instants(vec![true; LENGTH as usize]);
            let mut intervals = Intervals::union(vec![(0, LENGTH)]);
            for step in 0..3000 {
                let draw = |n: u64, low, high| between(seed, &[step, n], low, high);
                let start = draw(0, -5, LENGTH);
                let end = start + draw(1, 0, if draw(2, 0, 60) == 0 { 200 } else { 3 });
                let range = start.clamp(0, LENGTH) as usize..end.clamp(0, LENGTH) as usize;
                if draw(3, 0, 2) > 0 {
                    intervals.take(start, end);
                    instants.0[range].fill(false);
                } else if start >= 0 && end <= LENGTH && !instants.0[range.clone()].contains(&true) {
                    intervals.give(start, end);
                    instants.0[range].fill(true);
                }
                if step % 50 > 0 {
                    continue;
                }
                let expected = instants.intervals();
                most = most.max(expected.len());
                assert_eq!(intervals.iter().collect::<Vec<_>>(), expected, "seed {seed}, step {step}");
                let (at, least) = (draw(4, 0, LENGTH), draw(5, 0, 8));
                let long = expected.iter().copied().filter(|&(start, end)| end > at && end - start >= least);
                assert_eq!(intervals.long_after(at, least).collect::<Vec<_>>(), long.collect::<Vec<_>>());
                assert_eq!(intervals.before(at), expected.iter().copied().rfind(|&(_, end)| end <= at));
                let holds = expected.iter().any(|&(start, end)| start <= at && at + least <= end && at < end);
                assert_eq!(intervals.contains(at, at + least), holds, "{at} and {least} more");
            }
        }
        assert!(most > 3 * MOST_IN_A_BLOCK, "there were several blocks: {most}");
    }

    #[test]
    fn what_is_given_back_joins_its_neighbours() {
        let mut free = Intervals::union(vec![(0, 100)]);
        let all = |free: &Intervals| free.iter().collect::<Vec<_>>();
        free.take(10, 20);
        free.take(20, 30);
        free.give(10, 20);
        assert_eq!(all(&free), [(0, 20), (30, 100)]);
        free.give(20, 30);
        assert_eq!(all(&free), [(0, 100)]);
        free.take(0, 100);
        free.give(40, 50);
        assert_eq!(all(&free), [(40, 50)]);
    }
}
