//! Plans of small farms with known answers, and errors for bad input.

use forelight_planner::chance::bits;
use forelight_planner::{
    Booking, Bound, Confidence, FixedBooking, Frame, Input, InputError, Interval, Job, Node, Plan, Verdict,
    Violation, WorkTotal, plan, verify,
};

const SECOND: i64 = 1_000_000;
const HOUR: i64 = 3600 * SECOND;

fn node(id: u64, speed: u64) -> Node {
    Node {
        id,
        name: format!("node-{id}"),
        speed,
        price_per_hour: 3_600_000,
        calendar: vec![Interval { start: 0, end: None }],
        ..Node::default()
    }
}

fn job(id: u64, deadline: Option<i64>, works: &[u64]) -> Job {
    let total: u64 = works.iter().fold(0, |sum, &work| sum.saturating_add(work));
    Job {
        id,
        deadline,
        confidence: Confidence::P50,
        total: WorkTotal { p50: total, p80: total, p95: total },
        frames: (0..).zip(works).map(|(number, &work)| Frame { number, work, ..Frame::default() }).collect(),
        ..Job::default()
    }
}

fn input(nodes: Vec<Node>, jobs: Vec<Job>) -> Input {
    Input { nodes, jobs, ..Input::default() }
}

fn sound(input: &Input) -> Plan {
    let found = plan(input).expect("a plan");
    assert_eq!(verify(input, &found), Ok(()));
    found
}

#[test]
fn the_longest_frame_goes_first_to_the_fastest_node() {
    let found = sound(&input(vec![node(1, 10), node(2, 20)], vec![job(1, None, &[10, 40, 20])]));
    let booked: Vec<(i64, u64, i64, i64)> =
        found.bookings.iter().map(|b| (b.task.frame().expect("a frame"), b.node, b.start, b.end)).collect();
    assert_eq!(booked, [(2, 1, 0, 2 * SECOND), (1, 2, 0, 2 * SECOND), (0, 2, 2 * SECOND, 2_500_000)]);
    assert_eq!(found.jobs[0].verdict, Verdict::NoDeadline { finish: 2_500_000 });
    assert_eq!(
        found.bound,
        Bound { by_capacity: Some(2_333_334), by_longest_frame: Some(2 * SECOND) },
        "70 units at 30 a second; 40 at 20"
    );
}

#[test]
fn among_equal_ends_the_cheaper_node_wins() {
    let dear = Node { price_per_hour: 9_000_000, ..node(1, 10) };
    let found = sound(&input(vec![dear, node(2, 10)], vec![job(1, None, &[10])]));
    assert_eq!(found.bookings[0].node, 2);
}

#[test]
fn the_earlier_deadline_goes_first_whatever_the_order_of_jobs() {
    let jobs = vec![job(1, None, &[10]), job(2, Some(9 * SECOND), &[10]), job(3, Some(SECOND), &[10])];
    let found = sound(&input(vec![node(1, 10)], jobs));
    let order: Vec<u64> = found.bookings.iter().map(|b| b.job).collect();
    assert_eq!(order, [3, 2, 1]);
    assert_eq!(found.jobs[1].verdict, Verdict::Feasible { finish: 2 * SECOND, slack: 7 * SECOND });
}

#[test]
fn among_equal_deadlines_the_greater_priority_goes_first() {
    let urgent = Job { priority: 5, ..job(2, Some(HOUR), &[10]) };
    let found = sound(&input(vec![node(1, 10)], vec![job(1, Some(HOUR), &[10]), urgent]));
    assert_eq!(found.bookings[0].job, 2);
}

#[test]
fn capacity_is_bought_at_the_jobs_quantile() {
    let confident = Job {
        confidence: Confidence::P95,
        total: WorkTotal { p50: 30, p80: 40, p95: 61 },
        ..job(1, None, &[10, 20])
    };
    assert_eq!(confident.bought_work(), [21, 41], "61 in the ratio of one to two, rounded up");
    let found = sound(&input(vec![node(1, 1)], vec![confident]));
    assert_eq!(found.jobs[0].verdict, Verdict::NoDeadline { finish: 62 * SECOND });
}

#[test]
fn frames_without_a_forecast_share_the_total_evenly() {
    let unknown = Job { total: WorkTotal { p50: 10, p80: 10, p95: 10 }, ..job(1, None, &[0, 0, 0]) };
    assert_eq!(unknown.bought_work(), [4, 4, 4]);
}

#[test]
fn every_booking_rounds_its_time_up_and_every_rental_its_price() {
    let found = sound(&input(
        vec![Node { price_per_hour: 1, ..node(1, 3) }],
        vec![Job { budget: Some(0), ..job(1, None, &[1, 1]) }],
    ));
    assert_eq!(found.bookings[0].end, 333_334);
    assert_eq!((found.jobs[0].cost, found.cost, found.rentals.len()), (1, 1, 1));
    assert_eq!(found.jobs[0].within_budget, Some(false));
}

