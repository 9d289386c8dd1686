//! How much slower tasks are on the nodes that hold them than where they are booked.

use std::collections::BTreeSet;
use std::collections::btree_map::{BTreeMap, Entry};

use forelight_protocol::{JobId, Node, NodeId};
use sqlx::SqliteConnection;

use crate::error::Result;
use crate::nodes;
use crate::policy::projection::Holder;
use crate::policy::work_stealing::Rates;
use crate::tasks::rates;

/// A booked task that a node holds.
pub(crate) struct HeldTask<'a> {
    /// Its job.
    pub job: JobId,
    /// The node where it is booked.
    pub booked_on: NodeId,
    /// For how many microseconds.
    pub length: i64,
    /// The node that holds it.
    pub holder: &'a mut Holder,
}

/// Sets the slowness of all holders.
pub(crate) async fn set<'a>(
    connection: &mut SqliteConnection,
    held: impl Iterator<Item = HeldTask<'a>>,
) -> Result<()> {
    let elsewhere: Vec<HeldTask<'_>> = held.filter(|task| task.booked_on != task.holder.node_id).collect();
    let nodes: BTreeSet<NodeId> =
        elsewhere.iter().flat_map(|task| [task.booked_on, task.holder.node_id]).collect();
    let nodes = nodes::by_ids(connection, nodes).await?;
    let mut jobs = BTreeMap::new();
    for HeldTask { job, booked_on, length, holder } in elsewhere {
        let of_job = match jobs.entry(job) {
            Entry::Occupied(known) => known.into_mut(),
            Entry::Vacant(unknown) => unknown.insert(rates(connection, job).await?),
        };
        if let (Some(booked), Some(own)) = (nodes.get(&booked_on), nodes.get(&holder.node_id)) {
            holder.slowness = slowness(of_job, (booked, own), length);
        }
    }
    Ok(())
}

/// How many times as long a task of the job takes on the second of these nodes as on the first, where it is
/// booked for `length` microseconds.
fn slowness(of_job: &Rates, (booked, holder): (&Node, &Node), length: i64) -> f64 {
    let speed = |node: &Node| node.speed_for(of_job.work.as_ref()) * f64::from(node.cores);
    let serial = |node: &Node| of_job.serial.on(node.cores);
    // A booking that was made before serial time was learnt has none.
    let shared = length.saturating_sub(serial(booked)).max(length / 10) as f64;
    let slowness = (shared * speed(booked) / speed(holder) + serial(holder) as f64) / length as f64;
    if slowness.is_finite() && slowness > 0.0 { slowness } else { 1.0 }
}
