//! What a new plan changes for a job: its bookings, and what is said of its promise.

use std::collections::{BTreeMap, BTreeSet};

use forelight_protocol::{EventKind, FramePart, NodeId, Promise, Timestamp};

/// A booking of a plan to be kept.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct NewBooking {
    /// The frame, or the part of one.
    pub frame: FramePart,
    /// The node.
    pub node: NodeId,
    /// From when.
    pub start: Timestamp,
    /// Until when (exclusive).
    pub end: Timestamp,
}

/// A job's bookings under a new plan.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(crate) struct Rebooked {
    /// All bookings that the job has from now on.
    pub bookings: BTreeMap<FramePart, NewBooking>,
    /// The frames whose tasks are told where they are booked now; `None`: nowhere.
    pub tasks: Vec<(FramePart, Option<NewBooking>)>,
}

/// Books the frames that wait for a worker as the plan says, and leaves every other frame where it was.
///
/// `begun` are the frames that were done or with a worker when the plan was made. One of them that waits
/// again by now keeps the booking that it had.
pub(crate) fn rebook(
    before: BTreeMap<FramePart, NewBooking>,
    waiting: &[FramePart],
    planned: &[NewBooking],
    begun: &BTreeSet<FramePart>,
) -> Rebooked {
    let planned: BTreeMap<FramePart, &NewBooking> =
        planned.iter().map(|booking| (booking.frame, booking)).collect();
    let mut rebooked = Rebooked { bookings: before, tasks: Vec::with_capacity(waiting.len()) };
    for &frame in waiting {
        let booking = planned.get(&frame).map(|&booking| booking.clone());
        match &booking {
            Some(booking) => rebooked.bookings.insert(frame, booking.clone()),
            None if begun.contains(&frame) => continue,
            None => rebooked.bookings.remove(&frame),
        };
        rebooked.tasks.push((frame, booking));
    }
    rebooked
}

/// The event that a promise broke or is kept again, with its message; `None` if neither. A job without a
/// promise before counts as one whose promise was kept.
pub(crate) fn promise_news(before: Option<&Promise>, now: Option<&Promise>) -> Option<(EventKind, String)> {
    let now = now?;
    let was_kept = before.is_none_or(|promise| promise.kept);
    let kind = match (was_kept, now.kept) {
        (true, false) => EventKind::JobPromiseAtRisk,
        (false, true) => EventKind::JobPromiseSafe,
        _ => return None,
    };
    Some((kind, promise_in_words(now)))
}

fn promise_in_words(promise: &Promise) -> String {
    let sure = promise.probability * 100.0;
    if promise.kept {
        return format!("ready in time after all, with a probability of {sure:.0} %");
    }
    let rescue = match &promise.rescue {
        Some(rescue) => format!("the cheapest rescue: {}", rescue.words),
        None => "no rescue was found".to_owned(),
    };
    format!("ready in time with a probability of {sure:.0} % only; {rescue}")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(micros: i64) -> Timestamp {
        Timestamp::from_micros(micros)
    }

    #[test]
    fn a_plan_moves_what_waits_and_leaves_what_has_begun() {
        let (old, new) = (NodeId::new(), NodeId::new());
        let booking = |frame: u32, node| NewBooking { frame: frame.into(), node, start: at(0), end: at(1) };
        let before = (0..4).map(|frame| (frame.into(), booking(frame, old))).collect();
        // Frame 0 is with a worker. Frame 1 was when the plan was made. The plan has no node for frame 3.
        let planned = [booking(2, new)];
        let found = rebook(
            before,
            &[1, 2, 3].map(FramePart::from),
            &planned,
            &BTreeSet::from([0, 1].map(FramePart::from)),
        );
        let nodes: Vec<(u32, NodeId)> = found.bookings.values().map(|it| (it.frame.frame, it.node)).collect();
        assert_eq!(nodes, [(0, old), (1, old), (2, new)]);
        assert_eq!(found.tasks, [(2.into(), Some(booking(2, new))), (3.into(), None)]);
    }

    #[test]
    fn a_promise_is_news_when_it_breaks_and_when_it_is_kept_again() {
        let promise = |kept| Promise { kept, probability: 0.4, finish: None, since: at(0), rescue: None };
        let (kept, broken) = (promise(true), promise(false));
        let kind = |before, now| promise_news(before, now).map(|(kind, _)| kind);
        assert_eq!(kind(None, Some(&broken)), Some(EventKind::JobPromiseAtRisk));
        assert_eq!(kind(Some(&broken), Some(&kept)), Some(EventKind::JobPromiseSafe));
        assert_eq!(kind(None, Some(&kept)), None);
        assert_eq!(kind(Some(&broken), Some(&broken)), None);
        assert_eq!(kind(Some(&broken), None), None);
        assert!(promise_in_words(&broken).contains("40 % only; no rescue"));
    }
}
