//! The audit: who did what.

use crate::support::{Answer, Farm};
use forelight_protocol::{AuditAction, AuditEntry, AuditPage, ProblemKind, Role};
use reqwest::{Method, StatusCode};
use serde_json::json;

async fn entries(farm: &Farm, query: &str) -> Vec<AuditEntry> {
    farm.operator.json::<AuditPage>(&format!("/v1/audit?page_size=200{query}")).await.items
}

fn actions(entries: &[AuditEntry]) -> Vec<AuditAction> {
    entries.iter().rev().map(|entry| entry.action).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn whoever_changes_a_job_is_named_with_what_he_asked_for_and_from_where() {
    let farm = Farm::new().await;
    let (anna, token) = farm.new_token(json!({"name": "anna", "role": "submitter"})).await;
    let job = anna.post("/v1/jobs", &farm.job_request("0-3")).await;
    let job: forelight_protocol::Job = job.parsed(StatusCode::CREATED).await;
    let path = format!("/v1/jobs/{}", job.id);
    let patch = anna.request(Method::PATCH, &path).json(&json!({"budget": 7_000_000})).send().await.unwrap();
    assert_eq!(patch.status(), StatusCode::OK);
    // What changes nothing, and what is refused, leaves no entry.
    let again = anna.request(Method::PATCH, &path).json(&json!({"budget": 7_000_000})).send().await.unwrap();
    assert_eq!(again.status(), StatusCode::OK);
    farm.viewer.post(&format!("{path}/cancel"), &json!({})).await.problem(ProblemKind::Forbidden).await;
    let cancel = farm.operator.post(&format!("{path}/cancel"), &json!({})).await;
    assert_eq!(cancel.status(), StatusCode::OK);
    let found = entries(&farm, &format!("&target={}", job.id)).await;
    assert_eq!(
        actions(&found),
        [AuditAction::JobSubmitted, AuditAction::JobChanged, AuditAction::JobCancelled]
    );
    let [cancelled, changed, submitted] = found.try_into().unwrap();
    assert_eq!((cancelled.actor.as_str(), cancelled.role), ("operator", Some(Role::Operator)));
    assert_eq!((changed.actor.as_str(), changed.token_id), ("anna", Some(token.id)));
    assert_eq!(changed.detail, Some(json!({"budget": 7_000_000})));
    assert_eq!((changed.from.as_deref(), changed.project.as_deref()), (Some("127.0.0.1"), Some("default")));
    assert_eq!(submitted.detail.unwrap()["frames"], "0-3");
    let of_anna = entries(&farm, "&actor=anna&action=job_changed&project=default").await;
    assert_eq!(of_anna.len(), 1);
    let left_out = json!({"reason": "a test"});
    let left_out =
        farm.operator.request(Method::PUT, &format!("/v1/jobs/{}/left-out", job.id)).json(&left_out);
    assert_eq!(left_out.send().await.unwrap().status(), StatusCode::OK);
    let found = entries(&farm, "&action=job_left_out").await;
    assert_eq!(found[0].detail, Some(json!({"reason": "a test"})));
}

#[tokio::test(flavor = "multi_thread")]
async fn orders_tokens_sessions_and_money_are_in_the_audit_and_secrets_are_not() {
    let farm = Farm::new().await;
    let (screen, token) = farm.new_token(json!({"name": "screen", "role": "viewer"})).await;
    let (_, node) = farm.joined("rack-7").await;
    farm.order(&node, json!({"drain": true})).await;
    let budget = json!({"project": "film", "period": "month", "amount": 5, "zone": "UTC"});
    assert_eq!(farm.operator.post("/v1/budgets", &budget).await.status(), StatusCode::OK);
    let share = json!({"project": "film", "share": 3});
    assert_eq!(farm.operator.post("/v1/projects", &share).await.status(), StatusCode::OK);
    let hook = json!({"url": "http://127.0.0.1:9/a-secret-of-the-receiver"});
    assert_eq!(farm.operator.post("/v1/webhooks", &hook).await.status(), StatusCode::CREATED);
    let code = screen.post("/v1/sessions/codes", &()).await;
    let code: serde_json::Value = code.parsed(StatusCode::CREATED).await;
    let session = farm.nobody.post("/v1/sessions", &json!({"code": code["code"]})).await;
    assert_eq!(session.status(), StatusCode::CREATED);
    let rotate = farm.operator.post(&format!("/v1/tokens/{}/rotate", token.id), &json!({})).await;
    assert_eq!(rotate.status(), StatusCode::CREATED);
    assert_eq!(farm.delete(&format!("/v1/nodes/{}", node.id)).await.status(), StatusCode::NO_CONTENT);
    let found = entries(&farm, "").await;
    let expected = [
        AuditAction::TokenCreated,
        AuditAction::JoinTokenCreated,
        AuditAction::NodeJoined,
        AuditAction::NodeChanged,
        // The budget makes its project.
        AuditAction::ProjectSet,
        AuditAction::BudgetSet,
        AuditAction::ProjectSet,
        AuditAction::WebhookAdded,
        AuditAction::SessionBegun,
        AuditAction::TokenRotated,
        AuditAction::NodeRemoved,
    ];
    let by_people: Vec<AuditEntry> = found.into_iter().filter(|entry| entry.from.is_some()).collect();
    assert_eq!(actions(&by_people), expected);
    let begun = by_people.iter().find(|entry| entry.action == AuditAction::SessionBegun).unwrap();
    assert_eq!(begun.actor, "screen");
    for path in ["/v1/audit", "/v1/audit/export", "/v1/audit/export?format=csv"] {
        let text = farm.operator.get(path).await.text().await.unwrap();
        assert!(!text.contains("forelight_") && !text.contains("a-secret"), "{path}: {text}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn the_audit_is_for_operators_comes_in_pages_and_as_files() {
    let farm = Farm::new().await;
    for number in 0..5 {
        farm.new_token(json!({"name": format!("screen {number}"), "role": "viewer"})).await;
    }
    for http in [&farm.viewer, &farm.submitter, &farm.worker] {
        http.get("/v1/audit").await.problem(ProblemKind::Forbidden).await;
        http.get("/v1/audit/export").await.problem(ProblemKind::Forbidden).await;
    }
    let all = entries(&farm, "").await;
    let first: AuditPage = farm.operator.json("/v1/audit?page_size=4").await;
    let token = first.next_page_token.unwrap();
    let rest: AuditPage = farm.operator.json(&format!("/v1/audit?page_size=200&page_token={token}")).await;
    assert_eq!([first.items, rest.items].concat(), all);
    let lines = farm.operator.bytes("/v1/audit/export", "application/x-ndjson").await;
    let lines = String::from_utf8(lines).unwrap();
    let exported: Vec<AuditEntry> = lines.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(exported, all.iter().rev().cloned().collect::<Vec<_>>());
    let csv = farm.operator.bytes("/v1/audit/export?format=csv", "text/csv; charset=utf-8").await;
    assert_eq!(String::from_utf8(csv).unwrap().lines().count(), all.len() + 1);
    let later = all[0].at.plus_micros(1);
    assert_eq!(entries(&farm, &format!("&from={later}")).await, []);
    assert_eq!(entries(&farm, &format!("&to={later}")).await, all);
}
