//! When open bookings will really begin and end, from now on.
//!
//! A booking says when a frame *was to be* rendered. Frames run late and early, workers die, idle nodes take
//! frames over. Plans never change. So what needs to know when a node is free, or a job done, projects the
//! open bookings from now.

use std::collections::{BTreeMap, BTreeSet};

use forelight_protocol::{Booking, Job, JobId, NodeId, SharedCacheBooking, Timestamp};

use crate::policy::overdue::{AttemptTimes, TaskAttempt};

/// A booking whose frame is not rendered yet.
#[derive(Clone, PartialEq, Debug)]
pub struct OpenBooking {
    /// The booking.
    pub booking: Booking,
    /// The worker that has the frame; `None` if none has.
    pub holder: Option<Holder>,
    /// Whether its job is held, so that it is not handed out.
    pub held: bool,
}

/// The worker that has a frame, or a part of a cache.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Holder {
    /// Its node: not always the booked one.
    pub node_id: NodeId,
    /// Since when.
    pub started: Timestamp,
    /// What is known of its attempt.
    pub attempt: TaskAttempt,
    /// How many times as long the work takes on its node as on the booked one.
    pub slowness: f64,
}

impl Holder {
    pub(crate) fn new(node_id: NodeId, times: AttemptTimes, progress: f64, p95: Option<i64>) -> Self {
        Self { node_id, started: times.began, attempt: times.attempt(progress, p95), slowness: 1.0 }
    }

    /// Microseconds that the work takes there that was booked for so many.
    fn length(&self, booked: i64) -> i64 {
        ((booked as f64 * self.slowness).ceil() as i64).max(1)
    }
}

/// A booked part of an irradiance cache that the frames of a job share and wait for, and that is not full
/// yet.
#[derive(Clone, PartialEq, Debug)]
pub struct OpenCachePart {
    /// The booking: for all rounds of the part.
    pub booking: SharedCacheBooking,
    /// The share of the part whose rounds are done, 0 to 1.
    pub done: f64,
    /// The worker that has the part; `None` if none has. Its progress is that of the part, not of the round.
    pub holder: Option<Holder>,
    /// Whether its job is held, so that it is not handed out.
    pub held: bool,
}

/// When and where a booking's frame, or part of a cache, is expected to be done.
#[derive(Clone, PartialEq, Debug)]
pub struct Projected<B = Booking> {
    /// The booking.
    pub booking: B,
    /// The node that works on it, or on which it is booked.
    pub node_id: NodeId,
    /// From when: not before now, except for work under way.
    pub start: Timestamp,
    /// Until when: after now.
    pub end: Timestamp,
    /// Whether a worker has it.
    pub under_way: bool,
    /// Whether it waits and is held: it then comes after all else, and says nothing of an end.
    pub held: bool,
    /// What is known of that worker's attempt.
    pub attempt: Option<TaskAttempt>,
    /// Microseconds that it takes on its node.
    pub length: i64,
}

/// When and where a part of a cache is expected to be filled.
pub type ProjectedCachePart = Projected<SharedCacheBooking>;

/// What is expected of the open bookings.
#[derive(Clone, PartialEq, Debug, Default)]
pub struct Projection {
    /// Of frames, in the order of start, node, job, frame.
    pub frames: Vec<Projected>,
    /// Of parts of caches, in the order of start, node, job, part.
    pub cache_parts: Vec<ProjectedCachePart>,
}

/// What waits on a node.
enum Waiting<'a> {
    Part(&'a OpenCachePart),
    Frame(&'a OpenBooking),
}

impl Waiting<'_> {
    /// What is held comes last. Parts come before the frames that wait for them, even where they are booked at the
    /// same instant.
    fn order(&self) -> (bool, Timestamp, JobId, bool, u32, u32) {
        match self {
            Waiting::Part(OpenCachePart { booking, held, .. }) => {
                (*held, booking.start, booking.job_id, false, 0, booking.part)
            }
            Waiting::Frame(OpenBooking { booking, held, .. }) => {
                (*held, booking.start, booking.job_id, true, booking.frame, booking.part)
            }
        }
    }
}

/// Until when nodes are busy, and jobs' caches not full.
struct Busy {
    now: Timestamp,
    free_from: BTreeMap<NodeId, Timestamp>,
    full_from: BTreeMap<JobId, Timestamp>,
}

