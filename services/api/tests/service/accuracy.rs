//! Cost and error of a job at other qualities.

use crate::support::made_up::made_up_times;
use crate::support::{Answer, Farm};
use forelight_protocol::{
    AccuracyDoc, AnswersDoc, CacheMode, CacheSample, Integrator, Job, LadderKind, Ladders, Node, PlanChange,
    ProblemKind, ProfileResult, RenderSettings, TaskKind, TaskResult, TaskSpec, Timestamp,
};
use reqwest::StatusCode;
use serde_json::json;

async fn document(farm: &Farm, job: &Job) -> AccuracyDoc {
    farm.viewer.get(&format!("/v1/jobs/{}/accuracy", job.id)).await.parsed(StatusCode::OK).await
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_that_is_not_there_has_no_ladders_and_one_that_is_not_profiled_has_none_yet() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    for id in ["0197a8a5-0000-7000-8000-000000000000", "none"] {
        let answer = farm.viewer.get(&format!("/v1/jobs/{id}/accuracy")).await;
        answer.problem(ProblemKind::NotFound).await;
    }
    let job = farm.submit("0-4").await;
    let ask = || async { farm.viewer.get(&format!("/v1/jobs/{}/accuracy", job.id)).await };
    // Before the preview, after it, and after the first of two profiles.
    for _ in 0..3 {
        let problem = ask().await.problem(ProblemKind::Conflict).await;
        assert!(problem.detail.contains("not profiled"), "{}", problem.detail);
        let task = farm.next_task(&node).await;
        assert_ne!(task.spec.kind(), TaskKind::Render);
        farm.finish(&task).await;
    }
    assert_eq!(ask().await.status(), StatusCode::OK);
    let cancelled = farm.submit("0-4").await;
    farm.submitter.post(&format!("/v1/jobs/{}/cancel", cancelled.id), &json!({})).await;
    let answer = farm.viewer.get(&format!("/v1/jobs/{}/accuracy", cancelled.id)).await;
    assert!(answer.problem(ProblemKind::Conflict).await.detail.contains("cancelled"));
}

