//! The living estimate: from the quote to the truth, and what is said on the way.

use super::*;
use forelight_protocol::{BookedQuantity, Event, EventKind, FinishedPixels, ForecastHistory, LiveForecast};

/// A forecast of so many frames of 900 units and 4 seconds each, with an error of an eighth, in numbers that
/// JSON keeps exactly.
fn quoted(frames: usize) -> JobForecast {
    let known = |mean: f64| Quantiles { mean, p50: mean, p80: 1.125 * mean, p95: 1.25 * mean };
    let mut forecast = job_forecast();
    forecast.total.work = known(900.0 * frames as f64);
    forecast.total.cpu_seconds = known(4.0 * frames as f64);
    forecast.clock = (0..frames).map(|frame| frame as f64).collect();
    forecast
}

/// A booked job of so many frames.
async fn booked(farm: &Farm, node: NodeId, frames: usize) -> JobId {
    let request = request(&format!("0-{}", frames - 1));
    farm.quoted_job(request, node, at(10), &quoted(frames), None).await
}

/// Renders the next frame at so much work and time, a node of speed 1 being the measure.
async fn render(
    farm: &Farm,
    node: &Node,
    work: u64,
    cpu_seconds: f64,
    now: Timestamp,
) -> (Lease, TaskResult) {
    let lease = farm.claim(node.id, now).await.unwrap();
    let TaskResult::Render(mut render) = farm.result_for(&lease).await else { panic!() };
    render.stats.work = work;
    render.stats.cpu_seconds = cpu_seconds / node.speed;
    let result = TaskResult::Render(render);
    farm.store.commit_result(lease.lease_id, lease.fence, &result, now).await.unwrap();
    (lease, result)
}

async fn live(farm: &Farm, job: JobId) -> LiveForecast {
    farm.store.job(job).await.unwrap().live.unwrap()
}

async fn history(farm: &Farm, job: JobId) -> ForecastHistory {
    farm.store.forecast_history(job).await.unwrap().unwrap()
}

/// What was said of the job's estimate, in order.
async fn said(farm: &Farm, job: JobId) -> Vec<Event> {
    let events = farm.store.events_after(Some(job), 0, 10_000).await.unwrap();
    let about = |event: &Event| matches!(event.kind, EventKind::JobOffForecast | EventKind::JobOnForecast);
    events.into_iter().filter(about).collect()
}

#[tokio::test]
async fn the_estimate_begins_as_the_quote_and_is_the_truth_with_the_last_frame() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let job = farm.job("0-3").await;
    assert_eq!(farm.store.forecast_history(job.id).await.unwrap(), None, "not booked");
    farm.store.cancel_job(job.id, at(0)).await.unwrap();
    let job = booked(&farm, node.id, 4).await;
    let quote = quoted(4).total;
    let begin = live(&farm, job).await;
    assert_eq!((begin.work.whole, begin.cpu_seconds.whole), (quote.work, quote.cpu_seconds));
    assert_eq!((begin.frames_done, begin.booked.cpu_seconds), (0, quote.cpu_seconds.p80));
    assert_eq!((begin.booked.finish, begin.finish), (Some(at(100)), Some(at(50))));
    for (place, work) in [1000, 1010, 990, 1003].into_iter().enumerate() {
        let now = at(20 + place as i64);
        render(&farm, &node, work, 4.0, now).await;
        let now_known = live(&farm, job).await;
        assert_eq!((now_known.frames_done, now_known.at), (place as u32 + 1, now));
        assert_eq!(now_known.work.quote, quote.work, "the quote stays");
        let Quantiles { p50, p95, .. } = now_known.work.whole;
        assert!(place == 3 || (p50 > quote.work.p50 && p50 < p95), "{now_known:?}");
    }
    let end = live(&farm, job).await;
    assert_eq!(end.work.whole, Quantiles::known(4003.0));
    assert_eq!((end.work.remaining, end.work.spent), (Quantiles::default(), 4003.0));
    assert!((end.cpu_seconds.whole.p95 - 16.0).abs() < 1e-9);
    assert_eq!(end.finish, Some(at(23)));
    let kept = history(&farm, job).await;
    assert_eq!(kept.now, end);
    let done: Vec<u32> = kept.points.iter().map(|point| point.frames_done).collect();
    assert_eq!(done, [0, 1, 2, 3, 4]);
    assert_eq!((kept.points[0].work, kept.points[4].work), (quote.work, end.work.whole));
    assert_eq!(farm.store.job(job).await.unwrap().live, Some(end));
    let farm = farm.restarted().await;
    assert_eq!(live(&farm, job).await, end);
}

#[tokio::test]
async fn what_is_cancelled_will_have_cost_what_it_cost() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let job = booked(&farm, node.id, 4).await;
    for now in [20, 21] {
        render(&farm, &node, 1000, 4.0, at(now)).await;
    }
    farm.store.cancel_job(job, at(30)).await.unwrap();
    let end = live(&farm, job).await;
    assert_eq!((end.work.whole, end.work.spent), (Quantiles::known(2000.0), 2000.0));
    assert_eq!((end.cpu_seconds.remaining, end.finish), (Quantiles::default(), Some(at(30))));
    assert_eq!(said(&farm, job).await, [], "nobody has to know that the rest costs nothing");
}

