//! What holds of every simulated farm, whatever its policy and luck.

use std::collections::BTreeMap;

use forelight_planner::{Confidence, Interval, Limit, LimitUse, Seed, Task};
use forelight_simulator::{
    Attempt, Chances, Outcome, PolicyKind, Record, Scenario, World, report, run, studio,
};
use proptest::prelude::*;

const HOUR: i64 = 3_600_000_000;

fn simulated(world: &World, kind: PolicyKind, pool: u32) -> (Record, u64) {
    let mut policy = kind.policy(world, HOUR, pool);
    let record = run(world, policy.as_mut(), |_, _| {});
    (record, policy.plans())
}

/// The rules of the house, from the record alone.
fn check(world: &World, record: &Record) {
    let input = world.input();
    let mut by_node: BTreeMap<u64, Vec<&Attempt>> = BTreeMap::new();
    let mut done: BTreeMap<(u64, Task), u32> = BTreeMap::new();
    for attempt in &record.attempts {
        by_node.entry(attempt.node).or_default().push(attempt);
        if attempt.outcome == Outcome::Done {
            *done.entry((attempt.job, attempt.task)).or_default() += 1;
        }
    }
    for (job, entry) in input.jobs.iter().zip(&record.jobs) {
        assert!(entry.finish.is_none() || entry.withdrawn.is_none(), "job {} ended twice", job.id);
        assert!(entry.finish.is_some() || entry.withdrawn.is_some(), "job {} is left over", job.id);
        let tasks = job.frames.iter().map(|frame| Task::Frame(frame.number));
        for task in tasks.chain(job.seed.map(|_| Task::Seed)) {
            let times = done.get(&(job.id, task)).copied().unwrap_or(0);
            assert!(times <= 1, "job {}, {task} was done {times} times", job.id);
            assert!(times == 1 || entry.withdrawn.is_some(), "job {}, {task} was never done", job.id);
        }
        let of_job = || record.attempts.iter().filter(|attempt| attempt.job == job.id);
        let over = entry.withdrawn.or(entry.finish).unwrap_or(i64::MAX);
        for attempt in of_job() {
            assert!(attempt.start >= job.release && attempt.end <= over, "{attempt:?} is outside of its job");
        }
        let last =
            of_job().filter(|attempt| attempt.outcome == Outcome::Done).map(|attempt| attempt.end).max();
        assert!(entry.finish.is_none() || entry.finish == last.or(Some(job.release)));
        let seeded = of_job().find(|a| a.task == Task::Seed && a.outcome == Outcome::Done).map(|a| a.end);
        if job.seed.is_some() {
            for frame in of_job().filter(|attempt| attempt.task != Task::Seed) {
                assert!(seeded.is_some_and(|seeded| seeded <= frame.start), "{frame:?} came before its seed");
            }
        }
    }
    for node in &input.nodes {
        let attempts = by_node.remove(&node.id).unwrap_or_default();
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
        for attempt in &attempts {
            assert!(is_open(attempt.start, attempt.end), "{attempt:?} is outside of the calendar");
            let paid =
                rentals.iter().any(|rental| rental.start <= attempt.start && attempt.end <= rental.end);
            assert!(paid, "{attempt:?} was not paid");
        }
        for rental in &rentals {
            assert!(is_open(rental.start, rental.end), "{rental:?} is outside of the calendar");
            assert_eq!(rental.cost, node.price(rental.end - rental.start, rental.setup));
            let worked = |attempt: &&&Attempt| rental.start <= attempt.start && attempt.end <= rental.end;
            assert!(attempts.iter().filter(worked).count() > 0, "{rental:?} is for nothing");
        }
    }
    assert!(by_node.is_empty(), "attempts on nodes that do not exist");
    for limit in &input.limits {
        let mut changes: Vec<(i64, i64)> = Vec::new();
        for attempt in &record.attempts {
            let job = &input.jobs[input.jobs.iter().position(|job| job.id == attempt.job).unwrap()];
            let held: u64 = job.uses.iter().filter(|u| u.limit == limit.id).map(|u| u.count).sum();
            changes.push((attempt.end, -(held as i64)));
            changes.push((attempt.start, held as i64));
        }
        // What ends at an instant goes before what starts.
        changes.sort_unstable();
        let mut now = 0;
        for (_, change) in changes {
            now += change;
            assert!(now <= limit.count as i64, "{} is used {now} times at once", limit.name);
        }
    }
}

fn small(nodes: u64, jobs: u64, frames: u64, seed: u64, chances: Chances) -> World {
    let scenario = Scenario { nodes, jobs, frames, days: 3, frame_minutes: 120, confidence: None };
    let mut input = studio(scenario, seed);
    // Something for every rule to refuse.
    input.limits = vec![Limit { id: 0, name: "licence".into(), count: 2 }];
    for job in input.jobs.iter_mut().filter(|job| job.id % 3 == 0) {
        job.uses = vec![LimitUse { limit: 0, count: 1 }];
        job.seed = Some(Seed { class: job.class, work: 1_000_000_000_000, parts: 1 });
    }
    // Ten nodes need not have a graphics processor, nor all that memory.
    for job in &mut input.jobs {
        (job.class, job.gpu_memory, job.memory) = (0, 0, 0);
        job.seed = job.seed.map(|seed| Seed { class: 0, ..seed });
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
        pool in 40u32..=100,
    ) {
        let chances = Chances { bias, spread, hours_between_failures, withdrawn, ..Chances::default() };
        let world = small(nodes, jobs, jobs * per_job, seed, chances);
        let (record, plans) = simulated(&world, kind, pool);
        check(&world, &record);
        let bound = world.least_cost().unwrap();
        let report = report(&world, kind, pool, plans, bound, &record);
        prop_assert_eq!(report.cost, record.rentals.iter().map(|rental| rental.cost).sum::<i64>());
        prop_assert_eq!(report.unfinished, 0);
        prop_assert!(report.jobs + report.withdrawn == jobs);
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
    };
    let world = scenario.world(Chances { bias: 1.3, seed: 2, ..Chances::default() }).unwrap();
    let (record, plans) = simulated(&world, PolicyKind::Planned, 100);
    let report = report(&world, PolicyKind::Planned, 100, plans, 1, &record);
    assert!(report.kept() > 0.8, "{} of {} promises kept", report.promises_kept, report.promised);
    assert!(report.promised * 10 > report.jobs * 7, "only {} of {} promised", report.promised, report.jobs);
}
