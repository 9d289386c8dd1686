//! Jobs with a limit on time or money in place of a number of samples.

use crate::support::{Answer, Farm};
use forelight_protocol::{
    AccuracyDoc, AllottedStats, Job, JobState, ProblemKind, RenderResult, RenderStats, TaskResult, TaskSpec,
};
use reqwest::StatusCode;
use serde_json::{Value, json};

async fn submit(farm: &Farm, within: Value) -> Job {
    let mut request = farm.job_request("0-3");
    request["within"] = within;
    request["confidence"] = json!("p95");
    farm.submitter.post("/v1/jobs", &request).await.parsed(StatusCode::CREATED).await
}

#[tokio::test]
async fn the_most_samples_that_fit_are_chosen_said_and_rendered() {
    let farm = Farm::new().await;
    let node = farm.node("n").await;
    let plain = farm.submit("0-3").await;
    let plain = farm.until_booked(&node, &plain).await;
    let asked = farm.quote(&plain).await;
    assert_eq!(asked.chosen_spp, None);
    farm.submitter.post(&format!("/v1/jobs/{}/cancel", plain.id), &json!({})).await;

    let given = 5.0 * asked.total.cpu_seconds.p95;
    let job = submit(&farm, json!({"cpu_micros": (given * 1e6) as i64})).await;
    let job = farm.until_booked(&node, &job).await;
    let quoted = farm.quote(&job).await;
    let spp = quoted.chosen_spp.unwrap();
    assert_eq!(job.settings.own().unwrap().spp, spp, "the job says what it is rendered with");
    assert!(
        spp >= 4 * plain.settings.own().unwrap().spp && spp <= 6 * plain.settings.own().unwrap().spp,
        "{spp}"
    );
    assert!(quoted.total.cpu_seconds.p95 <= given, "{:?} in {given}", quoted.total.cpu_seconds);
    assert!(quoted.total.cpu_seconds.p95 > 0.9 * given, "{:?} in {given}", quoted.total.cpu_seconds);
    // Later answers from the profile are about the rendered images.
    let path = format!("/v1/jobs/{}/accuracy", job.id);
    let ladders: AccuracyDoc = farm.viewer.get(&path).await.parsed(StatusCode::OK).await;
    let own = ladders.rungs.iter().find(|rung| rung.asked_for).unwrap();
    assert!((own.cpu_seconds.mean / quoted.total.cpu_seconds.mean - 1.0).abs() < 1e-9, "{own:?}");
    let lease = farm.claim_waiting(&node, 5000).await.unwrap();
    let TaskSpec::Render(spec) = &lease.spec else { panic!("{:?}", lease.spec) };
    assert_eq!(
        (spec.settings.own().unwrap().spp, spec.profile),
        (spp, None),
        "profiled pixels have other samples"
    );
    let of_frame = quoted.frames.iter().find(|each| each.frame == spec.frame).unwrap();
    assert_eq!(spec.work, Some(of_frame.work.mean.round() as u64), "it may take what so many samples take");
    // The result says how it spent the work; impossible values are refused.
    let TaskResult::Render(made) = farm.made_up_result(&lease).await else { panic!() };
    let spent = *made.stats.allotted.clone().unwrap();
    let with = |allotted: Option<AllottedStats>| {
        let stats = RenderStats { allotted: allotted.map(Box::new), ..made.stats.clone() };
        TaskResult::Render(RenderResult { stats, ..made.clone() })
    };
    let above = AllottedStats { least: spent.most + 1, ..spent.clone() };
    let other = AllottedStats { mean: spent.mean - 1.0, ..spent.clone() };
    let none = AllottedStats { least: 0, ..spent };
    for allotted in [above, other, none].map(Some).into_iter().chain([None]) {
        farm.report(&lease, with(allotted)).await.problem(ProblemKind::Invalid).await;
    }
    assert_eq!(farm.report(&lease, TaskResult::Render(made)).await.status(), StatusCode::OK);
}

#[tokio::test]
async fn money_buys_samples_for_each_frame() {
    let farm = Farm::new().await;
    let node = farm.node("n").await;
    // Speed 2, two cores and 3.6 units per hour: a CPU second of speed 1 costs 250 micro-units.
    let job = submit(&farm, json!({"money": 250 * 400, "per": "frame"})).await;
    let job = farm.until_booked(&node, &job).await;
    let quoted = farm.quote(&job).await;
    let dearest = quoted.frames.iter().map(|frame| frame.cpu_seconds.p95).fold(0.0, f64::max);
    assert!(dearest <= 400.0 && dearest > 320.0, "{dearest} with {:?}", quoted.chosen_spp);
}

#[tokio::test]
async fn too_little_fails_with_what_would_do_and_nonsense_is_refused() {
    let farm = Farm::new().await;
    let node = farm.node("n").await;
    let job = submit(&farm, json!({"cpu_micros": 5})).await;
    let failed = farm.until_booked(&node, &job).await;
    assert_eq!(failed.state, JobState::Failed);
    let error = failed.error.unwrap();
    assert!(
        error.contains("one camera sample") && error.contains("the limit is 0.000005 CPU seconds"),
        "{error}"
    );
    // The limit named in the error does fit.
    let words: Vec<&str> = error.split(' ').collect();
    let least: f64 = words[words.iter().position(|word| *word == "takes").unwrap() + 1].parse().unwrap();
    let least = (least * 1e6).round() as i64;
    let job = submit(&farm, json!({"cpu_micros": least + 1})).await;
    assert_eq!(farm.until_booked(&node, &job).await.settings.own().unwrap().spp, 1);

    for (within, place) in [
        (json!({}), "/within"),
        (json!({"cpu_micros": 5, "money": 5}), "/within"),
        (json!({"cpu_micros": 0}), "/within/cpu_micros"),
        (json!({"money": -3}), "/within/money"),
    ] {
        let mut request = farm.job_request("0");
        request["within"] = within;
        let refused = farm.submitter.post("/v1/jobs", &request).await;
        assert_eq!(refused.status(), StatusCode::UNPROCESSABLE_ENTITY, "{place}");
        assert!(refused.text().await.unwrap().contains(place), "{place}");
    }
}
