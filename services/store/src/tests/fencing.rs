//! Workers that die, sleep, repeat themselves, or are told to stop.

use forelight_protocol::{EventKind, FrameState, JobState, LeaseOrder, TaskError};

use super::*;
use crate::StoreError;
use crate::policy::retries::MAX_EXPIRIES;

fn error(message: &str) -> TaskError {
    TaskError { message: message.to_owned(), ..TaskError::default() }
}

async fn events(farm: &Farm, kind: EventKind) -> usize {
    let events = farm.store.events_after(None, 0, 10_000).await.unwrap();
    events.iter().filter(|event| event.kind == kind).count()
}

#[tokio::test]
async fn an_expired_lease_goes_back_and_the_stale_fence_is_refused_everywhere() {
    let farm = Farm::new().await;
    let (a, b) = (farm.node("a").await, farm.node("b").await);
    farm.job("0").await;
    let stale = farm.claim(a.id, at(0)).await.unwrap();
    assert_eq!(farm.claim(b.id, at(29)).await, None);
    let current = farm.claim(b.id, at(30)).await.unwrap();
    assert_eq!(current.task_id, stale.task_id);
    assert!(current.fence > stale.fence);

    let store = &farm.store;
    let lost =
        |result: Result<(), StoreError>| assert!(matches!(result, Err(StoreError::LeaseLost)), "{result:?}");
    let result = farm.result_for(&stale).await;
    lost(store.renew(stale.lease_id, &renewal(stale.fence, 0.5), TTL, at(31)).await.map(drop));
    lost(store.commit_result(stale.lease_id, stale.fence, &result, at(31)).await.map(drop));
    lost(store.fail_task(stale.lease_id, stale.fence, &error("late"), at(31)).await.map(drop));
    lost(store.release(stale.lease_id, stale.fence, at(31)).await);
    // Nor does it help to have heard of the new fence, or to guess at the new lease's.
    lost(store.commit_result(stale.lease_id, current.fence, &result, at(31)).await.map(drop));
    lost(store.commit_result(current.lease_id, stale.fence, &result, at(31)).await.map(drop));
    assert_eq!(events(&farm, EventKind::LeaseLost).await, 6);

    assert!(!farm.commit(&current, at(32)).await.duplicate);
    lost(store.commit_result(stale.lease_id, stale.fence, &result, at(33)).await.map(drop));
}

#[tokio::test]
async fn a_duplicate_of_the_committed_result_is_harmless_and_another_result_is_a_conflict() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let job = farm.booked_job(request("0-1"), node.id, at(0)).await;
    let lease = farm.claim(node.id, at(1)).await.unwrap();
    let result = farm.result_for(&lease).await;
    let commit = |result: TaskResult, now| {
        let store = farm.store.clone();
        async move { store.commit_result(lease.lease_id, lease.fence, &result, now).await }
    };
    assert!(!commit(result.clone(), at(2)).await.unwrap().duplicate);
    let before = farm.store.frame(job, 0).await.unwrap();
    assert!(commit(result.clone(), at(3)).await.unwrap().duplicate);
    let TaskResult::Render(mut other) = result else { panic!() };
    other.stats.work += 1;
    assert!(matches!(commit(TaskResult::Render(other), at(4)).await, Err(StoreError::Conflict(_))));
    assert_eq!(farm.store.frame(job, 0).await.unwrap(), before);
    assert_eq!(events(&farm, EventKind::TaskDone).await, 3, "preview, profile, and one frame, once");
}

#[tokio::test]
async fn a_renewed_lease_lives_on_and_shows_its_progress() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let job = farm.booked_job(request("0-1"), node.id, at(0)).await;
    let lease = farm.claim(node.id, at(1)).await.unwrap();
    let renewed = farm.store.renew(lease.lease_id, &renewal(lease.fence, 0.5), TTL, at(25)).await.unwrap();
    assert_eq!((renewed.expires_at, renewed.order), (at(55), LeaseOrder::Continue));
    assert_eq!(farm.store.sweep(at(54)).await.unwrap().expired, 0);
    assert_eq!(farm.store.job(job).await.unwrap().progress, 0.25);
    assert_eq!(farm.store.frame(job, 0).await.unwrap().progress, 0.5);
    // A smaller step than a hundredth is not worth an event, and progress never runs backwards.
    farm.store.renew(lease.lease_id, &renewal(lease.fence, 0.501), TTL, at(26)).await.unwrap();
    farm.store.renew(lease.lease_id, &renewal(lease.fence, 0.1), TTL, at(27)).await.unwrap();
    assert_eq!(events(&farm, EventKind::TaskProgress).await, 1);
    assert_eq!(farm.store.frame(job, 0).await.unwrap().progress, 0.5);
    assert_eq!(farm.store.sweep(at(57)).await.unwrap().expired, 1);
    assert_eq!(farm.store.frame(job, 0).await.unwrap().state, FrameState::Ready);
}

