//! Which booked tasks an idle node may take (work stealing).
//!
//! The plan puts each frame where it costs least while deadlines are kept. A node that is idle beside it may
//! cost more. So it takes a frame that is booked on another node only for one of these reasons:
//!
//! | reason | why |
//! | --- | --- |
//! | the job has neither a deadline nor a budget | money was not weighed, and sooner is better |
//! | the plan does not keep the job's deadline, or no longer will | the deadline matters more than money |
//! | the idle node costs no more for such work than the booked one | the plan's cost is kept |
//! | the frame is [`OVERDUE`] or has no booking | its node is late |
//! | the frame has failed or lost its worker on another node | another node is the better experiment |
//! | the booked node gets no tasks, or is lost | no other node would render the frame |
//!
//! Otherwise the idle node waits, and says for which node.

use forelight_protocol::{ByClass, JobVerdict, Money, Node, Promise, Timestamp, Verdict};

use forelight_quote::serial_time::SerialTime;

use super::nodes::SAME_SPEED;

/// A frame that has not begun this long after its planned start may be taken by any idle node: a minute, in
/// microseconds. Plans are made of longer stretches.
pub const OVERDUE: i64 = 60_000_000;

/// Thousandths of a micro-unit in a micro-unit.
const THOUSANDTHS: f64 = 1e3;

/// Price of an hour of a core of speed 1 on this node for such work, in thousandths of a micro-unit.
pub(crate) fn rate(node: &Node, work: Option<&ByClass>) -> i64 {
    let speed = node.speed_for(work) * f64::from(node.cores);
    // Speeds are positive; the conversion saturates.
    (node.price_per_hour.micro_units() as f64 * THOUSANDTHS / speed).round() as i64
}

/// The lowest rate of a booking that a node of this rate may take. It is a little below the node's own:
/// measured speeds are never quite the same, and two equal machines must help each other.
pub(crate) fn least_rate(own: i64) -> i64 {
    (own as f64 / (1.0 + SAME_SPEED)) as i64
}

/// Whether a plan weighs this job's time against money.
pub(crate) fn is_bounded(deadline: Option<Timestamp>, budget: Option<Money>) -> bool {
    deadline.is_some() || budget.is_some()
}

/// Whether the plan does not keep the job's deadline, or no longer will: by what is left of its promise, or
/// without one by the plan's verdict.
pub(crate) fn is_at_risk(promise: Option<&Promise>, verdict: Option<&JobVerdict>) -> bool {
    match promise {
        Some(promise) => !promise.kept,
        None => verdict.is_some_and(|it| matches!(it.verdict, Verdict::Late | Verdict::Impossible)),
    }
}

/// Why a node stays idle, for people: `node` has work of the job booked at the rate `there`, and the idle
/// node's rate is `here`.
pub(crate) fn reason_to_wait(job: &str, node: &str, there: i64, here: i64) -> String {
    let money = |rate: i64| Money((rate as f64 / THOUSANDTHS).round() as i64);
    format!(
        "cheaper to wait for {node}: an hour of a core of speed 1 of job {job} costs {} there and {} here",
        money(there),
        money(here)
    )
}

/// What plans pay for the work of one job, node by node.
#[derive(Clone, Debug)]
pub(crate) struct Rates {
    /// The job's work by class; `None` before its forecast.
    pub work: Option<ByClass>,
    /// Whether the job has a deadline or a budget.
    pub is_bounded: bool,
    /// How long its frames keep a node beyond their CPU time.
    pub serial: SerialTime,
}

impl Rates {
    /// The rate on this node; `None` for a job that is not bounded, whose tasks any idle node may take.
    pub fn on(&self, node: &Node) -> Option<i64> {
        self.is_bounded.then(|| rate(node, self.work.as_ref()))
    }
}

#[cfg(test)]
mod tests {
    use forelight_protocol::{Confidence, JobId};

    use super::*;
    use crate::policy::nodes::tests::node;

    fn verdict(verdict: Verdict) -> JobVerdict {
        JobVerdict {
            job_id: JobId::new(),
            verdict,
            confidence: Confidence::P80,
            finish: None,
            cost: None,
            reasons: Vec::new(),
            ways_out: Vec::new(),
        }
    }

    #[test]
    fn a_node_twice_as_fast_at_twice_the_price_has_the_same_rate() {
        let slow = Node { speed: 1.0, cores: 4, price_per_hour: Money(1_000_000), ..node() };
        let fast = Node { speed: 2.0, price_per_hour: Money(2_000_000), ..slow.clone() };
        assert_eq!(rate(&slow, None), 250_000_000);
        assert_eq!(rate(&fast, None), rate(&slow, None));
    }

    #[test]
    fn equal_machines_whose_measured_speeds_differ_a_little_may_help_each_other() {
        let one = Node { speed: 1.0, price_per_hour: Money(1_000_000), ..node() };
        let other = Node { speed: 1.09, ..one.clone() };
        let dearer = Node { price_per_hour: Money(1_200_000), ..one.clone() };
        assert!(rate(&other, None) >= least_rate(rate(&one, None)));
        assert!(rate(&one, None) < least_rate(rate(&dearer, None)));
    }

    #[test]
    fn a_promise_goes_before_the_verdict_of_the_plan() {
        let at = Timestamp::from_micros(0);
        let promise = |kept| Promise { kept, probability: 0.5, finish: None, since: at, rescue: None };
        let late = verdict(Verdict::Late);
        assert!(is_at_risk(None, Some(&late)) && !is_at_risk(Some(&promise(true)), Some(&late)));
        assert!(is_at_risk(Some(&promise(false)), Some(&verdict(Verdict::OnTime))));
        assert!(!is_at_risk(None, Some(&verdict(Verdict::OnTime))) && !is_at_risk(None, None));
    }

    #[test]
    fn only_bounded_jobs_have_rates() {
        let rates = |is_bounded| Rates { work: None, is_bounded, serial: SerialTime::default() };
        assert_eq!(rates(false).on(&node()), None);
        assert_eq!(rates(true).on(&node()), Some(rate(&node(), None)));
        assert!(is_bounded(None, Some(Money(0))) && !is_bounded(None, None));
    }

    #[test]
    fn the_reason_to_wait_names_both_prices() {
        let reason = reason_to_wait("a shot", "rack 3", 500_000_000, 2_000_000_000);
        assert!(reason.contains("rack 3") && reason.contains("0.50 there and 2.00 here"), "{reason}");
    }
}
