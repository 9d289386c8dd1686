//! Shared irradiance caches: how their tasks follow each other, and frames follow them.

use forelight_protocol::{
    CachePrice, CacheQuote, CacheSharing, EventKind, FrameState, JobState, Money, MoneyQuantiles,
    SharedCacheForecast, TaskError, TaskKind,
};

use super::*;
use crate::{NewPartBooking, NewSharedCache, PlannedCache, StoreError};

/// Micro-units for a second.
const PRICE: f64 = 1000.0;

impl Farm {
    /// A job whose frames share a cache of two levels in three parts, booked.
    async fn job_with_shared_cache(&self, node: NodeId, parts: u32) -> JobId {
        let job = self.submit(request("0-2")).await;
        let preview = self.claim(node, at(0)).await.unwrap();
        self.commit(&preview, at(0)).await;
        self.store.start_profiling(job.id, &[0], true, at(0)).await.unwrap();
        assert_eq!(self.store.planned_cache(job.id).await.unwrap(), PlannedCache::Pending);
        // Profiles measure pixels with the cache as planned, too.
        let plan = self.claim(node, at(0)).await.unwrap();
        assert_eq!((plan.spec.kind(), self.claim(node, at(0)).await), (TaskKind::CachePlan, None));
        self.commit(&plan, at(0)).await;
        let profile = self.claim(node, at(0)).await.unwrap();
        assert_eq!(profile.spec.kind(), TaskKind::Profile);
        assert_eq!(profile.spec.caches(), [self.artifact("a plan").await]);
        self.commit(&profile, at(0)).await;
        let PlannedCache::There { plan, node_speed } = self.store.planned_cache(job.id).await.unwrap() else {
            panic!("no plan")
        };
        assert_eq!(node_speed, 2.0);
        let booking = |part: u32| NewPartBooking {
            part,
            node,
            start: at(i64::from(part)),
            end: at(i64::from(part) + 1),
        };
        let cache =
            NewSharedCache { cache: plan.cache.unwrap(), parts, bookings: (0..parts).map(booking).collect() };
        let mut new = self.plan_for(&job, node, at(10)).await;
        new.shared_cache = Some(cache);
        let mut forecast = JobForecast { cache: Some(quote(parts)), ..job_forecast() };
        forecast.cost = Some(forecast.total.cpu_seconds.plus(&Quantiles::known(6.0)).in_money(PRICE));
        self.store.book(job.id, &forecast, &frame_forecasts(&job), None, &new, at(0)).await.unwrap();
        job.id
    }

    async fn kinds(&self, node: NodeId) -> Vec<(TaskKind, Option<u32>, Option<u32>)> {
        let mut kinds = Vec::new();
        while let Some(lease) = self.claim(node, at(20)).await {
            kinds.push((lease.spec.kind(), lease.spec.round(), lease.spec.part()));
            self.commit(&lease, at(20)).await;
        }
        kinds
    }
}

fn quote(parts: u32) -> CacheQuote {
    CacheQuote {
        asked: CacheSharing::Auto,
        shared: true,
        reason: "it takes less".to_owned(),
        private_price: CachePrice { records: 200, work: 2000.0, cpu_seconds: 2.0, cost: None },
        shared_price: Some(CachePrice { records: 70, work: 700.0, cpu_seconds: 0.7, cost: None }),
        shared_cache: Some(SharedCacheForecast {
            records: vec![50, 20],
            parts,
            work: Quantiles::known(600.0),
            cpu_seconds: Quantiles::known(6.0),
            cost: None,
        }),
    }
}

#[tokio::test]
async fn more_profiles_are_asked_for_once_and_measure_with_the_planned_cache_as_the_first_did() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let job = farm.submit(request("0-5")).await;
    let preview = farm.claim(node.id, at(0)).await.unwrap();
    farm.commit(&preview, at(0)).await;
    farm.store.start_profiling(job.id, &[0], true, at(0)).await.unwrap();
    for _ in ["the plan", "the profile"] {
        let lease = farm.claim(node.id, at(0)).await.unwrap();
        farm.commit(&lease, at(0)).await;
    }
    assert_eq!(farm.store.profile_results(job.id).await.unwrap().map(|profiles| profiles.len()), Some(1));
    let planned = farm.store.planned_cache(job.id).await.unwrap();
    for _ in ["once", "again, as after a crash"] {
        farm.store.profile_more(job.id, &[2, 4], &planned).await.unwrap();
    }
    assert_eq!(farm.store.profile_results(job.id).await.unwrap(), None, "two are under way");
    for frame in [2, 4] {
        let profile = farm.claim(node.id, at(0)).await.unwrap();
        assert_eq!((profile.spec.kind(), profile.spec.frame()), (TaskKind::Profile, Some(frame)));
        assert_eq!(profile.spec.caches(), [farm.artifact("a plan").await]);
        farm.commit(&profile, at(0)).await;
    }
    assert_eq!(farm.claim(node.id, at(0)).await, None);
    assert_eq!(farm.store.profile_results(job.id).await.unwrap().map(|profiles| profiles.len()), Some(3));
    // Not of a job that is over.
    farm.store.cancel_job(job.id, at(1)).await.unwrap();
    farm.store.profile_more(job.id, &[5], &planned).await.unwrap();
    assert_eq!(farm.claim(node.id, at(1)).await, None);
}

