//! Earliest ends that no plan can beat.

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
        classes.iter().filter_map(|&of_nodes| first_end(problem, of_nodes, from, (class, amount))).min()
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
    let mut capacity = Some(i64::MIN);
    for class in classes {
        let jobs = || problem.jobs.iter().filter(|work| work.job.class == class);
        let mut able: Vec<usize> = jobs().flat_map(|work| work.classes.iter().copied()).collect();
        able.sort_unstable();
        able.dedup();
        let release = jobs().map(|work| work.release(problem.input.now)).min().unwrap_or(problem.input.now);
        let end = by_capacity(problem, &able, class, release, jobs().map(Work::total).sum());
        capacity = capacity.zip(end).map(|(a, b)| a.max(b));
    }
    if problem.jobs.is_empty() {
        return Bound::default();
    }
    let latest = |part: fn(&Bound) -> Option<i64>| {
        bounds.iter().map(part).try_fold(i64::MIN, |latest, end| Some(latest.max(end?)))
    };
    Bound {
        by_capacity: capacity.zip(latest(|bound| bound.by_capacity)).map(|(a, b)| a.max(b)),
        by_longest_frame: latest(|bound| bound.by_longest_frame),
    }
}

/// The node that would end the job's longest frame first, as a whole, on an empty farm.
pub(crate) fn first_alone<'a>(problem: &Problem<'a>, work: &Work) -> Option<&'a Node> {
    let longest = work.frames.iter().map(|frame| frame.work).max()?;
    let release = work.release(problem.input.now);
    let ends = work.classes.iter().filter_map(|&class| {
        let node = problem.representative(class);
        let end = first_end(problem, class, release, (work.job.class, longest))?;
        Some((end, node.price_per_hour, class, node))
    });
    ends.min_by_key(|&(end, price, class, _)| (end, price, class)).map(|(.., node)| node)
}

/// When a class of nodes, without bookings, first ends this work of a class.
fn first_end(problem: &Problem, class: usize, from: i64, (of_work, amount): (u32, u64)) -> Option<i64> {
    let duration = problem.representative(class).duration(amount, of_work)?;
    let (_, start) = problem.supply.gaps[class].first(from, duration)?;
    start.checked_add(duration)
}

/// The first instant at which the free capacity since `release`, on these classes of nodes, reaches the work.
fn by_capacity(problem: &Problem, classes: &[usize], class: u32, release: i64, work: u128) -> Option<i64> {
    let speed = |&index: &usize| (index, problem.representative(index).speed_of(class));
    let speeds: Vec<(usize, u64)> = classes.iter().map(speed).collect();
    problem.supply.reaches(in_millionths(work), release, &speeds)
}
