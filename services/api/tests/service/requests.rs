//! Invalid, repeated and forbidden requests.

use std::time::Duration;

use crate::support::{Answer, Farm, Http, address};
use forelight_protocol::{Job, JobCheck, JobPage, Lease, Problem, ProblemKind};
use reqwest::header::CONTENT_TYPE;
use reqwest::{Method, StatusCode};
use serde_json::{Value, json};

#[tokio::test(flavor = "multi_thread")]
async fn a_whole_number_may_be_written_with_a_point_and_any_other_fraction_may_not() {
    let farm = Farm::new().await;
    let text = |samples: &str| {
        let mut request = farm.job_request("0");
        request["samples"] = json!("here");
        request.to_string().replace("\"here\"", samples)
    };
    for (samples, status) in [
        ("64.0", StatusCode::CREATED),
        ("6.4e1", StatusCode::CREATED),
        ("64.5", StatusCode::UNPROCESSABLE_ENTITY),
        ("1e300", StatusCode::UNPROCESSABLE_ENTITY),
        ("-64.0", StatusCode::UNPROCESSABLE_ENTITY),
    ] {
        let request =
            farm.submitter.request(Method::POST, "/v1/jobs").header(CONTENT_TYPE, "application/json");
        let answer = request.body(text(samples)).send().await.unwrap();
        assert_eq!(answer.status(), status, "{samples}");
        if status == StatusCode::UNPROCESSABLE_ENTITY {
            assert_eq!(answer.problem(ProblemKind::Invalid).await.pointer.as_deref(), Some("/samples"));
        } else {
            assert_eq!(answer.parsed::<Job>(status).await.samples, 64);
        }
    }
}

/// Variants of a good job request, with the wrong field and a part of the error. An empty text means that the
/// variant is good.
fn job_requests(good: &Value) -> Vec<(Value, &'static str, &'static str)> {
    let with = |pointer: &str, value: Value| {
        let mut request = good.clone();
        let (parent, key) = pointer.rsplit_once('/').unwrap();
        request.pointer_mut(parent).unwrap()[key] = value;
        request
    };
    let mut without_frames = good.clone();
    without_frames.as_object_mut().unwrap().remove("frames");
    let mut settings = good.clone();
    settings["settings"] = json!({});
    let set = |key: &str, value: Value| {
        let mut request = settings.clone();
        request["settings"][key] = value;
        request
    };
    let together = |settings: Value| with("/settings", settings);
    vec![
        (with("/name", json!("")), "/name", "1 to 200"),
        (with("/name", json!("a\u{7}")), "/name", "control"),
        (with("/name", json!("x".repeat(201))), "/name", "1 to 200"),
        (with("/name", json!(7)), "/name", "invalid type"),
        (with("/confidence", json!(null)), "/confidence", "none of the values"),
        (with("/confidence", json!(0.8)), "/confidence", "none of the values"),
        (with("/project", json!(" ")), "/project", "1 to 200"),
        (with("/frames", json!("0-x")), "/frames", "`0-x`"),
        (with("/frames", json!("3-1")), "/frames", "ends before"),
        (with("/frames", json!("0-20")), "/frames", "frames 0 to 19"),
        (with("/frames", json!("0-4294967295")), "/frames", "at most 10000"),
        (without_frames, "", "missing field `frames`"),
        (with("/bundle", json!({})), "/bundle", "exactly one"),
        (with("/bundle/id", json!("0197a8a5-0000-7000-8000-000000000000")), "/bundle", "exactly one"),
        (
            with("/bundle", json!({"id": "0197a8a5-0000-7000-8000-000000000000"})),
            "/bundle/id",
            "no such bundle",
        ),
        (with("/bundle", json!({"id": "x"})), "/bundle/id", "UUID"),
        (with("/bundle", json!({"url": "x"})), "/bundle/url", "unknown field"),
        (with("/bundle/path", json!("/etc")), "/bundle/path", "bundle roots"),
        (with("/bundle/path", json!("quad")), "/bundle/path", "bundle roots"),
        (with("/samples", json!(3)), "/samples", "16 to 1000000"),
        (with("/samples", json!(-3)), "/samples", "u32"),
        (with("/profile_frames", json!(0)), "/profile_frames", "1 to 1000"),
        (with("/deadline", json!("tomorrow")), "/deadline", "RFC 3339"),
        (with("/deadline", json!("2020-01-01T00:00:00Z")), "/deadline", "has passed"),
        (with("/deadline", json!("2205-01-01T00:00:00Z")), "/deadline", "is more than ten years away"),
        (with("/budget", json!(-1)), "/budget", "-1"),
        (with("/budget", json!(0.5)), "/budget", "0.5"),
        (with("/confidence", json!("p99")), "/confidence", "p99"),
        (with("/priority", json!(1001)), "/priority", "1000"),
        (with("/colour", json!("blue")), "/colour", "unknown field"),
        (set("width", json!(0)), "/settings/width", "1 to 65536"),
        (set("width", json!(65_536)), "", ""),
        (set("spp", json!(0)), "/settings/spp", "1 to"),
        (set("materials", json!("shiny")), "/settings/materials", "shiny"),
        (set("gamma", json!(2.2)), "/settings/gamma", "unknown field"),
        (set("max_depth", json!(65)), "/settings/max_depth", "1 to 64"),
        (set("ambient_bounces", json!(9)), "/settings/ambient_bounces", "0 to 8"),
        (set("integrator", json!("photons")), "/settings/integrator", "photons"),
        (set("cache", json!("maybe")), "/settings/cache", "maybe"),
        (set("cache_accuracy", json!(9)), "/settings/cache_accuracy", "10 to 1000"),
        (set("cache_rays", json!(47)), "/settings/cache_rays", "48 to 65536"),
        (together(json!({"cache": "on", "ambient_bounces": 9})), "/settings/ambient_bounces", "0 to 8"),
        (together(json!({"cache": "on", "ambient_bounces": 8})), "", ""),
        (together(json!({"cache": "on", "integrator": "path"})), "/settings/cache", "`path`"),
        (together(json!({"cache": "on", "cache_accuracy": 100, "cache_rays": 192})), "", ""),
        (together(json!({"integrator": "path", "ambient_bounces": 65536})), "", ""),
    ]
}

