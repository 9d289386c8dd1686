//! What would become of quotes on hold if they were accepted now.

use forelight_planner as planner;
use forelight_protocol::JobId;
use forelight_store::JobOutlook;

use super::book::quoted;
use super::budget_holds::budget_holds;
use super::farm::{Farm, Snapshot};
use super::risks::{Risk, risk};
use super::settle::{end, lacks_money};
use super::{AdvanceError, Conductor, compute};

/// Most quotes that are looked at in one round: the newest.
const MOST: u32 = 50;

impl Conductor {
    /// Keeps the outlooks of the quotes on hold up to date.
    pub async fn foresee_held_quotes(&self) {
        logged(async { self.foresee(&self.store.held_quotes(MOST).await?).await }.await);
    }

    /// Keeps the outlook of a quote up to date. The quote is good without it.
    pub(super) async fn foresee_held_quote(&self, quote: JobId) {
        logged(self.foresee(&[quote]).await);
    }

    /// Keeps the outlooks of these quotes up to date.
    async fn foresee(&self, quotes: &[JobId]) -> Result<(), AdvanceError> {
        if quotes.is_empty() {
            return Ok(());
        }
        let now = self.clock.now();
        let mut snapshot = Snapshot::read(&self.store, now).await?;
        for &quote in quotes {
            snapshot.jobs.extend(quoted(&self.store, quote, now).await?);
        }
        let outlooks = foreseen(snapshot, quotes.to_vec()).await?;
        Ok(self.store.keep_quotes_outlooks(&outlooks, now).await?)
    }
}

/// The outlook, or nothing where it failed.
pub(super) fn logged<T: Default>(foreseen: Result<T, AdvanceError>) -> T {
    foreseen.unwrap_or_else(|error| {
        tracing::warn!(%error, "when quotes on hold would end is not known; the next round tries again");
        T::default()
    })
}

/// What would become of these quotes, which are among the jobs of the farm. Each is planned around what is booked.
pub(super) async fn foreseen(
    farm: Snapshot,
    quotes: Vec<JobId>,
) -> Result<Vec<(JobId, JobOutlook)>, AdvanceError> {
    compute(move || {
        let farm = Farm::new(&farm);
        let places = quotes.iter().filter_map(|&quote| Some((quote, farm.place(quote)?)));
        places.map(|(quote, place)| Ok((quote, outlook(&farm, place)?))).collect()
    })
    .await
}

fn outlook(farm: &Farm, job: usize) -> Result<JobOutlook, AdvanceError> {
    let around = farm.around(job, &farm.standing);
    let plan = planner::plan(&around)?;
    let planned = end(farm, &plan, job);
    let takes = planned.map(|end| end.saturating_sub(farm.input.now));
    let budget_hold = budget_holds(farm, &plan, &around.fixed).swap_remove(job);
    let lacks_money = lacks_money(&farm.jobs[job], planned, budget_hold.as_ref());
    let Risk { probability, finish } = risk(farm, &around, &plan, job)?.given_money(lacks_money);
    Ok(JobOutlook { probability, finish, takes, budget_hold, ..JobOutlook::default() })
}
