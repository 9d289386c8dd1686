//! Results that do not fit their task.

use crate::support::{Answer, Farm};
use forelight_protocol::{ArtifactHash, CacheSample, PreviewResult, ProblemKind, ProfileResult, TaskResult};

/// Previews with one error each, and its place.
fn bad_previews(preview: &PreviewResult) -> Vec<(PreviewResult, &'static str)> {
    let mut cases = Vec::new();
    let mut few = preview.clone();
    few.frames.pop();
    cases.push((few, "/result/preview/frames"));
    let mut other = preview.clone();
    other.frames[2].frame = 19;
    cases.push((other, "/result/preview/frames/2/frame"));
    let mut short = preview.clone();
    short.frames[1].pixels.clear();
    cases.push((short, "/result/preview/frames/1/pixels"));
    let mut many = preview.clone();
    many.frames[3].background += 1;
    cases.push((many, "/result/preview/frames/3/pixels"));
    let mut twice = preview.clone();
    twice.strata.push(twice.strata[0].clone());
    cases.push((twice, "/result/preview/strata/1"));
    for prior_cost in [0.0, -1.0, 1.1e6, f64::MIN_POSITIVE / -2.0] {
        let mut priced = preview.clone();
        priced.strata[0].prior_cost = prior_cost;
        cases.push((priced, "/result/preview/strata/0/prior_cost"));
        let mut empty = preview.clone();
        empty.background_prior_cost = prior_cost;
        cases.push((empty, "/result/preview/background_prior_cost"));
    }
    let mut cached = preview.clone();
    cached.frames[1].cache_records = vec![100];
    cases.push((cached, "/result/preview/frames/1/cache_records"));
    let mut dear = preview.clone();
    dear.record_prior_cost = Some(0.0);
    cases.push((dear, "/result/preview/record_prior_cost"));
    let mut nothing = preview.clone();
    nothing.strata[0].object = u32::MAX;
    cases.push((nothing, "/result/preview/strata/0/object"));
    cases
}

/// Profiles with one error each, and its place.
fn bad_profiles(good: ProfileResult) -> [(ProfileResult, &'static str); 5] {
    let mut stray = good.clone();
    stray.samples[5].pixel = 64;
    let mut gathered = good.clone();
    gathered.cache_samples = vec![CacheSample { level: 0, own: false, work: 1, cpu_nanos: 1, rays: [0; 7] }];
    let mut endless = good.clone();
    endless.fixed.plan.work = u64::MAX;
    let mut short = good.clone();
    short.samples[2].work_by_ray[0] -= 1;
    let mut wordy = good;
    wordy.effects = vec!["x".repeat(101)];
    [
        (stray, "/result/profile/samples/5/pixel"),
        (gathered, "/result/profile/cache_samples/0/level"),
        (endless, "/result/profile/fixed/plan"),
        (short, "/result/profile/samples/2/work_by_ray"),
        (wordy, "/result/profile/effects"),
    ]
}

#[tokio::test(flavor = "multi_thread")]
async fn a_result_that_does_not_fit_its_task_is_refused_with_the_place_and_the_lease_stays() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    farm.submit("0-3").await;
    let lease = farm.next_task(&node).await;
    let good = farm.made_up_result(&lease).await;
    let TaskResult::Preview(preview) = good else { panic!("{good:?}") };
    for (bad, pointer) in bad_previews(&preview) {
        let problem = farm.report(&lease, TaskResult::Preview(bad)).await.problem(ProblemKind::Invalid).await;
        assert_eq!(problem.pointer.as_deref(), Some(pointer));
    }
    assert!(!farm.finish(&lease).await.duplicate);
    let profile = farm.next_task(&node).await;
    let TaskResult::Profile(good) = farm.made_up_result(&profile).await else { panic!() };
    let mut missing = good.clone();
    missing.artifacts.profile = ArtifactHash([9; 32]);
    let problem =
        farm.report(&profile, TaskResult::Profile(missing)).await.problem(ProblemKind::MissingArtifact).await;
    assert!(problem.detail.contains("0909"), "{}", problem.detail);
    for (bad, pointer) in bad_profiles(good) {
        let answer = farm.report(&profile, TaskResult::Profile(bad)).await;
        let problem = answer.problem(ProblemKind::Invalid).await;
        assert_eq!(problem.pointer.as_deref(), Some(pointer));
    }
    assert!(!farm.finish(&profile).await.duplicate);
}
