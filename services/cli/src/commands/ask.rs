//! `forelight ask`: asks the service about a job's plan.

use crate::connection::ConnectionOptions;
use crate::connection::connect;
use crate::job_options::{deadline, svg_file};
use crate::named::{JOBS, job_id};
use anyhow::{Context, Result};
use forelight_client::Client;
use forelight_protocol::words::counted;
use forelight_protocol::{
    AnswersDoc, CacheMode, Integrator, Job, Money, MovedJob, OutlookLine, PlanEffect, PriceOffer,
    RenderSettings, Timestamp, WaitKind,
};
use forelight_terminal::atomic_file::{self, write_bytes};
use forelight_terminal::output;
use forelight_terminal::quantities::{
    Deadline, clock, money, parse_deadline, parse_money, probability_in_words, with_local_times,
};
use forelight_terminal::table::{Align, Table};
use std::path::PathBuf;

/// Ask about a job's plan: its deadline, the price of other deadlines, and ways to be in time
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight ask hero-shot --data farm-data
  forelight ask hero-shot --deadline 2h --budget 12.50 --data farm-data
  forelight ask 0192f0c1-7a3b-7c55-8f00-0123456789ab --curve price.svg --json

The answers:
  whether the job keeps its deadline, or another one, at P50, P80 and P95
  the earliest finish for a budget, and the price of each deadline
  the qualities that fit
  the effect of one more node, one more hour, or the loss of a node
  the jobs that end later because of this one, and why this one waits
  if the deadline cannot be kept: the reason, and the cheapest ways to keep it

Asking changes nothing. Costs are those of the frames that are not done.")]
pub struct Args {
    /// Id or name of the job. Of several jobs with the same name, the newest booked one is used
    job: String,
    /// Deadline to ask about: 2h, 06:00, 'tomorrow 06:00', or 2030-03-01T06:00:00Z [default: the job's deadline]
    #[arg(long, value_name = "WHEN", value_parser = parse_deadline, allow_hyphen_values = true)]
    deadline: Option<Deadline>,
    /// Budget for the rest of the job, in the farm's currency, such as 12.50 [default: the job's budget]
    #[arg(long, value_name = "AMOUNT", value_parser = parse_money)]
    budget: Option<i64>,
    /// Draw the job's price against its deadline into this SVG file
    #[arg(long, value_name = "FILE.svg", value_parser = svg_file)]
    curve: Option<PathBuf>,
    /// Print the answers as JSON to standard output
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    connection: ConnectionOptions,
}

/// Answers of this age, in microseconds, say how old they are. The service makes them once a minute.
const OLD: i64 = 5_000_000;

pub async fn run(args: Args) -> Result<()> {
    atomic_file::check([args.curve.as_deref()])?;
    let client = connect(&args.connection)?;
    let job = find(&client, &args.job).await?;
    let deadline = deadline(args.deadline, jiff::Timestamp::now())?;
    let found = client.answers(job.id, deadline, args.budget.map(Money)).await;
    let found = found.with_context(|| format!("cannot ask about {}", job.name))?;
    if let Some(path) = &args.curve {
        let svg = client.price_curve(job.id).await.context("cannot fetch the price curve")?;
        write_bytes(path, &svg)?;
    }
    if args.json { output::json(&found) } else { output::print(&report(&job, &found, Timestamp::now())) }
}

/// The job with this id, or the newest open and booked job with this name. If there is none, the newest job
/// with the name.
async fn find(client: &Client, text: &str) -> Result<Job> {
    if let Some(id) = job_id(text)? {
        return client.job(id).await.with_context(|| format!("cannot read job {id}"));
    }
    let named = client.jobs_named(text).await.context("cannot list the jobs")?;
    let open = named.iter().find(|job| !job.state.is_final() && job.plan_id.is_some());
    open.or(named.first()).cloned().ok_or_else(|| JOBS.missing(text, JOBS.none).into())
}

fn report(job: &Job, found: &AnswersDoc, now: Timestamp) -> String {
    let at = |instant: Timestamp| clock(instant, now);
    let mut text = heading(job, found, (now, &at));
    text += &outlook(&found.outlook, at);
    text += &offers(found, at);
    let ways = if is_late(found) { "Ways to keep the deadline" } else { "Ways out" };
    text += &listed(&format!("{ways}, cheapest first"), &found.ways_out, at);
    text += &curve(&found.curve, at);
    text += &qualities(found, at);
    text += &listed("What if", &found.what_if, at);
    text += &pushed_back(&found.pushes_back);
    if !found.left_out.is_empty() {
        text += &format!("\nnot answered within the time limit: {}\n", found.left_out.join(", "));
    }
    with_local_times(&text, now)
}

