//! Nights whose cost can be worked out by hand. Forecasts have no spread, so every quantile equals the sum.

use forelight_protocol::{
    Booking, BookingId, ByClass, ForecastTotals, FrameSet, Job, JobId, NodeId, PlanId, Quantiles,
    RenderSettingsRequest, SceneDigest, SceneSummary, SharedCacheBooking,
};
use forelight_quote::JobForecast;
use forelight_store::{
    FarmFrame, FarmJob, Holder, OpenBooking, OpenCachePart, OpenJob, TaskAttempt, Wanted, project,
};
use serde_json::json;
use uuid::Uuid;

use super::*;
use crate::conductor::farm::Snapshot;

const SECOND: i64 = 1_000_000;
const UNIT: i64 = 1_000_000;

fn at(seconds: i64) -> Timestamp {
    let evening: Timestamp = "2026-03-01T18:00:00Z".parse().unwrap();
    evening.plus_micros(seconds * SECOND)
}

fn node_id(number: u128) -> NodeId {
    NodeId(Uuid::from_u128(number))
}

fn job_id() -> JobId {
    JobId(Uuid::from_u128(9))
}

/// A node of one core. A memory operation takes this many picoseconds, any other a nanosecond.
fn node(
    number: u128,
    price: i64,
    memory_picos: u64,
    schedule: serde_json::Value,
) -> forelight_protocol::Node {
    let picos = ByClass { memory: memory_picos, ..ByClass::from_array([1000; ByClass::CLASSES]) };
    let mut node = json!({
        "id": node_id(number), "name": format!("node-{number}"), "speed": 1.0, "speed_set": false, "price_per_hour": price,
        "price_set": false, "cores": 1, "capabilities": {"calibration": {"picos_per_work": picos}}, "drain": false,
        "task_id": null, "created_at": at(0), "last_seen_at": at(0),
    });
    if !schedule.is_null() {
        node["schedule"] = schedule;
    }
    serde_json::from_value(node).unwrap()
}

fn job(frames: &str) -> Job {
    let scene = SceneSummary {
        name: "a".to_owned(),
        digest: SceneDigest([0; 32]),
        frames: 10,
        width: 8,
        height: 8,
        objects: 1,
        materials: 1,
        triangles: 2,
        frames_per_second: None,
    };
    let frames: FrameSet = frames.parse().unwrap();
    serde_json::from_value(json!({
        "id": job_id(), "name": "shot", "project": "film", "state": "booked", "bundle": {"path": "/a"}, "scene": scene,
        "frames": frames, "settings": RenderSettingsRequest::default().complete((8, 8)), "samples": 16, "profile_frames": 1,
        "deadline": null, "budget": null, "confidence": "p80", "priority": 0, "frames_total": frames.iter().count(), "frames_done": 0,
        "progress": 0.0, "verdict": null, "plan_id": PlanId(Uuid::from_u128(1)), "eta": null, "error": null, "created_at": at(0),
        "finished_at": null,
    }))
    .unwrap()
}

/// CPU seconds of a frame on a core of speed 1: one hour, all of it memory work.
const FRAME: f64 = 3600.0;

fn forecast(frames: usize) -> JobForecast {
    let total =
        ForecastTotals { cpu_seconds: Quantiles::known(FRAME * frames as f64), ..ForecastTotals::default() };
    JobForecast {
        total,
        work_by_class: Some(ByClass { memory: 100, ..ByClass::default() }),
        ..JobForecast::default()
    }
}

fn booking(frame: u32, node: u128, start: i64, end: i64) -> Booking {
    Booking {
        id: BookingId(Uuid::from_u128(u128::from(frame))),
        plan_id: PlanId(Uuid::from_u128(1)),
        job_id: job_id(),
        frame,
        part: 0,
        parts: 1,
        node_id: node_id(node),
        start: at(start),
        end: at(end),
    }
}

