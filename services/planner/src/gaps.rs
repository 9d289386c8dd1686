//! The gaps of a class of nodes, in one search tree.
//!
//! The tree is a treap (Seidel and Aragon 1996): sorted by start and node, and a heap by a hash of both, so
//! its depth grows with the logarithm of the number of gaps, whatever the order in which they came. Each
//! entry knows the longest gap and the latest end below it. So the first gap that is long enough, and one
//! that spans a given time, are found without a look at the others.

use forelight_random::{hash, mix};

use crate::looks::Looks;

/// Free time of a node. Ordered by start, then node.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Gap {
    pub start: i64,
    pub node: usize,
    pub end: i64,
}

/// Gaps, at most one per start and node.
#[derive(Clone, Debug, Default)]
pub(crate) struct Gaps {
    root: Link,
    entries: Vec<Entry>,
    spare: Vec<usize>,
    looks: Looks,
}

/// The root of a subtree, if it is not empty.
type Link = Option<u32>;

#[derive(Clone, Copy, Debug)]
struct Entry {
    gap: Gap,
    /// No entry below it has a higher rank.
    rank: u64,
    before: Link,
    behind: Link,
    /// Of this entry and all below it.
    longest: i64,
    last_end: i64,
}

impl Gap {
    fn length(&self) -> i64 {
        self.end.saturating_sub(self.start)
    }

    fn key(&self) -> (i64, usize) {
        (self.start, self.node)
    }
}

impl Gaps {
    pub fn new(looks: &Looks) -> Self {
        Gaps { looks: looks.clone(), ..Gaps::default() }
    }

    pub fn insert(&mut self, gap: Gap) {
        let rank = mix(hash(gap.start.cast_unsigned()) ^ gap.node as u64);
        let entry = Entry { gap, rank, before: None, behind: None, longest: gap.length(), last_end: gap.end };
        let index = match self.spare.pop() {
            Some(index) => {
                self.entries[index] = entry;
                index
            }
            None => {
                self.entries.push(entry);
                self.entries.len() - 1
            }
        };
        self.root = Some(self.put(self.root, index as u32));
    }

    /// Removes a node's gap with this start, if there is one.
    pub fn remove(&mut self, start: i64, node: usize) {
        self.root = self.cut(self.root, (start, node));
    }

    /// The first gap with at least this start, or this start and node, that is at least this long.
    pub fn next(&self, from: (i64, usize), length: i64) -> Option<Gap> {
        self.first_below(self.root, from, length)
    }

    /// Of the gaps that begin before an instant and end at or after another: the last to begin. Ties go to
    /// the first node.
    pub fn spanning(&self, instant: i64, end: i64) -> Option<Gap> {
        let last = self.last_below(self.root, instant, end)?;
        self.next((last.start, 0), end.saturating_sub(last.start))
    }

    /// The first gap that holds this length from an instant on, and when it does.
    pub fn first(&self, from: i64, length: i64) -> Option<(Gap, i64)> {
        let spanning = self.spanning(from, from.checked_add(length)?).map(|gap| (gap, from));
        spanning.or_else(|| self.next((from, 0), length).map(|gap| (gap, gap.start)))
    }

    fn at(&self, index: u32) -> &Entry {
        self.looks.add(1);
        &self.entries[index as usize]
    }

    fn first_below(&self, link: Link, from: (i64, usize), length: i64) -> Option<Gap> {
        let entry = self.at(link?);
        if entry.longest < length {
            return None;
        }
        if entry.gap.key() < from {
            return self.first_below(entry.behind, from, length);
        }
        let before = self.first_below(entry.before, from, length);
        let own = || Some(entry.gap).filter(|gap| gap.length() >= length);
        before.or_else(own).or_else(|| self.first_below(entry.behind, from, length))
    }

    fn last_below(&self, link: Link, before: i64, end: i64) -> Option<Gap> {
        let entry = self.at(link?);
        if entry.last_end < end {
            return None;
        }
        if entry.gap.start >= before {
            return self.last_below(entry.before, before, end);
        }
        let behind = self.last_below(entry.behind, before, end);
        let own = || Some(entry.gap).filter(|gap| gap.end >= end);
        behind.or_else(own).or_else(|| self.last_below(entry.before, before, end))
    }

    /// Puts an entry into a subtree, and returns its root.
    fn put(&mut self, link: Link, new: u32) -> u32 {
        let Some(root) = link else { return new };
        let (top, added) = (*self.at(root), self.entries[new as usize]);
        if (added.rank, added.gap) > (top.rank, top.gap) {
            let (before, behind) = self.split(link, added.gap.key());
            self.join_below(new, before, behind);
            return new;
        }
        if added.gap.key() < top.gap.key() {
            let before = Some(self.put(top.before, new));
            self.join_below(root, before, top.behind);
        } else {
            let behind = Some(self.put(top.behind, new));
            self.join_below(root, top.before, behind);
        }
        root
    }

