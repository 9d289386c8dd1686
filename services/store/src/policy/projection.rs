//! What the bookings look like from now on.
//!
//! A booking says when a frame *was to be* rendered. Frames run late and early, workers die, nodes help out; plans never
//! change. So whoever needs to know when a node will be free, or a job done, projects the open bookings from now.

use std::collections::BTreeMap;

use forelight_protocol::{Booking, Job, JobId, NodeId, SeedBooking, Timestamp, Waits};

/// A booking whose frame is not rendered yet.
#[derive(Clone, PartialEq, Debug)]
pub struct OpenBooking {
    /// The booking.
    pub booking: Booking,
    /// The worker that has the frame, if one has.
    pub holder: Option<Holder>,
}

/// Who has a frame, or a part of a cache.
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

/// A booked part of an irradiance cache that the frames of a job share and wait for, and that is not full yet.
#[derive(Clone, PartialEq, Debug)]
pub struct OpenSeed {
    /// The booking: for all rounds of the part.
    pub booking: SeedBooking,
    /// The share of it whose rounds are done, 0 to 1.
    pub done: f64,
    /// The worker that has the part, if one has; its progress is that of the part, not of the round.
    pub holder: Option<Holder>,
}

/// When and where a part of a cache is expected to be filled.
#[derive(Clone, PartialEq, Debug)]
pub struct ProjectedSeed {
    /// The booking that this is about.
    pub booking: SeedBooking,
    /// The node that has the part, or on which it is booked.
    pub node_id: NodeId,
    /// From when: not before now, except for a part under way.
    pub start: Timestamp,
    /// Until when: after now.
    pub end: Timestamp,
    /// Whether a worker has it.
    pub under_way: bool,
}

/// What is expected of the open bookings.
#[derive(Clone, PartialEq, Debug, Default)]
pub struct Projection {
    /// Of frames, in the order of start, node, job, frame.
    pub frames: Vec<Projected>,
    /// Of parts of caches, in the order of start, node, job, part.
    pub seeds: Vec<ProjectedSeed>,
}

/// What is under way and late is given at least a second more, in microseconds.
const AT_LEAST: i64 = 1_000_000;

/// When something under way should be done: when its booked length is over, or, once its worker has said how far it is, or it is late, after the part of
/// it that is left.
fn end_under_way(holder: &Holder, length: i64, now: Timestamp) -> Timestamp {
    let planned_end = holder.started.plus_micros(length);
    let left = (length as f64 * (1.0 - holder.progress.clamp(0.0, 1.0))) as i64;
    if holder.progress > 0.0 || planned_end <= now {
        now.plus_micros(left.max(AT_LEAST))
    } else {
        planned_end.max(now.plus_micros(AT_LEAST))
    }
}

/// What waits on a node: a frame, or a part of a cache.
enum Waiting<'a> {
    Seed(&'a OpenSeed),
    Frame(&'a Booking),
}

impl Waiting<'_> {
    /// Parts before the frames that wait for them, even where they are booked at the same instant.
    fn order(&self) -> (Timestamp, JobId, bool, u32) {
        match self {
            Waiting::Seed(seed) => (seed.booking.start, seed.booking.job_id, false, seed.booking.part),
            Waiting::Frame(booking) => (booking.start, booking.job_id, true, booking.frame),
        }
    }
}

