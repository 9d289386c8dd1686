//! `forelight plan`: reads a farm description, plans it, and answers what-if questions.

mod gantt;

use self::gantt::gantt;
use crate::job_options::svg_file;
use anyhow::{Result, anyhow};
use forelight_planner::{
    Change, Confidence, Description, Effect, Explanation, Input, Offer, Outlook, Plan, Simulation, Verdict,
    curve, earliest_for_budget, explain, outlook, plan, simulate, verify, ways_out, what_if,
};
use forelight_plots as plots;
use forelight_protocol::words::counted;
use forelight_terminal::atomic_file::{self, write_bytes};
use forelight_terminal::failure::BadInput;
use forelight_terminal::json_file;
use forelight_terminal::output;
use forelight_terminal::quantities::{money, parse_duration, parse_money, seconds};
use forelight_terminal::table::{Align, Table};
use serde::Serialize;
use std::path::PathBuf;

/// Plan the farm that a file describes: nodes, times, deadlines and cost
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight plan farm.json
  forelight plan farm.json --svg plan.svg --json > plan.json
  forelight plan farm.json --job hero-shot --curve price.svg --budget 250
  forelight plan farm.json --more cloud-1=4 --later hero-shot=2h --without farm-3

The fields of a farm description are documented in services/planner/README.md.")]
pub struct Args {
    /// Farm description, a JSON file
    farm: PathBuf,
    /// Draw the plan as a Gantt chart into this SVG file
    #[arg(long, value_name = "FILE.svg", value_parser = svg_file)]
    svg: Option<PathBuf>,
    /// Show this job's cost at each confidence and deadline, and the ways to make it possible
    #[arg(long, value_name = "NAME")]
    job: Option<String>,
    /// Draw the job's price against its deadline into this SVG file. Needs --job
    #[arg(long, value_name = "FILE.svg", requires = "job", value_parser = svg_file)]
    curve: Option<PathBuf>,
    /// Find the earliest deadline that this amount pays for, such as 250. Needs --job
    #[arg(long, value_name = "AMOUNT", requires = "job", value_parser = parse_money)]
    budget: Option<i64>,
    /// What if: add COUNT nodes like NODE, such as cloud-1=4. May be repeated
    #[arg(long, value_name = "NODE=COUNT", value_parser = parse_more)]
    more: Vec<(String, u32)>,
    /// What if: this node fails now. May be repeated
    #[arg(long, value_name = "NODE")]
    without: Vec<String>,
    /// What if: move the job's deadline back, such as hero-shot=2h. May be repeated
    #[arg(long, value_name = "JOB=DURATION", value_parser = parse_later)]
    later: Vec<(String, i64)>,
    /// Number of random scenarios to try the plan in. 0 skips the simulation
    #[arg(long, value_name = "COUNT", default_value_t = 500, value_parser = clap::value_parser!(u32).range(0..=100_000))]
    scenarios: u32,
    /// Seed of the random scenarios
    #[arg(long, value_name = "NUMBER", default_value_t = 0)]
    seed: u64,
    /// Print the plan and all answers as JSON to standard output
    #[arg(long)]
    json: bool,
}

fn parse_more(text: &str) -> Result<(String, u32), String> {
    let (name, count) = text.rsplit_once('=').ok_or("expected NODE=COUNT")?;
    let count = count.parse().ok().filter(|count| (1..=10_000).contains(count));
    Ok((name.to_owned(), count.ok_or("expected a count from 1 to 10000 after the =")?))
}

fn parse_later(text: &str) -> Result<(String, i64), String> {
    let (name, by) = text.rsplit_once('=').ok_or("expected JOB=DURATION")?;
    let micros = i64::try_from(parse_duration(by)?.as_micros()).map_err(|_| "too long".to_owned())?;
    Ok((name.to_owned(), micros))
}

#[derive(Debug, Serialize)]
struct Document {
    plan_id: String,
    plan: Plan,
    simulation: Option<Simulation>,
    explanations: Vec<Explanation>,
    #[serde(skip_serializing_if = "Option::is_none")]
    job: Option<Answers>,
    what_if: Vec<Effect>,
    jobs: Vec<(u64, String)>,
    nodes: Vec<(u64, String)>,
}

#[derive(Debug, Serialize)]
struct Answers {
    outlook: Vec<Outlook>,
    curve: Vec<Offer>,
    #[serde(skip_serializing_if = "Option::is_none")]
    earliest_for_budget: Option<Option<Offer>>,
    ways_out: Vec<Effect>,
}

