//! Bundles and artefacts: accepted and refused uploads.

use crate::support::{self, Answer, Farm, scene_zip};
use forelight_protocol::{Job, ProblemKind};
use reqwest::header::CONTENT_TYPE;
use reqwest::{Method, StatusCode};
use serde_json::{Value, json};

#[tokio::test(flavor = "multi_thread")]
async fn a_good_bundle_is_kept_and_rendered_from_and_a_bad_one_leaves_nothing() {
    let farm = Farm::with(|config| config.limits.bundle_bytes = 100_000).await;
    let upload = |content_type: &'static str, body: Vec<u8>| {
        let request = farm.submitter.request(Method::POST, "/v1/bundles").header("Idempotency-Key", "u");
        request.header(CONTENT_TYPE, content_type).body(body).send()
    };
    let problem = upload("application/zip", b"not a zip".to_vec())
        .await
        .unwrap()
        .problem(ProblemKind::InvalidBundle)
        .await;
    assert!(
        problem.detail.contains("bundle.zip") && !problem.detail.contains("staging"),
        "{}",
        problem.detail
    );
    upload("application/zip", vec![0; 100_001]).await.unwrap().problem(ProblemKind::TooLarge).await;
    upload("text/html", scene_zip()).await.unwrap().problem(ProblemKind::UnsupportedMediaType).await;
    let files = |folder: &str| {
        let mut count = 0;
        let mut folders = vec![farm.folder.path().join("data/artifacts").join(folder)];
        while let Some(folder) = folders.pop() {
            let Ok(entries) = std::fs::read_dir(folder) else { continue };
            for entry in entries.flatten() {
                if entry.path().is_dir() { folders.push(entry.path()) } else { count += 1 }
            }
        }
        count
    };
    assert_eq!(files(""), 0, "nothing of the refused uploads is kept");

    let bundle: Value =
        upload("application/zip", scene_zip()).await.unwrap().parsed(StatusCode::CREATED).await;
    let again: Value =
        upload("application/zip", scene_zip()).await.unwrap().parsed(StatusCode::CREATED).await;
    assert_eq!(again, bundle);
    assert_eq!(
        (bundle["scene"]["name"].as_str(), bundle["scene"]["frames"].as_u64()),
        (Some("quad"), Some(20))
    );
    assert_eq!((files("blake3"), files("staging")), (1, 0));
    let content = farm.worker.get(&format!("/v1/artifacts/{}", bundle["hash"].as_str().unwrap())).await;
    assert_eq!(content.bytes().await.unwrap(), scene_zip());

    let request = json!({"name": "from a zip", "bundle": {"id": bundle["id"]}, "frames": "0"});
    farm.submitter.post("/v1/jobs", &request).await.parsed::<Job>(StatusCode::CREATED).await;
    let node = farm.node("a").await;
    let lease = farm.next_task(&node).await;
    assert_eq!(serde_json::to_value(lease.spec.bundle()).unwrap(), json!({"artifact": bundle["hash"]}));
}

#[cfg(unix)]
#[tokio::test(flavor = "multi_thread")]
async fn links_and_dots_do_not_lead_out_of_the_bundle_roots() {
    let farm = Farm::new().await;
    let outside = farm.folder.path().join("secret");
    support::write_scene(&outside);
    let scenes = farm.folder.path().join("scenes");
    std::os::unix::fs::symlink(&outside, scenes.join("link")).unwrap();
    std::fs::write(scenes.join("broken.zip"), "not a zip").unwrap();
    for path in [scenes.join("link"), scenes.join("../secret"), outside, scenes.join("missing")] {
        let mut request = farm.job_request("0");
        request["bundle"] = json!({"path": path});
        let problem = farm.submitter.post("/v1/jobs", &request).await.problem(ProblemKind::Invalid).await;
        assert_eq!(problem.detail, "there is no such bundle under the service's bundle roots");
    }
    let mut request = farm.job_request("0");
    request["bundle"] = json!({"path": scenes.join("broken.zip")});
    let problem = farm.submitter.post("/v1/jobs", &request).await.problem(ProblemKind::InvalidBundle).await;
    assert_eq!(problem.pointer.as_deref(), Some("/bundle/path"));
    request["bundle"] = json!({"path": scenes.join("quad/../quad")});
    farm.submitter.post("/v1/jobs", &request).await.parsed::<Job>(StatusCode::CREATED).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_artefact_under_a_wrong_name_is_refused() {
    let farm = Farm::with(|config| config.limits.artifact_bytes = 1000).await;
    let put = |hash: String, body: Vec<u8>| {
        farm.worker.request(Method::PUT, &format!("/v1/artifacts/{hash}")).body(body).send()
    };
    let wrong = put("1".repeat(64), b"content".to_vec()).await.unwrap();
    wrong.problem(ProblemKind::HashMismatch).await;
    let hash = blake3::hash(b"content").to_hex().to_string();
    assert_eq!(put(hash.clone(), b"content".to_vec()).await.unwrap().status(), StatusCode::CREATED);
    assert_eq!(put(hash.clone(), b"content".to_vec()).await.unwrap().status(), StatusCode::OK);
    let long = vec![7; 1001];
    put(blake3::hash(&long).to_hex().to_string(), long).await.unwrap().problem(ProblemKind::TooLarge).await;
    let head = farm.viewer.request(Method::HEAD, &format!("/v1/artifacts/{hash}")).send().await.unwrap();
    assert_eq!((head.status(), head.headers()["content-length"].to_str().unwrap()), (StatusCode::OK, "7"));
}