#[tokio::test]
async fn frames_wait_until_every_level_of_the_cache_is_filled_and_put_together() {
    let farm = Farm::new().await;
    let node = farm.node("a").await.id;
    let job = farm.job_with_shared_cache(node, 3).await;
    let cost = async || farm.store.job(job).await.unwrap().live.unwrap().cost.unwrap();
    let quoted = job_forecast().total.cpu_seconds.mean;
    assert_eq!(cost().await.mean, Money(((quoted + 6.0) * PRICE) as i64));
    let states = async || farm.store.frames(job, None, 10).await.unwrap().into_iter().map(|f| f.state);
    assert!(states().await.all(|state| state == FrameState::Waiting));
    assert_eq!(
        farm.store.open_bookings().await.unwrap().len(),
        3,
        "frames that wait are booked all the same"
    );
    assert_eq!(farm.store.open_cache_parts().await.unwrap().len(), 3);
    // Three parts of a second each, at a unit an hour: what is planned anew has that much less to spend.
    let spent = async || farm.store.farm_jobs(at(20)).await.unwrap()[0].spent.micro_units();
    assert_eq!(spent().await, 3 * 278);

    let (fill, merge) = (TaskKind::CacheFill, TaskKind::CacheMerge);
    let mut seen = Vec::new();
    for round in 0..2 {
        for part in 0..3 {
            let lease = farm.claim(node, at(20)).await.unwrap();
            assert_eq!(
                (lease.spec.kind(), lease.spec.round(), lease.spec.part()),
                (fill, Some(round), Some(part))
            );
            seen.extend(lease.spec.caches());
            farm.commit(&lease, at(20)).await;
            // The service may die after any of them.
            let again = farm.result_for(&lease).await;
            let again = farm.store.commit_result(lease.lease_id, lease.fence, &again, at(20)).await.unwrap();
            assert!(again.duplicate);
        }
        let job = farm.store.job(job).await.unwrap();
        let cache = job.shared_cache.unwrap();
        assert_eq!(
            (job.state, cache.parts, cache.parts_done, cache.ready),
            (JobState::Rendering, 6, 3 * (round + 1), false)
        );
        // Two seconds a part; what merging took so far is next to nothing.
        assert_eq!(cache.work, 300 * u64::from(round + 1));
        assert!((cache.cpu_seconds - 6.0 * f64::from(round + 1)).abs() < 1e-3, "{}", cache.cpu_seconds);
        let done: Vec<f64> =
            farm.store.open_cache_parts().await.unwrap().iter().map(|part| part.done).collect();
        assert_eq!(done, [0.5 * f64::from(round + 1); 3], "the frames wait for them all the same");
        let lease = farm.claim(node, at(20)).await.unwrap();
        assert_eq!((lease.spec.kind(), lease.spec.round()), (merge, Some(round)));
        assert_eq!(lease.spec.caches().len(), 3);
        farm.commit(&lease, at(20)).await;
    }
    // The first round fills the plan, the second what was put together.
    assert!(seen[..3].iter().all(|&hash| hash == seen[0]) && seen[3..].iter().all(|&hash| hash == seen[3]));
    assert_ne!(seen[0], seen[3]);
    assert!(states().await.all(|state| state == FrameState::Ready));
    assert_eq!(spent().await, 0, "it is full, and took no time");
    assert!(farm.store.job(job).await.unwrap().shared_cache.unwrap().ready);
    assert!(farm.store.open_cache_parts().await.unwrap().is_empty());
    let cache = farm.artifact("a cache").await;
    for _ in 0..3 {
        let lease = farm.claim(node, at(20)).await.unwrap();
        let TaskSpec::Render(spec) = &lease.spec else { panic!("{:?}", lease.spec) };
        assert_eq!((spec.cache, spec.profile), (Some(cache), None));
        farm.commit(&lease, at(25)).await;
    }
    let done = farm.store.job(job).await.unwrap();
    assert_eq!(done.state, JobState::Done);
    // Quoted were six seconds for the cache, and it took twice as many.
    let cache = done.shared_cache.unwrap().cpu_seconds;
    assert!((cache - 12.0).abs() < 1e-3);
    // What is paid is the node's time, five seconds a frame at a unit an hour.
    assert_eq!(farm.store.spent_on(job, at(60)).await.unwrap(), Money(3 * 1389));
    assert_eq!(cost().await, MoneyQuantiles::default().plus(Money(3 * 1389)));
}

