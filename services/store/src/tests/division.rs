//! Frames that are divided into parts.

mod late_parts;
mod passes;

use forelight_protocol::{
    DivideResult, DivideSpec, FinishedPixels, FrameCache, FramePart, FrameSet, FrameState, JobState,
    PartPass, PartRange, PixelRange, RestOfPart, TaskKind,
};

use super::*;

impl Farm {
    /// A booked job whose first frame is divided into so many parts, all booked on `node` one after the
    /// other from second 10. Its other frames come after them.
    pub(super) async fn divided_job(&self, request: JobRequest, node: NodeId, parts: u32) -> JobId {
        self.divided_job_of(request, node, parts, &job_forecast()).await
    }

    /// The same for a job whose frames are rendered in passes.
    pub(super) async fn job_in_passes(&self, frames: &str, node: NodeId, parts: u32) -> JobId {
        let forecast = JobForecast { chosen_spp: Some(7), ..job_forecast() };
        self.divided_job_of(request(frames), node, parts, &forecast).await
    }

    async fn divided_job_of(
        &self,
        request: JobRequest,
        node: NodeId,
        parts: u32,
        forecast: &JobForecast,
    ) -> JobId {
        let job = self.profiled_job(request, node).await;
        let plan = self.plan_in_parts(&job, node, parts).await;
        let frames = frame_forecasts(&job);
        self.store.book(job.id, forecast, &frames, None, &plan, at(0)).await.unwrap();
        job.id
    }

    /// Does the next task of a node, which must be to divide a frame: into parts that end at these places,
    /// for a pass with these samples.
    pub(super) async fn divide<const N: usize>(
        &self,
        node: NodeId,
        ends: [u32; N],
        samples: &'static str,
    ) -> DivideSpec {
        self.divide_expecting(node, ends, samples, None).await
    }

    /// The same for an error, for which the pixels will probably take so much work in all.
    async fn divide_expecting<const N: usize>(
        &self,
        node: NodeId,
        ends: [u32; N],
        samples: &'static str,
        expected_work: Option<u64>,
    ) -> DivideSpec {
        let lease = self.claim(node, at(20)).await.unwrap();
        let TaskSpec::Divide(spec) = lease.spec else { panic!("{:?}", lease.spec) };
        let result = TaskResult::Divide(DivideResult {
            expected_work,
            ends: ends.into(),
            work: vec![10; N],
            cache: None,
            coarse_png: None,
            samples: Some(self.artifact(samples).await),
            spent: Spent::default(),
        });
        self.store.commit_result(lease.lease_id, lease.fence, &result, at(20)).await.unwrap();
        spec
    }

    /// Does the next task of a node, which must be a part of a pass.
    pub(super) async fn part_of_pass(&self, node: NodeId, file: &'static str, work: u64) -> PartPass {
        // Each part takes a while.
        let now = at(work as i64);
        let lease = self.claim(node, now).await.unwrap();
        let TaskSpec::RenderPart(spec) = lease.spec else { panic!("{:?}", lease.spec) };
        let cost = Spent { work, cpu_nanos: 1_000 * work };
        let hash = self.artifact(file).await;
        let result = TaskResult::RenderPart(RenderPartResult {
            finished: FinishedPart::Pixels(PartPixels { hash, count: 100, cost }),
            rest: None,
            spent: cost,
            peak_memory_bytes: 0,
        });
        self.store.commit_result(lease.lease_id, lease.fence, &result, now).await.unwrap();
        assert_eq!(spec.range, None, "a worker that knows no passes renders nothing");
        spec.pass.unwrap()
    }

    /// Whether anything refers to a file.
    async fn needs(&self, file: &'static str) -> bool {
        let hash = blake3::hash(file.as_bytes());
        let needs = sqlx::query_scalar("SELECT EXISTS (SELECT 1 FROM used_artifacts WHERE hash = ?)");
        needs.bind(&hash.as_bytes()[..]).fetch_one(self.store.readers()).await.unwrap()
    }

    async fn profiled_job(&self, request: JobRequest, node: NodeId) -> Job {
        let job = self.submit(request).await;
        let preview = self.claim(node, at(0)).await.unwrap();
        self.commit(&preview, at(0)).await;
        self.store.start_profiling(job.id, &[0], false, at(0)).await.unwrap();
        let profile = self.claim(node, at(0)).await.unwrap();
        self.commit(&profile, at(0)).await;
        job
    }

