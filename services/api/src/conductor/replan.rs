//! New plans after events, which the database counts (`forelight_store::Wanted`). Three cases write no event
//! and are watched for here: a node that falls silent or returns, a job that will miss its promise although its
//! frames are on forecast, and a budget that was to hold a job by now.

use std::collections::{BTreeMap, BTreeSet};

use forelight_protocol::{NodeId, PlanReason};
use forelight_store::{NewPlan, Projected, StoreError, project};

use super::bookable::bookable;
use super::farm::{Farm, MOST_NODES, Snapshot};
use super::settle::{Settled, settle};
use super::watched::Waiting;
use super::{ATTEMPTS, AdvanceError, Conductor, compute};

impl Conductor {
    /// Plans the farm anew if the newest plan is outdated. Returns whether a plan was made or confirmed.
    pub async fn replan_if_due(&self) -> bool {
        for _ in 0..ATTEMPTS {
            match self.store.wanted_plan().await {
                Ok(wanted) if !wanted.due => return false,
                Ok(_) => {}
                Err(error) => {
                    tracing::warn!(%error, "it could not be read whether a plan is due");
                    return false;
                }
            }
            match self.replan().await {
                Ok(()) => return true,
                Err(AdvanceError::Store(StoreError::Conflict(reason))) => {
                    tracing::info!(reason, "the plan is made again");
                }
                Err(error) => {
                    tracing::warn!(%error, "no new plan could be made; the next round tries again");
                    return true;
                }
            }
        }
        true
    }

    async fn replan(&self) -> Result<(), AdvanceError> {
        let now = self.clock.now();
        let snapshot = Snapshot::read(&self.store, now).await?;
        let (parent, wanted) = (snapshot.parent, snapshot.wanted.clone());
        if snapshot.jobs.is_empty() {
            return Ok(self.store.plan_still_good(&wanted).await?);
        }
        let settled = compute(move || Ok(settle(&Farm::new(&snapshot), None))).await?;
        let Settled { jobs, outlooks, finish, .. } = self.passed(settled)?;
        let causes = wanted.causes.join("; ");
        let rebooked = jobs.len();
        let reason = PlanReason::Events;
        let new = NewPlan { parent, reason, wanted, jobs, outlooks, finish, shared_cache: None };
        if rebooked == 0 {
            self.store.keep_outlooks(&new, self.clock.now()).await?;
            tracing::debug!(causes, "the plan is still good");
        } else {
            let plan = self.store.replan(&new, self.clock.now()).await?;
            self.note_plan();
            tracing::info!(%plan, rebooked, causes, "planned anew");
        }
        Ok(())
    }

    pub async fn watch(&self) {
        if let Err(error) = self.try_watch().await {
            tracing::warn!(%error, "the plan could not be checked against the farm; the next round tries again");
        }
    }

    async fn try_watch(&self) -> Result<(), StoreError> {
        let now = self.clock.now();
        let all = self.store.nodes(None, MOST_NODES).await?;
        let nodes: BTreeSet<NodeId> =
            bookable(all.clone(), now, self.store.up_since()).iter().map(|node| node.id).collect();
        let projected =
            project(&self.store.open_bookings().await?, &self.store.open_cache_parts().await?, now);
        let stranded: BTreeSet<Waiting> = projected
            .frames
            .iter()
            .filter(|frame| !frame.under_way && !nodes.contains(&frame.booking.node_id))
            .map(|Projected { booking, .. }| (booking.node_id, booking.job_id, booking.frame_part()))
            .collect();
        let ends = projected.ends();
        let mut names = BTreeMap::new();
        let mut late = BTreeMap::new();
        for (job, name, deadline) in self.store.kept_promises().await? {
            if let Some(finish) = ends.finish_of(job).filter(|&finish| finish > deadline) {
                names.insert(job, name);
                late.insert(job, finish);
            }
        }
        let mut watched = self.watched.lock().clone();
        let (returned, lost, late) =
            (watched.returned(nodes), watched.lost(stranded), watched.later(&late, now));
        let name = |node: &NodeId| all.iter().find(|other| other.id == *node).map_or("", |node| &node.name);
        let returned = returned.iter().map(|node| format!("node {} is back", name(node)));
        let lost = lost.iter().map(|node| format!("node {} is not responding", name(node)));
        let late = late.iter().map(|job| format!("job {} will miss its promise", names[job]));
        let held = self.store.past_budget_holds(now).await?;
        let held = held.iter().map(|job| format!("the budget of job {job} lasts longer than expected"));
        for cause in returned.chain(lost).chain(late).chain(held) {
            self.store.want_plan(&cause).await?;
        }
        // Not before, so that nothing is forgotten if the store fails.
        *self.watched.lock() = watched;
        Ok(())
    }
}
