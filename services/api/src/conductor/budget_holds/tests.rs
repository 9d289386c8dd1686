//! Farms of one node whose bookings last an hour and cost 1 each.

use forelight_protocol::{JobId, Verdict};

use super::*;
use crate::conductor::farm::Snapshot;
use crate::conductor::made_up::{at, booking, farm_job, job_id, node, snapshot, waiting};
use crate::conductor::settle::settle;

const HOUR: i64 = 3600;
const ONE: i64 = 1_000_000;

fn threshold(percent: u32, action: BudgetAction) -> BudgetThreshold {
    BudgetThreshold { percent, action }
}

/// The night's budget of the project, of which so much is spent. The night ends 18 hours from now.
fn budget(amount: i64, spent: i64) -> Budget {
    let (from, until) = BudgetPeriod::Night.bounds("UTC", at(0)).unwrap();
    assert_eq!(until, at(18 * HOUR));
    Budget {
        project: "film".to_owned(),
        period: BudgetPeriod::Night,
        amount: Money(amount),
        zone: "UTC".to_owned(),
        thresholds: vec![threshold(80, BudgetAction::Warn), threshold(100, BudgetAction::Drain)],
        from,
        until,
        spent: Money(spent),
        committed: Money(0),
        action: None,
        updated_at: at(0),
    }
}

fn in_all(amount: i64) -> Budget {
    let (from, until) = BudgetPeriod::Total.bounds("UTC", at(0)).unwrap();
    Budget { period: BudgetPeriod::Total, from, until, ..budget(amount, 0) }
}

/// A job of four frames, the first of which starts now. The next starts after so many hours, and so on.
fn farm(budgets: Vec<Budget>, every: i64) -> Snapshot {
    let hours = |frame: u32| HOUR * every * i64::from(frame);
    let one = |frame| waiting(booking(job_id(1), frame, 1, (hours(frame), hours(frame) + HOUR)));
    let open: Vec<_> = (0..4).map(one).collect();
    let nodes = vec![node(1, ONE, 1000, serde_json::Value::Null)];
    Snapshot { budgets, ..snapshot(nodes, vec![farm_job(job_id(1), &open)], &open, &[]) }
}

fn found(snapshot: &Snapshot) -> Option<BudgetHold> {
    let farm = Farm::new(snapshot);
    let plan = planner::Plan { bookings: farm.standing.clone(), ..planner::Plan::default() };
    budget_holds(&farm, &plan, &farm.input.fixed).swap_remove(0)
}

/// From when, how many frames, and how much is missing, in hundredths.
fn in_short(snapshot: &Snapshot) -> Option<(Timestamp, u32, i64)> {
    found(snapshot).map(|hold| (hold.from, hold.frames, (hold.missing.0 - 1) / (ONE / 100)))
}

#[test]
fn frames_that_are_booked_after_the_money_is_spent_wait_for_the_next_period() {
    assert_eq!(in_short(&farm(vec![budget(5 * ONE, 0)], 1)), None);
    // The frame with which the whole is reached is still started.
    assert_eq!(in_short(&farm(vec![budget(4 * ONE, 0)], 1)), None);
    assert_eq!(in_short(&farm(vec![budget(2 * ONE, 0)], 1)), Some((at(HOUR), 2, 200)));
    assert_eq!(in_short(&farm(vec![budget(5 * ONE, 3 * ONE)], 1)), Some((at(HOUR), 2, 200)));
    let told = found(&farm(vec![budget(2 * ONE, 0)], 1)).unwrap();
    assert_eq!(told.until, Some(at(18 * HOUR)));
    // What waits is done in the next period, in as much time as it is booked for.
    assert_eq!([4, 30].map(|hours| told.end(at(hours * HOUR))), [Some(at(21 * HOUR)), Some(at(47 * HOUR))]);
    assert_eq!(
        told.because,
        "the budget of project film lasts until about 2026-03-01T19:00:00.000000Z: 2 frames wait until \
         2026-03-02T12:00:00.000000Z, or until it is raised by 2.00"
    );
}

#[test]
fn thresholds_say_when_it_holds_and_whether_running_frames_are_stopped() {
    let with = |thresholds| farm(vec![Budget { thresholds, ..budget(2 * ONE, 0) }], 1);
    assert_eq!(in_short(&with(vec![threshold(80, BudgetAction::Warn)])), None);
    // A frame is committed when it starts, and stopped at once.
    assert_eq!(in_short(&with(vec![threshold(100, BudgetAction::Stop)])), Some((at(HOUR), 3, 200)));
    let both = vec![threshold(100, BudgetAction::Drain), threshold(50, BudgetAction::Drain)];
    assert_eq!(in_short(&with(both)), Some((at(0), 3, 600)));
}

#[test]
fn the_next_period_has_its_own_money() {
    // Two frames this night, two the next.
    assert_eq!(in_short(&farm(vec![budget(2 * ONE, 0)], 12)), None);
    assert_eq!(in_short(&farm(vec![budget(ONE, 0)], 12)), Some((at(0), 1, 100)));
    // What was spent before noon is spent: the second night is the one that runs short.
    let tonight_ends = Budget { until: at(HOUR), ..budget(2 * ONE, 0) };
    let short = in_short(&farm(vec![tonight_ends], 1));
    assert_eq!(short, Some((at(2 * HOUR), 1, 100)));
}

