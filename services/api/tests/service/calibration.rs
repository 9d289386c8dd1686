//! Finished jobs calibrate later quotes of the same renderer, and of no other.

use crate::support::{Answer, Farm};
use forelight_protocol::{CalibrationDoc, ForecastDoc, Job, JobState, Node, TaskResult, TrackRecord};
use reqwest::StatusCode;

/// Runs a job of two frames. Profiled pixels differ by up to 10 %; renders cost `factor` times the profile.
async fn run(farm: &Farm, node: &Node, renderer: &str, factor: f64) -> ForecastDoc {
    let job: Job = farm.submit("0-1").await;
    loop {
        let state = farm.job(&job).await.state;
        if state.is_final() {
            assert_eq!(state, JobState::Done);
            break;
        }
        let lease = farm.next_task(node).await;
        let mut result = farm.made_up_result(&lease).await;
        match &mut result {
            TaskResult::Profile(profile) => {
                profile.renderer = Some(renderer.to_owned());
                for sample in &mut profile.samples {
                    let more = sample.work * u64::from(sample.pixel * 7 % 11) / 100;
                    sample.work += more;
                    sample.work_by_ray[0] += more;
                    sample.cpu_nanos += more * 1_000_000;
                }
            }
            TaskResult::Render(render) => {
                render.stats.work = (render.stats.work as f64 * factor) as u64;
                render.stats.cpu_seconds *= factor;
            }
            _ => {}
        }
        let reported = farm.report(&lease, result).await;
        assert_eq!(reported.status(), StatusCode::OK);
    }
    farm.quote(&job).await
}

#[tokio::test(flavor = "multi_thread")]
async fn after_nineteen_jobs_quantiles_hold_and_another_version_starts_anew() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    // Every job costs 20 % to 60 % more than forecast, so no uncalibrated interval would hold.
    let factor = |job: u32| 1.2 + 0.4 * f64::from(job * 7 % 19) / 18.0;
    for job in 0..19 {
        let quote = run(&farm, &node, "r 1", factor(job)).await;
        assert!(!quote.calibrated, "{job} jobs are too few");
        assert!(quote.total.work.p95 < 1.2 * quote.total.work.mean);
    }
    let quote = run(&farm, &node, "r 1", 1.45).await;
    assert!(quote.calibrated);
    let at = |quantile: f64| quantile / quote.total.work.mean;
    let work = quote.total.work;
    // A little below the mean times the factor, since the profile's pixels were made dearer, not the renders.
    assert!((at(work.p50) - 1.33).abs() < 0.05 && (at(work.p80) - 1.47).abs() < 0.05, "{work:?}");
    assert!((at(work.p95) - 1.53).abs() < 0.05, "{work:?}");
    for frame in &quote.frames {
        let cpu = frame.cpu_seconds;
        assert!(cpu.p50 > 1.2 * cpu.mean && cpu.p95 > cpu.p80 && cpu.p80 > cpu.p50, "{cpu:?}");
    }
    let other = run(&farm, &node, "r 2", 1.0).await;
    assert!(!other.calibrated && other.total.work.p50 == other.total.work.mean);

    let taught: CalibrationDoc =
        farm.viewer.get("/v1/forecasts/calibration").await.parsed(StatusCode::OK).await;
    let jobs: Vec<(&str, u64, bool)> = taught
        .kinds
        .iter()
        .map(|kind| (kind.renderer.as_str(), kind.jobs, kind.corrections.is_some()))
        .collect();
    assert_eq!(jobs, [("r 1", 20, true), ("r 2", 1, false)]);

    let path = "/v1/forecasts/track-record";
    let record: TrackRecord =
        farm.viewer.get(&format!("{path}?page_size=1")).await.parsed(StatusCode::OK).await;
    let kinds: Vec<(Option<&str>, bool, u64, u64)> = record
        .kinds
        .iter()
        .map(|kind| (kind.renderer.as_deref(), kind.calibrated, kind.jobs.count, kind.frames.count))
        .collect();
    assert_eq!(kinds, [(Some("r 1"), false, 19, 38), (Some("r 1"), true, 1, 2), (Some("r 2"), false, 1, 2)]);
    assert_eq!(record.kinds[0].jobs.work_hits.p95, 0);
    assert_eq!((record.kinds[1].jobs.work_hits.p50, record.kinds[1].jobs.work_hits.p95), (0, 1));
    assert!(record.kinds.iter().all(|kind| kind.feature_class.as_deref() == Some("gathered")));
    let picture = farm.viewer.get(&format!("{path}.svg")).await;
    assert_eq!(
        (picture.status(), &picture.headers()["content-type"]),
        (StatusCode::OK, &"image/svg+xml".parse().unwrap())
    );
    let picture = picture.text().await.unwrap();
    roxmltree::Document::parse(&picture).unwrap();
    assert!(picture.contains("work of jobs, calibrated: 1 jobs") && !picture.contains("NaN"), "{picture}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_farm_that_has_finished_nothing_has_an_empty_picture() {
    let farm = Farm::new().await;
    let picture = farm.viewer.get("/v1/forecasts/track-record.svg").await.text().await.unwrap();
    roxmltree::Document::parse(&picture).unwrap();
    assert!(picture.contains("finished jobs: none"), "{picture}");
}
