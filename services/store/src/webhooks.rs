//! Webhooks, and what they are told: an outbox.
//!
//! The hazard: an event is lost because the service dies before it was sent. So events are looked through in
//! their order, and what is to be sent is stored before the place moves on. An event is stored once for each
//! webhook, whatever is repeated. It is sent until the receiver answers, so it may arrive twice, with the
//! same id.

use forelight_protocol::{
    AuditAction, Delivery, DeliveryId, DeliveryState, Event, EventId, JobId, Timestamp, Webhook, WebhookId,
    WebhookKind, WebhookRequest,
};

use crate::audit::{Deed, note, note_only};
use crate::columns::{Id, Json, Time, Word};
use crate::database::{Store, Write};
use crate::error::{Result, StoreError};
use crate::events::{event_rows, last_id};
use crate::writing::run;

/// How long ended deliveries are listed: thirty days, in microseconds.
const KEPT: i64 = 30 * 86_400_000_000;

/// Most events that are looked at together.
const BATCH: i64 = 500;

/// A webhook with its secret.
#[derive(Clone, PartialEq, Debug)]
pub struct Receiver {
    /// The webhook.
    pub webhook: Webhook,
    /// The secret that signs what is sent.
    pub secret: String,
    /// The last event that was looked at for it.
    pub seen: EventId,
}

/// A delivery to be stored.
#[derive(Clone, PartialEq, Debug)]
pub struct NewDelivery {
    /// The event; `None` for a test.
    pub event: Option<EventId>,
    /// The job. Deliveries of one job are sent in order.
    pub job: Option<JobId>,
    /// What it is about.
    pub kind: WebhookKind,
    /// The body.
    pub body: String,
}

/// A delivery that is due.
#[derive(Clone, PartialEq, Debug)]
pub struct DueDelivery {
    /// Its id.
    pub id: DeliveryId,
    /// The webhook.
    pub webhook: WebhookId,
    /// The job, see [`NewDelivery::job`].
    pub job: Option<JobId>,
    /// Address of the receiver.
    pub url: String,
    /// The secret that signs it.
    pub secret: String,
    /// The body.
    pub body: String,
    /// Attempts so far.
    pub attempts: u32,
    /// When it was stored.
    pub created_at: Timestamp,
}

/// The outcome of an attempt.
#[derive(Clone, PartialEq, Debug)]
pub struct Attempt {
    /// HTTP status, if there was an answer.
    pub status: Option<u16>,
    /// Why it failed; `None` if it was delivered.
    pub error: Option<String>,
    /// When to try again after a failure; `None` to give up.
    pub again_at: Option<Timestamp>,
}

impl Store {
    /// Adds a webhook, which is told of events from now on.
    pub async fn add_webhook(
        &self,
        request: &WebhookRequest,
        kinds: &[WebhookKind],
        secret: &str,
        now: Timestamp,
    ) -> Result<Webhook> {
        let id = WebhookId::new();
        let mut write = self.write().await?;
        let seen = last_id(write.connection().await?).await?;
        run!(
            write,
            "INSERT INTO webhooks (id, url, secret, kinds, project, template, seen, created_at) \
             VALUES (?, ?, ?, ?, ?, ?, ?, ?)",
            id.0,
            request.url,
            secret,
            Json(kinds),
            request.project,
            request.template.as_ref().map(Json),
            seen,
            now.micros()
        );
        // An address may hold a secret of its receiver.
        let detail = serde_json::json!({"kinds": kinds, "project": request.project});
        note(&mut write, Deed::new(AuditAction::WebhookAdded, id), Some(&detail), now);
        self.commit(write).await?;
        let added = self.receivers().await?.into_iter().find(|receiver| receiver.webhook.id == id);
        Ok(added.ok_or(StoreError::NotFound("webhook"))?.webhook)
    }

