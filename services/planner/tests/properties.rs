//! The README's properties, on random inputs.

use forelight_planner::{
    Confidence, Division, Event, FixedBooking, Frame, Input, Interval, Job, Node, Verdict, WorkTotal, curve,
    explain, mend, plan, replan, simulate, verify,
};
use forelight_simulator::reference::{Size, cheapest_by_trying_everything, studio, tiny};
use proptest::prelude::*;
use std::collections::BTreeSet;

fn interval() -> impl Strategy<Value = Interval> {
    (-50i64..400, prop::option::weighted(0.8, 0i64..200))
        .prop_map(|(start, length)| Interval { start, end: length.map(|l| start + l) })
}

prop_compose! {
    fn node()(
        speed in prop_oneof![1u64..10_000_000, Just(u64::MAX)],
        price_per_hour in prop_oneof![0i64..10_000_000_000_000, Just(i64::MAX)],
        available_from in -10i64..100,
        calendar in prop::collection::vec(interval(), 0..4),
    ) -> Node {
        Node { speed, price_per_hour, available_from, calendar, ..Node::default() }
    }
}

/// Mostly whole frames, some that may be divided, and some that must be.
fn division() -> impl Strategy<Value = Division> {
    prop_oneof![
        4 => Just(Division::Whole),
        3 => (0u32..9).prop_map(Division::UpTo),
        1 => Just(Division::UpTo(u32::MAX)),
        1 => (0u32..9).prop_map(Division::Into),
    ]
}

prop_compose! {
    fn job()(
        release in -20i64..200,
        deadline in prop::option::of(-100i64..600),
        priority in -1i32..2,
        confidence in prop_oneof![Just(Confidence::P50), Just(Confidence::P80), Just(Confidence::P95)],
        works in prop::collection::vec((prop_oneof![20 => 0u64..120, 1 => Just(u64::MAX)], division()), 0..8),
        part_overhead in 0u64..12,
        margin in (0u64..100, 0u64..100),
        budget in prop::option::of(0i64..5_000_000),
    ) -> Job {
        let p50 = works.iter().fold(0u64, |sum, &(work, _)| sum.saturating_add(work));
        let p80 = p50.saturating_add(margin.0);
        let total = WorkTotal { p50, p80, p95: p80.saturating_add(margin.1) };
        let frames = works.iter().zip(0..).map(|(&(work, division), number)| Frame { number: 3 * number - 5, work, division, ..Frame::default() }).collect();
        Job { release, deadline, priority, confidence, total, frames, part_overhead, budget, ..Job::default() }
    }
}

prop_compose! {
    fn any_input()(
        mut nodes in prop::collection::vec(node(), 0..5),
        mut jobs in prop::collection::vec(job(), 0..5),
        fixed in prop::collection::vec((0u64..5, -20i64..300, 0i64..60), 0..4),
    ) -> Input {
        nodes.iter_mut().zip(10..).for_each(|(node, id)| node.id = id);
        jobs.iter_mut().zip(20..).for_each(|(job, id)| job.id = id);
        let fixed = fixed.into_iter().filter(|(node, ..)| *node < nodes.len() as u64);
        let fixed = fixed.map(|(node, start, length)| FixedBooking { node: node + 10, start, end: start + length, ..FixedBooking::default() });
        Input { now: -100, fixed: fixed.collect(), nodes, jobs, ..Input::default() }
    }
}

/// Identical nodes that do one unit of work per microsecond, free from instant zero.
fn identical(nodes: u64, works: &[u64], deadline: Option<i64>) -> Input {
    let total: u64 = works.iter().sum();
    Input {
        nodes: (0..nodes)
            .map(|id| Node {
                id,
                speed: 1_000_000,
                calendar: vec![Interval { start: 0, end: None }],
                ..Node::default()
            })
            .collect(),
        jobs: vec![Job {
            deadline,
            confidence: Confidence::P50,
            total: WorkTotal { p50: total, p80: total, p95: total },
            frames: works
                .iter()
                .zip(0..)
                .map(|(&work, number)| Frame { number, work, ..Frame::default() })
                .collect(),
            ..Job::default()
        }],
        ..Input::default()
    }
}

