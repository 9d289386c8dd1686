//! An independent check of plans.
//!
//! It uses only the types of `model` and the inequality in `proof.rs`, and knows nothing of how plans are
//! made.

mod jobs;
mod nodes;
mod violation;

use std::collections::{BTreeMap, BTreeSet};

use self::jobs::{beats, check_job};
use self::nodes::{check_node, check_rentals};
pub use self::violation::Violation;
use crate::model::{Booking, Input, Job, JobPlan, Node, Plan, Rental, Verdict};
use crate::proof::{Counted, value};

/// Checks a plan against its input.
///
/// Every frame is booked once, for as long as its work takes, alone on a node that can render it. It lies in
/// the node's free time, after the release and the shared cache. Every booking is paid for. Verdicts, costs,
/// bounds and proofs agree with the bookings.
///
/// # Errors
/// All violations.
pub fn verify(input: &Input, plan: &Plan) -> Result<(), Vec<Violation>> {
    if let Err(error) = input.check() {
        return Err(vec![error.into()]);
    }
    let nodes: BTreeMap<u64, &Node> = input.nodes.iter().map(|node| (node.id, node)).collect();
    let mut by_node: BTreeMap<u64, (Vec<Booking>, Vec<Rental>)> = BTreeMap::new();
    let mut by_job: BTreeMap<u64, Vec<Booking>> = BTreeMap::new();
    for &booking in &plan.bookings {
        by_node.entry(booking.node).or_default().0.push(booking);
        by_job.entry(booking.job).or_default().push(booking);
    }
    for &rental in &plan.rentals {
        by_node.entry(rental.node).or_default().1.push(rental);
    }
    let mut fixed: BTreeMap<u64, Vec<(i64, i64)>> = BTreeMap::new();
    for booking in input.fixed.iter().filter(|booking| booking.start < booking.end) {
        fixed.entry(booking.node).or_default().push((booking.start, booking.end));
    }
    let mut found = Vec::new();

    let mut costs: BTreeMap<u64, i128> = BTreeMap::new();
    for (id, (mut bookings, rentals)) in by_node {
        let Some(node) = nodes.get(&id) else {
            found.extend(bookings.into_iter().map(Violation::Unknown));
            found.extend(
                rentals
                    .into_iter()
                    .map(|rental| Violation::Rental { rental, wrong: "is on a node that does not exist" }),
            );
            continue;
        };
        bookings.sort_unstable();
        let fixed = fixed.remove(&id).unwrap_or_default();
        check_node(input, node, &bookings, &fixed, &mut found);
        check_rentals(input, node, &bookings, rentals, &fixed, &mut costs, &mut found);
    }
    let mut ends = Some(i64::MIN);
    for job in &input.jobs {
        let bookings = by_job.remove(&job.id).unwrap_or_default();
        let verdicts: Vec<&JobPlan> = plan.jobs.iter().filter(|entry| entry.job == job.id).collect();
        let cost = costs.get(&job.id).copied().unwrap_or(0);
        match verdicts[..] {
            [entry] => {
                let end = check_job(&nodes, input, job, entry, &bookings, cost, &mut found);
                ends = ends.zip(end).map(|(a, b)| a.max(b));
            }
            _ => found.push(Violation::Verdicts { job: job.id, verdicts: verdicts.len() }),
        }
    }
    found.extend(by_job.into_values().flatten().map(Violation::Unknown));
    let known: BTreeSet<u64> = input.jobs.iter().map(|job| job.id).collect();
    let strangers = plan.jobs.iter().filter(|entry| !known.contains(&entry.job));
    found.extend(strangers.map(|entry| Violation::UnknownJob { job: entry.job }));
    if !input.jobs.is_empty() && ends.is_some_and(|end| beats(end, plan.bound)) {
        found.push(Violation::Bound { job: None });
    }
    check_costs(input, plan, &mut found);
    if found.is_empty() { Ok(()) } else { Err(found) }
}

/// The costs add up, and the cost bound is proven.
fn check_costs(input: &Input, plan: &Plan, found: &mut Vec<Violation>) {
    let total = plan.rentals.iter().fold(0i64, |sum, rental| sum.saturating_add(rental.cost));
    if total != plan.cost {
        found.push(Violation::TotalCost { stated: plan.cost, found: total });
    }
    let verdicts: BTreeMap<u64, &Verdict> =
        plan.jobs.iter().map(|entry| (entry.job, &entry.verdict)).collect();
    let counted = |job: &Job| match (verdicts.get(&job.id), job.deadline) {
        (Some(Verdict::Feasible { .. }), Some(deadline)) => Counted::By(deadline),
        (None | Some(Verdict::Unplaced { .. }), _) => Counted::Not,
        _ => Counted::Whenever,
    };
    let proven = value(input, &plan.proof, true, counted).max(0);
    let proven = i64::try_from(proven).unwrap_or(i64::MAX);
    if plan.cost_bound != proven || plan.cost < proven {
        found.push(Violation::CostBound { stated: plan.cost_bound, found: proven, cost: plan.cost });
    }
    if let Some(infeasible) = &plan.infeasible {
        let by = |job: &Job| job.deadline.map_or(Counted::Not, Counted::By);
        if value(input, &infeasible.proof, false, by) <= 0 {
            found.push(Violation::Infeasible);
        }
    }
}
