//! Frames that are divided into parts.
//!
//! A frame that must have parts is divided when its job comes in. Any other frame is divided when its first
//! part starts, and not before: until then, a new plan may have it whole. From then on each part is a task of
//! its own, with its own lease. So a node that dies loses one part, and the others stay done.

use forelight_planner::Task;

use super::{Farm, JobState, Refusal, TaskState};
use crate::world::TrueTask;

/// A frame that is divided.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Divided {
    /// Index of the first part. The others follow.
    first: usize,
    parts: u32,
    /// Parts that are not done.
    left: u32,
}

impl Farm<'_> {
    /// Starts a part of a frame on a node now. The first one divides the frame; its other parts wait from then
    /// on.
    ///
    /// # Errors
    /// If the part cannot start. Nothing has changed then.
    pub fn start_part(
        &mut self,
        node: usize,
        job: usize,
        frame: usize,
        (part, parts): (u32, u32),
    ) -> Result<(), Refusal> {
        if let Some(place) = self.jobs[job].part(frame, part, parts) {
            return self.start(node, job, place);
        }
        let is_allowed = |whole: &TrueTask| {
            matches!(whole.task, Task::Frame(_)) && parts > 1 && part < parts && whole.division.allows(parts)
        };
        if !self.jobs[job].truth.get(frame).is_some_and(is_allowed) {
            return Err(Refusal::NotDivisible);
        }
        self.can_start(node, job, frame)?;
        let first = self.divide(job, frame, parts);
        self.start(node, job, first + part as usize)
    }

    /// Makes parts of a frame that waits. Returns the index of the first.
    pub(super) fn divide(&mut self, job: usize, frame: usize, parts: u32) -> usize {
        let asked = self.job(job);
        let entry = &mut self.jobs[job];
        let whole = entry.truth[frame];
        let first = entry.truth.len();
        for part in 0..parts {
            let place = first + part as usize;
            entry.truth.push(TrueTask {
                task: Task::Part { frame: whole.task.frame().unwrap_or_default(), part, parts },
                median: asked.part_work(whole.median, parts),
                work: asked.part_work(whole.work, parts),
                class: whole.class,
                division: forelight_planner::Division::Whole,
            });
            entry.tasks.push(TaskState::Waiting);
            entry.waiting.insert(place);
            entry.whole_of.insert(place, frame);
        }
        entry.tasks[frame] = TaskState::Divided;
        entry.waiting.remove(&frame);
        entry.left += parts as usize - 1;
        entry.divided.insert(frame, Divided { first, parts, left: parts });
        first
    }
}

impl JobState {
    /// Index of a part of a frame that is divided into so many.
    pub(crate) fn part(&self, frame: usize, part: u32, parts: u32) -> Option<usize> {
        let divided = self.divided.get(&frame)?;
        (divided.parts == parts && part < parts).then_some(divided.first + part as usize)
    }

    /// Indices of a frame's tasks: itself, or its parts.
    pub(crate) fn tasks_of(&self, frame: usize) -> std::ops::Range<usize> {
        match self.divided.get(&frame) {
            None => frame..frame + 1,
            Some(divided) => divided.first..divided.first + divided.parts as usize,
        }
    }

    /// A task is done. The work of a frame is known when all its parts are done.
    pub(super) fn measure(&mut self, task: usize) {
        let whole = match self.whole_of.get(&task) {
            None => task,
            Some(&frame) => {
                let Some(divided) = self.divided.get_mut(&frame) else { return };
                divided.left -= 1;
                if divided.left > 0 {
                    return;
                }
                self.tasks[frame] = TaskState::Done;
                frame
            }
        };
        if !self.truth[whole].task.is_shared_cache() {
            self.measured.push(whole);
            self.measured_work += u128::from(self.truth[whole].work);
        }
    }
}
