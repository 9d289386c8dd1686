//! Frames that are divided into parts.

use std::collections::BTreeSet;

use crate::support::made_up::another_renderer;
use crate::support::{Answer, Farm};
use forelight_protocol::{
    BookingPage, Bundle, FrameRow, FrameState, Job, JobState, Lease, Node, PartRange, ProblemKind,
    SampleRange, TaskKind, TaskPage, TaskResult, TaskRow, TaskSpec,
};
use reqwest::StatusCode;
use serde_json::{Value, json};

impl Farm {
    async fn divided(&self, frames: &str, parts: u32) -> Job {
        let mut request = self.job_request(frames);
        request["division"] = json!({"into": parts});
        self.submitter.post("/v1/jobs", &request).await.parsed(StatusCode::CREATED).await
    }

    async fn frame(&self, job: &Job, frame: u32) -> FrameRow {
        self.viewer.get(&format!("/v1/jobs/{}/frames/{frame}", job.id)).await.parsed(StatusCode::OK).await
    }

    async fn tasks(&self, job: &Job, query: &str) -> TaskPage {
        self.viewer.get(&format!("/v1/jobs/{}/tasks{query}", job.id)).await.parsed(StatusCode::OK).await
    }

    /// The next task of a node, which must be of this kind.
    pub(crate) async fn next(&self, node: &Node, kind: TaskKind) -> Lease {
        let lease = self.next_task(node).await;
        assert_eq!(lease.spec.kind(), kind);
        lease
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn the_parts_of_a_frame_are_booked_side_by_side_and_the_frame_is_done_with_the_last() {
    let farm = Farm::new().await;
    let (a, b) = (farm.node("a").await, farm.node("b").await);
    let job = farm.divided("0", 3).await;
    farm.until_booked(&a, &job).await;
    let booked: BookingPage = farm.viewer.get("/v1/bookings").await.parsed(StatusCode::OK).await;
    let parts: BTreeSet<(u32, u32, u32)> =
        booked.items.iter().map(|booking| (booking.frame, booking.part, booking.parts)).collect();
    assert_eq!(parts, [(0, 0, 3), (0, 1, 3), (0, 2, 3)].into());
    let nodes: BTreeSet<_> = booked.items.iter().map(|booking| booking.node_id).collect();
    assert_eq!(nodes, [a.id, b.id].into(), "both nodes have parts");

    let lease = farm.next(&a, TaskKind::Divide).await;
    assert!(farm.claim(&b).await.is_none(), "parts wait until the frame is divided");
    farm.finish(&lease).await;
    let coarse = farm.tasks(&job, "?frame=0").await.items.iter().find_map(|task| task.coarse_png);
    let path = format!("/v1/artifacts/{}", coarse.expect("a coarse picture, before the first part"));
    assert_eq!(farm.viewer.get(&path).await.bytes().await.unwrap(), "a coarse picture");
    let (first, second) =
        (farm.next(&a, TaskKind::RenderPart).await, farm.next(&b, TaskKind::RenderPart).await);
    farm.finish(&first).await;
    let row = farm.frame(&job, 0).await;
    assert_eq!((row.state, row.parts, row.parts_done), (FrameState::Leased, 3, 1));
    assert!((row.progress - 1.0 / 3.0).abs() < 1e-9, "{}", row.progress);
    farm.finish(&second).await;
    let third = farm.next(&b, TaskKind::RenderPart).await;
    farm.finish(&third).await;
    let tasks = farm.tasks(&job, "?frame=0").await;
    let pixels = tasks.items.iter().filter(|task| task.pixels.is_some()).count();
    assert_eq!(pixels, 3, "the pixels of parts can be fetched until the frame is put together");
    let whole = farm.next(&b, TaskKind::Render).await;
    let TaskSpec::Render(spec) = &whole.spec else { panic!("{:?}", whole.spec) };
    assert_eq!(spec.parts.len(), 3);
    assert_eq!(farm.finish(&whole).await.job_state, JobState::Done);
    let row = farm.frame(&job, 0).await;
    assert_eq!((row.state, row.parts, row.parts_done), (FrameState::Done, 3, 3));
    let tasks = farm.tasks(&job, "?frame=0").await;
    let is_left = |task: &TaskRow| task.pixels.is_some() || task.coarse_png.is_some();
    assert!(!tasks.items.iter().any(is_left), "nothing of the parts is kept");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_frame_whose_samples_go_where_they_help_is_divided_for_each_pass() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let plain = farm.divided("0", 2).await;
    farm.until_booked(&node, &plain).await;
    let quoted = farm.quote(&plain).await;
    farm.submitter.post(&format!("/v1/jobs/{}/cancel", plain.id), &json!({})).await;
    let mut request = farm.job_request("0");
    request["division"] = json!({"into": 2});
    request["within"] = json!({"cpu_micros": (5e6 * quoted.total.cpu_seconds.p95) as i64});
    let job: Job = farm.submitter.post("/v1/jobs", &request).await.parsed(StatusCode::CREATED).await;
    farm.until_booked(&node, &job).await;

    let lease = farm.next(&node, TaskKind::Divide).await;
    let TaskSpec::Divide(spec) = &lease.spec else { panic!() };
    let work = spec.passes.as_ref().expect("its samples are not even").work;
    let TaskResult::Divide(good) = farm.made_up_result(&lease).await else { panic!() };
    // What a worker would say that knows no passes, and one that says too early that nothing is left.
    for (samples, ends) in [(None, good.ends.clone()), (None, Vec::new())] {
        let result = TaskResult::Divide(forelight_protocol::DivideResult { samples, ends, ..good.clone() });
        let problem = farm.report(&lease, result).await.problem(ProblemKind::Invalid).await;
        assert_eq!(problem.pointer.as_deref(), Some("/result/divide/samples"));
    }
    farm.finish(&lease).await;
    for _ in 0..2 {
        let lease = farm.next(&node, TaskKind::RenderPart).await;
        let TaskSpec::RenderPart(spec) = &lease.spec else { panic!() };
        assert!(spec.pass.is_some() && spec.range.is_none(), "{spec:?}");
        farm.finish(&lease).await;
    }
    let lease = farm.next(&node, TaskKind::Divide).await;
    let TaskSpec::Divide(spec) = &lease.spec else { panic!() };
    assert_eq!(spec.passes.as_ref().unwrap().before.len(), 2);
    farm.finish(&lease).await;
    let lease = farm.next(&node, TaskKind::Render).await;
    let TaskSpec::Render(spec) = &lease.spec else { panic!() };
    assert_eq!((spec.work, spec.parts.len()), (Some(work), 2));
    assert_eq!(farm.finish(&lease).await.job_state, JobState::Done);
}

#[tokio::test(flavor = "multi_thread")]
async fn tasks_of_a_job_are_listed_page_by_page() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let job = farm.divided("0-1", 2).await;
    farm.work_off(&node, &job).await;
    let all = farm.tasks(&job, "").await.items;
    let count = |kind| all.iter().filter(|task| task.kind == kind).count();
    assert_eq!((count(TaskKind::Preview), count(TaskKind::Divide)), (1, 2));
    assert_eq!((count(TaskKind::RenderPart), count(TaskKind::Render)), (4, 2));
    let mut paged = Vec::new();
    let mut query = "?page_size=3".to_owned();
    loop {
        let page = farm.tasks(&job, &query).await;
        paged.extend(page.items);
        let Some(token) = page.next_page_token else { break };
        query = format!("?page_size=3&page_token={}", token.0);
    }
    assert_eq!(paged, all);
}

#[tokio::test(flavor = "multi_thread")]
async fn what_does_not_divide_a_frame_is_refused_with_its_place() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    for (division, pointer) in [
        (json!({"into": 1}), "/division/into"),
        (json!({"into": 513}), "/division/into"),
        (json!("half"), "/division"),
    ] {
        let mut request = farm.job_request("0");
        request["division"] = division;
        let problem = farm.submitter.post("/v1/jobs", &request).await.problem(ProblemKind::Invalid).await;
        assert_eq!(problem.pointer.as_deref(), Some(pointer));
    }
    let job = farm.divided("0", 2).await;
    farm.until_booked(&node, &job).await;
    let lease = farm.next(&node, TaskKind::Divide).await;
    let TaskResult::Divide(good) = farm.made_up_result(&lease).await else { panic!() };
    for (ends, work, pointer) in [
        (vec![64], vec![1, 1], "/result/divide/ends"),
        (vec![32, 64], vec![1], "/result/divide/work"),
        (vec![40, 32], vec![1, 1], "/result/divide/ends"),
        (vec![32, 63], vec![1, 1], "/result/divide/ends"),
        (vec![32, 64], vec![1, 1 << 63], "/result/divide/work"),
    ] {
        let result = TaskResult::Divide(forelight_protocol::DivideResult { ends, work, ..good.clone() });
        let problem = farm.report(&lease, result).await.problem(ProblemKind::Invalid).await;
        assert_eq!(problem.pointer.as_deref(), Some(pointer));
    }
    farm.finish(&lease).await;
    let lease = farm.next(&node, TaskKind::RenderPart).await;
    let TaskResult::RenderPart(good) = farm.made_up_result(&lease).await else { panic!() };
    let forelight_protocol::FinishedPart::Pixels(pixels) = good.finished else { panic!() };
    let finished =
        forelight_protocol::FinishedPart::Pixels(forelight_protocol::PartPixels { count: 65, ..pixels });
    let result = TaskResult::RenderPart(forelight_protocol::RenderPartResult { finished, ..good.clone() });
    let problem = farm.report(&lease, result).await.problem(ProblemKind::Invalid).await;
    assert_eq!(problem.pointer.as_deref(), Some("/result/render_part/finished/pixels/count"));
    // The first part has the pixels 0 to 31.
    for (ends, work) in [
        (vec![10], vec![1]),
        (vec![10, 32], vec![1]),
        (vec![20, 10, 32], vec![1, 1, 1]),
        (vec![10, 20, 31], vec![1, 1, 1]),
        (vec![10, 20, 33], vec![1, 1, 1]),
        (vec![10; 513], vec![1; 513]),
    ] {
        let rest = Some(forelight_protocol::RestOfPart { ends, work });
        let result = TaskResult::RenderPart(forelight_protocol::RenderPartResult { rest, ..good.clone() });
        let problem = farm.report(&lease, result).await.problem(ProblemKind::Invalid).await;
        assert_eq!(problem.pointer.as_deref(), Some("/result/render_part/rest/ends"));
    }
    // Nobody asked the worker to leave anything.
    let rest = Some(forelight_protocol::RestOfPart { ends: vec![10, 32], work: vec![1, 1] });
    let result = TaskResult::RenderPart(forelight_protocol::RenderPartResult { rest, ..good });
    assert_eq!(farm.report(&lease, result).await.status(), StatusCode::CONFLICT);
    assert_eq!(farm.frame(&job, 0).await.parts, 2);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_renderer_that_takes_samples_over_divides_frames_by_their_samples() {
    let farm = Farm::new().await;
    let node = json!({"name": "blender", "capabilities": {"renderers": [another_renderer()]}});
    let node: Node = farm.worker.post("/v1/nodes", &node).await.parsed(StatusCode::CREATED).await;
    let upload = farm.submitter.request(reqwest::Method::POST, "/v1/bundles");
    let upload = upload.header("content-type", "application/x-blender").body("BLENDER-v500 and so on");
    let bundle: Bundle = upload.send().await.unwrap().parsed(StatusCode::CREATED).await;
    let request: Value = json!({
        "name": "shot", "bundle": {"id": bundle.id}, "frames": "1-2", "profile_frames": 1,
        "renderer": {"name": "cycles", "version": "5"}, "division": {"into": 3},
    });
    let job: Job = farm.submitter.post("/v1/jobs", &request).await.parsed(StatusCode::CREATED).await;
    farm.until_booked(&node, &job).await;
    let mut of_frame: [Vec<SampleRange>; 2] = Default::default();
    for _ in 0..8 {
        let lease = farm.next_task(&node).await;
        match &lease.spec {
            TaskSpec::RenderPart(spec) => {
                let Some(PartRange::Samples(range)) = spec.range else { panic!("{spec:?}") };
                of_frame[spec.frame as usize - 1].push(range);
            }
            TaskSpec::Render(spec) => {
                let shares = spec.shares.iter().map(|share| (share.offset, share.offset + share.count));
                let end = shares.fold(0, |end, (from, to)| {
                    assert_eq!(from, end, "shares follow each other");
                    to
                });
                assert_eq!(end, 32, "all samples are there");
            }
            other => panic!("{other:?}"),
        }
        farm.finish(&lease).await;
    }
    assert_eq!(farm.job(&job).await.state, JobState::Done);
    let counts = of_frame.map(|ranges| ranges.iter().map(|range| range.count).sum::<u32>());
    assert!(counts.contains(&28) && counts.contains(&32), "4 samples of one frame are profiled: {counts:?}");
}
