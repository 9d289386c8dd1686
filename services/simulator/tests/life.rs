//! Rules of every simulated farm, whatever its policy and luck.

use std::collections::BTreeMap;

use forelight_planner::{
    Confidence, Division, Frame, Input, Interval, Job, Node, SharedCache, Task, WorkTotal,
};
use forelight_simulator::{
    Attempt, Chances, Farm, JobRecord, Outcome, Policy, PolicyKind, Record, Refusal, Scenario, World, report,
    run, studio,
};
use proptest::prelude::*;

const HOUR: i64 = 3_600_000_000;

fn simulated(world: &World, kind: PolicyKind, pool: u32) -> (Record, u64) {
    let mut policy = kind.policy(world, HOUR, pool);
    let record = run(world, policy.as_mut(), |_, _| {});
    (record, policy.plans())
}

/// Checks the rules from the record alone. `may_leave`: frames may fill their own caches.
fn check(world: &World, record: &Record, may_leave: bool) {
    let input = world.input();
    let mut done = Done::new();
    for attempt in record.attempts.iter().filter(|attempt| attempt.outcome == Outcome::Done) {
        *done.entry((attempt.job, attempt.task)).or_default() += 1;
    }
    for (job, entry) in input.jobs.iter().zip(&record.jobs) {
        assert!(entry.finish.is_none() || entry.withdrawn.is_none(), "job {} ended twice", job.id);
        assert!(entry.finish.is_some() || entry.withdrawn.is_some(), "job {} is left over", job.id);
        for frame in &job.frames {
            check_frame(job, frame, &done, entry.withdrawn.is_some());
        }
        check_shared_cache(job, entry, record, &done, may_leave);
        let attempts = || record.attempts.iter().filter(|attempt| attempt.job == job.id);
        let over = entry.withdrawn.or(entry.finish).unwrap_or(i64::MAX);
        for attempt in attempts() {
            assert!(attempt.start >= job.release && attempt.end <= over, "{attempt:?} is outside of its job");
        }
        let ends = attempts().filter(|attempt| attempt.outcome == Outcome::Done).map(|attempt| attempt.end);
        assert!(entry.finish.is_none() || entry.finish == ends.max().or(Some(job.release)));
    }
    let mut by_node: BTreeMap<u64, Vec<&Attempt>> = BTreeMap::new();
    for attempt in &record.attempts {
        by_node.entry(attempt.node).or_default().push(attempt);
    }
    for node in &input.nodes {
        check_node(node, &by_node.remove(&node.id).unwrap_or_default(), record);
    }
    assert!(by_node.is_empty(), "attempts on nodes that do not exist");
}

/// How often each task of each job was done.
type Done = BTreeMap<(u64, Task), u32>;

/// A frame was done once: whole, or in parts of one division that it allows.
fn check_frame(job: &Job, frame: &Frame, done: &Done, is_withdrawn: bool) {
    let whole = done.get(&(job.id, Task::Frame(frame.number))).copied().unwrap_or(0);
    let parts: Vec<(u32, u32)> = done
        .range((job.id, Task::Part { frame: i64::MIN, part: 0, parts: 0 })..)
        .take_while(|((id, _), _)| *id == job.id)
        .filter_map(|(&(_, task), &times)| match task {
            Task::Part { frame: of, parts, .. } if of == frame.number => Some((parts, times)),
            _ => None,
        })
        .collect();
    let count = parts.first().map_or(1, |&(parts, _)| parts);
    let once = whole <= 1 && parts.iter().all(|&(parts, times)| times == 1 && parts == count);
    let all = if count > 1 { whole == 0 && parts.len() == count as usize } else { whole == 1 };
    assert!(once, "job {}, frame {} was done {whole} times, parts {parts:?}", job.id, frame.number);
    assert!(all || is_withdrawn, "job {}, frame {}: {parts:?}", job.id, frame.number);
    let is_allowed = frame.division.allows(count) || (whole == 0 && parts.is_empty());
    assert!(is_allowed, "job {}, frame {} in {count} parts", job.id, frame.number);
}