/// Whether it is the deadline that cannot be kept: there is a plan that keeps it if there is a cheapest one.
fn is_late(found: &AnswersDoc) -> bool {
    found.deadline.is_some() && found.cheapest.is_none()
}

/// The deadline, the reason for waiting, and the risk.
fn heading(job: &Job, found: &AnswersDoc, (now, at): (Timestamp, &dyn Fn(Timestamp) -> String)) -> String {
    let mut text = match found.deadline {
        Some(deadline) => format!("{}, deadline {}\n", job.name, at(deadline)),
        None => format!("{}, without a deadline\n", job.name),
    };
    if now.micros_since(found.at) >= OLD {
        text += &format!("as the farm stood at {}\n", at(found.at));
    }
    if let Some(waits) = &job.waits {
        text += &format!("{}\n", waits.because);
    }
    if let Some(promise) = job.promise.as_ref().filter(|promise| !promise.kept) {
        text += "its deadline is at risk\n";
        if let Some(rescue) = &promise.rescue {
            text += &format!("cheapest rescue: {}\n", rescue.words);
        }
    }
    if let Some(hold) = &job.budget_hold {
        text += &format!("{}\n\nIf the budget held nothing:\n", hold.because);
    }
    match job.waits.as_ref().map(|waits| waits.kind) {
        Some(WaitKind::Budget) => text += "\nIf the budget held it no longer:\n",
        Some(WaitKind::Paused) => text += "\nIf it were resumed now:\n",
        _ => {}
    }
    if let Some(probability) = found.probability {
        text += &format!("in time with a probability of {}\n", probability_in_words(probability));
    }
    text
}

/// Completion and cost at each confidence.
fn outlook(lines: &[OutlookLine], at: impl Fn(Timestamp) -> String) -> String {
    let mut table = Table::new(&[
        ("confidence", Align::Right),
        ("ready by", Align::Left),
        ("cost", Align::Right),
        ("at least", Align::Right),
        ("", Align::Left),
    ]);
    for line in lines {
        table.row([
            format!("{:?}", line.confidence),
            line.finish.map_or("never".into(), &at),
            money(line.cost.micro_units()),
            money(line.cost_at_least.micro_units()),
            line.in_time.map_or("", |in_time| if in_time { "in time" } else { "not in time" }).to_owned(),
        ]);
    }
    format!("\n{}", table.render())
}

/// The cheapest plan, the earliest finish for the budget, and why the deadline cannot be kept.
fn offers(found: &AnswersDoc, at: impl Fn(Timestamp) -> String) -> String {
    let mut text = String::new();
    if let Some(offer) = &found.cheapest {
        text += &format!("\ncheapest plan: {} by {}\n", money(offer.cost.micro_units()), at(offer.finish));
    }
    if let Some(answer) = &found.for_budget {
        let budget = money(answer.budget.micro_units());
        text += &match &answer.offer {
            Some(offer) => format!("for {budget}: ready by {} at the earliest\n", at(offer.finish)),
            None => format!("for {budget}: the budget is too small for any deadline\n"),
        };
    }
    if !found.why_not.is_empty() {
        text +=
            if is_late(found) { "\nThe deadline cannot be kept\n" } else { "\nIt cannot be done as asked\n" };
        text.extend(found.why_not.iter().map(|reason| format!("  {reason}\n")));
    }
    text
}

/// Error, completion and cost of other qualities.
fn qualities(found: &AnswersDoc, at: impl Fn(Timestamp) -> String) -> String {
    let offers = &found.qualities;
    if offers.is_empty() {
        return String::new();
    }
    let mut table = Table::new(&[
        ("samples", Align::Right),
        ("pixels", Align::Left),
        ("other settings", Align::Left),
        ("error", Align::Right),
        ("ready by", Align::Left),
        ("in time", Align::Right),
        ("cost", Align::Right),
        ("", Align::Left),
    ]);
    let asked = offers.iter().find(|offer| offer.asked_for).map(|offer| &offer.settings);
    for offer in offers {
        let settings = &offer.settings;
        table.row([
            settings.spp.to_string(),
            format!("{} × {}", settings.width, settings.height),
            asked.map_or_else(String::new, |asked| other_settings(settings, asked)),
            offer.error.map_or("-".into(), |error| format!("{:.1} %", error.p50 * 100.0)),
            offer.finish.map_or("never".into(), &at),
            offer.probability.map_or("-".into(), probability_in_words),
            money(offer.cost.micro_units()),
            match (offer.asked_for, offer.fits) {
                (true, true) => "as asked for",
                (true, false) if is_late(found) => "as asked for, too late",
                (true, false) => "as asked for, too dear",
                (false, true) => "fits",
                (false, false) => "",
            }
            .to_owned(),
        ]);
    }
    format!("\nQualities\n{}", table.render())
}

