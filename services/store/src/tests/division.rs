//! Frames that are divided into parts.

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

#[tokio::test]
async fn a_frame_in_passes_is_divided_anew_before_each_of_them() {
    let farm = Farm::new().await;
    let node = farm.node("a").await.id;
    let job = farm.job_in_passes("0", node, 2).await;
    let first = farm.divide(node, [100, 200], "one sample").await;
    let Some(passes) = &first.passes else { panic!("{first:?}") };
    assert_eq!((passes.work, passes.before.len(), first.profile), (900, 0, None));
    let pixels = |from, to| PixelRange { from, to };
    let hash = |file: &str| ArtifactHash(*blake3::hash(file.as_bytes()).as_bytes());
    let part = farm.part_of_pass(node, "1a", 90).await;
    assert_eq!((part.pixels, part.samples), (pixels(0, 100), hash("one sample")));
    assert!(part.before.is_empty());
    let frame = farm.store.frame(job, 0).await.unwrap();
    assert!((frame.progress - 0.1).abs() < 1e-9, "{}", frame.progress);
    farm.part_of_pass(node, "1b", 90).await;

    // Another division of the pixels: a part takes over the files that hold its pixels, and no others.
    let second = farm.divide(node, [50, 200], "more samples").await;
    assert_eq!(second.passes.unwrap().before, [hash("1a"), hash("1b")]);
    let part = farm.part_of_pass(node, "2a", 200).await;
    assert_eq!((part.pixels, part.samples), (pixels(0, 50), hash("more samples")));
    assert_eq!(part.before, [hash("1a")]);
    let frame = farm.store.frame(job, 0).await.unwrap();
    assert!((frame.progress - 380.0 / 900.0).abs() < 1e-9, "{}", frame.progress);
    assert!(farm.needs("1a").await && farm.needs("1b").await, "the other part takes them over");
    // Service and worker die. Nothing of the passes before is lost.
    let farm = farm.restarted().await;
    let part = farm.part_of_pass(node, "2b", 300).await;
    assert_eq!((part.pixels, part.before), (pixels(50, 200), vec![hash("1a"), hash("1b")]));

    // The image has all its samples.
    assert_eq!(farm.done(node, 1).await, [(TaskKind::Divide, None)]);
    assert!(!farm.needs("1a").await && farm.needs("2a").await && farm.needs("2b").await);
    let lease = farm.claim(node, at(20)).await.unwrap();
    let TaskSpec::Render(spec) = &lease.spec else { panic!("{:?}", lease.spec) };
    assert_eq!((spec.parts.clone(), spec.work), (vec![hash("2a"), hash("2b")], Some(900)));
    let estimate = farm.store.job(job).await.unwrap().live.unwrap();
    assert_eq!(estimate.work.spent, 680.0, "all passes are part of the estimate");
    farm.commit(&lease, at(21)).await;
    assert_eq!(farm.store.job(job).await.unwrap().state, JobState::Done);
    assert!(!farm.needs("2a").await && !farm.needs("more samples").await, "nothing of the passes is kept");
}

#[tokio::test]
async fn how_far_a_frame_for_an_error_is_follows_from_what_its_image_still_needs() {
    let farm = Farm::new().await;
    let node = farm.node("a").await.id;
    let job = farm.job_in_passes("0", node, 2).await;
    farm.divide(node, [100, 200], "two samples").await;
    farm.part_of_pass(node, "1a", 90).await;
    farm.part_of_pass(node, "1b", 90).await;
    // Ten times the forecast of 900.
    farm.divide_expecting(node, [100, 200], "more samples", Some(9000)).await;
    farm.part_of_pass(node, "2a", 720).await;
    let frame = farm.store.frame(job, 0).await.unwrap();
    assert!((frame.progress - 0.1).abs() < 1e-9, "{}", frame.progress);
}

