//! Farms that tests make up, whose plans can be worked out by hand. Forecasts have no spread.

use forelight_protocol::{
    Booking, BookingId, ByClass, ForecastTotals, FrameSet, Job, JobId, Money, Node, NodeId, PlanId,
    Quantiles, RenderSettingsRequest, SceneDigest, SceneSummary, Timestamp,
};
use forelight_quote::JobForecast;
use forelight_quote::serial_time::SerialTime;
use forelight_store::{FarmFrame, FarmJob, OpenBooking, OpenCachePart, Wanted, project};
use serde_json::json;
use uuid::Uuid;

use super::farm::Snapshot;

const SECOND: i64 = 1_000_000;

/// CPU seconds of a frame on a core of speed 1: one hour, all of it memory work.
pub(crate) const FRAME: f64 = 3600.0;

pub(crate) fn at(seconds: i64) -> Timestamp {
    let evening: Timestamp = "2026-03-01T18:00:00Z".parse().unwrap();
    evening.plus_micros(seconds * SECOND)
}

pub(crate) fn node_id(number: u128) -> NodeId {
    NodeId(Uuid::from_u128(number))
}

pub(crate) fn job_id(number: u128) -> JobId {
    JobId(Uuid::from_u128(number))
}

/// A node of one core. A memory operation takes this many picoseconds, any other a nanosecond.
pub(crate) fn node(number: u128, price: i64, memory_picos: u64, schedule: serde_json::Value) -> Node {
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

fn job(id: JobId, frames: &str) -> Job {
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
        "id": id, "name": "shot", "project": "film", "state": "booked", "bundle": {"path": "/a"}, "scene": scene,
        "frames": frames, "settings": RenderSettingsRequest::default().complete((8, 8)), "samples": 16, "profile_frames": 1,
        "deadline": null, "budget": null, "confidence": "p80", "priority": 0, "frames_total": frames.iter().count(), "frames_done": 0,
        "progress": 0.0, "verdict": null, "plan_id": PlanId(Uuid::from_u128(1)), "eta": null, "error": null, "created_at": at(0),
        "finished_at": null,
    }))
    .unwrap()
}

fn forecast(frames: usize) -> JobForecast {
    let total =
        ForecastTotals { cpu_seconds: Quantiles::known(FRAME * frames as f64), ..ForecastTotals::default() };
    JobForecast {
        total,
        work_by_class: Some(ByClass { memory: 100, ..ByClass::default() }),
        ..JobForecast::default()
    }
}

/// A frame of the job, booked on a node.
pub(crate) fn booking(job_id: JobId, frame: u32, node: u128, (start, end): (i64, i64)) -> Booking {
    Booking {
        id: BookingId(Uuid::from_u128(u128::from(frame))),
        plan_id: PlanId(Uuid::from_u128(1)),
        job_id,
        frame,
        part: 0,
        parts: 1,
        node_id: node_id(node),
        start: at(start),
        end: at(end),
    }
}

pub(crate) fn waiting(booking: Booking) -> OpenBooking {
    OpenBooking { booking, holder: None, held: false }
}

/// The job whose open bookings are these, of the frames from 0 on.
pub(crate) fn farm_job(id: JobId, bookings: &[OpenBooking]) -> FarmJob {
    let own: Vec<&OpenBooking> = bookings.iter().filter(|open| open.booking.job_id == id).collect();
    let frame = |open: &&OpenBooking| FarmFrame {
        frame: open.booking.frame_part(),
        share: 1.0 / f64::from(open.booking.parts),
        p50: FRAME,
        p80: FRAME,
        p95: FRAME,
        waits: open.holder.is_none(),
        untouched: false,
    };
    let last = own.iter().map(|open| open.booking.frame).max().unwrap_or(0);
    FarmJob {
        job: job(id, &FrameSet::range(0, last).to_string()),
        forecast: Some(forecast(last as usize + 1)),
        frames: own.iter().map(frame).collect(),
        spent: Money(0),
        factor: 1.0,
        serial_time: SerialTime::default(),
        held: false,
        terms: 0,
        has_new_terms: false,
    }
}

pub(crate) fn snapshot(
    nodes: Vec<Node>,
    jobs: Vec<FarmJob>,
    bookings: &[OpenBooking],
    parts: &[OpenCachePart],
) -> Snapshot {
    let now = at(0);
    Snapshot {
        now,
        parent: None,
        wanted: Wanted::default(),
        nodes,
        jobs,
        projects: Vec::new(),
        budgets: Vec::new(),
        projected: project(bookings, parts, now),
    }
}
