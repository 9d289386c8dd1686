//! Signing in with a browser.

use crate::support::events::Events;
use crate::support::{Answer, Farm, Http, PATIENCE, address};
use forelight_protocol::{Job, JobPage, ProblemKind, Role, Session, SessionCode, SessionPage, Timestamp};
use reqwest::{Method, RequestBuilder, Response, StatusCode};
use serde_json::{Value, json};

const MINUTE: i64 = 60_000_000;

/// A browser with the cookie of a session, on a page of the farm.
struct Browser {
    http: Http,
    cookie: String,
    session: Session,
}

impl Browser {
    async fn new(farm: &Farm, request: &Value) -> Self {
        let answer = sign_in(farm, request).await;
        assert_eq!(answer.headers()["cache-control"], "no-store");
        let cookie = answer.headers()["set-cookie"].to_str().unwrap().to_owned();
        let session = answer.parsed(StatusCode::CREATED).await;
        Self { http: farm.nobody.clone(), cookie, session }
    }

    /// A request of the farm's own page.
    fn request(&self, method: Method, path: &str) -> RequestBuilder {
        self.from(method, path, &[("sec-fetch-site", "same-origin")])
    }

    fn from(&self, method: Method, path: &str, headers: &[(&str, &str)]) -> RequestBuilder {
        let cookie = self.cookie.split(';').next().unwrap();
        let request = self.http.request(method, path).header("cookie", cookie);
        headers.iter().fold(request, |request, (name, value)| request.header(*name, *value))
    }

    async fn get(&self, path: &str) -> Response {
        self.request(Method::GET, path).send().await.unwrap()
    }
}

async fn sign_in(farm: &Farm, request: &Value) -> Response {
    farm.nobody.post("/v1/sessions", request).await
}

async fn code(http: &Http) -> SessionCode {
    http.post("/v1/sessions/codes", &()).await.parsed(StatusCode::CREATED).await
}

async fn browser_of(farm: &Farm, http: &Http) -> Browser {
    let code = code(http).await.code;
    Browser::new(farm, &json!({"code": code})).await
}