/// Offers on a price curve.
const POINTS: u32 = 13;
pub fn run(args: &Args) -> Result<()> {
    atomic_file::check([args.svg.as_deref(), args.curve.as_deref()])?;
    let input = read(&args.farm)?;
    let found = plan(&input).map_err(|error| BadInput::new(format!("{}: {error}", args.farm.display())))?;
    if let Err(violations) = verify(&input, &found) {
        let first = violations.first().map(ToString::to_string).unwrap_or_default();
        return Err(anyhow!(
            "the planner made an invalid plan, please report it: {} violations, the first: {first}",
            violations.len()
        ));
    }
    let simulation = match args.scenarios {
        0 => None,
        count => Some(simulate(&input, &found, count, args.seed)?),
    };
    let job = args.job.as_ref().map(|name| answers(args, &input, name)).transpose()?;
    let mut effects = Vec::new();
    for change in changes(args, &input)? {
        effects.push(what_if(&input, &change)?);
    }
    if let Some(path) = &args.svg {
        write_bytes(path, gantt(&input, &found)?.as_bytes())?;
    }
    if let (Some(path), Some(answers)) = (&args.curve, &job) {
        write_bytes(path, price_curve(&answers.curve)?.as_bytes())?;
    }
    let document = Document {
        plan_id: found.id().to_string(),
        explanations: explain(&input, &found, |_| true)?,
        plan: found,
        simulation,
        job,
        what_if: effects,
        jobs: input.jobs.iter().map(|job| (job.id, job.name.clone())).collect(),
        nodes: input.nodes.iter().map(|node| (node.id, node.name.clone())).collect(),
    };
    if args.json { output::json(&document) } else { output::print(&report(&input, &document)) }
}

fn price_curve(offers: &[Offer]) -> Result<String> {
    let offer =
        |&Offer { deadline, cost, cost_bound, .. }: &Offer| plots::Offer { deadline, cost, cost_bound };
    Ok(plots::price_curve(&offers.iter().map(offer).collect::<Vec<_>>(), money)?)
}

fn read(path: &std::path::Path) -> Result<Input> {
    let description: Description = json_file::read(path)?;
    Ok(description
        .input(jiff::tz::db())
        .map_err(|error| BadInput::new(format!("{}: {error}", path.display())))?)
}

fn job_id(input: &Input, name: &str) -> Result<u64> {
    let found = input.jobs.iter().find(|job| job.name == name).map(|job| job.id);
    Ok(found
        .ok_or_else(|| BadInput::new(format!("there is no job named {name:?} in the farm description")))?)
}

fn node_id(input: &Input, name: &str) -> Result<u64> {
    let found = input.nodes.iter().find(|node| node.name == name).map(|node| node.id);
    Ok(found
        .ok_or_else(|| BadInput::new(format!("there is no node named {name:?} in the farm description")))?)
}

fn changes(args: &Args, input: &Input) -> Result<Vec<Change>> {
    let mut changes = Vec::new();
    for (name, count) in &args.more {
        changes.push(Change::MoreNodes { like: node_id(input, name)?, count: *count });
    }
    for name in &args.without {
        changes.push(Change::NodeGone { node: node_id(input, name)?, from: input.now });
    }
    for (name, by) in &args.later {
        changes.push(Change::Later { job: job_id(input, name)?, by: *by });
    }
    Ok(changes)
}

fn answers(args: &Args, input: &Input, name: &str) -> Result<Answers> {
    let job = job_id(input, name)?;
    Ok(Answers {
        outlook: outlook(input, job)?,
        curve: curve(input, job, POINTS)?,
        earliest_for_budget: args.budget.map(|budget| earliest_for_budget(input, job, budget)).transpose()?,
        ways_out: ways_out(input, job)?,
    })
}

/// Whether a job was late in more scenarios than its confidence allows, by over three standard errors. Frames
/// that vary much cause this: the last of the parallel frames ends later than planned.
fn is_beyond((late, scenarios): (f64, u32), confidence: Confidence) -> bool {
    let allowed: f64 = match confidence {
        Confidence::P50 => 0.5,
        Confidence::P80 => 0.2,
        Confidence::P95 => 0.05,
    };
    late > allowed + 3.0 * (allowed * (1.0 - allowed) / f64::from(scenarios.max(1))).sqrt()
}

