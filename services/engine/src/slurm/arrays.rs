//! Groups tasks into Slurm arrays.
//!
//! All elements of a Slurm array share its options. So an array holds tasks of one job and one kind, in the
//! order of their bookings. Lost tasks go into an array of their own, and so do second attempts beside a node
//! that makes no progress.
//!
//! * **Begin**: the start of the first booking. Within an array, Slurm starts elements in order as nodes
//!   become free.
//! * **Limit**: the longest frame's P95 on the slowest node, times [`SAFETY`], plus [`START_UP`]. It doubles
//!   each time a task runs out of it.
//! * **Deadline**: the job's, if the plan keeps it and the last frame, started as booked, could use its whole
//!   limit. Otherwise none, because Slurm cancels what would miss it, and late frames are still wanted.
//! * **Reservation**: the booked nodes from the first booking to the end of the last, for jobs whose deadline
//!   the plan keeps.

use std::collections::BTreeMap;

use forelight_protocol::{JobId, TaskKind, Timestamp};
use forelight_store::{NewArray, Waiting};

/// Factor on the P95 of a frame's time. It covers busy nodes, a cold file system and full memory. A long
/// limit costs the slot of a hanging frame; a short one costs the whole frame.
pub const SAFETY: f64 = 4.0;

/// Seconds to fetch and load a scene, measure the node and write images.
pub const START_UP: f64 = 120.0;

/// Longest limit, in minutes: 30 days.
const LONGEST: f64 = 43_200.0;

/// Most elements in an array. Slurm's default limit is 1000 (`MaxArraySize`).
pub const MOST_ELEMENTS: usize = 1000;

/// Losses of one task after which its job fails.
pub const MAX_LOST: usize = 6;

/// First pause before a lost task is submitted again, microseconds. It doubles with each loss.
const FIRST_PAUSE: i64 = 5_000_000;

/// An array that begins sooner than this begins at once, microseconds.
const NOW: i64 = 2_000_000;

#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Pricing {
    /// Speed of the slowest node, relative to the reference core.
    pub slowest: f64,
    /// Limit of previews and profiles, in minutes. They have no forecast.
    pub quote_minutes: u32,
}

/// Tasks to submit as one array.
#[derive(Clone, PartialEq, Debug)]
pub struct Batch {
    pub array: NewArray,
    pub kind: TaskKind,
    pub job_name: String,
    /// Nodes to reserve, with start and end.
    pub keep_free: Option<(Vec<String>, Timestamp, Timestamp)>,
    /// The node that makes no progress with these tasks.
    pub avoid: Option<String>,
}

/// What to do with the waiting tasks.
#[derive(Clone, PartialEq, Debug, Default)]
pub struct Due {
    pub batches: Vec<Batch>,
    /// Tasks to give up, with the reason.
    pub hopeless: Vec<(Waiting, String)>,
}

/// What the tasks of an array have in common: the place of their job, the job, the kind, whether they were lost
/// before, and the node that makes no progress with them.
type Group<'a> = (usize, JobId, TaskKind, bool, Option<&'a str>);

/// Groups waiting tasks into arrays. Recently lost tasks keep waiting.
pub fn due(waiting: &[Waiting], pricing: Pricing, now: Timestamp) -> Due {
    let mut due = Due::default();
    let mut groups: BTreeMap<Group<'_>, Vec<&Waiting>> = BTreeMap::new();
    let mut order: BTreeMap<JobId, usize> = BTreeMap::new();
    for task in waiting {
        if task.lost.len() >= MAX_LOST {
            let last = task.lost.last().map_or("", String::as_str);
            let reason =
                format!("Slurm ended its process {} times, the last one with {last}", task.lost.len());
            due.hopeless.push((task.clone(), reason));
            continue;
        }
        if let Some(at) = task.lost_at
            && now < at.plus_micros(FIRST_PAUSE << task.lost.len().saturating_sub(1).min(6))
        {
            continue;
        }
        // Jobs keep the store's order: deadline, then priority.
        let next = order.len();
        let place = *order.entry(task.job).or_insert(next);
        let group = (place, task.job, task.kind, !task.lost.is_empty(), task.beside.as_deref());
        groups.entry(group).or_default().push(task);
    }
    for ((_, job, kind, again, _), mut tasks) in groups {
        tasks.sort_by_key(|task| (task.booked.as_ref().map(|booked| booked.start), task.frame));
        for tasks in tasks.chunks(MOST_ELEMENTS) {
            due.batches.push(batch(job, kind, again, tasks, pricing, now));
        }
    }
    due
}

