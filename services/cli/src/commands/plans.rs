//! `forelight plans`: the farm's plans, and what each plan changed.

use crate::connection::ConnectionOptions;
use crate::connection::connect;
use crate::named;
use anyhow::{Context, Result};
use forelight_protocol::{PlanId, PlanReason, PlanSummary, Timestamp};
use forelight_terminal::output;
use forelight_terminal::quantities::{clock, with_local_times};
use forelight_terminal::table::{Align, Table};

/// List the farm's newest plans, or show what one plan changed
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight plans --data farm-data
  forelight plans 0192f0c1-7a3b-7c55-8f00-0123456789ab --data farm-data
  forelight plans 0192f0c1-7a3b-7c55-8f00-0123456789ab --json

A plan never changes. A new plan replaces it when a job comes in, a node fails, frames take longer than \
forecast, or a calendar changes. The new plan moves as few bookings as possible.")]
pub struct Args {
    /// Id of the plan whose changes to show [default: list the newest plans]
    #[arg(value_parser = named::id::<PlanId>)]
    plan: Option<PlanId>,
    /// Print plans or changes as JSON to standard output
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    connection: ConnectionOptions,
}
pub async fn run(args: Args) -> Result<()> {
    let client = connect(&args.connection)?;
    let Some(plan) = args.plan else {
        let plans = client.newest_plans().await.context("cannot list the plans")?;
        return if args.json {
            output::json(&plans)
        } else {
            output::print(&report(&plans, Timestamp::now()))
        };
    };
    let found = client.plan_difference(plan).await.with_context(|| format!("cannot read plan {plan}"))?;
    if args.json {
        return output::json(&found);
    }
    let words: String = found.words.iter().map(|line| format!("{line}\n")).collect();
    output::print(&with_local_times(&words, Timestamp::now()))
}

fn report(plans: &[PlanSummary], now: Timestamp) -> String {
    if plans.is_empty() {
        return "there are no plans yet\n".into();
    }
    let mut table = Table::new(&[
        ("plan", Align::Left),
        ("made", Align::Left),
        ("books", Align::Right),
        ("because", Align::Left),
    ]);
    for plan in plans {
        let mut because = plan.causes.join("; ");
        if plan.reason == PlanReason::JobForecast {
            because = if because.is_empty() {
                "a job came in".to_owned()
            } else {
                format!("a job came in; {because}")
            };
        }
        table.row([plan.id.to_string(), clock(plan.created_at, now), plan.bookings.to_string(), because]);
    }
    table.render()
}
