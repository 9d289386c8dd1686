//! Rescues: the cheapest change with which a late job is in time, around the bookings of all others.

use std::collections::{BTreeMap, BTreeSet};

use serde::{Deserialize, Serialize};

use crate::admission::Admission;
use crate::answers::{Change, changed, find, own_job};
use crate::model::{Input, InputError, Node, Plan};
use crate::problem::Problem;
use crate::schedule::place_in_time;
use crate::state::{Placed, State};

/// How many more nodes are tried.
const COUNTS: [u32; 5] = [1, 2, 4, 8, 16];

/// A change with which a job keeps its deadline after all.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Rescue {
    /// The change.
    pub change: Change,
    /// What it adds to the cost of all jobs together, micro-units.
    pub added_cost: i64,
    /// When the job would end.
    pub finish: i64,
}

/// Which rescue is better: less added cost, then the cheapest kind of node before the fastest, then fewer
/// nodes.
type Rank = (i64, usize, u32);

/// A rescue for each of these jobs, as if it were the only one. More nodes are preferred to a later deadline.
///
/// Each changed farm is made once, for all jobs that it may help: that takes far longer than to place a job.
pub(crate) fn rescues(input: &Input, plan: &Plan, late: &[u64]) -> Result<Vec<Option<Rescue>>, InputError> {
    let mut models: BTreeMap<u32, Vec<u64>> = BTreeMap::new();
    let mut helped_by: BTreeMap<u64, Vec<(usize, usize)>> = BTreeMap::new();
    for (place, &job) in late.iter().enumerate() {
        let class = find(input, job)?.class;
        let models = models.entry(class).or_insert_with(|| cheapest_and_fastest(input, class));
        for (kind, &model) in models.iter().enumerate() {
            helped_by.entry(model).or_default().push((place, kind));
        }
    }
    let mut best: Vec<Option<(Rank, Rescue)>> = vec![None; late.len()];
    for (&like, helped) in &helped_by {
        let jobs: Vec<u64> = helped.iter().map(|&(place, _)| late[place]).collect();
        for count in COUNTS {
            let change = Change::MoreNodes { like, count };
            let trials = trials(&changed(input, &change)?, plan, &jobs);
            for (&(place, kind), trial) in helped.iter().zip(trials) {
                let Some((added_cost, finish)) = trial else { continue };
                let rank = (added_cost, kind, count);
                if best[place].as_ref().is_none_or(|(least, _)| rank < *least) {
                    best[place] = Some((rank, Rescue { change: change.clone(), added_cost, finish }));
                }
            }
        }
    }
    let mut found: Vec<Option<Rescue>> =
        best.into_iter().map(|best| best.map(|(_, rescue)| rescue)).collect();
    for (place, rescue) in with_more_time(input, plan, late, &found)? {
        found[place] = Some(rescue);
    }
    Ok(found)
}

/// The nodes that render work of this class most cheaply and fastest: two, one, or none.
fn cheapest_and_fastest(input: &Input, class: u32) -> Vec<u64> {
    let able = || input.nodes.iter().filter(move |node| node.speed_of(class) > 0);
    let price =
        |node: &Node| i128::from(node.price_per_hour) * 1_000_000_000 / i128::from(node.speed_of(class));
    let cheapest = able().min_by_key(|node| (price(node), node.id)).map(|node| node.id);
    let fastest = able().max_by_key(|node| (node.speed_of(class), node.id)).map(|node| node.id);
    let mut models: Vec<u64> = cheapest.into_iter().chain(fastest).collect();
    models.dedup();
    models
}

/// Later deadlines, for jobs that have no rescue yet: when each ends now.
fn with_more_time(
    input: &Input,
    plan: &Plan,
    late: &[u64],
    found: &[Option<Rescue>],
) -> Result<Vec<(usize, Rescue)>, InputError> {
    let mut later = input.clone();
    let mut asked: Vec<(usize, Change)> = Vec::new();
    for (place, &job) in late.iter().enumerate().filter(|&(place, _)| found[place].is_none()) {
        let finish = plan.job(job).and_then(|entry| entry.verdict.finish());
        let Some((finish, deadline)) = finish.zip(find(input, job)?.deadline) else { continue };
        asked.push((place, Change::Later { job, by: finish.saturating_sub(deadline) }));
        own_job(&mut later, job)?.deadline = Some(finish);
    }
    let jobs: Vec<u64> = asked.iter().map(|&(place, _)| late[place]).collect();
    let with_trials = asked.into_iter().zip(trials(&later, plan, &jobs));
    let rescues = with_trials.filter_map(|((place, change), trial)| {
        let (added_cost, finish) = trial?;
        Some((place, Rescue { change, added_cost, finish }))
    });
    Ok(rescues.collect())
}

/// Places each of these jobs anew by its deadline, with the plan's bookings of all others. For each that
/// fits: what that adds to the cost, and its end.
fn trials(input: &Input, plan: &Plan, jobs: &[u64]) -> Vec<Option<(i64, i64)>> {
    if jobs.is_empty() {
        return Vec::new();
    }
    let problem = Problem::new(input);
    let admission = Admission::none(&problem);
    let mut state = State::new(&problem, &admission);
    state.keep(&plan.bookings);
    let costs: Vec<i64> = (0..problem.nodes.len()).map(|node| state.cost_of(node)).collect();
    let mut place_anew = |job: u64| {
        let job = problem.job(job)?;
        let (before, kept) = (state.placed[job].clone(), std::mem::take(&mut state.kept[job]));
        state.unbook_after(job, 0);
        let found = place_in_time(&mut state, job).then(|| {
            let touched: BTreeSet<usize> = nodes(&before).chain(nodes(&state.placed[job])).collect();
            let added = |node: usize| state.cost_of(node).saturating_sub(costs[node]);
            (touched.into_iter().map(added).fold(0, i64::saturating_add), state.finish(job))
        });
        state.restore(job, before);
        state.kept[job] = kept;
        found
    };
    jobs.iter().map(|&job| place_anew(job)).collect()
}

fn nodes(places: &[Placed]) -> impl Iterator<Item = usize> {
    places.iter().map(|placed| placed.node)
}
