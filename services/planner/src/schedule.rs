//! List scheduling: the order of jobs, and the place of each frame. The crate's `README.md` explains the
//! method.

use std::cmp::Reverse;

use crate::admission::{Admission, Allotted, MOST_ROWS, admit};
use crate::bound::{bound, bound_of_all};
use crate::exact;
use crate::fairness::Turns;
use crate::improve::improve;
use crate::lane::Prefer;
use crate::model::{Booking, Bound, Input, InputError, Node, Plan, Task, price_of};
use crate::outcome;
use crate::parts::{even_out, place_in_parts};
use crate::places::{Search, find_allotted};
use crate::problem::{FrameWork, Problem};
use crate::score::Score;
use crate::state::{Placed, State};

/// The most frames placed in all rounds together: about three times those of a studio's week.
const MOST_PLACEMENTS: usize = 61_000;
const MOST_ROUNDS: usize = 60;
/// A job is overcharged if it pays more than the programme's price by more than one part in this many.
const OVERCHARGED: i128 = 2;
/// Overcharges are worth another round above one part in this many of the plan's cost.
const WORTH_A_ROUND: i128 = 20;
/// Problems with at most this many tasks are planned twice.
const SMALL: usize = 500;
const MOST_IMPROVEMENTS: usize = 3;

/// Makes a plan.
///
/// Movable bookings are kept where they are valid and do not make their job late. The order of nodes, jobs
/// and frames in the input does not matter.
///
/// # Errors
/// If the input is invalid. Demands that cannot be met are verdicts, not errors.
pub fn plan(input: &Input) -> Result<Plan, InputError> {
    Ok(plan_and_count(input)?.0)
}

/// As [`plan`], with the number of gaps, frames, places and numbers that were looked at: a measure of the
/// time that a plan takes, and the same on every machine.
///
/// # Errors
/// As [`plan`].
pub fn plan_and_count(input: &Input) -> Result<(Plan, u64), InputError> {
    plan_with(input, MOST_ROUNDS, MOST_ROWS, MOST_IMPROVEMENTS)
}

/// Makes a plan in a fraction of the time, for farms that are planned again soon. The linear programme is
/// coarser, and there are few second tries. The bound is lower, and more jobs are late where time is scarce.
///
/// # Errors
/// As [`plan`].
pub fn plan_quickly(input: &Input) -> Result<Plan, InputError> {
    Ok(plan_with(input, 1, MOST_ROWS / 4, 0)?.0)
}

fn plan_with(
    input: &Input,
    most_rounds: usize,
    most_rows: usize,
    improvements: usize,
) -> Result<(Plan, u64), InputError> {
    input.check()?;
    let problem = Problem::new(input);
    let admission = admit(&problem, most_rows);
    let bounds: Vec<Bound> = problem.jobs.iter().map(|work| bound(&problem, work)).collect();
    let state = schedule(&problem, &admission, &input.movable, most_rounds, improvements);
    let together = bound_of_all(&problem, &bounds);
    Ok((outcome::plan(&state, &admission, bounds, together, None), problem.looks.count()))
}

