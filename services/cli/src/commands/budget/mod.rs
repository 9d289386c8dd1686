//! `forelight budget`: forecasts the cost of nights against budgets, and sets the budgets.

mod page;
mod table;

use crate::connection::ConnectionOptions;
use crate::connection::connect;
use crate::data_folder;
use crate::failure::Threatened;
use anyhow::{Context, Result};
use clap::{Subcommand, ValueEnum};
use forelight_protocol::{
    BudgetAction, BudgetForecast, BudgetForecastRequest, BudgetList, BudgetPeriod, BudgetRequest,
    BudgetThreshold, Money, Night, Timestamp,
};
use forelight_store::Store;
use forelight_terminal::atomic_file::{self, write_bytes};
use forelight_terminal::failure::BadInput;
use forelight_terminal::output;
use forelight_terminal::quantities::parse_money;
use std::path::{Path, PathBuf};

/// Forecast the cost of tonight and later nights against budgets, or set budgets
#[derive(Debug, clap::Args)]
#[command(args_conflicts_with_subcommands = true)]
#[command(after_help = "\
Examples:
  forelight budget --data farm-data
  forelight budget --date 2026-03-01 --days 7 --html nights.html --csv nights.csv
  forelight budget set hero-film 250 --per night --warn 80 --drain 100 --stop 120
  forelight budget list --json
  forelight budget --database farm-data --json   without the service

A night is named by a date, and lasts 24 hours from noon of that date. Amounts stay below P50, P80 and P95 with that \
probability. The farm keeps one forecast for each first night, so that you may run the command as often as you like.

Exit codes for cron: 0 all budgets hold; 3 a budget is exceeded with a probability above 20 %; 1 and 2 as for all \
commands. deploy/forelight-budget.timer and deploy/forelight-budget.crontab run the command every evening.")]
pub struct Args {
    #[command(subcommand)]
    what: Option<What>,
    /// Date on which the first night begins, such as 2026-03-01 [default: tonight]
    #[arg(long, value_name = "YYYY-MM-DD", value_parser = parse_date)]
    date: Option<Date>,
    /// Number of nights, 1 to 60
    #[arg(long, value_name = "COUNT", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=60))]
    days: u32,
    /// Time zone of the nights, such as Europe/Berlin [default: this machine's]
    #[arg(long, value_name = "ZONE")]
    zone: Option<String>,
    /// Write the amounts by night, project, job and node class into this CSV file
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    /// Write the forecast as a page into this HTML file
    #[arg(long, value_name = "FILE")]
    html: Option<PathBuf>,
    /// Print the forecast as JSON to standard output
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    place: Place,
}

#[derive(Debug, clap::Args)]
struct Place {
    #[command(flatten)]
    connection: ConnectionOptions,
    /// Use this data folder of a farm on this machine instead of the service, which may run or not
    #[arg(long, value_name = "DIR", help_heading = "Connection")]
    database: Option<PathBuf>,
}

#[derive(Debug, Subcommand)]
enum What {
    Set(SetArgs),
    Remove(RemoveArgs),
    List(ListArgs),
}

/// Set a project's budget, and replace its budget for the same period
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight budget set hero-film 250
  forelight budget set hero-film 4000 --per month --warn 75 --stop 110 --zone Europe/Berlin

Without --warn, --drain and --stop, the farm warns at 80 % and starts no new tasks at 100 %.")]
struct SetArgs {
    /// Name of the project
    project: String,
    /// Amount in the farm's currency, such as 250
    #[arg(value_parser = parse_money)]
    amount: i64,
    /// Period of the budget
    #[arg(long, value_enum, default_value_t = Per::Night)]
    per: Per,
    /// Percentage of the budget at which the farm reports a warning event, 1 to 1000
    #[arg(long, value_name = "PERCENT", value_parser = clap::value_parser!(u32).range(1..=1000))]
    warn: Option<u32>,
    /// Percentage at which the project's running tasks finish and no new ones start, 1 to 1000
    #[arg(long, value_name = "PERCENT", value_parser = clap::value_parser!(u32).range(1..=1000))]
    drain: Option<u32>,
    /// Percentage at which the project's running tasks stop, 1 to 1000
    #[arg(long, value_name = "PERCENT", value_parser = clap::value_parser!(u32).range(1..=1000))]
    stop: Option<u32>,
    /// Time zone of nights and months, such as Europe/Berlin [default: this machine's]
    #[arg(long, value_name = "ZONE")]
    zone: Option<String>,
    /// Print the budget as JSON to standard output
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    place: Place,
}

/// Remove a project's budget: what it held goes on
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight budget remove hero-film --data farm-data
  forelight budget remove hero-film --per month --server http://farm:7878 --token-file me.token")]
struct RemoveArgs {
    /// Name of the project
    project: String,
    /// Period of the budget
    #[arg(long, value_enum, default_value_t = Per::Night)]
    per: Per,
    #[command(flatten)]
    place: Place,
}

