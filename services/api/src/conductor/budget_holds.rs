//! What the budgets of projects will hold back of their jobs, by all that is booked. Pure.
//!
//! Bookings are paid for in the order of their starts, on top of what is spent and committed. Once that reaches
//! the share of a budget at which nothing new is started, what is booked later waits for the next period. Only
//! the first hold of each project is told: what waits for it changes all that follows.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};

use forelight_planner as planner;
use forelight_planner::FixedBooking;
use forelight_protocol::{Budget, BudgetAction, BudgetHold, BudgetPeriod, BudgetThreshold, Money, Timestamp};

use super::farm::Farm;
use super::numbers::frame_part;

/// A new hold is told only from this share of the budget on, in per cent. So forecasts that vary a little do
/// not make promises come and go.
const NEWS: i64 = 1;

/// What is booked and will be paid for.
struct Payment {
    job: usize,
    /// `None` for shared caches, and for frames of jobs that this plan is not about.
    frame: Option<u32>,
    start: i64,
    end: i64,
    cost: i64,
}

/// A budget that runs out.
struct Shortfall<'a> {
    budget: &'a Budget,
    /// Whether it is used up already.
    in_force: bool,
    stops_running: bool,
    from: i64,
    until: i64,
    missing: i64,
}

/// By job, what the budgets of its project will hold back of it. `fixed` is booked besides the plan.
pub(crate) fn budget_holds(
    farm: &Farm,
    plan: &planner::Plan,
    fixed: &[FixedBooking],
) -> Vec<Option<BudgetHold>> {
    let mut found = vec![None; farm.jobs.len()];
    let mut payments = payments(farm, plan, fixed);
    for (project, budgets) in by_project(&farm.budgets) {
        let Some(payments) = payments.get_mut(project) else { continue };
        payments.sort_by_key(|payment| (payment.start, payment.job, payment.frame));
        let short = budgets.iter().filter_map(|budget| shortfall(budget, payments, farm.input.now));
        let holding =
            short.map(|short| (held_frames(&short, payments), short)).filter(|(held, _)| !held.is_empty());
        let first = holding.min_by_key(|(_, short)| (short.from, Reverse(short.until)));
        let Some((held, first)) = first else { continue };
        for (job, frames) in held {
            let is_known = farm.jobs[job].job.budget_hold.is_some();
            let is_news =
                i128::from(first.missing) * 100 >= i128::from(first.budget.amount.0) * i128::from(NEWS);
            if is_known || is_news || first.in_force {
                found[job] = Some(hold(&first, frames.len()));
            }
        }
    }
    found
}

fn by_project(budgets: &[Budget]) -> BTreeMap<&str, Vec<&Budget>> {
    let mut of_project: BTreeMap<&str, Vec<&Budget>> = BTreeMap::new();
    for budget in budgets {
        of_project.entry(&budget.project).or_default().push(budget);
    }
    of_project
}

/// What is to be paid by projects that have a budget. Jobs that are held already pay nothing.
fn payments<'a>(
    farm: &'a Farm,
    plan: &planner::Plan,
    fixed: &[FixedBooking],
) -> BTreeMap<&'a str, Vec<Payment>> {
    let now = farm.input.now;
    let mut found: BTreeMap<&str, Vec<Payment>> =
        farm.budgets.iter().map(|budget| (budget.project.as_str(), Vec::new())).collect();
    if found.is_empty() {
        return found;
    }
    // What is under way is committed already.
    let others = fixed.iter().filter(|booking| booking.start >= now);
    let others = others.filter_map(|it| Some((it.node, it.job?, None, it.start, it.end)));
    let planned = plan.bookings.iter();
    let planned =
        planned.map(|it| (it.node, it.job, frame_part(it.task).map(|part| part.frame), it.start, it.end));
    for (node, job, frame, start, end) in planned.chain(others) {
        let (job, node) = (job as usize, node as usize);
        let (Some(asked), Some(node)) = (farm.jobs.get(job), farm.nodes.get(node)) else { continue };
        if let Some(payments) = found.get_mut(asked.job.project.as_str()).filter(|_| !asked.held) {
            let cost = node.price_per_hour.for_micros_at_hourly_rate(end.saturating_sub(start)).0;
            payments.push(Payment { job, frame, start, end, cost });
        }
    }
    found
}

/// The first time at which a budget will hold its project, if it will.
fn shortfall<'a>(budget: &'a Budget, payments: &[Payment], now: i64) -> Option<Shortfall<'a>> {
    let holds = budget.thresholds.iter().filter(|it| it.action > BudgetAction::Warn);
    let first = holds.min_by_key(|it| (it.percent, Reverse(it.action)))?;
    let in_force = budget.action > Some(BudgetAction::Warn);
    let mut used = budget.spent.0.saturating_add(budget.committed.0);
    let mut until = budget.until.micros();
    let mut from = in_force.then_some(now);
    for payment in payments {
        if payment.start >= until {
            if from.is_some() {
                break;
            }
            let begins = Timestamp::from_micros(payment.start);
            (until, used) = (budget.period.bounds(&budget.zone, begins)?.1.micros(), 0);
        }
        used = used.saturating_add(payment.cost);
        if from.is_none() && first.is_reached(budget.amount, Money(used)) {
            from = Some(payment.start);
        }
    }
    let missing = enough(*first, used).saturating_sub(budget.amount.0).max(0);
    let stops_running = in_force || first.action == BudgetAction::Stop;
    Some(Shortfall { budget, in_force, stops_running, from: from?, until, missing })
}

/// The smallest amount whose share is not reached by what is used.
fn enough(threshold: BudgetThreshold, used: i64) -> i64 {
    let exact = i128::from(used) * 100 / i128::from(threshold.percent.max(1)) + 1;
    i64::try_from(exact).unwrap_or(i64::MAX)
}

/// By job, the frames that the budget will hold.
fn held_frames(short: &Shortfall, payments: &[Payment]) -> BTreeMap<usize, BTreeSet<u32>> {
    let mut held: BTreeMap<usize, BTreeSet<u32>> = BTreeMap::new();
    let waits = |payment: &&Payment| {
        let is_stopped = short.stops_running && payment.end > short.from;
        payment.start < short.until && (payment.start > short.from || is_stopped)
    };
    for payment in payments.iter().filter(waits) {
        if let Some(frame) = payment.frame {
            held.entry(payment.job).or_default().insert(frame);
        }
    }
    held
}

fn hold(short: &Shortfall, frames: usize) -> BudgetHold {
    let budget = short.budget;
    let from = Timestamp::from_micros(short.from);
    let until = (budget.period != BudgetPeriod::Total).then(|| Timestamp::from_micros(short.until));
    let project = &budget.project;
    let lasts = if short.in_force {
        format!("the budget of project {project} is used up")
    } else {
        format!("the budget of project {project} lasts until about {from}")
    };
    let frames_wait = if frames == 1 { "1 frame waits".to_owned() } else { format!("{frames} frames wait") };
    let missing = Money(short.missing);
    let next = until.map_or(String::new(), |until| format!("until {until}, or "));
    BudgetHold {
        period: budget.period,
        from,
        until,
        frames: u32::try_from(frames).unwrap_or(u32::MAX),
        missing,
        because: format!("{lasts}: {frames_wait} {next}until it is raised by {missing}"),
    }
}

#[cfg(test)]
mod tests;
