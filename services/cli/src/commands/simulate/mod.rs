//! `forelight simulate`: simulates weeks of a farm, with forelight's plans and with usual queues.

mod cases;
mod plot;
mod runner;
mod table;

use self::cases::{month, promises, shots, stills};
use self::runner::{Document, Runner};
use self::table::text;
use crate::job_options::svg_file;
use anyhow::Result;
use clap::ValueEnum;
use forelight_planner::{Confidence, Description};
use forelight_simulator::{Chances, PolicyKind, Report, Scenario, World};
use forelight_terminal::atomic_file::{self, write_bytes};
use forelight_terminal::failure::BadInput;
use forelight_terminal::interrupt::Interrupt;
use forelight_terminal::json_file;
use forelight_terminal::output::{self, Bars};
use forelight_terminal::quantities::parse_duration;
use std::path::PathBuf;

/// Simulate weeks of a farm: compare deadlines kept and money spent by plans and by queues
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight simulate --nodes 100 --jobs 50 --svg week.svg
  forelight simulate farm.json --policy forelight,edf --bias 1.3
  forelight simulate --scenario month --json > month.json
  forelight simulate --scenario promises
  forelight simulate --scenario shots
  forelight simulate --scenario stills

The seed determines nodes, jobs, their true cost, node failures and withdrawn jobs. All policies get the same. \
A job of a farm description (see `forelight plan`) comes in at its release time.

  --policy forelight     forelight's plans; a job is promised only if a plan keeps its deadline
  --policy edf           earliest deadline first, on any free node, without forecasts
  --policy three-frames  earliest deadline first, on as many nodes as the first, middle and last frame call for
  --policy fair-share    the project with the least use for its share first
  --policy fifo          by priority, then first come, first served

Policies without plans rent nodes as jobs need them. --pool restricts them to the cheapest nodes.")]
pub struct Args {
    /// Farm description, a JSON file [default: a random studio]
    #[arg(conflicts_with_all = ["scenario", "nodes", "jobs", "frames", "days", "frame_minutes", "confidence", "parts"])]
    farm: Option<PathBuf>,
    /// Run a fixed case and check its result against the required one
    #[arg(long, value_enum, conflicts_with_all = ["nodes", "jobs", "frames", "days", "frame_minutes", "confidence", "parts", "policy", "pool"])]
    scenario: Option<Case>,
    /// Number of nodes, 10 to 10,000
    #[arg(long, value_name = "COUNT", default_value_t = 100, value_parser = clap::value_parser!(u64).range(10..=10_000))]
    nodes: u64,
    /// Number of jobs, 1 to 1,000
    #[arg(long, value_name = "COUNT", default_value_t = 50, value_parser = clap::value_parser!(u64).range(1..=1_000))]
    jobs: u64,
    /// Mean number of frames of a job, 1 to 10,000
    #[arg(long, value_name = "COUNT", default_value_t = 40, value_parser = clap::value_parser!(u64).range(1..=10_000))]
    frames: u64,
    /// Number of days over which the jobs come in, 1 to 365
    #[arg(long, value_name = "COUNT", default_value_t = 7, value_parser = clap::value_parser!(u64).range(1..=365))]
    days: u64,
    /// Typical time of a frame on a node of speed 1, minutes. Nodes have speeds from 0.6 to 3
    #[arg(long, value_name = "MINUTES", default_value_t = 120, value_parser = clap::value_parser!(u64).range(1..=100_000))]
    frame_minutes: u64,
    /// Confidence of all jobs, per cent: 50, 80 or 95 [default: a third of the jobs each]
    #[arg(long, value_name = "PERCENT", value_parser = parse_confidence)]
    confidence: Option<Confidence>,
    /// Number of parts that each job's shared cache is filled in
    #[arg(long, value_name = "COUNT", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=64))]
    parts: u32,
    /// Work of a frame's own irradiance cache, per cent of the shared cache's. Policies without forecasts
    /// give each frame its own cache. 0: the shared cache comes first under all policies
    #[arg(long, value_name = "PERCENT", default_value_t = 0.0, value_parser = not_negative)]
    own_cache: f64,
    /// Policies to compare, separated by commas
    #[arg(long, value_enum, value_delimiter = ',', default_values_t = Choice::ALL)]
    policy: Vec<Choice>,
    /// Share of the nodes for policies without plans, per cent, the cheapest first. Several values are
    /// compared
    #[arg(long, value_name = "PERCENT", value_delimiter = ',', default_value = "100", value_parser = clap::value_parser!(u32).range(1..=100))]
    pool: Vec<u32>,
    /// Longest time between two plans, such as 1h
    #[arg(long, value_name = "DURATION", default_value = "1h", value_parser = parse_micros)]
    every: i64,
    /// True work divided by forecast work
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0, value_parser = up_to_a_thousand)]
    bias: f64,
    /// True spread divided by forecast spread
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0, value_parser = not_negative)]
    spread: f64,
    /// Mean time from a node's repair to its next failure, hours. 0: nodes do not fail
    #[arg(long, value_name = "HOURS", default_value_t = 720.0, value_parser = not_negative)]
    failures: f64,
    /// Mean time of a repair, hours
    #[arg(long, value_name = "HOURS", default_value_t = 4.0, value_parser = up_to_a_thousand)]
    repair: f64,
    /// Time until the lease of a failed node expires, and another node gets its frame, such as 60s
    #[arg(long, value_name = "DURATION", default_value = "60s", value_parser = parse_micros)]
    lease_ttl: i64,
    /// Share of the jobs that are withdrawn, per cent
    #[arg(long, value_name = "PERCENT", default_value_t = 1.0, value_parser = not_negative)]
    withdrawn: f64,
    /// Seed of all random numbers
    #[arg(long, value_name = "NUMBER", default_value_t = 1)]
    seed: u64,
    /// Draw utilisation over time, and cost against jobs in time, into this SVG file
    #[arg(long, value_name = "FILE.svg", value_parser = svg_file)]
    svg: Option<PathBuf>,
    /// Print all results as JSON to standard output
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Case {
    /// 30 days, 1,000 nodes: cost compared with EDF that is in time as often
    Month,
    /// 1,000 promises at 80 % and 1,000 at 95 %: share of promises kept
    Promises,
    /// Three weeks of frames of fifteen hours: the gain from caches that are filled in parts
    Shots,
    /// 100 stills a day on 100 nodes: the gain from frames in parts
    Stills,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Choice {
    Forelight,
    Edf,
    ThreeFrames,
    FairShare,
    Fifo,
}

impl Choice {
    const ALL: [Choice; 5] =
        [Choice::Forelight, Choice::Edf, Choice::ThreeFrames, Choice::FairShare, Choice::Fifo];

    fn kind(self) -> PolicyKind {
        match self {
            Choice::Forelight => PolicyKind::Planned,
            Choice::Edf => PolicyKind::Deadline,
            Choice::ThreeFrames => PolicyKind::ThreeFrames,
            Choice::FairShare => PolicyKind::FairShare,
            Choice::Fifo => PolicyKind::Fifo,
        }
    }
}

impl std::fmt::Display for Choice {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Choice::Forelight => "forelight",
            Choice::Edf => "edf",
            Choice::ThreeFrames => "three-frames",
            Choice::FairShare => "fair-share",
            Choice::Fifo => "fifo",
        })
    }
}