/// List all budgets with their use
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight budget list --data farm-data")]
struct ListArgs {
    /// Print the budgets as JSON to standard output
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    place: Place,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Per {
    /// The amount is for each night
    Night,
    /// The amount is for each month
    Month,
    /// The amount is for all time together
    Total,
}

impl From<Per> for BudgetPeriod {
    fn from(per: Per) -> Self {
        match per {
            Per::Night => Self::Night,
            Per::Month => Self::Month,
            Per::Total => Self::Total,
        }
    }
}

type Date = jiff::civil::Date;

fn parse_date(text: &str) -> Result<Date, String> {
    text.parse().map_err(|_| "expected a date such as 2026-03-01".to_owned())
}
pub async fn run(args: Args) -> Result<()> {
    match args.what {
        Some(What::Set(args)) => set(args).await,
        Some(What::Remove(args)) => remove(args).await,
        Some(What::List(args)) => list(args).await,
        None => forecast(args).await,
    }
}

async fn forecast(args: Args) -> Result<()> {
    atomic_file::check([args.csv.as_deref(), args.html.as_deref()])?;
    let failed = "cannot forecast the cost of nights";
    let (date, days, zone) = (args.date, args.days, zone(args.zone)?);
    let request = BudgetForecastRequest { date, days, zone, by_job: true, max_age: 0 };
    let found = match &args.place.database {
        Some(folder) => {
            let store = open(folder).await?;
            let found = forelight_api::budget_forecast(&store, &request, None, Timestamp::now()).await;
            store.close().await;
            found
                .map_err(|error| match error {
                    forelight_api::BudgetForecastError::Invalid { .. } => {
                        anyhow::Error::from(BadInput::new(error.to_string()))
                    }
                    other => other.into(),
                })
                .context(failed)?
        }
        None => connect(&args.place.connection)?.budget_forecast(&request).await.context(failed)?,
    };
    if let Some(path) = &args.csv {
        write_bytes(path, table::csv(&found).as_bytes())?;
    }
    if let Some(path) = &args.html {
        write_bytes(path, page::html(&found).as_bytes())?;
    }
    if args.json { output::json(&found) } else { output::print(&table::text(&found)) }?;
    threatened(&found)
}

/// An error with exit code 3 if a budget is threatened, for cron.
fn threatened(found: &BudgetForecast) -> Result<()> {
    let mut projects: Vec<&str> = found
        .budgets
        .iter()
        .filter(|budget| budget.threatened)
        .map(|budget| budget.project.as_str())
        .collect();
    projects.dedup();
    if projects.is_empty() {
        return Ok(());
    }
    Err(Threatened(format!("budgets are threatened: {}", projects.join(", "))).into())
}

async fn set(args: SetArgs) -> Result<()> {
    let asked =
        [(args.warn, BudgetAction::Warn), (args.drain, BudgetAction::Drain), (args.stop, BudgetAction::Stop)];
    let mut thresholds: Vec<BudgetThreshold> = asked
        .into_iter()
        .filter_map(|(percent, action)| Some(BudgetThreshold { percent: percent?, action }))
        .collect();
    if thresholds.is_empty() {
        thresholds = BudgetRequest::usual_thresholds();
    }
    if !(1..=200).contains(&args.project.trim().chars().count()) {
        return Err(BadInput::new("PROJECT: a name has 1 to 200 characters").into());
    }
    let request = BudgetRequest {
        project: args.project.trim().to_owned(),
        period: args.per.into(),
        amount: Money(args.amount),
        zone: zone(args.zone)?,
        thresholds,
    };
    let failed = || format!("cannot set the budget of project {}", request.project);
    let budget = match &args.place.database {
        Some(folder) => {
            let store = open(folder).await?;
            let set = store.set_budget(&request, Timestamp::now()).await;
            store.close().await;
            set.with_context(failed)?
        }
        None => connect(&args.place.connection)?.set_budget(&request).await.with_context(failed)?,
    };
    if args.json { output::json(&budget) } else { output::print(&table::budgets(&[budget])) }
}

async fn remove(args: RemoveArgs) -> Result<()> {
    let (project, period) = (args.project.trim(), args.per.into());
    match &args.place.database {
        Some(folder) => {
            let store = open(folder).await?;
            let removed = store.remove_budget(project, period, Timestamp::now()).await;
            store.close().await;
            removed.with_context(|| format!("cannot remove the budget of project {project}"))?;
        }
        None => {
            let client = connect(&args.place.connection)?;
            let removed = client.remove_budget(project, period).await;
            removed.with_context(|| format!("cannot remove the budget of project {project}"))?;
        }
    }
    output::line(format!(
        "the budget of project {project} is removed; `forelight budget list` shows the others"
    ))
}

async fn list(args: ListArgs) -> Result<()> {
    let found = match &args.place.database {
        Some(folder) => {
            let store = open(folder).await?;
            let items = store.budgets(Timestamp::now()).await;
            store.close().await;
            BudgetList { items: items.context("cannot list the budgets")? }
        }
        None => connect(&args.place.connection)?.budgets().await.context("cannot list the budgets")?,
    };
    if args.json { output::json(&found) } else { output::print(&table::budgets(&found.items)) }
}

async fn open(folder: &Path) -> Result<Store> {
    data_folder::check_farm("--database", folder)?;
    Store::open_beside(folder)
        .await
        .with_context(|| format!("cannot open the farm's data in {}", folder.display()))
}

fn zone(given: Option<String>) -> Result<String> {
    let zone = given.unwrap_or_else(|| jiff::tz::TimeZone::system().iana_name().unwrap_or("UTC").to_owned());
    if Night::of(&zone, Timestamp::now()).is_none() {
        return Err(BadInput::new(format!("--zone {zone}: this time zone is unknown"))
            .hint("write a name such as Europe/Berlin")
            .into());
    }
    Ok(zone)
}
