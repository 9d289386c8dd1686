//! What is learnt from finished jobs, and from which.

use super::*;
use forelight_forecast::Experience;
use forelight_quote::{QuoteBasis, QuoteKind, Spreads};

fn kind(renderer: &str, feature_class: &str) -> QuoteKind {
    QuoteKind { renderer: renderer.to_owned(), feature_class: feature_class.to_owned() }
}

/// A quote of so many frames of 900 units and 4 seconds each, a tenth unsure.
fn quote(kind: &QuoteKind, frames: usize) -> (JobForecast, QuoteBasis) {
    let known = |mean: f64| Quantiles { mean, p50: mean, p80: 1.1 * mean, p95: 1.2 * mean };
    let mut forecast = job_forecast();
    forecast.total.work = known(900.0 * frames as f64);
    forecast.total.cpu_seconds = known(4.0 * frames as f64);
    let spreads = Spreads { work: 0.1, cpu: 0.1 };
    (forecast, QuoteBasis { kind: kind.clone(), total: spreads, frames: vec![spreads; frames] })
}

/// Quotes a job, and renders all of it at `work` a frame, or all but the last frame.
async fn run(farm: &Farm, node: NodeId, kind: &QuoteKind, frames: u32, work: u64, whole: bool) -> JobId {
    let (forecast, basis) = quote(kind, frames as usize);
    let request = request(&format!("0-{}", frames - 1));
    let job = farm.quoted_job(request, node, at(10), &forecast, Some(&basis)).await;
    for _ in 0..frames - u32::from(!whole) {
        let lease = farm.claim(node, at(12)).await.unwrap();
        let TaskResult::Render(mut render) = farm.result_for(&lease).await else { panic!() };
        render.stats.work = work;
        let result = TaskResult::Render(render);
        farm.store.commit_result(lease.lease_id, lease.fence, &result, at(20)).await.unwrap();
    }
    job
}

#[tokio::test]
async fn a_finished_job_teaches_its_own_kind_and_an_unfinished_one_nobody() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let [new, old] = ["tracer 6", "tracer 5"].map(|renderer| kind(renderer, "gathered"));
    run(&farm, node.id, &old, 2, 5000, true).await;
    run(&farm, node.id, &new, 3, 1000, true).await;
    let known = farm.store.experience(&new).await.unwrap();
    let jobs = |experience: &Experience| {
        [&experience.frame_work, &experience.frame_cpu, &experience.job_work, &experience.job_cpu]
            .map(|past| past.jobs())
    };
    assert_eq!(jobs(&known), [1; 4], "the old version's job says nothing of the new one");
    // Nothing but the one residual, of frames and of the whole: ten times the logarithm.
    let off = 10.0 * (1000.0f64 / 900.0).ln();
    for past in [&known.frame_work, &known.job_work] {
        assert!((past.quantile(0.4).unwrap() - off).abs() < 1e-9);
        assert_eq!(past.correction(), None, "one job is too few");
    }
    assert_eq!(jobs(&farm.store.experience(&kind("tracer 6", "cached")).await.unwrap()), [0; 4]);
    run(&farm, node.id, &new, 3, 9000, false).await;
    assert_eq!(farm.store.experience(&new).await.unwrap(), known, "a job counts once it is whole");
    let farm = farm.restarted().await;
    assert_eq!(farm.store.experience(&new).await.unwrap(), known);
}

#[tokio::test]
async fn from_nineteen_jobs_on_quantiles_follow() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let kind = kind("tracer 6", "gathered");
    for job in 1..=19u64 {
        let before = farm.store.experience(&kind).await.unwrap().corrections();
        assert_eq!(before, None, "{job}");
        run(&farm, node.id, &kind, 1, 900 + 10 * job, true).await;
    }
    let found = farm.store.experience(&kind).await.unwrap().corrections().unwrap();
    let off = |job: f64| 10.0 * ((900.0 + 10.0 * job) / 900.0).ln();
    for correction in [found.frame_work, found.job_work] {
        for (z, job) in [(correction.p50, 10.0), (correction.p80, 16.0), (correction.p95, 19.0)] {
            assert!((z - off(job)).abs() < 1e-9, "{z} for job {job}");
        }
    }
}

#[tokio::test]
async fn of_a_long_job_some_frames_and_the_whole_are_learnt() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let kind = kind("tracer 6", "gathered");
    let job = run(&farm, node.id, &kind, 250, 1000, true).await;
    let count = |frames: &'static str| {
        let count = sqlx::query_scalar::<_, i64>(sqlx::AssertSqlSafe(format!(
            "SELECT count(*) FROM quote_spreads WHERE job_id = ? AND work_residual IS NOT NULL AND frame {frames}"
        )));
        count.bind(job.0).fetch_one(farm.store.readers())
    };
    assert_eq!(count("= -1").await.unwrap(), 1);
    let learnt = count(">= 0").await.unwrap();
    assert!((80..=100).contains(&learnt), "{learnt}");
}

#[tokio::test]
async fn the_track_record_holds_kinds_apart_and_counts_whole_jobs_too() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let kind = kind("tracer 6", "gathered");
    run(&farm, node.id, &kind, 2, 1000, true).await;
    run(&farm, node.id, &kind, 2, 1070, true).await;
    farm.booked_job(request("5"), node.id, at(10)).await;
    let lease = farm.claim(node.id, at(30)).await.unwrap();
    farm.commit(&lease, at(31)).await;
    let kinds = farm.store.track_record(None, 1, None).await.unwrap().kinds;
    let [unknown, known] = &kinds[..] else { panic!("{kinds:?}") };
    assert_eq!((&unknown.renderer, unknown.frames.count, unknown.jobs.count), (&None, 1, 1));
    assert_eq!(
        (known.renderer.as_deref(), known.feature_class.as_deref()),
        (Some("tracer 6"), Some("gathered"))
    );
    assert!(!known.calibrated);
    // Frames were promised 1000 and 1100, the jobs 1980 and 2160 at P80 and P95.
    let hits = |p80, p95| forelight_protocol::QuantileHits { p50: 0, p80, p95 };
    assert_eq!((known.frames.count, known.frames.work_hits), (4, hits(2, 4)));
    assert_eq!((known.jobs.count, known.jobs.work_hits), (2, hits(0, 2)));
    let errors = farm.store.finished_jobs(10, None).await.unwrap();
    assert_eq!(errors.len(), 3);
    assert!(errors.iter().all(|job| !job.calibrated));
    assert!((errors[0].work_error.unwrap() + 0.1).abs() < 1e-12, "{errors:?}");
    assert_eq!(farm.store.finished_jobs(1, None).await.unwrap(), errors[2..]);
}
