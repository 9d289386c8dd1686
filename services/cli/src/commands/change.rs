//! `forelight change`: other terms for a job.

use super::cancel::find;
use crate::connection::{ConnectionOptions, connect};
use crate::job_options::deadline;
use anyhow::{Context, Result};
use forelight_protocol::{Confidence, JobChange, Money};
use forelight_terminal::failure::BadInput;
use forelight_terminal::output;
use forelight_terminal::quantities::{Deadline, parse_deadline, parse_money};

/// Change a job's deadline, budget, confidence or priority; the farm is then planned again
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight change kitchen --deadline 'tomorrow 06:00' --data farm-data
  forelight change kitchen --priority 50 --data farm-data
  forelight change kitchen --no-deadline --budget 20 --server http://farm:7878 --token-file me.token

What you leave out stays. `forelight ask kitchen --deadline 3h` says first what another deadline would cost.")]
pub struct Args {
    /// Id or name of the job. Of several jobs with the name, the only open one is meant
    job: String,
    #[command(flatten)]
    terms: Terms,
    /// Print the job as JSON to standard output
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    connection: ConnectionOptions,
}

#[derive(Debug, clap::Args)]
#[group(required = true, multiple = true)]
struct Terms {
    /// Time by which all frames must be ready: 2h, 06:00, 'tomorrow 06:00', or 2030-03-01T06:00:00Z
    #[arg(long, value_name = "WHEN", value_parser = parse_deadline, allow_hyphen_values = true)]
    deadline: Option<Deadline>,
    /// Remove the deadline
    #[arg(long, conflicts_with = "deadline")]
    no_deadline: bool,
    /// Largest cost of the job, such as 12.50
    #[arg(long, value_name = "AMOUNT", value_parser = parse_money)]
    budget: Option<i64>,
    /// Remove the budget
    #[arg(long, conflicts_with = "budget")]
    no_budget: bool,
    /// Quantile of the forecast that the booking uses
    #[arg(long, value_name = "LEVEL")]
    confidence: Option<Confidence>,
    /// Priority, -1000 to 1000. Of jobs with the same deadline, or without one, the largest goes first. It may move
    /// others past their deadlines
    #[arg(long, value_name = "NUMBER", value_parser = clap::value_parser!(i32).range(-1000..=1000))]
    priority: Option<i32>,
}

pub async fn run(args: Args) -> Result<()> {
    let client = connect(&args.connection)?;
    let id = find(&client, &args.job).await?;
    let change = change(&args.terms, jiff::Timestamp::now())?;
    let job = client.change_job(id, &change).await.with_context(|| format!("cannot change job {id}"))?;
    if args.json {
        return output::json(&job);
    }
    output::line(format!("{} ({id}) is changed; `forelight status {id}` shows its booking", job.name))
}

fn change(terms: &Terms, now: jiff::Timestamp) -> Result<JobChange, BadInput> {
    let deadline = deadline(terms.deadline, now)?;
    Ok(JobChange {
        deadline: if terms.no_deadline { Some(None) } else { deadline.map(Some) },
        budget: if terms.no_budget { Some(None) } else { terms.budget.map(|budget| Some(Money(budget))) },
        confidence: terms.confidence,
        priority: terms.priority,
        paused: None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use forelight_protocol::Timestamp;

    #[test]
    fn terms_that_are_left_out_stay_and_others_are_set_or_removed() {
        let terms = Terms {
            deadline: None,
            no_deadline: true,
            budget: Some(5),
            no_budget: false,
            confidence: None,
            priority: Some(-3),
        };
        let changed = change(&terms, jiff::Timestamp::UNIX_EPOCH).unwrap();
        let expected = JobChange {
            deadline: Some(None),
            budget: Some(Some(Money(5))),
            priority: Some(-3),
            ..JobChange::default()
        };
        assert_eq!(changed, expected);
        let terms = Terms {
            deadline: Some(parse_deadline("2h").unwrap()),
            no_deadline: false,
            budget: None,
            no_budget: false,
            confidence: Some(Confidence::P95),
            priority: None,
        };
        let changed = change(&terms, jiff::Timestamp::UNIX_EPOCH).unwrap();
        let deadline = Some(Some(Timestamp::from_micros(7_200_000_000)));
        assert_eq!(
            changed,
            JobChange { deadline, confidence: Some(Confidence::P95), ..JobChange::default() }
        );
    }
}
