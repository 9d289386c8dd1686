//! Background work of the service. One task advances jobs and plans the farm; one takes back expired leases;
//! one tells webhooks of events; one writes images where their jobs want them; one deletes every night what
//! is past its time; one looks whether stored content is still what it was; one sums the farm up for streams.

use std::panic::AssertUnwindSafe;
use std::sync::Arc;
use std::time::Duration;

use forelight_protocol::{JobId, Timestamp};
use forelight_store::StoreError;
use futures::FutureExt as _;
use tokio::sync::mpsc;
use tokio::task::JoinHandle;
use tokio::time::Instant;

use crate::clock::SteadyClock;
use crate::conductor::Conductor;
use crate::outputs::write_outputs;
use crate::state::App;
use crate::summaries::summarize;
use crate::webhooks::tell_webhooks;

/// Pause before a loop restarts after a panic.
const AFTER_PANIC: Duration = Duration::from_secs(1);

/// Whether a loop panicked and must restart. Without it the service would accept requests and never act on
/// them.
async fn again_after_panic(name: &str, run: impl Future<Output = ()>) -> bool {
    match AssertUnwindSafe(run).catch_unwind().await {
        Ok(()) => false,
        Err(_) => {
            tracing::error!("{name} panicked; restarting");
            tokio::time::sleep(AFTER_PANIC).await;
            true
        }
    }
}

/// Starts all loops. They end with the service.
pub(crate) fn in_background(
    app: &App,
    jobs: mpsc::UnboundedReceiver<JobId>,
    clock: Arc<SteadyClock>,
) -> Vec<JoinHandle<()>> {
    let (own, giving_way) = (app.for_service(), app.low_priority.handle());
    vec![
        tokio::spawn(run_sweep(app.clone(), clock)),
        tokio::spawn(run_rights(app.clone())),
        giving_way.spawn(run_conductor(own.clone(), jobs)),
        giving_way.spawn(run_webhooks(own.clone())),
        giving_way.spawn(run_outputs(own.clone())),
        giving_way.spawn(run_retention(own.clone())),
        giving_way.spawn(run_scrub(own.clone())),
        giving_way.spawn(run_summaries(own)),
    ]
}

async fn run_conductor(app: App, mut jobs: mpsc::UnboundedReceiver<JobId>) {
    while again_after_panic("advancing jobs", conduct(&app, &mut jobs)).await {}
}

async fn run_sweep(app: App, clock: Arc<SteadyClock>) {
    while again_after_panic("the sweep", sweep(&app, &clock)).await {}
}

async fn run_webhooks(app: App) {
    while again_after_panic("telling webhooks", tell_webhooks(&app)).await {}
}

async fn run_summaries(app: App) {
    while again_after_panic("summarising the farm", summarize(&app)).await {}
}

async fn run_outputs(app: App) {
    while again_after_panic("writing images", write_outputs(&app)).await {}
}

async fn run_retention(app: App) {
    while again_after_panic("the nightly deletion", delete_nightly(&app)).await {}
}

/// Time between two deletions: a day, in microseconds.
const A_DAY: i64 = 86_400_000_000;

/// A service that runs deletes every night. If the last deletion is longer ago than this, the clock may be
/// wrong, and a wrong clock would delete everything.
const LONGEST_PAUSE: i64 = 30 * A_DAY;

/// How often the time since the last deletion is looked at.
const LOOK: Duration = Duration::from_secs(600);

/// Whether it is time for the nightly deletion.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Deletion {
    Due,
    NotDue,
    /// Only if somebody says so.
    Doubtful,
}

impl Deletion {
    /// A last deletion in the future was made by a clock that was wrong.
    fn at(now: Timestamp, last: Option<Timestamp>) -> Self {
        match last.map(|last| now.micros_since(last)) {
            Some(0..A_DAY) => Self::NotDue,
            Some(LONGEST_PAUSE..) => Self::Doubtful,
            Some(_) | None => Self::Due,
        }
    }
}