/// Projects the open bookings from `now` on. On every node, what is under way comes first, then what is booked
/// in the order of its starts, none before its booking and none before what is ahead of it is done; frames not before the cache that they share should be
/// full, either. A frame under way that is late is given the part of its booked length that its worker has not done, at least a second.
pub fn project(open: &[OpenBooking], seeds: &[OpenSeed], now: Timestamp) -> Projection {
    let mut free_from: BTreeMap<NodeId, Timestamp> = BTreeMap::new();
    let mut full_from: BTreeMap<JobId, Timestamp> = BTreeMap::new();
    let mut projection = Projection::default();
    let mut occupy = |node: NodeId, end: Timestamp| {
        let free = free_from.entry(node).or_insert(now);
        *free = (*free).max(end);
    };
    for OpenBooking { booking, holder } in open {
        let Some(holder) = holder else { continue };
        let end = end_under_way(holder, booking.end.micros_since(booking.start), now);
        occupy(holder.node_id, end);
        projection.frames.push(Projected {
            booking: booking.clone(),
            node_id: holder.node_id,
            start: holder.started,
            end,
            under_way: true,
        });
    }
    for OpenSeed { booking, holder, .. } in seeds {
        let Some(holder) = holder else { continue };
        let end = end_under_way(holder, booking.end.micros_since(booking.start), now);
        occupy(holder.node_id, end);
        projection.seeds.push(ProjectedSeed {
            booking: booking.clone(),
            node_id: holder.node_id,
            start: holder.started,
            end,
            under_way: true,
        });
    }
    for seed in &projection.seeds {
        let full = full_from.entry(seed.booking.job_id).or_insert(seed.end);
        *full = (*full).max(seed.end);
    }
    let frames = open.iter().filter(|open| open.holder.is_none()).map(|open| Waiting::Frame(&open.booking));
    let parts = seeds.iter().filter(|open| open.holder.is_none()).map(Waiting::Seed);
    let mut waiting: Vec<Waiting> = frames.chain(parts).collect();
    waiting.sort_by_key(Waiting::order);
    for waiting in waiting {
        match waiting {
            Waiting::Seed(OpenSeed { booking, done, .. }) => {
                let free = free_from.entry(booking.node_id).or_insert(now);
                let start = booking.start.max(*free);
                let length = booking.end.micros_since(booking.start) as f64 * (1.0 - done.clamp(0.0, 1.0));
                let end = start.plus_micros((length as i64).max(1));
                *free = end;
                let full = full_from.entry(booking.job_id).or_insert(end);
                *full = (*full).max(end);
                projection.seeds.push(ProjectedSeed {
                    booking: booking.clone(),
                    node_id: booking.node_id,
                    start,
                    end,
                    under_way: false,
                });
            }
            Waiting::Frame(booking) => {
                let free = free_from.entry(booking.node_id).or_insert(now);
                let full = full_from.get(&booking.job_id).copied().unwrap_or(now);
                let start = booking.start.max(*free).max(full);
                let end = start.plus_micros(booking.end.micros_since(booking.start));
                *free = end;
                projection.frames.push(Projected {
                    booking: booking.clone(),
                    node_id: booking.node_id,
                    start,
                    end,
                    under_way: false,
                });
            }
        }
    }
    let Projection { frames, seeds } = &mut projection;
    frames.sort_by_key(|frame| (frame.start, frame.node_id, frame.booking.job_id, frame.booking.frame));
    seeds.sort_by_key(|part| (part.start, part.node_id, part.booking.job_id, part.booking.part));
    projection
}

/// The bookings, with their lengths multiplied by this factor.
pub(crate) fn stretched(bookings: &[OpenBooking], by: f64) -> Vec<OpenBooking> {
    let mut bookings = bookings.to_vec();
    for OpenBooking { booking, .. } in &mut bookings {
        let length = booking.end.micros_since(booking.start) as f64 * by;
        booking.end = booking.start.plus_micros((length as i64).max(1));
    }
    bookings
}

impl Projection {
    /// When the last of a job's frames, and parts of its cache, is expected; `None` if none is open.
    pub fn finish_of(&self, job: JobId) -> Option<Timestamp> {
        let frames = self.frames.iter().filter(|frame| frame.booking.job_id == job).map(|frame| frame.end);
        frames.chain(self.full(job)).max()
    }

    /// When the last of a job's frames is expected; `None` if some are booked nowhere, or if the job waits for money.
    pub fn eta(&self, job: &Job) -> Option<Timestamp> {
        let booked = self.frames.iter().filter(|frame| frame.booking.job_id == job.id).count();
        let open = job.frames_total.saturating_sub(job.frames_done);
        let waits_for_money = job.waits.as_ref().is_some_and(Waits::is_for_money);
        self.finish_of(job.id).filter(|_| !waits_for_money && booked >= open as usize)
    }

    /// When the cache that a job's frames share should be full; `None` if they wait for none.
    pub fn full(&self, job: JobId) -> Option<Timestamp> {
        self.seeds.iter().filter(|part| part.booking.job_id == job).map(|part| part.end).max()
    }
}