    /// All webhooks, oldest first.
    pub async fn receivers(&self) -> Result<Vec<Receiver>> {
        let rows = sqlx::query!(
            r#"SELECT w.id, w.url, w.secret, w.kinds, w.project, w.template, w.seen, w.created_at,
                      (SELECT count(*) FROM deliveries d WHERE d.webhook_id = w.id AND d.state = 'pending')
                      AS "pending!: u64" FROM webhooks w ORDER BY w.id"#
        )
        .fetch_all(self.readers())
        .await?;
        let receiver = rows.into_iter().map(|row| Receiver {
            webhook: Webhook {
                id: row.id.into(),
                url: row.url,
                kinds: row.kinds.0,
                project: row.project,
                template: row.template.map(|it| it.0),
                secret: None,
                pending: row.pending,
                created_at: row.created_at.into(),
            },
            secret: row.secret,
            seen: row.seen,
        });
        Ok(receiver.collect())
    }

    /// Removes a webhook and its deliveries.
    pub async fn remove_webhook(&self, webhook: WebhookId, now: Timestamp) -> Result<()> {
        let mut write = self.write().await?;
        if run!(write, "DELETE FROM webhooks WHERE id = ?", webhook.0) == 0 {
            return Err(StoreError::NotFound("webhook"));
        }
        note_only(&mut write, Deed::new(AuditAction::WebhookRemoved, webhook), now);
        self.commit(write).await
    }

    /// The events after `seen` that webhooks may be told of, and the last event that was looked at.
    pub async fn events_for_webhooks(&self, seen: EventId) -> Result<(Vec<Event>, EventId)> {
        let mut transaction = self.read().await?;
        let last = last_id(&mut transaction).await?;
        let rows = event_rows!(
            "WHERE e.id > ?1 AND e.id <= ?2 AND e.kind IN ('job_promise_at_risk', 'job_promise_safe', \
             'job_state', 'budget', 'node_set_aside') ORDER BY e.id LIMIT ?3",
            seen,
            last,
            BATCH
        )
        .fetch_all(&mut *transaction)
        .await?;
        let is_whole = (rows.len() as i64) < BATCH;
        let events: Vec<Event> = rows.into_iter().map(Event::from).collect();
        let looked_at = events.last().map(|event| event.id).filter(|_| !is_whole).unwrap_or(last);
        Ok((events, looked_at))
    }

    /// Stores deliveries, and that events up to `seen` were looked at. An event that was stored before is
    /// left out.
    pub async fn add_deliveries(
        &self,
        webhook: WebhookId,
        deliveries: &[NewDelivery],
        seen: Option<EventId>,
        now: Timestamp,
    ) -> Result<()> {
        let mut write = self.write().await?;
        let exists = sqlx::query_scalar!(
            r#"SELECT EXISTS (SELECT 1 FROM webhooks WHERE id = ?) AS "exists!: bool""#,
            webhook.0
        );
        if !exists.fetch_one(write.connection().await?).await? {
            return Err(StoreError::NotFound("webhook"));
        }
        for delivery in deliveries {
            run!(
                write,
                "INSERT INTO deliveries (id, webhook_id, event_id, job_id, kind, body, state, next_at, created_at) \
                 VALUES (?1, ?2, ?3, ?4, ?5, ?6, 'pending', ?7, ?7) ON CONFLICT DO NOTHING",
                DeliveryId::new().0,
                webhook.0,
                delivery.event.unwrap_or(0),
                delivery.job.map(|job| job.0),
                delivery.kind.name(),
                delivery.body,
                now.micros()
            );
        }
        if let Some(seen) = seen {
            run!(write, "UPDATE webhooks SET seen = max(seen, ?) WHERE id = ?", seen, webhook.0);
        }
        self.commit(write).await
    }