    async fn plan_in_parts(&self, job: &Job, node: NodeId, parts: u32) -> NewPlan {
        let mut plan = self.plan_for(job, node, at(10 + 10 * i64::from(parts))).await;
        let bookings = &mut plan.jobs[0].bookings;
        bookings.remove(0);
        bookings.extend((0..parts).map(|part| {
            let start = at(10 + 10 * i64::from(part));
            let frame = FramePart { frame: 0, part, parts };
            NewBooking { frame, node, start, end: start.plus_micros(10 * SECOND) }
        }));
        plan
    }

    /// Kind and part of the next tasks of a node, which does them.
    pub(super) async fn done(&self, node: NodeId, count: usize) -> Vec<(TaskKind, Option<u32>)> {
        let mut done = Vec::new();
        for _ in 0..count {
            let Some(lease) = self.claim(node, at(20)).await else { break };
            done.push((lease.spec.kind(), lease.spec.part()));
            self.commit(&lease, at(20)).await;
        }
        done
    }
}

#[tokio::test]
async fn a_frame_is_divided_then_its_parts_are_rendered_and_it_is_put_together() {
    let farm = Farm::new().await;
    let node = farm.node("a").await.id;
    let job = farm.divided_job(request("0-1"), node, 3).await;
    let frame = async || farm.store.frame(job, 0).await.unwrap();
    assert_eq!(farm.store.open_bookings().await.unwrap().len(), 4, "three parts and a frame");
    assert_eq!(farm.done(node, 1).await, [(TaskKind::Divide, None)]);
    for part in 0..3 {
        let lease = farm.claim(node, at(100 * i64::from(part) + 20)).await.unwrap();
        let TaskSpec::RenderPart(spec) = &lease.spec else { panic!("{:?}", lease.spec) };
        let pixels = PixelRange { from: part * 100, to: (part + 1) * 100 };
        assert_eq!((spec.part, spec.range), (part, Some(PartRange::Pixels(pixels))));
        assert!(spec.profile.is_some(), "a part takes the frame's profiled pixels over");
        farm.commit(&lease, at(100 * i64::from(part + 1))).await;
        assert!((frame().await.progress - f64::from(part + 1) / 3.0).abs() < 1e-9);
        assert_ne!(frame().await.state, FrameState::Done);
    }
    let estimate = farm.store.job(job).await.unwrap().live.unwrap();
    assert_eq!(estimate.work.spent, 30.0, "finished parts are part of the estimate");
    let lease = farm.claim(node, at(400)).await.unwrap();
    let TaskSpec::Render(spec) = &lease.spec else { panic!("{:?}", lease.spec) };
    assert_eq!((spec.frame, spec.parts.len()), (0, 3));
    farm.commit(&lease, at(401)).await;
    assert_eq!(frame().await.state, FrameState::Done);
    assert_eq!(farm.done(node, 9).await, [(TaskKind::Render, None)], "the other frame is whole");
    assert_eq!(farm.store.job(job).await.unwrap().state, JobState::Done);
    assert!(farm.store.open_bookings().await.unwrap().is_empty());
}

#[tokio::test]
async fn the_cache_of_a_divided_frame_is_filled_before_its_parts_are_rendered() {
    let farm = Farm::new().await;
    let node = farm.node("a").await.id;
    farm.divided_job(request("0"), node, 2).await;
    let lease = farm.claim(node, at(20)).await.unwrap();
    let hash = farm.artifact("a plan").await;
    let result = TaskResult::Divide(DivideResult {
        expected_work: None,
        ends: vec![150, 200],
        work: vec![10, 10],
        cache: Some(FrameCache { hash, bytes: 6, full: false }),
        coarse_png: None,
        samples: None,
        spent: Spent::default(),
    });
    farm.store.commit_result(lease.lease_id, lease.fence, &result, at(20)).await.unwrap();
    let (fill, part, render) = (TaskKind::CacheFill, TaskKind::RenderPart, TaskKind::Render);
    // Each round fills one of two levels.
    let round = [(fill, Some(0)), (fill, Some(1)), (TaskKind::CacheMerge, None)];
    assert_eq!(farm.done(node, 3).await, round);
    assert_eq!(farm.done(node, 3).await, round);
    let lease = farm.claim(node, at(20)).await.unwrap();
    let TaskSpec::RenderPart(spec) = &lease.spec else { panic!("{:?}", lease.spec) };
    assert!(spec.frame_cache.is_some() && spec.cache.is_none());
    farm.commit(&lease, at(20)).await;
    assert_eq!(farm.done(node, 1).await, [(part, Some(1))]);
    let lease = farm.claim(node, at(20)).await.unwrap();
    assert_eq!((lease.spec.kind(), lease.spec.caches().len()), (render, 1));
}