#[tokio::test]
async fn a_frame_in_passes_that_is_rendered_again_begins_with_its_first_pass() {
    let farm = Farm::new().await;
    let node = farm.node("a").await.id;
    let job = farm.job_in_passes("0-1", node, 2).await;
    let (divide, part) = (TaskKind::Divide, TaskKind::RenderPart);
    let all = [(divide, None), (part, Some(0)), (part, Some(1)), (divide, None), (TaskKind::Render, None)];
    assert_eq!(farm.done(node, 5).await, all);
    assert_eq!(farm.done(node, 9).await, [(TaskKind::Render, None)], "the other frame is whole");
    assert_eq!(farm.store.job(job).await.unwrap().state, JobState::Done);
    farm.store.retry_frames(job, &FrameSet::range(0, 0), at(30)).await.unwrap();
    assert_eq!(farm.done(node, 9).await, all);
    // In the middle of a pass.
    farm.store.retry_frames(job, &FrameSet::range(0, 0), at(40)).await.unwrap();
    farm.divide(node, [100, 200], "one sample").await;
    farm.part_of_pass(node, "1a", 90).await;
    farm.part_of_pass(node, "1b", 90).await;
    farm.divide(node, [100, 200], "more samples").await;
    let lost = farm.claim(node, at(20)).await.unwrap();
    farm.store.drop_frames(job, &FrameSet::range(0, 0), at(41)).await.unwrap();
    farm.store.retry_frames(job, &FrameSet::range(0, 0), at(42)).await.unwrap();
    let late = farm.result_for(&lost).await;
    let refused = farm.store.commit_result(lost.lease_id, lost.fence, &late, at(43)).await;
    assert!(matches!(refused, Err(StoreError::LeaseLost)), "{refused:?}");
    assert_eq!(farm.done(node, 9).await, all);
    let frame = farm.store.frame(job, 0).await.unwrap();
    assert_eq!(frame.state, FrameState::Done);
}

#[tokio::test]
async fn the_cache_of_a_frame_in_passes_stays_for_all_of_them() {
    let farm = Farm::new().await;
    let node = farm.node("a").await.id;
    let job = farm.job_in_passes("0", node, 2).await;
    let lease = farm.claim(node, at(20)).await.unwrap();
    let hash = farm.artifact("a plan").await;
    let result = TaskResult::Divide(DivideResult {
        expected_work: None,
        ends: vec![100, 200],
        work: vec![10, 10],
        cache: Some(FrameCache { hash, bytes: 6, full: false }),
        coarse_png: None,
        samples: Some(farm.artifact("one sample").await),
        spent: Spent::default(),
    });
    farm.store.commit_result(lease.lease_id, lease.fence, &result, at(20)).await.unwrap();
    let (divide, fill, part) = (TaskKind::Divide, TaskKind::CacheFill, TaskKind::RenderPart);
    let round = [(fill, Some(0)), (fill, Some(1)), (TaskKind::CacheMerge, None)];
    assert_eq!(farm.done(node, 3).await, round);
    assert_eq!(farm.done(node, 3).await, round);
    assert_eq!(farm.done(node, 2).await, [(part, Some(0)), (part, Some(1))]);
    let cache = Some(farm.artifact("a cache").await);
    let again = farm.divide(node, [100, 200], "more samples").await;
    assert_eq!(again.frame_cache, cache);
    let lease = farm.claim(node, at(20)).await.unwrap();
    let TaskSpec::RenderPart(spec) = &lease.spec else { panic!("{:?}", lease.spec) };
    assert_eq!(spec.frame_cache, cache);
    farm.commit(&lease, at(20)).await;
    assert_eq!(farm.done(node, 3).await, [(part, Some(1)), (divide, None), (TaskKind::Render, None)]);
    assert!(farm.needs("a cache").await);
    // Rendered again, the frame has its cache.
    farm.store.retry_frames(job, &FrameSet::range(0, 0), at(30)).await.unwrap();
    let again = farm.divide(node, [100, 200], "one sample").await;
    assert_eq!((again.frame_cache, again.passes.unwrap().before.len()), (cache, 0));
    let rest = [(part, Some(0)), (part, Some(1)), (divide, None), (TaskKind::Render, None)];
    assert_eq!(farm.done(node, 9).await, rest);
}

/// Reports progress of a task that finishes few pixels. Returns into how many parts its rest is to be divided.
async fn renew(farm: &Farm, slow: &Lease, progress: f64, now: i64) -> Option<u32> {
    let pixels = FinishedPixels { done: 10, all: 100, work: 1, cpu_nanos: 5 };
    let renewal =
        RenewRequest { fence: slow.fence, progress, pixels: Some(pixels), ..RenewRequest::default() };
    let ttl = Duration::from_secs(100_000);
    farm.store.renew(slow.lease_id, &renewal, ttl, at(now)).await.unwrap().divide_rest
}

