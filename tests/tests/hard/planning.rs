//! Plans: bounds that hold, promises that follow from bookings, and no worse for having more.

use forelight_planner::{
    Confidence, FixedBooking, Frame, Input, Interval, Job, Node, Plan, Verdict, WorkTotal, plan, verify,
};
use forelight_tests::case::case;
use proptest::prelude::*;
use proptest::test_runner::TestRunner;

fn node(id: u64, speed: u64, price: i64, calendar: Vec<Interval>) -> Node {
    Node { id, name: format!("node {id}"), speed, price_per_hour: price, available_from: 0, calendar }
}

fn always() -> Vec<Interval> {
    vec![Interval { start: 0, end: None }]
}

fn job(id: u64, works: &[u64], deadline: Option<i64>) -> Job {
    let total = works.iter().sum();
    Job {
        id,
        release: 0,
        deadline,
        priority: 0,
        confidence: Confidence::P50,
        total: WorkTotal { p50: total, p80: total, p95: total },
        frames: works.iter().zip(0..).map(|(&work, number)| Frame { number, work }).collect(),
        budget: None,
    }
}

fn finish(verdict: &Verdict) -> Option<i64> {
    match verdict {
        Verdict::Feasible { finish, .. } | Verdict::NoDeadline { finish } | Verdict::Late { finish, .. } => {
            Some(*finish)
        }
        Verdict::Unplaced { .. } => None,
    }
}

/// What is wrong with a plan, found without the planner's own verifier: the essentials, written once more.
fn wrongs(input: &Input, plan: &Plan) -> Vec<String> {
    let mut wrongs = Vec::new();
    for (i, b) in plan.bookings.iter().enumerate() {
        let node = input.nodes.iter().find(|n| n.id == b.node);
        let job = input.jobs.iter().find(|j| j.id == b.job);
        let (Some(node), Some(job)) = (node, job) else {
            wrongs.push(format!("{b:?} of nothing"));
            continue;
        };
        let place = job.frames.iter().position(|f| f.number == b.frame);
        let work = place.map_or(0, |place| job.bought_work()[place]);
        // Exactly as long as the work takes, rounded up to a microsecond.
        let (length, work) = (i128::from(b.end) - i128::from(b.start), i128::from(work) * 1_000_000);
        let speed = i128::from(node.speed);
        if length * speed < work || (length - 1) * speed >= work.max(1) && length > 0 {
            wrongs.push(format!("{b:?} lasts wrongly"));
        }
        if b.start < job.release.max(node.available_from) && b.end > b.start {
            wrongs.push(format!("{b:?} starts too early"));
        }
        // Every instant of it is inside the union of the calendar.
        let mut at = b.start;
        while at < b.end {
            let reach = node.calendar.iter().filter(|c| c.start <= at).map(|c| c.end.unwrap_or(i64::MAX)).max();
            match reach {
                Some(end) if end > at => at = end,
                _ => {
                    wrongs.push(format!("{b:?} is outside the calendar at {at}"));
                    break;
                }
            }
        }
        let overlaps = |s: i64, e: i64| b.start < e && s < b.end;
        if plan.bookings[..i].iter().any(|o| o.node == b.node && overlaps(o.start, o.end))
            || input.fixed.iter().any(|f| f.node == b.node && overlaps(f.start, f.end))
        {
            wrongs.push(format!("{b:?} overlaps"));
        }
    }
    for job in &input.jobs {
        let booked: Vec<_> = plan.bookings.iter().filter(|b| b.job == job.id).collect();
        let Some(found) = plan.jobs.iter().find(|j| j.job == job.id) else {
            wrongs.push(format!("job {} has no verdict", job.id));
            continue;
        };
        let mut frames: Vec<i64> = booked.iter().map(|b| b.frame).collect();
        if let Verdict::Unplaced { frames: unplaced } = &found.verdict {
            frames.extend(unplaced);
        }
        frames.sort_unstable();
        let mut wanted: Vec<i64> = job.frames.iter().map(|f| f.number).collect();
        wanted.sort_unstable();
        if frames != wanted {
            wrongs.push(format!("job {}: frames {frames:?} instead of {wanted:?}", job.id));
        }
        if let Some(end) = finish(&found.verdict) {
            if end != booked.iter().map(|b| b.end).max().unwrap_or(job.release) {
                wrongs.push(format!("job {}: ends at {end}", job.id));
            }
            if found.bound.earliest_finish().is_none_or(|bound| bound > end) {
                wrongs.push(format!("job {}: ends at {end}, before its bound {:?}", job.id, found.bound));
            }
            let late = job.deadline.is_some_and(|d| end > d);
            if late != matches!(found.verdict, Verdict::Late { .. }) {
                wrongs.push(format!("job {}: {:?}", job.id, found.verdict));
            }
        }
    }
    wrongs
}

