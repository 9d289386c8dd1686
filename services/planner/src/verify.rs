//! An independent check of a plan.
//!
//! It knows what a plan must be and nothing of how one is made: it uses the words of `model` and the meaning of a proof,
//! and would pass a plan made by hand.

use std::collections::{BTreeMap, BTreeSet};

use crate::model::{
    Booking, Bound, Input, InputError, Interval, Job, JobPlan, Node, Plan, Power, Rental, Seed, Task, Verdict,
};
use crate::proof::{Counted, value};

/// Something that is wrong with a plan.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum Violation {
    /// The input itself has no meaning, so no plan can be right.
    #[error("the input has no meaning: {0}")]
    Input(#[from] InputError),
    /// A booking of an unknown node, job or task.
    #[error("job {}, {} on node {}: no such thing", .0.job, .0.task, .0.node)]
    Unknown(Booking),
    /// A task has more than one booking, or is also said to be unplaced.
    #[error("job {job}, {task} is booked twice, or booked and called unplaced")]
    Twice {
        /// The job.
        job: u64,
        /// The task.
        task: Task,
    },
    /// A task is neither booked nor called unplaced.
    #[error("job {job}, {task} is missing")]
    Missing {
        /// The job.
        job: u64,
        /// The task.
        task: Task,
    },
    /// A task is called unplaced although the job has no such task.
    #[error("job {job} has no {task} that could be unplaced")]
    UnknownUnplaced {
        /// The job.
        job: u64,
        /// The task.
        task: Task,
    },
    /// A frame is split where the job does not allow it, or into parts that do not make it up.
    #[error("job {}, {} on node {}: must not be split like this", .0.job, .0.task, .0.node)]
    Split(Booking),
    /// A node cannot do the work, or has too little memory.
    #[error("job {}, {} on node {}: the node cannot render it", .0.job, .0.task, .0.node)]
    Unfit(Booking),
    /// A booking does not last as long as its node takes for the task's work.
    #[error("job {}, {} on node {}: not as long as its work takes", .0.job, .0.task, .0.node)]
    Duration(Booking),
    /// A booking starts before its job is released, or before the plan is made.
    #[error("job {}, {} on node {}: starts before its release", .0.job, .0.task, .0.node)]
    Release(Booking),
    /// A frame starts before the job's seed ends.
    #[error("job {}, {} on node {}: starts before the seed is done", .0.job, .0.task, .0.node)]
    Precedence(Booking),
    /// A booking is not within the node's calendar, or before the node is available.
    #[error("job {}, {} on node {}: the node is not free for rendering", .0.job, .0.task, .0.node)]
    Calendar(Booking),
    /// A booking overlaps another one, or a fixed one, on its node.
    #[error("job {}, {} on node {}: overlaps another booking", .0.job, .0.task, .0.node)]
    Overlap(Booking),
    /// A booking is not within exactly one rental after its set-up.
    #[error("job {}, {} on node {}: is not within one rental", .0.job, .0.task, .0.node)]
    NotRented(Booking),
    /// A rental is not in its node's free time, overlaps another, begins without the set-up that it needs, or is
    /// longer than its frames.
    #[error("node {}: the rental from {} to {} {wrong}", .rental.node, .rental.start, .rental.end)]
    Rental {
        /// The rental.
        rental: Rental,
        /// What is wrong with it.
        wrong: &'static str,
    },
    /// More of a limit is held than there is.
    #[error("limit {limit}: {held} are held at {instant}, but there are {count}")]
    Limit {
        /// The limit.
        limit: u64,
        /// When.
        instant: i64,
        /// Units held.
        held: u64,
        /// Units that there are.
        count: u64,
    },
    /// A job has no verdict, or more than one.
    #[error("job {job} has {verdicts} verdicts")]
    Verdicts {
        /// The job.
        job: u64,
        /// How many it has.
        verdicts: usize,
    },
    /// A verdict for a job that does not exist.
    #[error("a verdict names job {job}, which does not exist")]
    UnknownJob {
        /// The job.
        job: u64,
    },
    /// A verdict does not follow from the bookings.
    #[error("job {job}: the verdict is not what the bookings say")]
    Verdict {
        /// The job.
        job: u64,
    },
    /// A job's cost, or whether it is within budget, does not follow from the rentals.
    #[error(
        "job {job}: the cost is {stated}, but its part of the rentals is {found}, or the budget is judged wrongly"
    )]
    Cost {
        /// The job.
        job: u64,
        /// Cost in the plan.
        stated: i64,
        /// Its part of the rentals.
        found: i64,
    },
    /// The costs of the rentals do not add up to the plan's.
    #[error("the plan's cost is {stated}, but its rentals cost {found}")]
    TotalCost {
        /// Cost in the plan.
        stated: i64,
        /// Cost of the rentals.
        found: i64,
    },
    /// Something ends before the bound that nothing can beat.
    #[error("{}: ends before its bound", .job.map_or("the plan".into(), |job| format!("job {job}")))]
    Bound {
        /// The job, or none for all together.
        job: Option<u64>,
    },
    /// The cost bound does not follow from its proof, or the plan costs less.
    #[error("the cost bound is {stated}, but the proof gives {found}, and the plan costs {cost}")]
    CostBound {
        /// Bound in the plan.
        stated: i64,
        /// What the proof gives.
        found: i64,
        /// What the plan costs.
        cost: i64,
    },
    /// The plan says that no plan keeps all deadlines, but does not prove it.
    #[error("the proof that not all deadlines can be met proves nothing")]
    Infeasible,
}

