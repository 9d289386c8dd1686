//! The input, sorted and grouped, with free time computed.

use std::collections::BTreeMap;

use crate::calendar::{Window, windows};
use crate::looks::Looks;
use crate::model::{Division, FixedBooking, Frame, Input, Job, Node, Task};
use crate::supply::Supply;

/// Sorted numbers, and where each of them is.
struct Numbers(Vec<u64>);

impl Numbers {
    fn place(&self, number: u64) -> Option<usize> {
        // They mostly follow each other.
        let ahead = number.checked_sub(*self.0.first()?)?;
        let guess = usize::try_from(ahead).ok().filter(|&guess| self.0.get(guess) == Some(&number));
        guess.or_else(|| self.0.binary_search(&number).ok())
    }
}

/// The number of a frame, in the same order from zero on.
fn from_zero(frame: i64) -> u64 {
    frame.cast_unsigned() ^ (1 << 63)
}

/// An input, sorted by id.
pub(crate) struct Problem<'a> {
    pub input: &'a Input,
    node_ids: Numbers,
    job_ids: Numbers,
    /// By id.
    pub nodes: Vec<&'a Node>,
    pub windows: Vec<Vec<Window>>,
    /// Groups of nodes that differ only in name and calendar.
    pub classes: Vec<Vec<usize>>,
    pub class_of: Vec<usize>,
    /// By id.
    pub jobs: Vec<Work<'a>>,
    pub supply: Supply,
    pub looks: Looks,
}

pub(crate) struct Work<'a> {
    pub job: &'a Job,
    pub shared_cache: Option<u64>,
    /// Frames by P80, longest first, then by number.
    pub frames: Vec<FrameWork>,
    /// Numbers of its frames ([`from_zero`]), and their places in `frames`.
    numbers: Numbers,
    places: Vec<usize>,
    /// Classes of nodes that can render its frames.
    pub classes: Vec<usize>,
    pub shared_cache_classes: Vec<usize>,
}

#[derive(Clone, Copy, Debug)]
pub(crate) struct FrameWork {
    pub number: i64,
    pub work: u64,
    pub division: Division,
}

impl<'a> Problem<'a> {
    pub fn new(input: &'a Input) -> Self {
        let mut nodes: Vec<&Node> = input.nodes.iter().collect();
        nodes.sort_unstable_by_key(|node| node.id);
        let mut fixed: BTreeMap<u64, Vec<&FixedBooking>> = BTreeMap::new();
        for booking in &input.fixed {
            fixed.entry(booking.node).or_default().push(booking);
        }
        let none = Vec::new();
        let windows: Vec<Vec<Window>> =
            nodes.iter().map(|node| windows(node, input.now, fixed.get(&node.id).unwrap_or(&none))).collect();
        let mut groups: BTreeMap<_, Vec<usize>> = BTreeMap::new();
        for (index, node) in nodes.iter().enumerate() {
            let machine = (node.speed, &node.speeds, &node.serial);
            let terms =
                (node.price_per_hour, node.billing_step, node.minimum_booking, node.setup, node.setup_cost);
            groups.entry((machine, terms)).or_default().push(index);
        }
        let classes: Vec<Vec<usize>> = groups.into_values().collect();
        let mut class_of = vec![0; nodes.len()];
        for (class, members) in classes.iter().enumerate() {
            members.iter().for_each(|&node| class_of[node] = class);
        }
        let mut jobs: Vec<&Job> = input.jobs.iter().collect();
        jobs.sort_unstable_by_key(|job| job.id);
        let job_ids = Numbers(jobs.iter().map(|job| job.id).collect());
        let node_ids = Numbers(nodes.iter().map(|node| node.id).collect());
        let jobs = jobs.into_iter().map(|job| Work::new(job, &nodes, &classes)).collect();
        let looks = Looks::default();
        let supply = Supply::new(&nodes, &windows, &classes, &looks);
        Problem { input, node_ids, job_ids, nodes, windows, classes, class_of, jobs, supply, looks }
    }

    /// A node of the class. All its nodes have the same speeds and serial times.
    pub fn representative(&self, class: usize) -> &'a Node {
        self.nodes[self.classes[class][0]]
    }

    pub fn node(&self, id: u64) -> Option<usize> {
        self.node_ids.place(id)
    }

    pub fn job(&self, id: u64) -> Option<usize> {
        self.job_ids.place(id)
    }
}

