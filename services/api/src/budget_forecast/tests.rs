//! Nights whose cost can be worked out by hand. Forecasts have no spread, so every quantile equals the sum.

use forelight_protocol::{Booking, JobId, SharedCacheBooking};
use forelight_store::{Holder, OpenBooking, OpenCachePart, OpenJob, TaskAttempt};
use serde_json::json;

use super::*;
use crate::conductor::made_up::{self, FRAME, at, farm_job, node, node_id, snapshot, waiting};

const UNIT: i64 = 1_000_000;

fn job_id() -> JobId {
    made_up::job_id(9)
}

fn booking(frame: u32, node: u128, start: i64, end: i64) -> Booking {
    made_up::booking(job_id(), frame, node, (start, end))
}

fn forecast_of(
    nodes: Vec<forelight_protocol::Node>,
    bookings: &[OpenBooking],
    parts: &[OpenCachePart],
) -> BudgetForecast {
    let now = at(0);
    let numbers: Vec<u32> = bookings.iter().map(|open| open.booking.frame).collect();
    let farm_job = farm_job(job_id(), bookings);
    let open = OpenJob {
        job: farm_job.job.clone(),
        forecast: farm_job.forecast.clone(),
        frames: numbers.iter().map(|&frame| (frame, FRAME, FRAME)).collect(),
        held: false,
    };
    let snapshot = snapshot(nodes.clone(), vec![farm_job], bookings, parts);
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
        held: false,
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
    let holder = Holder { node_id: node_id(2), started: at(-100), attempt, slowness: 2.0 };
    let half_done = OpenBooking { booking: booking(0, 1, 0, 1800), holder: Some(holder), held: false };
    // Half an hour of work at two thousandths per second.
    let forecast = forecast_of(nodes, &[half_done], &[]);
    assert_eq!(costs(&forecast), [36 * UNIT / 10, 0]);
    assert_eq!(forecast.nights[0].node_classes.len(), 1);
}
