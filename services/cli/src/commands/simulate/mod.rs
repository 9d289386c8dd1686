//! `forelight simulate`: simulates weeks of a farm, with forelight's plans and with usual queues.

mod plot;

use anyhow::Result;
use clap::ValueEnum;
use forelight_planner::{Confidence, Description};
use forelight_simulator::{
    Chances, PolicyKind, Report, Scenario, World, report, run as simulate, stills as draw_stills,
};
use forelight_terminal::atomic_file::{self, write_bytes};
use forelight_terminal::failure::{BadInput, Interrupted};
use forelight_terminal::interrupt::Interrupt;
use forelight_terminal::json_file;
use forelight_terminal::output::{self, Bars};
use forelight_terminal::quantities::{money, parse_duration};
use forelight_terminal::table::{Align, Table};
use serde::Serialize;
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
    /// Number of nodes
    #[arg(long, value_name = "COUNT", default_value_t = 100, value_parser = clap::value_parser!(u64).range(10..=10_000))]
    nodes: u64,
    /// Number of jobs
    #[arg(long, value_name = "COUNT", default_value_t = 50, value_parser = clap::value_parser!(u64).range(1..=1_000))]
    jobs: u64,
    /// Mean number of frames of a job
    #[arg(long, value_name = "COUNT", default_value_t = 40, value_parser = clap::value_parser!(u64).range(1..=10_000))]
    frames: u64,
    /// Number of days over which the jobs come in
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
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0, value_parser = positive)]
    bias: f64,
    /// True spread divided by forecast spread
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0, value_parser = not_negative)]
    spread: f64,
    /// Mean time from a node's repair to its next failure, hours. 0: nodes do not fail
    #[arg(long, value_name = "HOURS", default_value_t = 720.0, value_parser = not_negative)]
    failures: f64,
    /// Mean time of a repair, hours
    #[arg(long, value_name = "HOURS", default_value_t = 4.0, value_parser = positive)]
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
    #[arg(long, value_name = "FILE")]
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

fn positive(text: &str) -> Result<f64, String> {
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

/// Pools to try EDF with, per cent of the nodes. A farm's operator would also search for the best.
const POOLS: [u32; 9] = [100, 60, 40, 30, 25, 22, 20, 18, 16];
/// Required share of saved cost in the month, and of kept promises at each confidence.
const MONTH_SAVES: f64 = 0.15;
const PROMISES: [(Confidence, f64); 2] = [(Confidence::P80, 0.80 - 0.03), (Confidence::P95, 0.95 - 0.02)];

/// For long frames: a frame's own cache relative to the shared one, and the required gain in promises.
const OWN_CACHE: f64 = 0.5;
const SHOTS_MORE: f64 = 0.0;

/// For stills: the most parts of a frame, the least time saved, and the most that this may cost.
const STILL_PARTS: u32 = 512;
const STILLS_SAVE: f64 = 0.90;
const STILLS_COST: f64 = 0.03;

#[derive(Debug, Serialize)]
struct Document {
    worlds: Vec<Simulated>,
    /// For a fixed case: the results to check.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    findings: Vec<Finding>,
}

#[derive(Debug, Serialize)]
struct Simulated {
    name: String,
    nodes: usize,
    jobs: usize,
    chances: Chances,
    reports: Vec<Report>,
}

#[derive(Debug, Serialize)]
struct Finding {
    what: String,
    found: f64,
    wanted: f64,
    /// Whether `wanted` is the most. Otherwise it is the least.
    at_most: bool,
    reached: bool,
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

struct Runner<'a> {
    every: i64,
    chances: Chances,
    bars: Bars,
    interrupt: &'a Interrupt,
}

impl Runner<'_> {
    fn world(&self, name: String, world: &World, runs: &[(PolicyKind, u32)]) -> Result<Simulated> {
        let spinner = self.bars.spinner("lower bound of the cost");
        let bound = world.least_cost()?;
        spinner.finish_and_clear();
        let mut reports = Vec::new();
        for &(kind, pool) in runs {
            let bar = self.bars.bar(kind.name(), world.input().jobs.len() as u64);
            let mut policy = kind.policy(world, self.every, pool);
            // An interrupted simulation has no result; the thread ends with the process.
            let mut stopped = false;
            let record = simulate(world, policy.as_mut(), |over, _| {
                stopped |= self.interrupt.is_set();
                bar.set_position(over);
            });
            bar.finish_and_clear();
            if stopped {
                return Err(Interrupted.into());
            }
            reports.push(report(world, kind, pool, policy.plans(), bound, &record));
        }
        let input = world.input();
        let (nodes, jobs) = (input.nodes.len(), input.jobs.len());
        Ok(Simulated { name, nodes, jobs, chances: self.chances, reports })
    }
}

