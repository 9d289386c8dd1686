//! Refused requests: malformed bundles, impossible jobs, tokens of the wrong role.

use forelight_protocol::{Bundle, Problem, ProblemKind, Role};
use forelight_tests::bundles::{shipped, zip_of, zipped};
use forelight_tests::http::{Answer, Http};
use forelight_tests::ledger::Ledger;
use forelight_tests::processes::{Service, run};
use reqwest::{Method, StatusCode};
use serde_json::json;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

#[tokio::test(flavor = "multi_thread")]
async fn a_malformed_bundle_is_refused_with_its_reason_and_leaves_nothing_behind() {
    let mut service = Service::start("serve", &[]).await;
    let http = service.http(Role::Submitter);
    let text = |text: &str| text.as_bytes().to_vec();
    let scene = |geometry: &str| {
        json!({
            "version": 1, "name": "x", "geometry": [geometry],
            "camera": {"origin": [0, 0, 3], "target": [0, 0, 0], "up": [0, 1, 0], "fov_deg": 40, "fov_axis": "x", "width": 8, "height": 8},
        })
        .to_string()
        .into_bytes()
    };
    let triangle = text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
    let good = zip_of([("scene.json", scene("a.obj")), ("a.obj", triangle.clone())]);
    let mut cut = zipped(&shipped("corridor"));
    cut.truncate(cut.len() / 2);
    let mut damaged = good.clone();
    let middle = damaged.len() / 3;
    damaged[middle] ^= 0x55;
    let bundles: [(&str, Vec<u8>, &str); 9] = [
        ("nothing", Vec::new(), "zip"),
        ("no zip", text("this is not a zip file"), "zip"),
        ("half a zip", cut, "zip"),
        ("a zip with a wrong byte", damaged, ""),
        ("an empty zip", zip_of([]), "scene.json"),
        ("a scene that is no JSON", zip_of([("scene.json", text("{"))]), "scene.json"),
        ("a scene without its geometry", zip_of([("scene.json", scene("a.obj"))]), "a.obj"),
        (
            "geometry outside",
            zip_of([("scene.json", scene("../../a.obj")), ("a.obj", triangle.clone())]),
            "..",
        ),
        (
            "a file outside",
            zip_of([("scene.json", scene("a.obj")), ("a.obj", triangle), ("../out", vec![1])]),
            "..",
        ),
    ];
    let before = files(&service.data());
    for (number, (what, zip, said)) in bundles.into_iter().enumerate() {
        for key in [None, Some(format!("key {number}"))] {
            let refused = http.upload(zip.clone(), key.as_deref()).await;
            let problem: Problem = refused.problem(ProblemKind::InvalidBundle).await;
            assert!(problem.detail.contains(said), "{what}: {}", problem.detail);
        }
    }
    // Impossible jobs leave nothing either.
    for (body, pointer) in [
        (json!({"name": "x", "bundle": {"path": "/etc"}, "frames": "0"}), "/bundle/path"),
        (
            json!({"name": "x", "bundle": {"id": "0198c0de-0000-7000-8000-000000000009"}, "frames": "0"}),
            "/bundle/id",
        ),
        (json!({"name": "x", "bundle": {}, "frames": "0"}), "/bundle"),
        (json!({"name": "x", "bundle": {"path": "/x"}, "frames": "2-1"}), "/frames"),
    ] {
        let problem = http.post("/v1/jobs", &body).await.problem(ProblemKind::Invalid).await;
        assert_eq!(problem.pointer.as_deref(), Some(pointer), "{body}");
    }
    assert_eq!(files(&service.data()), before, "a refused bundle left a file");
    service.kill();
    let rows = Ledger::of(&service.data()).await.rows().await;
    assert!(rows.values().all(|count| *count == 0), "{rows:?}");

    // The key of a refused bundle can be used for a good one.
    service.start_again().await;
    let bundle: Bundle = http.upload(good, Some("key 0")).await.parsed(StatusCode::CREATED).await;
    assert_eq!(bundle.scene.triangles, 1);
}

