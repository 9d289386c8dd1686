//! What budgets call for, and what work under way will still cost.

use std::collections::BTreeMap;

use forelight_protocol::{
    Budget, BudgetAction, BudgetPeriod, BudgetThreshold, LedgerLine, Money, TaskKind, Timestamp,
};

/// The strongest action that this much spending calls for.
fn called_for(thresholds: &[BudgetThreshold], amount: Money, used: Money) -> Option<BudgetAction> {
    thresholds.iter().filter(|it| it.is_reached(amount, used)).map(|it| it.action).max()
}

/// The action that should be in force: what spent and committed money calls for, and at least what is in
/// force in this period already ([`Budget::action`]).
pub(crate) fn action(budget: &Budget) -> Option<BudgetAction> {
    let used = Money(budget.spent.0.saturating_add(budget.committed.0));
    called_for(&budget.thresholds, budget.amount, used).max(budget.action)
}

/// Whether `action` has to be written. `had` was written last, for the period that began at `period_at`.
pub(crate) fn is_news(
    budget: &Budget,
    action: Option<BudgetAction>,
    (had, period_at): (Option<BudgetAction>, Option<Timestamp>),
) -> bool {
    action != had || (had.is_some() && period_at != Some(budget.from))
}

/// The message of the event that an action comes into force; without an action, that a new period begins.
pub(crate) fn message(budget: &Budget, action: Option<BudgetAction>) -> String {
    let Budget { project, spent, committed, amount, .. } = budget;
    let period = budget.period.name();
    let what = match action {
        Some(BudgetAction::Warn) => "warning",
        Some(BudgetAction::Drain) => "nothing new is started",
        Some(BudgetAction::Stop) => "what runs is stopped",
        None => return format!("{project}: the budget's new {period} begins"),
    };
    format!("{project}: {spent} spent and {committed} committed of {amount} a {period}: {what}")
}

/// Such as `per night` or `in all`.
pub(crate) fn per(period: BudgetPeriod) -> String {
    match period {
        BudgetPeriod::Total => "in all".to_owned(),
        period => format!("per {}", period.name()),
    }
}

/// The strongest action in force for each project that has a budget.
pub(crate) fn strongest(
    budgets: impl IntoIterator<Item = (String, Option<BudgetAction>)>,
) -> BTreeMap<String, Option<BudgetAction>> {
    let mut found: BTreeMap<String, Option<BudgetAction>> = BTreeMap::new();
    for (project, action) in budgets {
        let strongest = found.entry(project).or_default();
        *strongest = (*strongest).max(action);
    }
    found
}

/// A quarter of an hour, in microseconds.
pub(crate) const QUARTER: i64 = 900_000_000;

/// An ended ledger line by quarters of an hour: where each begins, what it cost, and its node time in
/// microseconds. The sums are those of the line.
pub(crate) fn by_quarter(line: &LedgerLine) -> Vec<(Timestamp, Money, i64)> {
    let Some(end) = line.until else { return Vec::new() };
    let (mut quarters, mut from, mut before) = (Vec::new(), line.from, Money(0));
    while from < end {
        let begin = from.micros().div_euclid(QUARTER).saturating_mul(QUARTER);
        let until = Timestamp::from_micros(begin.saturating_add(QUARTER)).min(end);
        // Parts are rounded so that they add up to the whole.
        let so_far = line.cost_within(line.from, until);
        let cost = Money(so_far.0.saturating_sub(before.0));
        quarters.push((Timestamp::from_micros(begin), cost, until.micros_since(from)));
        (from, before) = (until, so_far);
    }
    quarters
}

/// What these ledger lines cost since an instant, as far as each is paid.
pub(crate) fn cost_since<'a>(lines: impl IntoIterator<Item = &'a LedgerLine>, from: Timestamp) -> Money {
    lines.into_iter().fold(Money(0), |sum, line| Money(sum.0.saturating_add(paid(line, from).0)))
}

fn paid(line: &LedgerLine, from: Timestamp) -> Money {
    line.until.map_or(Money(0), |until| line.cost_within(from, until))
}

/// Microseconds that so many CPU seconds at speed 1 take. `speed` is that of all cores of the node together.
pub(crate) fn frame_time(cpu_seconds: f64, speed: f64) -> i64 {
    (cpu_seconds / speed * 1e6) as i64
}

/// What a frame that is being rendered is expected to cost from now on, if it takes `whole` microseconds.
pub(crate) fn committed(line: &LedgerLine, whole: i64, now: Timestamp) -> Money {
    let left = whole.saturating_sub(now.micros_since(line.from)).max(0);
    line.price_per_hour.for_micros_at_hourly_rate(left)
}

/// A line of the ledger with the task that it paid for.
#[derive(Clone, PartialEq, Debug)]
pub(crate) struct Payment {
    pub line: LedgerLine,
    pub kind: TaskKind,
    pub frame: Option<u32>,
    /// The part of the frame, or of a cache.
    pub part: Option<u32>,
    /// Whether the lease goes on.
    pub is_active: bool,
}

