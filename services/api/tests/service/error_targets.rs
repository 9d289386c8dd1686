//! Jobs whose images are rendered until their error is small enough.

use crate::support::made_up::made_up_denoised;
use crate::support::{Answer, Farm};
use forelight_protocol::{
    AnswersDoc, Confidence, Division, ErrorTarget, Explanation, Job, JobState, PartCount, ProblemKind,
    ProfileResult, RenderResult, RenderStats, SamplesForError, TaskKind, TaskResult, TaskSpec,
};
use reqwest::StatusCode;
use serde_json::{Value, json};

const TARGET: ErrorTarget = ErrorTarget { ppm: 20_000, confidence: Confidence::P95 };

fn request(farm: &Farm, frames: &str) -> Value {
    let mut request = farm.job_request(frames);
    request["error_target"] = json!({"ppm": TARGET.ppm, "confidence": "p95"});
    request
}

#[tokio::test]
async fn frames_cost_what_their_error_takes_and_end_when_it_is_reached() {
    let farm = Farm::new().await;
    let node = farm.node("n").await;
    let plain = farm.submit("0-3").await;
    let plain = farm.until_booked(&node, &plain).await;
    let asked = farm.quote(&plain).await;
    farm.submitter.post(&format!("/v1/jobs/{}/cancel", plain.id), &json!({})).await;

    let job: Job =
        farm.submitter.post("/v1/jobs", &request(&farm, "0-3")).await.parsed(StatusCode::CREATED).await;
    assert_eq!(job.error_target, Some(TARGET));
    let spp = job.settings.own().unwrap().spp;
    let lease = farm.next(&node, TaskKind::Preview).await;
    farm.finish(&lease).await;
    let lease = farm.next(&node, TaskKind::Profile).await;
    let TaskSpec::Profile(spec) = &lease.spec else { panic!() };
    assert_eq!(spec.error_target, Some(TARGET));
    // The profile must say what the error takes, in numbers that can be.
    let TaskResult::Profile(good) = farm.made_up_result(&lease).await else { panic!() };
    let wrong = SamplesForError { p50: 9.0, p80: 8.0, p95: 9.0 };
    for samples_for_error in [None, Some(wrong)] {
        let result = TaskResult::Profile(ProfileResult { samples_for_error, ..good.clone() });
        let problem = farm.report(&lease, result).await.problem(ProblemKind::Invalid).await;
        assert_eq!(problem.pointer.as_deref(), Some("/result/profile/samples_for_error"));
    }
    farm.finish(&lease).await;
    let job = farm.until_booked(&node, &job).await;
    let quoted = farm.quote(&job).await;
    let chosen = quoted.chosen_spp.unwrap();
    let needed = good.samples_for_error.unwrap();
    assert!((f64::from(chosen) - needed.p50).abs() < 1.0, "{chosen} of {needed:?}");
    assert_eq!(job.settings.own().unwrap().spp, spp, "the profile's samples stay");
    // Pixels are all of the cost but a little, and cost what their samples do.
    let ratio = quoted.total.work.mean / asked.total.work.mean;
    assert!((ratio / (needed.p50 / f64::from(spp)) - 1.0).abs() < 0.02, "{ratio}");
    // The noise is not known for sure.
    let wide = quoted.total.work.p95 / quoted.total.work.p50;
    assert!(wide > 0.99 * needed.p95 / needed.p50, "{wide}");

    // No other samples are offered: they would not be rendered. The explanation is that of the quote.
    let path = format!("/v1/jobs/{}/answers", job.id);
    let answers: AnswersDoc = farm.viewer.get(&path).await.parsed(StatusCode::OK).await;
    assert!(answers.qualities.is_empty(), "{:?}", answers.qualities);
    let path = format!("/v1/jobs/{}/explanation", job.id);
    let explained: Explanation = farm.viewer.get(&path).await.parsed(StatusCode::OK).await;
    assert!((explained.work / quoted.total.work.mean - 1.0).abs() < 1e-9, "{explained:?}");

    let lease = farm.next(&node, TaskKind::Render).await;
    let TaskSpec::Render(spec) = &lease.spec else { panic!() };
    let of_frame = quoted.frames.iter().find(|each| each.frame == spec.frame).unwrap();
    assert_eq!((spec.error_target, spec.work), (Some(TARGET), Some(of_frame.work.mean.round() as u64)));
    assert_eq!(spec.profile, None, "profiled pixels have other samples");
    let TaskResult::Render(made) = farm.made_up_result(&lease).await else { panic!() };
    let stats = RenderStats { allotted: None, spp, ..made.stats.clone() };
    let silent = TaskResult::Render(RenderResult { stats, ..made.clone() });
    farm.report(&lease, silent).await.problem(ProblemKind::Invalid).await;
    // A worker that knows no error targets spends the forecast work, whatever the error is then.
    let mut missed = made.clone();
    missed.stats.allotted.as_mut().unwrap().error.p95 = 1.02 * TARGET.share();
    let problem = farm.report(&lease, TaskResult::Render(missed)).await.problem(ProblemKind::Invalid).await;
    assert_eq!(problem.pointer.as_deref(), Some("/result/render/stats/allotted/error"));
    let mut denoised = made.clone();
    denoised.stats.denoised = Some(made_up_denoised());
    let problem = farm.report(&lease, TaskResult::Render(denoised)).await.problem(ProblemKind::Invalid).await;
    assert_eq!(problem.pointer.as_deref(), Some("/result/render/stats/denoised"));
    farm.finish(&lease).await;
    assert_eq!(farm.work_off(&node, &job).await.state, JobState::Done);
}