/// What differs from the job's settings, beside samples and size.
fn other_settings(settings: &RenderSettings, asked: &RenderSettings) -> String {
    let mut others = Vec::new();
    if settings.integrator != asked.integrator {
        others.push(settings.integrator.name().to_owned());
    }
    if settings.ambient_bounces != asked.ambient_bounces {
        others.push(counted(settings.ambient_bounces, "bounce"));
    }
    let cache = |of: &RenderSettings| (of.cache, of.cache_accuracy, of.cache_rays);
    let gathers = settings.integrator == Integrator::Ambient;
    match settings.cache {
        CacheMode::On if gathers && cache(settings) != cache(asked) => {
            let accuracy = f64::from(settings.cache_accuracy) / 1000.0;
            others.push(format!("cache {accuracy}, {} rays", settings.cache_rays));
        }
        CacheMode::Off if gathers && asked.cache == CacheMode::On => others.push("no cache".to_owned()),
        _ => {}
    }
    if settings.ambient_divisions != asked.ambient_divisions && settings.cache == CacheMode::Off && gathers {
        others.push(format!("{} divisions", settings.ambient_divisions));
    }
    others.join(", ")
}

fn pushed_back(jobs: &[MovedJob]) -> String {
    if jobs.is_empty() {
        return String::new();
    }
    let mut text = "\nJobs that end later because of this job\n".to_owned();
    for job in jobs {
        let missed = if job.breaks_promise { ", and misses its deadline" } else { "" };
        text += &format!("  {}: {}{missed}\n", job.name, later(job));
    }
    text
}

fn later(job: &MovedJob) -> String {
    forelight_terminal::quantities::seconds(job.later_ms as f64 / 1e3) + " later"
}

fn listed(title: &str, effects: &[PlanEffect], at: impl Fn(Timestamp) -> String) -> String {
    if effects.is_empty() {
        return String::new();
    }
    let mut text = format!("\n{title}\n");
    for effect in effects {
        let finish = effect.finish.map(|finish| format!("; ready by {}", at(finish))).unwrap_or_default();
        let late = if effect.in_time { "" } else { ", too late" };
        text += &format!("  {}{finish}{late}\n", effect.words);
    }
    text
}

/// The deadlines at which the price changes.
fn curve(offers: &[PriceOffer], at: impl Fn(Timestamp) -> String) -> String {
    let mut table =
        Table::new(&[("deadline", Align::Left), ("price", Align::Right), ("at least", Align::Right)]);
    let price = |offer: &PriceOffer| (offer.cost, offer.cost_at_least);
    for offer in offers.chunk_by(|one, next| price(one) == price(next)).filter_map(|same| same.first()) {
        table.row([
            at(offer.deadline),
            money(offer.cost.micro_units()),
            money(offer.cost_at_least.micro_units()),
        ]);
    }
    if offers.is_empty() { String::new() } else { format!("\n{}", table.render()) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use forelight_protocol::RenderSettingsRequest;

    #[test]
    fn qualities_are_told_apart_by_what_the_job_does_not_have() {
        let asked = RenderSettingsRequest::default().complete((160, 90));
        let other = |change: &dyn Fn(&mut RenderSettings)| {
            let mut settings = asked.clone();
            change(&mut settings);
            other_settings(&settings, &asked)
        };
        assert_eq!(other(&|_| ()), "");
        assert_eq!(other(&|settings| (settings.spp, settings.width) = (64, 320)), "");
        assert_eq!(other(&|settings| settings.integrator = Integrator::Path), "path");
        assert_eq!(other(&|settings| settings.ambient_bounces = 5), "5 bounces");
        assert_eq!(other(&|settings| settings.ambient_divisions = 8), "8 divisions");
        let cached = |settings: &mut RenderSettings| {
            (settings.cache, settings.cache_accuracy, settings.cache_rays) = (CacheMode::On, 150, 768);
        };
        assert_eq!(other(&cached), "cache 0.15, 768 rays");
        let mut with_cache = asked.clone();
        cached(&mut with_cache);
        assert_eq!(other_settings(&asked, &with_cache), "no cache");
    }

    #[test]
    fn a_price_is_listed_once() {
        let offer = |seconds: i64, cost: i64| PriceOffer {
            deadline: Timestamp::from_micros(seconds * 1_000_000),
            finish: Timestamp::from_micros(seconds * 1_000_000),
            cost: Money(cost),
            cost_at_least: Money(cost),
        };
        let text = curve(&[offer(1, 9), offer(2, 9), offer(3, 7), offer(4, 7)], |at| {
            format!("{}s", at.micros() / 1_000_000)
        });
        let rows: Vec<&str> =
            text.lines().skip(3).map(|line| line.split_whitespace().next().unwrap()).collect();
        assert_eq!(rows, ["1s", "3s"], "{text}");
    }
}