/// Intervals that touch, overlap, are empty, begin before everything, or never end.
fn interval() -> impl Strategy<Value = Interval> {
    let length = prop_oneof![2 => Just(Some(0i64)), 6 => (1i64..120).prop_map(Some), 2 => Just(None)];
    ((-30i64..30).prop_map(|s| s * 10), length)
        .prop_map(|(start, length)| Interval { start, end: length.map(|l| start + l / 10 * 10) })
}

prop_compose! {
    fn instance()(
        nodes in prop::collection::vec((1u64..4, 0i64..5, prop::collection::vec(interval(), 0..5)), 0..4),
        jobs in prop::collection::vec((-20i64..60, prop::option::of(-20i64..400), prop::collection::vec(0u64..60, 0..6)), 0..4),
        fixed in prop::collection::vec((0u64..4, 0i64..30, 0i64..6), 0..5),
    ) -> Input {
        let count = nodes.len() as u64;
        Input {
            nodes: nodes.into_iter().zip(0..).map(|((speed, price, calendar), id)| {
                node(id, speed * 1_000_000, price * 3_600_000_000, calendar)
            }).collect(),
            jobs: jobs.into_iter().zip(0..).map(|((release, deadline, works), id)| Job { release, ..job(id, &works, deadline) }).collect(),
            // Bookings that touch each other and the calendar's ends at an instant.
            fixed: fixed.into_iter().filter(|f| f.0 < count).map(|(node, start, length)| {
                FixedBooking { node, start: start * 10, end: (start + length) * 10 }
            }).collect(),
        }
    }
}

/// Runs `check` on that many random instances; returns how many it found wrong, having printed the first few.
fn over_instances(cases: u32, mut check: impl FnMut(&Input) -> Result<(), String>) -> u64 {
    let mut runner = TestRunner::deterministic();
    let mut wrong = 0;
    for _ in 0..cases {
        let tree = instance().new_tree(&mut runner).expect("an instance");
        let input = proptest::strategy::ValueTree::current(&tree);
        if let Err(reason) = check(&input) {
            if wrong < 3 {
                println!("         {reason}\n         {input:?}");
            }
            wrong += 1;
        }
    }
    wrong
}

#[test]
fn every_plan_is_what_two_checkers_say_it_must_be() {
    let cases = 4000;
    let wrong = over_instances(cases, |input| {
        let found = plan(input).map_err(|e| e.to_string())?;
        verify(input, &found).map_err(|e| format!("{e:?}"))?;
        wrongs(input, &found).into_iter().next().map_or(Ok(()), Err)
    });
    case(25, "random plans (touching, empty, endless intervals) that one of two checkers refuses").never(wrong, cases.into());
}

#[test]
fn a_later_deadline_or_a_cheaper_node_never_costs_more() {
    let cases = 4000;
    let mut tried = 0;
    let wrong = over_instances(cases, |input| {
        // One job, for a deadline also orders jobs among each other.
        let mut input = input.clone();
        input.jobs.truncate(1);
        let Some(job) = input.jobs.first_mut() else { return Ok(()) };
        let deadline = job.deadline.get_or_insert(100);
        *deadline += 50;
        let later = plan(&input).map_err(|e| e.to_string())?;
        *input.jobs[0].deadline.get_or_insert(0) -= 50;
        let before = plan(&input).map_err(|e| e.to_string())?;
        tried += 1;
        if later.cost > before.cost {
            return Err(format!("a later deadline costs {} instead of {}", later.cost, before.cost));
        }
        for index in 0..input.nodes.len() {
            let mut cheaper = input.clone();
            cheaper.nodes[index].price_per_hour /= 2;
            let cost = plan(&cheaper).map_err(|e| e.to_string())?.cost;
            if cost > before.cost {
                return Err(format!("a cheaper node {index} costs {cost} instead of {}", before.cost));
            }
        }
        Ok(())
    });
    case(25, "random plans that a later deadline or a cheaper node makes dearer").never(wrong, tried);
}