    /// The deliveries that are due, the first of each job and webhook, and when the next one is. A webhook has at most
    /// fifty of them, so that one whose receiver is away holds up no other.
    pub async fn due_deliveries(&self, now: Timestamp) -> Result<(Vec<DueDelivery>, Option<Timestamp>)> {
        let rows = sqlx::query!(
            r#"SELECT d.id, d.webhook_id, d.job_id AS "job_id?: Id", d.body, d.attempts AS "attempts: u32", d.next_at,
                      d.created_at, w.url, w.secret FROM deliveries d JOIN webhooks w ON w.id = d.webhook_id
               WHERE d.id IN (SELECT id FROM (SELECT f.id, row_number() OVER (PARTITION BY f.webhook_id ORDER BY f.next_at, f.id) AS place
                     FROM deliveries f WHERE f.state = 'pending' AND NOT EXISTS (SELECT 1 FROM deliveries e INDEXED BY deliveries_pending
                           WHERE e.state = 'pending' AND e.webhook_id = f.webhook_id AND e.job_id IS f.job_id AND e.id < f.id))
                     WHERE place <= 50)
               ORDER BY d.next_at, d.id LIMIT 1000"#
        )
        .fetch_all(self.readers())
        .await?;
        let mut due = Vec::new();
        let mut next: Option<Timestamp> = None;
        for row in rows {
            let at = Timestamp::from(row.next_at);
            if at > now {
                next = Some(next.map_or(at, |next| next.min(at)));
                continue;
            }
            due.push(DueDelivery {
                id: row.id.into(),
                webhook: row.webhook_id.into(),
                job: row.job_id.map(Into::into),
                url: row.url,
                secret: row.secret,
                body: row.body,
                attempts: row.attempts,
                created_at: row.created_at.into(),
            });
        }
        Ok((due, next))
    }

    /// Stores the outcome of an attempt. Does nothing if the webhook was removed.
    pub async fn delivery_attempted(
        &self,
        delivery: DeliveryId,
        attempt: &Attempt,
        now: Timestamp,
    ) -> Result<()> {
        let state = match (&attempt.error, attempt.again_at) {
            (None, _) => "delivered",
            (Some(_), Some(_)) => "pending",
            (Some(_), None) => "given_up",
        };
        let mut write = self.write().await?;
        run!(
            write,
            "UPDATE deliveries SET state = ?1, attempts = attempts + 1, status = ?2, error = ?3, \
             next_at = coalesce(?4, next_at), ended_at = iif(?1 = 'pending', NULL, ?5) WHERE id = ?6",
            state,
            attempt.status,
            attempt.error,
            attempt.again_at.map(Timestamp::micros),
            now.micros(),
            delivery.0
        );
        self.commit(write).await
    }

    /// The deliveries of a webhook before `before`, newest first, at most `limit`.
    pub async fn deliveries(
        &self,
        webhook: WebhookId,
        before: Option<DeliveryId>,
        limit: u32,
    ) -> Result<Vec<Delivery>> {
        let mut transaction = self.read().await?;
        let exists = sqlx::query_scalar!(
            r#"SELECT EXISTS (SELECT 1 FROM webhooks WHERE id = ?) AS "exists!: bool""#,
            webhook.0
        );
        if !exists.fetch_one(&mut *transaction).await? {
            return Err(StoreError::NotFound("webhook"));
        }
        let rows = sqlx::query!(
            r#"SELECT id, event_id, job_id AS "job_id?: Id", kind AS "kind: Word<WebhookKind>",
                      state AS "state: Word<DeliveryState>", attempts AS "attempts: u32", status AS "status?: u16",
                      error, next_at, created_at, ended_at AS "ended_at?: Time"
               FROM deliveries WHERE webhook_id = ? AND id < ? ORDER BY id DESC LIMIT ?"#,
            webhook.0,
            before.map_or(uuid::Uuid::max(), |delivery| delivery.0),
            limit
        )
        .fetch_all(&mut *transaction)
        .await?;
        let delivery = rows.into_iter().map(|row| Delivery {
            id: row.id.into(),
            kind: row.kind.0,
            event_id: Some(row.event_id).filter(|&event| event > 0),
            job_id: row.job_id.map(Into::into),
            state: row.state.0,
            attempts: row.attempts,
            status: row.status,
            error: row.error,
            created_at: row.created_at.into(),
            next_at: Some(row.next_at.into()).filter(|_| row.ended_at.is_none()),
            ended_at: row.ended_at.map(Into::into),
        });
        Ok(delivery.collect())
    }
}

/// Forgets deliveries that ended long ago.
pub(crate) async fn forget_old_deliveries(write: &mut Write, now: Timestamp) -> Result<()> {
    run!(write, "DELETE FROM deliveries WHERE ended_at < ?", now.plus_micros(-KEPT).micros());
    Ok(())
}
