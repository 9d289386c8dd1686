//! What is kept for how long, and who may delete.

use crate::support::{Answer, Farm};
use forelight_protocol::{JobPage, ProblemKind, Pruned, Retention, RetentionKind, RetentionRule};
use reqwest::{Method, Response, StatusCode};
use serde_json::json;

async fn delete(client: &crate::support::Http, job: forelight_protocol::JobId) -> Response {
    client.request(Method::DELETE, &format!("/v1/jobs/{job}")).send().await.unwrap()
}

#[tokio::test]
async fn a_job_that_is_done_is_deleted_by_an_operator_alone_and_its_pictures_go_with_it() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let job = farm.submit("0").await;
    delete(&farm.operator, job.id).await.problem(ProblemKind::Conflict).await;
    farm.work_off(&node, &job).await;
    let image = format!("/v1/jobs/{}/frames/0/image.png", job.id);
    assert_eq!(farm.viewer.get(&image).await.status(), StatusCode::OK);
    delete(&farm.viewer, job.id).await.problem(ProblemKind::Forbidden).await;
    delete(&farm.submitter, job.id).await.problem(ProblemKind::Forbidden).await;
    assert_eq!(delete(&farm.operator, job.id).await.status(), StatusCode::NO_CONTENT);
    delete(&farm.operator, job.id).await.problem(ProblemKind::NotFound).await;
    farm.viewer.get(&image).await.problem(ProblemKind::NotFound).await;
    let jobs: JobPage = farm.viewer.json("/v1/jobs").await;
    assert_eq!(jobs.items.len(), 0);
}

#[tokio::test]
async fn a_submitter_deletes_a_job_that_was_cancelled() {
    let farm = Farm::new().await;
    let job = farm.submit("0").await;
    farm.submitter.post(&format!("/v1/jobs/{}/cancel", job.id), &json!({})).await;
    assert_eq!(delete(&farm.submitter, job.id).await.status(), StatusCode::NO_CONTENT);
}

#[tokio::test]
async fn rules_are_set_by_an_operator_and_checked() {
    let farm = Farm::new().await;
    farm.project("film").await;
    let rules: Retention = farm.viewer.json("/v1/retention").await;
    assert_eq!(rules.items.len(), RetentionKind::ALL.len());
    let rule = json!({"project": "film", "kind": "images"});
    farm.submitter.post("/v1/retention", &rule).await.problem(ProblemKind::Forbidden).await;
    let rules: Retention = farm.operator.post("/v1/retention", &rule).await.parsed(StatusCode::OK).await;
    let film = RetentionRule { project: Some("film".to_owned()), kind: RetentionKind::Images, days: None };
    assert!(rules.items.contains(&film));
    for (wrong, pointer) in [
        (json!({"kind": "images", "days": 40_000}), "/days"),
        (json!({"kind": "logs", "days": 1, "project": "film"}), "/project"),
        (json!({"kind": "images", "days": 1, "project": ""}), "/project"),
        (json!({"kind": "images", "days": 1, "project": "flim"}), "/project"),
    ] {
        let problem = farm.operator.post("/v1/retention", &wrong).await.problem(ProblemKind::Invalid).await;
        assert_eq!(problem.pointer.as_deref(), Some(pointer), "{wrong}");
    }
}

#[tokio::test]
async fn a_dry_run_says_what_would_be_deleted_and_deletes_nothing() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let job = farm.submit("0").await;
    farm.work_off(&node, &job).await;
    let rule = json!({"kind": "images", "days": 0});
    farm.operator.post("/v1/retention", &rule).await.parsed::<Retention>(StatusCode::OK).await;
    farm.submitter.post("/v1/prune", &json!({})).await.problem(ProblemKind::Forbidden).await;
    let images =
        |pruned: &Pruned| *pruned.items.iter().find(|item| item.kind == RetentionKind::Images).unwrap();
    let prune = async |dry_run: bool| -> Pruned {
        farm.operator.post("/v1/prune", &json!({"dry_run": dry_run})).await.parsed(StatusCode::OK).await
    };
    let image = format!("/v1/jobs/{}/frames/0/image.png", job.id);
    let dry = prune(true).await;
    assert_eq!(images(&dry).number, 1);
    assert!(images(&dry).bytes > 0);
    assert_eq!(farm.viewer.get(&image).await.status(), StatusCode::OK);
    let pruned = prune(false).await;
    assert_eq!(images(&pruned), images(&dry));
    let problem = farm.viewer.get(&image).await.problem(ProblemKind::NotFound).await;
    assert!(problem.detail.contains("kept for a limited time"), "{problem:?}");
    assert_eq!(images(&prune(false).await).number, 0);
}