/// Checks a plan against its input: every frame once, on a node that can render it, in the node's free time, after
/// its release and its job's seed, as long as its work takes, alone on its node and within the limits; every
/// booking paid for; and verdicts, costs, bounds and proofs in agreement with that.
///
/// # Errors
/// Everything that is wrong.
pub fn verify(input: &Input, plan: &Plan) -> Result<(), Vec<Violation>> {
    if let Err(error) = input.check() {
        return Err(vec![error.into()]);
    }
    let nodes: BTreeMap<u64, &Node> = input.nodes.iter().map(|node| (node.id, node)).collect();
    let mut by_node: BTreeMap<u64, (Vec<Booking>, Vec<Rental>)> = BTreeMap::new();
    let mut by_job: BTreeMap<u64, Vec<Booking>> = BTreeMap::new();
    for &booking in &plan.bookings {
        by_node.entry(booking.node).or_default().0.push(booking);
        by_job.entry(booking.job).or_default().push(booking);
    }
    for &rental in &plan.rentals {
        by_node.entry(rental.node).or_default().1.push(rental);
    }
    let mut fixed: BTreeMap<u64, Vec<(i64, i64)>> = BTreeMap::new();
    for booking in input.fixed.iter().filter(|booking| booking.start < booking.end) {
        fixed.entry(booking.node).or_default().push((booking.start, booking.end));
    }
    let mut found = Vec::new();

    let mut costs: BTreeMap<u64, i128> = BTreeMap::new();
    for (id, (mut bookings, rentals)) in by_node {
        let Some(node) = nodes.get(&id) else {
            found.extend(bookings.into_iter().map(Violation::Unknown));
            found.extend(
                rentals.into_iter().map(|rental| Violation::Rental { rental, wrong: "names no node" }),
            );
            continue;
        };
        bookings.sort_unstable();
        let fixed = fixed.remove(&id).unwrap_or_default();
        check_node(input, node, &bookings, &fixed, &mut found);
        check_rentals(input, node, &bookings, rentals, &fixed, &mut costs, &mut found);
    }
    check_limits(input, plan, &mut found);
    let mut ends = Some(i64::MIN);
    for job in &input.jobs {
        let bookings = by_job.remove(&job.id).unwrap_or_default();
        let verdicts: Vec<&JobPlan> = plan.jobs.iter().filter(|entry| entry.job == job.id).collect();
        let cost = costs.get(&job.id).copied().unwrap_or(0);
        match verdicts[..] {
            [entry] => {
                let end = check_job(&nodes, input, job, entry, &bookings, cost, &mut found);
                ends = ends.zip(end).map(|(a, b)| a.max(b));
            }
            _ => found.push(Violation::Verdicts { job: job.id, verdicts: verdicts.len() }),
        }
    }
    found.extend(by_job.into_values().flatten().map(Violation::Unknown));
    let known: BTreeSet<u64> = input.jobs.iter().map(|job| job.id).collect();
    let strangers = plan.jobs.iter().filter(|entry| !known.contains(&entry.job));
    found.extend(strangers.map(|entry| Violation::UnknownJob { job: entry.job }));
    if !input.jobs.is_empty() && ends.is_some_and(|end| beats(end, plan.bound)) {
        found.push(Violation::Bound { job: None });
    }
    check_costs(input, plan, &mut found);
    if found.is_empty() { Ok(()) } else { Err(found) }
}

