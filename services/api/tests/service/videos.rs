//! Videos of finished frames.

use crate::support::{Answer, Farm};
use forelight_protocol::{
    ArtifactHash, FrameState, Job, JobState, JobVideo, Lease, Node, ProblemKind, Retention, TaskKind,
    TaskPage, TaskSpec,
};
use reqwest::{Method, Response, StatusCode};
use serde_json::{Value, json};

/// A node that has ffmpeg.
async fn with_ffmpeg(farm: &Farm, name: &str) -> Node {
    let (capabilities, worker) = (json!({"ffmpeg": "5.1"}), uuid::Uuid::now_v7());
    let node =
        json!({"name": name, "speed": 2.0, "cores": 2, "capabilities": capabilities, "worker": worker});
    farm.worker.post("/v1/nodes", &node).await.parsed(StatusCode::CREATED).await
}

async fn submit(farm: &Farm, frames: &str, video: Value) -> Job {
    let mut request = farm.job_request(frames);
    request["video"] = video;
    farm.submitter.post("/v1/jobs", &request).await.parsed(StatusCode::CREATED).await
}

async fn set(farm: &Farm, job: &Job, video: Value) -> Response {
    let request = farm.submitter.request(Method::PUT, &format!("/v1/jobs/{}/video", job.id));
    request.json(&video).send().await.unwrap()
}

async fn delete(farm: &Farm, job: &Job) -> Job {
    let request = farm.submitter.request(Method::DELETE, &format!("/v1/jobs/{}/video", job.id));
    request.send().await.unwrap().parsed(StatusCode::OK).await
}

async fn file(farm: &Farm, job: &Job) -> Response {
    farm.viewer.get(&format!("/v1/jobs/{}/video.mp4", job.id)).await
}

async fn video(farm: &Farm, job: &Job) -> JobVideo {
    farm.job(job).await.video.expect("a video is asked for")
}

async fn video_task(farm: &Farm, node: &Node) -> Lease {
    let lease = farm.next_task(node).await;
    assert_eq!(lease.spec.kind(), TaskKind::Video);
    lease
}

/// The pictures that the task shows, and its rate.
fn shown(lease: &Lease) -> (Vec<ArtifactHash>, f64) {
    let TaskSpec::Video(spec) = &lease.spec else { panic!("a video") };
    (spec.pictures.clone(), spec.frames_per_second.into())
}

