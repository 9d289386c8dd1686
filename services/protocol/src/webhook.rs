//! Webhooks: addresses that the farm tells of events.

use serde::{Deserialize, Serialize};
use serde_json::Value;
use utoipa::ToSchema;

use crate::{DeliveryId, EventId, JobId, PageToken, Timestamp, WebhookId};

/// What a webhook is told of.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum WebhookKind {
    /// A job will probably miss its promised deadline.
    PromiseAtRisk,
    /// A job whose promise was at risk will probably be ready in time after all.
    PromiseSafe,
    /// A job is done.
    JobDone,
    /// A job failed.
    JobFailed,
    /// A budget reached a threshold, or its next period began.
    Budget,
    /// A node was set aside.
    NodeSetAside,
    /// Somebody tests the webhook.
    Test,
}

impl WebhookKind {
    /// All kinds.
    pub const ALL: [WebhookKind; 7] = [
        WebhookKind::PromiseAtRisk,
        WebhookKind::PromiseSafe,
        WebhookKind::JobDone,
        WebhookKind::JobFailed,
        WebhookKind::Budget,
        WebhookKind::NodeSetAside,
        WebhookKind::Test,
    ];

    /// The name, as in JSON.
    pub const fn name(self) -> &'static str {
        match self {
            WebhookKind::PromiseAtRisk => "promise_at_risk",
            WebhookKind::PromiseSafe => "promise_safe",
            WebhookKind::JobDone => "job_done",
            WebhookKind::JobFailed => "job_failed",
            WebhookKind::Budget => "budget",
            WebhookKind::NodeSetAside => "node_set_aside",
            WebhookKind::Test => "test",
        }
    }
}

/// Adds a webhook. It is told of events from now on, each until it answers with 2xx, or for a day.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct WebhookRequest {
    /// Address of the receiver: http or https, at most 2000 characters.
    #[schema(min_length = 1, max_length = 2000)]
    pub url: String,
    /// What it is told of. If absent, everything.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(min_items = 1)]
    pub kinds: Option<Vec<WebhookKind>>,
    /// Only jobs and budgets of this project. If absent, all, and nodes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(min_length = 1, max_length = 200, pattern = r"^[^\x00-\x1F\x7F-\x9F]+$")]
    pub project: Option<String>,
    /// The body that it gets, as JSON. In its strings, `{text}`, `{kind}`, `{job}`, `{project}` and `{url}`
    /// are replaced. For most chat services, `{"text": "{text}"}`. If absent, the body is a `WebhookMessage`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub template: Option<Value>,
}

/// A webhook.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct Webhook {
    /// Its id.
    pub id: WebhookId,
    /// Address of the receiver.
    pub url: String,
    /// What it is told of.
    pub kinds: Vec<WebhookKind>,
    /// Only jobs and budgets of this project. Absent if all.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub project: Option<String>,
    /// The body that it gets. Absent if it is a `WebhookMessage`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub template: Option<Value>,
    /// The secret that signs what is sent (Standard Webhooks). Shown only when the webhook is added.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub secret: Option<String>,
    /// Number of deliveries that are not done.
    pub pending: u64,
    /// When it was added.
    pub created_at: Timestamp,
}

/// All webhooks, oldest first.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct WebhookList {
    /// The webhooks.
    pub items: Vec<Webhook>,
}

/// State of a delivery.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum DeliveryState {
    /// To be sent, or sent again.
    Pending,
    /// The receiver answered with 2xx.
    Delivered,
    /// The receiver did not answer with 2xx for a day.
    GivenUp,
}

/// What a webhook is or was told.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct Delivery {
    /// Its id. It is sent as `webhook-id`, the same with each attempt.
    pub id: DeliveryId,
    /// What it is about.
    pub kind: WebhookKind,
    /// The event. Absent for a test.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub event_id: Option<EventId>,
    /// The job. Absent if it is about none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub job_id: Option<JobId>,
    /// Its state.
    pub state: DeliveryState,
    /// Number of attempts so far.
    pub attempts: u32,
    /// HTTP status of the last attempt. Absent if there was no answer.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub status: Option<u16>,
    /// Why the last attempt failed. Absent if it did not.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error: Option<String>,
    /// When the event was seen.
    pub created_at: Timestamp,
    /// When the next attempt is due. Absent once it is over.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub next_at: Option<Timestamp>,
    /// When it was delivered or given up. Absent until then.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ended_at: Option<Timestamp>,
}

/// One page of deliveries, newest first.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct DeliveryPage {
    /// The deliveries.
    pub items: Vec<Delivery>,
    /// Token of the next page. Absent on the last page.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub next_page_token: Option<PageToken>,
}

/// The body of a delivery to a webhook without a template.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct WebhookMessage {
    /// What it is about.
    #[serde(rename = "type")]
    pub kind: WebhookKind,
    /// When it happened.
    pub timestamp: Timestamp,
    /// What happened.
    pub data: WebhookData,
}

/// What happened.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct WebhookData {
    /// It as one line of text.
    pub text: String,
    /// The job. Absent if it is about none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub job_id: Option<JobId>,
    /// Name of the job.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub job: Option<String>,
    /// The project.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub project: Option<String>,
    /// The event. Absent for a test.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub event: Option<Box<crate::Event>>,
    /// Address of the page about it. Absent if the service does not know its own address.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub url: Option<String>,
}
