//! Removing nodes.
//!
//! Leases, bookings and the ledger refer to a node for good, so its row stays, with the instant of its
//! removal. It is in no list and gets no tasks, and its own tokens are gone. A machine that registers under
//! its name, with a token that may, brings it back under its old id, and without what operators had set.

use forelight_protocol::{AuditAction, EventKind, NodeId, Timestamp};

use crate::audit::{Deed, note};
use crate::database::Store;
use crate::error::{Result, StoreError};
use crate::events::node_event;
use crate::nodes::changing::take_tasks_away;
use crate::nodes::read;
use crate::plans::replans;
use crate::writing::run;

impl Store {
    /// Removes a node with its tokens, and calls for a new plan. A node that holds a task is a
    /// [`StoreError::Conflict`], unless its tasks may be taken away. They are ready again then.
    pub async fn remove_node(&self, node: NodeId, cancel_task: bool, now: Timestamp) -> Result<()> {
        let mut write = self.write().await?;
        let found = read(write.connection().await?, node).await?;
        if let Some(task) = found.task_id.filter(|_| !cancel_task) {
            return Err(StoreError::Conflict(format!(
                "the node {:?} holds task {task}; drain it first, or remove it with its tasks",
                found.name
            )));
        }
        take_tasks_away(&mut write, node, now).await?;
        run!(write, "DELETE FROM tokens WHERE node_id = ?", node.0);
        run!(
            write,
            "UPDATE nodes SET removed_at = ?, idle_reason = NULL, drain = 0, pause = 0, set_aside = NULL, \
             speed_set = NULL, price_set = NULL, schedule_set = NULL, terms = '{}' WHERE id = ?",
            now.micros(),
            node.0
        );
        node_event(&mut write, EventKind::NodeRemoved, &found, found.name.clone(), now);
        replans::want(&mut write, &format!("node {} was removed", found.name)).await?;
        let detail = serde_json::json!({"name": found.name, "task": found.task_id});
        note(&mut write, Deed::new(AuditAction::NodeRemoved, node), Some(&detail), now);
        // Its waiting claims look again, and learn that it is gone.
        write.made_work = true;
        self.commit(write).await
    }
}