/// The shared cache was filled once and entirely before all frames, or left to the frames if they may.
fn check_shared_cache(job: &Job, entry: &JobRecord, record: &Record, done: &Done, may_leave: bool) {
    let tasks = job.shared_cache.iter().flat_map(|cache| cache.tasks());
    let parts: Vec<u32> = tasks.map(|task| done.get(&(job.id, task)).copied().unwrap_or(0)).collect();
    let attempts = || record.attempts.iter().filter(|attempt| attempt.job == job.id);
    let shares = parts.iter().all(|&times| times == 1);
    let leaves = may_leave && !attempts().any(|attempt| attempt.task.is_shared_cache());
    assert!(shares || leaves || entry.withdrawn.is_some(), "job {}: parts of the cache {parts:?}", job.id);
    assert!(parts.iter().all(|&times| times <= 1));
    if job.shared_cache.is_none() || leaves {
        return;
    }
    let is_fill = |attempt: &&Attempt| attempt.task.is_shared_cache() && attempt.outcome == Outcome::Done;
    let filled = attempts().filter(is_fill).map(|attempt| attempt.end).max();
    for frame in attempts().filter(|attempt| !attempt.task.is_shared_cache()) {
        let is_after = filled.is_some_and(|filled| filled <= frame.start);
        assert!(is_after, "{frame:?} came before its shared cache");
    }
}

/// A node did one thing at a time, while it was open and paid for, and was paid for nothing else.
fn check_node(node: &Node, attempts: &[&Attempt], record: &Record) {
    for pair in attempts.windows(2) {
        assert!(pair[0].end <= pair[1].start, "two at once: {pair:?}");
    }
    let rentals: Vec<_> = record.rentals.iter().filter(|rental| rental.node == node.id).collect();
    for pair in rentals.windows(2) {
        assert!(pair[0].end <= pair[1].start, "paid twice: {pair:?}");
    }
    let is_open = |start: i64, end: i64| {
        node.calendar.iter().any(|&Interval { start: opens, end: closes }| {
            opens <= start && closes.is_none_or(|closes| end <= closes)
        })
    };
    for attempt in attempts {
        assert!(is_open(attempt.start, attempt.end), "{attempt:?} is outside of the calendar");
        let paid = rentals.iter().any(|rental| rental.start <= attempt.start && attempt.end <= rental.end);
        assert!(paid, "{attempt:?} was not paid");
    }
    for rental in &rentals {
        assert!(is_open(rental.start, rental.end), "{rental:?} is outside of the calendar");
        assert_eq!(rental.cost, node.price(rental.end - rental.start, rental.setup));
        let worked = |attempt: &&&Attempt| rental.start <= attempt.start && attempt.end <= rental.end;
        assert!(attempts.iter().filter(worked).count() > 0, "{rental:?} is for nothing");
    }
}

fn small(nodes: u64, jobs: u64, frames: u64, seed: u64, chances: Chances) -> World {
    let scenario = Scenario { nodes, jobs, frames, days: 3, frame_minutes: 120, confidence: None, parts: 4 };
    let mut input = studio(scenario, seed);
    // Something for every rule to refuse.
    for job in input.jobs.iter_mut().filter(|job| job.id % 3 == 0) {
        job.shared_cache =
            Some(SharedCache { class: job.class, work: 1_000_000_000_000, parts: 1 + (job.id % 4) as u32 });
    }
    // Ten nodes may have no GPU, and too little memory.
    for job in &mut input.jobs {
        job.class = 0;
        job.part_overhead = 30_000_000_000;
        for frame in &mut job.frames {
            frame.division = match (job.id % 2, frame.number % 4) {
                (0, 0) => Division::Into(3),
                (0, _) => Division::UpTo(8),
                _ => Division::Whole,
            };
        }
        if job.id % 4 == 2 {
            job.deadline = None;
        }
        job.shared_cache = job.shared_cache.map(|cache| SharedCache { class: 0, ..cache });
    }
    World::new(input, Chances { seed, ..chances }).unwrap()
}