fn finish(input: &Input) -> i64 {
    match plan(input).expect("a plan").jobs[0].verdict {
        Verdict::Feasible { finish, .. } | Verdict::NoDeadline { finish } | Verdict::Late { finish, .. } => {
            finish
        }
        Verdict::Unplaced { .. } => panic!("there is room for everything"),
    }
}

/// The least makespan of all assignments to identical nodes.
fn optimum(loads: &mut Vec<u64>, works: &[u64]) -> u64 {
    let Some((&work, rest)) = works.split_first() else { return loads.iter().copied().max().unwrap_or(0) };
    (0..loads.len())
        .map(|node| {
            loads[node] += work;
            let best = optimum(loads, rest);
            loads[node] -= work;
            best
        })
        .min()
        .unwrap_or(0)
}

fn works() -> impl Strategy<Value = Vec<u64>> {
    prop::collection::vec(1u64..1000, 1..30)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1000))]

    #[test]
    fn every_plan_passes_the_verifier(input in any_input()) {
        let found = plan(&input).expect("a plan");
        prop_assert_eq!(verify(&input, &found), Ok(()));
    }

    #[test]
    fn the_order_of_the_input_does_not_matter(input in any_input(), turn in 0usize..5) {
        let mut turned = input.clone();
        let rotate = |length: usize| if length == 0 { 0 } else { turn % length };
        turned.nodes.reverse();
        let by = rotate(turned.jobs.len());
        turned.jobs.rotate_left(by);
        turned.fixed.reverse();
        for job in &mut turned.jobs {
            let by = rotate(job.frames.len());
            job.frames.rotate_left(by);
        }
        for node in &mut turned.nodes {
            node.calendar.reverse();
        }
        prop_assert_eq!(plan(&turned), plan(&input));
    }
}

proptest! {
    #[test]
    fn list_scheduling_keeps_grahams_bound(nodes in 1u64..9, works in works()) {
        let input = identical(nodes, &works, None);
        let found = plan(&input).expect("a plan");
        let bound = i128::from(found.bound.earliest_finish().expect("there is room"));
        let end = i128::from(finish(&input));
        let m = i128::from(nodes);
        prop_assert!(end >= bound);
        prop_assert!(end * m <= (2 * m - 1) * bound);
        prop_assert_eq!(found.bound.by_capacity, Some(works.iter().sum::<u64>().div_ceil(nodes) as i64));
        prop_assert_eq!(found.bound.by_longest_frame, works.iter().max().map(|&work| work as i64));
    }

    #[test]
    fn longest_first_is_within_a_third_of_the_optimum(nodes in 1u64..4, works in prop::collection::vec(1u64..50, 1..8)) {
        let input = identical(nodes, &works, None);
        let best = optimum(&mut vec![0; nodes as usize], &works) as i64;
        let (end, m) = (finish(&input), nodes as i64);
        prop_assert!(plan(&input).expect("a plan").bound.earliest_finish().is_some_and(|bound| bound <= best));
        prop_assert!(end >= best && 3 * m * end <= (4 * m - 1) * best, "{} against {}", end, best);
    }

    #[test]
    fn one_more_node_never_ends_later(nodes in 1u64..9, works in works()) {
        prop_assert!(finish(&identical(nodes + 1, &works, None)) <= finish(&identical(nodes, &works, None)));
    }

    #[test]
    fn a_later_deadline_never_makes_it_worse(nodes in 1u64..5, works in works(), deadline in 0i64..9000, more in 0i64..9000) {
        // Only lateness counts. If list scheduling is late on a small farm, a search finds a plan in time,
        // which may end later than the list's plan for a later deadline.
        let tardiness = |deadline| match plan(&identical(nodes, &works, Some(deadline))).expect("a plan").jobs[0].verdict {
            Verdict::Feasible { .. } => 0,
            Verdict::Late { by, .. } => by,
            _ => panic!("there is a deadline and room"),
        };
        prop_assert!(tardiness(deadline + more) <= (tardiness(deadline) - more).max(0));
    }

    #[test]
    fn the_unit_of_work_does_not_matter(input in any_input(), factor in 1u64..1000) {
        // Scaling must stay in range. Medians are booked, since other quantiles round differently.
        let mut small = input;
        small.nodes.iter_mut().for_each(|node| node.speed = node.speed.min(10_000_000));
        for job in &mut small.jobs {
            // All numbers of parts divide it, so that parts round alike.
            job.frames.iter_mut().for_each(|frame| {
                frame.work = frame.work.min(100) * 840;
                if frame.division == Division::UpTo(u32::MAX) {
                    frame.division = Division::Whole;
                }
            });
            let total = job.frames.iter().map(|frame| frame.work).sum();
            job.total = WorkTotal { p50: total, p80: total, p95: total };
        }
        let mut large = small.clone();
        large.nodes.iter_mut().for_each(|node| node.speed *= factor);
        for job in &mut large.jobs {
            job.frames.iter_mut().for_each(|frame| frame.work *= factor);
            job.part_overhead *= factor;
            let total = job.total.p50 * factor;
            job.total = WorkTotal { p50: total, p80: total, p95: total };
        }
        prop_assert_eq!(plan(&large), plan(&small));
    }

    #[test]
    fn bought_work_reaches_the_quantile_and_hardly_more(job in job()) {
        let bought: u128 = job.bought_work().into_iter().map(u128::from).sum();
        let total = match job.confidence {
            Confidence::P50 => job.total.p50,
            Confidence::P80 => job.total.p80,
            Confidence::P95 => job.total.p95,
        };
        if !job.frames.is_empty() {
            prop_assert!(bought >= u128::from(total));
            prop_assert!(bought < u128::from(total) + job.frames.len() as u128);
        }
    }
}