#[tokio::test]
async fn cancelling_a_job_stops_its_leases_and_takes_its_tasks_back() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let job = farm.booked_job(request("0-2"), node.id, at(0)).await;
    let lease = farm.claim(node.id, at(1)).await.unwrap();
    let result = farm.result_for(&lease).await;
    assert_eq!(farm.store.cancel_job(job, at(2)).await.unwrap().state, JobState::Cancelled);
    let renewal = farm.store.renew(lease.lease_id, &renewal(lease.fence, 0.5), TTL, at(3)).await.unwrap();
    assert_eq!(renewal.order, LeaseOrder::Stop);
    farm.store.release(lease.lease_id, lease.fence, at(3)).await.unwrap();
    let refused = farm.store.commit_result(lease.lease_id, lease.fence, &result, at(3)).await;
    assert!(matches!(refused, Err(StoreError::LeaseLost)), "{refused:?}");
    assert_eq!(farm.claim(node.id, at(4)).await, None);
    assert_eq!(farm.store.cancel_job(job, at(5)).await.unwrap().finished_at, Some(at(2)), "twice is once");
    for frame in farm.store.frames(job, None, 10).await.unwrap() {
        assert_eq!(frame.state, FrameState::Cancelled);
    }
}

#[tokio::test]
async fn a_released_task_goes_back_at_once_and_counts_as_no_failure() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    farm.job("0").await;
    for _ in 0..2 * MAX_EXPIRIES {
        let lease = farm.claim(node.id, at(0)).await.unwrap();
        farm.store.release(lease.lease_id, lease.fence, at(0)).await.unwrap();
        farm.store.release(lease.lease_id, lease.fence, at(0)).await.unwrap();
    }
    assert!(farm.claim(node.id, at(0)).await.is_some());
}

#[tokio::test]
async fn the_tenth_lost_worker_fails_the_job() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let job = farm.job("0").await;
    for round in 1..=i64::from(MAX_EXPIRIES) {
        assert!(farm.claim(node.id, at(round * 100)).await.is_some(), "round {round}");
        let swept = farm.store.sweep(at(round * 100 + 30)).await.unwrap();
        assert_eq!((swept.expired, swept.jobs_failed), (1, u32::from(round == i64::from(MAX_EXPIRIES))));
    }
    assert_eq!(farm.store.job(job.id).await.unwrap().state, JobState::Failed);
    assert_eq!(farm.claim(node.id, at(10_000)).await, None);
}

#[tokio::test]
async fn a_task_whose_worker_was_lost_goes_to_another_node_first() {
    let farm = Farm::new().await;
    let (a, b) = (farm.node("a").await, farm.node("b").await);
    farm.job("0").await;
    let lost = farm.claim(a.id, at(0)).await.unwrap();
    farm.store.register_node(&registration("b"), None, at(25)).await.unwrap();
    assert_eq!(farm.store.sweep(at(30)).await.unwrap().expired, 1);
    assert_eq!(farm.claim(a.id, at(31)).await, None, "the node on which it was lost waits for the other");
    let again = farm.claim(b.id, at(31)).await.unwrap();
    assert_eq!(again.task_id, lost.task_id);
    farm.store.release(again.lease_id, again.fence, at(32)).await.unwrap();
    assert!(farm.claim(a.id, at(41)).await.is_some(), "but not for long");
}

#[tokio::test]
async fn a_task_that_ends_its_worker_each_time_fails_its_job_however_soon_another_worker_starts() {
    let farm = Farm::new().await;
    let job = farm.job("0").await;
    for round in 1..=i64::from(MAX_EXPIRIES) {
        let node = farm.new_worker("a", at(round)).await;
        assert_eq!(farm.store.job(job.id).await.unwrap().state, JobState::Previewing, "round {round}");
        assert!(farm.claim(node.id, at(round)).await.is_some(), "round {round}");
    }
    farm.new_worker("a", at(20)).await;
    let job = farm.store.job(job.id).await.unwrap();
    assert_eq!(job.state, JobState::Failed);
    assert!(
        job.error.as_ref().is_some_and(|it| it.ends_with("10 workers were lost on this task, on a")),
        "{job:?}"
    );
}