#[test]
fn fixed_bookings_calendars_and_releases_are_respected_to_the_microsecond() {
    let mut one = node(1, 1);
    one.calendar = vec![
        Interval { start: 0, end: Some(10 * SECOND) },
        Interval { start: 20 * SECOND, end: Some(30 * SECOND) },
        Interval { start: 25 * SECOND, end: Some(45 * SECOND) },
    ];
    one.available_from = SECOND;
    let mut work =
        input(vec![one], vec![Job { release: 2 * SECOND, ..job(1, Some(40 * SECOND), &[5, 6, 15]) }]);
    work.fixed =
        vec![FixedBooking { node: 1, start: 7 * SECOND, end: 8 * SECOND, ..FixedBooking::default() }];
    let found = sound(&work);
    let booked: Vec<(i64, i64, i64)> = found
        .bookings
        .iter()
        .map(|b| (b.task.frame().expect("a frame"), b.start / SECOND, b.end / SECOND))
        .collect();
    assert_eq!(booked, [(0, 2, 7), (2, 20, 35), (1, 35, 41)]);
    let Verdict::Late { finish, by, unavoidable } = found.jobs[0].verdict else { panic!("late") };
    assert_eq!((finish, by, unavoidable), (41 * SECOND, SECOND, false));
    assert_eq!(found.jobs[0].bound.by_capacity, Some(39 * SECOND));
    assert_eq!(found.jobs[0].bound.by_longest_frame, Some(35 * SECOND));
}

#[test]
fn a_deadline_in_the_past_is_late_and_cannot_be_helped() {
    let found = sound(&input(vec![node(1, 10)], vec![job(1, Some(-HOUR), &[10])]));
    assert_eq!(found.jobs[0].verdict, Verdict::Late { finish: SECOND, by: HOUR + SECOND, unavoidable: true });
}

#[test]
fn an_empty_farm_places_nothing_and_says_so() {
    let found = sound(&input(vec![], vec![job(1, Some(HOUR), &[10, 20])]));
    assert_eq!(found.jobs[0].verdict, Verdict::Unplaced { frames: vec![0, 1], shared_cache: false });
    assert_eq!(found.jobs[0].bound.earliest_finish(), None);
    assert!(found.bookings.is_empty());
}

#[test]
fn a_frame_that_fits_no_gap_is_unplaced_and_the_others_are_not() {
    let mut one = node(1, 1);
    one.calendar = vec![Interval { start: 0, end: Some(10 * SECOND) }];
    let found = sound(&input(vec![one], vec![job(1, None, &[11, 10])]));
    assert_eq!(found.jobs[0].verdict, Verdict::Unplaced { frames: vec![0], shared_cache: false });
    assert_eq!(found.bookings.len(), 1);
}

#[test]
fn jobs_without_frames_and_inputs_without_anything_are_planned() {
    let empty = Job { release: 5, ..job(1, Some(7), &[]) };
    assert_eq!(sound(&input(vec![], vec![empty])).jobs[0].verdict, Verdict::Feasible { finish: 5, slack: 2 });
    assert_eq!(sound(&Input::default()), Plan::default());
}

#[test]
fn absurd_numbers_give_a_verdict() {
    let vast = Job {
        release: i64::MIN,
        deadline: Some(i64::MIN),
        budget: Some(i64::MIN),
        ..job(1, None, &[u64::MAX, u64::MAX, 1])
    };
    let dear = Node { price_per_hour: i64::MAX, available_from: i64::MIN, ..node(1, 1) };
    let mut endless = Node { speed: u64::MAX, price_per_hour: i64::MAX, ..node(2, 1) };
    endless.calendar = vec![Interval { start: i64::MIN, end: None }];
    endless.available_from = i64::MIN;
    let found =
        sound(&input(vec![dear, endless], vec![vast, Job { release: i64::MAX, ..job(2, None, &[1]) }]));
    assert!(matches!(found.jobs[0].verdict, Verdict::Late { unavoidable: true, .. }));
    assert_eq!(found.jobs[1].verdict, Verdict::Unplaced { frames: vec![0], shared_cache: false });
    assert_eq!(found.jobs[0].within_budget, Some(false));
}

#[test]
fn input_without_a_meaning_is_named() {
    let one = || node(1, 10);
    let two = || job(2, None, &[1]);
    let reversed = Node { calendar: vec![Interval { start: 3, end: Some(2) }], ..one() };
    let twice = Job { frames: vec![Frame { number: 4, work: 1, ..Frame::default() }; 2], ..two() };
    let falling = Job { total: WorkTotal { p50: 3, p80: 2, p95: 4 }, ..two() };
    let fixed = |node, start, end| Input {
        nodes: vec![one()],
        fixed: vec![FixedBooking { node, start, end, ..FixedBooking::default() }],
        ..Input::default()
    };
    for (bad, expected) in [
        (input(vec![one(), one()], vec![]), InputError::DuplicateNode { node: 1 }),
        (input(vec![node(1, 0)], vec![]), InputError::ZeroSpeed { node: 1 }),
        (
            input(vec![Node { price_per_hour: -1, ..one() }], vec![]),
            InputError::NegativePrice { node: 1, price: -1 },
        ),
        (input(vec![reversed], vec![]), InputError::ReversedInterval { node: 1, start: 3, end: 2 }),
        (input(vec![], vec![two(), two()]), InputError::DuplicateJob { job: 2 }),
        (input(vec![], vec![twice]), InputError::DuplicateFrame { job: 2, frame: 4 }),
        (input(vec![], vec![falling]), InputError::FallingQuantiles { job: 2 }),
        (fixed(9, 0, 1), InputError::UnknownNode { node: 9 }),
        (fixed(1, 1, 0), InputError::ReversedBooking { node: 1, start: 1, end: 0 }),
    ] {
        assert_eq!(plan(&bad), Err(expected.clone()));
        assert_eq!(verify(&bad, &Plan::default()), Err(vec![Violation::Input(expected)]));
    }
}

