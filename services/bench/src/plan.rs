//! `forelight bench plan`: quality and speed of plans, for weeks of a studio with hundreds of jobs, whole and
//! with divided frames, for shots whose frames are divided, and for farms small enough to try every plan.

use crate::report::Report;
use anyhow::{Result, anyhow};
use forelight_planner::{Division, Event, Input, Plan, Task, plan, replan, verify};
use forelight_simulator::reference::{
    Size, cheapest_by_trying_everything, shot, studio, studio_with_parts, tiny,
};
use forelight_terminal::quantities::{percent, seconds};
use forelight_terminal::table::{Align, Table};
use forelight_tracer::clocked;
use serde::Serialize;
use std::collections::BTreeMap;

/// Measure plans: time, cost against the bound, and small ones against the optimum
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight bench plan
  forelight bench plan --seeds 3 --tiny 1000 --json > plan.json

Times are CPU seconds of one thread, so other load on the machine hardly matters.")]
pub struct Args {
    /// Random studios
    #[arg(long, value_name = "COUNT", default_value_t = 3, value_parser = clap::value_parser!(u64).range(1..=1000))]
    seeds: u64,
    /// Jobs per studio
    #[arg(long, value_name = "COUNT", default_value_t = 200, value_parser = clap::value_parser!(u64).range(1..=10_000))]
    jobs: u64,
    /// Frames of all jobs together
    #[arg(long, value_name = "COUNT", default_value_t = 20_000, value_parser = clap::value_parser!(u64).range(1..=1_000_000))]
    frames: u64,
    /// Nodes per studio
    #[arg(long, value_name = "COUNT", default_value_t = 500, value_parser = clap::value_parser!(u64).range(1..=10_000))]
    nodes: u64,
    /// Small farms of each kind to plan exhaustively
    #[arg(long, value_name = "COUNT", default_value_t = 1000)]
    tiny: u64,
    /// Print the measurements as JSON to standard output
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Serialize)]
struct Document {
    studios: Vec<Studio>,
    shots: Vec<Shots>,
    tiny: Vec<Tiny>,
}

#[derive(Debug, Serialize)]
struct Studio {
    seed: u64,
    /// Whether frames may be divided.
    divided: bool,
    /// Bookings of parts of frames.
    parts: usize,
    jobs: usize,
    frames: usize,
    nodes: usize,
    kept: usize,
    plan_seconds: f64,
    verify_seconds: f64,
    cost: i64,
    cost_bound: i64,
    above_bound: f64,
    replans: Vec<Replan>,
}

/// A new plan after one event.
#[derive(Debug, Serialize)]
struct Replan {
    event: &'static str,
    seconds: f64,
    moved: usize,
    /// Share of the bookings moved that the event does not concern.
    others_moved: f64,
    at_risk: usize,
}

/// Shots without a deadline, of frames that may be divided.
#[derive(Debug, Serialize)]
struct Shots {
    frames: u64,
    nodes: u64,
    /// One frame takes this many times as long as it would.
    longest: u64,
    shots: u64,
    /// Worst end of the last frame after the mean node's, as a share of the shot's length.
    end_after_mean: f64,
    /// The same with whole frames.
    end_after_mean_whole: f64,
    /// Most that dividing costs.
    worst_added_cost: f64,
    worst_plan_seconds: f64,
}

/// Small farms of one kind.
#[derive(Debug, Serialize)]
struct Tiny {
    billed_in_steps: bool,
    farms: u64,
    with_a_plan: u64,
    /// A plan exists, but none was found.
    missed: u64,
    optimal: u64,
    mean_above_optimum: f64,
    worst_above_optimum: f64,
}

pub fn run(args: &Args) -> Result<Report> {
    let size = Size { jobs: args.jobs, frames: args.frames, nodes: args.nodes, ..Size::default() };
    let studios = (1..=args.seeds)
        .flat_map(|seed| [(seed, studio(size, seed)), (seed, studio_with_parts(size, seed))])
        .map(|(seed, input)| measure(seed, &input))
        .collect::<Result<Vec<_>>>()?;
    let shots = SHOTS.into_iter().map(|kind| measure_shots(kind, args.seeds)).collect::<Result<Vec<_>>>()?;
    let tiny = [false, true]
        .into_iter()
        .map(|steps| try_everything(args.tiny, steps))
        .collect::<Result<Vec<_>>>()?;
    let document = Document { studios, shots, tiny };
    report(&document).printed(args.json, &document)
}

/// Result of `work`, and its CPU seconds on this thread.
fn timed<T>(work: impl FnOnce() -> T) -> (T, f64) {
    let (done, nanos) = clocked(work);
    (done, nanos as f64 * 1e-9)
}

