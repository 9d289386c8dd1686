//! Events in time order, and the rules that no policy can break.

mod events;
mod parts;
mod rentals;

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet, BinaryHeap};

use forelight_planner::{Job, Node};

use crate::record::{Attempt, JobRecord, Outcome, Record};
use crate::world::{TrueTask, World};
use parts::Divided;

/// An event. Events at the same instant happen in this order: a frame that ends as its window closes is done.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Event {
    Finish { node: usize, attempt: usize },
    Fail { node: usize, count: u64 },
    Expire { attempt: usize },
    Close { node: usize },
    Repair { node: usize, count: u64 },
    Open { node: usize, window: usize },
    Paid { node: usize },
    Withdraw { job: usize },
    Arrive { job: usize },
    Wake,
}

/// Decides what a farm does. It is called at every instant at which something happens.
pub trait Policy {
    /// A job came in. Returns whether its deadline is promised.
    fn arrived(&mut self, farm: &mut Farm, job: usize) -> bool;

    /// Starts tasks ([`Farm::start`]). Returns the latest time of the next call, if nothing happens before.
    fn act(&mut self, farm: &mut Farm) -> Option<i64>;

    /// Whether a job's frames use a shared cache, rather than their own, where they have the choice.
    fn shares_cache(&self, world: &World, job: usize) -> bool {
        let _ = job;
        world.chances.own_cache == 0.0
    }

    /// Number of plans made.
    fn plans(&self) -> u64 {
        0
    }
}

/// Why a task cannot start on a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum Refusal {
    /// The node is down, outside its window, or busy.
    #[error("the node is not idle")]
    NotIdle,
    /// The task is done, leased or withdrawn, or its job has not come in.
    #[error("the task is not waiting")]
    NotWaiting,
    /// The job's shared cache is not filled.
    #[error("the job's shared cache is not filled")]
    NoSharedCache,
    /// The node cannot do work of this class.
    #[error("the node cannot do this class of work")]
    Unfit,
    /// It is no frame, or the frame may not have this number of parts.
    #[error("the frame may not be divided like this")]
    NotDivisible,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum TaskState {
    Waiting,
    /// Leased under this token. The worker may be dead.
    Held(usize),
    /// Its parts are tasks of their own.
    Divided,
    Done,
}

#[derive(Clone, Copy, Debug)]
struct OpenRental {
    start: i64,
    setup: bool,
}

#[derive(Clone, Debug)]
struct NodeState {
    up: bool,
    /// End of the open window. `None` while closed.
    until: Option<i64>,
    running: Option<usize>,
    rental: Option<OpenRental>,
    /// End of the last attempt in the rental.
    worked_until: i64,
    /// Rank by price of work.
    rank: usize,
}

#[derive(Clone, Debug)]
pub(crate) struct JobState {
    pub arrived: bool,
    pub withdrawn: bool,
    /// Its tasks: the shared cache's first, then frames, then parts of frames that were divided.
    pub truth: Vec<TrueTask>,
    pub tasks: Vec<TaskState>,
    /// By index of a frame that was divided.
    pub divided: BTreeMap<usize, Divided>,
    /// By index of a part: the index of its frame.
    pub whole_of: BTreeMap<usize, usize>,
    pub left: usize,
    /// Indices of waiting tasks. `left` counts the tasks that are not done.
    pub waiting: BTreeSet<usize>,
    /// Indices of finished frames, whose true work is known to everyone.
    pub measured: Vec<usize>,
    pub measured_work: u128,
    /// Number of leased tasks.
    pub running: usize,
    /// Work per second of the nodes that hold them.
    pub running_speed: u64,
}

/// A farm at an instant, as a policy sees it.
pub struct Farm<'w> {
    pub(crate) world: &'w World,
    now: i64,
    nodes: Vec<NodeState>,
    pub(crate) jobs: Vec<JobState>,
    /// Open, up and without a task, cheapest first.
    idle: BTreeSet<(usize, usize)>,
    /// Jobs that came in and are neither done nor withdrawn.
    open: BTreeSet<usize>,
    /// Indices of job and task of every attempt.
    places: Vec<(usize, usize)>,
    events: BinaryHeap<Reverse<(i64, Event)>>,
    /// Nodes that lost their task at this instant.
    freed: Vec<usize>,
    /// Jobs with a task that was requeued at this instant.
    pub(crate) given_back: Vec<usize>,
    /// Number of jobs that are done or withdrawn.
    over: usize,
    record: Record,
}

