//! Decides what to do about an element from its state in Slurm and its task's state in the store.

use forelight_store::Holding;

use super::answer::{SlurmJob, Stage};

#[derive(Clone, PartialEq, Eq, Debug)]
pub enum Step {
    Leave,
    Cancel,
    /// Record how it ended.
    End(String),
}

/// Outcome of elements that Slurm no longer knows. Slurm forgets ended jobs after minutes (`MinJobAge`), and
/// all jobs if it loses its state.
pub const UNKNOWN: &str = "unknown to Slurm";

/// Decides the next step. `seen` is `None` if Slurm does not know the element.
pub fn next_step(held: Holding, seen: Option<&SlurmJob>) -> Step {
    let Some(job) = seen else {
        return match held {
            // A worker holds the lease, whatever Slurm knows. When the lease ends, the task is done or ready.
            Holding::Leased => Step::Leave,
            Holding::Ready | Holding::Done | Holding::Withdrawn => Step::End(UNKNOWN.to_owned()),
        };
    };
    match (job.stage(), held) {
        (Stage::Ended, Holding::Leased) => Step::Leave,
        (Stage::Ended, Holding::Ready | Holding::Done | Holding::Withdrawn) => Step::End(job.outcome()),
        // Requeued although its task is done, or withdrawn.
        (Stage::Pending | Stage::Stuck, Holding::Done | Holding::Withdrawn) => Step::Cancel,
        (Stage::Stuck, Holding::Ready) => Step::Cancel,
        (Stage::Running, Holding::Withdrawn) => Step::Cancel,
        // It has delivered its result and is about to end.
        (Stage::Running, Holding::Done) => Step::Leave,
        (Stage::Pending | Stage::Running, Holding::Ready | Holding::Leased) => Step::Leave,
        (Stage::Stuck, Holding::Leased) => Step::Leave,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::slurm::answer::Ending;

    fn job(state: &str) -> SlurmJob {
        SlurmJob {
            array: 1,
            elements: vec![0..=0],
            state: state.to_owned(),
            reason: String::new(),
            ending: Ending::default(),
            comment: String::new(),
        }
    }

    #[test]
    fn what_ended_is_not_handed_out_again_while_somebody_still_holds_its_task() {
        for state in ["NODE_FAIL", "CANCELLED", "TIMEOUT", "COMPLETED"] {
            assert_eq!(next_step(Holding::Leased, Some(&job(state))), Step::Leave, "{state}");
            assert_eq!(next_step(Holding::Ready, Some(&job(state))), Step::End(state.to_owned()), "{state}");
        }
        assert_eq!(next_step(Holding::Leased, None), Step::Leave);
        assert_eq!(next_step(Holding::Ready, None), Step::End(UNKNOWN.to_owned()));
    }

    #[test]
    fn what_nobody_wants_any_more_is_taken_back_and_what_is_just_ending_is_not() {
        assert_eq!(next_step(Holding::Withdrawn, Some(&job("RUNNING"))), Step::Cancel);
        assert_eq!(next_step(Holding::Withdrawn, Some(&job("PENDING"))), Step::Cancel);
        assert_eq!(next_step(Holding::Done, Some(&job("PENDING"))), Step::Cancel);
        assert_eq!(next_step(Holding::Done, Some(&job("RUNNING"))), Step::Leave);
        assert_eq!(next_step(Holding::Done, Some(&job("COMPLETED"))), Step::End("COMPLETED".to_owned()));
    }

    #[test]
    fn what_slurm_put_back_into_the_queue_waits_there_for_its_turn() {
        assert_eq!(next_step(Holding::Ready, Some(&job("PENDING"))), Step::Leave);
        assert_eq!(next_step(Holding::Leased, Some(&job("PENDING"))), Step::Leave);
        let held = SlurmJob { reason: "launch_failed_requeued_held".to_owned(), ..job("PENDING") };
        assert_eq!(next_step(Holding::Ready, Some(&held)), Step::Cancel);
    }
}