fn checked(input: &Input, plan: &Plan) -> Result<()> {
    verify(input, plan).map_err(|violations| {
        let first = violations.first().map(ToString::to_string).unwrap_or_default();
        anyhow!("the verifier found {} violations; the first: {first}", violations.len())
    })
}

fn measure(seed: u64, input: &Input) -> Result<Studio> {
    let (found, plan_seconds) = timed(|| plan(input));
    let found = found?;
    let (faults, verify_seconds) = timed(|| checked(input, &found));
    faults?;
    let mut replans = Vec::new();
    for (event, name, concerned) in events(input, &found) {
        let (after, seconds) = timed(|| replan(input, &found, &event));
        let after = after?;
        checked(&after.input, &after.plan)?;
        let moved = after.difference.moved.len();
        let others = found.bookings.len().saturating_sub(concerned).max(1);
        let others_moved = moved.saturating_sub(concerned) as f64 / others as f64;
        replans.push(Replan { event: name, seconds, moved, others_moved, at_risk: after.at_risk.len() });
    }
    Ok(Studio {
        seed,
        divided: input.jobs.iter().flat_map(|job| &job.frames).any(|frame| frame.division.most() > 1),
        parts: found.bookings.iter().filter(|booking| matches!(booking.task, Task::Part { .. })).count(),
        jobs: input.jobs.len(),
        frames: input.jobs.iter().map(|job| job.frames.len()).sum(),
        nodes: input.nodes.len(),
        kept: found.jobs.iter().filter(|entry| entry.verdict.is_kept()).count(),
        plan_seconds,
        verify_seconds,
        cost: found.cost,
        cost_bound: found.cost_bound,
        above_bound: found.cost as f64 / found.cost_bound.max(1) as f64 - 1.0,
        replans,
    })
}

/// Frames, nodes, and how many times as long the longest frame takes.
const SHOTS: [(u64, u64, u64); 6] =
    [(1000, 100, 1), (1000, 100, 10), (400, 100, 1), (400, 100, 10), (200, 100, 1), (200, 100, 10)];

fn measure_shots((frames, nodes, longest): (u64, u64, u64), shots: u64) -> Result<Shots> {
    let mut worst = Shots {
        frames,
        nodes,
        longest,
        shots,
        end_after_mean: 0.0,
        end_after_mean_whole: 0.0,
        worst_added_cost: 0.0,
        worst_plan_seconds: 0.0,
    };
    for seed in 1..=shots {
        let mut input = shot(frames, nodes, longest, seed);
        let (divided, seconds) = timed(|| plan(&input));
        let divided = divided?;
        checked(&input, &divided)?;
        for frame in input.jobs.iter_mut().flat_map(|job| &mut job.frames) {
            frame.division = Division::Whole;
        }
        let whole = plan(&input)?;
        let added = divided.cost as f64 / whole.cost.max(1) as f64 - 1.0;
        worst.end_after_mean = worst.end_after_mean.max(end_after_mean(&input, &divided));
        worst.end_after_mean_whole = worst.end_after_mean_whole.max(end_after_mean(&input, &whole));
        worst.worst_added_cost = worst.worst_added_cost.max(added);
        worst.worst_plan_seconds = worst.worst_plan_seconds.max(seconds);
    }
    Ok(worst)
}

/// The shot's last end over the mean of the last ends on its nodes, both from the release, less one.
fn end_after_mean(input: &Input, plan: &Plan) -> f64 {
    let release = input.jobs.first().map_or(input.now, |job| job.release.max(input.now));
    let mut ends: BTreeMap<u64, i64> = BTreeMap::new();
    for booking in &plan.bookings {
        let end = ends.entry(booking.node).or_default();
        *end = (booking.end - release).max(*end);
    }
    let last = ends.values().max().copied().unwrap_or(0) as f64;
    last * ends.len() as f64 / ends.values().sum::<i64>().max(1) as f64 - 1.0
}

