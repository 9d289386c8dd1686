//! `forelight retention`, `forelight prune` and `forelight delete`: what is kept, and for how long.

use super::cancel::find_any;
use crate::connection::{ConnectionOptions, connect};
use crate::named::each;
use anyhow::{Context, Result};
use clap::Subcommand;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use forelight_protocol::words::counted;
use forelight_protocol::{Files, PruneRequest, Pruned, Retention, RetentionKind, RetentionRule};
use forelight_terminal::output;
use forelight_terminal::quantities::bytes;
use forelight_terminal::table::{Align, Table};

/// List how long the farm keeps things, or set it
#[derive(Debug, clap::Args)]
#[command(args_conflicts_with_subcommands = true)]
#[command(after_help = "\
Examples:
  forelight retention --data farm-data
  forelight retention set images 30 --data farm-data
  forelight retention set images forever --project hero-film --data farm-data
  forelight retention set audit forever --data farm-data

The farm deletes every night what is past its time. `forelight prune --dry-run` says what that is.")]
pub struct Args {
    #[command(subcommand)]
    what: Option<What>,
    /// Print the rules as JSON to standard output
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    connection: ConnectionOptions,
}

#[derive(Debug, Subcommand)]
enum What {
    Set(SetArgs),
}

/// Set how long one kind of thing is kept
#[derive(Debug, clap::Args)]
struct SetArgs {
    /// What the rule is about
    #[arg(value_parser = kinds())]
    kind: RetentionKind,
    /// Days after the end of the job, or `forever`
    #[arg(value_parser = parse_days)]
    days: Days,
    /// Set it for this project only: images, profiles, jobs
    #[arg(long, value_name = "PROJECT")]
    project: Option<String>,
    #[command(flatten)]
    connection: ConnectionOptions,
}

fn kinds() -> impl TypedValueParser<Value = RetentionKind> {
    let names = PossibleValuesParser::new(RetentionKind::ALL.map(RetentionKind::name));
    names.try_map(|text| {
        let known = RetentionKind::ALL.into_iter().find(|kind| kind.name() == text);
        known.ok_or("not a kind of thing that is kept")
    })
}

/// Number of days; `None` for ever.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Days(Option<u32>);

fn parse_days(text: &str) -> Result<Days, String> {
    if text == "forever" {
        return Ok(Days(None));
    }
    let days = text.strip_suffix('d').unwrap_or(text).parse();
    days.map(|days| Days(Some(days)))
        .map_err(|_| "write a number of days, such as 30, or `forever`".to_owned())
}

/// Delete what is past its time now, instead of tonight
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight prune --dry-run --data farm-data
  forelight prune --data farm-data

Files are deleted a day after nothing refers to them any more.")]
pub struct PruneArgs {
    /// Only say what would be deleted
    #[arg(long)]
    dry_run: bool,
    /// Print the result as JSON to standard output
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    connection: ConnectionOptions,
}

/// Delete jobs that have ended, with their images
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight delete 0192f0c1-7a3b-7c55-8f00-0123456789ab --data farm-data

What a job cost stays in the books of its project. Jobs that are done count in the track record: only an operator \
deletes them.")]
pub struct DeleteArgs {
    /// Ids of the jobs. A name works if only one job has it
    #[arg(required = true, value_name = "JOB")]
    jobs: Vec<String>,
    #[command(flatten)]
    connection: ConnectionOptions,
}

pub async fn run(args: Args) -> Result<()> {
    let retention = match args.what {
        Some(What::Set(set)) => {
            let rule = RetentionRule { project: set.project, kind: set.kind, days: set.days.0 };
            let client = connect(&set.connection)?;
            client.set_retention(&rule).await.context("cannot set the rule")?
        }
        None => connect(&args.connection)?.retention().await.context("cannot read the rules")?,
    };
    if args.json { output::json(&retention) } else { output::print(&rules(&retention)) }
}

pub async fn prune(args: PruneArgs) -> Result<()> {
    let client = connect(&args.connection)?;
    let pruned = client.prune(&PruneRequest { dry_run: args.dry_run }).await.context("cannot delete")?;
    if args.json { output::json(&pruned) } else { output::print(&report(&pruned)) }
}

pub async fn delete(args: DeleteArgs) -> Result<()> {
    let client = connect(&args.connection)?;
    // Nothing is deleted if one is not known.
    for wanted in &args.jobs {
        find_any(&client, wanted).await?;
    }
    each(&args.jobs, "deleted", async |wanted: &str| {
        let id = find_any(&client, wanted).await?;
        client.delete_job(id).await.with_context(|| format!("cannot delete job {wanted}"))?;
        output::line(format!("{id} is deleted"))
    })
    .await
}

fn rules(retention: &Retention) -> String {
    let mut table = Table::new(&[("kept", Align::Left), ("of project", Align::Left), ("days", Align::Right)]);
    for rule in &retention.items {
        table.row([
            rule.kind.name().to_owned(),
            rule.project.clone().unwrap_or_else(|| "all".to_owned()),
            rule.days.map_or_else(|| "forever".to_owned(), |days| days.to_string()),
        ]);
    }
    let last = retention.last.as_ref().map(|last| format!("\nlast deleted {}\n", last.at));
    table.render() + &last.unwrap_or_default()
}

fn report(pruned: &Pruned) -> String {
    let verb = if pruned.dry_run { "would be deleted" } else { "deleted" };
    let mut table = Table::new(&[(verb, Align::Left), ("number", Align::Right), ("files", Align::Right)]);
    for item in &pruned.items {
        let what = match item.kind {
            RetentionKind::Images => "images of jobs",
            RetentionKind::Profiles => "profiles of jobs",
            other => other.name(),
        };
        let size = if item.bytes > 0 { bytes(item.bytes) } else { String::new() };
        table.row([what.to_owned(), item.number.to_string(), size]);
    }
    let files = |what: &str, files: Files| {
        format!("{what}: {}, {}\n", counted(files.number, "file"), bytes(files.bytes))
    };
    table.render()
        + "\n"
        + &files(&format!("{verb} from the disk"), pruned.deleted)
        + &files("unused, and kept for a day", pruned.waiting)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn days_are_a_number_or_forever() {
        assert_eq!(parse_days("30"), Ok(Days(Some(30))));
        assert_eq!(parse_days("30d"), Ok(Days(Some(30))));
        assert_eq!(parse_days("forever"), Ok(Days(None)));
        for wrong in ["", "-1", "month", "3.5"] {
            assert!(parse_days(wrong).is_err(), "{wrong}");
        }
    }
}
