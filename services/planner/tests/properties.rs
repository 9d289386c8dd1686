//! The wanted properties of the README, on random instances.

use forelight_planner::{
    Confidence, FixedBooking, Frame, Input, Interval, Job, Node, Verdict, WorkTotal, plan, verify,
};
use proptest::prelude::*;

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
        Node { id: 0, name: String::new(), speed, price_per_hour, available_from, calendar }
    }
}

prop_compose! {
    fn job()(
        release in -20i64..200,
        deadline in prop::option::of(-100i64..600),
        priority in -1i32..2,
        confidence in prop_oneof![Just(Confidence::P50), Just(Confidence::P80), Just(Confidence::P95)],
        works in prop::collection::vec(prop_oneof![20 => 0u64..120, 1 => Just(u64::MAX)], 0..8),
        margin in (0u64..100, 0u64..100),
        budget in prop::option::of(0i64..5_000_000),
    ) -> Job {
        let p50 = works.iter().fold(0u64, |sum, &work| sum.saturating_add(work));
        let p80 = p50.saturating_add(margin.0);
        let total = WorkTotal { p50, p80, p95: p80.saturating_add(margin.1) };
        let frames = works.iter().zip(0..).map(|(&work, number)| Frame { number: 3 * number - 5, work }).collect();
        Job { id: 0, release, deadline, priority, confidence, total, frames, budget }
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
        let fixed = fixed.map(|(node, start, length)| FixedBooking { node: node + 10, start, end: start + length });
        Input { fixed: fixed.collect(), nodes, jobs }
    }
}

/// Identical nodes, one unit of work a microsecond, free from instant zero.
fn identical(nodes: u64, works: &[u64], deadline: Option<i64>) -> Input {
    let total: u64 = works.iter().sum();
    Input {
        nodes: (0..nodes)
            .map(|id| Node {
                id,
                name: String::new(),
                speed: 1_000_000,
                price_per_hour: 0,
                available_from: 0,
                calendar: vec![Interval { start: 0, end: None }],
            })
            .collect(),
        fixed: vec![],
        jobs: vec![Job {
            id: 0,
            release: 0,
            deadline,
            priority: 0,
            confidence: Confidence::P50,
            total: WorkTotal { p50: total, p80: total, p95: total },
            frames: works.iter().zip(0..).map(|(&work, number)| Frame { number, work }).collect(),
            budget: None,
        }],
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

/// The least makespan of all assignments of works to identical nodes.
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
        let lateness = |deadline| match plan(&identical(nodes, &works, Some(deadline))).expect("a plan").jobs[0].verdict {
            Verdict::Feasible { slack, .. } => -slack,
            Verdict::Late { by, .. } => by,
            _ => panic!("there is a deadline and room"),
        };
        prop_assert_eq!(lateness(deadline + more), lateness(deadline) - more);
    }

    #[test]
    fn the_unit_of_work_does_not_matter(input in any_input(), factor in 1u64..1000) {
        // Scaling must stay in range, and quantiles that scale frames by fractions round differently: medians
        // are bought.
        let mut small = input;
        small.nodes.iter_mut().for_each(|node| node.speed = node.speed.min(10_000_000));
        for job in &mut small.jobs {
            job.frames.iter_mut().for_each(|frame| frame.work = frame.work.min(1000));
            let total = job.frames.iter().map(|frame| frame.work).sum();
            job.total = WorkTotal { p50: total, p80: total, p95: total };
        }
        let mut large = small.clone();
        large.nodes.iter_mut().for_each(|node| node.speed *= factor);
        for job in &mut large.jobs {
            job.frames.iter_mut().for_each(|frame| frame.work *= factor);
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