fn policies() -> impl Strategy<Value = PolicyKind> {
    prop::sample::select(PolicyKind::ALL.to_vec())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]

    #[test]
    fn every_frame_is_done_once_in_an_open_window_and_paid(
        kind in policies(),
        nodes in 10u64..30,
        jobs in 1u64..12,
        per_job in 1u64..15,
        seed in 0u64..1_000_000,
        bias in 0.7f64..1.6,
        spread in 0.0f64..3.0,
        hours_between_failures in prop::sample::select(vec![0.0, 15.0, 100.0]),
        withdrawn in 0.0f64..0.4,
        own_cache in prop::sample::select(vec![0.0, 0.05, 0.6]),
        pool in 40u32..=100,
    ) {
        let chances = Chances { bias, spread, hours_between_failures, withdrawn, own_cache, ..Chances::default() };
        let world = small(nodes, jobs, jobs * per_job, seed, chances);
        let (record, plans) = simulated(&world, kind, pool);
        check(&world, &record, own_cache > 0.0);
        // Today's farm managers divide only frames that must be, and know no shared cache.
        let is_ours = kind == PolicyKind::Planned;
        let must_be = |a: &Attempt| world.input().jobs.iter().any(|job| job.id == a.job && job.frames.iter().any(|frame| {
            Some(frame.number) == a.task.frame() && frame.division.fewest() > 1
        }));
        let divided: Vec<&Attempt> = record.attempts.iter().filter(|a| matches!(a.task, Task::Part { .. })).collect();
        prop_assert!(is_ours || divided.iter().all(|a| must_be(a)));
        prop_assert!(is_ours || own_cache == 0.0 || !record.attempts.iter().any(|a| a.task.is_shared_cache()));
        let bound = world.least_cost().unwrap();
        let report = report(&world, kind, pool, plans, bound, &record);
        prop_assert_eq!(report.cost, record.rentals.iter().map(|rental| rental.cost).sum::<i64>());
        prop_assert_eq!(report.unfinished, 0);
        let with_deadline = world.input().jobs.iter().filter(|job| job.deadline.is_some()).count() as u64;
        prop_assert!(report.jobs <= with_deadline && report.jobs + report.withdrawn >= with_deadline);
        prop_assert!(report.useful <= 1.0 && report.utilisation <= 1.0 + 1e-9);
        if report.in_time == report.jobs {
            prop_assert!(report.cost >= bound, "{} is less than {bound}", report.cost);
        }
    }
}

#[test]
fn the_same_seed_gives_the_same_bits_and_another_one_does_not() {
    let world =
        |seed| small(20, 10, 100, seed, Chances { hours_between_failures: 40.0, ..Chances::default() });
    for kind in PolicyKind::ALL {
        let first = simulated(&world(5), kind, 100);
        assert_eq!(first, simulated(&world(5), kind, 100), "{}", kind.name());
        assert_ne!(first.0, simulated(&world(6), kind, 100).0, "{}", kind.name());
    }
}

#[test]
fn a_lost_workers_frame_goes_back_when_its_lease_expires_and_not_before() {
    let chances = Chances { hours_between_failures: 10.0, lease_seconds: 600.0, ..Chances::default() };
    let world = small(20, 10, 200, 3, chances);
    let (record, _) = simulated(&world, PolicyKind::Fifo, 100);
    let lost: Vec<&Attempt> =
        record.attempts.iter().filter(|attempt| attempt.outcome == Outcome::Lost).collect();
    assert!(lost.len() > 5, "only {} frames were lost", lost.len());
    for attempt in lost {
        let again = record.attempts.iter().find(|other| {
            (other.job, other.task) == (attempt.job, attempt.task) && other.start > attempt.start
        });
        assert!(again.is_none_or(|again| again.start >= attempt.end + 600_000_000), "{attempt:?} {again:?}");
    }
}

#[test]
fn forecasts_that_are_too_low_are_seen_through() {
    let scenario = Scenario {
        nodes: 40,
        jobs: 150,
        frames: 3000,
        days: 20,
        frame_minutes: 120,
        confidence: Some(Confidence::P80),
        parts: 1,
    };
    let world = scenario.world(Chances { bias: 1.3, seed: 2, ..Chances::default() }).unwrap();
    let (record, plans) = simulated(&world, PolicyKind::Planned, 100);
    let report = report(&world, PolicyKind::Planned, 100, plans, 1, &record);
    assert!(report.kept() > 0.8, "{} of {} promises kept", report.promises_kept, report.promised);
    assert!(report.promised * 10 > report.jobs * 7, "only {} of {} promised", report.promised, report.jobs);
}

