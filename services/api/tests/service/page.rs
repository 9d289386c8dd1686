//! The dashboard page, compression, and headers that protect browsers.

use crate::support::{Answer, Farm};
use forelight_protocol::{ProblemKind, TaskPage, Webhook};
use reqwest::{Method, Response, StatusCode};
use serde_json::json;

async fn with_gzip(farm: &Farm, path: &str) -> Response {
    farm.viewer.request(Method::GET, path).header("accept-encoding", "gzip").send().await.unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn the_page_needs_no_token_and_may_load_only_what_is_its_own() {
    let farm = Farm::new().await;
    let page = farm.nobody.get("/").await;
    assert_eq!(page.status(), StatusCode::OK);
    let headers = page.headers().clone();
    assert_eq!(headers["content-type"], "text/html; charset=utf-8");
    assert_eq!(headers["x-content-type-options"], "nosniff");
    assert_eq!(headers["cache-control"], "no-cache");
    assert_eq!(headers["referrer-policy"], "no-referrer");
    let policy = headers["content-security-policy"].to_str().unwrap();
    assert!(policy.starts_with("default-src 'self';") && !policy.contains("unsafe"), "{policy}");
    assert!(policy.contains("frame-ancestors 'none'"), "{policy}");
    let text = page.text().await.unwrap();
    assert!(text.starts_with("<!doctype html>"), "{text}");
    let known = farm.nobody.request(Method::GET, "/").header("if-none-match", &headers["etag"]);
    let known = known.send().await.unwrap();
    assert_eq!((known.status(), &known.headers()["etag"]), (StatusCode::NOT_MODIFIED, &headers["etag"]));
    assert_eq!(farm.nobody.get("/index.html").await.text().await.unwrap(), text);
    for path in ["/assets/nothing.js", "/assets/..%2f..%2fCargo.toml", "/%2e%2e/Cargo.toml", "//etc/passwd"] {
        farm.nobody.get(path).await.problem(ProblemKind::NotFound).await;
    }
    farm.nobody.post("/", &()).await.problem(ProblemKind::NotFound).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn long_text_is_compressed_for_those_who_ask_and_nothing_else_is() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let job = farm.submit("0-1").await;
    farm.work_off(&node, &job).await;
    for path in [format!("/v1/jobs/{}/frames", job.id), "/openapi.yaml".to_owned()] {
        let short = with_gzip(&farm, &path).await;
        assert_eq!(short.headers()["content-encoding"], "gzip", "{path}");
        let short = short.bytes().await.unwrap();
        let plain = farm.viewer.get(&path).await;
        assert!(!plain.headers().contains_key("content-encoding"), "{path}");
        let plain = plain.bytes().await.unwrap();
        assert!(short.starts_with(&[0x1f, 0x8b]) && short.len() * 2 < plain.len(), "{path}");
    }
    for path in [
        "/healthz".to_owned(),
        format!("/v1/jobs/{}/frames/0/image.png", job.id),
        format!("/v1/jobs/{}/frames/0/image.exr", job.id),
        format!("/v1/jobs/{}/events", job.id),
    ] {
        let answer = with_gzip(&farm, &path).await;
        assert_eq!(answer.status(), StatusCode::OK, "{path}");
        assert!(!answer.headers().contains_key("content-encoding"), "{path}");
        assert_eq!(answer.headers()["x-content-type-options"], "nosniff", "{path}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_document_that_has_not_changed_is_not_sent_again() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let job = farm.submit("0-1").await;
    let job = farm.work_off(&node, &job).await;
    let webhook = farm.operator.post("/v1/webhooks", &json!({"url": "http://127.0.0.1:1/"})).await;
    let webhook: Webhook = webhook.parsed(StatusCode::CREATED).await;
    let tasks: TaskPage = farm.viewer.json(&format!("/v1/jobs/{}/tasks", job.id)).await;
    let of_job =
        ["", "/forecast", "/frames", "/frames/0", "/strip"].map(|path| format!("/v1/jobs/{}{path}", job.id));
    let of_farm = [
        format!("/v1/nodes/{}", node.id),
        format!("/v1/tasks/{}/log", tasks.items[0].id),
        format!("/v1/webhooks/{}/deliveries", webhook.id),
        format!("/v1/plans/{}", job.plan_id.unwrap()),
        format!("/v1/plans/{}/difference", job.plan_id.unwrap()),
    ];
    let lists = ["nodes", "plans", "bookings", "webhooks", "jobs", "budgets", "retention", "audit"];
    let lists = lists.map(|list| format!("/v1/{list}"));
    for path in of_job.into_iter().chain(of_farm).chain(lists) {
        let first = farm.operator.get(&path).await;
        let tag = first.headers()["etag"].to_str().unwrap().to_owned();
        assert_eq!(first.headers()["cache-control"], "private, no-cache", "{path}");
        let strong = tag.trim_start_matches("W/").to_owned();
        for known in [tag.clone(), strong, format!("\"other\", {tag}"), "*".to_owned()] {
            let again = farm.operator.request(Method::GET, &path).header("if-none-match", &known);
            let again = again.send().await.unwrap();
            assert_eq!(again.status(), StatusCode::NOT_MODIFIED, "{path} {known}");
            assert!(again.bytes().await.unwrap().is_empty());
        }
        let other =
            farm.operator.request(Method::GET, &path).header("if-none-match", "\"other\"").send().await;
        assert_eq!(other.unwrap().status(), StatusCode::OK, "{path}");
    }
}