/// Runs a world under a policy until every job is done or withdrawn, or the world ends. `progress` receives
/// the number of jobs that are over, and of all.
pub fn run(world: &World, policy: &mut dyn Policy, mut progress: impl FnMut(u64, u64)) -> Record {
    let mut farm = Farm::new(world, policy);
    let all = farm.jobs.len();
    let mut told = 0;
    let mut woken = None;
    progress(0, all as u64);
    while let Some(&Reverse((at, _))) = farm.events.peek() {
        if farm.over == all || at > world.horizon {
            break;
        }
        farm.now = at;
        let mut arrived = Vec::new();
        while let Some(&Reverse((next, event))) = farm.events.peek()
            && next == at
        {
            farm.events.pop();
            if let Some(job) = farm.happens(event) {
                arrived.push(job);
            }
        }
        for job in arrived {
            farm.record.jobs[job].promised = policy.arrived(&mut farm, job);
        }
        let wake = policy.act(&mut farm);
        if let Some(wake) =
            wake.filter(|&wake| wake > at && woken.is_none_or(|known| wake < known || known <= at))
        {
            farm.events.push(Reverse((wake, Event::Wake)));
            woken = Some(wake);
        }
        farm.settle();
        farm.given_back.clear();
        if farm.over != told {
            told = farm.over;
            progress(told as u64, all as u64);
        }
    }
    farm.finish()
}

impl<'w> Farm<'w> {
    fn new(world: &'w World, policy: &dyn Policy) -> Self {
        let input = &world.input;
        let mut by_price: Vec<usize> = (0..input.nodes.len()).collect();
        by_price.sort_by_key(|&node| (price_of_work(&input.nodes[node]), node));
        let mut rank = vec![0; by_price.len()];
        by_price.iter().enumerate().for_each(|(place, &node)| rank[node] = place);
        let mut events = BinaryHeap::new();
        for (node, windows) in world.windows.iter().enumerate() {
            if let Some(first) = windows.first() {
                events.push(Reverse((first.start, Event::Open { node, window: 0 })));
            }
            if let Some(after) = world.until_failure(node, 0) {
                events.push(Reverse((input.now.saturating_add(after), Event::Fail { node, count: 0 })));
            }
        }
        for (index, job) in input.jobs.iter().enumerate() {
            events.push(Reverse((job.release, Event::Arrive { job: index })));
            if let Some(at) = world.withdrawn[index] {
                events.push(Reverse((at, Event::Withdraw { job: index })));
            }
        }
        let truths = (0..input.jobs.len()).map(|job| world.truth(job, policy.shares_cache(world, job)));
        let jobs = truths.map(|truth| JobState {
            arrived: false,
            withdrawn: false,
            tasks: vec![TaskState::Waiting; truth.len()],
            left: truth.len(),
            waiting: (0..truth.len()).collect(),
            truth,
            divided: BTreeMap::new(),
            whole_of: BTreeMap::new(),
            measured: Vec::new(),
            measured_work: 0,
            running: 0,
            running_speed: 0,
        });
        let records = input.jobs.iter().map(|job| JobRecord {
            job: job.id,
            promised: false,
            finish: None,
            withdrawn: None,
        });
        let mut farm = Farm {
            world,
            now: input.now,
            nodes: rank
                .into_iter()
                .map(|rank| NodeState {
                    up: true,
                    until: None,
                    running: None,
                    rental: None,
                    worked_until: i64::MIN,
                    rank,
                })
                .collect(),
            jobs: jobs.collect(),
            idle: BTreeSet::new(),
            open: BTreeSet::new(),
            places: Vec::new(),
            events,
            freed: Vec::new(),
            given_back: Vec::new(),
            over: 0,
            record: Record { jobs: records.collect(), end: input.now, ..Record::default() },
        };
        farm.divide_all();
        farm
    }

    /// Divides all frames that must have parts.
    fn divide_all(&mut self) {
        for job in 0..self.jobs.len() {
            for frame in 0..self.jobs[job].truth.len() {
                match self.jobs[job].truth[frame].division.fewest() {
                    1 => {}
                    parts => {
                        self.divide(job, frame, parts);
                    }
                }
            }
        }
    }

    /// The current instant.
    pub fn now(&self) -> i64 {
        self.now
    }

