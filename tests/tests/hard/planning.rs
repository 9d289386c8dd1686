//! Plans: valid bounds, promises that follow from bookings, and no harm from more resources.

use forelight_planner::{
    Booking, Confidence, FixedBooking, Frame, Input, Interval, Job, Node, Plan, Task, Verdict, Weekly,
    WorkTotal, expand, plan, verify,
};
use forelight_tests::case::case;
use proptest::prelude::*;

fn node(id: u64, speed: u64, price: i64, calendar: Vec<Interval>) -> Node {
    Node { id, name: format!("node {id}"), speed, price_per_hour: price, calendar, ..Node::default() }
}

fn always() -> Vec<Interval> {
    vec![Interval { start: 0, end: None }]
}

fn job(id: u64, works: &[u64], deadline: Option<i64>) -> Job {
    let total = works.iter().sum();
    Job {
        id,
        deadline,
        confidence: Confidence::P50,
        total: WorkTotal { p50: total, p80: total, p95: total },
        frames: works
            .iter()
            .zip(0..)
            .map(|(&work, number)| Frame { number, work, ..Frame::default() })
            .collect(),
        ..Job::default()
    }
}

/// One unit of work takes a microsecond at speed one. A price of one is a micro-unit per microsecond.
const SPEED: u64 = 1_000_000;
const PRICE: i64 = 3_600_000_000;

