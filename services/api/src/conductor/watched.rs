//! What the watch of the farm found when it last looked. It asks for a new plan when something is new, and
//! not at every look: planning may have found nothing better.

use std::collections::{BTreeMap, BTreeSet};

use forelight_protocol::{FramePart, JobId, NodeId, Timestamp};

const MINUTE: i64 = 60_000_000;

/// A job that will miss its promise is planned again when it is later than before by a tenth of the time that
/// is left, within these limits, in microseconds.
const LATER: (i64, i64) = (MINUTE, 5 * MINUTE);

/// A frame of a job, or a part of it, that waits on a node.
pub(super) type Waiting = (NodeId, JobId, FramePart);

/// What the last look found.
#[derive(Clone, Default)]
pub(super) struct Watched {
    /// The nodes that could be booked; `None` before the first look.
    bookable: Option<BTreeSet<NodeId>>,
    /// What waited on nodes that were lost.
    stranded: BTreeSet<Waiting>,
    /// The earliest end that was expected of each late job since a plan was last asked for because of it.
    late: BTreeMap<JobId, Timestamp>,
}

impl Watched {
    /// The nodes that can be booked again, of those that can be booked now.
    pub fn returned(&mut self, bookable: BTreeSet<NodeId>) -> Vec<NodeId> {
        let before = self.bookable.replace(bookable.clone());
        before.map_or_else(Vec::new, |before| bookable.difference(&before).copied().collect())
    }

    /// The nodes with something that did not wait there before, of what waits on lost nodes now.
    pub fn lost(&mut self, stranded: BTreeSet<Waiting>) -> BTreeSet<NodeId> {
        let new = stranded.difference(&self.stranded).map(|&(node, ..)| node).collect();
        self.stranded = stranded;
        new
    }

    /// The jobs that are late or later than before, of those that will miss their promises, with their ends.
    pub fn later(&mut self, late: &BTreeMap<JobId, Timestamp>, now: Timestamp) -> Vec<JobId> {
        self.late.retain(|job, _| late.contains_key(job));
        let mut later = Vec::new();
        for (&job, &end) in late {
            let step = (end.micros_since(now) / 10).clamp(LATER.0, LATER.1);
            match self.late.get_mut(&job) {
                Some(before) if end.micros_since(*before) < step => *before = end.min(*before),
                _ => {
                    self.late.insert(job, end);
                    later.push(job);
                }
            }
        }
        later
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_node_is_told_once_when_it_is_back() {
        let mut watched = Watched::default();
        let (a, b) = (NodeId::new(), NodeId::new());
        assert_eq!(watched.returned([a, b].into()), [], "nothing is known before the first look");
        assert_eq!(watched.returned([a].into()), []);
        assert_eq!(watched.returned([a, b].into()), [b]);
        assert_eq!(watched.returned([a, b].into()), []);
    }

    #[test]
    fn a_lost_node_is_told_when_more_waits_there_than_before() {
        let mut watched = Watched::default();
        let (node, job) = (NodeId::new(), JobId::new());
        let told: Vec<usize> = [&[][..], &[1], &[1], &[1, 2], &[1, 2], &[2], &[2, 1], &[], &[1]]
            .into_iter()
            .map(|frames| {
                frames.iter().map(|&frame| (node, job, FramePart { frame, part: 0, parts: 1 })).collect()
            })
            .map(|stranded| watched.lost(stranded).len())
            .collect();
        assert_eq!(told, [0, 1, 0, 1, 0, 0, 1, 0, 1]);
    }

    #[test]
    fn a_late_job_is_told_again_only_when_it_is_later_by_minutes() {
        let at = |minutes: i64| Timestamp::from_micros(minutes * MINUTE);
        let job = JobId::new();
        let told = |ends: &[i64], now: i64| -> Vec<i64> {
            let mut watched = Watched::default();
            let is_told = |end: &i64| watched.later(&BTreeMap::from([(job, at(*end))]), at(now)) == [job];
            ends.iter().copied().filter(is_told).collect()
        };
        assert_eq!(told(&[100, 100, 104, 104, 105, 109, 110, 90, 94, 95], 0), [100, 105, 110, 95]);
        assert_eq!(told(&[100, 100, 101, 101, 102], 95), [100, 101, 102], "its end is near");
        let mut watched = Watched::default();
        for late in [BTreeMap::from([(job, at(100))]), BTreeMap::new()] {
            assert_eq!(watched.later(&late, at(0)).len(), late.len(), "{late:?}");
        }
        assert_eq!(
            watched.later(&BTreeMap::from([(job, at(90))]), at(0)),
            [job],
            "it was in time for a while"
        );
    }
}
