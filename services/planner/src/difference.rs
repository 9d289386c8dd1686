//! Differences between two plans.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fmt;

use serde::{Deserialize, Serialize};

use crate::model::{Booking, JobPlan, Plan, PlanId, Task};

/// The difference between two plans.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Difference {
    /// The old plan.
    pub from: PlanId,
    /// The new plan.
    pub to: PlanId,
    /// Tasks that moved: old and new booking.
    pub moved: Vec<(Booking, Booking)>,
    /// Tasks with a booking in the new plan only.
    pub added: Vec<Booking>,
    /// Tasks with a booking in the old plan only.
    pub removed: Vec<Booking>,
    /// Jobs whose end changes, or whether their deadline is kept.
    pub jobs: Vec<JobDifference>,
    /// Change of the cost, micro-units.
    pub added_cost: i64,
}

/// The difference for one job.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct JobDifference {
    /// The job.
    pub job: u64,
    /// The old end. `None` if it had none.
    pub before: Option<i64>,
    /// The new end.
    pub after: Option<i64>,
    /// Whether the deadline was kept, and whether it is kept now.
    pub kept: (bool, bool),
}

/// A plan's bookings in order, as those of our plans are anyway.
fn sorted(plan: &Plan) -> Cow<'_, [Booking]> {
    let mut bookings = Cow::Borrowed(&*plan.bookings);
    if !bookings.is_sorted() {
        bookings.to_mut().sort_unstable();
    }
    bookings
}

/// The bookings of either list that the other does not have, by task. Both are sorted.
fn apart(old: &[Booking], new: &[Booking]) -> [BTreeMap<(u64, Task), Booking>; 2] {
    let [mut only_old, mut only_new] = [BTreeMap::new(), BTreeMap::new()];
    let (mut old, mut new) = (old.iter().peekable(), new.iter().peekable());
    while old.peek().is_some() || new.peek().is_some() {
        // The end of a list comes after all bookings.
        let order = match (old.peek(), new.peek()) {
            (Some(one), Some(other)) => one.cmp(other),
            (one, other) => other.is_some().cmp(&one.is_some()),
        };
        let (one, other) = (old.next_if(|_| order.is_le()), new.next_if(|_| order.is_ge()));
        match (one, other) {
            (Some(one), None) => only_old.insert((one.job, one.task), *one),
            (None, Some(other)) => only_new.insert((other.job, other.task), *other),
            _ => None,
        };
    }
    [only_old, only_new]
}

/// Compares two plans.
pub fn difference(before: &Plan, after: &Plan) -> Difference {
    difference_from(before.id(), before, after)
}

/// The same for an old plan whose identity is known.
pub(crate) fn difference_from(from: PlanId, before: &Plan, after: &Plan) -> Difference {
    // Most bookings are in both plans, so tasks are matched among the others alone.
    let [old, new] = apart(&sorted(before), &sorted(after));
    let moved = old.iter().filter_map(|(task, old)| Some((*old, *new.get(task)?)));
    let missing = |these: &BTreeMap<(u64, Task), Booking>, those: &BTreeMap<(u64, Task), Booking>| {
        these.iter().filter(|(task, _)| !those.contains_key(task)).map(|(_, booking)| *booking).collect()
    };
    let entries = |plan: &Plan| -> BTreeMap<u64, (Option<i64>, bool)> {
        let entry = |entry: &JobPlan| (entry.job, (entry.verdict.finish(), entry.verdict.is_kept()));
        plan.jobs.iter().map(entry).collect()
    };
    let entries = [entries(before), entries(after)];
    let mut ids: Vec<u64> = before.jobs.iter().chain(&after.jobs).map(|job| job.job).collect();
    ids.sort_unstable();
    ids.dedup();
    let jobs = ids.into_iter().filter_map(|job| {
        let [old, new] = [0, 1].map(|plan| entries[plan].get(&job).copied().unwrap_or((None, false)));
        (old != new).then_some(JobDifference { job, before: old.0, after: new.0, kept: (old.1, new.1) })
    });
    Difference {
        from,
        to: after.id(),
        moved: moved.collect(),
        added: missing(&new, &old),
        removed: missing(&old, &new),
        jobs: jobs.collect(),
        added_cost: after.cost.saturating_sub(before.cost),
    }
}

impl fmt::Display for Difference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let time = |instant: Option<i64>| match instant {
            None => "never".to_owned(),
            Some(instant) => {
                let at = jiff::Timestamp::from_microsecond(instant);
                at.map_or_else(|_| instant.to_string(), |at| at.to_string())
            }
        };
        writeln!(
            f,
            "plan {} after {}: {} moved, {} added, {} removed, cost {:+} micro-units",
            self.to,
            self.from,
            self.moved.len(),
            self.added.len(),
            self.removed.len(),
            self.added_cost
        )?;
        for job in &self.jobs {
            let word = match job.kept {
                (true, false) => " and misses its deadline now",
                (false, true) => " and keeps its deadline now",
                _ => "",
            };
            writeln!(f, "job {} ends {} instead of {}{word}", job.job, time(job.after), time(job.before))?;
        }
        for (old, new) in &self.moved {
            writeln!(
                f,
                "job {}, {}: node {} from {} instead of node {} from {}",
                new.job,
                new.task,
                new.node,
                time(Some(new.start)),
                old.node,
                time(Some(old.start))
            )?;
        }
        Ok(())
    }
}
