//! Background work of the service. One task advances jobs and plans the farm; one takes back expired leases;
//! one tells webhooks of events.

use std::panic::AssertUnwindSafe;
use std::sync::Arc;
use std::time::Duration;

use forelight_protocol::JobId;
use forelight_store::{Store, StoreError};
use futures::FutureExt as _;
use tokio::sync::mpsc;
use tokio::time::Instant;

use crate::clock::SteadyClock;
use crate::conductor::Conductor;
use crate::rights::watch_rights;
use crate::state::App;
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

pub(crate) async fn run_conductor(app: App, mut jobs: mpsc::UnboundedReceiver<JobId>) {
    while again_after_panic("advancing jobs", conduct(&app, &mut jobs)).await {}
}

pub(crate) async fn run_sweep(app: App, clock: Arc<SteadyClock>) {
    while again_after_panic("the sweep", sweep(&app, &clock)).await {}
}

pub(crate) async fn run_webhooks(app: App) {
    while again_after_panic("telling webhooks", tell_webhooks(&app)).await {}
}

pub(crate) async fn run_rights(app: App) {
    while again_after_panic("ending rights", watch_rights(&app)).await {}
}

/// Shortest time between plans that no request waits for, or four times the last plan's duration if longer.
const BREATH: Duration = Duration::from_millis(500);

/// Advances announced jobs, and sometimes all waiting ones, since a transient error may have passed. Makes
/// one plan at a time; events meanwhile, or soon after, are covered by the next plan.
async fn conduct(app: &App, jobs: &mut mpsc::UnboundedReceiver<JobId>) {
    let conductor = Conductor::new(app.store.clone(), app.clock.clone(), app.metrics.clone());
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
        if let Err(error) = follow(&app.store, clock).await {
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
async fn follow(store: &Store, clock: &SteadyClock) -> Result<(), StoreError> {
    let micros = clock.set_by();
    if micros.unsigned_abs() < CLOCK_WAS_SET.as_micros() as u64 {
        clock.follow(micros);
        return Ok(());
    }
    tracing::warn!(
        seconds = micros as f64 * 1e-6,
        "the system's clock was set; leases go on as long as they would have"
    );
    if micros < 0 {
        clock.follow(micros);
    }
    let moved = store.clock_was_set(micros).await;
    match (micros < 0, &moved) {
        (false, Ok(())) => clock.follow(micros),
        // The ends were not moved, so the clock goes back to where it was.
        (true, Err(_)) => clock.follow(-micros),
        _ => {}
    }
    moved
}
