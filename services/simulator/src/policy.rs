//! Who renders what.

pub mod planned;
pub mod queue;

use serde::{Deserialize, Serialize};

use crate::farm::Farm;
use crate::world::World;
use planned::Planned;
use queue::{Queue, QueueRule};

/// Decides what a farm does. It is told of every instant at which something happens.
pub trait Policy {
    /// A job came in: is its deadline promised?
    fn arrived(&mut self, farm: &mut Farm, job: usize) -> bool;

    /// Starts what should start now ([`Farm::start`]). Returns when it wants to be asked again at the latest, if nothing
    /// happens before.
    fn act(&mut self, farm: &mut Farm) -> Option<i64>;

    /// Whether the frames of a job, by its place, share a cache that is filled before them. Otherwise each fills one of its own, as they do where
    /// nobody knows beforehand what it holds. What is no cache always comes first.
    fn shares_cache(&self, world: &World, job: usize) -> bool {
        let _ = job;
        world.chances.own_cache == 0.0
    }

    /// How many plans it made.
    fn plans(&self) -> u64 {
        0
    }
}

/// The policies that there are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PolicyKind {
    /// This project's.
    Planned,
    /// The oldest job of the highest priority first.
    Fifo,
    /// The project that has least of its share first.
    FairShare,
    /// The earliest deadline first, on whatever is free.
    Deadline,
    /// The earliest deadline first, on as many nodes as three frames' cost says that it needs.
    ThreeFrames,
}

impl PolicyKind {
    /// All of them.
    pub const ALL: [PolicyKind; 5] = [
        PolicyKind::Planned,
        PolicyKind::Deadline,
        PolicyKind::ThreeFrames,
        PolicyKind::FairShare,
        PolicyKind::Fifo,
    ];

    /// For people.
    pub fn name(self) -> &'static str {
        match self {
            PolicyKind::Planned => "forelight",
            PolicyKind::Fifo => "priority, first come",
            PolicyKind::FairShare => "fair share",
            PolicyKind::Deadline => "EDF",
            PolicyKind::ThreeFrames => "EDF, three frames",
        }
    }

    /// The policy for a world. `every`: microseconds between two plans at most. `pool`: per cent of the nodes, the cheapest first, that
    /// policies without plans may use; jobs that fit on none of them may use all.
    pub fn policy(self, world: &World, every: i64, pool: u32) -> Box<dyn Policy> {
        let queue = |rule| -> Box<dyn Policy> { Box::new(Queue::new(world, rule, pool)) };
        match self {
            PolicyKind::Planned => Box::new(Planned::new(world, every)),
            PolicyKind::Fifo => queue(QueueRule::Fifo),
            PolicyKind::FairShare => queue(QueueRule::FairShare),
            PolicyKind::Deadline => queue(QueueRule::Deadline),
            PolicyKind::ThreeFrames => queue(QueueRule::ThreeFrames),
        }
    }
}