fn month(runner: &Runner) -> Result<Document> {
    let world = Scenario::MONTH.world(runner.chances)?;
    let mut runs = vec![(PolicyKind::Planned, 100)];
    runs.extend(POOLS.map(|pool| (PolicyKind::Deadline, pool)));
    runs.extend([PolicyKind::ThreeFrames, PolicyKind::FairShare, PolicyKind::Fifo].map(|kind| (kind, 100)));
    let simulated = runner.world("a month, 1,000 nodes".to_owned(), &world, &runs)?;
    let mut findings = Vec::new();
    let ours = simulated.reports.iter().find(|report| report.policy == PolicyKind::Planned);
    if let Some((ours, rival)) = ours.zip(rival(&simulated.reports)) {
        let saved = 1.0 - ours.cost as f64 / rival.cost.max(1) as f64;
        findings.push(Finding {
            what: format!(
                "saved compared with EDF on the cheapest {} % of the nodes, which has {:.1} % in time (forelight: {:.1} %)",
                rival.pool,
                rival.on_time() * 100.0,
                ours.on_time() * 100.0
            ),
            found: saved,
            wanted: MONTH_SAVES,
            at_most: false,
            reached: saved >= MONTH_SAVES,
        });
    }
    Ok(Document { worlds: vec![simulated], findings })
}

/// The cheapest EDF that is in time as often as forelight. Otherwise the cheapest one that is at most one job
/// in a hundred behind. Otherwise the one that is in time most often.
fn rival(reports: &[Report]) -> Option<&Report> {
    let ours = reports.iter().find(|report| report.policy == PolicyKind::Planned)?;
    let all = || reports.iter().filter(|report| report.policy == PolicyKind::Deadline);
    let at_least = |rate: f64| all().filter(|r| r.on_time() >= rate).min_by_key(|report| report.cost);
    at_least(ours.on_time())
        .or_else(|| at_least(ours.on_time() - 0.01))
        .or_else(|| all().max_by(|a, b| a.on_time().total_cmp(&b.on_time())))
}

fn promises(runner: &Runner) -> Result<Document> {
    let mut document = Document { worlds: Vec::new(), findings: Vec::new() };
    for (confidence, wanted) in PROMISES {
        let world = Scenario::promises(confidence).world(runner.chances)?;
        let per_cent = confidence.probability() * 100.0;
        let name = format!("promises at {per_cent:.0} %");
        let simulated = runner.world(name, &world, &[(PolicyKind::Planned, 100)])?;
        for report in &simulated.reports {
            document.findings.push(Finding {
                what: format!("of {} promises at {per_cent:.0} % were kept", report.promised),
                found: report.kept(),
                wanted,
                at_most: false,
                reached: report.kept() >= wanted && report.promised >= 1000,
            });
        }
        document.worlds.push(simulated);
    }
    Ok(document)
}

/// The same jobs with frames and caches in one piece, and in parts.
fn shots(runner: &Runner) -> Result<Document> {
    let chances = Chances { own_cache: OWN_CACHE, ..runner.chances };
    let whole = Scenario { parts: 1, ..Scenario::SHOTS }.world(chances)?;
    let parts = Scenario::SHOTS.world(chances)?;
    let runs = [PolicyKind::Planned, PolicyKind::Deadline].map(|kind| (kind, 100));
    let whole = runner.world("in one piece".to_owned(), &whole, &runs[..1])?;
    let parts = runner.world("in parts".to_owned(), &parts, &runs)?;
    let promised = |world: &Simulated| world.reports.first().map_or(0, |report| report.promised);
    let more = promised(&parts) as f64 / promised(&whole).max(1) as f64 - 1.0;
    let kept = parts.reports.first().map_or(0.0, Report::kept);
    let findings = vec![
        Finding {
            what: "more jobs are promised with caches in parts".to_owned(),
            found: more,
            wanted: SHOTS_MORE,
            at_most: false,
            reached: more >= SHOTS_MORE,
        },
        Finding {
            what: "of these promises at 80 % were kept".to_owned(),
            found: kept,
            wanted: PROMISES[0].1,
            at_most: false,
            reached: kept >= PROMISES[0].1,
        },
    ];
    Ok(Document { worlds: vec![whole, parts], findings })
}