/// Nodes at speed 1, and one job of frames of eight hours, due in `deadline` hours. True work is as forecast.
fn eight_hours(
    nodes: u64,
    frames: i64,
    deadline: i64,
    shared_cache: Option<SharedCache>,
    chances: Chances,
) -> World {
    let node = |id| Node {
        id,
        speed: 1,
        price_per_hour: 1_000_000,
        calendar: vec![Interval { start: 0, end: None }],
        ..Node::default()
    };
    let work = 8 * 3600 * frames as u64;
    let job = Job {
        id: 7,
        deadline: Some(deadline * HOUR),
        confidence: Confidence::P80,
        total: WorkTotal { p50: work, p80: work, p95: work },
        frames: (0..frames)
            .map(|number| Frame { number, work: 8 * 3600, work_p80: 8 * 3600, ..Frame::default() })
            .collect(),
        shared_cache,
        part_overhead: 360,
        ..Job::default()
    };
    let input = Input { nodes: (0..nodes).map(node).collect(), jobs: vec![job], ..Input::default() };
    World::new(input, Chances { withdrawn: 0.0, ..chances }).unwrap()
}

const QUIET: Chances = Chances {
    seed: 1,
    bias: 1.0,
    spread: 0.0,
    hours_between_failures: 0.0,
    hours_of_repair: 4.0,
    lease_seconds: 60.0,
    own_cache: 0.0,
    withdrawn: 0.0,
};

/// As [`eight_hours`], with one frame that may have up to four parts. Each costs six minutes on top.
fn divisible(nodes: u64, deadline: Option<i64>, division: Division, chances: Chances) -> World {
    let mut input = eight_hours(nodes, 1, 1, None, chances).input().clone();
    input.jobs[0].frames[0].division = division;
    input.jobs[0].deadline = deadline.map(|hours| hours * HOUR);
    World::new(input, Chances { withdrawn: 0.0, ..chances }).unwrap()
}

#[test]
fn a_frame_that_is_too_long_for_its_deadline_is_divided_by_plans_and_by_nobody_else() {
    let world = divisible(4, Some(5), Division::UpTo(4), QUIET);
    let (record, _) = simulated(&world, PolicyKind::Planned, 100);
    check(&world, &record, false);
    assert!(record.jobs[0].promised);
    // Half of eight hours, and a tenth of an hour on top.
    assert_eq!(record.attempts.len(), 2);
    assert!(record.attempts.iter().all(|part| part.end - part.start == 4 * HOUR + HOUR / 10), "{record:?}");
    assert_eq!(record.jobs[0].finish, Some(4 * HOUR + HOUR / 10));
    let (today, _) = simulated(&world, PolicyKind::Deadline, 100);
    assert_eq!(today.jobs[0].finish, Some(8 * HOUR));
}

#[test]
fn a_still_that_must_have_parts_has_them_under_every_policy() {
    let world = divisible(2, None, Division::Into(4), QUIET);
    for kind in PolicyKind::ALL {
        let (record, _) = simulated(&world, kind, 100);
        check(&world, &record, false);
        assert_eq!(record.attempts.len(), 4, "{}", kind.name());
        assert_eq!(record.jobs[0].finish, Some(4 * HOUR + HOUR / 5), "{}", kind.name());
    }
}

#[test]
fn a_node_that_dies_takes_its_part_with_it_and_the_others_stay_done() {
    let mut seen = 0;
    for seed in 0..60 {
        let chances = Chances { seed, hours_between_failures: 8.0, hours_of_repair: 1.0, ..QUIET };
        let world = divisible(3, Some(5), Division::UpTo(4), chances);
        let (record, _) = simulated(&world, PolicyKind::Planned, 100);
        check(&world, &record, false);
        let of = |outcome| record.attempts.iter().filter(move |attempt| attempt.outcome == outcome);
        let is_part = |attempt: &&Attempt| matches!(attempt.task, Task::Part { .. });
        let Some(lost) = of(Outcome::Lost).find(is_part) else { continue };
        // `check` counts that what was done before the node died was not done again. The lost part was, under
        // a new lease.
        let again = of(Outcome::Done).find(|attempt| attempt.task == lost.task);
        assert!(again.is_some_and(|again| again.start >= lost.end + 60_000_000), "seed {seed}: {record:?}");
        seen += 1;
    }
    assert!(seen > 5, "only {seen} parts were lost");
}