    /// A job's description.
    pub fn job(&self, job: usize) -> &'w Job {
        &self.world.input.jobs[job]
    }

    /// A node's description.
    pub fn node(&self, node: usize) -> &'w Node {
        &self.world.input.nodes[node]
    }

    /// Nodes that could start a task now, cheapest work first, as indices into the nodes by id.
    pub fn idle(&self) -> impl Iterator<Item = usize> + '_ {
        self.idle.iter().map(|&(_, node)| node)
    }

    /// Jobs that came in and are not over, as indices into the jobs by id.
    pub fn open(&self) -> impl Iterator<Item = usize> + '_ {
        self.open.iter().copied()
    }

    pub(crate) fn is_up(&self, node: usize) -> bool {
        self.nodes[node].up
    }

    pub(crate) fn is_idle(&self, node: usize) -> bool {
        self.idle.contains(&(self.nodes[node].rank, node))
    }

    pub(crate) fn rank(&self, node: usize) -> usize {
        self.nodes[node].rank
    }

    /// End of the open window, or the end of time if it has none.
    pub(crate) fn open_until(&self, node: usize) -> Option<i64> {
        self.nodes[node].until
    }

    /// Whether the node is rented, so that a task needs no set-up.
    pub(crate) fn is_warm(&self, node: usize) -> bool {
        self.nodes[node].rental.is_some()
    }

    /// Indices of the job and task that the node works on, and its start.
    pub(crate) fn running(&self, node: usize) -> Option<(usize, usize, i64)> {
        let attempt = self.nodes[node].running?;
        let (job, task) = self.places[attempt];
        Some((job, task, self.record.attempts[attempt].start))
    }

    /// Whether the shared cache is filled, or there is none.
    pub(crate) fn has_shared_cache(&self, job: usize) -> bool {
        let entry = &self.jobs[job];
        entry
            .truth
            .iter()
            .zip(&entry.tasks)
            .take_while(|(truth, _)| truth.task.is_shared_cache())
            .all(|(_, &state)| state == TaskState::Done)
    }

    /// The attempt with this fencing token.
    pub(crate) fn attempt(&self, token: usize) -> &Attempt {
        &self.record.attempts[token]
    }

    /// Starts a task on a node now.
    ///
    /// # Errors
    /// If the task cannot start. Nothing has changed then.
    pub fn start(&mut self, node: usize, job: usize, task: usize) -> Result<(), Refusal> {
        self.can_start(node, job, task)?;
        let (world, now) = (self.world, self.now);
        let machine = &world.input.nodes[node];
        let truth = self.jobs[job].truth[task];
        let length = machine.duration(truth.work, truth.class).unwrap_or(i64::MAX);
        let state = &mut self.nodes[node];
        let needs_setup = machine.setup > 0 || machine.setup_cost > 0;
        let ready = match state.rental {
            Some(_) => now,
            None => {
                state.rental = Some(OpenRental { start: now, setup: needs_setup });
                now.saturating_add(machine.setup)
            }
        };
        let attempt = self.record.attempts.len();
        state.running = Some(attempt);
        self.idle.remove(&(state.rank, node));
        self.record.attempts.push(Attempt {
            node: machine.id,
            job: world.input.jobs[job].id,
            task: truth.task,
            start: ready,
            end: i64::MAX,
            outcome: Outcome::Running,
        });
        self.places.push((job, task));
        let entry = &mut self.jobs[job];
        entry.tasks[task] = TaskState::Held(attempt);
        entry.waiting.remove(&task);
        entry.running += 1;
        entry.running_speed = entry.running_speed.saturating_add(machine.speed_of(truth.class));
        self.events.push(Reverse((ready.saturating_add(length), Event::Finish { node, attempt })));
        Ok(())
    }

    /// Whether a task could start on a node now.
    ///
    /// # Errors
    /// The reason why not.
    pub fn can_start(&self, node: usize, job: usize, task: usize) -> Result<(), Refusal> {
        let machine = self.node(node);
        let entry = &self.jobs[job];
        if !self.is_idle(node) {
            return Err(Refusal::NotIdle);
        }
        if !entry.arrived || entry.withdrawn || entry.tasks.get(task) != Some(&TaskState::Waiting) {
            return Err(Refusal::NotWaiting);
        }
        let truth = &entry.truth[task];
        if !truth.task.is_shared_cache() && !self.has_shared_cache(job) {
            return Err(Refusal::NoSharedCache);
        }
        if machine.speed_of(truth.class) == 0 {
            return Err(Refusal::Unfit);
        }
        Ok(())
    }

    /// Stops all work.
    fn finish(mut self) -> Record {
        for node in 0..self.nodes.len() {
            if let Some(attempt) = self.nodes[node].running {
                self.ends(node, attempt, Outcome::Running);
            }
            self.close_rental(node);
        }
        if self.record.jobs.iter().any(|job| job.finish.is_none() && job.withdrawn.is_none()) {
            self.record.end = self.now;
        }
        self.record
    }
}

/// Price of work on a node at its greatest speed, for comparison: micro-units per 10¹⁸ units of work.
pub(crate) fn price_of_work(node: &Node) -> i128 {
    let speed = node.speeds.values().copied().fold(node.speed, u64::max).max(1);
    i128::from(node.price_per_hour) * 1_000_000_000_000_000_000 / i128::from(speed)
}