#[tokio::test]
async fn the_rest_of_a_late_part_of_a_pass_continues_from_its_samples() {
    let farm = Farm::new().await;
    let (a, b) = (farm.node("a").await.id, farm.node("b").await.id);
    let job = farm.job_in_passes("0", a, 2).await;
    farm.divide(a, [100, 200], "two samples").await;
    let slow = farm.claim(a, at(30)).await.unwrap();
    assert_eq!(renew(&farm, &slow, 0.1, 230).await, None);
    let other = farm.claim(b, at(230)).await.unwrap();
    farm.commit(&other, at(231)).await;
    assert!(farm.claim(b, at(231)).await.is_none(), "its node is idle");
    farm.store.sweep(at(232)).await.unwrap();
    assert_eq!(renew(&farm, &slow, 0.1, 233).await, Some(2));

    let TaskResult::RenderPart(made) = farm.result_for(&slow).await else { panic!() };
    let file = made.finished.hash();
    let rest = RestOfPart { ends: vec![40, 70, 100], work: vec![40, 0, 0] };
    let result = TaskResult::RenderPart(RenderPartResult { rest: Some(rest), ..made });
    farm.store.commit_result(slow.lease_id, slow.fence, &result, at(240)).await.unwrap();
    let all: Vec<(f64, u32)> = sqlx::query_as(
        "SELECT share, json_extract(spec, '$.render_part.parts') FROM tasks WHERE kind = 'render_part' ORDER BY part",
    )
    .fetch_all(farm.store.readers())
    .await
    .unwrap();
    // The worker forecast no work: the shares are those of the pixels.
    let shares = [0.5 * 0.4, 0.5, 0.5 * 0.3, 0.5 * 0.3];
    assert!(all.iter().zip(shares).all(|(found, share)| (found.0 - share).abs() < 1e-9), "{all:?}");
    assert!(all.iter().all(|found| found.1 == 4), "{all:?}");
    for (node, (from, to)) in [(b, (40, 70)), (a, (70, 100))] {
        let lease = farm.claim(node, at(241)).await.unwrap();
        let TaskSpec::RenderPart(spec) = &lease.spec else { panic!("{:?}", lease.spec) };
        assert_eq!((spec.parts, spec.range), (4, None));
        let pass = spec.pass.clone().unwrap();
        assert_eq!((pass.pixels, pass.before), (PixelRange { from, to }, vec![file]));
        farm.commit(&lease, at(242)).await;
    }
    // The next pass has the four parts.
    let again = farm.divide(a, [50, 100, 150, 200], "more samples").await;
    assert_eq!((again.parts, again.passes.unwrap().before.len()), (4, 4));
    let shares: Vec<Option<f64>> =
        sqlx::query_scalar("SELECT share FROM tasks WHERE kind = 'render_part' ORDER BY part")
            .fetch_all(farm.store.readers())
            .await
            .unwrap();
    assert_eq!(shares, [None; 4]);
    let first = farm.claim(a, at(250)).await.unwrap();
    let TaskSpec::RenderPart(spec) = &first.spec else { panic!("{:?}", first.spec) };
    // Pixels 0 to 49 were in the file of the first piece, and in that of the second.
    assert_eq!(spec.pass.as_ref().unwrap().before.len(), 2);
    farm.commit(&first, at(251)).await;
    farm.done(a, 9).await;
    assert_eq!(farm.store.job(job).await.unwrap().state, JobState::Done);
    // Rendered again, it has its four parts in every pass.
    farm.store.retry_frames(job, &FrameSet::range(0, 0), at(260)).await.unwrap();
    let again = farm.divide(a, [50, 100, 150, 200], "two samples").await;
    assert_eq!((again.parts, again.passes.unwrap().before.len()), (4, 0));
    farm.done(a, 9).await;
    assert_eq!(farm.store.job(job).await.unwrap().state, JobState::Done);
}