/// Deletes once a day what is past its time.
async fn delete_nightly(app: &App) {
    let mut ticks = tokio::time::interval(LOOK);
    let mut is_told = false;
    loop {
        tokio::select! {
            () = app.stopping.cancelled() => return,
            _ = ticks.tick() => {}
        }
        let last = match app.store.last_prune().await {
            Ok(last) => last,
            Err(error) => {
                tracing::warn!(%error, "cannot read the time of the last deletion; trying again in ten minutes");
                continue;
            }
        };
        let deletion = Deletion::at(app.now(), last);
        if deletion == Deletion::Doubtful && !is_told {
            tracing::warn!(
                last = last.map(tracing::field::display),
                "the last deletion was more than 30 days ago, so the clock may be wrong: nothing is deleted by \
                 itself; if the clock is right, run `forelight prune` once"
            );
        }
        is_told = deletion == Deletion::Doubtful;
        if deletion == Deletion::Due
            && let Err(error) = delete(app).await
        {
            tracing::warn!(%error, "cannot delete what is past its time; trying again in ten minutes");
        }
    }
}

async fn delete(app: &App) -> Result<(), StoreError> {
    let Ok(_alone) = app.pruning.try_lock() else { return Ok(()) };
    let pruned = app.store.prune(false, app.now()).await?;
    for item in pruned.items.iter().filter(|item| item.number > 0) {
        tracing::info!(kind = item.kind.name(), number = item.number, "past their time and deleted");
    }
    if pruned.deleted.number > 0 {
        tracing::info!(files = pruned.deleted.number, bytes = pruned.deleted.bytes, "unused files deleted");
    }
    Ok(())
}

async fn run_scrub(app: App) {
    while again_after_panic("the scrub", scrub(&app)).await {}
}

/// The scrub looks at so many bytes at a time, and then rests.
const SCRUBBED_AT_ONCE: u64 = 16 << 20;
const SCRUB_RESTS: Duration = Duration::from_secs(4);

/// Rest after a round through all artefacts.
const AFTER_ROUND: Duration = Duration::from_secs(86_400);

/// Looks whether artefacts are still what they were, slowly and again and again: 4 MiB a second, or 300 GiB a
/// day.
async fn scrub(app: &App) {
    let mut rest = SCRUB_RESTS;
    loop {
        tokio::select! {
            () = app.stopping.cancelled() => return,
            () = tokio::time::sleep(rest) => {}
        }
        rest = SCRUB_RESTS;
        match app.store.artifacts().scrub_on(SCRUBBED_AT_ONCE, app.now()).await {
            Ok(part) => {
                for damaged in &part.damaged {
                    tracing::error!(reason = damaged, "stored content is damaged");
                }
                if part.next.is_none() {
                    rest = AFTER_ROUND;
                }
            }
            Err(error) => tracing::warn!(%error, "the scrub failed; it goes on where it was"),
        }
    }
}

async fn run_rights(app: App) {
    while again_after_panic("ending rights", watch_rights(&app)).await {}
}

/// Interval at which the service looks which rights have ended: by time, or by another process such as
/// `forelight token`. Those that end through the service are told at once.
const LOOKED_FOR: Duration = Duration::from_millis(250);

/// Looks for ended rights, and stores when tokens were used.
async fn watch_rights(app: &App) {
    let mut looks = tokio::time::interval(LOOKED_FOR);
    looks.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    loop {
        tokio::select! {
            () = app.stopping.cancelled() => break,
            _ = looks.tick() => {}
        }
        app.end_rights().await;
        store_uses(app, false).await;
    }
    store_uses(app, true).await;
}

async fn store_uses(app: &App, all: bool) {
    if let Err(error) = app.rights.store_uses(&app.store, all, app.now()).await {
        // Reading goes on while the disk is full.
        tracing::debug!(%error, "the uses of tokens were not stored");
    }
}

/// Shortest time between plans that no request waits for, or four times the last plan's duration if longer.
const BREATH: Duration = Duration::from_millis(500);