impl<'a> Work<'a> {
    fn new(job: &'a Job, nodes: &[&Node], classes: &[Vec<usize>]) -> Self {
        let mut frames: Vec<(&Frame, u64)> = job.open_frames().collect();
        // Without a P80 of its own, a frame counts with its booked work.
        frames.sort_unstable_by_key(|(frame, work)| {
            (std::cmp::Reverse(frame.work_p80.max(*work)), std::cmp::Reverse(*work), frame.number)
        });
        let able = |class: u32| -> Vec<usize> {
            let can = |members: &[usize]| nodes[members[0]].speed_of(class) > 0;
            (0..classes.len()).filter(|&index| can(&classes[index])).collect()
        };
        let mut by_number: Vec<(u64, usize)> =
            frames.iter().enumerate().map(|(place, (frame, _))| (from_zero(frame.number), place)).collect();
        by_number.sort_unstable();
        let (numbers, places) = by_number.into_iter().unzip();
        Work {
            job,
            numbers: Numbers(numbers),
            places,
            shared_cache: job.bought_shared_cache(),
            frames: frames
                .iter()
                .map(|&(frame, work)| FrameWork { number: frame.number, work, division: frame.division })
                .collect(),
            classes: able(job.class),
            shared_cache_classes: job.shared_cache.map_or_else(Vec::new, |cache| able(cache.class)),
        }
    }

    /// Microseconds that the node needs for a task of this job. `None` if it cannot do it.
    pub fn duration(&self, node: &Node, task: Task) -> Option<i64> {
        self.duration_at(self.place_of(task)?, node, task)
    }

    /// The same, for a task whose place is known. See [`Work::place_of`].
    pub fn duration_at(&self, place: usize, node: &Node, task: Task) -> Option<i64> {
        match self.frames.get(place) {
            Some(frame) => node.duration(self.work_in(frame, task)?, self.job.class),
            None => node.duration(self.job.shared_cache_work(task)?, self.job.shared_cache?.class),
        }
    }

    /// Where a task's frame is in `frames`. Tasks of the shared cache come behind the last.
    pub fn place_of(&self, task: Task) -> Option<usize> {
        task.frame().map_or(Some(self.frames.len()), |number| self.place(number))
    }

    /// Work of a frame or a part of one. `None` if the job has no such task, or the frame may not be divided
    /// like this.
    pub fn work_of(&self, task: Task) -> Option<u64> {
        self.work_in(self.frame(task.frame()?)?, task)
    }

    /// Work of a task of this frame. `None` if the frame may not be divided like this.
    fn work_in(&self, frame: &FrameWork, task: Task) -> Option<u64> {
        match task {
            Task::Part { part, parts, .. } => (part < parts && parts > 1 && frame.division.allows(parts))
                .then(|| self.job.part_work(frame.work, parts)),
            _ => frame.division.allows(1).then_some(frame.work),
        }
    }

    pub fn frame(&self, number: i64) -> Option<&FrameWork> {
        self.frames.get(self.place(number)?)
    }

    /// Where a frame is in `frames`.
    pub fn place(&self, number: i64) -> Option<usize> {
        Some(self.places[self.numbers.place(from_zero(number))?])
    }

    /// Work of each part of the shared cache, or of all of it if it is not split.
    pub fn shared_cache_part(&self) -> Option<u64> {
        self.job.shared_cache_work(self.job.shared_cache?.tasks().next()?)
    }

    /// Whether some nodes can render its frames, and some can do its shared cache.
    pub fn has_nodes(&self) -> bool {
        let can = |is_wanted: bool, classes: &[usize]| !is_wanted || !classes.is_empty();
        can(!self.frames.is_empty(), &self.classes)
            && can(self.shared_cache.is_some(), &self.shared_cache_classes)
    }

    /// The least work of its frames together.
    pub fn total(&self) -> u128 {
        self.frames.iter().map(|frame| self.job.least_work(frame.work, frame.division)).sum()
    }

    pub fn release(&self, now: i64) -> i64 {
        self.job.release.max(now)
    }
}

#[cfg(test)]
mod tests {
    use super::{Numbers, from_zero};

    #[test]
    fn numbers_are_found_whether_they_follow_each_other_or_not() {
        let all = [i64::MIN, -3, -2, -1, 0, 1, 5, i64::MAX];
        let numbers = Numbers(all.map(from_zero).to_vec());
        for (place, number) in all.into_iter().enumerate() {
            assert_eq!(numbers.place(from_zero(number)), Some(place), "{number}");
        }
        assert_eq!([2, 6, i64::MAX - 1].map(|number| numbers.place(from_zero(number))), [None; 3]);
        assert_eq!(Numbers(Vec::new()).place(0), None);
    }
}
