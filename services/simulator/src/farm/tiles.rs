//! Frames that are split into tiles.
//!
//! A frame is split when its first tile starts, and not before: until then a plan may change its mind. From then on each tile is a task of its
//! own, with a lease of its own, so a node that dies takes one tile with it and the others stay done.

use forelight_planner::Task;

use super::{Farm, Refusal, TaskState};
use crate::world::TrueTask;

/// A frame that is split.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Tiles {
    /// Place of the first tile; the others follow.
    first: usize,
    parts: u32,
    /// Tiles that are not done.
    left: u32,
}

impl Farm<'_> {
    /// Starts a tile of a frame on a node now. The first tile of a frame splits it; the rest of its tiles wait from then on.
    ///
    /// # Errors
    /// If that cannot be; nothing has happened then.
    pub fn start_tile(
        &mut self,
        node: usize,
        job: usize,
        frame: usize,
        part: u32,
        parts: u32,
    ) -> Result<(), Refusal> {
        if let Some(tile) = self.tile(job, frame, part, parts) {
            return self.start(node, job, tile);
        }
        let is_frame = matches!(self.jobs[job].truth.get(frame), Some(TrueTask { task: Task::Frame(_), .. }));
        if !is_frame || part >= parts || !(2..=self.job(job).tiles).contains(&parts) {
            return Err(Refusal::NotSplit);
        }
        self.can_start(node, job, frame)?;
        let first = self.split(job, frame, parts);
        self.start(node, job, first + part as usize)
    }

    /// Place of a tile of a frame that is split like this.
    pub(crate) fn tile(&self, job: usize, frame: usize, part: u32, parts: u32) -> Option<usize> {
        let tiles = self.jobs[job].tiles.get(&frame)?;
        (tiles.parts == parts && part < parts).then_some(tiles.first + part as usize)
    }

    /// Makes tiles of a frame that waits.
    fn split(&mut self, job: usize, frame: usize, parts: u32) -> usize {
        let asked = self.job(job);
        let entry = &mut self.jobs[job];
        let whole = entry.truth[frame];
        let first = entry.truth.len();
        for part in 0..parts {
            entry.truth.push(TrueTask {
                task: Task::Tile { frame: whole.task.frame().unwrap_or_default(), part, parts },
                median: asked.tile_work(whole.median, parts),
                work: asked.tile_work(whole.work, parts),
                class: whole.class,
            });
            entry.tasks.push(TaskState::Waiting);
            entry.waiting.insert(first + part as usize);
            entry.whole_of.insert(first + part as usize, frame);
        }
        entry.tasks[frame] = TaskState::Split;
        entry.waiting.remove(&frame);
        entry.left += parts as usize - 1;
        entry.tiles.insert(frame, Tiles { first, parts, left: parts });
        first
    }

    /// What is known once a task is done: a frame's work, once all its tiles are.
    pub(super) fn measure(&mut self, job: usize, task: usize) {
        let entry = &mut self.jobs[job];
        let whole = match entry.whole_of.get(&task) {
            None => task,
            Some(&frame) => {
                let Some(tiles) = entry.tiles.get_mut(&frame) else { return };
                tiles.left -= 1;
                if tiles.left > 0 {
                    return;
                }
                entry.tasks[frame] = TaskState::Done;
                frame
            }
        };
        if !entry.truth[whole].task.is_seed() {
            entry.measured.push(whole);
            entry.measured_work += u128::from(entry.truth[whole].work);
        }
    }
}