/// Advances announced jobs, and sometimes all waiting ones, since a transient error may have passed, and then
/// looks when quotes on hold would end. Makes one plan at a time; events meanwhile, or soon after, are covered
/// by the next plan.
async fn conduct(app: &App, jobs: &mut mpsc::UnboundedReceiver<JobId>) {
    let conductor =
        Conductor::new(app.store.clone(), app.clock.clone(), app.metrics.clone(), app.changes.clone());
    let mut again = tokio::time::interval(app.lease_ttl.max(Duration::from_secs(1)));
    let mut wanted = app.store.watch_plans();
    let mut not_before = Instant::now();
    // Work that was due when the service died is due now.
    let mut due = true;
    loop {
        tokio::select! {
            () = app.stopping.cancelled() => return,
            announced = jobs.recv() => match announced {
                Some(job) => conductor.advance(job).await,
                None => return,
            },
            changed = wanted.changed(), if !due => match changed {
                Ok(()) => due = true,
                Err(_) => return,
            },
            () = tokio::time::sleep_until(not_before), if due => {
                wanted.borrow_and_update();
                let begun = Instant::now();
                conductor.replan_if_due().await;
                due = false;
                not_before = Instant::now() + BREATH.max(begun.elapsed() * 4);
            },
            _ = again.tick() => {
                conductor.advance_all().await;
                conductor.watch().await;
                conductor.foresee_held_quotes().await;
                due = true;
            }
        }
    }
}

/// From this difference on, the clock was set. Time servers correct smaller ones all day.
const CLOCK_WAS_SET: Duration = Duration::from_secs(1);

/// Takes back tasks with expired leases, four times per lease duration, after following the system's clock.
async fn sweep(app: &App, clock: &SteadyClock) {
    let mut ticks = tokio::time::interval((app.lease_ttl / 4).max(Duration::from_millis(100)));
    ticks.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    let mut lacks_room = false;
    loop {
        tokio::select! {
            () = app.stopping.cancelled() => return,
            _ = ticks.tick() => {}
        }
        lacks_room = app.log_disk_space(lacks_room);
        if let Err(error) = follow(app, clock).await {
            tracing::warn!(%error, "the clock was set and could not be followed; the next sweep tries again");
        }
        match app.store.sweep(app.now()).await {
            Ok(swept) if swept.expired > 0 => {
                app.metrics.leases_expired.add(u64::from(swept.expired));
                tracing::info!(leases = swept.expired, "leases ran out; their tasks are ready again");
            }
            Ok(_) => {}
            Err(error) => tracing::warn!(%error, "the sweep failed; the next one tries again"),
        }
        match app.store.enforce_budgets(app.now()).await {
            Ok(0) => {}
            Ok(changed) => {
                tracing::info!(budgets = changed, "actions of budgets began or ended")
            }
            Err(error) => {
                tracing::warn!(%error, "the budgets could not be checked; the next sweep tries again")
            }
        }
    }
}

/// Follows a clock that was set, and moves all ends along. In this order, nothing seems to expire in between.
async fn follow(app: &App, clock: &SteadyClock) -> Result<(), StoreError> {
    let micros = clock.set_by();
    if micros.unsigned_abs() < CLOCK_WAS_SET.as_micros() as u64 {
        clock.follow(micros);
        return Ok(());
    }
    tracing::warn!(
        seconds = micros as f64 * 1e-6,
        "the system's clock was set; leases go on as long as they would have"
    );
    let _step = app.clock_steps.write().await;
    if micros < 0 {
        clock.follow(micros);
    }
    let moved = app.store.clock_was_set(micros).await;
    match (micros < 0, &moved) {
        (false, Ok(())) => clock.follow(micros),
        // The ends were not moved, so the clock goes back to where it was.
        (true, Err(_)) => clock.follow(-micros),
        _ => {}
    }
    moved
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn everything_is_deleted_only_by_a_clock_that_may_be_trusted() {
        let now = Timestamp::from_micros(1_000 * A_DAY);
        let after = |days: i64| Deletion::at(now, Some(now.plus_micros(-days * A_DAY)));
        assert_eq!(Deletion::at(now, None), Deletion::Due);
        assert_eq!((after(0), after(1), after(29)), (Deletion::NotDue, Deletion::Due, Deletion::Due));
        assert_eq!((after(30), after(3650)), (Deletion::Doubtful, Deletion::Doubtful));
        // The clock was wrong when something was last deleted.
        assert_eq!(after(-3650), Deletion::Due);
    }
}
