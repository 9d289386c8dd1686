//! Tells webhooks of events: looks through the events, stores what is to be sent, and sends it.
//!
//! One task does this. A slow receiver has at most [`AT_ONCE`] requests under way, so it holds up no other.
//! The farm never waits for any of them.

mod message;
mod sending;

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use forelight_protocol::{EventId, JobId, Timestamp, WebhookId, WebhookKind};
use forelight_store::{Attempt, DueDelivery, NewDelivery, Receiver, Store, StoreError};
use futures::StreamExt as _;
use futures::stream::FuturesUnordered;

use self::message::{About, kind_of};
use self::sending::Sender;
use crate::state::App;

pub(crate) use self::sending::new_secret;

/// Requests to one webhook at the same time, each about another job.
const AT_ONCE: usize = 4;

/// Longest wait while something is to be sent later: its time may come sooner than the clock said.
const LOOK_AGAIN: Duration = Duration::from_secs(1);

/// How long a message is sent: a day, in microseconds.
const PATIENCE: i64 = 86_400_000_000;

/// The longest pause between two attempts: five minutes, in microseconds.
const LONGEST_PAUSE: i64 = 300_000_000;

/// A message under way.
struct Sent {
    delivery: DueDelivery,
    status: Option<u16>,
    error: Option<String>,
}

/// Tells webhooks of events until the service stops.
pub(crate) async fn tell_webhooks(app: &App) {
    let sender = match Sender::new() {
        Ok(sender) => sender,
        Err(error) => {
            tracing::error!(%error, "webhooks are told nothing: no HTTP client could be made");
            return;
        }
    };
    let mut events = app.store.watch_events();
    let mut asked = app.webhooks_changed.subscribe();
    let mut under_way = FuturesUnordered::new();
    let mut busy = Busy::default();
    loop {
        events.borrow_and_update();
        asked.borrow_and_update();
        if let Err(error) = collect(app).await {
            tracing::warn!(%error, "events for webhooks could not be stored; the next round tries again");
        }
        let mut next = None;
        match app.store.due_deliveries(app.now()).await {
            Ok((due, later)) => {
                next = later;
                for delivery in due {
                    if busy.takes(&delivery) {
                        under_way.push(send(&sender, delivery, app.now()));
                    }
                }
            }
            Err(error) => tracing::warn!(%error, "deliveries could not be read; the next round tries again"),
        }
        tokio::select! {
            () = app.stopping.cancelled() => return,
            Some(sent) = under_way.next(), if !under_way.is_empty() => {
                busy.gives(&sent.delivery);
                note(&app.store, &sent, app.now()).await;
            }
            changed = events.changed() => if changed.is_err() { return },
            changed = asked.changed() => if changed.is_err() { return },
            () = tokio::time::sleep(LOOK_AGAIN), if next.is_some() => {}
        }
    }
}

async fn send(sender: &Sender, delivery: DueDelivery, now: Timestamp) -> Sent {
    let (status, error) = sender.send(&delivery, now).await;
    Sent { delivery, status, error }
}

/// What is under way.
#[derive(Default)]
struct Busy {
    jobs: BTreeSet<(WebhookId, Option<JobId>)>,
    requests: BTreeMap<WebhookId, usize>,
}

impl Busy {
    /// Takes a delivery, unless one about its job is under way, or too many to its webhook.
    fn takes(&mut self, delivery: &DueDelivery) -> bool {
        let requests = self.requests.entry(delivery.webhook).or_default();
        let is_taken = *requests < AT_ONCE && self.jobs.insert((delivery.webhook, delivery.job));
        *requests += usize::from(is_taken);
        is_taken
    }

    fn gives(&mut self, delivery: &DueDelivery) {
        self.jobs.remove(&(delivery.webhook, delivery.job));
        if let Some(requests) = self.requests.get_mut(&delivery.webhook) {
            *requests = requests.saturating_sub(1);
        }
    }
}

/// Stores the outcome of an attempt.
async fn note(store: &Store, sent: &Sent, now: Timestamp) {
    let Sent { delivery, status, error } = sent;
    let again_at = now.plus_micros(pause(delivery.attempts));
    let is_given_up = again_at.micros_since(delivery.created_at) > PATIENCE;
    if let Some(error) = error {
        tracing::info!(webhook = %delivery.webhook, error, again = !is_given_up, "a webhook was not told");
    }
    let again_at = (!is_given_up).then_some(again_at);
    let attempt = Attempt { status: *status, error: error.clone(), again_at };
    if let Err(error) = store.delivery_attempted(delivery.id, &attempt, now).await {
        tracing::warn!(%error, "the outcome of a delivery could not be stored; it is sent again");
    }
}

/// The pause after so many failed attempts before this one, in microseconds: one second, then twice as long
/// each time.
fn pause(attempts: u32) -> i64 {
    1_000_000i64.saturating_mul(1 << attempts.min(20)).min(LONGEST_PAUSE)
}

/// Looks through the events since the last look, for each webhook.
async fn collect(app: &App) -> Result<(), StoreError> {
    for receiver in app.store.receivers().await? {
        let mut seen = receiver.seen;
        loop {
            let (events, looked_at) = app.store.events_for_webhooks(seen).await?;
            if looked_at == seen {
                break;
            }
            let mut deliveries = Vec::new();
            for event in events {
                let Some(kind) = kind_of(&event) else { continue };
                let about = About::event(app, kind, event).await?;
                if let Some(delivery) = delivery_to(&receiver, &about) {
                    deliveries.push(delivery);
                }
            }
            // Moving the place alone is not worth a write for each event.
            if !deliveries.is_empty() || looked_at - receiver.seen > SKIPPED {
                app.store
                    .add_deliveries(receiver.webhook.id, &deliveries, Some(looked_at), app.now())
                    .await?;
            }
            seen = looked_at;
        }
    }
    Ok(())
}

/// So many events without news for a webhook are looked through again after a restart, at most.
const SKIPPED: EventId = 1000;

/// What the webhook is told, if it is to be told.
fn delivery_to(receiver: &Receiver, about: &About) -> Option<NewDelivery> {
    let webhook = &receiver.webhook;
    let is_wanted = webhook.kinds.contains(&about.kind)
        && (webhook.project.is_none() || webhook.project == about.project);
    is_wanted.then(|| NewDelivery {
        event: about.event.as_ref().map(|event| event.id),
        job: about.job_id,
        kind: about.kind,
        body: about.body(webhook.template.as_ref()),
    })
}

/// Stores a test for a webhook.
pub(crate) async fn test_delivery(app: &App, webhook: WebhookId) -> Result<(), StoreError> {
    let receivers = app.store.receivers().await?;
    let receiver = receivers.into_iter().find(|receiver| receiver.webhook.id == webhook);
    let receiver = receiver.ok_or(StoreError::NotFound("webhook"))?;
    let about = About::test(app);
    let delivery = NewDelivery {
        event: None,
        job: None,
        kind: WebhookKind::Test,
        body: about.body(receiver.webhook.template.as_ref()),
    };
    app.store.add_deliveries(webhook, &[delivery], None, app.now()).await?;
    app.webhooks_changed.send_modify(|version| *version = version.wrapping_add(1));
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pauses_double_from_a_second_to_five_minutes() {
        let seconds: Vec<i64> =
            [0, 1, 2, 8, 9, 40, u32::MAX].map(|attempts| pause(attempts) / 1_000_000).to_vec();
        assert_eq!(seconds, [1, 2, 4, 256, 300, 300, 300]);
    }
}
