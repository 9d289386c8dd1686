//! Quotas of projects and tokens.

use crate::support::{Answer, Farm, scene_zip};
use forelight_protocol::{Job, JobState, ProblemKind, QuotaList};
use reqwest::{Method, StatusCode};
use serde_json::{Value, json};

async fn set(farm: &Farm, quota: Value) -> QuotaList {
    farm.operator.post("/v1/quotas", &quota).await.parsed(StatusCode::OK).await
}

#[tokio::test(flavor = "multi_thread")]
async fn a_project_and_a_token_have_so_many_open_jobs_and_are_told_what_to_do() {
    let farm = Farm::new().await;
    set(&farm, json!({"project": "default", "open_jobs": 2})).await;
    let first = farm.submit("0").await;
    farm.submit("0").await;
    farm.submitter
        .post("/v1/jobs/check", &farm.job_request("0"))
        .await
        .problem(ProblemKind::QuotaExceeded)
        .await;
    let refused = farm.submitter.post("/v1/jobs", &farm.job_request("0")).await;
    let refused = refused.problem(ProblemKind::QuotaExceeded).await;
    for part in
        ["project default may have 2 open jobs and has 2", "cancel some", "forelight quota --project default"]
    {
        assert!(refused.detail.contains(part), "{part}: {}", refused.detail);
    }
    farm.submitter.post(&format!("/v1/jobs/{}/cancel", first.id), &json!({})).await;
    farm.submit("0").await;
    // More for the project, and less for the token, whose jobs of all projects count.
    set(&farm, json!({"project": "default", "open_jobs": 9})).await;
    let quotas = set(&farm, json!({"token": "submitter", "open_jobs": 2})).await;
    assert_eq!(quotas.items.iter().map(|item| item.used_open_jobs).collect::<Vec<_>>(), [2, 2]);
    let refused = farm.submitter.post("/v1/jobs", &farm.job_request("0")).await;
    let refused = refused.problem(ProblemKind::QuotaExceeded).await;
    assert!(refused.detail.contains("token submitter"), "{}", refused.detail);
    let other: Job =
        farm.operator.post("/v1/jobs", &farm.job_request("0")).await.parsed(StatusCode::CREATED).await;
    assert_eq!(other.project, "default");
    // A quota that limits nothing is gone.
    assert_eq!(set(&farm, json!({"token": "submitter"})).await.items.len(), 1);
    farm.submit("0").await;
}

#[tokio::test(flavor = "multi_thread")]
async fn jobs_that_are_over_are_opened_again_as_far_as_a_quota_allows() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let jobs = [farm.submit("0").await, farm.submit("0").await];
    for job in &jobs {
        assert_eq!(farm.work_off(&node, job).await.state, JobState::Done);
    }
    set(&farm, json!({"project": "default", "open_jobs": 1})).await;
    let retry = async |job: &Job| {
        farm.submitter.post(&format!("/v1/jobs/{}/frames/retry", job.id), &json!({"frames": "0"})).await
    };
    assert_eq!(retry(&jobs[0]).await.status(), StatusCode::OK);
    retry(&jobs[1]).await.problem(ProblemKind::QuotaExceeded).await;
    assert_eq!(farm.job(&jobs[1]).await.state, JobState::Done);
    // Frames of a job that is open are no further job.
    assert_eq!(retry(&jobs[0]).await.status(), StatusCode::OK);
}