/// All files below a folder, except the database.
fn files(folder: &Path) -> BTreeSet<PathBuf> {
    let mut found = BTreeSet::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().path()) {
            if entry.is_dir() {
                folders.push(entry);
            } else if !entry.display().to_string().contains("forelight.sqlite") {
                found.insert(entry);
            }
        }
    }
    found
}

#[tokio::test(flavor = "multi_thread")]
async fn a_token_that_is_missing_unknown_or_of_the_wrong_role_opens_nothing() {
    let service = Service::start("serve", &[]).await;
    let nothing = "0198c0de-0000-7000-8000-000000000000";
    let hash = "0".repeat(64);
    // Forbidden roles of each operation. All others must not get status 401 or 403.
    let doors: [(Method, String, &[Role]); 14] = [
        (Method::POST, "/v1/bundles".into(), &[Role::Worker, Role::Viewer]),
        (Method::GET, format!("/v1/bundles/{nothing}"), &[]),
        (Method::POST, "/v1/jobs".into(), &[Role::Worker, Role::Viewer]),
        (Method::POST, "/v1/jobs/check".into(), &[Role::Worker, Role::Viewer]),
        (Method::GET, "/v1/jobs".into(), &[Role::Worker]),
        (Method::POST, format!("/v1/jobs/{nothing}/cancel"), &[Role::Worker, Role::Viewer]),
        (Method::GET, format!("/v1/jobs/{nothing}/frames/0/image.exr"), &[Role::Worker]),
        (Method::GET, "/v1/dashboard".into(), &[Role::Worker]),
        (Method::POST, "/v1/nodes".into(), &[Role::Submitter, Role::Viewer]),
        (Method::PATCH, format!("/v1/nodes/{nothing}"), &[Role::Submitter, Role::Viewer]),
        (Method::POST, "/v1/leases".into(), &[Role::Submitter, Role::Viewer]),
        (Method::POST, format!("/v1/leases/{nothing}/result"), &[Role::Submitter, Role::Viewer]),
        (Method::PUT, format!("/v1/artifacts/{hash}"), &[Role::Submitter, Role::Viewer]),
        (Method::GET, "/metrics".into(), &[Role::Worker]),
    ];
    let anonymous = service.anonymous();
    let stranger = Http::new(service.address(), Some("a".repeat(64)));
    for (method, path, forbidden) in &doors {
        let what = format!("{method} {path}");
        for http in [&anonymous, &stranger] {
            let response = http.request(method.clone(), path).send().await.unwrap();
            assert!(response.headers()["www-authenticate"].to_str().unwrap().starts_with("Bearer"), "{what}");
            response.problem(ProblemKind::Unauthenticated).await;
        }
        for role in Role::ALL {
            let response = service.http(role).request(method.clone(), path).send().await.unwrap();
            if forbidden.contains(&role) {
                response.problem(ProblemKind::Forbidden).await;
            } else {
                let status = response.status();
                assert!(
                    !matches!(status.as_u16(), 401 | 403) && status.as_u16() < 500,
                    "{role}: {what}: {status}"
                );
            }
        }
    }
    for path in ["/healthz", "/readyz", "/openapi.yaml"] {
        assert_eq!(anonymous.get(path).await.status(), StatusCode::OK, "{path}");
    }
    // The command line names the reason without the words of HTTP, and exits with the code for what is refused.
    let (address, bundle) = (service.address().to_owned(), shipped("corridor").display().to_string());
    let viewer = service.token_file(Role::Viewer).display().to_string();
    for (flag, token, said) in [
        ("--token", "wrong", "the service does not know this token"),
        ("--token-file", viewer.as_str(), "a viewer token does not allow this"),
    ] {
        let output = run(&["submit", &bundle, "--server", &address, flag, token]);
        let error = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.code() == Some(2) && error.contains(said), "{error}");
        assert!(!error.contains("401") && !error.contains("403"), "{error}");
    }
}