#[tokio::test]
async fn frames_that_come_in_a_burst_are_estimated_once_a_second_and_the_sweep_takes_the_rest() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let job = booked(&farm, node.id, 40).await;
    for _ in 0..30 {
        render(&farm, &node, 900, 4.0, at(11)).await;
    }
    assert_eq!(live(&farm, job).await.frames_done, 16, "each of the first ones, and no other in this second");
    render(&farm, &node, 900, 4.0, at(12)).await;
    assert_eq!(live(&farm, job).await.frames_done, 31);
    for _ in 0..3 {
        render(&farm, &node, 900, 4.0, at(12)).await;
    }
    for (now, known) in [(21, 31), (22, 34)] {
        farm.store.sweep(at(now)).await.unwrap();
        assert_eq!(live(&farm, job).await.frames_done, known);
    }
    for _ in 0..6 {
        render(&farm, &node, 900, 4.0, at(22)).await;
    }
    assert_eq!(live(&farm, job).await.frames_done, 40, "the last one is waited for by nobody");
}

#[tokio::test]
async fn frames_in_a_light_that_is_yet_to_go_on_are_thought_less_like_those_that_are_finished() {
    let mut remaining = Vec::new();
    for lights in [Vec::new(), vec![0, 0, 0, 0, 1, 1, 1, 1]] {
        let farm = Farm::new().await;
        let node = farm.node("a").await;
        let forecast = JobForecast { lights, ..quoted(8) };
        let job = farm.quoted_job(request("0-7"), node.id, at(10), &forecast, None).await;
        for frame in 0..4 {
            render(&farm, &node, 1350, 6.0, at(11 + frame)).await;
        }
        remaining.push(live(&farm, job).await.work.remaining);
    }
    let [same, other] = remaining[..] else { panic!("{remaining:?}") };
    assert!(same.p50 > 4.0 * 900.0 && other.p50 < 0.97 * same.p50, "{same:?} {other:?}");
    assert!(other.p95 / other.p50 > same.p95 / same.p50, "{same:?} {other:?}");
}

#[tokio::test]
async fn leaving_the_booking_and_coming_back_are_said_once_each_with_numbers() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let job = booked(&farm, node.id, 12).await;
    // Half as dear again as quoted: above P80 with the first frames, and so it stays.
    for frame in 0..5 {
        render(&farm, &node, 900, 6.0, at(11 + frame)).await;
    }
    let events = said(&farm, job).await;
    let of_cost = |event: &&Event| event.off_forecast.is_some_and(|off| off.quantity == BookedQuantity::Cost);
    let [off] = events.iter().filter(of_cost).collect::<Vec<_>>()[..] else { panic!("{events:?}") };
    let numbers = off.off_forecast.unwrap();
    assert_eq!((off.kind, off.job_id), (EventKind::JobOffForecast, Some(job)));
    assert_eq!(off.plan_id, farm.store.job(job).await.unwrap().plan_id);
    assert_eq!(numbers.booked.cpu_seconds, quoted(12).total.cpu_seconds.p80);
    assert!(numbers.cpu_seconds > 1.02 * numbers.booked.cpu_seconds, "{numbers:?}");
    assert!(numbers.cost.unwrap() > numbers.booked.cost.unwrap(), "{numbers:?}");
    assert!(off.message.as_deref().unwrap().starts_with("the cost exceeds its booking: at P80"));
    assert!(live(&farm, job).await.cost_is_off);
    // A duplicate says nothing again.
    let (lease, result) = render(&farm, &node, 900, 6.0, at(17)).await;
    let before = said(&farm, job).await.len();
    assert!(farm.store.commit_result(lease.lease_id, lease.fence, &result, at(18)).await.unwrap().duplicate);
    assert_eq!(history(&farm, job).await.points.len(), 7);
    // The rest is so cheap that the whole comes out below what was booked.
    for frame in 0..6 {
        render(&farm, &node, 900, 1.0, at(19 + frame)).await;
    }
    let events = said(&farm, job).await;
    let kinds: Vec<EventKind> = events.iter().filter(of_cost).map(|event| event.kind).collect();
    assert_eq!(kinds, [EventKind::JobOffForecast, EventKind::JobOnForecast], "{before} before: {events:?}");
    let end = live(&farm, job).await;
    assert!(!end.cost_is_off && (end.cpu_seconds.whole.p80 - 42.0).abs() < 1e-9, "{end:?}");
}

#[tokio::test]
async fn a_job_that_falls_behind_its_bookings_is_said_to_end_late() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let job = booked(&farm, node.id, 9).await;
    // Nine bookings of ten seconds fill the time until the promised end. The first frame is 30 seconds late.
    render(&farm, &node, 900, 4.0, at(50)).await;
    let events = said(&farm, job).await;
    let [late] = &events[..] else { panic!("{events:?}") };
    let numbers = late.off_forecast.unwrap();
    assert_eq!((late.kind, numbers.quantity), (EventKind::JobOffForecast, BookedQuantity::Finish));
    assert!(numbers.finish.unwrap() > at(101) && numbers.booked.finish == Some(at(100)), "{numbers:?}");
    // Others help out: all but one are there long before.
    for frame in 0..7 {
        render(&farm, &node, 900, 4.0, at(51 + frame)).await;
    }
    let kinds: Vec<EventKind> = said(&farm, job).await.iter().map(|event| event.kind).collect();
    assert_eq!(kinds, [EventKind::JobOffForecast, EventKind::JobOnForecast]);
}

