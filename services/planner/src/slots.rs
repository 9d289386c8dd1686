//! Slots of time for the linear programme of [`crate::admission`].

use crate::calendar::Window;
use crate::problem::Problem;

/// More slots gain little.
const MOST_SLOTS: usize = 96;

/// Where slots begin, and where the last one ends: at deadlines, releases and calendars. If these are too
/// many, at some of the deadlines and releases, and at a quarter and a half of the first slot. Empty without
/// a deadline.
pub(crate) fn slots(problem: &Problem, most_rows: usize) -> Vec<i64> {
    let now = problem.input.now;
    let with_deadline = || problem.jobs.iter().filter_map(|work| Some((work, work.job.deadline?)));
    let Some(horizon) = with_deadline().map(|(_, deadline)| deadline).max() else { return Vec::new() };
    let start = with_deadline().map(|(work, _)| work.release(now)).min().unwrap_or(now).max(now);
    if horizon <= start {
        return Vec::new();
    }
    let most = (most_rows / problem.classes.len().max(1)).clamp(8, MOST_SLOTS);

    let mut of_jobs: Vec<i64> =
        with_deadline().flat_map(|(work, deadline)| [work.release(now), deadline]).collect();
    let mut of_nodes: Vec<i64> = problem.windows.iter().flatten().flat_map(|w| [w.start, w.end]).collect();
    for instants in [&mut of_jobs, &mut of_nodes] {
        instants.retain(|&instant| instant > start && instant < horizon);
        instants.sort_unstable();
    }
    let mut all = of_jobs.clone();
    all.extend_from_slice(&of_nodes);
    all.sort_unstable();
    all.dedup();
    if all.len() > most {
        // Deadlines and releases matter most: calendars only say where time lies within a slot. Slots are
        // short where there are many of them, and nowhere long. Before the jobs of a later slot are released,
        // earlier jobs use its time. The first slot has no earlier jobs, so it is cut in three.
        all = spread(&of_jobs, most - 2, (start, horizon));
        let first = all.first().map_or(0, |&end| end.saturating_sub(start));
        all.splice(0..0, [start + first / 4, start + first / 2]);
    }
    all.insert(0, start);
    all.push(horizon);
    all.dedup();
    all
}

/// Up to `most` of these sorted instants: half as if every n-th were taken, duplicates included, and half
/// as if they were taken at equal distances in time.
fn spread(instants: &[i64], most: usize, (start, horizon): (i64, i64)) -> Vec<i64> {
    let (count, length) = (instants.len().max(1) as i128, (i128::from(horizon) - i128::from(start)).max(1));
    let mut found = Vec::new();
    let mut taken = 0;
    for (rank, &instant) in instants.iter().enumerate() {
        // From 0 to 2, in parts of the product of count and length.
        let passed = rank as i128 * length + (i128::from(instant) - i128::from(start)) * count;
        let step = passed * most as i128 / (2 * count * length);
        if step > taken {
            taken = step;
            found.push(instant);
        }
    }
    found.dedup();
    found
}

/// Free time of each class in each slot, microseconds.
pub(crate) fn capacity(problem: &Problem, slots: &[i64]) -> Vec<Vec<u128>> {
    let count = slots.len().saturating_sub(1);
    problem
        .classes
        .iter()
        .map(|members| {
            let mut free = vec![0u128; count];
            for &Window { start, end, .. } in members.iter().flat_map(|&node| &problem.windows[node]) {
                let first = slots.partition_point(|&slot| slot <= start).saturating_sub(1);
                for (slot, free) in free.iter_mut().enumerate().skip(first) {
                    let (from, until) = (start.max(slots[slot]), end.min(slots[slot + 1]));
                    if slots[slot] >= end {
                        break;
                    }
                    if from < until {
                        *free += u128::from(until.abs_diff(from));
                    }
                }
            }
            free
        })
        .collect()
}