#[tokio::test]
async fn the_rest_of_a_late_part_is_divided_among_idle_nodes() {
    let farm = Farm::new().await;
    let (a, b, c) = (farm.node("a").await.id, farm.node("b").await.id, farm.node("c").await.id);
    let job = farm.divided_job(request("0"), a, 2).await;
    farm.done(a, 2).await;
    let slow = farm.claim(a, at(30)).await.unwrap();
    assert_eq!(slow.spec.part(), Some(1));
    // Nodes that ask for work are idle, and there.
    let wait = async |now| {
        for node in [b, c] {
            assert!(farm.claim(node, at(now)).await.is_none());
        }
    };
    let renew = async |progress, now| renew(&farm, &slow, progress, now).await;
    assert_eq!(renew(0.02, 32).await, None);
    wait(33).await;
    farm.store.sweep(at(33)).await.unwrap();
    assert_eq!(renew(0.03, 34).await, None, "it is not late yet");
    // Far beyond its forecast of a few seconds, and half an hour is left.
    assert_eq!(renew(0.1, 230).await, None);
    wait(231).await;
    farm.store.sweep(at(231)).await.unwrap();
    farm.store.sweep(at(232)).await.unwrap();
    assert_eq!(renew(0.1, 233).await, Some(3), "one for each idle node, and one for its own");
    let told = farm.events(EventKind::TaskLate).await;
    assert!(
        told.iter().any(|event| event.message.as_ref().is_some_and(|text| text.contains("into 3 parts")))
    );

    let TaskResult::RenderPart(made) = farm.result_for(&slow).await else { panic!() };
    let rest = RestOfPart { ends: vec![110, 140, 160, 200], work: vec![25, 25, 25, 25] };
    let result = TaskResult::RenderPart(RenderPartResult { rest: Some(rest), ..made });
    farm.store.commit_result(slow.lease_id, slow.fence, &result, at(240)).await.unwrap();
    let frame = farm.store.frame(job, 0).await.unwrap();
    assert_eq!((frame.parts, frame.parts_done), (5, 2));
    // Half of the frame, and a quarter of the other half.
    assert!((frame.progress - 0.625).abs() < 1e-9, "{}", frame.progress);
    let mut ranges = Vec::new();
    for node in [b, c, a] {
        let lease = farm.claim(node, at(241)).await.unwrap();
        let TaskSpec::RenderPart(spec) = &lease.spec else { panic!("{:?}", lease.spec) };
        ranges.push((spec.part, spec.range));
        farm.commit(&lease, at(242)).await;
    }
    let pixels = |from, to| Some(PartRange::Pixels(PixelRange { from, to }));
    assert_eq!(ranges, [(2, pixels(110, 140)), (3, pixels(140, 160)), (4, pixels(160, 200))]);
    let lease = farm.claim(a, at(243)).await.unwrap();
    let TaskSpec::Render(spec) = &lease.spec else { panic!("{:?}", lease.spec) };
    assert_eq!(spec.parts.len(), 5);
    farm.commit(&lease, at(244)).await;
    assert_eq!(farm.store.job(job).await.unwrap().state, JobState::Done);
    // Rendered again, it has its five parts.
    farm.store.retry_frames(job, &FrameSet::range(0, 0), at(250)).await.unwrap();
    assert_eq!(farm.done(a, 9).await.len(), 6);
    assert_eq!(farm.store.job(job).await.unwrap().state, JobState::Done);
}

#[tokio::test]
async fn a_part_is_done_before_a_nodes_window_ends_if_the_part_takes_no_longer() {
    let farm = Farm::new().await;
    let node = farm.node("a").await.id;
    farm.divided_job(request("0-1"), node, 4).await;
    let closed = forelight_protocol::TimeSpan { start: at(24), end: None };
    let terms = forelight_protocol::NodeTerms { maintenance: vec![closed], ..Default::default() };
    let change = forelight_protocol::NodeChange { terms: Some(terms), ..Default::default() };
    farm.store.change_node(node, &change, at(0)).await.unwrap();
    // One frame in twenty takes five seconds or more, and a part of it a quarter of that.
    let divide = farm.claim(node, at(20)).await.expect("a short task");
    farm.commit(&divide, at(20)).await;
    let part = farm.claim(node, at(20)).await.expect("a part");
    assert_eq!(part.spec.kind(), TaskKind::RenderPart);
}