/// The best of several rounds of list scheduling: earliest deadline first, then with late jobs first.
pub(crate) fn schedule<'p, 'a>(
    problem: &'p Problem<'a>,
    admission: &'p Admission,
    movable: &[Booking],
    most_rounds: usize,
    improvements: usize,
) -> State<'p, 'a> {
    let mut start = State::new(problem, admission);
    start.keep(movable);
    let count = problem.jobs.iter().map(|work| work.frames.len() + 1).sum::<usize>().max(1);
    let mut ahead: Vec<u32> = vec![0; problem.jobs.len()];
    let mut best: Option<(Score, State)> = None;
    let keeps_nothing = start.kept.iter().all(|&kept| kept == 0);
    for round in 0..=most_rounds.min(MOST_PLACEMENTS / count) {
        let mut state = if round == 0 || keeps_nothing {
            start.clone()
        } else {
            // Kept bookings may be what is in the way.
            State::new(problem, admission)
        };
        // Every other round from the fourth on places frames early, whatever the price.
        run(&mut state, admission, &ahead, round > 2 && round % 2 == 1);
        let score = Score::of(&state);
        let broken: Vec<usize> = (0..problem.jobs.len())
            .filter(|&job| problem.jobs[job].job.deadline.is_some() && admission.admitted[job])
            .filter(|&job| !state.is_kept(job))
            .collect();
        let overcharged = if keeps_nothing { overcharged(&state, admission) } else { Vec::new() };
        if best.as_ref().is_none_or(|(least, _)| score < *least) {
            best = Some((score, state));
        }
        // Late jobs go first in the next round (squeaky wheel optimisation, Joslin and Clements 1999). Jobs
        // that pay too much go first once. Kept bookings make way for late jobs only, not for a lower cost.
        let squeaky = if broken.is_empty() && round == 0 { overcharged } else { broken };
        if squeaky.is_empty() {
            break;
        }
        squeaky.into_iter().for_each(|job| ahead[job] += 1);
    }
    let mut state = best.map_or_else(|| start.clone(), |(_, state)| state);
    improve(&mut state, improvements);
    if count <= SMALL {
        // The programme's prices and slots mean little for a few frames, so these are also placed without
        // them.
        let mut selfish = State { is_selfless: false, ..start.clone() };
        run(&mut selfish, admission, &vec![0; problem.jobs.len()], false);
        improve(&mut selfish, improvements);
        if Score::of(&selfish) < Score::of(&state) {
            state = selfish;
        }
    }
    if let Some(mut found) = exact::search(problem, &start, &state) {
        improve(&mut found, improvements);
        if Score::of(&found) < Score::of(&state) {
            state = found;
        }
    }
    state
}

/// Jobs that pay far more than the programme's price, if they make the whole plan expensive.
fn overcharged(state: &State, admission: &Admission) -> Vec<usize> {
    let problem = state.problem;
    let price = |node: &Node, time: i64| i128::from(price_of(node.price_per_hour, time));
    let mut found = Vec::new();
    let (mut all, mut above) = (0i128, 0i128);
    for (job, allotted) in admission.allotments.iter().enumerate() {
        let placed = state.placed[job].iter();
        let is: i128 = placed.map(|place| price(problem.nodes[place.node], place.end - place.start)).sum();
        let pieces = allotted.iter();
        let fair: i128 = pieces.map(|piece| price(problem.representative(piece.class), piece.left)).sum();
        all += is;
        if fair > 0 && is - fair > fair / OVERCHARGED {
            above += is - fair;
            found.push(job);
        }
    }
    if above > all / WORTH_A_ROUND { found } else { Vec::new() }
}

/// Places everything that has no place yet. With `early`, the end matters more than the price.
fn run(state: &mut State, admission: &Admission, ahead: &[u32], early: bool) {
    let problem = state.problem;
    let mut promised: Vec<usize> = Vec::new();
    let mut others: Vec<usize> = Vec::new();
    for (job, work) in problem.jobs.iter().enumerate() {
        let is_promised = work.job.deadline.is_some() && admission.admitted[job];
        if is_promised { promised.push(job) } else { others.push(job) }
    }
    promised.sort_unstable_by_key(|&job| {
        let work = &problem.jobs[job];
        (Reverse(ahead[job]), work.job.deadline, Reverse(work.job.priority), work.job.id)
    });
    for job in promised {
        let mut allotment = admission.allotments[job].clone();
        if !state.is_selfless {
            allotment.iter_mut().for_each(|piece| (piece.start, piece.end) = (i64::MIN, i64::MAX));
        }
        by_deadline(state, job, &mut allotment, early);
    }
    // The rest, by priority: first the jobs that will be late, then those without a deadline, in turns.
    others.sort_unstable_by_key(|&job| {
        let job = problem.jobs[job].job;
        (Reverse(job.priority), job.deadline.is_none(), job.deadline, job.id)
    });
    for group in others.chunk_by(|&a, &b| problem.jobs[a].job.priority == problem.jobs[b].job.priority) {
        let (late, free): (Vec<usize>, Vec<usize>) =
            group.iter().partition(|&&job| problem.jobs[job].job.deadline.is_some());
        for job in late {
            as_early_as_possible(state, job);
        }
        in_turns(state, &free);
    }
}