#[test]
fn the_unit_of_work_the_origin_of_time_and_the_unit_of_money_do_not_matter() {
    let cases = 2000;
    let wrong = over_instances(cases, |input| {
        let found = plan(input).map_err(|e| e.to_string())?;
        let mut other = input.clone();
        let shift = 1_700_000_000_000_000i64;
        for n in &mut other.nodes {
            n.speed *= 1000;
            n.price_per_hour *= 7;
            n.available_from += shift;
            for c in &mut n.calendar {
                c.start += shift;
                c.end = c.end.map(|e| e + shift);
            }
        }
        for j in &mut other.jobs {
            j.release += shift;
            j.deadline = j.deadline.map(|d| d + shift);
            j.frames.iter_mut().for_each(|f| f.work *= 1000);
            let total = j.total.p50 * 1000;
            j.total = WorkTotal { p50: total, p80: total, p95: total };
        }
        for f in &mut other.fixed {
            f.start += shift;
            f.end += shift;
        }
        let moved = plan(&other).map_err(|e| e.to_string())?;
        let back: Vec<_> = moved
            .bookings
            .iter()
            .map(|b| forelight_planner::Booking { start: b.start - shift, end: b.end - shift, ..*b })
            .collect();
        // Prices are whole micro-units a microsecond here, so seven times the price is seven times the cost.
        if back == found.bookings && moved.cost == 7 * found.cost { Ok(()) } else { Err("another plan".into()) }
    });
    case(25, "random plans that another unit of work or money, or another epoch, changes").never(wrong, cases.into());
}

/// The least end over all ways to put the works onto the nodes, in any order: nodes without gaps.
fn optimum(speeds: &[u64], loads: &mut Vec<u64>, works: &[u64]) -> u64 {
    let Some((&work, rest)) = works.split_first() else {
        return loads.iter().copied().max().unwrap_or(0);
    };
    (0..speeds.len())
        .map(|i| {
            let time = work.div_ceil(speeds[i]);
            loads[i] += time;
            let best = optimum(speeds, loads, rest);
            loads[i] -= time;
            best
        })
        .min()
        .unwrap_or(0)
}

#[test]
fn bound_optimum_and_plan_stand_in_this_order_on_all_small_farms() {
    let (mut wrong, mut tried, mut widest) = (0, 0, 1.0f64);
    for i in 0..3000u64 {
        let mut state = i;
        let mut draw = |below: u64| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) % below
        };
        let speeds: Vec<u64> = (0..1 + draw(3)).map(|_| 1 + draw(3)).collect();
        let works: Vec<u64> = (0..1 + draw(6)).map(|_| 1 + draw(30)).collect();
        let nodes = speeds.iter().zip(0..).map(|(&s, id)| node(id, s * 1_000_000, 0, always())).collect();
        let input = Input { nodes, fixed: vec![], jobs: vec![job(0, &works, None)] };
        let found = plan(&input).expect("a plan");
        let end = finish(&found.jobs[0].verdict).expect("there is room") as u64;
        let bound = found.jobs[0].bound.earliest_finish().expect("there is room") as u64;
        let best = optimum(&speeds, &mut vec![0; speeds.len()], &works);
        wrong += u64::from(!(bound <= best && best <= end));
        widest = widest.max(end as f64 / best as f64);
        tried += 1;
    }
    case(25, "small farms where bound ≤ optimum ≤ plan does not hold").never(wrong, tried);
    // Longest first by earliest finish on uniform nodes: below 2m/(m + 1) of the optimum (Gonzalez, Ibarra, Sahni 1977), and
    // rounding up to microseconds can add one for each frame to ends of at least eleven.
    case(25, "end of the plan over the optimum's, up to three nodes of speeds 1 to 3").worst(widest, 1.5 + 0.1);
}

