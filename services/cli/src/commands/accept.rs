//! `forelight accept`: books a job that waits with its quote.

use super::cancel::find;
use crate::connection::{ConnectionOptions, connect};
use crate::job_options::deadline;
use anyhow::{Context, Result};
use forelight_protocol::{AcceptRequest, Confidence, Job, JobState, Money};
use forelight_terminal::failure::BadInput;
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
    #[arg(long, value_name = "AMOUNT", value_parser = parse_money)]
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
    let before = client.job(id).await.with_context(|| format!("cannot read job {id}"))?;
    if let Some(answer) = needless(&before, request == AcceptRequest::default())? {
        return if args.json { output::json(&before) } else { output::line(answer) };
    }
    let job = client.accept(id, &request).await.with_context(|| format!("cannot accept job {id}"))?;
    if args.json {
        return output::json(&job);
    }
    output::line(format!("{} ({id}) is accepted; `forelight status {id}` shows its booking", job.name))
}

/// What is said of a job that does not wait to be accepted. `None` if the service must decide.
///
/// # Errors
/// If it is accepted under other terms: these are for another command.
fn needless(job: &Job, keeps_terms: bool) -> Result<Option<String>, BadInput> {
    if job.hold || job.state.is_final() && job.state != JobState::Done {
        return Ok(None);
    }
    let Job { name, id, state, .. } = job;
    let reason = format!("{name} ({id}) is {state} and does not wait to be accepted");
    if keeps_terms {
        return Ok(Some(format!("{reason}; nothing was changed")));
    }
    let error = BadInput::new(reason);
    // The terms of a job that is over cannot be changed.
    if state.is_final() {
        return Err(error);
    }
    Err(error.hint(format!("`forelight change {id}` changes deadline, budget or confidence")))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::commands::status::tests::job;

    #[test]
    fn a_job_that_was_not_held_is_not_said_to_be_accepted() {
        let of = |hold: bool, state: JobState| Job { hold, state, ..job() };
        let said = needless(&of(false, JobState::Booked), true).unwrap().unwrap();
        assert!(said.contains("is booked and does not wait to be accepted; nothing was changed"), "{said}");
        let other = needless(&of(false, JobState::Booked), false).unwrap_err();
        assert!(other.advice().is_some_and(|hint| hint.contains("forelight change")), "{other}");
        for job in [of(true, JobState::Quoted), of(true, JobState::Profiling), of(false, JobState::Failed)] {
            assert_eq!(needless(&job, false).unwrap(), None, "{}", job.state);
        }
    }
}
