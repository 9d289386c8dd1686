//! Jobs whose images have their noise removed.

use crate::support::made_up::{DENOISED_SHARE, DENOISING, made_up_denoised, made_up_times};
use crate::support::{Answer, Farm};
use forelight_protocol::{
    AccuracyDoc, AnswersDoc, DenoisedStats, FrameRow, Job, JobState, Node, ProblemKind, RenderStats,
    TaskKind, TaskResult, TaskSpec,
};
use reqwest::StatusCode;
use serde_json::{Value, json};
use std::collections::BTreeSet;

fn request(farm: &Farm, frames: &str) -> Value {
    let mut request = farm.job_request(frames);
    request["denoise"] = json!(true);
    request
}

async fn submit(farm: &Farm, frames: &str) -> Job {
    farm.submitter.post("/v1/jobs", &request(farm, frames)).await.parsed(StatusCode::CREATED).await
}

/// A node with our own renderer, and with or without a denoiser.
async fn node(farm: &Farm, name: &str, denoiser: Option<&str>) -> Node {
    let renderers = json!([{"name": "forelight", "version": "tracer-9"}]);
    let mut capabilities = json!({"renderers": renderers});
    denoiser.inspect(|denoiser| capabilities["denoiser"] = json!(denoiser));
    let node = json!({"name": name, "speed": 1.0, "cores": 1, "capabilities": capabilities});
    farm.worker.post("/v1/nodes", &node).await.parsed(StatusCode::CREATED).await
}

#[tokio::test(flavor = "multi_thread")]
async fn only_nodes_with_a_denoiser_profile_and_render_the_job() {
    let farm = Farm::new().await;
    let plain = node(&farm, "plain", None).await;
    let job = submit(&farm, "0-1").await;
    assert!(job.denoise);
    // Everybody can preview it. Then it waits, and says for what.
    let preview = farm.next(&plain, TaskKind::Preview).await;
    farm.finish(&preview).await;
    let waiting = farm.until(&job, "wait for a denoiser", |job| job.waits.is_some()).await;
    let because = waiting.waits.unwrap().because;
    assert!(because.contains("no node has forelight tracer-9 with Open Image Denoise"), "{because}");
    assert!(farm.claim(&plain).await.is_none());

    let clean = node(&farm, "clean", Some("Open Image Denoise 2.5.1")).await;
    let lease = farm.next(&clean, TaskKind::Profile).await;
    let TaskSpec::Profile(spec) = &lease.spec else { panic!() };
    assert!(spec.denoise);
    farm.finish(&lease).await;
    farm.until_booked(&clean, &job).await;
    // What removing the noise takes is part of the price, on the one node that can.
    let quote = farm.quote(&job).await;
    let seconds = DENOISING as f64 * 1e-9;
    assert!(quote.frames.iter().all(|frame| frame.cpu_seconds.p50 > seconds), "{:?}", quote.total);
    assert!(farm.claim(&plain).await.is_none());
    let lease = farm.next(&clean, TaskKind::Render).await;
    let TaskSpec::Render(spec) = &lease.spec else { panic!() };
    assert!(spec.denoise);

    // The result says how, and what is left.
    let TaskResult::Render(made) = farm.made_up_result(&lease).await else { panic!() };
    let refused = async |change: &dyn Fn(&mut RenderStats), field: &str| {
        let mut result = made.clone();
        change(&mut result.stats);
        let problem =
            farm.report(&lease, TaskResult::Render(result)).await.problem(ProblemKind::Invalid).await;
        assert_eq!(problem.pointer, Some(format!("/result/render/stats/denoised{field}")));
    };
    refused(&|stats| stats.denoised = None, "").await;
    let wrong = async |field: &str, change: fn(&mut DenoisedStats)| {
        refused(&|stats| change(stats.denoised.as_mut().unwrap()), field).await;
    };
    wrong("/by", |stats| stats.by = String::new()).await;
    wrong("/error", |stats| stats.error.p50 = -1.0).await;
    wrong("/measured_pixels", |stats| stats.measured_pixels = u64::MAX).await;
    wrong("/measuring_cpu_seconds", |stats| stats.measuring_cpu_seconds = -1.0).await;
    farm.finish(&lease).await;
    assert_eq!(farm.work_off(&clean, &job).await.state, JobState::Done);
    let path = format!("/v1/jobs/{}/frames/0", job.id);
    let frame: FrameRow = farm.viewer.get(&path).await.parsed(StatusCode::OK).await;
    assert_eq!(frame.actual.unwrap().denoised, Some(made_up_denoised()));
}