fn forecast_of(
    nodes: Vec<forelight_protocol::Node>,
    bookings: &[OpenBooking],
    parts: &[OpenCachePart],
) -> BudgetForecast {
    let now = at(0);
    let numbers: Vec<u32> = bookings.iter().map(|open| open.booking.frame).collect();
    let frames = FrameSet::range(0, numbers.len() as u32 - 1).to_string();
    let frame = |open: &OpenBooking| FarmFrame {
        frame: open.booking.frame_part(),
        share: 1.0 / f64::from(open.booking.parts),
        p50: FRAME,
        p80: FRAME,
        p95: FRAME,
        waits: open.holder.is_none(),
        untouched: false,
    };
    let farm_job = FarmJob {
        job: job(&frames),
        forecast: Some(forecast(numbers.len())),
        frames: bookings.iter().map(frame).collect(),
        spent: Money(0),
        factor: 1.0,
        held: false,
        terms: 0,
        has_new_terms: false,
    };
    let open = OpenJob {
        job: farm_job.job.clone(),
        forecast: farm_job.forecast.clone(),
        frames: numbers.iter().map(|&frame| (frame, FRAME, FRAME)).collect(),
        held: false,
    };
    let snapshot = Snapshot {
        now,
        parent: None,
        wanted: Wanted::default(),
        nodes: nodes.clone(),
        jobs: vec![farm_job],
        projects: Vec::new(),
        projected: project(bookings, parts, now),
    };
    let request: BudgetForecastRequest = serde_json::from_value(json!({"days": 2})).unwrap();
    let basis = Basis {
        now,
        zone: "UTC".to_owned(),
        nights: nights(&request, now).unwrap(),
        nodes,
        jobs: vec![open],
        ledger: Vec::new(),
        budgets: Vec::new(),
        projects: None,
    };
    work_out(&basis, &snapshot).unwrap()
}

fn costs(forecast: &BudgetForecast) -> [i64; 2] {
    for night in &forecast.nights {
        assert_eq!((night.cost.p50, night.cost.p80), (night.cost.p95, night.cost.p95));
    }
    [forecast.nights[0].cost.p80.0, forecast.nights[1].cost.p80.0]
}

fn waiting(booking: Booking) -> OpenBooking {
    OpenBooking { booking, holder: None }
}

/// Awake from 20:00 to 21:10: two half hours, not three.
fn an_hour_a_day() -> serde_json::Value {
    json!({"zone": "UTC", "windows": [{"from": "20:00", "until": "21:10"}]})
}

#[test]
fn frames_are_paid_for_when_the_node_is_awake_and_for_what_their_class_of_work_takes_there() {
    // Half an hour per frame. Two frames fit into the evening's window, the third into the next night's.
    let nodes = vec![node(1, 3_600 * 1000, 500, an_hour_a_day())];
    let bookings: Vec<_> =
        (0..3).map(|i| waiting(booking(i, 1, 1800 * i64::from(i), 1800 * i64::from(i + 1)))).collect();
    // A thousandth of a unit per second.
    assert_eq!(costs(&forecast_of(nodes, &bookings, &[])), [36 * UNIT / 10, 18 * UNIT / 10]);
}

#[test]
fn parts_of_a_shared_cache_cost_and_the_frames_come_after_them() {
    let nodes = vec![
        node(1, 3_600 * 1000, 500, an_hour_a_day()),
        node(2, 3_600 * 2000, 1000, serde_json::Value::Null),
    ];
    let bookings: Vec<_> = (0..2)
        .map(|i| waiting(booking(i, 1, 7200 + 1800 * i64::from(i), 9000 + 1800 * i64::from(i))))
        .collect();
    let part = |part, start: i64, end: i64, done| OpenCachePart {
        booking: SharedCacheBooking {
            job_id: job_id(),
            part,
            node_id: node_id(2),
            start: at(start),
            end: at(end),
        },
        done,
        holder: None,
    };
    // Ten minutes at two thousandths per second; done before the evening.
    let early = forecast_of(nodes.clone(), &bookings, &[part(0, 0, 600, 0.0)]);
    assert_eq!(costs(&early), [12 * UNIT / 10 + 36 * UNIT / 10, 0]);
    // Half of the part is left: two and a half hours, until 20:30. Only one frame then fits into the window.
    let late = forecast_of(nodes, &bookings, &[part(0, 0, 18_000, 0.5)]);
    assert_eq!(costs(&late), [18 * UNIT + 18 * UNIT / 10, 18 * UNIT / 10]);
}

#[test]
fn a_frame_that_another_node_has_costs_what_it_takes_there_even_while_that_one_should_sleep() {
    let nodes = vec![
        node(1, 3_600 * 1000, 500, serde_json::Value::Null),
        node(2, 3_600 * 2000, 1000, an_hour_a_day()),
    ];
    let attempt = TaskAttempt { since: at(-100), progress: 0.5, sign: at(0), p95: Some(2_000_000_000) };
    let holder = Holder { node_id: node_id(2), started: at(-100), attempt };
    let half_done = OpenBooking { booking: booking(0, 1, 0, 1800), holder: Some(holder) };
    // Half an hour of work at two thousandths per second.
    let forecast = forecast_of(nodes, &[half_done], &[]);
    assert_eq!(costs(&forecast), [36 * UNIT / 10, 0]);
    assert_eq!(forecast.nights[0].node_classes.len(), 1);
}