#[tokio::test(flavor = "multi_thread")]
async fn every_malformed_job_is_told_which_field_is_wrong_and_nothing_is_kept() {
    let farm = Farm::new().await;
    for (request, pointer, text) in job_requests(&farm.job_request("0-3")) {
        for path in ["/v1/jobs/check", "/v1/jobs"] {
            let response = farm.submitter.post(path, &request).await;
            if text.is_empty() {
                // 65,536 × 8 pixels are allowed: some good variants prove that the table can fail.
                assert!(response.status().is_success());
                continue;
            }
            let problem = response.problem(ProblemKind::Invalid).await;
            assert_eq!(problem.pointer.as_deref(), Some(pointer), "{request}: {}", problem.detail);
            assert!(problem.detail.contains(text), "{request}: {}", problem.detail);
        }
    }
    let page: JobPage = farm.viewer.get("/v1/jobs").await.parsed(StatusCode::OK).await;
    assert_eq!(page.items.len(), 4, "only the good ones were kept");
}

#[tokio::test(flavor = "multi_thread")]
async fn bodies_that_are_not_what_they_should_be_are_refused_by_kind() {
    let farm = Farm::with(|config| config.limits.request_bytes = 2000).await;
    let send = |content_type: &'static str, body: Vec<u8>| {
        farm.submitter.request(Method::POST, "/v1/jobs").header(CONTENT_TYPE, content_type).body(body).send()
    };
    let json = "application/json";
    for (content_type, body, kind) in [
        (json, b"{".to_vec(), ProblemKind::Malformed),
        (json, b"".to_vec(), ProblemKind::Malformed),
        (json, b"\xff\xfe".to_vec(), ProblemKind::Malformed),
        (json, b"[1, 2".to_vec(), ProblemKind::Malformed),
        (json, b"[]".to_vec(), ProblemKind::Invalid),
        (json, "[".repeat(1900).into_bytes(), ProblemKind::Malformed),
        (json, vec![b' '; 3000], ProblemKind::TooLarge),
        ("text/plain", b"{}".to_vec(), ProblemKind::UnsupportedMediaType),
    ] {
        let shown = String::from_utf8_lossy(&body).chars().take(20).collect::<String>();
        eprintln!("{content_type} {shown}");
        send(content_type, body).await.unwrap().problem(kind).await;
    }
    // Without an announced length, the limit is found while reading.
    let pieces = futures::stream::iter((0..4).map(|_| Ok::<_, std::io::Error>(vec![b' '; 1000])));
    let streamed = farm.submitter.request(Method::POST, "/v1/jobs").header(CONTENT_TYPE, json);
    streamed
        .body(reqwest::Body::wrap_stream(pieces))
        .send()
        .await
        .unwrap()
        .problem(ProblemKind::TooLarge)
        .await;
    let trailing = format!("{} x", farm.job_request("0"));
    send(json, trailing.into_bytes()).await.unwrap().problem(ProblemKind::Malformed).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn addresses_methods_and_parameters_that_lead_nowhere_are_problems_too() {
    let farm = Farm::new().await;
    let job = farm.submit("0-3").await;
    let nothing = "0197a8a5-0000-7000-8000-000000000000";
    for path in [
        "/nothing".to_owned(),
        "/v2/jobs".to_owned(),
        "/v1/jobs/x".to_owned(),
        format!("/v1/jobs/{nothing}"),
        format!("/v1/jobs/{nothing}/frames"),
        format!("/v1/jobs/{nothing}/events"),
        format!("/v1/jobs/{nothing}/forecast"),
        format!("/v1/jobs/{}/frames/9", job.id),
        format!("/v1/jobs/{}/frames/-1", job.id),
        format!("/v1/jobs/{}/frames/0/image.exr", job.id),
        format!("/v1/plans/{nothing}"),
        format!("/v1/bundles/{nothing}"),
        format!("/v1/artifacts/{}", "0".repeat(64)),
        "/v1/artifacts/..%2f..%2fforelight.sqlite".to_owned(),
    ] {
        farm.operator.get(&path).await.problem(ProblemKind::NotFound).await;
    }
    let refused = farm.operator.request(Method::DELETE, "/v1/jobs").send().await.unwrap();
    assert!(refused.headers().contains_key("allow"));
    refused.problem(ProblemKind::MethodNotAllowed).await;
    farm.viewer.get(&format!("/v1/jobs/{}/forecast", job.id)).await.problem(ProblemKind::Conflict).await;
    for (query, parameter) in [
        ("page_size=0", "page_size"),
        ("page_size=201", "page_size"),
        ("page_size=many", "page_size"),
        ("page_token=zz", "page_token"),
        ("state=sleeping", "state"),
        ("stat=done", "stat"),
    ] {
        let problem = farm.viewer.get(&format!("/v1/jobs?{query}")).await.problem(ProblemKind::Invalid).await;
        assert_eq!(problem.parameter.as_deref(), Some(parameter), "{query}: {}", problem.detail);
    }
    let reason = async |path: String| farm.viewer.get(&path).await.json::<Problem>().await.unwrap().detail;
    let explained = format!("/v1/jobs/{}/explanation", job.id);
    for (path, said) in [
        (format!("{explained}?frame=-1"), "frame: `-1` is not a whole number from 0 to 4294967295"),
        (format!("{explained}?fame=1"), "fame: unknown field `fame`, expected `frame`"),
        ("/v1/jobs?page_size=many".to_owned(), "page_size: `many` is not a whole number from 1 to 200"),
        (
            format!("/v1/jobs/{}/frames/one/image.png", job.id),
            "this address does not exist: `one` is not a valid id or number",
        ),
    ] {
        assert_eq!(reason(path).await, said);
    }
    for (header, said) in
        [("Basic YTpi", "only bearer tokens"), ("Bearer", "no token"), ("Bearer ", "no token")]
    {
        let asked = farm.nobody.request(Method::GET, "/v1/jobs").header("authorization", header);
        let problem = asked.send().await.unwrap().problem(ProblemKind::Unauthenticated).await;
        assert!(problem.detail.contains(said), "{header}: {}", problem.detail);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn every_role_may_do_what_it_is_for_and_nothing_else() {
    let farm = Farm::new().await;
    let job = farm.submit("0").await;
    let node = farm.node("a").await;
    let id = job.id;
    let nothing = "0197a8a5-0000-7000-8000-000000000000";
    // All bodies are empty objects. Forbidden callers are refused before the body is read; others learn that
    // it is invalid.
    let table: [(Method, String, &str); 43] = [
        (Method::POST, "/v1/sessions/codes".into(), "s-ov"),
        (Method::GET, "/v1/sessions/current".into(), "s-ov"),
        (Method::DELETE, "/v1/sessions/current".into(), "s-ov"),
        (Method::GET, "/v1/sessions".into(), "--o-"),
        (Method::DELETE, format!("/v1/sessions/{nothing}"), "--o-"),
        (Method::POST, "/v1/bundles".into(), "s-o-"),
        (Method::GET, format!("/v1/bundles/{nothing}"), "swov"),
        (Method::POST, "/v1/jobs".into(), "s-o-"),
        (Method::POST, "/v1/jobs/check".into(), "s-o-"),
        (Method::POST, format!("/v1/jobs/{nothing}/cancel"), "s-o-"),
        (Method::PATCH, format!("/v1/jobs/{nothing}"), "s-o-"),
        (Method::POST, format!("/v1/jobs/{nothing}/accept"), "s-o-"),
        (Method::POST, format!("/v1/jobs/{nothing}/frames/retry"), "s-o-"),
        (Method::POST, format!("/v1/jobs/{nothing}/frames/cancel"), "s-o-"),
        (Method::POST, "/v1/plans/what-if".into(), "s-ov"),
        (Method::GET, "/v1/jobs".into(), "s-ov"),
        (Method::GET, format!("/v1/jobs/{id}"), "s-ov"),
        (Method::GET, format!("/v1/jobs/{id}/frames"), "s-ov"),
        (Method::GET, format!("/v1/jobs/{id}/forecast"), "s-ov"),
        (Method::GET, format!("/v1/jobs/{id}/frames/0/image.png"), "s-ov"),
        (Method::GET, format!("/v1/plans/{nothing}"), "s-ov"),
        (Method::GET, "/v1/bookings".into(), "s-ov"),
        (Method::GET, "/v1/forecasts/track-record".into(), "s-ov"),
        (Method::POST, "/v1/webhooks".into(), "--o-"),
        (Method::GET, "/v1/webhooks".into(), "--o-"),
        (Method::DELETE, format!("/v1/webhooks/{nothing}"), "--o-"),
        (Method::POST, format!("/v1/webhooks/{nothing}/test"), "--o-"),
        (Method::GET, format!("/v1/webhooks/{nothing}/deliveries"), "--o-"),
        (Method::GET, "/v1/dashboard".into(), "s-ov"),
        (Method::GET, "/v1/timeline".into(), "s-ov"),
        (Method::GET, format!("/v1/jobs/{id}/strip"), "s-ov"),
        (Method::GET, "/metrics".into(), "s-ov"),
        (Method::GET, "/v1/nodes".into(), "swov"),
        (Method::POST, "/v1/nodes".into(), "-wo-"),
        (Method::PATCH, format!("/v1/nodes/{}", node.id), "-wo-"),
        (Method::POST, "/v1/join-tokens".into(), "--o-"),
        (Method::GET, format!("/v1/tasks/{nothing}/log"), "s-ov"),
        (Method::POST, "/v1/leases".into(), "-wo-"),
        (Method::PATCH, format!("/v1/leases/{nothing}"), "-wo-"),
        (Method::POST, format!("/v1/leases/{nothing}/release"), "-wo-"),
        (Method::POST, format!("/v1/leases/{nothing}/result"), "-wo-"),
        (Method::PUT, format!("/v1/artifacts/{}", "0".repeat(64)), "-wo-"),
        (Method::GET, format!("/v1/artifacts/{}", "0".repeat(64)), "swov"),
    ];
    let clients = [('s', &farm.submitter), ('w', &farm.worker), ('o', &farm.operator), ('v', &farm.viewer)];
    for (method, path, allowed) in table {
        let refused = farm.nobody.request(method.clone(), &path).json(&json!({})).send().await.unwrap();
        assert!(refused.headers()["www-authenticate"].to_str().unwrap().starts_with("Bearer"), "{path}");
        refused.problem(ProblemKind::Unauthenticated).await;
        for (letter, client) in clients {
            let response = client.request(method.clone(), &path).json(&json!({})).send().await.unwrap();
            let status = response.status();
            let forbidden = status == StatusCode::FORBIDDEN;
            assert_eq!(!forbidden, allowed.contains(letter), "{method} {path} as {letter}: {status}");
            assert!(
                status != StatusCode::UNAUTHORIZED && !status.is_server_error(),
                "{method} {path} as {letter}: {status}"
            );
        }
    }
    let stranger = Http::new(&address(&farm.service), Some("forelight_0000".into()));
    let refused = stranger.get("/v1/jobs").await;
    assert!(refused.headers()["www-authenticate"].to_str().unwrap().contains("invalid_token"));
    refused.problem(ProblemKind::Unauthenticated).await;
    for path in ["/healthz", "/readyz", "/openapi.yaml"] {
        assert_eq!(farm.nobody.get(path).await.status(), StatusCode::OK, "{path}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_repeated_submission_is_one_job_and_a_reused_key_is_refused() {
    let farm = Farm::new().await;
    let submit = |client: &Http, key: &str, body: Value| {
        client.request(Method::POST, "/v1/jobs").header("Idempotency-Key", key).json(&body).send()
    };
    let first: Job = submit(&farm.submitter, "k", farm.job_request("0-3"))
        .await
        .unwrap()
        .parsed(StatusCode::CREATED)
        .await;
    let farm = farm.killed_and_restarted().await;
    let again = submit(&farm.submitter, "k", farm.job_request("0-3")).await.unwrap();
    assert_eq!(again.headers()["idempotency-replayed"], "true");
    let again: Job = again.parsed(StatusCode::CREATED).await;
    assert_eq!(again, first);
    let problem = submit(&farm.submitter, "k", farm.job_request("0-4")).await.unwrap();
    let problem = problem.problem(ProblemKind::IdempotencyKeyReused).await;
    assert_eq!(problem.parameter.as_deref(), Some("Idempotency-Key"));
    let other: Job =
        submit(&farm.operator, "k", farm.job_request("0-3")).await.unwrap().parsed(StatusCode::CREATED).await;
    assert_ne!(other.id, first.id, "keys of different tokens have nothing to do with each other");
    let problem = submit(&farm.submitter, &"k".repeat(256), farm.job_request("0")).await.unwrap();
    problem.problem(ProblemKind::Malformed).await;
    // A refused request leaves no trace: its key can be used again with a corrected request.
    submit(&farm.submitter, "m", farm.job_request("0-99")).await.unwrap().problem(ProblemKind::Invalid).await;
    submit(&farm.submitter, "m", farm.job_request("0-9"))
        .await
        .unwrap()
        .parsed::<Job>(StatusCode::CREATED)
        .await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_request_that_is_being_worked_on_is_not_begun_again() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let claim = || {
        let request = farm.worker.request(Method::POST, "/v1/leases").header("Idempotency-Key", "c");
        request.json(&json!({"node_id": node.id, "wait_ms": 50_000})).send()
    };
    let (waiting, second) = tokio::join!(claim(), async {
        farm.until_heard_of_since(&node).await;
        let second = claim().await.unwrap();
        farm.submit("0").await;
        second
    });
    assert_eq!(second.headers()["retry-after"], "1");
    second.problem(ProblemKind::IdempotencyInFlight).await;
    let lease: Value = waiting.unwrap().parsed(StatusCode::OK).await;
    let repeated: Value = claim().await.unwrap().parsed(StatusCode::OK).await;
    assert_eq!(repeated, lease, "the same claim has the same lease");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_process_that_was_started_twice_for_a_task_waits_for_the_first_and_is_told_when_it_is_needless() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    farm.submit("0").await;
    let first = farm.claim(&node).await.unwrap();
    let by_id = async |task: &str, wait_ms: u32| {
        let request = json!({"node_id": node.id, "wait_ms": wait_ms, "task_id": task});
        farm.worker.post("/v1/leases", &request).await
    };
    let task = first.task_id.to_string();
    assert_eq!(by_id(&task, 0).await.status(), StatusCode::NO_CONTENT);
    let (second, _) = tokio::join!(by_id(&task, 50_000), async {
        tokio::time::sleep(Duration::from_millis(200)).await;
        let release = format!("/v1/leases/{}/release", first.lease_id);
        farm.worker.post(&release, &json!({"fence": first.fence})).await
    });
    let second: Lease = second.parsed(StatusCode::OK).await;
    assert_eq!((second.task_id, second.fence), (first.task_id, first.fence + 1));
    farm.fail_without_bundle(&second).await;
    by_id(&task, 10_000).await.problem(ProblemKind::Conflict).await;
    by_id("0197a8a5-0000-7000-8000-000000000000", 0).await.problem(ProblemKind::NotFound).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn pages_of_jobs_lead_through_all_of_them_once() {
    let farm = Farm::new().await;
    let mut ids = Vec::new();
    for _ in 0..5 {
        ids.push(farm.submit("0").await.id);
    }
    ids.reverse();
    let (mut seen, mut query) = (Vec::new(), "page_size=2".to_owned());
    loop {
        let page: JobPage =
            farm.viewer.get(&format!("/v1/jobs?{query}&state=previewing")).await.parsed(StatusCode::OK).await;
        assert!(page.items.len() <= 2);
        seen.extend(page.items.iter().map(|job| job.id));
        match page.next_page_token {
            Some(token) => query = format!("page_size=2&page_token={token}"),
            None => break,
        }
    }
    assert_eq!(seen, ids);
}

#[tokio::test(flavor = "multi_thread")]
async fn checking_a_job_says_what_it_would_be_and_keeps_nothing() {
    let farm = Farm::new().await;
    let check: JobCheck = farm
        .submitter
        .post("/v1/jobs/check", &farm.job_request("0,5,9-12"))
        .await
        .parsed(StatusCode::OK)
        .await;
    assert_eq!(
        (check.frames_total, check.settings.own().unwrap().width, check.scene.name.as_str()),
        (6, 8, "quad")
    );
    let page: JobPage = farm.viewer.get("/v1/jobs").await.parsed(StatusCode::OK).await;
    assert!(page.items.is_empty());
}
