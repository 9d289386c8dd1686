//! Effects of events.

use std::cmp::Reverse;

use super::{Event, Farm, TaskState};
use crate::record::Outcome;

impl Farm<'_> {
    /// Applies an event. Returns the job if one came in.
    pub(super) fn happens(&mut self, event: Event) -> Option<usize> {
        match event {
            Event::Finish { node, attempt } => self.finished(node, attempt),
            Event::Fail { node, count } => {
                self.record.failures += 1;
                let back = self.now.saturating_add(self.world.repair(node, count));
                self.events.push(Reverse((back, Event::Repair { node, count })));
                self.nodes[node].up = false;
                self.idle.remove(&(self.nodes[node].rank, node));
                if let Some(attempt) = self.nodes[node].running {
                    self.ends(node, attempt, Outcome::Lost);
                    let expiry = self.now.saturating_add(self.world.lease());
                    self.events.push(Reverse((expiry, Event::Expire { attempt })));
                }
                self.close_rental(node);
            }
            Event::Expire { attempt } => self.give_back(attempt),
            Event::Close { node } => {
                self.nodes[node].until = None;
                self.idle.remove(&(self.nodes[node].rank, node));
                if let Some(attempt) = self.nodes[node].running {
                    self.ends(node, attempt, Outcome::Evicted);
                    self.give_back(attempt);
                }
                self.close_rental(node);
            }
            Event::Repair { node, count } => {
                self.nodes[node].up = true;
                self.idle_again(node);
                if let Some(after) = self.world.until_failure(node, count + 1) {
                    let at = self.now.saturating_add(after);
                    self.events.push(Reverse((at, Event::Fail { node, count: count + 1 })));
                }
            }
            Event::Open { node, window } => {
                let windows = &self.world.windows[node];
                let end = windows[window].end;
                self.nodes[node].until = Some(end.unwrap_or(i64::MAX));
                if let Some(end) = end {
                    self.events.push(Reverse((end, Event::Close { node })));
                }
                if let Some(next) = windows.get(window + 1) {
                    self.events.push(Reverse((next.start, Event::Open { node, window: window + 1 })));
                }
                self.idle_again(node);
            }
            Event::Paid { node } => self.stop_paying(node),
            Event::Withdraw { job } => self.withdrawn(job),
            Event::Arrive { job } => {
                let entry = &mut self.jobs[job];
                if !entry.withdrawn {
                    entry.arrived = true;
                    if entry.left == 0 {
                        self.over += 1;
                        self.record.jobs[job].finish = Some(self.now);
                    } else {
                        self.open.insert(job);
                        return Some(job);
                    }
                }
            }
            Event::Wake => {}
        }
        None
    }

    fn finished(&mut self, node: usize, attempt: usize) {
        // Otherwise the worker was lost, evicted or stopped before.
        if self.nodes[node].running != Some(attempt) {
            return;
        }
        self.ends(node, attempt, Outcome::Done);
        self.let_go(attempt);
        let (job, task) = self.places[attempt];
        let entry = &mut self.jobs[job];
        entry.tasks[task] = TaskState::Done;
        entry.left -= 1;
        entry.measure(task);
        if entry.left == 0 {
            self.over += 1;
            self.open.remove(&job);
            self.record.jobs[job].finish = Some(self.now);
            self.record.end = self.now;
        }
        self.idle_again(node);
    }

    fn withdrawn(&mut self, job: usize) {
        if self.jobs[job].withdrawn || (self.jobs[job].arrived && self.jobs[job].left == 0) {
            return;
        }
        self.over += 1;
        self.jobs[job].withdrawn = true;
        self.record.jobs[job].withdrawn = Some(self.now);
        self.record.end = self.now;
        self.open.remove(&job);
        let running: Vec<(usize, usize)> = (0..self.nodes.len())
            .filter_map(|node| Some((node, self.nodes[node].running?)))
            .filter(|&(_, attempt)| self.places[attempt].0 == job)
            .collect();
        for (node, attempt) in running {
            self.ends(node, attempt, Outcome::Withdrawn);
            self.idle_again(node);
        }
        // Leases of dead workers end with the job.
        for task in 0..self.jobs[job].tasks.len() {
            if let TaskState::Held(attempt) = self.jobs[job].tasks[task] {
                self.let_go(attempt);
            }
        }
        self.jobs[job].waiting.clear();
    }

    /// Ends the attempt and leaves the node without a task.
    pub(super) fn ends(&mut self, node: usize, attempt: usize, outcome: Outcome) {
        let entry = &mut self.record.attempts[attempt];
        // It may have ended during its set-up.
        entry.start = entry.start.min(self.now);
        entry.end = self.now;
        entry.outcome = outcome;
        self.nodes[node].running = None;
        self.nodes[node].worked_until = self.now;
        self.freed.push(node);
    }

    /// Releases the lease.
    fn let_go(&mut self, attempt: usize) {
        let (job, task) = self.places[attempt];
        let speed = self.speed_of(attempt, task);
        let entry = &mut self.jobs[job];
        entry.running -= 1;
        entry.running_speed = entry.running_speed.saturating_sub(speed);
    }

    fn speed_of(&self, attempt: usize, task: usize) -> u64 {
        let (job, id) = (self.places[attempt].0, self.record.attempts[attempt].node);
        let nodes = &self.world.input.nodes;
        let node = nodes.binary_search_by_key(&id, |node| node.id).ok();
        node.map_or(0, |node| nodes[node].speed_of(self.jobs[job].truth[task].class))
    }

    fn give_back(&mut self, attempt: usize) {
        let (job, task) = self.places[attempt];
        if self.jobs[job].withdrawn || self.jobs[job].tasks[task] != TaskState::Held(attempt) {
            return;
        }
        self.let_go(attempt);
        self.jobs[job].tasks[task] = TaskState::Waiting;
        self.jobs[job].waiting.insert(task);
        self.given_back.push(job);
    }

    fn idle_again(&mut self, node: usize) {
        let state = &self.nodes[node];
        if state.up && state.until.is_some() && state.running.is_none() {
            self.idle.insert((state.rank, node));
        }
    }
}