#[tokio::test(flavor = "multi_thread")]
async fn rungs_cost_in_proportion_and_err_by_the_profiled_variance() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let job = farm.submit("0-4").await;
    farm.until_booked(&node, &job).await;
    let document = document(&farm, &job).await;
    let quote = farm.quote(&job).await;
    assert_eq!((document.frames, &document.settings), (5, job.settings.own().unwrap()));
    assert_eq!((&document.profiled, document.spent), (&quote.profiled, quote.spent));

    let of = |kind| document.rungs.iter().filter(move |rung| rung.ladder == kind);
    let samples: Vec<u32> = of(LadderKind::Ambient).map(|rung| rung.settings.spp).collect();
    assert_eq!(samples, [1, 4, 16, 64, 256]);
    // Fixed per frame, whatever its samples: 5 units of work, and 5 ms at speed 2.
    let fixed = (5.0 * 5.0, 5.0 * 5e-3 * 2.0);
    let pixels = (quote.total.work.mean - fixed.0, quote.total.cpu_seconds.mean - fixed.1);
    for rung in of(LadderKind::Ambient) {
        let times = f64::from(rung.settings.spp) / 16.0;
        // Costs of a scaled pixel are whole numbers.
        let work = rung.work.mean / (fixed.0 + pixels.0 * times) - 1.0;
        let cpu = rung.cpu_seconds.mean / (fixed.1 + pixels.1 * times) - 1.0;
        assert!(work.abs() < 0.01 && cpu.abs() < 0.01, "{}: {work} {cpu}", rung.settings.spp);
        // Three quarters of the image have a variance of 1 / n; its mean is 1.75.
        let expected = 0.75f64.sqrt() / 1.75 / f64::from(rung.settings.spp).sqrt();
        let error = rung.error.unwrap();
        let allowed = if rung.settings.spp <= 16 { 0.02 } else { 0.1 };
        assert!((error.p50 / expected - 1.0).abs() < allowed, "{}: {error:?}", rung.settings.spp);
        assert!(error.p05 <= error.p50 && error.p50 <= error.p80 && error.p80 <= error.p95);
    }
    let asked = of(LadderKind::Ambient).find(|rung| rung.asked_for).unwrap();
    assert_eq!((asked.work, asked.cpu_seconds), (quote.total.work, quote.total.cpu_seconds));

    let marked: Vec<bool> = document.rungs.iter().map(|rung| rung.worth_taking).collect();
    let resolutions = of(LadderKind::Resolution).count();
    assert_eq!(marked, [vec![true; 5], vec![false; resolutions]].concat());
    let next = document.rungs[0].next.unwrap();
    assert_eq!(next.rung, 1);
    assert!((next.times_error / 0.5 - 1.0).abs() < 0.02 && next.times_cpu_seconds > 3.0, "{next:?}");
    assert!(document.rungs[4].next.is_none());

    let pixels: Vec<u64> = of(LadderKind::Resolution).map(|rung| rung.settings.pixels()).collect();
    assert_eq!(pixels, [16, 36, 64, 121, 256]);
    let largest = of(LadderKind::Resolution).next_back().unwrap();
    assert!((largest.work.mean / (4.0 * quote.total.work.mean) - 1.0).abs() < 0.01);
    assert_eq!(largest.error, asked.error);

    let missing: Vec<LadderKind> = document.missing.iter().map(|missing| missing.ladder).collect();
    let unknown = [LadderKind::Path, LadderKind::CachedSamples, LadderKind::Cache, LadderKind::Divisions];
    assert_eq!(missing, unknown);
    assert!(document.missing.iter().all(|missing| missing.reason.contains("all `ladders`")));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_with_a_cache_has_its_times_and_no_errors_and_says_why() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let mut request = farm.job_request("0-1");
    request["profile_frames"] = json!(1);
    request["settings"] = json!({"cache": "on", "ambient_bounces": 1, "spp": 4});
    request["cache"] = json!("private");
    let job: Job = farm.submitter.post("/v1/jobs", &request).await.parsed(StatusCode::CREATED).await;
    let preview = farm.next_task(&node).await;
    let TaskResult::Preview(mut previewed) = farm.made_up_result(&preview).await else { panic!() };
    previewed.frames.iter_mut().for_each(|frame| frame.cache_records = vec![30]);
    previewed.record_prior_cost = Some(10.0);
    assert_eq!(farm.report(&preview, TaskResult::Preview(previewed)).await.status(), StatusCode::OK);
    let profile = farm.next_task(&node).await;
    let TaskResult::Profile(mut profiled) = farm.made_up_result(&profile).await else { panic!() };
    profiled.noise.clear();
    profiled.cache_samples =
        vec![CacheSample { level: 0, own: false, work: 7000, cpu_nanos: 1, rays: [0; 7] }; 8];
    assert_eq!(farm.report(&profile, TaskResult::Profile(profiled)).await.status(), StatusCode::OK);
    let document = document(&farm, &job).await;
    let known =
        document.rungs.iter().all(|rung| rung.ladder == LadderKind::CachedSamples && rung.error.is_none());
    assert!(known, "{:?}", document.rungs);
    assert!(
        document
            .rungs
            .iter()
            .all(|rung| !rung.worth_taking && rung.settings.cache == job.settings.own().unwrap().cache)
    );
    // Records are gathered once, whatever the samples.
    let [first, second] = [0, 1].map(|i| document.rungs[i].work.mean);
    let records = 2.0 * 30.0 * 7000.0;
    assert!(first > records && (second - first) * 4.0 / 3.0 + records < second * 1.01, "{first} {second}");
    assert!(document.missing.iter().any(|missing| missing.reason.contains("before the irradiance cache")));
}

