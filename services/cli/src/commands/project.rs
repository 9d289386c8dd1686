//! `forelight project`: the projects, and each one's share of the farm for jobs without a deadline.

use crate::connection::ConnectionOptions;
use crate::connection::connect;
use anyhow::{Context, Result};
use forelight_protocol::{ProjectList, ProjectRequest};
use forelight_terminal::output;
use forelight_terminal::table::{Align, Table};

/// List the projects, make one, or set its share of the farm
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight project --data farm-data
  forelight project hero-film --data farm-data
  forelight project hero-film 3 --data farm-data

A project exists before a submitter's jobs are booked on it; `default` always does. Setting a budget makes it too, and \
so does a job that an operator submits to it. Shares order jobs without a deadline. The first job is that of the project with the least use for its share. \
Use counts half after a week. A project has a share of 1 unless one was set.")]
pub struct Args {
    /// Name of the project [default: list all projects]
    project: Option<String>,
    /// Share to set, from 1 to 1000000, relative to the other projects' shares [default: as it is; 1 if it is
    /// new]
    #[arg(value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    share: Option<u32>,
    /// Print the shares as JSON to standard output
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    connection: ConnectionOptions,
}
pub async fn run(args: Args) -> Result<()> {
    let client = connect(&args.connection)?;
    if let Some(project) = args.project {
        let known = client.projects().await.context("cannot list the projects")?;
        let known = known.items.into_iter().find(|known| known.project == project);
        let share = args.share.or(known.map(|known| known.share)).unwrap_or(1);
        let request = ProjectRequest { project, share };
        client.set_share(&request).await.with_context(|| format!("project {}", request.project))?;
    }
    let projects = client.projects().await.context("cannot list the projects")?;
    if args.json { output::json(&projects) } else { output::print(&report(&projects)) }
}

fn report(projects: &ProjectList) -> String {
    let mut table = Table::new(&[
        ("project", Align::Left),
        ("share", Align::Right),
        ("node hours", Align::Right),
        ("for a share of 1", Align::Right),
    ]);
    for project in &projects.items {
        table.row([
            project.project.clone(),
            project.share.to_string(),
            format!("{:.2}", project.used_hours),
            format!("{:.2}", project.used_hours / f64::from(project.share.max(1))),
        ]);
    }
    table.render()
}