#[tokio::test(flavor = "multi_thread")]
async fn files_that_do_not_fit_into_a_quota_are_refused_before_they_are_made() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let job = farm.submit("0-3").await;
    farm.work_off(&node, &job).await;
    let quotas = set(&farm, json!({"project": "default", "storage_bytes": 1_u64 << 40})).await;
    let used = quotas.items[0].used_storage_bytes;
    assert!(used > 0);
    // Two frames of 8 × 8 pixels at 35 bytes each.
    set(&farm, json!({"project": "default", "storage_bytes": used + 2 * 64 * 35})).await;
    for path in ["/v1/jobs/check", "/v1/jobs"] {
        let refused = farm.submitter.post(path, &farm.job_request("0-2")).await;
        let refused = refused.problem(ProblemKind::QuotaExceeded).await;
        assert!(refused.detail.contains("forelight delete"), "{}", refused.detail);
    }
    farm.submit("0-1").await;
    // The open job will write two frames.
    for path in ["/v1/jobs/check", "/v1/jobs"] {
        let refused = farm.submitter.post(path, &farm.job_request("0")).await;
        let refused = refused.problem(ProblemKind::QuotaExceeded).await;
        assert!(refused.detail.contains("its open jobs will write about 4480"), "{}", refused.detail);
    }
    let zip = scene_zip();
    set(&farm, json!({"token": "submitter", "storage_bytes": zip.len() - 1})).await;
    farm.submitter.upload(zip.clone(), None).await.problem(ProblemKind::QuotaExceeded).await;
    // In chunks, without a length.
    let chunks = reqwest::Body::wrap_stream(futures::stream::iter([Ok::<_, std::io::Error>(zip.clone())]));
    let sent = farm.submitter.request(Method::POST, "/v1/bundles").header("content-type", "application/zip");
    sent.body(chunks).send().await.unwrap().problem(ProblemKind::QuotaExceeded).await;
    set(&farm, json!({"token": "submitter", "storage_bytes": 1 << 30})).await;
    assert_eq!(farm.submitter.upload(zip, None).await.status(), StatusCode::CREATED);
}

#[tokio::test(flavor = "multi_thread")]
async fn uploads_at_the_same_time_do_not_exceed_a_quota_together() {
    let farm = Farm::new().await;
    let zip = |comment: &str| {
        let mut zip = zip::ZipWriter::new_append(std::io::Cursor::new(scene_zip())).unwrap();
        zip.set_comment(comment);
        zip.finish().unwrap().into_inner()
    };
    let (before, size) =
        (set(&farm, json!({"token": "submitter", "storage_bytes": 1 << 30})).await, zip("a").len());
    let used = before.items[0].used_storage_bytes as usize;
    set(&farm, json!({"token": "submitter", "storage_bytes": used + size + size / 2})).await;
    let uploads = ["a", "b", "c", "d"].map(|comment| farm.submitter.upload(zip(comment), None));
    let answers = futures::future::join_all(uploads).await;
    let created = answers.iter().filter(|answer| answer.status() == StatusCode::CREATED);
    assert_eq!(created.count(), 1);
    for refused in answers.into_iter().filter(|answer| answer.status() != StatusCode::CREATED) {
        refused.problem(ProblemKind::QuotaExceeded).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn quotas_are_set_by_operators_and_seen_by_those_whom_they_concern() {
    let farm = Farm::new().await;
    for project in ["film", "ads"] {
        farm.project(project).await;
        set(&farm, json!({"project": project, "open_jobs": 5})).await;
    }
    let (anna, _) = farm.new_token(json!({"name": "anna", "projects": {"film": "submitter"}})).await;
    for token in ["anna", "bert"] {
        set(&farm, json!({"token": token, "open_jobs": 5})).await;
    }
    let seen: QuotaList = anna.json("/v1/quotas").await;
    let names =
        seen.items.iter().map(|item| item.allowed.project.clone().or(item.allowed.token.clone()).unwrap());
    assert_eq!(names.collect::<Vec<_>>(), ["film", "anna"]);
    assert_eq!(farm.viewer.json::<QuotaList>("/v1/quotas").await.items.len(), 4);
    farm.submitter
        .post("/v1/quotas", &json!({"project": "film", "open_jobs": 9}))
        .await
        .problem(ProblemKind::Forbidden)
        .await;
    for (wrong, pointer) in [
        (json!({"open_jobs": 1}), ""),
        (json!({"project": "a", "token": "b"}), ""),
        (json!({"project": ""}), "/project"),
        (json!({"project": "flim", "open_jobs": 1}), "/project"),
        (json!({"project": "a", "open_jobs": 1_000_001}), "/open_jobs"),
        (json!({"token": "a", "storage_bytes": u64::MAX}), "/storage_bytes"),
    ] {
        let refused = farm.operator.post("/v1/quotas", &wrong).await.problem(ProblemKind::Invalid).await;
        assert_eq!(refused.pointer.as_deref(), Some(pointer), "{wrong}");
    }
}