/// Works off a job with all ladders up to its booking, with changed profiles. Returns the frames profiled for
/// ladders.
async fn booked_after(farm: &Farm, node: &Node, job: &Job, change: impl Fn(&mut ProfileResult)) -> Vec<u32> {
    let mut laid_out = Vec::new();
    while !farm.job(job).await.state.is_final() {
        let task = farm.next_task(node).await;
        match &task.spec {
            TaskSpec::Render(_) => break,
            TaskSpec::Profile(spec) if spec.ladders => laid_out.push(spec.frame),
            _ => {}
        }
        let mut result = farm.made_up_result(&task).await;
        if let TaskResult::Profile(result) = &mut result {
            change(result);
        }
        farm.report(&task, result).await.parsed::<serde_json::Value>(StatusCode::OK).await;
    }
    laid_out
}

async fn booked_with_ladders(farm: &Farm, node: &Node, job: &Job) -> Vec<u32> {
    booked_after(farm, node, job, |_| ()).await
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_that_asks_for_all_ladders_has_those_of_other_settings_by_one_of_its_frames() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let mut request = farm.job_request("0-4");
    request["ladders"] = json!("all");
    request["profile_frames"] = json!(3);
    request["settings"] = json!({"ambient_bounces": 1, "spp": 16, "width": 8, "height": 8});
    let job: Job = farm.submitter.post("/v1/jobs", &request).await.parsed(StatusCode::CREATED).await;
    assert_eq!(job.ladders, Ladders::All);
    let laid_out = booked_with_ladders(&farm, &node, &job).await;
    assert_eq!(laid_out.len(), 1, "one frame stands for all");
    let document = document(&farm, &job).await;
    let quote = farm.quote(&job).await;
    assert!(quote.profiled.frames.contains(&laid_out[0]) && quote.profiled.frames[0] < laid_out[0]);
    // The job's own ladders are unchanged. The others are given as ratios to the request, for price and
    // error.
    let asked = document.rungs.iter().find(|rung| rung.asked_for).unwrap();
    assert_eq!(asked.work, quote.total.work);
    for kind in LadderKind::ALL {
        let rungs: Vec<_> = document.rungs.iter().filter(|rung| rung.ladder == kind).collect();
        let settings: Vec<_> = rungs.iter().map(|rung| rung.settings.clone()).collect();
        assert_eq!(settings, forelight_quote::ladder(kind, job.settings.own().unwrap()).unwrap(), "{kind:?}");
        if [LadderKind::Ambient, LadderKind::Resolution].contains(&kind) {
            continue;
        }
        for (place, rung) in (1..).zip(rungs) {
            let times =
                if Some(&rung.settings) == job.settings.own() { 1.0 } else { made_up_times(kind, place) };
            assert!((rung.work.mean / (times * asked.work.mean) - 1.0).abs() < 1e-9, "{rung:?}");
            assert!((rung.cpu_seconds.p95 / (times * asked.cpu_seconds.p95) - 1.0).abs() < 1e-9, "{rung:?}");
            let (error, own) = (rung.error.unwrap(), asked.error.unwrap());
            assert!((error.p80 / (times * own.p80) - 1.0).abs() < 1e-9, "{error:?} {own:?}");
            assert!((error.p05 / (times * own.p05) - 1.0).abs() < 1e-9, "{error:?} {own:?}");
        }
    }
    assert_eq!(document.missing.len(), 1);
    assert_eq!(document.missing[0].reason, "too dear");
    // Their cost is part of the quote's: three profiles of 1000 and a preview of 100.
    assert_eq!(document.spent.work, 3100);
    assert_eq!(document.profiled.pixels, quote.profiled.pixels + 99, "those of the ladders count as well");
}

