//! Webhooks: receivers that are away, slow, or answer with errors.

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicU16, AtomicU64, Ordering};
use std::time::Duration;

use crate::support::{Answer, Farm, until};
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode as Status};
use axum::routing::post;
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use forelight_api::Clock as _;
use forelight_protocol::{
    Delivery, DeliveryPage, DeliveryState, Job, JobState, Node, ProblemKind, Timestamp, Webhook, WebhookKind,
    WebhookList, WebhookMessage,
};
use hmac::{Hmac, KeyInit as _, Mac as _};
use parking_lot::Mutex;
use reqwest::{Method, StatusCode};
use serde_json::{Value, json};
use sha2::Sha256;
use tokio::net::TcpListener;

const MINUTE: i64 = 60_000_000;

/// A receiver of messages.
#[derive(Clone, Default)]
struct Receiver {
    /// What it got: headers and body.
    got: Arc<Mutex<Vec<(HeaderMap, String)>>>,
    /// The status that it answers; 0 for 204.
    status: Arc<AtomicU16>,
    /// How long it takes to answer, milliseconds.
    pause: Arc<AtomicU64>,
}

impl Receiver {
    async fn listen(&self, at: SocketAddr) -> SocketAddr {
        let listener = TcpListener::bind(at).await.unwrap();
        let address = listener.local_addr().unwrap();
        let router = axum::Router::new().route("/hook", post(receive)).with_state(self.clone());
        tokio::spawn(async move { axum::serve(listener, router).await });
        address
    }

    async fn new() -> (Self, String) {
        let receiver = Self::default();
        let address = receiver.listen(SocketAddr::from(([127, 0, 0, 1], 0))).await;
        (receiver, format!("http://{address}/hook"))
    }

    /// The messages so far, of those that were answered well.
    fn messages(&self) -> Vec<WebhookMessage> {
        self.got.lock().iter().map(|(_, body)| serde_json::from_str(body).unwrap()).collect()
    }
}

async fn receive(State(receiver): State<Receiver>, headers: HeaderMap, body: String) -> Status {
    tokio::time::sleep(Duration::from_millis(receiver.pause.load(Ordering::SeqCst))).await;
    match receiver.status.load(Ordering::SeqCst) {
        0 => {
            receiver.got.lock().push((headers, body));
            Status::NO_CONTENT
        }
        status => Status::from_u16(status).unwrap(),
    }
}

async fn add(farm: &Farm, request: Value) -> Webhook {
    farm.operator.post("/v1/webhooks", &request).await.parsed(StatusCode::CREATED).await
}

async fn deliveries(farm: &Farm, webhook: &Webhook) -> Vec<Delivery> {
    let path = format!("/v1/webhooks/{}/deliveries?page_size=200", webhook.id);
    farm.operator.json::<DeliveryPage>(&path).await.items
}

/// Takes a job of one frame to its end.
async fn done(farm: &Farm, node: &forelight_protocol::Node) -> Job {
    let job = farm.submit("0").await;
    let done = farm.work_off(node, &job).await;
    assert_eq!(done.state, JobState::Done);
    done
}

