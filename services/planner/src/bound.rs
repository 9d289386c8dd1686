//! Earliest ends that no plan can beat.

use crate::calendar::{FOREVER, Window};
use crate::model::{Bound, Node, in_millionths};
use crate::problem::{Problem, Work};

/// The earliest possible end of this job, if it had the farm to itself.
///
/// The frames' work must come out of the nodes' free time after the release. The longest frame, or the part
/// of it if it has as many as it may have, needs an unbroken stretch of one node after the shared cache,
/// which takes at least as long as its longest part. Without calendars the first bound is Σ w / Σ s, the
/// second max w / max s (Graham 1969).
pub(crate) fn bound(problem: &Problem, work: &Work) -> Bound {
    let job = work.job;
    let release = work.release(problem.input.now);
    let earliest = |classes: &[usize], class: u32, from: i64, amount: u64| {
        let nodes = classes.iter().flat_map(|&class| &problem.classes[class]);
        nodes
            .filter_map(|&node| {
                let place = &problem.nodes[node];
                first_end(place, &problem.windows[node], from, place.duration(amount, class)?)
            })
            .min()
    };
    let cached = match job.shared_cache.zip(work.shared_cache_part()) {
        None => Some(release),
        Some((cache, amount)) => earliest(&work.shared_cache_classes, cache.class, release, amount),
    };
    let longest = work.frames.iter().map(|frame| job.longest_part(frame.work, frame.division)).max();
    let Some(longest) = longest else {
        return Bound { by_capacity: cached, by_longest_frame: cached };
    };
    Bound {
        by_capacity: by_capacity(problem, &work.classes, job.class, release, work.total()),
        by_longest_frame: cached.and_then(|from| earliest(&work.classes, job.class, from, longest)),
    }
}

/// The bound of all jobs together. All work of a class counts from the first release, on all nodes that some
/// job can use. The longest frames count through their jobs' bounds.
pub(crate) fn bound_of_all(problem: &Problem, bounds: &[Bound]) -> Bound {
    let mut classes: Vec<u32> = problem.jobs.iter().map(|work| work.job.class).collect();
    classes.sort_unstable();
    classes.dedup();
    let mut by_capacity = Some(i64::MIN);
    for class in classes {
        let jobs = || problem.jobs.iter().filter(|work| work.job.class == class);
        let mut able: Vec<usize> = jobs().flat_map(|work| work.classes.iter().copied()).collect();
        able.sort_unstable();
        able.dedup();
        let release = jobs().map(|work| work.release(problem.input.now)).min().unwrap_or(problem.input.now);
        let end = crate::bound::by_capacity(problem, &able, class, release, jobs().map(Work::total).sum());
        by_capacity = by_capacity.zip(end).map(|(a, b)| a.max(b));
    }
    if problem.jobs.is_empty() {
        return Bound::default();
    }
    let latest = |part: fn(&Bound) -> Option<i64>| {
        bounds.iter().map(part).try_fold(i64::MIN, |latest, end| Some(latest.max(end?)))
    };
    Bound {
        by_capacity: by_capacity.zip(latest(|bound| bound.by_capacity)).map(|(a, b)| a.max(b)),
        by_longest_frame: latest(|bound| bound.by_longest_frame),
    }
}

/// The node that would end the job's longest frame first, as a whole, on an empty farm.
pub(crate) fn first_alone<'a>(problem: &Problem<'a>, work: &Work) -> Option<&'a Node> {
    let longest = work.frames.iter().map(|frame| frame.work).max()?;
    let release = work.release(problem.input.now);
    let nodes = work.classes.iter().flat_map(|&class| &problem.classes[class]);
    let ends = nodes.filter_map(|&node| {
        let place = problem.nodes[node];
        let duration = place.duration(longest, work.job.class)?;
        let end = first_end(place, &problem.windows[node], release, duration)?;
        Some((end, place.price_per_hour, place.id, place))
    });
    ends.min_by_key(|&(end, price, id, _)| (end, price, id)).map(|(.., place)| place)
}

fn first_end(node: &Node, windows: &[Window], from: i64, duration: i64) -> Option<i64> {
    windows.iter().find_map(|window| {
        let ready = if window.warm { window.start } else { window.start.saturating_add(node.setup) };
        ready.max(from).checked_add(duration).filter(|&end| end <= window.end)
    })
}

/// The first instant at which the free capacity since `release`, on these classes of nodes, reaches the work.
fn by_capacity(problem: &Problem, classes: &[usize], class: u32, release: i64, work: u128) -> Option<i64> {
    let mut left = in_millionths(work);
    if left == 0 {
        return Some(release);
    }
    let mut changes: Vec<(i64, bool, u64)> = Vec::new();
    for &node in classes.iter().flat_map(|&class| &problem.classes[class]) {
        let speed = problem.nodes[node].speed_of(class);
        for window in problem.windows[node].iter().filter(|window| window.end > release) {
            changes.push((window.start.max(release), true, speed));
            if window.end < FOREVER {
                changes.push((window.end, false, speed));
            }
        }
    }
    changes.push((FOREVER, false, 0));
    changes.sort_unstable();
    let mut rate = 0u128;
    let mut now = release;
    for (instant, opens, speed) in changes {
        let capacity = rate.saturating_mul(u128::from(instant.abs_diff(now)));
        if rate > 0 && capacity >= left {
            let stretch = i64::try_from(left.div_ceil(rate)).ok()?;
            return now.checked_add(stretch);
        }
        left -= capacity;
        now = instant;
        // Every window opens before it closes, so the rate never goes below zero.
        rate = if opens { rate + u128::from(speed) } else { rate - u128::from(speed) };
    }
    None
}
