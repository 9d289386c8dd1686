//! The input as the method wants it: in order, grouped, with free time worked out.

use std::collections::BTreeMap;

use crate::calendar::{Window, windows};
use crate::model::{FixedBooking, Frame, Input, Job, Node, Task};

/// An input in the order of identities.
pub(crate) struct Problem<'a> {
    pub input: &'a Input,
    /// By id.
    pub nodes: Vec<&'a Node>,
    /// Free stretches of each node.
    pub windows: Vec<Vec<Window>>,
    /// Nodes that differ in nothing but calendar and name.
    pub classes: Vec<Vec<usize>>,
    /// Class of each node.
    pub class_of: Vec<usize>,
    /// By id.
    pub jobs: Vec<Work<'a>>,
}

/// A job with its bought work.
pub(crate) struct Work<'a> {
    pub job: &'a Job,
    /// Work of the shared cache.
    pub shared_cache: Option<u64>,
    /// Frames, longest predicted P80 first, then by number.
    pub frames: Vec<FrameWork>,
    /// Classes of nodes that can do its frames' work.
    pub classes: Vec<usize>,
    /// The same for its shared cache.
    pub shared_cache_classes: Vec<usize>,
}

/// A frame with its bought work.
#[derive(Clone, Copy, Debug)]
pub(crate) struct FrameWork {
    pub number: i64,
    pub work: u64,
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
        let windows =
            nodes.iter().map(|node| windows(node, input.now, fixed.get(&node.id).unwrap_or(&none))).collect();
        let mut groups: BTreeMap<_, Vec<usize>> = BTreeMap::new();
        for (index, node) in nodes.iter().enumerate() {
            let machine = (node.speed, &node.speeds);
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
        let jobs = jobs.into_iter().map(|job| Work::new(job, &nodes, &classes)).collect();
        Problem { input, nodes, windows, classes, class_of, jobs }
    }

    /// A node of the class; all its nodes do the same work in the same time.
    pub fn representative(&self, class: usize) -> &'a Node {
        // Classes are not empty.
        self.nodes[self.classes[class][0]]
    }

    /// Index of a node.
    pub fn node(&self, id: u64) -> Option<usize> {
        self.nodes.binary_search_by_key(&id, |node| node.id).ok()
    }

    /// Index of a job.
    pub fn job(&self, id: u64) -> Option<usize> {
        self.jobs.binary_search_by_key(&id, |work| work.job.id).ok()
    }
}

impl<'a> Work<'a> {
    fn new(job: &'a Job, nodes: &[&Node], classes: &[Vec<usize>]) -> Self {
        let open: BTreeMap<i64, u64> = job.open_work().collect();
        let mut frames: Vec<(&Frame, u64)> =
            job.frames.iter().filter_map(|frame| Some((frame, *open.get(&frame.number)?))).collect();
        // Without a P80 of its own, a frame counts with what is bought for it.
        frames.sort_unstable_by_key(|(frame, work)| {
            (std::cmp::Reverse(frame.work_p80.max(*work)), std::cmp::Reverse(*work), frame.number)
        });
        let able = |class: u32| -> Vec<usize> {
            let can = |members: &[usize]| nodes[members[0]].speed_of(class) > 0;
            (0..classes.len()).filter(|&index| can(&classes[index])).collect()
        };
        Work {
            job,
            shared_cache: job.bought_shared_cache(),
            frames: frames
                .iter()
                .map(|(frame, work)| FrameWork { number: frame.number, work: *work })
                .collect(),
            classes: able(job.class),
            shared_cache_classes: job.shared_cache.map_or_else(Vec::new, |cache| able(cache.class)),
        }
    }

    /// Microseconds that the node takes for a task of this job. None if it cannot do it at all.
    pub fn duration(&self, node: &Node, task: Task) -> Option<i64> {
        match task {
            Task::SharedCache | Task::SharedCachePart { .. } => {
                node.duration(self.job.shared_cache_work(task)?, self.job.shared_cache?.class)
            }
            Task::Frame(number) => node.duration(self.work_of(number)?, self.job.class),
        }
    }

    /// Work of each part of the shared cache, or of all of it if it is not split.
    pub fn shared_cache_part(&self) -> Option<u64> {
        self.job.shared_cache_work(self.job.shared_cache?.tasks().next()?)
    }

    fn work_of(&self, number: i64) -> Option<u64> {
        self.frames.iter().find(|frame| frame.number == number).map(|frame| frame.work)
    }

    /// Whether there are nodes that can do its frames, and its shared cache.
    pub fn has_nodes(&self) -> bool {
        let can = |is_wanted: bool, classes: &[usize]| !is_wanted || !classes.is_empty();
        can(!self.frames.is_empty(), &self.classes)
            && can(self.shared_cache.is_some(), &self.shared_cache_classes)
    }

    /// Work of all frames together.
    pub fn total(&self) -> u128 {
        self.frames.iter().map(|frame| u128::from(frame.work)).sum()
    }

    pub fn release(&self, now: i64) -> i64 {
        self.job.release.max(now)
    }
}
