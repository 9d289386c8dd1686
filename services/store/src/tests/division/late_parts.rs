//! What is left of parts that take longer than forecast, and windows that end before a part would.

use super::*;

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
