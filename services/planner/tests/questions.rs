//! Questions about plans, on farms with known answers.

use std::sync::Arc;

use forelight_planner::{
    Booking, Change, Confidence, Event, FixedBooking, Frame, Input, Interval, Job, Node, Plan, Precedence,
    Project, Reason, SharedCache, Task, Usage, Verdict, WorkTotal, curve, difference, earliest_for_budget,
    explain, outlook, plan, replan, simulate, verify, ways_out, what_if,
};

const HOUR: i64 = 3_600_000_000;

/// One unit of work is an hour at speed one.
fn node(id: u64, speed: u64, price: i64) -> Node {
    Node {
        id,
        name: format!("node-{id}"),
        speed,
        price_per_hour: price,
        calendar: vec![Interval { start: 0, end: None }],
        ..Node::default()
    }
}

fn job(id: u64, deadline: Option<i64>, hours: &[u64]) -> Job {
    let total = hours.iter().sum::<u64>() * 3600;
    Job {
        id,
        deadline: deadline.map(|hours| hours * HOUR),
        confidence: Confidence::P50,
        total: WorkTotal { p50: total, p80: total, p95: total },
        frames: (0..)
            .zip(hours)
            .map(|(number, &h)| Frame { number, work: h * 3600, ..Frame::default() })
            .collect(),
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
fn the_cheap_node_is_used_as_far_as_the_deadline_leaves_room() {
    let nodes = vec![node(1, 1, 1_000_000), node(2, 4, 8_000_000)];
    let cost = |deadline| sound(&input(nodes.clone(), vec![job(1, Some(deadline), &[1; 8])])).cost;
    assert_eq!(cost(8), 8_000_000, "all on the cheap node");
    assert_eq!(cost(4), 4_000_000 + 4 * 2_000_000, "half of it");
    assert_eq!(cost(2), 2_000_000 + 6 * 2_000_000);
}

#[test]
fn the_bound_of_a_plan_that_uses_all_cheap_time_is_its_cost() {
    let nodes = vec![node(1, 1, 1_000_000), node(2, 4, 8_000_000)];
    let found = sound(&input(nodes, vec![job(1, Some(4), &[1; 8])]));
    assert_eq!(found.cost_bound, found.cost);
    assert!(!found.proof.slots.is_empty());
}

#[test]
fn frames_wait_for_their_shared_cache() {
    let cached =
        Job { shared_cache: Some(SharedCache { class: 0, work: 3600, parts: 1 }), ..job(1, None, &[2, 2]) };
    let found = sound(&input(vec![node(1, 1, 0), node(2, 1, 0)], vec![cached]));
    assert_eq!(found.jobs[0].verdict, Verdict::NoDeadline { finish: 3 * HOUR });
    // In two parts, the shared cache occupies both nodes for half as long.
    let split =
        Job { shared_cache: Some(SharedCache { class: 0, work: 7200, parts: 2 }), ..job(1, None, &[2, 2]) };
    let split = sound(&input(vec![node(1, 1, 0), node(2, 1, 0)], vec![split]));
    assert_eq!(split.jobs[0].verdict, Verdict::NoDeadline { finish: 3 * HOUR });
    let parts = [0, 1].map(|part| Task::SharedCachePart { part, parts: 2 });
    let cache_parts: Vec<_> =
        split.bookings.iter().filter(|booking| booking.task.is_shared_cache()).collect();
    assert_eq!(cache_parts.iter().map(|booking| booking.task).collect::<Vec<_>>(), parts);
    assert!(
        cache_parts.iter().all(|booking| booking.end - booking.start == HOUR)
            && cache_parts[0].node != cache_parts[1].node
    );
}

#[test]
fn the_class_of_work_chooses_the_node() {
    let large = node(1, 1, 9_000_000);
    let fast = Node { speeds: Arc::new([(3, 0), (7, 10)].into()), ..node(2, 1, 1_000_000) };
    let heavy = Job { class: 3, ..job(1, Some(9), &[1]) };
    let special = Job { class: 7, ..job(2, Some(1), &[10]) };
    let found = sound(&input(vec![large, fast], vec![heavy, special]));
    let on: Vec<(u64, u64)> = found.bookings.iter().map(|booking| (booking.job, booking.node)).collect();
    assert!(on.contains(&(1, 1)) && on.contains(&(2, 2)));
}

#[test]
fn rented_hours_are_filled_before_another_is_begun() {
    let rented =
        |id| Node { billing_step: HOUR, setup: HOUR / 10, setup_cost: 500_000, ..node(id, 2, 4_000_000) };
    let found = sound(&input(vec![rented(1), rented(2)], vec![job(1, Some(9), &[1, 1, 1])]));
    assert_eq!(found.rentals.len(), 1, "{:?}", found.rentals);
    assert_eq!(found.cost, 2 * 4_000_000 + 500_000);
}

#[test]
fn when_it_cannot_be_done_the_plan_says_why_and_the_ways_out_are_priced() {
    let farm = input(vec![node(1, 1, 1_000_000)], vec![job(1, Some(4), &[1; 4]), job(2, Some(4), &[1; 2])]);
    let found = sound(&farm);
    let infeasible = found.infeasible.clone().expect("six hours do not fit into four");
    assert_eq!(infeasible.jobs, [1, 2]);
    assert_eq!(infeasible.short[0].nodes, [1]);
    let late = found.jobs.iter().find(|entry| !entry.verdict.is_kept()).expect("one is late").job;
    let ways = ways_out(&farm, late).expect("ways out");
    assert!(!ways.is_empty() && ways.len() <= 3);
    assert!(ways.iter().any(|way| matches!(way.change, Change::MoreNodes { .. })), "{ways:?}");
    for way in &ways {
        assert!(way.saved.contains(&late) || matches!(way.change, Change::MakeWay { .. }));
    }
    let mut untrue = found.clone();
    untrue.infeasible.as_mut().expect("it is").proof = Default::default();
    assert!(verify(&farm, &untrue).is_err(), "a proof that proves nothing");
}

#[test]
fn the_greater_priority_keeps_its_deadline() {
    let farm = |first: i32| {
        let one = Job { priority: first, ..job(1, Some(4), &[1; 4]) };
        input(vec![node(1, 1, 0)], vec![one, job(2, Some(4), &[1; 3])])
    };
    assert!(sound(&farm(1)).jobs[0].verdict.is_kept());
    assert!(sound(&farm(-1)).jobs[1].verdict.is_kept());
}

#[test]
fn more_confidence_costs_more_time_and_budgets_buy_deadlines() {
    let mut unsure = job(1, Some(6), &[1; 4]);
    unsure.total = WorkTotal { p50: 4 * 3600, p80: 6 * 3600, p95: 8 * 3600 };
    let farm = input(vec![node(1, 1, 1_000_000)], vec![unsure]);
    let kept: Vec<bool> =
        outlook(&farm, 1).expect("an outlook").iter().map(|line| line.verdict.is_kept()).collect();
    assert_eq!(kept, [true, true, false]);
    let two = input(vec![node(1, 1, 1_000_000), node(2, 4, 8_000_000)], vec![job(1, None, &[1; 8])]);
    let offer = |budget| earliest_for_budget(&two, 1, budget).expect("an answer").map(|offer| offer.deadline);
    assert_eq!(offer(7_999_999), None);
    let cheapest = offer(8_000_000).expect("the cheap node does it");
    let dearer = offer(12_000_000).expect("both");
    assert!(dearer < cheapest && cheapest <= 8 * HOUR + 60_000_000, "{dearer} {cheapest}");
}

#[test]
fn answers_about_a_job_agree_with_the_plan_that_others_make_way_for_it() {
    let with = |deadline, unsure: bool| {
        let mut hero = job(2, deadline, &[1; 4]);
        if unsure {
            hero.total = WorkTotal { p50: 4 * 3600, p80: 4 * 3600, p95: 8 * 3600 };
        }
        input(vec![node(1, 1, 1_000_000), node(2, 1, 1_000_000)], vec![job(1, None, &[1; 4]), hero])
    };
    let finishes = |farm: &Input| -> Vec<(bool, Option<i64>)> {
        let lines = outlook(farm, 2).expect("an outlook");
        lines.iter().map(|line| (line.verdict.is_kept(), line.verdict.finish())).collect()
    };
    let farm = with(Some(2), false);
    assert!(sound(&farm).jobs[1].verdict.is_kept());
    assert_eq!(finishes(&farm), [(true, Some(2 * HOUR)); 3]);
    assert_eq!(curve(&farm, 2, 5).expect("a curve")[0].deadline, 2 * HOUR);
    let offer = earliest_for_budget(&farm, 2, 4_000_000).expect("an answer");
    assert_eq!(offer.map(|offer| offer.deadline), Some(2 * HOUR));
    let least = |farm: &Input| curve(farm, 2, 5).expect("a curve")[0].deadline;
    assert_eq!(least(&with(None, false)), 2 * HOUR, "with a deadline, it would go first");
    // More work at P95 pushes the other further back.
    assert_eq!(finishes(&with(Some(4), true))[2], (true, Some(4 * HOUR)));
    // Without a deadline, both take turns.
    assert_eq!(finishes(&with(None, false))[0].1, sound(&with(None, false)).jobs[1].verdict.finish());
    // What a deadline reserves stays reserved.
    let mut promised = with(Some(4), false);
    promised.jobs[0].deadline = Some(2 * HOUR);
    assert_eq!(least(&promised), 4 * HOUR);
}

#[test]
fn a_job_waits_because_it_is_cheaper_only_if_it_could_start_and_keeps_its_deadline() {
    let reason = |farm: &Input, id: u64| {
        let waits = explain(farm, &sound(farm), |job| job == id).expect("reasons");
        waits.into_iter().next().map(|explanation| explanation.reason)
    };
    let from = |start: i64, node: Node| Node { calendar: vec![Interval { start, end: None }], ..node };
    // The cheap node opens later, and the dear one is free now.
    let both = |deadline| {
        input(vec![node(1, 1, 9_000_000), from(HOUR, node(2, 1, 1_000_000))], vec![job(1, deadline, &[1])])
    };
    assert_eq!(reason(&both(Some(3)), 1), Some(Reason::Cheaper));
    assert_eq!(reason(&both(None), 1), None, "it starts now");
    // The only node closes before a frame would end.
    let calendar = vec![Interval { start: 0, end: Some(HOUR / 6) }, Interval { start: 2 * HOUR, end: None }];
    let closing = Node { calendar, ..node(1, 1, 0) };
    let long = |deadline| input(vec![closing.clone()], vec![job(1, deadline, &[1])]);
    assert_eq!(reason(&long(Some(9)), 1), Some(Reason::NoRoom { until: 2 * HOUR }));
    assert_eq!(reason(&long(Some(1)), 1), Some(Reason::NoRoom { until: 2 * HOUR }));
    // The node is free until a fixed booking, of a job or of none.
    let mut until_fixed = input(vec![node(1, 1, 0)], vec![job(1, Some(9), &[1])]);
    until_fixed.fixed = vec![FixedBooking { node: 1, start: HOUR / 2, end: 3 * HOUR, job: None }];
    assert_eq!(reason(&until_fixed, 1), Some(Reason::NoRoom { until: 3 * HOUR }));
    until_fixed.fixed[0].job = Some(7);
    assert_eq!(reason(&until_fixed, 1), Some(Reason::Behind { jobs: vec![(7, Precedence::Fixed)] }));
    // A node that sleeps is set up first.
    let asleep = Node { setup: HOUR / 4, ..node(1, 1, 1_000_000) };
    let set_up = input(vec![asleep], vec![job(1, Some(9), &[1])]);
    assert_eq!(reason(&set_up, 1), Some(Reason::NoRoom { until: HOUR / 4 }));
    // A job without a deadline waits for the fast node, which ends it sooner.
    let fast = from(HOUR, node(2, 10, 0));
    let sooner = input(vec![node(1, 1, 0), fast.clone()], vec![job(1, None, &[5])]);
    assert_eq!(reason(&sooner, 1), Some(Reason::Sooner));
    let late = input(vec![node(1, 1, 0), fast], vec![job(1, Some(1), &[5])]);
    assert_eq!(reason(&late, 1), Some(Reason::Sooner), "it is late in every plan");
    // It waits three hours for another job. That it could start a minute earlier elsewhere is not why.
    let mut behind = input(vec![node(1, 1, 1_000_000)], vec![job(1, Some(3), &[3]), job(2, Some(9), &[1])]);
    behind.nodes.push(from(3 * HOUR - 60_000_000, node(2, 1, 9_000_000)));
    let others = vec![(1, Precedence::EarlierDeadline)];
    assert_eq!(reason(&behind, 2), Some(Reason::Behind { jobs: others }));
    let words =
        [Reason::NoRoom { until: 0 }, Reason::Sooner, Reason::Booked].map(|reason| reason.to_string());
    assert!(words.iter().all(|words| words.starts_with("waits because ")), "{words:?}");
}

#[test]
fn a_booking_that_stays_where_it_was_is_not_called_cheaper() {
    let farm = input(vec![node(1, 1, 0)], vec![job(1, None, &[1])]);
    let mut found = sound(&farm);
    (found.bookings[0].start, found.bookings[0].end) = (2 * HOUR, 3 * HOUR);
    let waits = explain(&farm, &found, |_| true).expect("reasons");
    assert_eq!(waits[0].reason, Reason::Booked);
}

#[test]
fn a_dead_nodes_frames_move_and_no_others() {
    let farm = input((0..4).map(|id| node(id, 1, 1_000_000)).collect(), vec![job(1, Some(6), &[1; 8])]);
    let old = sound(&farm);
    let event = Event::NodeDown { node: 2, from: HOUR, until: None };
    let new = replan(&farm, &old, &event).expect("a plan");
    assert_eq!(verify(&new.input, &new.plan), Ok(()));
    assert!(new.difference.moved.iter().all(|(before, _)| before.node == 2));
    assert!(new.at_risk.is_empty() && new.plan.parent == Some(old.id()));
    assert_eq!(new.difference, difference(&old, &new.plan));
    assert!(new.difference.to_string().contains("moved"));
}

#[test]
fn a_promise_that_breaks_comes_with_a_rescue() {
    let farm = input(vec![node(1, 1, 1_000_000), node(2, 1, 1_000_000)], vec![job(1, Some(4), &[1; 8])]);
    let old = sound(&farm);
    let new = replan(&farm, &old, &Event::NodeDown { node: 2, from: HOUR, until: None }).expect("a plan");
    assert_eq!(new.at_risk.len(), 1);
    let rescue = new.at_risk[0].rescue.clone().expect("a rescue");
    assert!(matches!(rescue.change, Change::MoreNodes { .. }) && rescue.finish <= 4 * HOUR, "{rescue:?}");
    let late = Event::Takes { job: 1, task: Task::Frame(0), until: 9 * HOUR };
    let new = replan(&farm, &old, &late).expect("a plan");
    assert_eq!(new.at_risk.iter().map(|risk| risk.job).collect::<Vec<_>>(), [1]);
}

#[test]
fn a_job_without_a_deadline_makes_way_for_one_that_would_be_late() {
    let farm = input(vec![node(1, 1, 0)], vec![job(1, None, &[1; 4])]);
    let old = sound(&farm);
    let new = replan(&farm, &old, &Event::JobAdded { job: Box::new(job(2, Some(2), &[2])) }).expect("a plan");
    assert_eq!(verify(&new.input, &new.plan), Ok(()));
    assert!(new.at_risk.is_empty() && new.plan.jobs[1].verdict.is_kept());
}

#[test]
fn of_jobs_without_a_deadline_the_greatest_priority_goes_first_and_others_move_no_more_than_that_takes() {
    let farm = input(vec![node(0, 1, 0), node(1, 1, 0)], vec![job(0, None, &[1, 1, 1, 1])]);
    let old = sound(&farm);
    // The first frames of the other job move to the end; its second pair stays.
    let urgent = Job { priority: 1, ..job(1, None, &[1, 1]) };
    let new = replan(&farm, &old, &Event::JobAdded { job: Box::new(urgent.clone()) }).expect("a plan");
    assert_eq!(verify(&new.input, &new.plan), Ok(()));
    assert_eq!(new.plan.job(1).unwrap().verdict.finish(), Some(HOUR));
    assert_eq!(new.plan.job(0).unwrap().verdict.finish(), Some(3 * HOUR));
    let moved = |booking: &&Booking| booking.job == 0 && !old.bookings.contains(booking);
    assert_eq!(new.plan.bookings.iter().filter(moved).count(), 2);
    // Of equal priority, nothing moves.
    let equal = Job { priority: 0, ..urgent };
    let new = replan(&farm, &old, &Event::JobAdded { job: Box::new(equal) }).expect("a plan");
    assert_eq!(new.plan.bookings.iter().filter(moved).count(), 0);
}

#[test]
fn when_a_job_is_withdrawn_another_makes_way_for_one_that_was_late() {
    let small = Node { speeds: Arc::new([(3, 0)].into()), ..node(1, 1, 1_000_000) };
    let large = Node { speeds: Arc::new([(2, 0)].into()), ..node(2, 1, 2_000_000) };
    // The first job fits on both nodes, the second only on the small one, the third only on the large one.
    let anywhere = Job { weight: 3, ..job(1, Some(2), &[2]) };
    let on_small = Job { class: 2, ..job(2, Some(3), &[2]) };
    let on_large = Job { class: 3, weight: 3, ..job(3, Some(2), &[2]) };
    let farm = input(vec![small, large], vec![anywhere, on_small, on_large]);
    let old = sound(&farm);
    assert!(matches!(old.jobs[1].verdict, Verdict::Late { by: HOUR, .. }), "{:?}", old.jobs);
    let new = replan(&farm, &old, &Event::JobRemoved { job: 3 }).expect("a plan");
    assert_eq!(verify(&new.input, &new.plan), Ok(()));
    assert!(new.plan.jobs.iter().all(|entry| entry.verdict.is_kept()) && new.at_risk.is_empty());
    let moved: Vec<(u64, u64)> = new.difference.moved.iter().map(|(_, now)| (now.job, now.node)).collect();
    assert_eq!(moved, [(1, 2), (2, 1)], "the first makes way, and keeps its own deadline");
}

#[test]
fn projects_take_turns_by_what_they_had_for_their_share() {
    let project = |id, share, hours: i64| Project {
        id,
        share,
        usage: vec![Usage { at: 0, time: hours * HOUR }],
        ..Project::default()
    };
    let of = |project, id| Job { project: Some(project), ..job(id, None, &[1; 6]) };
    let mut farm = input(vec![node(1, 1, 0)], vec![of(1, 1), of(2, 2)]);
    farm.projects = vec![project(1, 1, 0), project(2, 2, 0)];
    let first = |found: &Plan, count: usize| found.bookings.iter().take(count).filter(|b| b.job == 2).count();
    assert_eq!(first(&sound(&farm), 6), 4, "two thirds to the share of two");
    farm.projects = vec![project(1, 1, 0), project(2, 1, 3)];
    let found = sound(&farm);
    assert_eq!(first(&found, 3), 0, "the one that had three hours waits three hours");
    let waits = explain(&farm, &found, |_| true).expect("reasons");
    assert!(waits[0].reason.to_string().contains("share"), "{}", waits[0].reason);
    farm.now = 1000 * HOUR;
    farm.half_life = HOUR;
    assert_eq!(first(&sound(&farm), 2), 1, "after a thousand half-lives nothing is left of it");
}

#[test]
fn scenarios_are_late_as_often_as_the_quantile_says() {
    let mut unsure = job(1, Some(0), &[1; 50]);
    let p50 = 50 * 3600;
    unsure.total = WorkTotal { p50, p80: p50 * 6 / 5, p95: p50 * 3 / 2 };
    unsure.confidence = Confidence::P80;
    unsure.deadline = Some(60 * HOUR);
    let farm = input(vec![node(1, 1, 1_000_000)], vec![unsure]);
    let found = sound(&farm);
    let simulated = simulate(&farm, &found, 2000, 7).expect("a simulation");
    let late = simulated.jobs[0].probability(2000);
    assert!((late - 0.2).abs() < 0.04, "{late}");
    assert_eq!(simulate(&farm, &found, 2000, 7), Ok(simulated));
}

#[test]
fn the_parts_of_a_frame_that_was_divided_before_are_late_together() {
    // Each of four nodes has a part. Parts that vary on their own are hardly ever all in time.
    let nodes = || (1..=4).map(|id| node(id, 1, 0)).collect::<Vec<Node>>();
    let late = |part_of: Option<i64>| {
        let mut parts = job(1, Some(1), &[1; 4]);
        parts.deadline = Some(HOUR + HOUR / 10);
        for frame in &mut parts.frames {
            (frame.work_p80, frame.part_of) = (frame.work * 3 / 2, part_of);
        }
        let farm = input(nodes(), vec![parts]);
        simulate(&farm, &sound(&farm), 1000, 7).expect("a simulation").jobs[0].probability(1000)
    };
    let (together, alone) = (late(Some(5)), late(None));
    assert!((0.25..0.4).contains(&together) && alone > 0.7, "{together} {alone}");
}

#[test]
fn one_more_node_and_a_dead_one_have_their_price() {
    let farm = input(vec![node(1, 1, 1_000_000), node(2, 4, 8_000_000)], vec![job(1, Some(4), &[1; 8])]);
    let more = what_if(&farm, &Change::MoreNodes { like: 1, count: 1 }).expect("an effect");
    assert_eq!(more.added_cost, -4_000_000, "all eight on two cheap nodes");
    let gone = what_if(&farm, &Change::NodeGone { node: 2, from: 0 }).expect("an effect");
    assert_eq!(gone.broken, [1]);
    assert!(gone.moved()[&1] > 0 && gone.end(1) > Some(4 * HOUR), "{gone:?}");
    let later = what_if(&farm, &Change::Later { job: 1, by: 4 * HOUR }).expect("an effect");
    assert_eq!(later.added_cost, -4_000_000);
    let only = input(vec![node(1, 1, 1_000_000)], vec![job(1, Some(9), &[1])]);
    let nowhere = what_if(&only, &Change::NodeGone { node: 1, from: 0 }).expect("an effect");
    let never = (&nowhere.broken[..], nowhere.moved()[&1], nowhere.end(1));
    assert_eq!(never, (&[1][..], 0, None), "what has no end any more is moved, too");
}
