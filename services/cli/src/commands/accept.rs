//! `forelight accept`: books a job that waits with its quote.

use super::cancel::find;
use crate::connection::{ConnectionOptions, connect};
use crate::job_options::deadline;
use anyhow::{Context, Result};
use forelight_protocol::{AcceptRequest, Confidence, Money};
use forelight_terminal::output;
use forelight_terminal::quantities::{Deadline, parse_deadline, parse_money};

/// Accept the quote of a job that was submitted with --hold: the farm then books it
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight accept kitchen --data farm-data
  forelight accept 0192f0c1-7a3b-7c55-8f00-0123456789ab --deadline 6h --budget 12.50 --server http://farm:7878

What you leave out stays as it was submitted. `forelight ask` says what the job would cost and when it would be \
ready; `forelight cancel` drops it.")]
pub struct Args {
    /// Id or name of the job. Of several jobs with the name, the only open one is meant
    job: String,
    /// Time by which all frames must be ready: 2h, 06:00, 'tomorrow 06:00', or 2030-03-01T06:00:00Z
    #[arg(long, value_name = "WHEN", value_parser = parse_deadline, allow_hyphen_values = true)]
    deadline: Option<Deadline>,
    /// Largest cost of the job, such as 12.50
    #[arg(long, value_name = "AMOUNT", value_parser = parse_money, allow_negative_numbers = true)]
    budget: Option<i64>,
    /// Quantile of the forecast that the booking uses
    #[arg(long, value_name = "LEVEL")]
    confidence: Option<Confidence>,
    /// Print the job as JSON to standard output
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    connection: ConnectionOptions,
}

pub async fn run(args: Args) -> Result<()> {
    let client = connect(&args.connection)?;
    let id = find(&client, &args.job).await?;
    let deadline = deadline(args.deadline, jiff::Timestamp::now())?;
    let request = AcceptRequest { deadline, budget: args.budget.map(Money), confidence: args.confidence };
    let job = client.accept(id, &request).await.with_context(|| format!("cannot accept job {id}"))?;
    if args.json {
        return output::json(&job);
    }
    output::line(format!("{} ({id}) is accepted; `forelight status {id}` shows its booking", job.name))
}