#[tokio::test(flavor = "multi_thread")]
async fn all_passes_over_a_divided_frame_have_its_error_target() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let mut request = request(&farm, "0");
    request["division"] = serde_json::to_value(Division::Into(PartCount(2))).unwrap();
    let job: Job = farm.submitter.post("/v1/jobs", &request).await.parsed(StatusCode::CREATED).await;
    farm.until_booked(&node, &job).await;
    for before in [0, 2] {
        let lease = farm.next(&node, TaskKind::Divide).await;
        let TaskSpec::Divide(spec) = &lease.spec else { panic!() };
        let passes = spec.passes.as_ref().expect("samples go where they help");
        assert_eq!((passes.error_target, passes.before.len()), (Some(TARGET), before));
        farm.finish(&lease).await;
        for _ in before..2 {
            let lease = farm.next(&node, TaskKind::RenderPart).await;
            farm.finish(&lease).await;
        }
    }
    let lease = farm.next(&node, TaskKind::Render).await;
    let TaskSpec::Render(spec) = &lease.spec else { panic!() };
    assert_eq!((spec.error_target, spec.parts.len()), (Some(TARGET), 2));
    assert_eq!(farm.finish(&lease).await.job_state, JobState::Done);
}

#[tokio::test]
async fn what_cannot_be_combined_with_an_error_is_refused_by_name() {
    let farm = Farm::new().await;
    for (field, value, pointer) in [
        ("/error_target", json!({"ppm": 0}), "/error_target/ppm"),
        ("/error_target", json!({"ppm": 1_000_001}), "/error_target/ppm"),
        ("/within", json!({"cpu_micros": 5}), "/error_target"),
        ("/ladders", json!("all"), "/ladders"),
        ("/settings", json!({"spp": 3}), "/settings/spp"),
        ("/cache", json!("shared"), "/cache"),
    ] {
        let mut request = request(&farm, "0");
        request[&field[1..]] = value;
        if field == "/cache" {
            request["settings"]["cache"] = json!("on");
        }
        let refused = farm.submitter.post("/v1/jobs", &request).await;
        let problem = refused.problem(ProblemKind::Invalid).await;
        assert_eq!(problem.pointer.as_deref(), Some(pointer), "{}", problem.detail);
    }
}