/// Places a job by its deadline: within its allotment, else at the least cost, else as early as possible. If
/// all fail, it is placed as early as possible without the deadline.
fn by_deadline(state: &mut State, job: usize, allotment: &mut [Allotted], early: bool) {
    let before = state.placed[job].len();
    let attempts: &[(Prefer, bool)] = if early {
        &[(Prefer::Early, false)]
    } else {
        &[(Prefer::Cheap, true), (Prefer::Cheap, false), (Prefer::Early, false)]
    };
    for &(prefer, allotted) in attempts {
        if place_all(state, job, prefer, if allotted { Some(&mut *allotment) } else { None }) {
            return;
        }
        state.unbook_after(job, before);
    }
    as_early_as_possible(state, job);
}

/// Places all tasks of the job by its deadline. Returns whether that succeeded.
pub(crate) fn place_all(
    state: &mut State,
    job: usize,
    prefer: Prefer,
    mut allotment: Option<&mut [Allotted]>,
) -> bool {
    let problem = state.problem;
    let work = &problem.jobs[job];
    let latest_end = work.job.deadline.unwrap_or(i64::MAX);
    if !place_shared_cache(state, job, latest_end) {
        return false;
    }
    let missing = state.missing(job);
    let mut waiting = work.frames.iter().filter(|frame| missing.binary_search(&frame.number).is_ok());
    waiting.all(|frame| place_frame(state, job, frame, (latest_end, prefer), allotment.as_deref_mut()))
}

/// As [`place_all`], cheaply or, failing that, as early as possible. On failure, nothing more is placed.
pub(crate) fn place_in_time(state: &mut State, job: usize) -> bool {
    let before = state.placed[job].len();
    for prefer in [Prefer::Cheap, Prefer::Early] {
        if place_all(state, job, prefer, None) {
            return true;
        }
        state.unbook_after(job, before);
    }
    false
}

/// Places a frame by an instant: whole if it may be and fits, else in parts.
fn place_frame(
    state: &mut State,
    job: usize,
    frame: &FrameWork,
    (latest_end, prefer): (i64, Prefer),
    mut allotment: Option<&mut [Allotted]>,
) -> bool {
    let number = frame.number;
    let Some(release) = state.earliest(job, Task::Frame(number)) else { return false };
    let search = Search { latest_end, prefer, ..Search::early(state, job, release, frame.work) };
    if frame.division.allows(1) {
        let allotted =
            allotment.as_deref_mut().and_then(|allotment| find_allotted(state, &search, allotment));
        if let Some((node, fit)) = allotted.or_else(|| state.find(&search)) {
            state.book(job, Placed { node, start: fit.start, end: fit.end, task: Task::Frame(number) });
            return true;
        }
    }
    place_in_parts(state, job, frame, &search, allotment)
}

/// Places the shared cache, if any. All frames wait for it, so a cheaper place may at most double the
/// shortest wait.
fn place_shared_cache(state: &mut State, job: usize, latest_end: i64) -> bool {
    let work = &state.problem.jobs[job];
    let Some((cache, amount)) = work.job.shared_cache.zip(work.shared_cache_part()) else { return true };
    let release = work.release(state.problem.input.now);
    let for_others = state.for_others();
    let search = |latest_end, prefer| Search {
        class_of_work: cache.class,
        work: amount,
        release,
        latest_end,
        classes: &work.shared_cache_classes,
        prefer,
        below: i64::MAX,
        except: None,
        for_others,
    };
    for task in state.missing_cache_parts(job) {
        let Some((node, first)) = state.find(&search(latest_end, Prefer::Early)) else { return false };
        let patience = first.end.saturating_add(first.end.saturating_sub(release)).min(latest_end);
        let (node, fit) = state.find(&search(patience, Prefer::Cheap)).unwrap_or((node, first));
        state.book(job, Placed { node, start: fit.start, end: fit.end, task });
    }
    true
}

