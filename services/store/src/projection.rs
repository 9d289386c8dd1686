//! What the bookings look like from now on.
//!
//! A booking says when a frame *was to be* rendered. Frames run late and early, workers die, nodes help out; plans never
//! change. So whoever needs to know when a node will be free, or a job done, projects the open bookings from now.

use std::collections::BTreeMap;

use forelight_protocol::{Booking, JobId, NodeId, Timestamp};

/// A booking whose frame is not rendered yet.
#[derive(Clone, PartialEq, Debug)]
pub struct OpenBooking {
    /// The booking.
    pub booking: Booking,
    /// The worker that has the frame, if one has.
    pub holder: Option<Holder>,
}

/// Who has a frame.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Holder {
    /// On which node: not always the booked one.
    pub node_id: NodeId,
    /// Since when.
    pub started: Timestamp,
    /// How far it is, 0 to 1.
    pub progress: f64,
}

/// When and where a frame is expected to be rendered.
#[derive(Clone, PartialEq, Debug)]
pub struct Projected {
    /// The booking that this is about.
    pub booking: Booking,
    /// The node that has the frame, or on which it is booked.
    pub node_id: NodeId,
    /// From when: not before now, except for a frame under way.
    pub start: Timestamp,
    /// Until when: after now.
    pub end: Timestamp,
    /// Whether a worker has it.
    pub under_way: bool,
}

/// Projects the open bookings from `now` on. On every node the frames under way come first, then the booked
/// frames in the order of their starts, none before its booking and none before the frame ahead of it is done. A frame
/// under way that is late is given the part of its booked length that its worker has not done, at least a second.
/// The result is in the order of start, node, frame.
pub fn project(open: &[OpenBooking], now: Timestamp) -> Vec<Projected> {
    const AT_LEAST: i64 = 1_000_000;
    let mut free_from: BTreeMap<NodeId, Timestamp> = BTreeMap::new();
    let mut projected = Vec::with_capacity(open.len());
    for OpenBooking { booking, holder } in open {
        let Some(holder) = holder else { continue };
        let length = booking.end.micros_since(booking.start);
        let planned_end = holder.started.plus_micros(length);
        let left = (length as f64 * (1.0 - holder.progress.clamp(0.0, 1.0))) as i64;
        let end = if holder.progress > 0.0 || planned_end <= now {
            now.plus_micros(left.max(AT_LEAST))
        } else {
            planned_end.max(now.plus_micros(AT_LEAST))
        };
        let free = free_from.entry(holder.node_id).or_insert(now);
        *free = (*free).max(end);
        projected.push(Projected {
            booking: booking.clone(),
            node_id: holder.node_id,
            start: holder.started,
            end,
            under_way: true,
        });
    }
    let mut waiting: Vec<&Booking> =
        open.iter().filter(|open| open.holder.is_none()).map(|open| &open.booking).collect();
    waiting.sort_by_key(|booking| (booking.start, booking.job_id, booking.frame));
    for booking in waiting {
        let free = free_from.entry(booking.node_id).or_insert(now);
        let start = booking.start.max(*free);
        let end = start.plus_micros(booking.end.micros_since(booking.start));
        *free = end;
        projected.push(Projected {
            booking: booking.clone(),
            node_id: booking.node_id,
            start,
            end,
            under_way: false,
        });
    }
    projected.sort_by_key(|frame| (frame.start, frame.node_id, frame.booking.job_id, frame.booking.frame));
    projected
}

impl Projected {
    /// When the last of a job's frames is expected; `None` if none is open.
    pub fn finish_of(projected: &[Projected], job: JobId) -> Option<Timestamp> {
        projected.iter().filter(|frame| frame.booking.job_id == job).map(|frame| frame.end).max()
    }
}