/// No overlaps, and nothing outside the calendar.
fn check_node(
    input: &Input,
    node: &Node,
    bookings: &[Booking],
    fixed: &[(i64, i64)],
    found: &mut Vec<Violation>,
) {
    let open = sorted(&node.calendar);
    let mut busy_until = i64::MIN;
    for &booking in bookings {
        if !is_open(input, node, &open, booking.start, booking.end) {
            found.push(Violation::Calendar(booking));
        }
        if booking.start >= booking.end {
            continue;
        }
        let with_fixed = fixed.iter().any(|&(start, end)| start < booking.end && booking.start < end);
        if booking.start < busy_until || with_fixed {
            found.push(Violation::Overlap(booking));
        }
        busy_until = busy_until.max(booking.end);
    }
}

fn sorted(calendar: &[Interval]) -> Vec<Interval> {
    let mut open = calendar.to_vec();
    open.sort_unstable_by_key(|interval| interval.start);
    open
}

/// Whether the node may be used from `start` to just before `end`, as far as calendar and maintenance go.
fn is_open(input: &Input, node: &Node, open: &[Interval], start: i64, end: i64) -> bool {
    let closed = node.maintenance.iter().any(|closed| {
        let until = closed.end.unwrap_or(i64::MAX);
        closed.start < until && closed.start < end && start < until
    });
    start >= node.available_from.max(input.now) && !closed && covered(open, start, end)
}

/// Whether the intervals, sorted by start, together cover all time from `start` to `end`.
fn covered(open: &[Interval], start: i64, end: i64) -> bool {
    let mut reached = start;
    for interval in open {
        if reached >= end || interval.start > reached {
            break;
        }
        match interval.end {
            None => return true,
            Some(until) => reached = reached.max(until),
        }
    }
    reached >= end
}

/// Every booking is paid for, every rental is in order, and what it costs is dealt out to the jobs.
fn check_rentals(
    input: &Input,
    node: &Node,
    bookings: &[Booking],
    mut rentals: Vec<Rental>,
    fixed: &[(i64, i64)],
    costs: &mut BTreeMap<u64, i128>,
    found: &mut Vec<Violation>,
) {
    rentals.sort_unstable_by_key(|rental| (rental.start, rental.end));
    let open = sorted(&node.calendar);
    let mut paid_until = i64::MIN;
    let mut paid = vec![false; bookings.len()];
    for &rental in &rentals {
        let mut wrong = |wrong| found.push(Violation::Rental { rental, wrong });
        if rental.start < paid_until {
            wrong("overlaps another one");
        }
        paid_until = paid_until.max(rental.end);
        let taken = fixed.iter().any(|&(start, end)| start < rental.end && rental.start < end);
        if taken || !is_open(input, node, &open, rental.start, rental.end) {
            wrong("is not in the node's free time");
        }
        let ready = if rental.setup { rental.start.saturating_add(node.setup) } else { rental.start };
        let runs_already = (node.power == Power::On && rental.start == node.available_from.max(input.now))
            || fixed.iter().any(|&(_, end)| end == rental.start);
        if !rental.setup && !runs_already && (node.setup > 0 || node.setup_cost > 0) {
            wrong("begins without the set-up that it needs");
        }
        if rental.cost != node.price(rental.end.saturating_sub(rental.start), rental.setup) {
            wrong("does not cost what its time costs");
        }
        let first = bookings.partition_point(|booking| booking.start < ready);
        let beyond = bookings.partition_point(|booking| booking.start < rental.end).max(first);
        let within = &bookings[first..beyond];
        if within.iter().map(|booking| booking.end).max() != Some(rental.end) {
            wrong("does not end with a frame");
        }
        paid[first..beyond].iter_mut().for_each(|paid| *paid = true);
        let total: i128 = within.iter().map(length).sum();
        let mut before = 0;
        for booking in within {
            let upto = before + length(booking);
            let part = |time: i128| i128::from(rental.cost).saturating_mul(time) / total.max(1);
            *costs.entry(booking.job).or_default() += part(upto) - part(before);
            before = upto;
        }
    }
    let unpaid = bookings.iter().zip(paid).filter(|(_, paid)| !paid);
    found.extend(unpaid.map(|(&booking, _)| Violation::NotRented(booking)));
}

fn length(booking: &Booking) -> i128 {
    i128::from(booking.end) - i128::from(booking.start)
}