#[test]
fn of_several_budgets_the_first_to_run_short_holds() {
    let hold = found(&farm(vec![budget(3 * ONE, 0), in_all(2 * ONE)], 1)).unwrap();
    assert_eq!((hold.period, hold.from, hold.until), (BudgetPeriod::Total, at(HOUR), None));
    assert_eq!(hold.end(at(4 * HOUR)), None);
    assert!(hold.because.ends_with("2 frames wait until it is raised by 2.00"), "{}", hold.because);
    // Nothing is booked before the end of a night whose money is spent.
    let spent = Budget { action: Some(BudgetAction::Drain), until: at(0), ..budget(ONE, ONE) };
    let short = spent.until;
    let hold = found(&farm(vec![spent, in_all(2 * ONE)], 1)).unwrap();
    assert_eq!((hold.period, short), (BudgetPeriod::Total, at(0)));
    // At the same time, the longer hold counts.
    let hold = found(&farm(vec![budget(2 * ONE, 0), in_all(2 * ONE)], 1)).unwrap();
    assert_eq!(hold.period, BudgetPeriod::Total);
}

#[test]
fn a_budget_that_holds_already_holds_a_new_quote_at_once() {
    let used_up = Budget { action: Some(BudgetAction::Drain), ..budget(2 * ONE, 2 * ONE) };
    let hold = found(&farm(vec![used_up.clone()], 1)).unwrap();
    assert_eq!((hold.from, hold.frames), (at(0), 4));
    assert!(hold.because.starts_with("the budget of project film is used up: 4 frames wait"));
    // However little is missing.
    let nearly = Budget { action: Some(BudgetAction::Drain), ..budget(1000 * ONE, 1000 * ONE) };
    assert_eq!(found(&farm(vec![nearly], 1)).map(|hold| hold.frames), Some(4));
    // A job that is held is told so already, and pays nothing.
    let mut held = farm(vec![used_up], 1);
    held.jobs[0].held = true;
    assert_eq!(found(&held), None);
}

#[test]
fn a_hold_that_is_less_than_a_hundredth_is_no_news() {
    let nearly = || farm(vec![budget(1000 * ONE, 998 * ONE)], 1);
    assert_eq!(in_short(&nearly()), None);
    let mut known = nearly();
    known.jobs[0].job.budget_hold = found(&farm(vec![budget(2 * ONE, 0)], 1));
    assert!(in_short(&known).is_some());
}

#[test]
fn no_deadline_is_promised_that_a_budget_will_break() {
    let said = |amount: i64, deadline: Option<i64>, period: fn(i64) -> Budget| {
        let mut snapshot = farm(vec![period(amount)], 1);
        snapshot.jobs[0].job.deadline = deadline.map(at);
        let farm = Farm::new(&snapshot);
        let settled = settle(&farm, Some(0)).unwrap();
        let (_, outlook) = &settled.outlooks[0];
        let promised = outlook.promise.as_ref().map(|promise| promise.kept);
        (settled.jobs[0].verdict.verdict, settled.jobs[0].verdict.finish, promised, outlook.probability)
    };
    let of_night = |amount| budget(amount, 0);
    let end = Some(at(4 * HOUR));
    assert_eq!(said(5 * ONE, Some(5 * HOUR), of_night), (Verdict::OnTime, end, Some(true), Some(1.0)));
    let next_night = Some(at(21 * HOUR));
    assert_eq!(said(2 * ONE, Some(5 * HOUR), of_night), (Verdict::Late, next_night, None, Some(0.0)));
    // Time enough for the next night's money.
    assert_eq!(said(2 * ONE, Some(40 * HOUR), of_night).0, Verdict::OnTime);
    assert_eq!(said(2 * ONE, Some(5 * HOUR), in_all), (Verdict::Late, None, None, Some(0.0)));
    assert_eq!(said(2 * ONE, None, in_all), (Verdict::OverBudget, None, None, None));
    assert_eq!(said(2 * ONE, None, of_night), (Verdict::OnTime, next_night, None, None));
}

#[test]
fn a_promise_that_the_budget_will_break_is_at_risk() {
    let mut snapshot = farm(vec![budget(2 * ONE, 0)], 1);
    let job: &mut forelight_protocol::Job = &mut snapshot.jobs[0].job;
    job.deadline = Some(at(5 * HOUR));
    let id: JobId = job.id;
    job.promise = Some(forelight_protocol::Promise {
        kept: true,
        probability: 1.0,
        finish: Some(at(4 * HOUR)),
        since: at(0),
        rescue: None,
    });
    let settled = settle(&Farm::new(&snapshot), None).unwrap();
    let (of, outlook) = &settled.outlooks[0];
    let promise = outlook.promise.as_ref().unwrap();
    assert_eq!((*of, promise.kept, promise.probability), (id, false, 0.0));
    assert_eq!(settled.jobs[0].verdict.verdict, Verdict::Late);
    assert_eq!(
        settled.jobs[0].verdict.reasons,
        ["the budget of project film does not last for all of its frames"]
    );
    assert!(settled.jobs[0].verdict.ways_out.is_empty());
}