#[tokio::test(flavor = "multi_thread")]
async fn ladders_say_what_error_is_left_at_every_quality() {
    let farm = Farm::new().await;
    let clean = node(&farm, "clean", Some("Open Image Denoise 2.5.1")).await;
    let mut request = request(&farm, "0-2");
    request["ladders"] = json!("all");
    request["settings"] = json!({"ambient_bounces": 1, "spp": 16, "width": 8, "height": 8});
    let job: Job = farm.submitter.post("/v1/jobs", &request).await.parsed(StatusCode::CREATED).await;
    farm.until_booked(&clean, &job).await;
    let path = format!("/v1/jobs/{}/accuracy", job.id);
    let document: AccuracyDoc = farm.viewer.get(&path).await.parsed(StatusCode::OK).await;
    let quote = farm.quote(&job).await;
    let asked = document.rungs.iter().find(|rung| rung.asked_for).unwrap();
    // Also on ladders that the job's own profile prices, and at other resolutions.
    assert_eq!(document.rungs.iter().map(|rung| rung.ladder).collect::<BTreeSet<_>>().len(), 6);
    for rung in &document.rungs {
        let (denoised, asked) = (rung.denoised_error.unwrap().p50, asked.denoised_error.unwrap().p50);
        let place = document.rungs.iter().filter(|other| other.ladder == rung.ladder);
        let place = place.take_while(|other| other.settings != rung.settings).count() as u32 + 1;
        let times = if rung.asked_for { 1.0 } else { made_up_times(rung.ladder, place) };
        // As in the frame that was profiled with other settings. Its prices hold for all of the job's ladders.
        assert!((denoised / asked / times - 1.0).abs() < 1e-9, "{rung:?}");
        let price = rung.cpu_seconds.p50 / (times * quote.total.cpu_seconds.p50);
        assert!((price - 1.0).abs() < 1e-9, "{rung:?}");
    }
    assert_eq!(asked.denoised_error.unwrap().p50, 0.01 * DENOISED_SHARE);
    assert_ne!(asked.error.unwrap().p50, 0.01, "the job's own profiles know its noise better");
    // Other qualities are offered by what is left.
    let path = format!("/v1/jobs/{}/answers", job.id);
    let answers: AnswersDoc = farm.viewer.get(&path).await.parsed(StatusCode::OK).await;
    for offer in &answers.qualities {
        let rung = document.rungs.iter().find(|rung| rung.settings == offer.settings).unwrap();
        assert_eq!(offer.error, rung.denoised_error);
    }
    assert!(answers.qualities.len() > 5);
}

#[tokio::test]
async fn noise_stays_where_it_is_needed_or_cannot_be_removed() {
    let farm = Farm::new().await;
    for (field, value) in [
        ("error_target", json!({"ppm": 20_000})),
        ("within", json!({"cpu_micros": 1_000_000_000})),
        ("renderer", json!({"name": "cycles"})),
    ] {
        let mut request = request(&farm, "0");
        request[field] = value;
        let problem = farm.submitter.post("/v1/jobs", &request).await.problem(ProblemKind::Invalid).await;
        assert_eq!(problem.pointer.as_deref(), Some("/denoise"), "{field}: {problem:?}");
    }
}