/// A row for each job: whether and when it is ready, and what it costs.
fn jobs(input: &Input, document: &Document) -> Table {
    let mut table = Table::new(&[
        ("job", Align::Left),
        ("ready by", Align::Left),
        ("deadline", Align::Left),
        ("left", Align::Right),
        ("cost", Align::Right),
        ("late", Align::Right),
        ("", Align::Left),
    ]);
    for entry in &document.plan.jobs {
        let Some(job) = input.jobs.iter().find(|job| job.id == entry.job) else { continue };
        let risk = document.simulation.as_ref().and_then(|simulation| {
            let risk = simulation.jobs.iter().find(|risk| risk.job == entry.job)?;
            job.deadline.map(|_| (risk.probability(simulation.scenarios), simulation.scenarios))
        });
        let left = match &entry.verdict {
            Verdict::Feasible { slack, .. } => seconds(*slack as f64 / 1e6),
            Verdict::Late { by, .. } => format!("-{}", seconds(*by as f64 / 1e6)),
            _ => String::new(),
        };
        let mut word = match &entry.verdict {
            Verdict::Feasible { .. } if risk.is_some_and(|risk| is_beyond(risk, job.confidence)) => {
                format!("in time as planned, but late more often than {:?} allows", job.confidence)
            }
            Verdict::Feasible { .. } => "in time".to_owned(),
            Verdict::NoDeadline { .. } => String::new(),
            Verdict::Late { unavoidable: true, .. } => "late in every plan".to_owned(),
            Verdict::Late { .. } => "late".to_owned(),
            Verdict::Unplaced { shared_cache: true, .. } => "its shared cache has no free node".to_owned(),
            Verdict::Unplaced { frames, .. } => {
                let have = if frames.len() == 1 { "has" } else { "have" };
                format!("{} {have} no free node", counted(frames.len(), "frame"))
            }
        };
        if entry.within_budget == Some(false) {
            word += if word.is_empty() { "over budget" } else { ", over budget" };
        }
        table.row([
            job.name.clone(),
            entry.verdict.finish().map(clock).unwrap_or_default(),
            job.deadline.map(clock).unwrap_or_default(),
            left,
            money(entry.cost),
            risk.map_or(String::new(), |(late, _)| format!("{:.1} %", late * 100.0)),
            word,
        ]);
    }
    table
}

fn report(input: &Input, document: &Document) -> String {
    let found = &document.plan;
    let mut text = jobs(input, document).render();
    text += &format!(
        "\nplan {}: {} in {} for {}; no plan can cost less than {}\n",
        document.plan_id,
        counted(found.bookings.len(), "booking"),
        counted(found.rentals.len(), "rental"),
        money(found.cost),
        money(found.cost_bound)
    );
    if let Some(simulation) = &document.simulation {
        let [p50, p80, p95] = simulation.cost.map(money);
        text +=
            &format!("cost in {} scenarios: {p50} (P50), {p80} (P80), {p95} (P95)\n", simulation.scenarios);
    }
    if let Some(infeasible) = &found.infeasible {
        text += "\nNo plan keeps all deadlines. The farm has too little time for these jobs together: ";
        text += &infeasible.jobs.iter().map(|&job| job_name(input, job)).collect::<Vec<_>>().join(", ");
        text.push('\n');
        for short in &infeasible.short {
            let nodes = counted(short.nodes.len(), "node");
            text += &format!("  {} to {}: {nodes} needed in full\n", clock(short.start), clock(short.end));
        }
    }
    if !document.explanations.is_empty() {
        text += "\nWaiting jobs\n";
    }
    for explanation in &document.explanations {
        text += &format!("  {} {}\n", job_name(input, explanation.job), explanation.reason);
    }
    if let Some(answers) = &document.job {
        text += &answers_report(input, answers);
    }
    if !document.what_if.is_empty() {
        text += "\nWhat if\n";
    }
    for effect in &document.what_if {
        text += &format!("  {}\n", describe(input, effect));
    }
    text
}

fn answers_report(input: &Input, answers: &Answers) -> String {
    let mut table = Table::new(&[
        ("confidence", Align::Right),
        ("ready by", Align::Left),
        ("cost", Align::Right),
        ("", Align::Left),
    ]);
    for line in &answers.outlook {
        table.row([
            format!("{:?}", line.confidence),
            line.verdict.finish().map(clock).unwrap_or_default(),
            money(line.cost),
            if line.verdict.is_kept() { "in time" } else { "not in time" }.to_owned(),
        ]);
    }
    let mut text = format!("\n{}", table.render());
    let mut prices =
        Table::new(&[("deadline", Align::Left), ("price", Align::Right), ("at least", Align::Right)]);
    for offer in &answers.curve {
        prices.row([clock(offer.deadline), money(offer.cost), money(offer.cost_bound)]);
    }
    text += &format!("\n{}", prices.render());
    match &answers.earliest_for_budget {
        None => {}
        Some(None) => text += "\nthe budget is too small for any deadline\n",
        Some(Some(offer)) => {
            text += &format!(
                "\nthe budget pays for the deadline {}, at a price of {}\n",
                clock(offer.deadline),
                money(offer.cost)
            );
        }
    }
    if !answers.ways_out.is_empty() {
        text += "\nWays to keep the deadline, cheapest first\n";
    }
    for effect in &answers.ways_out {
        text += &format!("  {}\n", describe(input, effect));
    }
    text
}

