//! `forelight quota`: how much projects and tokens may take.

use crate::connection::{ConnectionOptions, connect};
use anyhow::{Context, Result};
use forelight_protocol::{Quota, QuotaList, QuotaRequest};
use forelight_terminal::output;
use forelight_terminal::quantities::{bytes, parse_bytes};
use forelight_terminal::table::{Align, Table};
use std::str::FromStr;

/// List the quotas of projects and tokens, or set one
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight quota --data farm-data
  forelight quota --project hero-film --storage 500GiB --open-jobs 200 --data farm-data
  forelight quota --who anna --open-jobs 20 --data farm-data
  forelight quota --project hero-film --storage none --data farm-data

A quota refuses what would be added: jobs, and uploads of scenes. Jobs that are there go on. Storage is that of all \
files of a project's jobs, or of a token's jobs and uploads; a file that several share counts once in each. Several \
tokens of one name share a quota.")]
pub struct Args {
    /// The project whose quota is set
    #[arg(long, value_name = "PROJECT", group = "whose")]
    project: Option<String>,
    /// Name of the token whose quota is set
    #[arg(long, value_name = "NAME", group = "whose")]
    who: Option<String>,
    /// Most bytes of files, such as 500GiB, or `none` [default: as it is]
    #[arg(long, value_name = "SIZE", requires = "whose", value_parser = |text: &str| Limit::read(text, parse_bytes))]
    storage: Option<Limit<u64>>,
    /// Most jobs that are not over, or `none` [default: as it is]
    #[arg(long, value_name = "COUNT", requires = "whose", value_parser = |text: &str| Limit::read(text, number))]
    open_jobs: Option<Limit<u32>>,
    /// Print the quotas as JSON to standard output
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    connection: ConnectionOptions,
}

/// A limit, or none.
#[derive(Debug, Clone, Copy)]
struct Limit<T>(Option<T>);

impl<T> Limit<T> {
    fn read(text: &str, parse: fn(&str) -> Result<T, String>) -> Result<Self, String> {
        if text == "none" { Ok(Self(None)) } else { parse(text).map(|limit| Self(Some(limit))) }
    }
}

fn number(text: &str) -> Result<u32, String> {
    u32::from_str(text).map_err(|_| "expected a number, or `none`".to_owned())
}

pub async fn run(args: Args) -> Result<()> {
    let client = connect(&args.connection)?;
    let mut quotas = client.quotas().await.context("cannot list the quotas")?;
    let asked = QuotaRequest { project: args.project, token: args.who, ..QuotaRequest::default() };
    if asked.project.is_some() || asked.token.is_some() {
        let is_asked =
            |had: &&Quota| had.allowed.project == asked.project && had.allowed.token == asked.token;
        let had = quotas.items.iter().find(is_asked).map(|had| had.allowed.clone()).unwrap_or_default();
        let request = QuotaRequest {
            storage_bytes: args.storage.map_or(had.storage_bytes, |limit| limit.0),
            open_jobs: args.open_jobs.map_or(had.open_jobs, |limit| limit.0),
            ..asked
        };
        quotas = client.set_quota(&request).await.context("cannot set the quota")?;
    }
    if args.json { output::json(&quotas) } else { output::print(&report(&quotas)) }
}

fn report(quotas: &QuotaList) -> String {
    if quotas.items.is_empty() {
        return "there are no quotas\n".into();
    }
    let mut table = Table::new(&[
        ("", Align::Left),
        ("name", Align::Left),
        ("storage", Align::Right),
        ("of", Align::Right),
        ("open jobs", Align::Right),
        ("of", Align::Right),
    ]);
    for Quota { allowed, used_storage_bytes, used_open_jobs } in &quotas.items {
        let (kind, name) = match (&allowed.project, &allowed.token) {
            (Some(project), _) => ("project", project.clone()),
            (None, token) => ("token", token.clone().unwrap_or_default()),
        };
        table.row([
            kind.to_owned(),
            name,
            bytes(*used_storage_bytes),
            allowed.storage_bytes.map_or("-".to_owned(), bytes),
            used_open_jobs.to_string(),
            allowed.open_jobs.map_or("-".to_owned(), |most| most.to_string()),
        ]);
    }
    table.render()
}
