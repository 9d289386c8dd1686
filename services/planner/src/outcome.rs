//! Turns a finished schedule into a plan.

use std::collections::BTreeMap;

use crate::admission::Admission;
use crate::model::{Booking, Bound, Input, Job, JobPlan, Plan, PlanId, Proof, Rental, Verdict};
use crate::proof::{Counted, value};
use crate::rental::shares;
use crate::state::State;

pub(crate) fn plan(
    state: &State,
    admission: &Admission,
    bounds: Vec<Bound>,
    bound: Bound,
    parent: Option<PlanId>,
) -> Plan {
    let problem = state.problem;
    let mut bookings: Vec<Booking> = Vec::new();
    for (job, placed) in state.placed.iter().enumerate() {
        bookings.extend(placed.iter().map(|placed| state.booking(job, placed)));
    }
    bookings.sort_unstable();
    let (rentals, costs) = rentals_and_costs(state);
    let jobs: Vec<JobPlan> = problem
        .jobs
        .iter()
        .zip(bounds)
        .enumerate()
        .map(|(index, (work, bound))| {
            let cost = costs[index];
            JobPlan {
                job: work.job.id,
                verdict: verdict(state, index, bound),
                cost,
                within_budget: work.job.budget.map(|budget| cost <= budget),
                bound,
            }
        })
        .collect();
    let cost = rentals.iter().fold(0i64, |sum, rental| sum.saturating_add(rental.cost));
    let (cost_bound, proof) = cost_bound(problem.input, &jobs, &admission.proof);
    let infeasible = admission.infeasible.clone();
    Plan { parent, bookings, rentals, jobs, cost, bound, cost_bound, proof, infeasible }
}

/// All rentals, and by job its part of their cost, in proportion to its time in them.
fn rentals_and_costs(state: &State) -> (Vec<Rental>, Vec<i64>) {
    // By node: start, end and job of each booking.
    let mut by_node: Vec<Vec<(i64, i64, usize)>> = vec![Vec::new(); state.lanes.len()];
    for (job, placed) in state.placed.iter().enumerate() {
        placed.iter().for_each(|placed| by_node[placed.node].push((placed.start, placed.end, job)));
    }
    let mut all = Vec::new();
    let mut costs = vec![0i64; state.placed.len()];
    for ((lane, node), mut of_node) in state.lanes.iter().zip(&state.problem.nodes).zip(by_node) {
        of_node.sort_unstable();
        for rental in lane.rentals(node) {
            let first = of_node.partition_point(|&(start, ..)| start < rental.start);
            let beyond = of_node.partition_point(|&(start, ..)| start < rental.end);
            let within = &of_node[first..beyond.max(first)];
            let times = within.iter().map(|(start, end, _)| end.saturating_sub(*start));
            for (&(.., job), part) in within.iter().zip(shares(rental.cost, times)) {
                costs[job] = costs[job].saturating_add(part);
            }
            all.push(rental);
        }
    }
    (all, costs)
}

fn verdict(state: &State, index: usize, bound: Bound) -> Verdict {
    let frames = state.missing(index);
    let shared_cache = state.misses_shared_cache(index);
    if !frames.is_empty() || shared_cache {
        return Verdict::Unplaced { frames, shared_cache };
    }
    let finish = state.finish(index);
    match state.problem.jobs[index].job.deadline {
        None => Verdict::NoDeadline { finish },
        Some(deadline) if finish <= deadline => {
            Verdict::Feasible { finish, slack: deadline.saturating_sub(finish) }
        }
        Some(deadline) => Verdict::Late {
            finish,
            by: finish.saturating_sub(deadline),
            unavoidable: bound.earliest_finish().is_none_or(|earliest| earliest > deadline),
        },
    }
}

/// How a job counts for the cost bound: by its deadline if the plan keeps it, not at all if the plan does not
/// place it.
pub(crate) fn counted(jobs: &[JobPlan]) -> impl Fn(&Job) -> Counted {
    let verdicts: BTreeMap<u64, Counted> = jobs
        .iter()
        .map(|entry| {
            let counted = match &entry.verdict {
                Verdict::Feasible { finish, slack } => Counted::By(finish.saturating_add(*slack)),
                Verdict::NoDeadline { .. } | Verdict::Late { .. } => Counted::Whenever,
                Verdict::Unplaced { .. } => Counted::Not,
            };
            (entry.job, counted)
        })
        .collect();
    move |job| match verdicts.get(&job.id) {
        Some(Counted::By(_)) => job.deadline.map_or(Counted::Whenever, Counted::By),
        Some(&counted) => counted,
        None => Counted::Not,
    }
}

/// The better of the bound with these prices and the bound without any.
fn cost_bound(input: &Input, jobs: &[JobPlan], proof: &Proof) -> (i64, Proof) {
    let money = |value: i128| i64::try_from(value.max(0)).unwrap_or(i64::MAX);
    let counted = counted(jobs);
    let plain = value(input, &Proof::default(), true, &counted);
    let priced = value(input, proof, true, &counted);
    if priced > plain { (money(priced), proof.clone()) } else { (money(plain), Proof::default()) }
}