/// What a job has cost, and what work under way will still cost: the rest of the bookings of frames that are
/// with a worker, and of the shared cache. Bookings are costs in micro-units, by frame and part.
pub(crate) fn spent_and_under_way(
    payments: &[Payment],
    booked: &BTreeMap<(u32, u32), i64>,
    booked_cache: i64,
) -> Money {
    let (mut spent, mut on_cache, mut left) = (0i64, 0i64, 0i64);
    for Payment { line, kind, frame, part, is_active } in payments {
        let paid = paid(line, line.from).0;
        spent = spent.saturating_add(paid);
        match kind {
            TaskKind::CacheFill | TaskKind::CacheMerge => on_cache = on_cache.saturating_add(paid),
            TaskKind::Render | TaskKind::RenderPart if *is_active => {
                let place = frame.map(|frame| (frame, part.unwrap_or(0)));
                let booked = place.and_then(|place| booked.get(&place).copied()).unwrap_or_default();
                left = left.saturating_add(booked.saturating_sub(paid).max(0));
            }
            _ => {}
        }
    }
    left = left.saturating_add(booked_cache.saturating_sub(on_cache).max(0));
    Money(spent.saturating_add(left))
}

#[cfg(test)]
mod tests {
    use forelight_protocol::{JobId, NodeId};

    use super::*;

    const HOUR: i64 = 3_600_000_000;

    fn at(micros: i64) -> Timestamp {
        Timestamp::from_micros(micros)
    }

    fn line(from: i64, until: Option<i64>) -> LedgerLine {
        LedgerLine {
            project: "film".to_owned(),
            of: Some((JobId::new(), NodeId::new())),
            price_per_hour: Money(100),
            from: at(from),
            until: until.map(at),
        }
    }

    fn budget(spent: i64, action: Option<BudgetAction>) -> Budget {
        Budget {
            project: "film".to_owned(),
            period: BudgetPeriod::Night,
            amount: Money(1000),
            zone: "UTC".to_owned(),
            thresholds: vec![BudgetThreshold { percent: 80, action: BudgetAction::Warn }],
            from: at(0),
            until: at(1),
            spent: Money(spent),
            committed: Money(0),
            action,
            updated_at: at(0),
        }
    }

    #[test]
    fn quarters_of_a_line_add_up_to_it() {
        let line = line(HOUR / 6, Some(HOUR + 7));
        let quarters = by_quarter(&line);
        let begins: Vec<i64> = quarters.iter().map(|(begin, ..)| begin.micros() / QUARTER).collect();
        assert_eq!(begins, [0, 1, 2, 3, 4]);
        let (cost, used) =
            quarters.iter().fold((0, 0), |(cost, used), part| (cost + part.1.0, used + part.2));
        assert_eq!(cost, line.cost_within(at(i64::MIN), at(i64::MAX)).0);
        assert_eq!(used, HOUR - HOUR / 6 + 7);
        assert_eq!(by_quarter(&self::line(0, None)), []);
    }

    #[test]
    fn the_strongest_action_whose_share_is_reached_is_called_for() {
        let at = |percent, action| BudgetThreshold { percent, action };
        let thresholds =
            [at(120, BudgetAction::Stop), at(80, BudgetAction::Warn), at(100, BudgetAction::Drain)];
        let found = |used| called_for(&thresholds, Money(1000), Money(used));
        assert_eq!(found(799), None);
        assert_eq!(found(800), Some(BudgetAction::Warn));
        assert_eq!(found(1000), Some(BudgetAction::Drain));
        assert_eq!(found(1_000_000), Some(BudgetAction::Stop));
        // Any spending exceeds a budget of nothing; no spending does not.
        assert_eq!(called_for(&thresholds, Money(0), Money(0)), None);
        assert_eq!(called_for(&thresholds, Money(0), Money(1)), Some(BudgetAction::Stop));
    }

    #[test]
    fn an_action_stays_in_force_within_its_period() {
        let (warn, stop) = (Some(BudgetAction::Warn), Some(BudgetAction::Stop));
        assert_eq!(action(&budget(900, None)), warn);
        assert_eq!(action(&budget(0, stop)), stop);
        assert!(is_news(&budget(900, None), warn, (None, None)));
        assert!(!is_news(&budget(900, warn), warn, (warn, Some(at(0)))));
        assert!(is_news(&budget(900, warn), warn, (warn, Some(at(-5)))), "a new period");
    }

    #[test]
    fn the_strongest_action_of_a_projects_budgets_counts() {
        let of = |project: &str, action| (project.to_owned(), action);
        let found = strongest([
            of("film", Some(BudgetAction::Warn)),
            of("film", Some(BudgetAction::Stop)),
            of("film", None),
            of("spot", None),
        ]);
        assert_eq!((found["film"], found["spot"]), (Some(BudgetAction::Stop), None));
    }

    #[test]
    fn a_frame_commits_what_is_left_of_its_median_and_nothing_once_it_is_late() {
        // Two hours of CPU time at twice the speed.
        let after = |hours: i64| committed(&line(0, None), frame_time(7200.0, 2.0), at(hours * HOUR));
        assert_eq!((after(0), after(1), after(5)), (Money(100), Money(0), Money(0)));
    }

    #[test]
    fn what_is_under_way_counts_with_the_rest_of_its_booking() {
        let payment = |kind, frame: Option<u32>, is_active| {
            let line = line(0, Some(HOUR));
            Payment { line, kind, frame, part: None, is_active }
        };
        let payments = [
            payment(TaskKind::Profile, Some(3), false),
            payment(TaskKind::Render, Some(3), true),
            payment(TaskKind::CacheFill, None, false),
        ];
        let booked = BTreeMap::from([((3, 0), 250), ((4, 0), 1000)]);
        // 300 are paid; 150 are left of frame 3's booking and 50 of the cache's.
        assert_eq!(spent_and_under_way(&payments, &booked, 150), Money(500));
        assert_eq!(spent_and_under_way(&payments, &booked, 20), Money(450));
        assert_eq!(cost_since([&line(0, Some(HOUR))], at(HOUR / 2)), Money(50));
    }
}