#[tokio::test(flavor = "multi_thread")]
async fn other_resolutions_of_a_job_of_one_sample_err_as_what_was_asked_for_does() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let mut request = farm.job_request("0");
    request["ladders"] = json!("all");
    request["settings"] = json!({"ambient_bounces": 1, "spp": 1, "width": 8, "height": 8});
    let job: Job = farm.submitter.post("/v1/jobs", &request).await.parsed(StatusCode::CREATED).await;
    // One sample per pixel shows no variance.
    booked_after(&farm, &node, &job, |result| result.noise.clear()).await;
    let document = document(&farm, &job).await;
    let asked = document.rungs.iter().find(|rung| rung.asked_for).unwrap();
    let resolutions: Vec<_> =
        document.rungs.iter().filter(|rung| rung.ladder == LadderKind::Resolution).collect();
    assert_eq!(resolutions.len(), 5);
    assert!(
        resolutions.iter().all(|rung| rung.error.is_some() && rung.error == asked.error),
        "{resolutions:?}"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn ladders_that_could_not_be_laid_out_are_missing_for_that_reason() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let mut request = farm.job_request("0");
    request["ladders"] = json!("all");
    request["settings"] = json!({"ambient_bounces": 1, "spp": 16, "width": 8, "height": 8});
    let job: Job = farm.submitter.post("/v1/jobs", &request).await.parsed(StatusCode::CREATED).await;
    let fail = |result: &mut ProfileResult| {
        let ladders = result.ladders.as_mut().unwrap();
        **ladders = forelight_quote::without_ladders(0, &ladders.settings, "no room");
    };
    booked_after(&farm, &node, &job, fail).await;
    let document = document(&farm, &job).await;
    let missing: Vec<_> = document.missing.iter().map(|missing| (missing.ladder, &*missing.reason)).collect();
    let of_others = [LadderKind::Path, LadderKind::CachedSamples, LadderKind::Cache, LadderKind::Divisions];
    assert_eq!(missing, of_others.map(|ladder| (ladder, "no room")));
    assert!(document.rungs.iter().all(|rung| rung.error.is_some()), "those of its own are there");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_that_is_late_is_offered_other_settings_that_would_be_in_time() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let mut request = farm.job_request("0-4");
    request["ladders"] = json!("all");
    request["settings"] = json!({"ambient_bounces": 1, "spp": 16, "width": 8, "height": 8});
    // As requested it takes four minutes.
    request["deadline"] = json!(Timestamp::from_micros(Timestamp::now().micros() + 120_000_000));
    let job: Job = farm.submitter.post("/v1/jobs", &request).await.parsed(StatusCode::CREATED).await;
    booked_with_ladders(&farm, &node, &job).await;
    let path = format!("/v1/jobs/{}/answers", job.id);
    let answers: AnswersDoc = farm.submitter.get(&path).await.parsed(StatusCode::OK).await;
    let of = |has: &dyn Fn(&RenderSettings) -> bool| {
        answers.qualities.iter().filter(|offer| has(&offer.settings)).count()
    };
    assert!(of(&|settings| settings.integrator == Integrator::Path) >= 5, "{:?}", answers.qualities);
    assert!(of(&|settings| settings.cache == CacheMode::On) >= 5);
    assert_eq!(of(&|settings| Some(settings) == job.settings.own()), 1, "each quality is offered once");
    // The best quality that is on time.
    let verdict = farm.job(&job).await.verdict.unwrap();
    let way = verdict.ways_out.iter().find_map(|way| match &way.change {
        PlanChange::Quality { settings: Some(settings), .. } => Some((settings, &way.words)),
        _ => None,
    });
    let (settings, words) = way.unwrap_or_else(|| panic!("{:?}", verdict.ways_out));
    assert_eq!((settings.cache, settings.spp), (CacheMode::On, 1));
    assert!(
        words.starts_with("an irradiance cache of accuracy 0.2, 1 sample a pixel instead of 16"),
        "{words}"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn ladders_that_make_no_sense_are_refused_with_the_place() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let mut request = farm.job_request("0");
    request["ladders"] = json!("all");
    request["within"] = json!({"cpu_micros": 1_000_000});
    let answer = farm.submitter.post("/v1/jobs", &request).await;
    assert_eq!(answer.problem(ProblemKind::Invalid).await.pointer.as_deref(), Some("/ladders"));
    request.as_object_mut().unwrap().remove("within");
    farm.submitter.post("/v1/jobs", &request).await.parsed::<Job>(StatusCode::CREATED).await;
    let preview = farm.next_task(&node).await;
    farm.finish(&preview).await;
    let profile = farm.next_task(&node).await;
    let TaskResult::Profile(good) = farm.made_up_result(&profile).await else { panic!() };
    let at = |change: &dyn Fn(&mut AccuracyDoc)| {
        let mut result = good.clone();
        change(result.ladders.as_mut().unwrap());
        result
    };
    let first = |pointer: &str| format!("/result/profile/ladders/rungs/0/{pointer}");
    for (result, pointer) in [
        (at(&|l| l.settings.spp += 1), "/result/profile/ladders/settings".to_owned()),
        (at(&|l| l.rungs[0].settings.spp = 3), first("settings")),
        (at(&|l| l.rungs[0].ladder = LadderKind::Divisions), first("settings")),
        (at(&|l| l.rungs[1] = l.rungs[0].clone()), "/result/profile/ladders/rungs/1/settings".to_owned()),
        (at(&|l| l.rungs[0].work.p80 = -1.0), first("work")),
        (at(&|l| l.rungs[0].cpu_seconds.mean = 1e31), first("cpu_seconds")),
        (at(&|l| l.rungs[0].error.as_mut().unwrap().p95 = -0.1), first("error")),
        // The job's images keep their noise.
        (at(&|l| l.rungs[0].denoised_error = l.rungs[0].error), first("denoised_error")),
        (at(&|l| l.missing[0].reason = "x".repeat(5000)), "/result/profile/ladders/missing".to_owned()),
        (at(&|l| l.profiled.pixels = u64::MAX), "/result/profile/ladders/profiled/pixels".to_owned()),
        (at(&|l| l.spent.work = u64::MAX), "/result/profile/ladders/spent/work".to_owned()),
    ] {
        let answer = farm.report(&profile, TaskResult::Profile(result)).await;
        let problem = answer.problem(ProblemKind::Invalid).await;
        assert_eq!(problem.pointer.as_deref(), Some(&*pointer), "{}", problem.detail);
    }
    // An older worker sends no other ladders, so the job has only its own.
    let mut without = good;
    without.ladders = None;
    farm.report(&profile, TaskResult::Profile(without))
        .await
        .parsed::<serde_json::Value>(StatusCode::OK)
        .await;
}

#[tokio::test(flavor = "multi_thread")]
async fn noise_that_makes_no_sense_is_refused_with_the_place() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    farm.submit("0").await;
    let preview = farm.next_task(&node).await;
    farm.finish(&preview).await;
    let profile = farm.next_task(&node).await;
    let TaskResult::Profile(good) = farm.made_up_result(&profile).await else { panic!() };
    let at = |change: &dyn Fn(&mut forelight_protocol::ProfileResult)| {
        let mut result = good.clone();
        change(&mut result);
        result
    };
    for (result, pointer) in [
        (at(&|r| r.noise[0].pixels = 47), "/result/profile/noise"),
        (at(&|r| r.noise[1].samples.clear()), "/result/profile/noise/1/samples"),
        (at(&|r| r.noise[0].samples[2].brightness = -1.0), "/result/profile/noise/0/samples/2/brightness"),
        (at(&|r| r.noise[0].samples[0].drops.clear()), "/result/profile/noise/0/samples/0/drops"),
        (at(&|r| r.noise[0].samples[0].drops[1] = -1e-9), "/result/profile/noise/0/samples/0/drops"),
        (at(&|r| r.noise[0].samples[0].drops[1] = 1e36), "/result/profile/noise/0/samples/0/drops"),
    ] {
        let answer = farm.report(&profile, TaskResult::Profile(result)).await;
        let problem = answer.problem(ProblemKind::Invalid).await;
        assert_eq!(problem.pointer.as_deref(), Some(pointer), "{}", problem.detail);
    }
    farm.report(&profile, TaskResult::Profile(good)).await.parsed::<serde_json::Value>(StatusCode::OK).await;
}