#[test]
fn a_small_farm_that_is_late_whatever_it_does_is_late_by_no_more_than_it_has_to_be() {
    // Longest first would put 3 + 2 + 2 on one of the nodes.
    let nodes = || vec![node(1, 1_000_000), node(2, 1_000_000)];
    let found = sound(&input(nodes(), vec![job(1, Some(5), &[3, 3, 2, 2, 2])]));
    assert_eq!(found.jobs[0].verdict, Verdict::Late { finish: 6, by: 1, unavoidable: true });
    // A job that can be in time stays in time, however late another becomes.
    let found = sound(&input(nodes(), vec![job(1, Some(2), &[2, 2]), job(2, Some(3), &[3, 3, 2, 2, 2])]));
    assert_eq!(found.jobs[0].verdict, Verdict::Feasible { finish: 2, slack: 0 });
    assert!(matches!(found.jobs[1].verdict, Verdict::Late { finish: 8, by: 5, .. }), "{:?}", found.jobs);
}

#[test]
fn jobs_with_nothing_left_to_do_do_not_count_when_a_small_farm_is_late() {
    let mut jobs: Vec<Job> = (0..70).map(|id| job(id, Some(HOUR), &[])).collect();
    jobs.push(Job { done: vec![0], ..job(70, Some(-HOUR), &[10]) });
    jobs.extend([job(71, Some(SECOND), &[3]), job(72, Some(4 * SECOND), &[2, 2])]);
    let found = sound(&input(vec![node(1, 1)], jobs));
    assert!(found.jobs[..70].iter().all(|entry| entry.verdict.is_kept()));
    assert!(
        matches!(found.jobs[71].verdict, Verdict::Late { by, .. } if by == 6 * SECOND),
        "{:?}",
        found.jobs[71]
    );
    assert!(found.jobs[72].verdict.is_kept());
}

/// A reference for list scheduling of one job's frames: in this order, each frame goes where it ends first,
/// and ties go to the first node.
fn one_by_one(nodes: &[Node], works: &[(i64, u64)]) -> Vec<(i64, u64, i64, i64)> {
    let mut taken: Vec<Vec<(i64, i64)>> = nodes
        .iter()
        .map(|node| node.maintenance.iter().map(|closed| (closed.start, closed.end.unwrap())).collect())
        .collect();
    let mut placed = Vec::new();
    for &(number, work) in works {
        let first_end = |node: usize| {
            let length = nodes[node].duration(work, 0).unwrap();
            let starts = std::iter::once(0).chain(taken[node].iter().map(|&(_, end)| end));
            let is_free = |&start: &i64| !taken[node].iter().any(|&(s, e)| s < start + length && start < e);
            starts.filter(is_free).min().unwrap() + length
        };
        let (end, node) = (0..nodes.len()).map(|node| (first_end(node), node)).min().unwrap();
        let start = end - nodes[node].duration(work, 0).unwrap();
        taken[node].push((start, end));
        placed.push((start, nodes[node].id, number, end));
    }
    placed.sort_unstable();
    placed
}

#[test]
fn a_farm_full_of_gaps_is_planned_as_if_every_frame_looked_at_all_that_is_taken() {
    let closed = |node: u64, n: u64| {
        let start = (10 * n + bits(5, &[node, n]) % 8) as i64 * SECOND;
        Interval { start, end: Some(start + SECOND + (bits(6, &[node, n]) % 2) as i64 * SECOND / 2) }
    };
    let gappy = |id: u64| Node {
        price_per_hour: 0,
        maintenance: (0..300).map(|n| closed(id, n)).collect(),
        ..node(id, 1000 + 100 * (id % 3))
    };
    let nodes: Vec<Node> = (0..3).map(gappy).collect();
    let works: Vec<u64> = (0..1500).map(|n| 200 + bits(7, &[n]) % 6000).collect();
    let found = sound(&input(nodes.clone(), vec![job(1, None, &works)]));
    let mut longest_first: Vec<(i64, u64)> = (0..).zip(works).collect();
    longest_first.sort_unstable_by_key(|&(number, work)| (std::cmp::Reverse(work), number));
    let place = |b: &Booking| (b.start, b.node, b.task.frame().unwrap(), b.end);
    let places: Vec<_> = found.bookings.iter().map(place).collect();
    assert_eq!(places, one_by_one(&nodes, &longest_first));
}