#[test]
fn slots_of_no_length_and_bookings_that_touch_leave_exactly_the_time_between() {
    let at = |start, end| Interval { start, end: Some(end) };
    // Free 0–10, 10–10, 10–30, 30–31; booked 5–10 and 10–20 and 30–30: a frame of 10 fits at 20 to the microsecond, one of 12
    // does not fit at all.
    let calendar = vec![at(0, 10), at(10, 10), at(10, 30), at(30, 31)];
    let fixed = vec![
        FixedBooking { node: 0, start: 5, end: 10 },
        FixedBooking { node: 0, start: 10, end: 20 },
        FixedBooking { node: 0, start: 30, end: 30 },
    ];
    let input = |work| Input {
        nodes: vec![node(0, 1_000_000, 0, calendar.clone())],
        fixed: fixed.clone(),
        jobs: vec![job(0, &[work], Some(31))],
    };
    let found = |work| plan(&input(work)).expect("a plan").jobs[0].verdict.clone();
    let mut wrong = 0;
    wrong += u64::from(found(5) != Verdict::Feasible { finish: 5, slack: 26 });
    wrong += u64::from(found(10) != Verdict::Feasible { finish: 30, slack: 1 });
    wrong += u64::from(found(11) != Verdict::Feasible { finish: 31, slack: 0 });
    wrong += u64::from(found(12) != Verdict::Unplaced { frames: vec![0] });
    wrong += u64::from(found(0) != Verdict::Feasible { finish: 0, slack: 31 });
    case(25, "frames at instants where slots and bookings touch that are placed wrongly").never(wrong, 5);
}

#[test]
fn the_ends_of_time_are_verdicts_and_no_panic() {
    let extremes = [i64::MIN, i64::MIN + 1, -1, 0, 1, i64::MAX - 1, i64::MAX];
    let (mut wrong, mut tried) = (0, 0);
    for start in extremes {
        for end in extremes {
            for release in extremes {
                for work in [0, 1, u64::MAX] {
                    let open = vec![Interval { start, end: (end >= start).then_some(end) }];
                    let mut one = job(0, &[work], Some(end));
                    one.release = release;
                    let node = Node { available_from: start, ..node(0, 1_000_000, i64::MAX, open) };
                    let input = Input { nodes: vec![node], fixed: vec![], jobs: vec![one] };
                    let checked = plan(&input).map(|found| verify(&input, &found));
                    wrong += u64::from(checked != Ok(Ok(())));
                    tried += 1;
                }
            }
        }
    }
    case(25, "plans at the ends of the range of time that the verifier refuses").never(wrong, tried);
}

#[test]
fn calendars_across_a_change_of_clocks_lose_and_gain_their_hour() {
    // Nights from 22:00 to 06:00 in Vienna, 2026: 29 March has an hour less, 25 October one more. Instants are UTC, so what
    // turns local hours into instants decides: it is said here by the offsets (+1 in winter, +2 in summer).
    let hour = 3_600_000_000i64;
    let night = |evening_utc: i64, morning_utc: i64| Interval { start: evening_utc * hour, end: Some(morning_utc * hour) };
    // Hours since 2026-03-28T00:00Z: 22:00 is 21:00Z (winter); 06:00 on the 29th is 04:00Z (summer).
    let spring = night(21, 28);
    // Hours since 2026-10-24T00:00Z: 22:00 is 20:00Z (summer); 06:00 on the 25th is 05:00Z (winter).
    let autumn = night(20, 29);
    let frames = |interval: Interval| {
        let works = vec![60 * 60 * 1_000_000u64; 12];
        let input = Input {
            nodes: vec![node(0, 1_000_000, 0, vec![interval])],
            fixed: vec![],
            jobs: vec![job(0, &works, None)],
        };
        plan(&input).expect("a plan").bookings.len() as f64
    };
    case(25, "hours in the night of 29 March in Vienna").worst((frames(spring) - 7.0).abs(), 0.0);
    case(25, "hours in the night of 25 October in Vienna").worst((frames(autumn) - 9.0).abs(), 0.0);
}
