//! What no plan can beat.

use crate::calendar::FreeTime;
use crate::model::{Bound, Node, in_millionths};

/// The earliest conceivable end of this work, released at `release`, on these nodes in their free time.
///
/// Any plan takes the frames' work out of the nodes' free time after the release, and gives the longest frame
/// an unbroken stretch of one node; so neither part can be beaten. Without calendars the first is Σ w / Σ s,
/// the second max w / max s (Graham 1969).
pub(crate) fn bound(nodes: &[(&Node, FreeTime)], release: i64, works: &[u64]) -> Bound {
    let Some(&longest) = works.iter().max() else {
        return Bound { by_capacity: Some(release), by_longest_frame: Some(release) };
    };
    Bound {
        by_capacity: by_capacity(nodes, release, works.iter().map(|&work| u128::from(work)).sum()),
        by_longest_frame: nodes
            .iter()
            .filter_map(|(node, free)| placement(node, free, release, longest))
            .map(|(_, end)| end)
            .min(),
    }
}

/// Start and end of this work on a node, as early as it can be; none if it never can.
pub(crate) fn placement(node: &Node, free: &FreeTime, release: i64, work: u64) -> Option<(i64, i64)> {
    let duration = node.duration(work)?;
    let start = free.earliest_start(release, duration)?;
    Some((start, start.checked_add(duration)?))
}

/// The first instant at which the free capacity since `release` reaches the work.
fn by_capacity(nodes: &[(&Node, FreeTime)], release: i64, work: u128) -> Option<i64> {
    let mut left = in_millionths(work);
    if left == 0 {
        return Some(release);
    }
    let mut changes: Vec<(i64, bool, u64)> = Vec::new();
    for (node, free) in nodes {
        for (start, end) in free.from(release) {
            changes.push((start, true, node.speed));
            changes.push((end, false, node.speed));
        }
    }
    changes.sort_unstable();
    let mut rate = 0u128;
    let mut now = release;
    for (instant, opens, speed) in changes {
        let capacity = rate.saturating_mul(u128::from(instant.abs_diff(now)));
        if rate > 0 && capacity >= left {
            // The quotient is at most the length of this stretch.
            let stretch = i64::try_from(left.div_ceil(rate)).ok()?;
            return now.checked_add(stretch);
        }
        left -= capacity;
        now = instant;
        // Intervals are not empty, so what closes here opened at an earlier instant and the rate stays at
        // zero or above.
        rate = if opens { rate + u128::from(speed) } else { rate - u128::from(speed) };
    }
    None
}