#[tokio::test]
async fn a_new_plan_is_held_against_what_was_expected_when_it_was_made() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let job = booked(&farm, node.id, 12).await;
    for frame in 0..4 {
        render(&farm, &node, 900, 6.0, at(11 + frame)).await;
    }
    let before = live(&farm, job).await;
    assert!(before.cost_is_off);
    let mut write = farm.store.write().await.unwrap();
    let plan = forelight_protocol::PlanId::new();
    sqlx::query("INSERT INTO plans (id, reason, verdicts, created_at) VALUES (?, 'job_forecast', '[]', 0)")
        .bind(plan.0)
        .execute(write.connection().await.unwrap())
        .await
        .unwrap();
    sqlx::query("UPDATE jobs SET plan_id = ? WHERE id = ?")
        .bind(plan.0)
        .bind(job.0)
        .execute(write.connection().await.unwrap())
        .await
        .unwrap();
    farm.store.commit(write).await.unwrap();
    render(&farm, &node, 900, 6.0, at(16)).await;
    let after = live(&farm, job).await;
    assert_eq!(after.booked.cpu_seconds, before.cpu_seconds.whole.p80);
    assert!(!after.cost_is_off, "{after:?}");
}

#[tokio::test]
async fn finished_pixels_move_the_estimate_of_the_frame_that_they_are_of_every_ten_seconds() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let job = booked(&farm, node.id, 1).await;
    let lease = farm.claim(node.id, at(10)).await.unwrap();
    let report = async |done: u64, now: Timestamp| {
        // Twice as dear as quoted.
        let pixels = FinishedPixels { done, all: 100, work: 18 * done, cpu_nanos: 80_000_000 * done };
        let renewal = RenewRequest { pixels: Some(pixels), ..renewal(lease.fence, done as f64 / 100.0) };
        farm.store.renew(lease.lease_id, &renewal, TTL, now).await.unwrap();
    };
    report(20, at(20)).await;
    let early = live(&farm, job).await;
    assert_eq!((early.frames_done, early.work.spent), (0, 360.0));
    assert!(early.work.whole.p50 > 900.0, "{early:?}");
    report(40, at(25)).await;
    assert_eq!(live(&farm, job).await, early, "not yet again");
    report(80, at(30)).await;
    let late = live(&farm, job).await;
    assert!(late.work.whole.p50 > early.work.whole.p50 && late.at == at(30), "{late:?}");
    let cpu = late.cpu_seconds;
    assert!((cpu.spent - 6.4 * node.speed).abs() < 1e-9, "{cpu:?}");
    // What the next worker does not have is not counted.
    farm.store.release(lease.lease_id, lease.fence, at(31)).await.unwrap();
    let lease = farm.claim(node.id, at(32)).await.unwrap();
    let bare = RenewRequest {
        pixels: Some(FinishedPixels { all: 100, ..Default::default() }),
        ..renewal(lease.fence, 0.0)
    };
    farm.store.renew(lease.lease_id, &bare, TTL, at(41)).await.unwrap();
    assert_eq!(live(&farm, job).await.work.spent, 0.0);
}

#[tokio::test]
async fn the_history_of_a_job_is_bounded_and_begins_with_its_quote() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let job = booked(&farm, node.id, 1).await;
    let lease = farm.claim(node.id, at(10)).await.unwrap();
    let reports = 1200;
    for step in 0..reports {
        let pixels = FinishedPixels { done: step, all: 2 * reports, work: step, cpu_nanos: step };
        let renewal = RenewRequest { pixels: Some(pixels), ..renewal(lease.fence, 0.0) };
        farm.store.renew(lease.lease_id, &renewal, TTL, at(20 + 10 * step as i64)).await.unwrap();
    }
    let points = history(&farm, job).await.points;
    assert!((256..=512).contains(&points.len()), "{}", points.len());
    assert_eq!(points[0].work, quoted(1).total.work);
    assert_eq!(points.last().unwrap().at, at(20 + 10 * (reports as i64 - 1)));
    assert!(points.windows(2).all(|pair| pair[0].at < pair[1].at));
}

#[tokio::test]
async fn a_long_job_is_estimated_again_with_its_first_frames_then_now_and_then_and_with_its_last() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let job = booked(&farm, node.id, 1100).await;
    for second in 0..30 {
        render(&farm, &node, 900, 4.0, at(11 + second)).await;
    }
    let done: Vec<u32> = history(&farm, job).await.points.iter().map(|point| point.frames_done).collect();
    assert_eq!(done, [&(0..=16).collect::<Vec<_>>()[..], &[20, 24, 28]].concat());
}
