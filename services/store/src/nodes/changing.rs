//! Registering nodes and changing them.

use forelight_protocol::{
    AuditAction, EventKind, Money, Node, NodeChange, NodeId, NodeRegistration, Role, Timestamp,
};

use crate::audit::{Deed, note};
use crate::columns::Json;
use crate::database::{Store, Write};
use crate::error::Result;
use crate::events::node_event;
use crate::idempotency::{Answered, IdempotencyKey, earlier_answer, record};
use crate::leases;
use crate::leases::losing::lose_tasks_of;
use crate::nodes::{LOST, by_name, has_another_worker, node_rows, read};
use crate::plans::replans;
use crate::policy::availability::{Opening, opening, silence, with_power};
use crate::policy::nodes::{cause_of, is_same_machine, may_take_tasks_again};
use crate::videos::FFMPEG;
use crate::writing::run;

impl Store {
    /// Registers a node. A node of the same name is updated and keeps its id: a restarted worker is the same
    /// node. A speed or price that was set by hand stays in force. A worker says a price only for a new node:
    /// later, only an operator changes it.
    pub async fn register_node(
        &self,
        registration: &NodeRegistration,
        key: Option<&IdempotencyKey>,
        now: Timestamp,
    ) -> Result<Answered<Node>> {
        let mut write = self.write().await?;
        if let Some(answer) = earlier_answer(&mut write, key).await? {
            return Ok(Answered::Repeated(answer));
        }
        let node = upsert(&mut write, registration, now).await?;
        record(&mut write, key, 201, &node, now);
        self.commit(write).await?;
        Ok(Answered::Fresh(node))
    }

    /// Changes a node. A speed or price that is set here stays in force until it is set again or cleared with
    /// `None` inside `Some`. Then the node's own last value applies.
    pub async fn change_node(&self, node: NodeId, change: &NodeChange, now: Timestamp) -> Result<Node> {
        let mut write = self.write().await?;
        run!(
            write,
            "UPDATE nodes SET drain = coalesce(?1, drain), pause = coalesce(?2, pause), speed_set = \
             CASE WHEN ?3 THEN ?4 ELSE speed_set END, price_set = CASE WHEN ?5 THEN ?6 ELSE price_set \
             END, set_aside = CASE ?7 WHEN 1 THEN coalesce(set_aside, 'by hand') WHEN 0 THEN NULL ELSE \
             set_aside END, trusted_since = CASE ?7 WHEN 0 THEN ?8 ELSE trusted_since END, schedule_set \
             = CASE WHEN ?10 THEN ?11 ELSE schedule_set END, terms = coalesce(?12, terms) WHERE id = ?9",
            change.drain,
            change.pause,
            change.speed.is_some(),
            change.speed.flatten(),
            change.price_per_hour.is_some(),
            change.price_per_hour.flatten().map(Money::micro_units),
            change.set_aside,
            now.micros(),
            node.0,
            change.schedule.is_some(),
            change.schedule.as_ref().and_then(Option::as_ref).map(Json),
            change.terms.as_ref().map(Json)
        );
        if change.cancel_task == Some(true) {
            take_tasks_away(&mut write, node, now).await?;
        }
        let changed = read(write.connection().await?, node).await?;
        node_event(&mut write, EventKind::NodeChanged, &changed, changed.name.clone(), now);
        note(&mut write, Deed::new(AuditAction::NodeChanged, node), Some(change), now);
        // Waiting claims should look again.
        write.made_work |= may_take_tasks_again(change);
        if let Some(cause) = cause_of(change) {
            replans::want(&mut write, &format!("node {} {cause}", changed.name)).await?;
        }
        self.commit(write).await?;
        Ok(changed)
    }
}

/// Makes a node, or updates the one of the same name. Calls for a new plan if the node is new or has changed.
pub(crate) async fn upsert(
    write: &mut Write,
    registration: &NodeRegistration,
    now: Timestamp,
) -> Result<Node> {
    let before = by_name(write.connection().await?, &registration.name).await?;
    let is_replaced = match (&before, registration.worker) {
        (Some(before), Some(worker)) => {
            has_another_worker(write.connection().await?, before.id, worker).await?
        }
        _ => false,
    };
    let may_price = write.actor().is_none_or(|actor| actor.role == Role::Operator);
    let capabilities = &registration.capabilities;
    let ffmpeg = capabilities.ffmpeg.as_ref().map(|_| FFMPEG.to_owned());
    let renderers: Vec<String> = capabilities.answers().into_iter().chain(ffmpeg).collect();
    let node_id: NodeId = sqlx::query_scalar!(
        "INSERT INTO nodes (id, name, speed, price_per_hour, cores, created_at, last_seen_at, \
         capabilities, schedule, worker, renderers) VALUES (?, ?, ?, ?, ?, ?6, ?6, ?7, ?8, ?9, ?10) ON CONFLICT (name) \
         DO UPDATE SET speed = excluded.speed, price_per_hour = \
         CASE WHEN ?11 OR removed_at IS NOT NULL THEN excluded.price_per_hour ELSE price_per_hour END, cores = \
         excluded.cores, last_seen_at = excluded.last_seen_at, capabilities = excluded.capabilities, \
         schedule = excluded.schedule, worker = coalesce(excluded.worker, worker), paused = 0, \
         renderers = excluded.renderers, removed_at = NULL \
         RETURNING id",
        NodeId::new().0,
        registration.name,
        registration.speed,
        registration.price_per_hour.0,
        registration.cores,
        now.micros(),
        Json(&registration.capabilities),
        registration.schedule.as_ref().map(Json),
        registration.worker,
        Json(&renderers),
        may_price
    )
    .fetch_one(write.connection().await?)
    .await?
    .into();
    if is_replaced {
        // The previous worker is dead, or will be told to stop.
        lose_tasks_of(write, node_id, now).await?;
    }
    let node = read(write.connection().await?, node_id).await?;
    match before {
        None => replans::want(write, &format!("node {} joined", node.name)).await?,
        Some(before) if !is_same_machine(&before, &node) || silence(&before, now) > LOST => {
            replans::want(write, &format!("node {} came back", node.name)).await?;
        }
        Some(_) => {}
    }
    node_event(write, EventKind::NodeRegistered, &node, node.name.clone(), now);
    Ok(with_power(node, now))
}

/// Takes a node's tasks away. They are ready again, and the node's next renewal brings the order to stop.
pub(crate) async fn take_tasks_away(write: &mut Write, node: NodeId, now: Timestamp) -> Result<()> {
    let held = leases::active_leases_of(write, node).await?;
    leases::take_back(write, held, now).await
}

/// Takes the tasks from nodes whose window has ended, if their terms say so. Returns how many nodes.
pub(crate) async fn stop_after_windows(write: &mut Write, now: Timestamp) -> Result<u32> {
    let rows = node_rows!(
        "WHERE n.terms ->> 'window_end' = 'stop' \
         AND EXISTS (SELECT 1 FROM leases l WHERE l.node_id = n.id AND l.state = 'active') ORDER BY n.id"
    )
    .fetch_all(write.connection().await?)
    .await?;
    let mut stopped = 0;
    for row in rows {
        let node = Node::from(row);
        if matches!(opening(&node, now), Opening::Asleep(_)) {
            take_tasks_away(write, node.id, now).await?;
            stopped += 1;
        }
    }
    Ok(stopped)
}