    /// Takes an entry out of a subtree, and returns what remains.
    fn cut(&mut self, link: Link, key: (i64, usize)) -> Link {
        let root = link?;
        let top = *self.at(root);
        if top.gap.key() == key {
            self.spare.push(root as usize);
            return self.merge(top.before, top.behind);
        }
        if key < top.gap.key() {
            let before = self.cut(top.before, key);
            self.join_below(root, before, top.behind);
        } else {
            let behind = self.cut(top.behind, key);
            self.join_below(root, top.before, behind);
        }
        Some(root)
    }

    /// Splits a subtree into what comes before the key, and the rest.
    fn split(&mut self, link: Link, key: (i64, usize)) -> (Link, Link) {
        let Some(root) = link else { return (None, None) };
        let top = *self.at(root);
        if top.gap.key() < key {
            let (before, behind) = self.split(top.behind, key);
            self.join_below(root, top.before, before);
            (link, behind)
        } else {
            let (before, behind) = self.split(top.before, key);
            self.join_below(root, behind, top.behind);
            (before, link)
        }
    }

    /// Joins two subtrees, all of the first before the second.
    fn merge(&mut self, before: Link, behind: Link) -> Link {
        let (Some(first), Some(second)) = (before, behind) else { return before.or(behind) };
        let (one, other) = (*self.at(first), *self.at(second));
        if (one.rank, one.gap) > (other.rank, other.gap) {
            let rest = self.merge(one.behind, behind);
            self.join_below(first, one.before, rest);
            before
        } else {
            let rest = self.merge(before, other.before);
            self.join_below(second, rest, other.behind);
            behind
        }
    }

    /// Gives an entry these subtrees.
    fn join_below(&mut self, index: u32, before: Link, behind: Link) {
        let gap = self.entries[index as usize].gap;
        let (mut longest, mut last_end) = (gap.length(), gap.end);
        for below in [before, behind].into_iter().flatten() {
            let below = &self.entries[below as usize];
            longest = longest.max(below.longest);
            last_end = last_end.max(below.last_end);
        }
        let entry = &mut self.entries[index as usize];
        *entry = Entry { before, behind, longest, last_end, ..*entry };
    }
}

#[cfg(test)]
mod tests {
    use std::cmp::Reverse;

    use super::{Gap, Gaps};
    use crate::chance::between;

    #[test]
    fn whatever_comes_and_goes_searches_find_what_a_look_at_all_gaps_finds() {
        for seed in 0..4 {
            let mut gaps = Gaps::default();
            let mut all: Vec<Gap> = Vec::new();
            for step in 0..3000 {
                let draw = |n: u64, low, high| between(seed, &[step, n], low, high);
                let start = draw(0, -50, 500);
                let gap = Gap { start, node: draw(1, 0, 9) as usize, end: start + draw(2, 1, 60) };
                all.retain(|other| other.key() != gap.key());
                gaps.remove(gap.start, gap.node);
                if draw(3, 0, 2) > 0 {
                    all.push(gap);
                    gaps.insert(gap);
                }
                let (from, length) = ((draw(4, -60, 510), draw(5, 0, 9) as usize), draw(6, 0, 70));
                let long = || all.iter().filter(|gap| gap.length() >= length);
                let next = long().filter(|gap| gap.key() >= from).min();
                assert_eq!(gaps.next(from, length), next.copied(), "seed {seed}, step {step}");
                let spans = |gap: &&Gap| gap.start < from.0 && gap.end >= from.0 + length;
                let last = all.iter().filter(spans).max_by_key(|gap| (gap.start, Reverse(gap.node)));
                assert_eq!(gaps.spanning(from.0, from.0 + length), last.copied());
            }
            assert!(all.len() > 100, "{}", all.len());
        }
    }

    #[test]
    fn a_search_looks_at_few_gaps_in_whatever_order_they_came() {
        for in_order in [false, true] {
            let mut gaps = Gaps::default();
            for n in 0..100_000 {
                let start = if in_order { n } else { n * 7919 % 100_000 };
                gaps.insert(Gap { start, node: 0, end: start + 1 });
            }
            let before = gaps.looks.count();
            for n in 0..1000 {
                assert_eq!(gaps.next((n * 97, 0), 1).map(|gap| gap.start), Some(n * 97));
                assert_eq!(gaps.next((n * 97, 0), 2), None);
                assert_eq!(gaps.spanning(n * 97, n * 97 + 1), None);
            }
            let looks = gaps.looks.count() - before;
            assert!(looks < 3 * 1000 * 50, "{looks} looks for 3000 searches among 100,000 gaps");
        }
    }
}
