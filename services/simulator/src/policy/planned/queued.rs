//! A task that a plan has given to a node.

use crate::farm::{Farm, TaskState};

#[derive(Clone, Copy, Debug)]
pub(super) struct Queued {
    pub job: usize,
    pub task: usize,
    /// For a part of a frame that the plan divides: which of how many. `task` is the frame then.
    pub part: Option<(u32, u32)>,
    /// Booked time.
    pub length: i64,
}

impl Queued {
    /// Whether the task is still waiting.
    pub fn waits(&self, farm: &Farm) -> bool {
        let entry = &farm.jobs[self.job];
        let part = self.part.and_then(|(part, parts)| entry.part(self.task, part, parts));
        !entry.withdrawn && entry.tasks[part.unwrap_or(self.task)] == TaskState::Waiting
    }

    /// Starts the task. Returns whether it could.
    pub fn start(&self, farm: &mut Farm, node: usize) -> bool {
        let started = match self.part {
            None => farm.start(node, self.job, self.task),
            Some(part) => farm.start_part(node, self.job, self.task, part),
        };
        started.is_ok()
    }
}
