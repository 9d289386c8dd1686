//! The main job of the program, over HTTP and by the command line: from a bundle to a quote, bookings and
//! images. Refused requests leave nothing behind.

mod cancelling;
mod command_line;
mod few_files;
mod refusals;
mod shot;

use forelight_protocol::{Bundle, FramePage, FrameRow, Job, Role, Timestamp};
use forelight_tests::bundles::{shipped, zipped};
use forelight_tests::http::{Answer, Http};
use forelight_tests::processes::Service;
use forelight_tests::waiting::eventually;
use reqwest::StatusCode;
use serde_json::{Value, json};
use std::time::Duration;

const WIDTH: u32 = 48;
const HEIGHT: u32 = 27;

/// Limit for steps of a job.
const PATIENCE: Duration = Duration::from_secs(90);
/// Limit for a whole job.
const JOB_PATIENCE: Duration = Duration::from_secs(240);

/// A farm of two workers on this machine.
async fn farm() -> Service {
    let flags =
        ["--workers", "2", "--threads", "1", "--price", "3.60", "--preview", "cpu", "--lease-ttl", "10s"];
    let farm = Service::start("farm", &flags).await;
    let film = json!({"project": "a film", "share": 1});
    assert_eq!(farm.http(Role::Operator).post("/v1/projects", &film).await.status(), StatusCode::OK);
    farm
}

async fn upload(http: &Http, scene: &str) -> Bundle {
    http.upload(zipped(&shipped(scene)), None).await.parsed(StatusCode::CREATED).await
}

fn in_a_year() -> Timestamp {
    Timestamp::now().plus_micros(365 * 86_400_000_000)
}

fn request(bundle: &Bundle, frames: &str, samples_per_pixel: u32) -> Value {
    json!({
        "name": "a shot", "project": "a film", "bundle": {"id": bundle.id}, "frames": frames,
        "settings": {"width": WIDTH, "height": HEIGHT, "spp": samples_per_pixel},
        "samples": 128, "profile_frames": 2, "deadline": in_a_year(),
    })
}

async fn frames_of(http: &Http, job: &Job) -> Vec<FrameRow> {
    let page: FramePage = http.json(&format!("/v1/jobs/{}/frames", job.id)).await;
    page.items
}

async fn until(http: &Http, job: &Job, patience: Duration, wanted: impl Fn(&Job) -> bool) -> Job {
    eventually("a state of the job", patience, async || {
        let job: Job = http.json(&format!("/v1/jobs/{}", job.id)).await;
        wanted(&job).then_some(job)
    })
    .await
}