/// The same stills whole, and in parts.
fn stills(runner: &Runner) -> Result<Document> {
    let world = |parts: u32| World::new(draw_stills(parts, runner.chances.seed), runner.chances);
    let runs = [(PolicyKind::Planned, 100)];
    let whole = runner.world("whole frames".to_owned(), &world(1)?, &runs)?;
    let parts = runner.world("frames in parts".to_owned(), &world(STILL_PARTS)?, &runs)?;
    let mut findings = Vec::new();
    if let Some((before, after)) = whole.reports.first().zip(parts.reports.first()) {
        let saved = 1.0 - after.median_hours / before.median_hours.max(f64::MIN_POSITIVE);
        let more = after.cost as f64 / before.cost.max(1) as f64 - 1.0;
        findings = vec![
            Finding {
                what: format!(
                    "of the median time from submit to image is saved: {} instead of {}",
                    hours(after.median_hours),
                    hours(before.median_hours)
                ),
                found: saved,
                wanted: STILLS_SAVE,
                at_most: false,
                reached: saved >= STILLS_SAVE,
            },
            Finding {
                what: "more is paid".to_owned(),
                found: more,
                wanted: STILLS_COST,
                at_most: true,
                reached: more <= STILLS_COST,
            },
        ];
    }
    Ok(Document { worlds: vec![whole, parts], findings })
}

fn hours(hours: f64) -> String {
    format!("{hours:.2} h")
}

fn text(document: &Document) -> String {
    let mut text = String::new();
    for world in &document.worlds {
        text += &format!(
            "{}: {} nodes, {} jobs, seed {}\n\n",
            world.name, world.nodes, world.jobs, world.chances.seed
        );
        text += &table(world).render();
        if let Some(first) = world.reports.first() {
            text += &format!(
                "\nNo schedule that keeps all deadlines costs less than {}.\n\n",
                money(first.cost_bound)
            );
        }
    }
    for finding in &document.findings {
        let verdict = if finding.reached { "reached" } else { "missed" };
        text += &format!(
            "{:.1} % {} (required: at {} {:.0} %): {verdict}\n",
            finding.found * 100.0,
            finding.what,
            if finding.at_most { "most" } else { "least" },
            finding.wanted * 100.0
        );
    }
    text
}

fn table(world: &Simulated) -> Table {
    let mut table = Table::new(&[
        ("policy", Align::Left),
        ("pool", Align::Right),
        ("promised", Align::Right),
        ("kept", Align::Right),
        ("in time", Align::Right),
        ("median time", Align::Right),
        ("late, mean", Align::Right),
        ("late, P95", Align::Right),
        ("cost", Align::Right),
        ("of bound", Align::Right),
        ("rented", Align::Right),
        ("useful", Align::Right),
        ("busy", Align::Right),
        ("makespan", Align::Right),
        ("lost", Align::Right),
        ("plans", Align::Right),
    ]);
    let per_cent = |share: f64| format!("{:.1} %", share * 100.0);
    for report in &world.reports {
        table.row([
            report.policy.name().to_owned(),
            format!("{} %", report.pool),
            report.promised.to_string(),
            per_cent(report.kept()),
            per_cent(report.on_time()),
            hours(report.median_hours),
            format!("{:.1} h", report.mean_hours_late),
            format!("{:.1} h", report.hours_late_p95),
            money(report.cost),
            format!("{:.2}", report.over_bound()),
            format!("{:.0} h", report.rented_hours),
            per_cent(report.useful),
            per_cent(report.utilisation),
            format!("{:.0} h", report.makespan_hours),
            (report.lost + report.evicted).to_string(),
            report.plans.to_string(),
        ]);
    }
    table
}