fn parse_confidence(text: &str) -> Result<Confidence, String> {
    match text {
        "50" => Ok(Confidence::P50),
        "80" => Ok(Confidence::P80),
        "95" => Ok(Confidence::P95),
        _ => Err("expected 50, 80 or 95".to_owned()),
    }
}

fn parse_micros(text: &str) -> Result<i64, String> {
    i64::try_from(parse_duration(text)?.as_micros()).map_err(|_| "too long".to_owned())
}

fn up_to_a_thousand(text: &str) -> Result<f64, String> {
    text.parse()
        .ok()
        .filter(|value| (1e-3..=1e3).contains(value))
        .ok_or("expected a number from 0.001 to 1000".into())
}

fn not_negative(text: &str) -> Result<f64, String> {
    text.parse()
        .ok()
        .filter(|value| (0.0..=1e6).contains(value))
        .ok_or("expected a number from 0 to 1000000".into())
}

pub fn run(args: &Args, interrupt: &Interrupt) -> Result<()> {
    atomic_file::check([args.svg.as_deref()])?;
    let chances = Chances {
        seed: args.seed,
        bias: args.bias,
        spread: args.spread,
        hours_between_failures: args.failures,
        hours_of_repair: args.repair,
        lease_seconds: args.lease_ttl as f64 / 1e6,
        own_cache: args.own_cache / 100.0,
        withdrawn: args.withdrawn / 100.0,
    };
    let bars = Bars::new(args.json);
    let runner = Runner { every: args.every, chances, bars, interrupt };
    let document = match args.scenario {
        Some(Case::Month) => month(&runner)?,
        Some(Case::Promises) => promises(&runner)?,
        Some(Case::Shots) => shots(&runner)?,
        Some(Case::Stills) => stills(&runner)?,
        None => {
            let (name, world) = world(args, chances)?;
            let queue = |kind: PolicyKind| args.pool.iter().map(move |&pool| (kind, pool));
            let runs = args.policy.iter().flat_map(|choice| match choice.kind() {
                PolicyKind::Planned => vec![(PolicyKind::Planned, 100)],
                kind => queue(kind).collect(),
            });
            let runs: Vec<(PolicyKind, u32)> = runs.collect();
            Document { worlds: vec![runner.world(name, &world, &runs)?], findings: Vec::new() }
        }
    };
    if let Some(path) = &args.svg {
        let worlds: Vec<(&str, &[Report])> =
            document.worlds.iter().map(|world| (world.name.as_str(), world.reports.as_slice())).collect();
        write_bytes(path, plot::svg(&worlds)?.as_bytes())?;
    }
    if args.json { output::json(&document) } else { output::print(&text(&document)) }
}

fn world(args: &Args, chances: Chances) -> Result<(String, World)> {
    let Some(path) = &args.farm else {
        let scenario = Scenario {
            nodes: args.nodes,
            jobs: args.jobs,
            frames: args.jobs.saturating_mul(args.frames),
            days: args.days,
            frame_minutes: args.frame_minutes,
            confidence: args.confidence,
            parts: args.parts,
        };
        return Ok(("a studio".to_owned(), scenario.world(chances)?));
    };
    let wrong = |error: String| BadInput::new(format!("{}: {error}", path.display()));
    let description: Description = json_file::read(path)?;
    let input = description.input(jiff::tz::db()).map_err(|error| wrong(error.to_string()))?;
    let world = World::new(input, chances).map_err(|error| wrong(error.to_string()))?;
    Ok((path.display().to_string(), world))
}