/// Possible events on the second day, with the number of bookings that each concerns.
fn events(input: &Input, plan: &Plan) -> Vec<(Event, &'static str, usize)> {
    const DAY: i64 = 86_400_000_000;
    let mut events = Vec::new();
    let Some(first) =
        plan.bookings.iter().find(|booking| booking.start > DAY && booking.task.frame().is_some())
    else {
        return events;
    };
    let from = first.start;
    let on_node = plan.bookings.iter().filter(|b| b.node == first.node && b.end > from).count();
    events.push((Event::NodeDown { node: first.node, from, until: None }, "node dies", on_node));
    let until = first.end + (first.end - first.start);
    let late = Event::Takes { job: first.job, task: first.task, until };
    let behind =
        plan.bookings.iter().filter(|b| b.node == first.node && b.start < until && b.end > from).count();
    events.push((late, "frame takes twice as long", behind));
    if let Some(job) = input.jobs.iter().find(|job| job.release > DAY) {
        let new = forelight_planner::Job {
            id: input.jobs.iter().map(|job| job.id).max().map_or(0, |id| id + 1),
            name: "new".to_owned(),
            ..job.clone()
        };
        events.push((Event::JobAdded { job: Box::new(new) }, "job comes in", 0));
    }
    events
}

fn try_everything(farms: u64, billed_in_steps: bool) -> Result<Tiny> {
    let mut tried = Tiny {
        billed_in_steps,
        farms,
        with_a_plan: 0,
        missed: 0,
        optimal: 0,
        mean_above_optimum: 0.0,
        worst_above_optimum: 0.0,
    };
    for seed in 0..farms {
        let input = tiny(seed, billed_in_steps);
        let found = plan(&input)?;
        checked(&input, &found)?;
        let Some(optimum) = cheapest_by_trying_everything(&input) else { continue };
        tried.with_a_plan += 1;
        if !found.jobs.iter().all(|entry| entry.verdict.is_kept()) {
            tried.missed += 1;
            continue;
        }
        let above = if optimum == 0 { 0.0 } else { found.cost as f64 / optimum as f64 - 1.0 };
        tried.optimal += u64::from(found.cost == optimum);
        tried.mean_above_optimum += above;
        tried.worst_above_optimum = tried.worst_above_optimum.max(above);
    }
    tried.mean_above_optimum /= (tried.with_a_plan - tried.missed).max(1) as f64;
    Ok(tried)
}

fn report(document: &Document) -> Report {
    let mut table = Table::new(&[
        ("seed", Align::Right),
        ("frames", Align::Right),
        ("parts", Align::Right),
        ("in time", Align::Right),
        ("plan", Align::Right),
        ("check", Align::Right),
        ("above bound", Align::Right),
        ("event", Align::Left),
        ("replan", Align::Right),
        ("moved", Align::Right),
        ("of the others", Align::Right),
        ("at risk", Align::Right),
    ]);
    for studio in &document.studios {
        let mut cells = vec![
            studio.seed.to_string(),
            studio.frames.to_string(),
            if studio.divided { studio.parts.to_string() } else { "whole".to_owned() },
            format!("{}/{}", studio.kept, studio.jobs),
            seconds(studio.plan_seconds),
            seconds(studio.verify_seconds),
            percent(studio.above_bound),
        ];
        for replan in &studio.replans {
            cells.extend([
                replan.event.to_owned(),
                format!("{:.0} ms", replan.seconds * 1e3),
                replan.moved.to_string(),
                percent(replan.others_moved),
                replan.at_risk.to_string(),
            ]);
            table.row(std::mem::replace(&mut cells, vec![String::new(); 7]));
        }
    }
    let mut small = Table::new(&[
        ("small farms", Align::Left),
        ("tried", Align::Right),
        ("with a plan", Align::Right),
        ("missed", Align::Right),
        ("optimal", Align::Right),
        ("mean above optimum", Align::Right),
        ("worst", Align::Right),
    ]);
    for tiny in &document.tiny {
        small.row([
            if tiny.billed_in_steps { "billed by the hour" } else { "billed as used" }.to_owned(),
            tiny.farms.to_string(),
            tiny.with_a_plan.to_string(),
            tiny.missed.to_string(),
            tiny.optimal.to_string(),
            percent(tiny.mean_above_optimum),
            percent(tiny.worst_above_optimum),
        ]);
    }
    Report::default().table(table).text("\n").table(shots_table(&document.shots)).text("\n").table(small)
}

fn shots_table(shots: &[Shots]) -> Table {
    let mut table = Table::new(&[
        ("shots", Align::Right),
        ("frames", Align::Right),
        ("nodes", Align::Right),
        ("longest frame", Align::Right),
        ("end after mean node", Align::Right),
        ("whole frames", Align::Right),
        ("added cost", Align::Right),
        ("plan", Align::Right),
    ]);
    for kind in shots {
        table.row([
            kind.shots.to_string(),
            kind.frames.to_string(),
            kind.nodes.to_string(),
            format!("{} times", kind.longest),
            percent(kind.end_after_mean),
            percent(kind.end_after_mean_whole),
            percent(kind.worst_added_cost),
            seconds(kind.worst_plan_seconds),
        ]);
    }
    table
}