impl Busy {
    /// Work of so many booked microseconds that a worker has.
    fn under_way<B>(&mut self, booking: B, booked: i64, holder: &Holder) -> Projected<B> {
        let &Holder { node_id, started: start, .. } = holder;
        let length = holder.length(booked);
        let end = holder.attempt.expected_end(length, self.now);
        let free = self.free_from.entry(node_id).or_insert(self.now);
        *free = (*free).max(end);
        Projected {
            booking,
            node_id,
            start,
            end,
            under_way: true,
            held: false,
            attempt: Some(holder.attempt),
            length,
        }
    }

    /// Work of `length` microseconds that waits: not before its booked start, and not before what is ahead of
    /// it on its node is done.
    fn waiting<B>(&mut self, booking: B, node_id: NodeId, start: Timestamp, length: i64) -> Projected<B> {
        let free = self.free_from.entry(node_id).or_insert(self.now);
        let start = start.max(*free);
        let end = start.plus_micros(length);
        *free = end;
        Projected { booking, node_id, start, end, under_way: false, held: false, attempt: None, length }
    }

    /// The job's cache is not full before this part is filled.
    fn fills(&mut self, part: &ProjectedCachePart) {
        let full = self.full_from.entry(part.booking.job_id).or_insert(part.end);
        *full = (*full).max(part.end);
    }
}

/// Projects the open bookings from `now` on.
///
/// On every node, work under way comes first. Booked work follows in the order of its starts, none before its
/// booked start and none before what is ahead of it is done. Frames also wait until the cache that they share
/// is full. What is held delays nothing.
pub fn project(open: &[OpenBooking], parts: &[OpenCachePart], now: Timestamp) -> Projection {
    let mut busy = Busy { now, free_from: BTreeMap::new(), full_from: BTreeMap::new() };
    let mut projection = Projection::default();
    for OpenBooking { booking, holder, .. } in open {
        if let Some(holder) = holder {
            let booked = booking.end.micros_since(booking.start);
            projection.frames.push(busy.under_way(booking.clone(), booked, holder));
        }
    }
    for OpenCachePart { booking, holder, .. } in parts {
        if let Some(holder) = holder {
            let booked = booking.end.micros_since(booking.start);
            let part = busy.under_way(booking.clone(), booked, holder);
            busy.fills(&part);
            projection.cache_parts.push(part);
        }
    }
    let frames = open.iter().filter(|open| open.holder.is_none()).map(Waiting::Frame);
    let parts = parts.iter().filter(|open| open.holder.is_none()).map(Waiting::Part);
    let mut waiting: Vec<Waiting> = frames.chain(parts).collect();
    waiting.sort_by_key(Waiting::order);
    for waiting in waiting {
        match waiting {
            Waiting::Part(OpenCachePart { booking, done, held, .. }) => {
                let booked = booking.end.micros_since(booking.start) as f64;
                let length = (booked * (1.0 - done.clamp(0.0, 1.0))) as i64;
                let part = busy.waiting(booking.clone(), booking.node_id, booking.start, length.max(1));
                busy.fills(&part);
                projection.cache_parts.push(Projected { held: *held, ..part });
            }
            Waiting::Frame(OpenBooking { booking, held, .. }) => {
                let full = busy.full_from.get(&booking.job_id).copied().unwrap_or(now);
                let length = booking.end.micros_since(booking.start);
                let start = booking.start.max(full);
                let frame = busy.waiting(booking.clone(), booking.node_id, start, length);
                projection.frames.push(Projected { held: *held, ..frame });
            }
        }
    }
    let Projection { frames, cache_parts } = &mut projection;
    frames
        .sort_by_key(|frame| (frame.start, frame.node_id, frame.booking.job_id, frame.booking.frame_part()));
    cache_parts.sort_by_key(|part| (part.start, part.node_id, part.booking.job_id, part.booking.part));
    projection
}

/// Number of frames that these bookings are of: a divided frame has several.
pub(crate) fn frames_of(bookings: &[OpenBooking]) -> usize {
    bookings.iter().map(|open| (open.booking.job_id, open.booking.frame)).collect::<BTreeSet<_>>().len()
}