/// Random farms with calendars, shared caches, set-ups and billing steps. All deadlines are far away.
fn studio_input() -> impl Strategy<Value = Input> {
    (1u64..12, 1u64..60, 1u64..20, 1u64..8, any::<u64>(), 0usize..4).prop_map(
        |(jobs, frames, nodes, classes, seed, without)| {
            let mut input = studio(Size { jobs, frames: frames.max(jobs), nodes, classes, days: 3 }, seed);
            // Some jobs have no deadline, so that they take turns.
            input.jobs.iter_mut().take(without).for_each(|job| job.deadline = None);
            for job in &mut input.jobs {
                job.shared_cache.iter_mut().for_each(|cache| cache.parts = (job.id % 4) as u32);
                // A third of the jobs may divide their frames, and some of the others must.
                job.part_overhead = 60_000_000_000;
                for frame in &mut job.frames {
                    frame.division = match (job.id % 3, frame.number % 5) {
                        (0, _) => Division::UpTo(16),
                        (1, 0) => Division::Into(3),
                        _ => Division::Whole,
                    };
                }
            }
            input
        },
    )
}

/// The number of unplaced frames, and then the end.
fn how_bad(verdict: &Verdict) -> (usize, Option<i64>) {
    match verdict {
        Verdict::Unplaced { frames, .. } => (frames.len(), None),
        placed => (0, placed.finish()),
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(128))]

    #[test]
    fn plans_of_studios_pass_the_verifier_and_never_cost_less_than_their_bound(input in studio_input()) {
        let found = plan(&input).expect("a plan");
        prop_assert_eq!(verify(&input, &found), Ok(()));
        prop_assert!(found.cost_bound <= found.cost);
        let simulated = simulate(&input, &found, 3, 1).expect("a simulation");
        prop_assert_eq!(simulate(&input, &found, 3, 1), Ok(simulated));
        prop_assert!(explain(&input, &found, |_| true).is_ok());
    }

    #[test]
    fn the_order_of_a_studio_does_not_matter(input in studio_input()) {
        let mut turned = input.clone();
        turned.nodes.reverse();
        turned.jobs.reverse();
        turned.jobs.iter_mut().for_each(|job| job.frames.reverse());
        prop_assert_eq!(plan(&turned), plan(&input));
    }

    #[test]
    fn an_event_leaves_a_right_plan_and_breaks_no_promise_in_silence(input in studio_input(), pick in any::<prop::sample::Index>(), kind in 0usize..4) {
        let old = plan(&input).expect("a plan");
        prop_assume!(!old.bookings.is_empty());
        let booking = old.bookings[pick.index(old.bookings.len())];
        let event = match kind {
            0 => Event::NodeDown { node: booking.node, from: booking.start, until: None },
            1 => Event::Takes { job: booking.job, task: booking.task, until: booking.end + (booking.end - booking.start) / 2 },
            2 => Event::JobRemoved { job: booking.job },
            _ => Event::DeadlineMoved { job: booking.job, deadline: Some(booking.end) },
        };
        let new = replan(&input, &old, &event).expect("a plan");
        prop_assert_eq!(verify(&new.input, &new.plan), Ok(()));
        prop_assert_eq!(new.plan.parent, Some(old.id()));
        for entry in &new.plan.jobs {
            let kept = old.job(entry.job).is_some_and(|before| before.verdict.is_kept());
            let told = new.at_risk.iter().any(|risk| risk.job == entry.job);
            prop_assert!(!kept || entry.verdict.is_kept() || told, "job {} breaks its deadline without a warning", entry.job);
        }
        if kind == 2 {
            // Late jobs may move into the freed time. One job in time may move, without harm to itself, for
            // each late job that this helps.
            let was_right = |job| old.job(job).is_some_and(|before| before.verdict.is_kept());
            let moved: BTreeSet<u64> = new.difference.moved.iter().map(|(was, _)| was.job).filter(|&job| was_right(job)).collect();
            let helped = new.plan.jobs.iter().filter(|entry| entry.verdict.is_kept() && !was_right(entry.job)).count();
            prop_assert!(moved.len() <= helped, "{:?} moved, but only {} became in time", moved, helped);
            prop_assert!(new.at_risk.is_empty(), "free time breaks no promise: {:?}", new.at_risk);
            for entry in new.plan.jobs.iter().filter(|entry| !entry.verdict.is_kept()) {
                let before = old.job(entry.job).map(|before| how_bad(&before.verdict));
                prop_assert!(Some(how_bad(&entry.verdict)) <= before, "job {} is worse off: {:?}", entry.job, entry.verdict);
            }
        }
    }

    #[test]
    fn a_plan_that_is_mended_though_nothing_happened_stays_as_it_is(input in studio_input()) {
        let first = plan(&input).expect("a plan");
        prop_assume!(first.jobs.iter().all(|entry| entry.verdict.is_kept()));
        let mended = mend(&input, &first).expect("a plan");
        prop_assert_eq!(&mended.plan.bookings, &first.bookings);
        prop_assert!(mended.at_risk.is_empty() && mended.difference.moved.is_empty());
    }

    #[test]
    fn mending_breaks_no_promise_in_silence(input in studio_input(), slower in 0usize..8, by in 2u64..4) {
        let first = plan(&input).expect("a plan");
        prop_assume!(!input.jobs.is_empty());
        // One job takes this many times as long.
        let mut now = input.clone();
        let slow = slower % now.jobs.len();
        let job = &mut now.jobs[slow];
        job.frames.iter_mut().for_each(|frame| frame.work = frame.work.saturating_mul(by));
        let total = &mut job.total;
        [&mut total.p50, &mut total.p80, &mut total.p95].into_iter().for_each(|part| *part = part.saturating_mul(by));
        let mended = mend(&now, &first).expect("a plan");
        prop_assert_eq!(verify(&now, &mended.plan), Ok(()));
        for entry in &mended.plan.jobs {
            let kept = first.job(entry.job).is_some_and(|before| before.verdict.is_kept());
            let told = mended.at_risk.iter().any(|risk| risk.job == entry.job);
            prop_assert!(!kept || entry.verdict.is_kept() || told, "job {} breaks its deadline without a warning", entry.job);
        }
        // Each job's rescue is what it would be if no other promise broke.
        for risk in &mended.at_risk {
            let mut alone = first.clone();
            let others = alone.jobs.iter_mut().filter(|entry| entry.job != risk.job);
            others.for_each(|entry| entry.verdict = Verdict::Late { finish: 0, by: 1, unavoidable: false });
            let alone = mend(&now, &alone).expect("a plan");
            prop_assert_eq!(&alone.plan.bookings, &mended.plan.bookings);
            prop_assert_eq!(alone.at_risk, std::slice::from_ref(risk));
        }
    }

    #[test]
    fn bookings_that_are_movable_and_right_stay(input in studio_input()) {
        let first = plan(&input).expect("a plan");
        prop_assume!(first.jobs.iter().all(|entry| entry.verdict.is_kept()));
        let again = plan(&Input { movable: first.bookings.clone(), ..input.clone() }).expect("a plan");
        prop_assert_eq!(again.bookings, first.bookings);
    }

    #[test]
    fn the_bound_never_rises_with_a_later_deadline_or_a_cheaper_node(seed in any::<u64>(), later in 1i64..20) {
        // On small farms billed as used, the plan is optimal, so its cost may not rise.
        let input = tiny(seed, false);
        let before = plan(&input).expect("a plan");
        prop_assume!(before.jobs.iter().all(|entry| entry.verdict.is_kept()));
        let mut relaxed = input.clone();
        relaxed.jobs[0].deadline = relaxed.jobs[0].deadline.map(|deadline| deadline + later * 900_000_000);
        let mut cheaper = input.clone();
        cheaper.nodes[0].price_per_hour /= 2;
        for input in [relaxed, cheaper] {
            let after = plan(&input).expect("a plan");
            prop_assert_eq!(verify(&input, &after), Ok(()));
            prop_assert!(after.jobs.iter().all(|entry| entry.verdict.is_kept()));
            prop_assert!(after.cost <= before.cost, "{} after {}", after.cost, before.cost);
        }
    }

    #[test]
    fn a_price_curve_never_rises(seed in any::<u64>()) {
        let input = tiny(seed, true);
        let offers = curve(&input, 0, 5).expect("a curve");
        prop_assert!(offers.is_sorted_by(|a, b| a.cost >= b.cost && a.deadline <= b.deadline));
        for offer in &offers {
            prop_assert!(offer.finish <= offer.deadline && offer.cost_bound <= offer.cost);
        }
    }
}