/// Never more held than there is.
fn check_limits(input: &Input, plan: &Plan, found: &mut Vec<Violation>) {
    let jobs: BTreeMap<u64, &Job> = input.jobs.iter().map(|job| (job.id, job)).collect();
    for limit in &input.limits {
        let of = |uses: &[crate::model::LimitUse]| {
            uses.iter()
                .filter(|held| held.limit == limit.id)
                .fold(0i128, |sum, held| sum + i128::from(held.count))
        };
        // Ends before starts at the same instant: what is given back can be taken.
        let mut changes: Vec<(i64, i128)> = Vec::new();
        let mut hold = |start: i64, end: i64, count: i128| {
            if start < end && count > 0 {
                changes.push((start, count));
                changes.push((end, -count));
            }
        };
        let mut fixed_alone: Vec<(i64, i128)> = Vec::new();
        for booking in &input.fixed {
            hold(booking.start, booking.end, of(&booking.uses));
        }
        for booking in &plan.bookings {
            let count = jobs.get(&booking.job).map_or(0, |job| of(&job.uses));
            hold(booking.start, booking.end, count);
            if count > 0 {
                fixed_alone.push((booking.start, count));
            }
        }
        changes.sort_unstable();
        fixed_alone.sort_unstable();
        let mut held = 0i128;
        for (instant, change) in changes {
            held += change;
            // Fixed bookings are facts, even where they hold too much; only what the plan adds can be wrong.
            let starts_here = fixed_alone.binary_search(&(instant, change)).is_ok();
            if change > 0 && starts_here && held > i128::from(limit.count) {
                let held = u64::try_from(held).unwrap_or(u64::MAX);
                found.push(Violation::Limit { limit: limit.id, instant, held, count: limit.count });
            }
        }
    }
}

/// Every task once and rightly booked, and what the plan says of the job is true. Returns the end of the last
/// task, or none if one has no place.
fn check_job(
    nodes: &BTreeMap<u64, &Node>,
    input: &Input,
    job: &Job,
    entry: &JobPlan,
    bookings: &[Booking],
    cost: i128,
    found: &mut Vec<Violation>,
) -> Option<i64> {
    let works: BTreeMap<i64, u64> = job.open_work().collect();
    let (unplaced, seed_unplaced) = match &entry.verdict {
        Verdict::Unplaced { frames, seed } => (&frames[..], *seed),
        _ => (&[][..], false),
    };
    let seed_end = bookings.iter().filter(|booking| booking.task.is_seed()).map(|booking| booking.end).max();
    let release = job.release.max(input.now);
    let mut tasks: BTreeSet<Task> = BTreeSet::new();
    for &booking in bookings {
        let work = match booking.task {
            task @ (Task::Seed | Task::SeedPart { .. }) => {
                job.seed.zip(job.seed_work(task)).map(|(seed, work)| (seed.class, work))
            }
            Task::Frame(frame) => works.get(&frame).map(|&work| (job.class, work)),
            Task::Tile { frame, parts, .. } => {
                works.get(&frame).map(|&work| (job.class, job.tile_work(work, parts)))
            }
        };
        let Some((class, work)) = work else {
            found.push(Violation::Unknown(booking));
            continue;
        };
        if !tasks.insert(booking.task) {
            found.push(Violation::Twice { job: job.id, task: booking.task });
        }
        if let Task::Tile { part, parts, .. } = booking.task
            && (part >= parts || parts > job.tiles || parts < 2)
        {
            found.push(Violation::Split(booking));
        }
        if booking.start < release {
            found.push(Violation::Release(booking));
        }
        let is_frame = !booking.task.is_seed();
        if is_frame && job.seed.is_some() && seed_end.is_none_or(|end| booking.start < end) {
            found.push(Violation::Precedence(booking));
        }
        if let Some(node) = nodes.get(&booking.node) {
            if !node.fits(job) || node.speed_of(class) == 0 {
                found.push(Violation::Unfit(booking));
            }
            let end = node.duration(work, class).and_then(|duration| booking.start.checked_add(duration));
            if end != Some(booking.end) {
                found.push(Violation::Duration(booking));
            }
        }
    }
    check_complete(job, &tasks, unplaced, seed_unplaced, &works, bookings, found);

    let finish = bookings.iter().map(|booking| booking.end).max().unwrap_or(release);
    if !is_true(job, entry, finish) {
        found.push(Violation::Verdict { job: job.id });
    }
    let cost = i64::try_from(cost).unwrap_or(i64::MAX);
    if entry.cost != cost || entry.within_budget != job.budget.map(|budget| cost <= budget) {
        found.push(Violation::Cost { job: job.id, stated: entry.cost, found: cost });
    }
    let is_placed = unplaced.is_empty() && !seed_unplaced;
    if is_placed && beats(finish, entry.bound) {
        found.push(Violation::Bound { job: Some(job.id) });
    }
    is_placed.then_some(finish)
}