/// Places the job's missing tasks where each ends first.
pub(crate) fn as_early_as_possible(state: &mut State, job: usize) {
    let work = &state.problem.jobs[job];
    if !place_shared_cache(state, job, i64::MAX) {
        return;
    }
    let missing = state.missing(job);
    for frame in work.frames.iter().filter(|frame| missing.binary_search(&frame.number).is_ok()) {
        place_frame(state, job, frame, (i64::MAX, Prefer::Early), None);
    }
    even_out(state, job);
}

/// Places jobs without a deadline frame by frame, each time one of the job whose turn it is.
pub(crate) fn in_turns(state: &mut State, jobs: &[usize]) {
    let problem = state.problem;
    let mut turns = Turns::new(problem);
    let mut waiting: Vec<(usize, Option<u64>)> = Vec::new();
    let mut frames: Vec<std::vec::IntoIter<FrameWork>> = vec![Vec::new().into_iter(); problem.jobs.len()];
    for &job in jobs {
        let work = &problem.jobs[job];
        if !place_shared_cache(state, job, i64::MAX) {
            continue;
        }
        let missing = state.missing(job);
        let left = work.frames.iter().filter(|frame| missing.binary_search(&frame.number).is_ok());
        frames[job] = left.copied().collect::<Vec<_>>().into_iter();
        waiting.push((job, work.job.project));
    }
    while let Some(job) = turns.next(&waiting) {
        let project = problem.jobs[job].job.project;
        match frames[job].next() {
            Some(frame) => {
                let before = state.placed[job].len();
                place_frame(state, job, &frame, (i64::MAX, Prefer::Early), None);
                let placed = state.placed[job].iter().skip(before);
                let time = placed.fold(0i64, |sum, place| sum.saturating_add(place.end - place.start));
                turns.had(job, project, time);
                if frames[job].len() == 0 {
                    even_out(state, job);
                }
            }
            None => waiting.retain(|&(other, _)| other != job),
        }
    }
    for &job in jobs {
        within_budget(state, job);
    }
}

/// If a job without a deadline exceeds its budget, places it anew with the earliest end that the budget
/// allows.
fn within_budget(state: &mut State, job: usize) {
    let work = &state.problem.jobs[job];
    let (Some(budget), None) = (work.job.budget, work.job.deadline) else { return };
    let kept = state.kept[job];
    let spent = |state: &State| {
        state.placed[job].iter().fold(0i64, |sum, placed| {
            let node = state.problem.nodes[placed.node];
            sum.saturating_add(
                state.lanes[placed.node]
                    .saved_without(node, placed.start, placed.end)
                    .max(node.price(placed.end - placed.start, false)),
            )
        })
    };
    if spent(state) <= budget || !state.missing(job).is_empty() {
        return;
    }
    let release = work.release(state.problem.input.now);
    let soonest = state.finish(job);
    let mut best = state.placed[job].clone();
    let (mut tight, mut loose) = (soonest, None::<i64>);
    let mut length = soonest.saturating_sub(release).max(1);
    for _ in 0..24 {
        let by = match loose {
            None => {
                length = length.saturating_mul(2);
                release.saturating_add(length)
            }
            Some(loose) => tight + (loose - tight) / 2,
        };
        state.unbook_after(job, kept);
        if place_cheaply_by(state, job, by) && spent(state) <= budget {
            loose = Some(by);
            best = state.placed[job].clone();
        } else {
            tight = by;
        }
        if by == i64::MAX || loose.is_some_and(|loose| loose - tight <= 1_000_000) {
            break;
        }
    }
    state.restore(job, best);
}

/// Places all missing frames of a job at the least cost that ends by this instant.
fn place_cheaply_by(state: &mut State, job: usize, by: i64) -> bool {
    let work = &state.problem.jobs[job];
    if !place_shared_cache(state, job, by) {
        return false;
    }
    let missing = state.missing(job);
    let mut waiting = work.frames.iter().filter(|frame| missing.binary_search(&frame.number).is_ok());
    waiting.all(|frame| place_frame(state, job, frame, (by, Prefer::Cheap), None))
}
