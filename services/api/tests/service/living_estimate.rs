//! The estimate of a running job and the explanation of a quote.

use crate::support::{Answer, Farm};
use forelight_protocol::{
    BookedQuantity, Event, EventKind, Explanation, ForecastDoc, ForecastHistory, Job, Lease, MoneyQuantiles,
    Node, Problem, ProblemKind, TaskResult,
};
use reqwest::StatusCode;
use serde_json::json;
use std::collections::BTreeSet;

/// Renders the next frame at this multiple of the profiled cost.
async fn render(farm: &Farm, node: &Node, times: f64) -> Lease {
    let lease = farm.next_task(node).await;
    let TaskResult::Render(mut render) = farm.made_up_result(&lease).await else { panic!("{lease:?}") };
    render.stats.work = (render.stats.work as f64 * times) as u64;
    render.stats.cpu_seconds *= times;
    let answer = farm.report(&lease, TaskResult::Render(render)).await;
    assert_eq!(answer.status(), StatusCode::OK);
    lease
}

async fn history(farm: &Farm, job: &Job) -> ForecastHistory {
    farm.viewer.get(&format!("/v1/jobs/{}/forecast/history", job.id)).await.parsed(StatusCode::OK).await
}

#[tokio::test(flavor = "multi_thread")]
async fn a_dearer_job_is_seen_as_such_told_of_and_drawn_and_its_quote_stays() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let job = farm.submit("0-9").await;
    let path = format!("/v1/jobs/{}/forecast/history", job.id);
    for path in [path.clone(), format!("{path}.svg")] {
        farm.viewer.get(&path).await.problem(ProblemKind::Conflict).await;
    }
    let booked = farm.until_booked(&node, &job).await;
    let quote_path = format!("/v1/jobs/{}/forecast", job.id);
    let quote: ForecastDoc = farm.viewer.get(&quote_path).await.parsed(StatusCode::OK).await;
    let begin = booked.live.unwrap();
    let close = |one: f64, other: f64| (one / other - 1.0).abs() < 1e-12;
    assert!(close(begin.work.whole.p80, quote.total.work.p80), "{begin:?}");
    assert!(close(begin.cpu_seconds.remaining.p95, quote.total.cpu_seconds.p95), "{begin:?}");
    assert_eq!(begin.booked.cost, booked.verdict.unwrap().cost);
    assert!(
        begin.cost.unwrap().p50 >= quote.cost.unwrap().p50,
        "the quote itself was not for nothing: {begin:?}"
    );

    for _ in 0..4 {
        render(&farm, &node, 1.5).await;
    }
    let under_way = farm.job(&job).await.live.unwrap();
    assert!(under_way.work.factor > 1.3 && under_way.work.factor < 1.55, "{under_way:?}");
    assert!(under_way.work.whole.p50 > quote.total.work.p95, "{under_way:?}");
    // The estimate differs from the booking, unless the resulting new plan is already made.
    let is_booked_anew = under_way.booked.cpu_seconds > begin.booked.cpu_seconds;
    assert!(under_way.cost_is_off || is_booked_anew, "{under_way:?}");
    assert!(under_way.cpu_seconds.whole.p50 > quote.total.cpu_seconds.p95, "{under_way:?}");
    for _ in 0..6 {
        render(&farm, &node, 1.5).await;
    }
    let history = history(&farm, &job).await;
    let last = history.points.last().unwrap();
    // The new plan, made because the job takes longer, may be a point as well.
    let frames: BTreeSet<u32> = history.points.iter().map(|point| point.frames_done).collect();
    assert_eq!((frames.len(), last.frames_done, history.frames_total), (11, 10, 10));
    let truth: f64 = (0..10).map(|frame| (f64::from(48 * (1000 + 10 * frame) + 165) * 1.5).floor()).sum();
    assert_eq!((last.work.p50, last.work.p95, last.work_spent), (truth, truth, truth));
    let done = farm.job(&job).await;
    assert_eq!(history.now, done.live.unwrap());
    assert_eq!(history.now.cost.unwrap(), MoneyQuantiles::default().plus(done.spent.unwrap_or_default()));
    let after: ForecastDoc = farm.viewer.get(&quote_path).await.parsed(StatusCode::OK).await;
    assert_eq!(after, quote, "a quote never changes");

    let store = farm.service.store();
    let events: Vec<Event> = store.events_after(Some(job.id), 0, 1000).await.unwrap();
    let is_news =
        |event: &&Event| [EventKind::JobOffForecast, EventKind::JobOnForecast].contains(&event.kind);
    let told: Vec<&Event> = events.iter().filter(is_news).collect();
    assert!(!told.is_empty());
    for quantity in [BookedQuantity::Cost, BookedQuantity::Finish] {
        // Each new plan may bring the estimate back to its booking: it leaves and comes back in turns.
        let of_it =
            told.iter().filter(|event| event.off_forecast.is_some_and(|off| off.quantity == quantity));
        let turns = [EventKind::JobOffForecast, EventKind::JobOnForecast].into_iter().cycle();
        assert!(of_it.zip(turns).all(|(event, kind)| event.kind == kind), "{quantity:?}: {told:?}");
    }
    assert!(told[0].off_forecast.unwrap().cpu_seconds > begin.booked.cpu_seconds);
    let drawn = farm.viewer.get(&format!("{path}.svg")).await;
    assert_eq!(drawn.headers()["content-type"], "image/svg+xml");
    let drawn = drawn.text().await.unwrap();
    for word in ["<svg", "booked, at P80", "the truth", "frames finished, of 10", "When it will be done"] {
        assert!(drawn.contains(word), "no {word} in {drawn}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_quote_explains_itself_as_a_whole_and_frame_by_frame() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let job = farm.submit("0-9").await;
    let path = format!("/v1/jobs/{}/explanation", job.id);
    farm.viewer.get(&path).await.problem(ProblemKind::Conflict).await;
    farm.until_booked(&node, &job).await;
    let quote = farm.quote(&job).await;
    let whole: Explanation = farm.viewer.get(&path).await.parsed(StatusCode::OK).await;
    assert!((whole.work / quote.total.work.mean - 1.0).abs() < 1e-12);
    let shares: f64 = whole.parts.iter().map(|part| part.share).sum();
    assert!((shares - 1.0).abs() < 1e-9, "{whole:?}");
    let quad = &whole.objects[0];
    assert_eq!((quad.name().as_str(), quad.pixels), ("quad, paint", 480));
    // Two profiled frames with 16 pixels each; three quarters show the quad.
    assert_eq!(quad.samples, 24);
    assert!((quad.share_per_sample.unwrap() * 24.0 - quad.share).abs() < 1e-12);
    assert!(quad.share > 0.99 && quad.times_mean_pixel > 1.3, "{quad:?}");
    assert!(whole.words.iter().any(|line| line.starts_with("quad, paint: 99.")), "{:?}", whole.words);
    let pixels = whole.parts.iter().find(|part| part.part == "pixels").unwrap().work;
    let primary = &whole.rays[0];
    assert_eq!(primary.category, "primary");
    assert!((primary.work.unwrap() / pixels - 0.75).abs() < 0.01, "{whole:?}");
    let by_ray: f64 = whole.rays.iter().filter_map(|ray| ray.work).sum();
    assert!((by_ray / pixels - 1.0).abs() < 1e-9, "{whole:?}");
    assert!(whole.words.last().unwrap().starts_with("to halve the work: "), "{:?}", whole.words);
    let one: Explanation = farm.viewer.get(&format!("{path}?frame=3")).await.parsed(StatusCode::OK).await;
    assert_eq!((one.frame, one.objects[0].pixels), (Some(3), 48));
    assert!((one.work / quote.frames[3].work.mean - 1.0).abs() < 1e-12);
    let problem: Problem =
        farm.viewer.get(&format!("{path}?frame=10")).await.problem(ProblemKind::NotFound).await;
    assert_eq!(problem.detail, "the job has no frame 10");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_quote_whose_samples_were_chosen_for_a_time_is_explained_at_those() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let mut request = farm.job_request("0-3");
    request["within"] = json!({"cpu_micros": 2_000_000_000i64});
    let job: Job = farm.submitter.post("/v1/jobs", &request).await.parsed(StatusCode::CREATED).await;
    let booked = farm.until_booked(&node, &job).await;
    assert_ne!(booked.settings.own().unwrap().spp, job.settings.own().unwrap().spp);
    let path = format!("/v1/jobs/{}", job.id);
    let quote: ForecastDoc = farm.viewer.get(&format!("{path}/forecast")).await.parsed(StatusCode::OK).await;
    let whole: Explanation =
        farm.viewer.get(&format!("{path}/explanation")).await.parsed(StatusCode::OK).await;
    assert!((whole.work / quote.total.work.mean - 1.0).abs() < 1e-12, "{} {:?}", whole.work, quote.total);
    let spp = f64::from(booked.settings.own().unwrap().spp);
    assert!(whole.halving.iter().any(|way| way.setting == "spp" && way.from == spp), "{whole:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn finished_pixels_are_reported_with_renewals_and_more_than_there_are_is_refused() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let job = farm.submit("0-1").await;
    farm.until_booked(&node, &job).await;
    let lease = farm.next_task(&node).await;
    let renew = async |pixels: serde_json::Value| {
        let path = format!("/v1/leases/{}", lease.lease_id);
        let request = farm.worker.request(reqwest::Method::PATCH, &path);
        request.json(&json!({"fence": lease.fence, "progress": 0.5, "pixels": pixels})).send().await.unwrap()
    };
    let wrong = renew(json!({"done": 65, "all": 64, "work": 1, "cpu_nanos": 1})).await;
    assert!(
        wrong
            .problem(ProblemKind::Invalid)
            .await
            .detail
            .contains("no more pixels are finished than there are")
    );
    renew(json!({"done": 0, "all": 0, "work": 1, "cpu_nanos": 1})).await.problem(ProblemKind::Invalid).await;
    let taken = renew(json!({"done": 32, "all": 64, "work": 24_000, "cpu_nanos": 24_000_000_000u64})).await;
    assert_eq!(taken.status(), StatusCode::OK);
}