#[tokio::test]
async fn a_result_that_names_a_missing_artefact_is_refused_and_the_lease_stays() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    farm.booked_job(request("0"), node.id, at(0)).await;
    let lease = farm.claim(node.id, at(1)).await.unwrap();
    let TaskResult::Render(mut result) = farm.result_for(&lease).await else { panic!() };
    result.artifacts.image_exr = ArtifactHash([7; 32]);
    let refused =
        farm.store.commit_result(lease.lease_id, lease.fence, &TaskResult::Render(result), at(2)).await;
    assert!(
        matches!(refused, Err(StoreError::MissingArtifact(hash)) if hash == ArtifactHash([7; 32])),
        "{refused:?}"
    );
    assert!(!farm.commit(&lease, at(3)).await.duplicate);
}

#[tokio::test]
async fn who_died_with_the_service_is_not_paid_for_the_time_that_it_was_down() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    farm.booked_job(request("0-2"), node.id, at(0)).await;
    let dead = farm.claim(node.id, at(1)).await.unwrap();
    let alive = farm.claim(node.id, at(2)).await.unwrap();
    let runs_out =
        farm.store.renew(dead.lease_id, &renewal(dead.fence, 0.1), TTL, at(4)).await.unwrap().expires_at;
    // Twice, as after a failed start.
    farm.store.extend_leases_after_start(TTL, at(3000)).await.unwrap();
    farm.store.extend_leases_after_start(TTL, at(3600)).await.unwrap();
    farm.store.renew(alive.lease_id, &renewal(alive.fence, 0.5), TTL, at(3605)).await.unwrap();
    // Before the first lease has run out once more, nothing is owed for it either.
    let job = farm.store.lease(dead.lease_id).await.unwrap().job_id;
    let price = registration("a").price_per_hour;
    let owed = |micros: i64| price.for_micros_at_hourly_rate(micros).0;
    let until_now = owed(runs_out.micros_since(at(1))) + owed(3608 * SECOND);
    assert_eq!(farm.store.spent_on(job, at(3610)).await.unwrap().0, until_now);
    assert_eq!(farm.store.sweep(at(9000)).await.unwrap().expired, 2);
    let ledger = farm.store.ledger(at(0), at(9000)).await.unwrap();
    let paid: Vec<_> = ledger.iter().map(|line| line.until).collect();
    let term = i64::try_from(TTL.as_micros()).unwrap();
    let heard_of = at(3605).plus_micros(term);
    assert_eq!(
        paid,
        [Some(runs_out), Some(heard_of)],
        "the other was heard of after the start, however late the sweep"
    );
}

#[tokio::test]
async fn nor_if_its_job_is_cancelled_before_its_lease_has_run_out() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let job = farm.booked_job(request("0-1"), node.id, at(0)).await;
    let dead = farm.claim(node.id, at(1)).await.unwrap();
    let alive = farm.claim(node.id, at(2)).await.unwrap();
    farm.store.extend_leases_after_start(TTL, at(3600)).await.unwrap();
    farm.store.renew(alive.lease_id, &renewal(alive.fence, 0.5), TTL, at(3605)).await.unwrap();
    farm.store.cancel_job(job, at(3610)).await.unwrap();
    let ledger = farm.store.ledger(at(0), at(9000)).await.unwrap();
    let paid: Vec<_> = ledger.iter().map(|line| line.until).collect();
    assert_eq!(paid, [Some(dead.expires_at), Some(at(3610))]);
}

#[tokio::test]
async fn a_restart_resumes_where_it_was_and_leaves_leases_a_term_to_report() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let job = farm.booked_job(request("0-1"), node.id, at(0)).await;
    let lease = farm.claim(node.id, at(1)).await.unwrap();
    let result = farm.result_for(&lease).await;
    let before = farm.store.job(job).await.unwrap();
    let farm = farm.restarted().await;
    assert_eq!(farm.store.job(job).await.unwrap(), before);
    // The service was down for an hour, the worker kept on rendering.
    assert_eq!(farm.store.extend_leases_after_start(TTL, at(3600)).await.unwrap(), 1);
    assert_eq!(farm.store.sweep(at(3601)).await.unwrap().expired, 0);
    let committed = farm.store.commit_result(lease.lease_id, lease.fence, &result, at(3602)).await.unwrap();
    assert!(!committed.duplicate);
    let farm = farm.restarted().await;
    assert_eq!(farm.store.frame(job, 0).await.unwrap().state, FrameState::Done);
}

#[tokio::test]
async fn one_sweep_takes_back_all_leases_that_expired_together() {
    const MANY: u32 = 120;
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    for _ in 0..MANY {
        farm.job("0").await;
        farm.claim(node.id, at(0)).await.unwrap();
    }
    assert_eq!(farm.store.sweep(at(30)).await.unwrap().expired, MANY);
    assert_eq!(farm.events(EventKind::LeaseExpired).await.len(), MANY as usize);
    assert_eq!(farm.store.sweep(at(30)).await.unwrap().expired, 0);
    assert!(farm.claim(node.id, at(31)).await.is_some());
}