#[tokio::test]
async fn parts_that_say_they_took_more_than_can_be_counted_leave_the_farm_readable() {
    let farm = Farm::new().await;
    let node = farm.node("a").await.id;
    let job = farm.job_with_shared_cache(node, 3).await;
    for _ in 0..2 {
        let lease = farm.claim(node, at(20)).await.unwrap();
        let TaskResult::CacheFill(mut filled) = farm.result_for(&lease).await else { panic!() };
        filled.spent.work = i64::MAX.unsigned_abs();
        let result = TaskResult::CacheFill(filled);
        farm.store.commit_result(lease.lease_id, lease.fence, &result, at(20)).await.unwrap();
    }
    assert_eq!(farm.store.job(job).await.unwrap().shared_cache.unwrap().work, u64::MAX);
    assert_eq!(farm.store.farm_jobs(at(20)).await.unwrap().len(), 1);
}

#[tokio::test]
async fn a_cache_in_one_part_is_put_together_by_nobody() {
    let farm = Farm::new().await;
    let node = farm.node("a").await.id;
    let job = farm.job_with_shared_cache(node, 1).await;
    let render = (TaskKind::Render, None, None);
    assert_eq!(farm.kinds(node).await, [(TaskKind::CacheFill, Some(0), Some(0)), render, render, render]);
    assert_eq!(farm.store.job(job).await.unwrap().state, JobState::Done);
}

#[tokio::test]
async fn a_part_whose_worker_is_lost_is_filled_by_another_and_a_late_word_of_the_first_is_refused() {
    let farm = Farm::new().await;
    let (a, b) = (farm.node("a").await.id, farm.node("b").await.id);
    let job = farm.job_with_shared_cache(a, 3).await;
    let lost = farm.claim(a, at(0)).await.unwrap();
    let farm = farm.restarted().await;
    // What it waits for stands still with it.
    let kinds = async |at_second: i64| {
        let mut kinds = Vec::new();
        while let Some(lease) = farm.claim(b, at(at_second)).await {
            kinds.push((lease.spec.kind(), lease.spec.part()));
            farm.commit(&lease, at(at_second)).await;
        }
        kinds
    };
    let fill = |part| (TaskKind::CacheFill, Some(part));
    assert_eq!(kinds(1).await, [fill(1), fill(2)]);
    assert_eq!(kinds(40).await[..2], [fill(0), (TaskKind::CacheMerge, None)]);
    let late = farm.result_for(&lost).await;
    let late = farm.store.commit_result(lost.lease_id, lost.fence, &late, at(41)).await;
    assert!(matches!(late, Err(StoreError::LeaseLost)));
    assert_eq!(farm.store.job(job).await.unwrap().state, JobState::Done);
    let events = farm.store.events_after(Some(job), 0, 1000).await.unwrap();
    let merges = events
        .iter()
        .filter(|event| event.kind == EventKind::TaskDone && event.task_kind == Some(TaskKind::CacheMerge));
    assert_eq!(merges.count(), 2);
}

#[tokio::test]
async fn frames_that_wait_go_with_a_job_that_is_cancelled_or_whose_cache_cannot_be_made() {
    let farm = Farm::new().await;
    let node = farm.node("a").await.id;
    let cancelled = farm.job_with_shared_cache(node, 2).await;
    farm.store.cancel_job(cancelled, at(0)).await.unwrap();
    let failed = farm.job_with_shared_cache(node, 2).await;
    let lease = farm.claim(node, at(0)).await.unwrap();
    let (message, kind) = ("damaged".to_owned(), forelight_protocol::FailureKind::Input);
    let error = TaskError { message, kind, ..TaskError::default() };
    farm.store.fail_task(lease.lease_id, lease.fence, &error, at(0)).await.unwrap();
    for job in [cancelled, failed] {
        let frames = farm.store.frames(job, None, 10).await.unwrap();
        assert!(frames.iter().all(|frame| frame.state == FrameState::Cancelled), "{frames:?}");
    }
    assert_eq!(farm.store.job(failed).await.unwrap().error.unwrap(), "cache_fill: damaged");
    assert!(farm.claim(node, at(60)).await.is_none());
}