#[tokio::test(flavor = "multi_thread")]
async fn a_code_signs_in_once_with_the_rights_of_the_one_who_asked_for_it() {
    let farm = Farm::new().await;
    let first = code(&farm.viewer).await;
    let browser = Browser::new(&farm, &json!({"code": first.code})).await;
    for part in ["HttpOnly", "SameSite=Strict", "Path=/", "Max-Age=604800"] {
        assert!(browser.cookie.split("; ").any(|it| it == part), "{part}: {}", browser.cookie);
    }
    assert!(!browser.cookie.contains("Secure"), "this service is not behind TLS: {}", browser.cookie);
    assert_eq!((browser.session.role, browser.session.name.as_str()), (Role::Viewer, "viewer"));
    let current: Session = browser.get("/v1/sessions/current").await.parsed(StatusCode::OK).await;
    assert_eq!(current, browser.session);
    browser.get("/v1/jobs").await.parsed::<JobPage>(StatusCode::OK).await;
    let refused = sign_in(&farm, &json!({"code": first.code})).await;
    assert!(!refused.headers().contains_key("set-cookie"));
    refused.problem(ProblemKind::Unauthenticated).await;
    // A session can ask for a code for another browser.
    let other = browser.request(Method::POST, "/v1/sessions/codes").send().await.unwrap();
    let other: SessionCode = other.parsed(StatusCode::CREATED).await;
    let other = Browser::new(&farm, &json!({"code": other.code})).await;
    assert_eq!(other.session.role, Role::Viewer);
    assert_ne!(other.session.id, browser.session.id);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_token_signs_in_too_but_not_a_workers() {
    let farm = Farm::new().await;
    let make = async |role| {
        forelight_store::tokens::create(farm.service.store(), role, "anna", Timestamp::now()).await.unwrap()
    };
    let browser = Browser::new(&farm, &json!({"token": make(Role::Submitter).await})).await;
    assert_eq!(browser.session.role, Role::Submitter);
    let worker = sign_in(&farm, &json!({"token": make(Role::Worker).await})).await;
    worker.problem(ProblemKind::Forbidden).await;
    farm.worker.post("/v1/sessions/codes", &()).await.problem(ProblemKind::Forbidden).await;
    farm.nobody.post("/v1/sessions/codes", &()).await.problem(ProblemKind::Unauthenticated).await;
    for wrong in [json!({}), json!({"code": "a", "token": "b"}), json!({"password": "x"}), json!({"code": 7})]
    {
        sign_in(&farm, &wrong).await.problem(ProblemKind::Invalid).await;
    }
    // With a bearer token there is somebody, but no session.
    let current: Session = farm.operator.get("/v1/sessions/current").await.parsed(StatusCode::OK).await;
    assert_eq!((current.role, current.id, current.expires_at), (Role::Operator, None, None));
    let end = farm.operator.request(Method::DELETE, "/v1/sessions/current").send().await.unwrap();
    end.problem(ProblemKind::Conflict).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_session_does_what_its_role_may_and_no_more() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let viewer = browser_of(&farm, &farm.viewer).await;
    let path = format!("/v1/nodes/{}", node.id);
    for (method, path) in
        [(Method::PATCH, path.as_str()), (Method::POST, "/v1/jobs"), (Method::POST, "/v1/join-tokens")]
    {
        let refused = viewer.request(method, path).json(&json!({})).send().await.unwrap();
        refused.problem(ProblemKind::Forbidden).await;
    }
    viewer.get("/v1/sessions").await.problem(ProblemKind::Forbidden).await;
    let operator = browser_of(&farm, &farm.operator).await;
    let drained = operator.request(Method::PATCH, &path).json(&json!({"drain": true})).send().await.unwrap();
    assert_eq!(drained.status(), StatusCode::OK);
    let submitter = browser_of(&farm, &farm.submitter).await;
    let submitted = submitter.request(Method::POST, "/v1/jobs").json(&farm.job_request("0")).send().await;
    submitted.unwrap().parsed::<Job>(StatusCode::CREATED).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_page_of_another_site_changes_nothing() {
    let farm = Farm::new().await;
    let operator = browser_of(&farm, &farm.operator).await;
    let host = address(&farm.service);
    let elsewhere: [&[(&str, &str)]; 7] = [
        &[],
        &[("sec-fetch-site", "cross-site")],
        &[("sec-fetch-site", "same-site"), ("origin", &host)],
        &[("sec-fetch-site", "none")],
        &[("origin", "https://evil.example")],
        &[("origin", "null")],
        &[("origin", "http://127.0.0.1:1")],
    ];
    for headers in elsewhere {
        for (method, path) in [
            (Method::POST, "/v1/jobs"),
            (Method::POST, "/v1/sessions/codes"),
            (Method::DELETE, "/v1/sessions/current"),
            (Method::POST, "/v1/budgets"),
        ] {
            let request = operator.from(method, path, headers).json(&farm.job_request("0"));
            request.send().await.unwrap().problem(ProblemKind::CrossSite).await;
        }
    }
    let jobs: JobPage = farm.viewer.get("/v1/jobs").await.parsed(StatusCode::OK).await;
    assert!(jobs.items.is_empty(), "a job came from another site");
    // A browser that sends no `Sec-Fetch-Site` says where its page is from.
    let same = operator.from(Method::POST, "/v1/jobs", &[("origin", &host)]).json(&farm.job_request("0"));
    same.send().await.unwrap().parsed::<Job>(StatusCode::CREATED).await;
    // Nobody is signed in by another site either, and a bearer token needs no origin.
    let code = code(&farm.viewer).await.code;
    let request = farm.nobody.request(Method::POST, "/v1/sessions").header("sec-fetch-site", "cross-site");
    request.json(&json!({"code": code})).send().await.unwrap().problem(ProblemKind::CrossSite).await;
    let bearer = farm.submitter.request(Method::POST, "/v1/jobs").header("sec-fetch-site", "cross-site");
    let bearer = bearer.json(&farm.job_request("0")).send().await.unwrap();
    assert_eq!(bearer.status(), StatusCode::CREATED);
}

#[tokio::test(flavor = "multi_thread")]
async fn sessions_and_codes_end_with_time() {
    let (farm, clock) = Farm::with_clock().await;
    let late = code(&farm.viewer).await;
    let browser = browser_of(&farm, &farm.viewer).await;
    clock.advance_micros(5 * MINUTE);
    sign_in(&farm, &json!({"code": late.code})).await.problem(ProblemKind::Unauthenticated).await;
    let current: Session = browser.get("/v1/sessions/current").await.parsed(StatusCode::OK).await;
    assert!(current.last_used_at > browser.session.last_used_at);
    clock.advance_micros(7 * 24 * 60 * MINUTE);
    let refused = browser.get("/v1/jobs").await;
    assert!(refused.headers()["www-authenticate"].to_str().unwrap().contains("invalid_token"));
    refused.problem(ProblemKind::Unauthenticated).await;
    let list: SessionPage = farm.operator.get("/v1/sessions").await.parsed(StatusCode::OK).await;
    assert!(list.items.is_empty());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_session_that_was_ended_is_over_everywhere_and_its_stream_of_events_too() {
    let farm = Farm::new().await;
    let (mine, other) = (browser_of(&farm, &farm.operator).await, browser_of(&farm, &farm.viewer).await);
    let stream = other.request(Method::GET, "/v1/events").send().await.unwrap();
    assert_eq!(stream.status(), StatusCode::OK);
    let list: SessionPage = mine.get("/v1/sessions?page_size=1").await.parsed(StatusCode::OK).await;
    assert_eq!(list.items, std::slice::from_ref(&other.session));
    let rest = format!("/v1/sessions?page_token={}", list.next_page_token.unwrap());
    let rest: SessionPage = mine.get(&rest).await.parsed(StatusCode::OK).await;
    assert_eq!(rest.items[0].id, mine.session.id);
    let path = format!("/v1/sessions/{}", other.session.id.unwrap());
    let ended = mine.request(Method::DELETE, &path).send().await.unwrap();
    assert_eq!(ended.status(), StatusCode::NO_CONTENT);
    tokio::time::timeout(PATIENCE, stream.bytes()).await.expect("the stream to end").unwrap();
    other.get("/v1/jobs").await.problem(ProblemKind::Unauthenticated).await;
    mine.request(Method::DELETE, &path).send().await.unwrap().problem(ProblemKind::NotFound).await;
    let out = mine.request(Method::DELETE, "/v1/sessions/current").send().await.unwrap();
    assert_eq!(out.status(), StatusCode::NO_CONTENT);
    assert!(out.headers()["set-cookie"].to_str().unwrap().contains("Max-Age=0"));
    mine.get("/v1/jobs").await.problem(ProblemKind::Unauthenticated).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_session_lasts_through_a_restart_and_streams_events() {
    let farm = Farm::new().await;
    let browser = browser_of(&farm, &farm.submitter).await;
    let farm = farm.killed_and_restarted().await;
    let browser = Browser { http: farm.nobody.clone(), ..browser };
    let job = farm.submit("0").await;
    let path = format!("/v1/jobs/{}/events", job.id);
    assert_eq!(browser.get(&path).await.status(), StatusCode::OK);
    let mut events = Events::open(&farm.viewer, &path, None).await.unwrap();
    assert_eq!(events.take(1, PATIENCE).await[0].job_id, Some(job.id));
}

#[tokio::test(flavor = "multi_thread")]
async fn behind_tls_the_cookie_travels_over_tls_only_and_the_public_origin_is_ones_own() {
    let farm = Farm::with(|config| config.public_origin = Some("https://farm.example".to_owned())).await;
    let browser = browser_of(&farm, &farm.submitter).await;
    assert!(browser.cookie.ends_with("; Secure"), "{}", browser.cookie);
    let submit = async |origin| {
        let request = browser.from(Method::POST, "/v1/jobs", &[("origin", origin)]);
        request.json(&farm.job_request("0")).send().await.unwrap()
    };
    assert_eq!(submit("https://farm.example").await.status(), StatusCode::CREATED);
    submit("https://farm.example.evil").await.problem(ProblemKind::CrossSite).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn whoever_guesses_is_held_back_for_a_minute() {
    let (farm, clock) = Farm::with_clock().await;
    let good = code(&farm.viewer).await.code;
    for _ in 0..10 {
        sign_in(&farm, &json!({"code": "0000"})).await.problem(ProblemKind::Unauthenticated).await;
    }
    let held = sign_in(&farm, &json!({"code": good})).await;
    assert_eq!(held.headers()["retry-after"], "60");
    held.problem(ProblemKind::TooManyRequests).await;
    clock.advance_micros(MINUTE);
    assert_eq!(sign_in(&farm, &json!({"code": good})).await.status(), StatusCode::CREATED);
}