#[tokio::test]
async fn parts_of_lost_workers_are_leased_again_and_the_others_stay_done() {
    let farm = Farm::new().await;
    let (a, b) = (farm.node("a").await.id, farm.node("b").await.id);
    let job = farm.divided_job(request("0"), a, 3).await;
    farm.done(a, 2).await;
    let lost = farm.claim(a, at(20)).await.unwrap();
    assert_eq!(lost.spec.part(), Some(1));
    // The service dies, and the worker with it.
    let farm = farm.restarted().await;
    let again = farm.claim(b, at(1000)).await.unwrap();
    assert_eq!((again.task_id, again.fence), (lost.task_id, lost.fence + 1));
    farm.commit(&again, at(1000)).await;
    let late = farm.result_for(&lost).await;
    let refused = farm.store.commit_result(lost.lease_id, lost.fence, &late, at(1001)).await;
    assert!(matches!(refused, Err(StoreError::LeaseLost)), "{refused:?}");
    assert_eq!(farm.done(b, 9).await, [(TaskKind::RenderPart, Some(2)), (TaskKind::Render, None)]);
    assert_eq!(farm.store.job(job).await.unwrap().state, JobState::Done);
}

#[tokio::test]
async fn a_plan_divides_only_frames_that_no_worker_has_had() {
    let farm = Farm::new().await;
    let node = farm.node("a").await.id;
    let job = farm.booked_job(request("0-1"), node, at(10)).await;
    let lease = farm.claim(node, at(10)).await.unwrap();
    farm.store.release(lease.lease_id, lease.fence, at(11)).await.unwrap();
    let current = farm.store.job(job).await.unwrap();
    let mut plan = farm.plan_in_parts(&current, node, 2).await;
    plan.reason = PlanReason::Events;
    plan.jobs[0].bookings.retain(|booking| booking.frame.frame == 0);
    let second = |frame| NewBooking { frame, node, start: at(90), end: at(99) };
    plan.jobs[0].bookings.extend([0, 1].map(|part| second(FramePart { frame: 1, part, parts: 2 })));
    farm.store.replan(&plan, at(12)).await.unwrap();
    let open = farm.store.open_bookings().await.unwrap();
    let parts: Vec<FramePart> = open.iter().map(|open| open.booking.frame_part()).collect();
    // The first frame was with a worker, so the plan's bookings of its parts are void.
    assert_eq!(
        parts,
        [1, 1]
            .into_iter()
            .zip(0..)
            .map(|(frame, part)| FramePart { frame, part, parts: 2 })
            .collect::<Vec<_>>()
    );
    assert_eq!(farm.done(node, 1).await, [(TaskKind::Divide, None)]);
}

#[tokio::test]
async fn a_divided_frame_is_rendered_again_in_its_parts() {
    let farm = Farm::new().await;
    let node = farm.node("a").await.id;
    let job = farm.divided_job(request("0"), node, 2).await;
    let (part, render) = (TaskKind::RenderPart, TaskKind::Render);
    let all = [(part, Some(0)), (part, Some(1)), (render, None)];
    assert_eq!(farm.done(node, 9).await[1..], all);
    farm.store.retry_frames(job, &FrameSet::range(0, 0), at(30)).await.unwrap();
    assert_eq!(farm.done(node, 9).await, all, "what divides it is known");
    assert_eq!(farm.store.job(job).await.unwrap().state, JobState::Done);
}

#[tokio::test]
async fn cancelling_a_divided_frame_takes_its_parts_from_all_workers() {
    let farm = Farm::new().await;
    let (a, b) = (farm.node("a").await.id, farm.node("b").await.id);
    let job = farm.divided_job(request("0-1"), a, 2).await;
    farm.done(a, 1).await;
    let first = farm.claim(a, at(20)).await.unwrap();
    farm.store.drop_frames(job, &FrameSet::range(0, 0), at(21)).await.unwrap();
    let renewal = RenewRequest { fence: first.fence, ..RenewRequest::default() };
    let told = farm.store.renew(first.lease_id, &renewal, TTL, at(22)).await.unwrap();
    assert_eq!(told.order, forelight_protocol::LeaseOrder::Stop);
    assert_eq!(farm.done(b, 9).await, [(TaskKind::Render, None)]);
    let found = farm.store.job(job).await.unwrap();
    assert_eq!((found.state, found.frames_cancelled), (JobState::Done, 1));
}