fn batch(
    job: JobId,
    kind: TaskKind,
    again: bool,
    tasks: &[&Waiting],
    pricing: Pricing,
    now: Timestamp,
) -> Batch {
    let limit_minutes = tasks.iter().map(|task| limit(task, pricing)).max().unwrap_or(pricing.quote_minutes);
    let bookings = || tasks.iter().filter_map(|task| task.booked.as_ref());
    let first = bookings().map(|booked| booked.start).min();
    let begin = first.filter(|start| !again && start.micros_since(now) > NOW);
    let held = tasks.iter().find_map(|task| task.deadline).filter(|_| !again);
    let last_start = bookings().map(|booked| booked.start).max().map_or(now, |start| start.max(now));
    let deadline =
        held.filter(|deadline| last_start.plus_micros(i64::from(limit_minutes) * 60_000_000) <= *deadline);
    let mut nodes: Vec<String> = bookings().map(|booked| booked.node.clone()).collect();
    nodes.sort();
    nodes.dedup();
    let last_end = bookings().map(|booked| booked.end).max();
    let keep_free = match (held, first, last_end) {
        (Some(_), Some(start), Some(end)) if end > now => Some((nodes, start, end)),
        _ => None,
    };
    Batch {
        array: NewArray {
            job,
            tasks: tasks.iter().map(|task| task.task).collect(),
            limit_minutes,
            begin,
            deadline,
            reservation: None,
        },
        kind,
        job_name: tasks.first().map_or(String::new(), |task| task.job_name.clone()),
        keep_free,
        avoid: tasks.first().and_then(|task| task.beside.clone()),
    }
}

fn limit(task: &Waiting, pricing: Pricing) -> u32 {
    let minutes = match task.cpu_p95 {
        Some(cpu) if task.kind.is_booked() => {
            let time = cpu.max(0.0) / pricing.slowest.max(1e-6) + task.serial as f64 * 1e-6;
            (time * SAFETY + START_UP) / 60.0
        }
        _ => f64::from(pricing.quote_minutes),
    };
    let ran_out = task.lost.iter().filter(|outcome| outcome.starts_with("TIMEOUT")).count();
    let minutes = minutes * f64::from(1_u32 << ran_out.min(MAX_LOST));
    minutes.ceil().clamp(1.0, LONGEST) as u32
}

#[cfg(test)]
mod tests {
    use super::*;
    use forelight_protocol::TaskId;
    use forelight_store::BookedTime;
    use uuid::Uuid;

    const PRICING: Pricing = Pricing { slowest: 2.0, quote_minutes: 60 };

    fn at(seconds: i64) -> Timestamp {
        Timestamp::from_micros(1_800_000_000_000_000 + seconds * 1_000_000)
    }

    /// A frame of 60 CPU seconds, booked for a minute on one of two nodes.
    fn frame(number: u32) -> Waiting {
        let start = 600 + i64::from(number / 2) * 60;
        Waiting {
            task: TaskId(Uuid::from_u128(u128::from(number))),
            job: JobId(Uuid::nil()),
            job_name: "shot".to_owned(),
            kind: TaskKind::Render,
            frame: Some(number),
            booked: Some(BookedTime {
                node: format!("n{}", number % 2),
                start: at(start),
                end: at(start + 60),
            }),
            cpu_p95: Some(60.0),
            serial: 0,
            deadline: Some(at(7200)),
            lost: Vec::new(),
            lost_at: None,
            beside: None,
        }
    }

    fn lost(number: u32, outcomes: &[&str], seconds: i64) -> Waiting {
        let lost = outcomes.iter().map(|&outcome| outcome.to_owned()).collect();
        Waiting { lost, lost_at: Some(at(seconds)), ..frame(number) }
    }

    fn only(due: Due) -> Batch {
        assert!(due.batches.len() == 1 && due.hopeless.is_empty(), "{due:?}");
        due.batches.into_iter().next().unwrap()
    }

    #[test]
    fn a_jobs_frames_are_one_array_in_the_order_of_their_bookings() {
        let frames: Vec<Waiting> = (0..10).rev().map(frame).collect();
        let batch = only(due(&frames, PRICING, at(0)));
        let expected: Vec<TaskId> = (0..10).map(|number| frame(number).task).collect();
        assert_eq!(batch.array.tasks, expected);
        assert_eq!(batch.array.begin, Some(at(600)));
        // 60 s on two cores take 30 s. Four times that is 2 minutes, plus 2 minutes of start-up.
        assert_eq!(batch.array.limit_minutes, 4);
        assert_eq!(batch.array.deadline, Some(at(7200)));
        assert_eq!(batch.keep_free, Some((vec!["n0".to_owned(), "n1".to_owned()], at(600), at(900))));
    }

