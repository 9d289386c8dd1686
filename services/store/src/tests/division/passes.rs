//! Frames that are rendered in passes.

use super::*;

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
