//! Policies: which node renders what.

pub mod planned;
pub mod queue;

use serde::{Deserialize, Serialize};

use crate::farm::Policy;
use crate::world::World;
use planned::Planned;
use queue::{Queue, QueueRule};

/// All policies.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PolicyKind {
    /// This project's.
    Planned,
    /// The oldest job of the highest priority first.
    Fifo,
    /// The project furthest below its share first.
    FairShare,
    /// The earliest deadline first, on any idle node.
    Deadline,
    /// The earliest deadline first, on as many nodes as the cost of three frames suggests.
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

    /// Name for people.
    pub fn name(self) -> &'static str {
        match self {
            PolicyKind::Planned => "forelight",
            PolicyKind::Fifo => "priority, first come",
            PolicyKind::FairShare => "fair share",
            PolicyKind::Deadline => "EDF",
            PolicyKind::ThreeFrames => "EDF, three frames",
        }
    }

    /// The policy for a world. `every`: longest time between plans, in microseconds. `pool`: cheapest nodes
    /// that policies without plans may use, in per cent. Jobs that fit on none of them may use all.
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
