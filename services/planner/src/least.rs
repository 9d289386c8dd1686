//! A lower bound on a farm's cost, without a plan.

use crate::admission::{MOST_ROWS, admit};
use crate::model::{Input, InputError, Job, Proof};
use crate::problem::Problem;
use crate::proof::{Counted, value};

/// Lower bound in micro-units on the cost of any plan. The plan keeps all deadlines that the linear programme
/// admits, and renders everything else at any time. This is the bound of [`crate::plan`], for farms that are
/// too large to plan at once.
///
/// # Errors
/// If the input is invalid.
pub fn least_cost(input: &Input) -> Result<i64, InputError> {
    input.check()?;
    let problem = Problem::new(input);
    let admission = admit(&problem, MOST_ROWS);
    let counted = |job: &Job| {
        let admitted = problem.job(job.id).is_some_and(|index| admission.admitted[index]);
        match job.deadline {
            Some(deadline) if admitted => Counted::By(deadline),
            _ => Counted::Whenever,
        }
    };
    let plain = value(input, &Proof::default(), true, counted);
    let priced = value(input, &admission.proof, true, counted);
    Ok(i64::try_from(plain.max(priced).max(0)).unwrap_or(i64::MAX))
}