fn describe(input: &Input, effect: &Effect) -> String {
    let change = match &effect.change {
        Change::MoreNodes { like, count } => {
            let name = input.nodes.iter().find(|node| node.id == *like).map_or("", |node| &node.name);
            format!("{count} more like {name}")
        }
        Change::NodeGone { node, .. } => {
            let name = input.nodes.iter().find(|other| other.id == *node).map_or("", |node| &node.name);
            format!("without {name}")
        }
        Change::Later { job, by } => {
            format!("{} later by {}", job_name(input, *job), seconds(*by as f64 / 1e6))
        }
        Change::Confidence { job, confidence } => format!("{} at {confidence:?}", job_name(input, *job)),
        Change::MakeWay { job } => format!("{} gives up its deadline", job_name(input, *job)),
        Change::Parts { job, parts } => {
            format!("frames of {} in up to {parts} parts", job_name(input, *job))
        }
        Change::NewJob { job } => format!("with {}", job.name),
    };
    let sign = if effect.added_cost < 0 { "" } else { "+" };
    let mut text = format!("{change}: {sign}{}", money(effect.added_cost));
    let list = |jobs: &[u64]| jobs.iter().map(|&job| job_name(input, job)).collect::<Vec<_>>().join(", ");
    if !effect.saved.is_empty() {
        text += &format!("; in time: {}", list(&effect.saved));
    }
    if !effect.broken.is_empty() {
        text += &format!("; late: {}", list(&effect.broken));
    }
    if !effect.pushed_back.is_empty() {
        let end = if effect.pushed_back.len() == 1 { "ends" } else { "end" };
        text += &format!("; {} {end} later", counted(effect.pushed_back.len(), "job"));
    }
    text
}

fn job_name(input: &Input, id: u64) -> String {
    input.jobs.iter().find(|job| job.id == id).map(|job| job.name.clone()).unwrap_or_default()
}

/// UTC.
fn clock(instant: i64) -> String {
    Some(forelight_plots::clock(instant))
        .filter(|text| !text.is_empty())
        .unwrap_or_else(|| "never".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;
    use forelight_planner::{Frame, Interval, Job, Node, SharedCache, WorkTotal};

    const HOUR: i64 = 3_600_000_000;

    fn reported(jobs: Vec<Job>) -> String {
        let node = |id| Node {
            id,
            name: format!("node-{id}"),
            speed: 1,
            calendar: vec![Interval { start: 0, end: Some(4 * HOUR) }],
            ..Node::default()
        };
        let input = Input { nodes: vec![node(1)], jobs, ..Input::default() };
        let found = plan(&input).unwrap();
        let document = Document {
            plan_id: found.id().to_string(),
            plan: found,
            simulation: None,
            explanations: Vec::new(),
            job: None,
            what_if: Vec::new(),
            jobs: Vec::new(),
            nodes: Vec::new(),
        };
        report(&input, &document)
    }

    fn job(id: u64, hours: &[u64]) -> Job {
        let total = hours.iter().sum::<u64>() * 3600;
        Job {
            id,
            name: format!("job-{id}"),
            total: WorkTotal { p50: total, p80: total, p95: total },
            frames: (0..)
                .zip(hours)
                .map(|(number, &h)| Frame { number, work: h * 3600, ..Frame::default() })
                .collect(),
            ..Job::default()
        }
    }

    #[test]
    fn one_thing_is_not_told_as_several_and_a_cache_without_a_place_is_named() {
        let one = reported(vec![job(1, &[1]), job(2, &[9])]);
        assert!(one.contains(": 1 booking in 1 rental for"), "{one}");
        assert!(one.contains("1 frame has no free node"), "{one}");
        let two = reported(vec![job(1, &[1, 1]), job(2, &[9, 9])]);
        assert!(two.contains(": 2 bookings in 1 rental for"), "{two}");
        assert!(two.contains("2 frames have no free node"), "{two}");
        let shared_cache = Some(SharedCache { class: 0, work: 9 * 3600, parts: 1 });
        let cached = reported(vec![Job { shared_cache, ..job(1, &[1]) }]);
        assert!(cached.contains("its shared cache has no free node"), "{cached}");
        let late = Job { deadline: Some(HOUR), ..job(1, &[2]) };
        let short = reported(vec![late]);
        assert!(short.contains(": 1 node needed in full"), "{short}");
    }
}