/// Every frame is booked whole, or in all its tiles, or called unplaced; and so is the seed.
fn check_complete(
    job: &Job,
    tasks: &BTreeSet<Task>,
    unplaced: &[i64],
    seed_unplaced: bool,
    works: &BTreeMap<i64, u64>,
    bookings: &[Booking],
    found: &mut Vec<Violation>,
) {
    let mut by_frame: BTreeMap<i64, Vec<Task>> = BTreeMap::new();
    for &task in tasks {
        if let Some(frame) = task.frame() {
            by_frame.entry(frame).or_default().push(task);
        }
    }
    let mut called = BTreeSet::new();
    for &frame in unplaced {
        if !works.contains_key(&frame) {
            found.push(Violation::UnknownUnplaced { job: job.id, task: Task::Frame(frame) });
        } else if !called.insert(frame) || by_frame.contains_key(&frame) {
            found.push(Violation::Twice { job: job.id, task: Task::Frame(frame) });
        }
    }
    for &frame in works.keys().filter(|frame| !called.contains(frame)) {
        let has = by_frame.get(&frame).map_or(&[][..], |tasks| &tasks[..]);
        match has {
            [] => found.push(Violation::Missing { job: job.id, task: Task::Frame(frame) }),
            [Task::Frame(_)] => {}
            [Task::Tile { parts, .. }, ..] => {
                let parts = *parts;
                let all = |part| tasks.contains(&Task::Tile { frame, part, parts });
                if has.len() != parts as usize || !(0..parts).all(all) {
                    let booking = bookings.iter().find(|booking| booking.task.frame() == Some(frame));
                    found.extend(booking.map(|&booking| Violation::Split(booking)));
                }
            }
            [task, ..] => found.push(Violation::Twice { job: job.id, task: *task }),
        }
    }
    let mut parts = job.seed.into_iter().flat_map(Seed::tasks);
    let missing = parts.find(|part| !tasks.contains(part));
    match (job.seed.is_some(), missing, seed_unplaced) {
        (true, Some(task), false) => found.push(Violation::Missing { job: job.id, task }),
        (true, None, true) => found.push(Violation::Twice { job: job.id, task: Task::Seed }),
        (false, _, true) => found.push(Violation::UnknownUnplaced { job: job.id, task: Task::Seed }),
        _ => {}
    }
}

/// Whether the verdict is what the deadline and the last end make it.
fn is_true(job: &Job, entry: &JobPlan, end: i64) -> bool {
    match (&entry.verdict, job.deadline) {
        (Verdict::Unplaced { frames, seed }, _) => !frames.is_empty() || *seed,
        (Verdict::NoDeadline { finish }, None) => *finish == end,
        (Verdict::Feasible { finish, slack }, Some(deadline)) => {
            *finish == end && end <= deadline && *slack == deadline.saturating_sub(end)
        }
        (Verdict::Late { finish, by, unavoidable }, Some(deadline)) => {
            let possible = entry.bound.earliest_finish().is_some_and(|earliest| earliest <= deadline);
            *finish == end
                && end > deadline
                && *by == end.saturating_sub(deadline)
                && *unavoidable != possible
        }
        _ => false,
    }
}

fn beats(end: i64, bound: Bound) -> bool {
    bound.earliest_finish().is_none_or(|earliest| end < earliest)
}

/// The costs add up, and the bound is proven.
fn check_costs(input: &Input, plan: &Plan, found: &mut Vec<Violation>) {
    let total = plan.rentals.iter().fold(0i64, |sum, rental| sum.saturating_add(rental.cost));
    if total != plan.cost {
        found.push(Violation::TotalCost { stated: plan.cost, found: total });
    }
    let verdicts: BTreeMap<u64, &Verdict> =
        plan.jobs.iter().map(|entry| (entry.job, &entry.verdict)).collect();
    let counted = |job: &Job| match (verdicts.get(&job.id), job.deadline) {
        (Some(Verdict::Feasible { .. }), Some(deadline)) => Counted::By(deadline),
        (None | Some(Verdict::Unplaced { .. }), _) => Counted::Not,
        _ => Counted::Whenever,
    };
    let proven = value(input, &plan.proof, true, counted).max(0);
    let proven = i64::try_from(proven).unwrap_or(i64::MAX);
    if plan.cost_bound != proven || plan.cost < proven {
        found.push(Violation::CostBound { stated: plan.cost_bound, found: proven, cost: plan.cost });
    }
    if let Some(infeasible) = &plan.infeasible {
        let by = |job: &Job| job.deadline.map_or(Counted::Not, Counted::By);
        if value(input, &infeasible.proof, false, by) <= 0 {
            found.push(Violation::Infeasible);
        }
    }
}