/// An expected instant, rounded up: to the second if it is within ten minutes, else to the minute. What waits
/// for a node that is not there is expected later with each look, and most of that is no news.
pub(crate) fn rounded_up(at: Timestamp, now: Timestamp) -> Timestamp {
    const SECOND: i64 = 1_000_000;
    let step = if at.micros_since(now) <= 600 * SECOND { SECOND } else { 60 * SECOND };
    Timestamp::from_micros(at.micros().saturating_add(step - 1).div_euclid(step).saturating_mul(step))
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

impl Projected {
    /// Probability that the frame is done by `deadline`, given what its attempt has shown by `now`. One that
    /// waits has none of its own.
    pub fn chance(&self, deadline: Timestamp, now: Timestamp) -> Option<f64> {
        Some(self.attempt?.chance(self.length, deadline, now))
    }
}

impl Projection {
    /// When the last of a job's frames and parts of its cache is expected; `None` if none is open.
    pub fn finish_of(&self, job: JobId) -> Option<Timestamp> {
        let frames = self.frames.iter().filter(|frame| frame.booking.job_id == job).map(|frame| frame.end);
        frames.chain(self.cache_full_at(job)).max()
    }

    /// When each job ends, for lists of many jobs. Of what is held, nobody knows.
    pub fn ends(&self) -> JobEnds {
        let mut ends: BTreeMap<JobId, (usize, Timestamp)> = BTreeMap::new();
        let mut seen = BTreeSet::new();
        let frames = self.frames.iter().filter(|frame| !frame.held);
        let frames = frames.map(|frame| (frame.booking.job_id, Some(frame.booking.frame), frame.end));
        let parts = self.cache_parts.iter().filter(|part| !part.held);
        let parts = parts.map(|part| (part.booking.job_id, None, part.end));
        for (job, frame, end) in frames.chain(parts) {
            let (booked, last) = ends.entry(job).or_insert((0, end));
            // The parts of a divided frame are one frame.
            *booked += usize::from(frame.is_some_and(|frame| seen.insert((job, frame))));
            *last = (*last).max(end);
        }
        JobEnds(ends)
    }

    /// When the cache that a job's frames share should be full; `None` if they wait for none.
    pub fn cache_full_at(&self, job: JobId) -> Option<Timestamp> {
        self.cache_parts.iter().filter(|part| part.booking.job_id == job).map(|part| part.end).max()
    }
}

/// The number of open bookings of each job, and the last end of them and of its cache.
#[derive(Clone, PartialEq, Debug, Default)]
pub struct JobEnds(BTreeMap<JobId, (usize, Timestamp)>);

impl JobEnds {
    /// When the last of a job's frames is expected; `None` if some are booked nowhere, or held.
    pub fn eta(&self, job: &Job) -> Option<Timestamp> {
        let &(booked, end) = self.0.get(&job.id)?;
        let open = job.frames_total.saturating_sub(job.frames_done + job.frames_cancelled);
        (booked >= open as usize).then_some(end)
    }

    /// As [`Projection::finish_of`].
    pub fn finish_of(&self, job: JobId) -> Option<Timestamp> {
        self.0.get(&job).map(|&(_, end)| end)
    }

    /// The last end of all; `None` if nothing is booked.
    pub fn last(&self) -> Option<Timestamp> {
        self.0.values().map(|&(_, end)| end).max()
    }
}

#[cfg(test)]
mod tests {
    use forelight_protocol::{BookingId, PlanId};

    use super::*;

    fn at(seconds: i64) -> Timestamp {
        Timestamp::from_micros(seconds * 1_000_000)
    }

    struct Farm {
        job: JobId,
        plan: PlanId,
        nodes: [NodeId; 2],
    }

    impl Farm {
        fn new() -> Self {
            Self { job: JobId::new(), plan: PlanId::new(), nodes: [NodeId::new(), NodeId::new()] }
        }

        fn frame(
            &self,
            frame: u32,
            node: usize,
            (start, end): (i64, i64),
            holder: Option<Holder>,
        ) -> OpenBooking {
            let booking = Booking {
                id: BookingId::new(),
                plan_id: self.plan,
                job_id: self.job,
                frame,
                part: 0,
                parts: 1,
                node_id: self.nodes[node],
                start: at(start),
                end: at(end),
            };
            OpenBooking { booking, holder, held: false }
        }

        /// A booking of another job that is held.
        fn held_frame(&self, node: usize, span: (i64, i64)) -> OpenBooking {
            let open = self.frame(0, node, span, None);
            OpenBooking { booking: Booking { job_id: JobId::new(), ..open.booking }, held: true, ..open }
        }

        fn part(&self, node: usize, (start, end): (i64, i64), done: f64) -> OpenCachePart {
            let node_id = self.nodes[node];
            let booking =
                SharedCacheBooking { job_id: self.job, part: 0, node_id, start: at(start), end: at(end) };
            OpenCachePart { booking, done, holder: None, held: false }
        }

        fn held(&self, node: usize, started: i64, progress: f64) -> Option<Holder> {
            let (since, p95) = (at(started), Some(12_000_000));
            let attempt = TaskAttempt { since, progress, sign: since, p95 };
            Some(Holder { node_id: self.nodes[node], started: since, attempt, slowness: 1.0 })
        }
    }

    fn times(projection: &Projection) -> Vec<(u32, i64, i64)> {
        let seconds = |it: Timestamp| it.micros() / 1_000_000;
        projection.frames.iter().map(|it| (it.booking.frame, seconds(it.start), seconds(it.end))).collect()
    }

    #[test]
    fn a_frame_that_runs_late_moves_those_after_it_on_its_node() {
        let farm = Farm::new();
        let open = [
            farm.frame(0, 0, (0, 10), farm.held(0, 0, 0.5)),
            farm.frame(1, 0, (10, 20), None),
            farm.frame(2, 1, (10, 20), None),
        ];
        // It was to be half done at second 0, and so done at second 5. In 19 of 20 cases it is by second 10.
        let found = project(&open, &[], at(6));
        assert_eq!(times(&found), [(0, 0, 10), (1, 10, 20), (2, 10, 20)]);
        // At second 30 it rather hangs than works. It is run again at second 60.
        let found = project(&open, &[], at(30));
        assert_eq!(times(&found), [(0, 0, 70), (2, 30, 40), (1, 70, 80)]);
        assert_eq!(found.finish_of(farm.job), Some(at(80)));
        assert_eq!(times(&project(&stretched(&open[1..2], 1.5), &[], at(0))), [(1, 10, 25)]);
    }

    #[test]
    fn a_frame_takes_as_long_as_its_holder_needs_and_not_the_node_that_it_was_booked_on() {
        let farm = Farm::new();
        let slow = farm.held(1, 0, 0.0).map(|holder| Holder { slowness: 3.0, ..holder });
        let open = [farm.frame(0, 0, (0, 10), slow), farm.frame(1, 1, (5, 15), None)];
        let found = project(&open, &[], at(0));
        assert_eq!(times(&found), [(0, 0, 30), (1, 30, 40)]);
        let chance = |deadline| found.frames[0].chance(at(deadline), at(0)).unwrap();
        assert!(chance(15) < 0.1 && chance(60) > 0.9, "{} {}", chance(15), chance(60));
    }

    #[test]
    fn near_instants_are_shown_to_the_second_and_far_ones_to_the_minute() {
        let micros = |micros| Timestamp::from_micros(micros);
        assert_eq!(rounded_up(micros(1_000_001), at(0)), at(2));
        assert_eq!(rounded_up(at(600), at(0)), at(600));
        assert_eq!(rounded_up(micros(600_000_001), at(0)), at(660));
        assert_eq!(rounded_up(micros(-1), at(0)), at(0));
    }

    #[test]
    fn frames_wait_for_the_cache_that_they_share() {
        let farm = Farm::new();
        let open = [farm.frame(0, 0, (0, 10), None)];
        let found = project(&open, &[farm.part(1, (0, 20), 0.5)], at(0));
        assert_eq!((found.cache_full_at(farm.job), times(&found)), (Some(at(10)), vec![(0, 10, 20)]));
        let same_node = project(&open, &[farm.part(0, (0, 20), 0.0)], at(0));
        assert_eq!(times(&same_node), [(0, 20, 30)], "the part goes first");
    }

    #[test]
    fn what_is_held_delays_no_other_job_and_has_no_end() {
        let farm = Farm::new();
        let open = [farm.held_frame(0, (0, 50)), farm.frame(1, 0, (60, 80), None)];
        let held = open[0].booking.job_id;
        // Its booking has passed.
        let projection = project(&open, &[], at(70));
        let ends = projection.ends();
        assert_eq!((ends.finish_of(farm.job), ends.finish_of(held)), (Some(at(90)), None));
        assert_eq!(ends.last(), Some(at(90)));
        let of_held = projection.frames.iter().find(|frame| frame.held).expect("it is booked");
        assert_eq!((of_held.start, of_held.end), (at(90), at(140)));
    }
}