#[test]
fn small_farms_are_planned_whenever_there_is_a_plan_and_at_hardly_more_than_the_least_cost() {
    for in_steps in [false, true] {
        let (mut with_a_plan, mut above) = (0u32, 0.0);
        for seed in 0..300 {
            let input = tiny(seed, in_steps);
            let found = plan(&input).expect("a plan");
            assert_eq!(verify(&input, &found), Ok(()), "seed {seed}");
            let kept = found.jobs.iter().all(|entry| entry.verdict.is_kept());
            let Some(least) = cheapest_by_trying_everything(&input) else {
                assert!(!kept, "seed {seed}: trying everything finds no plan");
                continue;
            };
            assert!(kept, "seed {seed}: there is a plan");
            assert!(
                found.cost_bound <= least && found.cost >= least,
                "seed {seed}: {} and {least}",
                found.cost
            );
            assert!(found.infeasible.is_none(), "seed {seed}");
            with_a_plan += 1;
            above += found.cost as f64 / least.max(1) as f64 - 1.0;
        }
        let mean = above / f64::from(with_a_plan);
        assert!(with_a_plan > 60, "{with_a_plan} farms have a plan");
        assert!(if in_steps { mean < 0.02 } else { mean == 0.0 }, "{mean} above the optimum");
    }
}

#[test]
fn as_many_jobs_of_a_small_farm_are_in_time_as_can_be_while_all_are_rendered() {
    let mut hopeless = 0u32;
    for seed in 0..2000 {
        let input = tiny(seed, false);
        let kept = plan(&input).expect("a plan").jobs.iter().filter(|entry| entry.verdict.is_kept()).count();
        // Deadlines that need not be kept are years away.
        let is_possible = |set: usize| {
            let mut input = input.clone();
            let others = input.jobs.iter_mut().enumerate().filter(|(job, _)| set >> job & 1 == 0);
            others.for_each(|(_, job)| job.deadline = Some(1 << 50));
            cheapest_by_trying_everything(&input).is_some()
        };
        let sets = 0..1usize << input.jobs.len();
        let Some(most) = sets.filter(|&set| is_possible(set)).map(usize::count_ones).max() else { continue };
        hopeless += u32::from((most as usize) < input.jobs.len());
        // It may be more, since the plan may leave out frames that would be late.
        assert!(kept >= most as usize, "seed {seed}: {kept} of {most}");
    }
    assert!(hopeless > 200, "{hopeless} farms have too little time");
}