#[test]
fn a_shared_cache_is_filled_in_parts_at_once_and_whoever_knows_none_fills_one_for_each_frame() {
    let cache = SharedCache { class: 0, work: 6 * 3600, parts: 3 };
    let world = eight_hours(3, 3, 40, Some(cache), Chances { own_cache: 0.5, ..QUIET });
    let (ours, _) = simulated(&world, PolicyKind::Planned, 100);
    check(&world, &ours, true);
    let parts: Vec<&Attempt> =
        ours.attempts.iter().filter(|attempt| attempt.task.is_shared_cache()).collect();
    assert!(
        parts.len() == 3 && parts.iter().all(|part| (part.start, part.end) == (0, 2 * HOUR)),
        "{parts:?}"
    );
    assert_eq!(ours.jobs[0].finish, Some(10 * HOUR));
    let (today, _) = simulated(&world, PolicyKind::Fifo, 100);
    check(&world, &today, true);
    assert!(today.attempts.iter().all(|frame| frame.end - frame.start == 11 * HOUR), "{today:?}");
    // A single frame does not need a shared cache: its own takes half as much.
    let alone =
        eight_hours(1, 1, 40, Some(SharedCache { parts: 1, ..cache }), Chances { own_cache: 0.5, ..QUIET });
    let (alone, _) = simulated(&alone, PolicyKind::Planned, 100);
    assert_eq!(alone.jobs[0].finish, Some(11 * HOUR));
}

/// Tries what is forbidden, then starts everything.
struct Forbidden(Vec<Refusal>);

impl Policy for Forbidden {
    fn arrived(&mut self, farm: &mut Farm, job: usize) -> bool {
        let mut refused = |tried: Result<(), Refusal>| self.0.extend(tried.err());
        refused(farm.start(0, job, 1));
        refused(farm.start(0, job, 9));
        assert_eq!(farm.start(0, job, 0), Ok(()));
        refused(farm.start(0, job, 0));
        refused(farm.start(1, job, 0));
        refused(farm.start(1, job, 1));
        false
    }

    fn act(&mut self, farm: &mut Farm) -> Option<i64> {
        let idle: Vec<usize> = farm.idle().collect();
        idle.into_iter().for_each(|node| {
            let _ = farm.start(node, 0, 1);
        });
        None
    }
}

#[test]
fn a_task_starts_once_after_its_shared_cache_and_alone_on_its_node() {
    let cache = SharedCache { class: 0, work: 3600, parts: 1 };
    let world = eight_hours(2, 1, 40, Some(cache), QUIET);
    let mut policy = Forbidden(Vec::new());
    let record = run(&world, &mut policy, |_, _| {});
    check(&world, &record, false);
    let expected = [
        Refusal::NoSharedCache,
        Refusal::NotWaiting,
        Refusal::NotIdle,
        Refusal::NotWaiting,
        Refusal::NoSharedCache,
    ];
    assert_eq!(policy.0, expected);
}

/// Tries to divide a frame as it may not be.
struct ForbiddenParts(Vec<Refusal>);

impl Policy for ForbiddenParts {
    fn arrived(&mut self, farm: &mut Farm, job: usize) -> bool {
        let mut refused = |tried: Result<(), Refusal>| self.0.extend(tried.err());
        refused(farm.start_part(0, job, 0, (0, 5)));
        refused(farm.start_part(0, job, 0, (2, 2)));
        refused(farm.start_part(0, job, 0, (0, 1)));
        refused(farm.start_part(0, job, 9, (0, 2)));
        assert_eq!(farm.start_part(0, job, 0, (1, 2)), Ok(()));
        refused(farm.start_part(1, job, 0, (1, 2)));
        refused(farm.start_part(1, job, 0, (0, 3)));
        refused(farm.start(1, job, 0));
        assert_eq!(farm.start_part(1, job, 0, (0, 2)), Ok(()));
        false
    }

    fn act(&mut self, _: &mut Farm) -> Option<i64> {
        None
    }
}

#[test]
fn a_frame_is_divided_once_and_only_as_it_may_be() {
    let world = divisible(2, Some(5), Division::UpTo(4), QUIET);
    let mut policy = ForbiddenParts(Vec::new());
    let record = run(&world, &mut policy, |_, _| {});
    check(&world, &record, false);
    let (not, waiting) = (Refusal::NotDivisible, Refusal::NotWaiting);
    assert_eq!(policy.0, [not, not, not, not, waiting, waiting, waiting]);
}
