//! `forelight audit`: who did what, when, and from where.

use crate::connection::{ConnectionOptions, connect};
use anyhow::{Context, Result};
use forelight_protocol::{AuditAction, AuditEntry, Timestamp};
use forelight_terminal::atomic_file;
use forelight_terminal::failure::BadInput;
use forelight_terminal::options::duration;
use forelight_terminal::output;
use forelight_terminal::quantities::clock;
use forelight_terminal::table::{Align, Table};
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Duration;

/// Show who submitted, cancelled, changed or ordered what, newest first
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight audit --data farm-data
  forelight audit --who anna --since 7d --data farm-data
  forelight audit --action job_cancelled --project hero-film --data farm-data
  forelight audit --export audit.csv --since 365d --data farm-data

Needs an operator's token. Entries never change. An export has all entries since then, oldest first: `.csv` for \
spreadsheets, `.ndjson` for programs. Nodes, and what was made within the shown time, are named; --json has all ids \
and all that was asked for.")]
pub struct Args {
    /// Show only what this person or service did, by the name of the token
    #[arg(long, value_name = "NAME")]
    who: Option<String>,
    /// Show only this action, such as job_cancelled
    #[arg(long, value_name = "ACTION")]
    action: Option<AuditAction>,
    /// Show only what was done with this: the id of a job, node or token, or a project
    #[arg(long, value_name = "ID")]
    target: Option<String>,
    /// Show only what concerns this project
    #[arg(long, value_name = "NAME")]
    project: Option<String>,
    /// Show only what was done within this time, such as 7d
    #[arg(long, value_name = "DURATION", value_parser = duration)]
    since: Option<Duration>,
    /// Show at most this many entries, the newest: 1 to 200
    #[arg(long, value_name = "COUNT", default_value_t = 50, value_parser = clap::value_parser!(u32).range(1..=200))]
    most: u32,
    /// Write all entries to this file, NAME.csv or NAME.ndjson
    #[arg(long, value_name = "FILE", conflicts_with_all = ["who", "action", "target", "project", "json"])]
    export: Option<PathBuf>,
    /// Print the entries as JSON to standard output
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    connection: ConnectionOptions,
}

pub async fn run(args: Args) -> Result<()> {
    let now = Timestamp::now();
    let back =
        |time: Duration| now.plus_micros(-i64::try_from(time.as_micros()).unwrap_or(i64::MAX)).to_string();
    let since = args.since.map(back);
    let since = since.as_deref().map(|since| ("from", since));
    if let Some(path) = &args.export {
        atomic_file::check([Some(&**path)])?;
        let format = match path.extension().and_then(|end| end.to_str()) {
            Some("csv") => "csv",
            Some("ndjson") => "ndjson",
            _ => return Err(BadInput::new("--export: the file's name ends in .csv or .ndjson").into()),
        };
        let filters: Vec<_> = since.into_iter().collect();
        let exported = connect(&args.connection)?.audit_export(format, &filters).await;
        return atomic_file::write_bytes(path, &exported.context("cannot export the audit")?);
    }
    let filters = [
        ("actor", args.who.as_deref()),
        ("action", args.action.map(AuditAction::name)),
        ("target", args.target.as_deref()),
        ("project", args.project.as_deref()),
    ];
    let filters = filters.into_iter().filter_map(|(name, value)| Some((name, value?)));
    let filters: Vec<_> = filters.chain(since).collect();
    let client = connect(&args.connection)?;
    let entries = client.newest_audit(&filters, args.most).await.context("cannot read the audit")?;
    if args.json {
        return output::json(&entries);
    }
    let nodes = client.nodes().await.context("cannot list the nodes")?;
    let mut names: BTreeMap<String, String> =
        nodes.into_iter().map(|node| (node.id.to_string(), node.name)).collect();
    // Whoever makes something names it.
    for entry in &entries {
        if let Some(name) = entry.detail.as_ref().and_then(|asked| asked.get("name")?.as_str()) {
            names.insert(entry.target.clone(), name.to_owned());
        }
    }
    output::print(&report(&entries, &names, now))
}

/// Most characters of what was asked for, in the table.
const MOST_ASKED: usize = 60;

/// What was asked for, in a few words such as `drain true, price_per_hour 5`.
fn asked_for(detail: &Value) -> String {
    let plain = |value: &Value| value.as_str().map_or_else(|| value.to_string(), str::to_owned);
    let fields = detail.as_object().into_iter().flatten().filter(|(_, value)| !value.is_null());
    let words: Vec<String> = fields.map(|(name, value)| format!("{name} {}", plain(value))).collect();
    let text = words.join(", ");
    let cut: String = text.chars().take(MOST_ASKED).collect();
    if cut.len() < text.len() { cut + "…" } else { cut }
}

fn report(entries: &[AuditEntry], names: &BTreeMap<String, String>, now: Timestamp) -> String {
    if entries.is_empty() {
        return "no entries match\n".into();
    }
    let mut table = Table::new(&[
        ("when", Align::Right),
        ("who", Align::Left),
        ("from", Align::Left),
        ("did", Align::Left),
        ("project", Align::Left),
        ("with", Align::Left),
        ("asked for", Align::Left),
    ]);
    for entry in entries {
        table.row([
            clock(entry.at, now),
            entry.actor.clone(),
            entry.from.clone().unwrap_or_else(|| "-".into()),
            entry.action.to_string(),
            entry.project.clone().unwrap_or_else(|| "-".into()),
            names.get(&entry.target).unwrap_or(&entry.target).clone(),
            entry.detail.as_ref().map_or_else(String::new, asked_for),
        ]);
    }
    table.render()
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn what_was_asked_for_is_short() {
        assert_eq!(
            asked_for(&json!({"drain": true, "speed": null, "name": "rack-1"})),
            "drain true, name rack-1"
        );
        let long = asked_for(&json!({"bundle": "x".repeat(100)}));
        assert!(long.ends_with("x…") && long.chars().count() == MOST_ASKED + 1, "{long}");
        assert_eq!(asked_for(&json!("text")), "");
    }
}