/// Faults of a plan, found by a second, minimal verifier.
fn wrongs(input: &Input, plan: &Plan) -> Vec<String> {
    let mut wrongs = Vec::new();
    for (i, b) in plan.bookings.iter().enumerate() {
        let node = input.nodes.iter().find(|n| n.id == b.node);
        let job = input.jobs.iter().find(|j| j.id == b.job);
        let (Some(node), Some(job)) = (node, job) else {
            wrongs.push(format!("{b:?} of nothing"));
            continue;
        };
        let place = job.frames.iter().position(|f| Task::Frame(f.number) == b.task);
        let work = place.map_or(0, |place| job.bought_work()[place]);
        // Exactly the work's time, rounded up to a microsecond, and at least one.
        let work = i128::from(work) * 1_000_000;
        let wanted = ((work + i128::from(node.speed) - 1) / i128::from(node.speed)).max(1);
        if place.is_none() || i128::from(b.end) - i128::from(b.start) != wanted {
            wrongs.push(format!("{b:?} lasts wrongly"));
        }
        if b.start < job.release.max(node.available_from).max(input.now) {
            wrongs.push(format!("{b:?} starts too early"));
        }
        // Every instant is inside the union of the calendar.
        let mut at = b.start;
        while at < b.end {
            let reach =
                node.calendar.iter().filter(|c| c.start <= at).map(|c| c.end.unwrap_or(i64::MAX)).max();
            match reach {
                Some(end) if end > at => at = end,
                _ => {
                    wrongs.push(format!("{b:?} is outside the calendar at {at}"));
                    break;
                }
            }
        }
        // Empty intervals overlap nothing.
        let overlaps = |s: i64, e: i64| s < e && b.start < b.end && b.start < e && s < b.end;
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
        let mut frames: Vec<i64> = booked.iter().filter_map(|b| b.task.frame()).collect();
        if let Verdict::Unplaced { frames: unplaced, .. } = &found.verdict {
            frames.extend(unplaced);
        }
        frames.sort_unstable();
        let mut wanted: Vec<i64> = job.frames.iter().map(|f| f.number).collect();
        wanted.sort_unstable();
        if frames != wanted {
            wrongs.push(format!("job {}: frames {frames:?} instead of {wanted:?}", job.id));
        }
        if let Some(end) = found.verdict.finish() {
            if end != booked.iter().map(|b| b.end).max().unwrap_or(end) {
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
    let shared: i64 = plan.jobs.iter().map(|j| j.cost).sum();
    let rented: i64 = plan.rentals.iter().map(|r| r.cost).sum();
    if plan.cost_bound > plan.cost || shared != plan.cost || rented != plan.cost {
        let (cost, bound) = (plan.cost, plan.cost_bound);
        wrongs.push(format!("costs {cost}, jobs {shared}, rentals {rented}, bound {bound}"));
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
            now: -100,
            nodes: nodes.into_iter().zip(0..).map(|((speed, price, calendar), id)| {
                node(id, speed * SPEED, price * PRICE, calendar)
            }).collect(),
            jobs: jobs.into_iter().zip(0..).map(|((release, deadline, works), id)| Job { release, ..job(id, &works, deadline) }).collect(),
            // Bookings that touch each other and the calendar's ends at an instant.
            fixed: fixed.into_iter().filter(|f| f.0 < count).map(|(node, start, length)| {
                FixedBooking { node, start: start * 10, end: (start + length) * 10, ..FixedBooking::default() }
            }).collect(),
            ..Input::default()
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(4000))]

    #[test]
    fn every_plan_is_what_two_checkers_say_it_must_be(input in instance()) {
        let found = plan(&input).unwrap();
        prop_assert_eq!(verify(&input, &found), Ok(()));
        prop_assert_eq!(wrongs(&input, &found), Vec::<String>::new());
    }

    #[test]
    fn a_later_deadline_or_a_cheaper_node_never_costs_more(input in instance()) {
        // One job only, because deadlines also order jobs.
        let mut input = input;
        input.jobs.truncate(1);
        if input.jobs.is_empty() {
            return Ok(());
        }
        let deadline = input.jobs[0].deadline.unwrap_or(100);
        input.jobs[0].deadline = Some(deadline + 50);
        let later = plan(&input).unwrap().cost;
        input.jobs[0].deadline = Some(deadline);
        let before = plan(&input).unwrap().cost;
        prop_assert!(later <= before, "a later deadline costs {later} instead of {before}");
        for index in 0..input.nodes.len() {
            let mut cheaper = input.clone();
            cheaper.nodes[index].price_per_hour /= 2;
            let cost = plan(&cheaper).unwrap().cost;
            prop_assert!(cost <= before, "a cheaper node {index} costs {cost} instead of {before}");
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    #[test]
    fn the_unit_of_work_the_origin_of_time_and_the_unit_of_money_do_not_matter(input in instance()) {
        let found = plan(&input).unwrap();
        let mut other = input;
        let shift = 1_700_000_000_000_000i64;
        other.now += shift;
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
        let moved = plan(&other).unwrap();
        let back = |b: &Booking| Booking { start: b.start - shift, end: b.end - shift, ..*b };
        prop_assert_eq!(moved.bookings.iter().map(back).collect::<Vec<_>>(), found.bookings);
        // Prices are whole micro-units per microsecond, so seven times the price is seven times the cost.
        prop_assert_eq!(moved.cost, 7 * found.cost);
    }
}

/// The earliest end over all assignments of works to nodes without gaps.
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
        let nodes = speeds.iter().zip(0..).map(|(&s, id)| node(id, s * SPEED, 0, always())).collect();
        let input = Input { nodes, jobs: vec![job(0, &works, None)], ..Input::default() };
        let found = plan(&input).expect("a plan");
        let end = found.jobs[0].verdict.finish().expect("there is room") as u64;
        let bound = found.jobs[0].bound.earliest_finish().expect("there is room") as u64;
        let best = optimum(&speeds, &mut vec![0; speeds.len()], &works);
        wrong += u64::from(!(bound <= best && best <= end));
        widest = widest.max(end as f64 / best as f64);
        tried += 1;
    }
    case(25, "small farms where bound ≤ optimum ≤ plan does not hold").never(wrong, tried);
    // Longest first by earliest finish on uniform nodes is below 2m/(m + 1) of the optimum (Gonzalez, Ibarra,
    // Sahni 1977). Rounding up adds at most a microsecond per frame to ends of at least eleven.
    case(25, "end of the plan over the optimum's, up to three nodes of speeds 1 to 3")
        .worst(widest, 1.5 + 0.1);
}

#[test]
fn slots_of_no_length_and_bookings_that_touch_leave_exactly_the_time_between() {
    let at = |start, end| Interval { start, end: Some(end) };
    // Free 0–10, 10–10, 10–30, 30–31; booked 5–10, 10–20 and 30–30. A frame of 10 fits at 20 exactly, one of
    // 12 does not fit.
    let calendar = vec![at(0, 10), at(10, 10), at(10, 30), at(30, 31)];
    let booked = |start, end| FixedBooking { node: 0, start, end, ..FixedBooking::default() };
    let fixed = vec![booked(5, 10), booked(10, 20), booked(30, 30)];
    let input = |work| Input {
        nodes: vec![node(0, SPEED, 0, calendar.clone())],
        fixed: fixed.clone(),
        jobs: vec![job(0, &[work], None)],
        ..Input::default()
    };
    let end = |work| plan(&input(work)).expect("a plan").jobs[0].verdict.finish();
    let expected = [(5, Some(5)), (10, Some(30)), (11, Some(31)), (12, None), (0, Some(1))];
    let wrong = expected.iter().filter(|(work, expected)| end(*work) != *expected).count() as u64;
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
                    let node = Node { available_from: start, ..node(0, SPEED, i64::MAX, open) };
                    let input =
                        Input { now: release, nodes: vec![node], jobs: vec![one], ..Input::default() };
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
fn nights_in_which_clocks_change_lose_and_gain_their_hour() {
    use jiff::civil::{Weekday, time};
    // 22:00 to 06:00 in Vienna: seven hours in the night to 29 March 2026, nine in that to 25 October, eight
    // in others.
    let night = Weekly {
        zone: jiff::tz::TimeZone::get("Europe/Vienna").expect("a time zone"),
        days: vec![Weekday::Saturday],
        from: time(22, 0, 0, 0),
        until: time(6, 0, 0, 0),
    };
    let hour = 3_600_000_000i64;
    let at = |text: &str| text.parse::<jiff::Timestamp>().expect("an instant").as_microsecond();
    let mut wrong = 0;
    let nights = [("2026-03-28", 7), ("2026-10-24", 9), ("2026-06-06", 8)];
    for (evening, hours) in nights {
        let noon = at(&format!("{evening}T12:00:00Z"));
        let calendar = expand(std::slice::from_ref(&night), noon, noon + 24 * hour).expect("a night");
        let frames = |count: usize| {
            let works = vec![hour as u64; count];
            let input = Input {
                now: noon,
                nodes: vec![node(0, SPEED, 0, calendar.clone())],
                jobs: vec![job(0, &works, None)],
                ..Input::default()
            };
            plan(&input).expect("a plan").jobs[0].verdict.is_kept()
        };
        wrong += u64::from(!frames(hours) || frames(hours + 1));
    }
    case(25, "nights in Vienna that do not have their 7, 9 and 8 hours").never(wrong, 3);
}

/// The least cost over all assignments of works to nodes that finish by the deadline.
fn cheapest(nodes: &[(u64, u64)], loads: &mut Vec<u64>, works: &[u64], deadline: u64) -> Option<u64> {
    let Some((&work, rest)) = works.split_first() else { return Some(0) };
    let mut least = None;
    for (i, &(speed, price)) in nodes.iter().enumerate() {
        let time = work.div_ceil(speed);
        if loads[i] + time <= deadline {
            loads[i] += time;
            if let Some(others) = cheapest(nodes, loads, rest, deadline) {
                least = Some(least.unwrap_or(u64::MAX).min(others + time * price));
            }
            loads[i] -= time;
        }
    }
    least
}

#[test]
fn on_tiny_farms_a_plan_is_found_whenever_there_is_one_and_none_is_cheaper() {
    let (mut missed, mut wrong, mut tried, mut dearest) = (0, 0, 0, 1.0f64);
    for i in 0..2000u64 {
        let mut stream = crate::meshes::Stream::new(i);
        let mut draw = |below: usize| stream.below(below) as u64;
        let nodes: Vec<(u64, u64)> = (0..1 + draw(3)).map(|_| (1 + draw(3), 1 + draw(5))).collect();
        let works: Vec<u64> = (0..1 + draw(6)).map(|_| 1 + draw(30)).collect();
        let deadline = 10 + draw(90);
        let farm = nodes.iter().zip(0..).map(|(&(s, p), id)| node(id, s * SPEED, p as i64 * PRICE, always()));
        let one = job(0, &works, Some(deadline as i64));
        let input = Input { nodes: farm.collect(), jobs: vec![one], ..Input::default() };
        let found = plan(&input).expect("a plan");
        let best = cheapest(&nodes, &mut vec![0; nodes.len()], &works, deadline);
        tried += 1;
        match best {
            Some(best) if found.jobs[0].verdict.is_kept() => {
                dearest = dearest.max(found.cost as f64 / best as f64);
                wrong += u64::from(found.cost_bound > best as i64);
            }
            Some(_) => missed += 1,
            None => wrong += u64::from(found.jobs[0].verdict.is_kept()),
        }
    }
    case(25, "tiny farms with a plan in time that is not found").never(missed, tried);
    case(25, "tiny farms whose bound is above the optimum, or whose verdict is impossible")
        .never(wrong, tried);
    // Nodes are billed as used, without set-up. Every assignment is tried.
    case(25, "cost of the plan over the optimum's by enumeration, tiny farms").worst(dearest, 1.0);
}