#[tokio::test(flavor = "multi_thread")]
async fn a_message_is_signed_and_says_what_happened() {
    let (farm, _) = Farm::with_clock().await;
    let (receiver, url) = Receiver::new().await;
    let webhook = add(&farm, json!({"url": url, "kinds": ["job_done", "job_failed", "job_done"]})).await;
    assert_eq!(webhook.kinds, [WebhookKind::JobDone, WebhookKind::JobFailed]);
    let secret = webhook.secret.clone().unwrap();
    let listed = farm.operator.json::<WebhookList>("/v1/webhooks").await.items;
    assert_eq!((listed.len(), &listed[0].secret), (1, &None), "a secret is shown once");
    let node = farm.node("a").await;
    let job = done(&farm, &node).await;
    until("a message", async || !receiver.messages().is_empty()).await;
    let (headers, body) = receiver.got.lock()[0].clone();
    let header = |name: &str| headers[name].to_str().unwrap().to_owned();
    let signed = format!("{}.{}.{body}", header("webhook-id"), header("webhook-timestamp"));
    let key = STANDARD.decode(secret.strip_prefix("whsec_").unwrap()).unwrap();
    let mut mac = Hmac::<Sha256>::new_from_slice(&key).unwrap();
    mac.update(signed.as_bytes());
    let expected = format!("v1,{}", STANDARD.encode(mac.finalize().into_bytes()));
    assert_eq!(header("webhook-signature"), expected);
    let message: WebhookMessage = serde_json::from_str(&body).unwrap();
    assert_eq!((message.kind, message.data.job_id), (WebhookKind::JobDone, Some(job.id)));
    assert_eq!(message.data.text, "a job of project default is done: 1 of 1 frames");
    until("it is noted", async || deliveries(&farm, &webhook).await[0].state == DeliveryState::Delivered)
        .await;
    let delivery = deliveries(&farm, &webhook).await.remove(0);
    assert_eq!(
        (delivery.attempts, delivery.status, delivery.id.to_string()),
        (1, Some(204), header("webhook-id"))
    );
    assert_eq!(delivery.event_id, message.data.event.map(|event| event.id));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_receiver_that_was_away_or_answers_500_gets_every_event_once_or_more_in_order() {
    let (farm, clock) = Farm::with_clock().await;
    let node = farm.node("a").await;
    // A port on which nobody listens yet.
    let port = TcpListener::bind("127.0.0.1:0").await.unwrap().local_addr().unwrap();
    let webhook = add(&farm, json!({"url": format!("http://{port}/hook")})).await;
    let job = done(&farm, &node).await;
    // The same job is done again and again: its events have an order.
    for _ in 0..2 {
        let path = format!("/v1/jobs/{}/frames/retry", job.id);
        farm.submitter.post(&path, &json!({"frames": "0"})).await.parsed::<Job>(StatusCode::OK).await;
        farm.work_off(&node, &job).await;
    }
    until("an attempt failed", async || {
        let all = deliveries(&farm, &webhook).await;
        all.len() == 3 && all[2].attempts >= 1 && all[2].error.is_some()
    })
    .await;
    // The service dies meanwhile, and loses nothing.
    let all = deliveries(&farm, &webhook).await;
    assert!(all.iter().all(|delivery| delivery.state == DeliveryState::Pending), "{all:?}");
    assert_eq!((all[0].attempts, all[1].attempts), (0, 0), "later events of a job wait for the first");
    let receiver = Receiver::default();
    receiver.status.store(500, Ordering::SeqCst);
    receiver.listen(port).await;
    clock.advance_micros(10 * MINUTE);
    until("an answer of 500", async || deliveries(&farm, &webhook).await[2].status == Some(500)).await;
    receiver.status.store(0, Ordering::SeqCst);
    until("all events", async || {
        clock.advance_micros(5 * MINUTE);
        receiver.got.lock().len() >= 3
    })
    .await;
    let events: Vec<i64> =
        receiver.messages().into_iter().filter_map(|message| Some(message.data.event?.id)).collect();
    let mut sorted = events.clone();
    sorted.sort_unstable();
    assert_eq!(events, sorted);
    let all = deliveries(&farm, &webhook).await;
    let sent: Vec<Option<i64>> = all.iter().rev().map(|delivery| delivery.event_id).collect();
    sorted.dedup();
    assert_eq!(sent, sorted.into_iter().map(Some).collect::<Vec<_>>());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_slow_receiver_holds_up_neither_the_farm_nor_others() {
    let (farm, _) = Farm::with_clock().await;
    let node = farm.node("a").await;
    let (slow, slow_url) = Receiver::new().await;
    slow.pause.store(3_600_000, Ordering::SeqCst);
    let (quick, quick_url) = Receiver::new().await;
    let webhook = add(&farm, json!({"url": slow_url})).await;
    add(&farm, json!({"url": quick_url})).await;
    for _ in 0..6 {
        done(&farm, &node).await;
    }
    until("the quick one has all", async || quick.got.lock().len() == 6).await;
    assert!(slow.got.lock().is_empty());
    let waiting = deliveries(&farm, &webhook).await;
    assert!(waiting.iter().all(|delivery| delivery.state == DeliveryState::Pending), "{waiting:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn events_are_told_after_a_restart_too_and_a_removed_webhook_is_told_nothing() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let port = TcpListener::bind("127.0.0.1:0").await.unwrap().local_addr().unwrap();
    let kept = add(&farm, json!({"url": format!("http://{port}/hook")})).await;
    let removed = add(&farm, json!({"url": format!("http://{port}/hook")})).await;
    done(&farm, &node).await;
    until("it is to be sent", async || !deliveries(&farm, &removed).await.is_empty()).await;
    let path = format!("/v1/webhooks/{}", removed.id);
    let gone = farm.operator.request(Method::DELETE, &path).send().await.unwrap();
    assert_eq!(gone.status(), StatusCode::NO_CONTENT);
    farm.operator.get(&format!("{path}/deliveries")).await.problem(ProblemKind::NotFound).await;
    let farm = farm.killed_and_restarted().await;
    let receiver = Receiver::default();
    receiver.listen(port).await;
    until("the event", async || !receiver.got.lock().is_empty()).await;
    until("it is noted", async || deliveries(&farm, &kept).await[0].state == DeliveryState::Delivered).await;
    assert_eq!(receiver.got.lock().len(), 1);
}

#[tokio::test(flavor = "multi_thread")]
async fn chat_services_get_their_own_form_and_projects_their_own_events() {
    let (farm, _) = Farm::with_clock().await;
    let node = farm.node("a").await;
    let (chat, url) = Receiver::new().await;
    let (other, other_url) = Receiver::new().await;
    let template = json!({"text": "{kind}: {text}", "extra": ["{job}", 7]});
    let webhook = add(&farm, json!({"url": url, "template": template})).await;
    add(&farm, json!({"url": other_url, "project": "film"})).await;
    let tested = farm.operator.post(&format!("/v1/webhooks/{}/test", webhook.id), &json!({})).await;
    assert_eq!(tested.status(), StatusCode::ACCEPTED);
    until("the test", async || chat.got.lock().len() == 1).await;
    let mut request = farm.job_request("0");
    request["name"] = json!("\"}, {\"text\": \"</b>{url}");
    let job: Job = farm.submitter.post("/v1/jobs", &request).await.parsed(StatusCode::CREATED).await;
    farm.work_off(&node, &job).await;
    until("the job", async || chat.got.lock().len() == 2).await;
    let body: Value = serde_json::from_str(&chat.got.lock()[1].1).unwrap();
    assert_eq!(body["extra"], json!([request["name"], 7]));
    assert!(
        body["text"].as_str().unwrap().starts_with("job_done: \"}, {\"text\": \"</b>{url} of project"),
        "{body}"
    );
    request["project"] = json!("film");
    farm.project("film").await;
    let job: Job = farm.submitter.post("/v1/jobs", &request).await.parsed(StatusCode::CREATED).await;
    farm.work_off(&node, &job).await;
    until("the film's job", async || chat.got.lock().len() == 3).await;
    until("it is told too", async || !other.got.lock().is_empty()).await;
    assert_eq!(
        other.messages().iter().map(|message| message.data.job_id).collect::<Vec<_>>(),
        [Some(job.id)]
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn a_budget_that_is_spent_and_a_promise_at_risk_are_told_of() {
    let (farm, clock) = Farm::with_clock().await;
    let node = farm.node("a").await;
    let (receiver, url) = Receiver::new().await;
    add(&farm, json!({"url": url})).await;
    let mut request = farm.job_request("0-3");
    request["deadline"] = json!(Timestamp::now().plus_micros(48 * 60 * MINUTE));
    let job: Job = farm.submitter.post("/v1/jobs", &request).await.parsed(StatusCode::CREATED).await;
    farm.until_booked(&node, &job).await;
    // A budget of nothing holds the job, so its promise is at risk.
    farm.next_task(&node).await;
    clock.advance_micros(1_000_000);
    let budget = json!({"project": "default", "period": "total", "amount": 0});
    farm.operator.post("/v1/budgets", &budget).await;
    let told = async |kind: WebhookKind| receiver.messages().iter().any(|message| message.kind == kind);
    until("both are told", async || {
        told(WebhookKind::PromiseAtRisk).await && told(WebhookKind::Budget).await
    })
    .await;
    let messages: BTreeMap<WebhookKind, String> =
        receiver.messages().into_iter().map(|message| (message.kind, message.data.text)).collect();
    let budget = &messages[&WebhookKind::Budget];
    assert!(
        budget.starts_with("budget of project default: ") && budget.contains("nothing new is started"),
        "{budget}"
    );
    let at_risk = &messages[&WebhookKind::PromiseAtRisk];
    assert!(at_risk.starts_with("a job of project default is at risk: ready in time with"), "{at_risk}");
}

#[tokio::test(flavor = "multi_thread")]
async fn each_threshold_of_a_budget_is_told_of_when_it_is_reached() {
    let (farm, clock) = Farm::with_clock().await;
    let node = farm.node("a").await;
    let (receiver, url) = Receiver::new().await;
    add(&farm, json!({"url": url, "kinds": ["budget"], "project": "default"})).await;
    // The node costs a thousand a second.
    let thresholds = json!([{"percent": 50, "action": "warn"}, {"percent": 100, "action": "drain"}]);
    let budget =
        json!({"project": "default", "period": "total", "amount": 100_000, "thresholds": thresholds});
    farm.operator.post("/v1/budgets", &budget).await;
    let job = farm.submit("0-9").await;
    farm.until_booked(&node, &job).await;
    let task = farm.next_task(&node).await;
    let lease = format!("/v1/leases/{}", task.lease_id);
    for (seconds, word) in [(60, "warning"), (50, "nothing new is started")] {
        let before = receiver.messages().len();
        for _ in 0..seconds / 10 {
            clock.advance_micros(10_000_000);
            let beat = farm.worker.request(Method::PATCH, &lease).json(&json!({"fence": task.fence}));
            assert_eq!(beat.send().await.unwrap().status(), StatusCode::OK);
        }
        farm.service.store().enforce_budgets(clock.now()).await.unwrap();
        until(word, async || receiver.messages().len() > before).await;
        let said = receiver.messages().pop().unwrap().data;
        assert!(said.text.contains(word), "{}", said.text);
        assert_eq!((said.project.as_deref(), said.job_id), (Some("default"), None));
    }
    assert_eq!(receiver.messages().len(), 2);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_node_that_is_set_aside_for_its_failures_is_told_of_with_its_page() {
    let farm = Farm::with(|config| config.public_origin = Some("https://farm.example".to_owned())).await;
    let (receiver, url) = Receiver::new().await;
    add(&farm, json!({"url": url, "kinds": ["node_set_aside"]})).await;
    // Film people hear of their jobs, and not of nodes.
    let (of_film, film_url) = Receiver::new().await;
    add(&farm, json!({"url": film_url, "project": "film"})).await;
    let (bad, good) = (farm.node("bad").await, farm.node("good").await);
    let job = farm.submit("0-7").await;
    farm.until_booked(&good, &job).await;
    // A failure counts once another node has done the task.
    while farm.viewer.json::<Node>(&format!("/v1/nodes/{}", bad.id)).await.set_aside.is_none() {
        if let Some(lease) = farm.claim(&bad).await {
            let failed = json!({"fence": lease.fence, "error": {"message": "no GPU"}});
            farm.worker.post(&format!("/v1/leases/{}/result", lease.lease_id), &failed).await;
        }
        if let Some(lease) = farm.claim_waiting(&good, 2000).await {
            farm.finish(&lease).await;
        }
    }
    until("the node", async || !receiver.got.lock().is_empty()).await;
    let data = receiver.messages().remove(0).data;
    assert!(data.text.starts_with("node bad: it was at fault for 3 tasks within a day"), "{}", data.text);
    assert_eq!(data.url, Some(format!("https://farm.example/#/farm?node={}", bad.id)));
    assert_eq!(data.event.unwrap().node_id, Some(bad.id));
    assert!(of_film.got.lock().is_empty());
}

#[tokio::test(flavor = "multi_thread")]
async fn what_cannot_be_told_is_refused() {
    let farm = Farm::new().await;
    for (request, pointer) in [
        (json!({"url": "farm.example"}), "/url"),
        (json!({"url": "ftp://farm.example/"}), "/url"),
        (json!({"url": "http://user:secret@farm.example/"}), "/url"),
        (json!({"url": format!("http://a/{}", "x".repeat(2000))}), "/url"),
        (json!({"url": "http://a", "kinds": []}), "/kinds"),
        (json!({"url": "http://a", "kinds": ["weather"]}), "/kinds/0"),
        (json!({"url": "http://a", "project": ""}), "/project"),
        (json!({"url": "http://a", "template": "x".repeat(20_000)}), "/template"),
        (json!({"url": "http://a", "secret": "x"}), "/secret"),
    ] {
        let problem = farm.operator.post("/v1/webhooks", &request).await.problem(ProblemKind::Invalid).await;
        assert_eq!(problem.pointer.as_deref(), Some(pointer), "{request}: {}", problem.detail);
    }
    assert!(farm.operator.json::<WebhookList>("/v1/webhooks").await.items.is_empty());
    for _ in 0..50 {
        add(&farm, json!({"url": "http://127.0.0.1:1/"})).await;
    }
    farm.operator
        .post("/v1/webhooks", &json!({"url": "http://a"}))
        .await
        .problem(ProblemKind::Conflict)
        .await;
}