fn pictures(frames: impl IntoIterator<Item = u32>) -> Vec<ArtifactHash> {
    let name = |frame| ArtifactHash(*blake3::hash(format!("picture {frame}").as_bytes()).as_bytes());
    frames.into_iter().map(name).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_node_with_ffmpeg_makes_the_video_after_the_last_frame() {
    let farm = Farm::new().await;
    let plain = farm.node("plain").await;
    let job = submit(&farm, "2-5", json!({})).await;
    assert_eq!(job.video.as_ref().unwrap().state, FrameState::Waiting);
    // The job is done without its video, which a node without ffmpeg does not get.
    let done = farm.work_off(&plain, &job).await;
    assert_eq!(done.state, JobState::Done);
    assert!(farm.claim(&plain).await.is_none());
    let waiting = done.video.unwrap();
    assert_eq!((waiting.state, f64::from(waiting.frames_per_second)), (FrameState::Ready, 25.0));
    assert!(waiting.waits.is_some_and(|reason| reason.contains("no worker that takes tasks has ffmpeg")));
    // Not even a process that was started for it.
    let tasks: TaskPage = farm.viewer.json(&format!("/v1/jobs/{}/tasks?page_size=200", job.id)).await;
    let task = tasks.items.iter().find(|task| task.kind == TaskKind::Video).unwrap();
    let claim = json!({"node_id": plain.id, "wait_ms": 0, "task_id": task.id});
    farm.worker.post("/v1/leases", &claim).await.problem(ProblemKind::Conflict).await;
    file(&farm, &job).await.problem(ProblemKind::NotFound).await;
    // Whatever happens to the service.
    let farm = farm.killed_and_restarted().await;
    let node = with_ffmpeg(&farm, "encoder").await;
    assert_eq!(video(&farm, &job).await.waits, None);
    let lease = video_task(&farm, &node).await;
    assert_eq!(shown(&lease), (pictures(2..=5), 25.0), "the scene's rate");
    assert_eq!(farm.finish(&lease).await.job_state, JobState::Done);
    let made = video(&farm, &job).await;
    assert_eq!((made.state, made.progress, made.file.unwrap().frames), (FrameState::Done, 1.0, 4));
    let answer = file(&farm, &job).await;
    assert_eq!(answer.headers()["content-type"], "video/mp4");
    assert_eq!(answer.headers()["accept-ranges"], "bytes");
    let content = answer.bytes().await.unwrap();
    assert_eq!(content.len() as u64, made.file.unwrap().bytes);
    // As a browser asks, to show the middle.
    let part = farm.viewer.request(Method::GET, &format!("/v1/jobs/{}/video.mp4", job.id));
    let part = part.header("range", "bytes=10-19").send().await.unwrap();
    assert_eq!(part.status(), StatusCode::PARTIAL_CONTENT);
    assert_eq!(part.bytes().await.unwrap(), content.slice(10..20));
}

#[tokio::test(flavor = "multi_thread")]
async fn cancelled_frames_are_left_out_and_frames_that_are_rendered_again_take_the_video_back() {
    let farm = Farm::new().await;
    let node = with_ffmpeg(&farm, "a").await;
    let job = submit(&farm, "0-3", json!({"frames_per_second": 23.976})).await;
    farm.until_booked(&node, &job).await;
    let frames = |frames: &str| json!({ "frames": frames });
    let cancel = format!("/v1/jobs/{}/frames/cancel", job.id);
    farm.submitter.post(&cancel, &frames("1")).await.parsed::<Job>(StatusCode::OK).await;
    farm.work_off(&node, &job).await;
    let first = video_task(&farm, &node).await;
    assert_eq!(shown(&first), (pictures([0, 2, 3]), 23.976));
    let retry = format!("/v1/jobs/{}/frames/retry", job.id);
    let again: Job = farm.submitter.post(&retry, &frames("2")).await.parsed(StatusCode::OK).await;
    assert_eq!((again.state, again.video.unwrap().state), (JobState::Rendering, FrameState::Waiting));
    // Whoever encodes the old one has lost it.
    let result = farm.made_up_result(&first).await;
    farm.report(&first, result).await.problem(ProblemKind::LeaseLost).await;
    farm.work_off(&node, &job).await;
    let second = video_task(&farm, &node).await;
    assert!(second.fence > first.fence && shown(&second) == shown(&first));
    farm.finish(&second).await;
    assert_eq!(file(&farm, &job).await.status(), StatusCode::OK);
    // A finished one, too.
    farm.submitter.post(&retry, &frames("0-3")).await.parsed::<Job>(StatusCode::OK).await;
    file(&farm, &job).await.problem(ProblemKind::NotFound).await;
    farm.work_off(&node, &job).await;
    assert_eq!(shown(&video_task(&farm, &node).await).0, pictures(0..=3));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_that_ends_while_it_is_paused_gets_its_video_and_is_paused_no_more() {
    let farm = Farm::new().await;
    let node = with_ffmpeg(&farm, "a").await;
    let job = submit(&farm, "0", json!({})).await;
    farm.until_booked(&node, &job).await;
    let frame = farm.next_task(&node).await;
    let pause = farm.submitter.request(Method::PATCH, &format!("/v1/jobs/{}", job.id));
    let pause = pause.json(&json!({"paused": true})).send().await.unwrap();
    assert!(pause.parsed::<Job>(StatusCode::OK).await.paused);
    assert_eq!(farm.finish(&frame).await.job_state, JobState::Done);
    assert!(!farm.job(&job).await.paused);
    let lease = video_task(&farm, &node).await;
    farm.finish(&lease).await;
    assert_eq!(file(&farm, &job).await.status(), StatusCode::OK);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_video_that_fails_leaves_the_job_done_and_can_be_asked_for_again() {
    let (farm, clock) = Farm::with_clock().await;
    let node = with_ffmpeg(&farm, "a").await;
    let job = submit(&farm, "0-1", json!({})).await;
    farm.work_off(&node, &job).await;
    // A node that is alone is believed the third time.
    for _ in 0..3 {
        let lease = video_task(&farm, &node).await;
        let error = json!({"fence": lease.fence, "error": {"message": "ffmpeg: no", "permanent": true}});
        let answer = farm.worker.post(&format!("/v1/leases/{}/result", lease.lease_id), &error).await;
        assert_eq!(answer.status(), StatusCode::OK);
        clock.advance_micros(60_000_000);
    }
    let failed = farm.job(&job).await;
    assert_eq!((failed.state, failed.error), (JobState::Done, None));
    let failed = failed.video.unwrap();
    assert!(failed.state == FrameState::Failed && failed.error.unwrap().contains("ffmpeg: no"));
    let again: Job = set(&farm, &job, json!({"frames_per_second": 12.5})).await.parsed(StatusCode::OK).await;
    let again = again.video.unwrap();
    assert_eq!((again.state, again.error), (FrameState::Ready, None));
    let lease = video_task(&farm, &node).await;
    assert_eq!(shown(&lease).1, 12.5);
    // What went wrong before is not wrong with it.
    assert_eq!(video(&farm, &job).await.error, None);
    // Results that do not fit their task are refused.
    let fitting = serde_json::to_value(farm.made_up_result(&lease).await).unwrap();
    for (pointer, wrong) in [("/video/file/frames", json!(3)), ("/video/file/bytes", json!(1u64 << 31))] {
        let mut result = fitting.clone();
        *result.pointer_mut(pointer).unwrap() = wrong;
        let request = json!({"fence": lease.fence, "result": result});
        let answer = farm.worker.post(&format!("/v1/leases/{}/result", lease.lease_id), &request).await;
        let problem = answer.problem(ProblemKind::Invalid).await;
        assert_eq!(problem.pointer, Some(format!("/result{pointer}")));
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_video_is_asked_for_and_deleted_at_any_time() {
    let farm = Farm::new().await;
    let node = with_ffmpeg(&farm, "a").await;
    let job = farm.submit("0-1").await;
    assert_eq!(job.video, None);
    for (wrong, pointer) in [(json!(0), "/frames_per_second"), (json!("24"), "/frames_per_second")] {
        let answer = set(&farm, &job, json!({ "frames_per_second": wrong })).await;
        assert_eq!(answer.problem(ProblemKind::Invalid).await.pointer.as_deref(), Some(pointer));
    }
    let path = format!("/v1/jobs/{}/video", job.id);
    let by_viewer = farm.viewer.request(Method::PUT, &path).json(&json!({})).send().await.unwrap();
    by_viewer.problem(ProblemKind::Forbidden).await;
    let open: Job = set(&farm, &job, json!({})).await.parsed(StatusCode::OK).await;
    assert_eq!(open.video.unwrap().state, FrameState::Waiting);
    assert_eq!(delete(&farm, &job).await.video, None);
    let state_of = async || {
        let tasks: TaskPage = farm.viewer.json(&format!("/v1/jobs/{}/tasks?page_size=200", job.id)).await;
        tasks.items.iter().find(|task| task.kind == TaskKind::Video).map(|task| task.state)
    };
    farm.work_off(&node, &job).await;
    assert!(farm.claim(&node).await.is_none(), "none is asked for");
    let done: Job = set(&farm, &job, json!({})).await.parsed(StatusCode::OK).await;
    assert_eq!(done.video.unwrap().state, FrameState::Ready);
    let lease = video_task(&farm, &node).await;
    farm.finish(&lease).await;
    assert_eq!(file(&farm, &job).await.status(), StatusCode::OK);
    // Asked for again, it stays.
    let again: Job = set(&farm, &job, json!({})).await.parsed(StatusCode::OK).await;
    assert_eq!(again.video.unwrap().state, FrameState::Done);
    assert_eq!(delete(&farm, &job).await.video, None);
    file(&farm, &job).await.problem(ProblemKind::NotFound).await;

    // Its images are its source.
    set(&farm, &job, json!({})).await.parsed::<Job>(StatusCode::OK).await;
    let rule = json!({"kind": "images", "days": 0});
    farm.operator.post("/v1/retention", &rule).await.parsed::<Retention>(StatusCode::OK).await;
    farm.operator.post("/v1/prune", &json!({})).await.parsed::<Value>(StatusCode::OK).await;
    assert_eq!(farm.job(&job).await.video, None);
    assert!(farm.claim(&node).await.is_none());
    let refused = set(&farm, &job, json!({})).await.problem(ProblemKind::Conflict).await;
    assert!(refused.detail.contains("images of the job were deleted"), "{refused:?}");
    // A frame that is rendered again does not stand for all.
    let frames = json!({"frames": "1"});
    let path = format!("/v1/jobs/{}/frames", job.id);
    farm.submitter.post(&format!("{path}/retry"), &frames).await.parsed::<Job>(StatusCode::OK).await;
    set(&farm, &job, json!({})).await.problem(ProblemKind::Conflict).await;
    farm.submitter.post(&format!("{path}/cancel"), &frames).await.parsed::<Job>(StatusCode::OK).await;
    assert_eq!(state_of().await, Some(FrameState::Cancelled), "its task waits for nothing");

    // A job that is deleted while its video is encoded.
    let deleted = submit(&farm, "0", json!({})).await;
    farm.work_off(&node, &deleted).await;
    let lease = video_task(&farm, &node).await;
    let request = farm.operator.request(Method::DELETE, &format!("/v1/jobs/{}", deleted.id));
    assert_eq!(request.send().await.unwrap().status(), StatusCode::NO_CONTENT);
    let result = farm.made_up_result(&lease).await;
    farm.report(&lease, result).await.problem(ProblemKind::NotFound).await;

    let cancelled = farm.submit("0").await;
    let cancel = format!("/v1/jobs/{}/cancel", cancelled.id);
    farm.submitter.post(&cancel, &json!({})).await.parsed::<Job>(StatusCode::OK).await;
    set(&farm, &cancelled, json!({})).await.problem(ProblemKind::Conflict).await;
}