    #[test]
    fn a_booking_that_has_come_begins_at_once() {
        let batch = only(due(&[frame(0)], PRICING, at(599)));
        assert_eq!(batch.array.begin, None);
    }

    #[test]
    fn slurm_is_told_a_deadline_only_if_it_cannot_kill_a_frame_that_goes_as_planned() {
        // The last frame is booked at 600 s and has a limit of 240 s.
        for (deadline, told) in [(839, false), (840, true)] {
            let frame = Waiting { deadline: Some(at(deadline)), ..frame(0) };
            let batch = only(due(&[frame], PRICING, at(0)));
            assert_eq!(batch.array.deadline.is_some(), told, "{deadline}");
        }
        let none = Waiting { deadline: None, ..frame(0) };
        let batch = only(due(&[none], PRICING, at(0)));
        assert_eq!((batch.array.deadline, batch.keep_free), (None, None));
    }

    #[test]
    fn what_was_lost_goes_again_after_a_pause_at_once_without_deadline_and_with_more_time_if_it_ran_out_of_it()
     {
        let task = lost(3, &["TIMEOUT", "NODE_FAIL", "TIMEOUT"], 100);
        assert_eq!(due(std::slice::from_ref(&task), PRICING, at(119)), Due::default());
        let batch = only(due(&[task], PRICING, at(120)));
        assert_eq!((batch.array.limit_minutes, batch.array.begin, batch.array.deadline), (16, None, None));
        assert_eq!(batch.keep_free, None);
        // Not in one array with those that go for the first time.
        let both = due(&[frame(0), lost(3, &["CANCELLED"], 0)], PRICING, at(10));
        assert_eq!(both.batches.iter().map(|batch| batch.array.tasks.len()).collect::<Vec<_>>(), [1, 1]);
    }

    #[test]
    fn second_attempts_avoid_the_node_of_the_first_and_begin_at_once() {
        let beside = |number, node: &str| Waiting {
            beside: Some(node.to_owned()),
            booked: None,
            deadline: None,
            ..frame(number)
        };
        let due = due(&[beside(0, "n0"), beside(1, "n1"), beside(2, "n0"), frame(3)], PRICING, at(0));
        let arrays: Vec<_> = due
            .batches
            .iter()
            .map(|batch| (batch.avoid.as_deref(), batch.array.tasks.len(), batch.array.begin))
            .collect();
        assert_eq!(arrays, [(None, 1, Some(at(660))), (Some("n0"), 2, None), (Some("n1"), 1, None)]);
    }

    #[test]
    fn what_was_lost_too_often_is_given_up_with_the_last_reason() {
        let task = lost(3, &["FAILED with exit code 127"; MAX_LOST], 0);
        let due = due(&[task], PRICING, at(10_000));
        assert!(due.batches.is_empty());
        assert_eq!(
            due.hopeless[0].1,
            "Slurm ended its process 6 times, the last one with FAILED with exit code 127"
        );
    }

    #[test]
    fn quotes_have_a_limit_of_their_own_and_long_jobs_more_than_one_array() {
        let preview =
            Waiting { kind: TaskKind::Preview, frame: None, booked: None, cpu_p95: None, ..frame(0) };
        let batch = only(due(&[preview], PRICING, at(0)));
        assert_eq!((batch.array.limit_minutes, batch.array.begin), (60, None));
        let many: Vec<Waiting> = (0..2500).map(frame).collect();
        let sizes: Vec<usize> =
            due(&many, PRICING, at(0)).batches.iter().map(|batch| batch.array.tasks.len()).collect();
        assert_eq!(sizes, [1000, 1000, 500]);
    }

    #[test]
    fn no_forecast_however_wrong_makes_a_limit_that_slurm_refuses() {
        for cpu in [0.0, -1.0, 1e300, f64::INFINITY, f64::NAN] {
            let task = Waiting { cpu_p95: Some(cpu), ..frame(0) };
            let minutes = limit(&task, Pricing { slowest: 0.0, ..PRICING });
            assert!((1..=LONGEST as u32).contains(&minutes), "{cpu}: {minutes}");
        }
    }
}