#[tokio::test]
async fn tasks_of_a_farm_from_before_caches_were_shared_are_kept_with_their_leases() {
    let folder = tempfile::tempdir().unwrap();
    let options = sqlx::sqlite::SqliteConnectOptions::new()
        .filename(folder.path().join("forelight.sqlite"))
        .create_if_missing(true);
    let mut connection = <sqlx::SqliteConnection as sqlx::Connection>::connect_with(&options).await.unwrap();
    sqlx::migrate!("../../migrations").run_to(5, &mut connection).await.unwrap();
    for statement in [
        "INSERT INTO nodes (id, name, speed, price_per_hour, cores, created_at, last_seen_at) VALUES (randomblob(16), 'n', 1, 0, 1, 0, 0)",
        "INSERT INTO jobs (id, name, project, state, bundle_path, bundle_source, scene, frames, frames_total, settings, samples, \
         profile_frames, confidence, priority, created_at) VALUES (randomblob(16), 'j', 'p', 'previewing', 'x', '{}', '{}', '0', 1, '{}', 1, 1, 'p80', 0, 0)",
        "INSERT INTO tasks (id, job_id, kind, state, spec, fence, due_at, priority, held) SELECT randomblob(16), id, 'preview', 'leased', '{}', 1, 7, 8, 1 FROM jobs",
        "INSERT INTO leases (id, task_id, node_id, fence, node_speed, state, granted_at, expires_at) \
         SELECT randomblob(16), t.id, n.id, 1, 1, 'active', 0, 9 FROM tasks t, nodes n",
        "INSERT INTO task_logs SELECT id, 1, 0, 0, 'info', 'a line' FROM tasks",
    ] {
        sqlx::query(statement).execute(&mut connection).await.unwrap();
    }
    sqlx::Connection::close(connection).await.unwrap();
    let store = Store::open(folder.path()).await.unwrap();
    let found: (String, String, i64, i64, i64) = sqlx::query_as(
        "SELECT t.kind, l.state, t.due_at, t.priority, t.held FROM tasks t JOIN leases l ON l.task_id = t.id JOIN task_logs g ON g.task_id = t.id",
    )
    .fetch_one(store.readers())
    .await
    .unwrap();
    assert_eq!(found, ("preview".to_owned(), "active".to_owned(), 7, 8, 1));
}

#[tokio::test]
async fn shared_caches_of_a_farm_from_before_they_had_that_name_are_kept() {
    let farm = Farm::new().await;
    let node = farm.node("a").await.id;
    let job = farm.job_with_shared_cache(node, 2).await;
    let plan = farm.store.job(job).await.unwrap().plan_id.unwrap();
    let known = async |store: &Store| {
        let (parts, plan) = (store.open_cache_parts().await.unwrap(), store.plan(plan).await.unwrap());
        (store.job(job).await.unwrap(), store.forecast(job).await.unwrap(), plan, parts)
    };
    let before = known(&farm.store).await;
    assert_eq!((before.2.shared_cache_bookings.len(), before.3.len()), (2, 2));
    // As it was before migration 16.
    for statement in [
        "DROP INDEX shared_cache_bookings_by_job",
        "DROP TRIGGER shared_cache_bookings_are_never_changed",
        "DROP TRIGGER shared_cache_bookings_are_never_deleted",
        "ALTER TABLE shared_cache_bookings RENAME TO seed_bookings",
        "CREATE INDEX seed_bookings_by_job ON seed_bookings (job_id)",
        "CREATE TRIGGER seed_bookings_are_never_changed BEFORE UPDATE ON seed_bookings BEGIN SELECT RAISE(ABORT, ''); END",
        "CREATE TRIGGER seed_bookings_are_never_deleted BEFORE DELETE ON seed_bookings BEGIN SELECT RAISE(ABORT, ''); END",
        r#"UPDATE jobs SET forecast = replace(forecast, '"shared_cache":', '"seed":')"#,
        "DELETE FROM _sqlx_migrations WHERE version = 16",
    ] {
        let mut write = farm.store.write().await.unwrap();
        sqlx::query(statement).execute(write.connection().await.unwrap()).await.unwrap();
        farm.store.commit(write).await.unwrap();
    }
    let Farm { folder, store } = farm;
    store.close().await;
    drop(store);
    let store = Store::open(folder.path()).await.unwrap();
    assert_eq!(known(&store).await, before);
}
