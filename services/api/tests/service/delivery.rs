//! Files: verified, in ranges, conditional; what HEAD and other sites get.

use crate::support::{Answer, Farm};
use forelight_protocol::{ArtifactHash, Problem, ProblemKind};
use reqwest::header::{HeaderMap, HeaderName};
use reqwest::{Method, Response, StatusCode};

async fn with(farm: &Farm, path: &str, headers: &[(&str, &str)]) -> Response {
    let request = farm.viewer.request(Method::GET, path);
    let request = headers.iter().fold(request, |request, (name, value)| request.header(*name, *value));
    request.send().await.unwrap()
}

fn path_of(farm: &Farm, hash: ArtifactHash) -> std::path::PathBuf {
    let name = hash.to_string();
    farm.folder.path().join("data/artifacts/blake3").join(&name[..2]).join(name)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_file_is_had_in_ranges_and_only_if_it_is_another() {
    let farm = Farm::new().await;
    let content: Vec<u8> = (0..200_000u32).map(|n| (n % 251) as u8).collect();
    let hash = farm.artifact(&content).await;
    let path = format!("/v1/artifacts/{hash}");
    let tag = format!("\"{hash}\"");
    let whole = with(&farm, &path, &[]).await;
    assert_eq!(whole.status(), StatusCode::OK);
    assert_eq!(whole.headers()["accept-ranges"], "bytes");
    assert_eq!(whole.headers()["etag"], tag.as_str());
    assert_eq!(whole.headers()["x-content-type-options"], "nosniff");
    assert_eq!(whole.bytes().await.unwrap(), content);
    for (range, from, to) in [("bytes=100-199999", 100, 200_000), ("bytes=-5", 199_995, 200_000)] {
        for condition in [&[][..], &[("if-range", tag.as_str())]] {
            let part = with(&farm, &path, &[&[("range", range)], condition].concat()).await;
            assert_eq!(part.status(), StatusCode::PARTIAL_CONTENT);
            let expected = format!("bytes {from}-{}/200000", to - 1);
            assert_eq!(part.headers()["content-range"], expected.as_str());
            assert_eq!(part.bytes().await.unwrap(), content[from..to]);
        }
    }
    let refused = with(&farm, &path, &[("range", "bytes=200000-")]).await;
    assert_eq!(refused.headers()["content-range"], "bytes */200000");
    refused.problem(ProblemKind::RangeNotSatisfiable).await;
    for known in [tag.as_str(), &format!("W/{tag}"), "*", &format!("\"other\", W/{tag}")] {
        let answer = with(&farm, &path, &[("if-none-match", known)]).await;
        assert_eq!(answer.status(), StatusCode::NOT_MODIFIED, "{known}");
        assert_eq!(answer.headers()["etag"], tag.as_str());
    }
    assert_eq!(with(&farm, &path, &[("if-none-match", "\"other\"")]).await.status(), StatusCode::OK);
    for (wanted, status) in [
        (tag.as_str(), StatusCode::OK),
        ("*", StatusCode::OK),
        (&format!("\"other\", {tag}"), StatusCode::OK),
        ("\"other\"", StatusCode::PRECONDITION_FAILED),
        // A weak tag does not promise the same bytes.
        (&format!("W/{tag}"), StatusCode::PRECONDITION_FAILED),
    ] {
        assert_eq!(with(&farm, &path, &[("if-match", wanted)]).await.status(), status, "{wanted}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn several_ranges_come_in_one_answer_each_with_its_place() {
    let farm = Farm::new().await;
    let content: Vec<u8> = (0..200_000u32).map(|n| (n % 251) as u8).collect();
    let path = format!("/v1/artifacts/{}", farm.artifact(&content).await);
    let answer = with(&farm, &path, &[("range", "bytes=150000-199999,0-9")]).await;
    assert_eq!(answer.status(), StatusCode::PARTIAL_CONTENT);
    let kind = answer.headers()["content-type"].to_str().unwrap().to_owned();
    let boundary = kind.strip_prefix("multipart/byteranges; boundary=").unwrap();
    let length: usize = answer.headers()["content-length"].to_str().unwrap().parse().unwrap();
    let body = answer.bytes().await.unwrap();
    assert_eq!(body.len(), length);
    let mut expected = Vec::new();
    for (place, range) in [("150000-199999", 150_000..200_000), ("0-9", 0..10)] {
        let head = format!(
            "\r\n--{boundary}\r\nContent-Type: application/octet-stream\r\nContent-Range: bytes {place}/200000\r\n\r\n"
        );
        expected.extend(head.into_bytes());
        expected.extend(&content[range]);
    }
    expected.extend(format!("\r\n--{boundary}--\r\n").into_bytes());
    assert_eq!(body, expected);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_flipped_bit_is_an_error_and_an_event_and_no_image() {
    let farm = Farm::new().await;
    let hash = farm.artifact(&[7; 1000]).await;
    let path = format!("/v1/artifacts/{hash}");
    let mut bytes = std::fs::read(path_of(&farm, hash)).unwrap();
    bytes[500] ^= 4;
    std::fs::write(path_of(&farm, hash), bytes).unwrap();
    let problem = farm.viewer.get(&path).await.problem(ProblemKind::ArtifactDamaged).await;
    assert!(problem.detail.contains(&hash.to_string()) && problem.status == 500, "{}", problem.detail);
    let head = farm.viewer.request(Method::HEAD, &path).send().await.unwrap();
    assert_eq!(head.status(), StatusCode::INTERNAL_SERVER_ERROR);
    let dashboard: serde_json::Value = farm.viewer.json("/v1/dashboard").await;
    let told =
        dashboard["events"].as_array().unwrap().iter().filter(|event| event["kind"] == "artifact_damaged");
    assert_eq!(told.count(), 1);
    // Whoever still has it may bring it back.
    farm.artifact(&[7; 1000]).await;
    assert_eq!(farm.viewer.get(&path).await.status(), StatusCode::OK);
}

#[tokio::test(flavor = "multi_thread")]
async fn head_agrees_with_get_but_for_the_body() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let job = farm.submit("0-3").await;
    let job = farm.work_off(&node, &job).await;
    let hash = farm.artifact(b"content").await;
    let id = job.id;
    for path in [
        "/healthz".to_owned(),
        "/openapi.yaml".to_owned(),
        "/v1/jobs".to_owned(),
        "/v1/dashboard".to_owned(),
        "/v1/timeline".to_owned(),
        "/v1/forecasts/track-record.svg".to_owned(),
        format!("/v1/jobs/{id}"),
        format!("/v1/jobs/{id}/frames"),
        format!("/v1/jobs/{id}/accuracy"),
        format!("/v1/jobs/{id}/explanation"),
        format!("/v1/jobs/{id}/forecast/history.svg"),
        format!("/v1/jobs/{id}/answers"),
        format!("/v1/jobs/{id}/frames/0/image.png"),
        format!("/v1/artifacts/{hash}"),
        format!("/v1/artifacts/{}", "0".repeat(64)),
        "/nothing".to_owned(),
    ] {
        for coding in ["identity", "gzip"] {
            let ask = async |method: Method| {
                let request = farm.viewer.request(method, &path).header("accept-encoding", coding);
                let answer = request.send().await.unwrap();
                let mut headers: HeaderMap = answer.headers().clone();
                // How long the body is may only be known while it is sent (RFC 9110, section 9.3.2).
                for field in ["date", "transfer-encoding"] {
                    headers.remove(field);
                }
                // The dashboard says when it was made, which is compressed to more or fewer bytes.
                if path == "/v1/dashboard" && coding == "gzip" {
                    headers.remove("content-length");
                }
                (answer.status(), headers, answer.bytes().await.unwrap())
            };
            let (get, head) = (ask(Method::GET).await, ask(Method::HEAD).await);
            assert_eq!((&get.0, get.1), (&head.0, head.1), "{path} as {coding}");
            assert!(!get.2.is_empty() && head.2.is_empty(), "{path}");
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn pages_of_listed_origins_may_ask_and_of_no_others() {
    let listed = "https://pipeline.example.org";
    let farm = Farm::with(|config| config.allowed_origins = vec![listed.to_owned()]).await;
    let header = |answer: &Response, name: &'static str| {
        answer.headers().get(HeaderName::from_static(name)).map(|value| value.to_str().unwrap().to_owned())
    };
    let ask = async |method: Method, origin: &str| {
        let request = farm.viewer.request(method, "/v1/jobs").header("origin", origin);
        request.header("access-control-request-method", "POST").send().await.unwrap()
    };
    for method in [Method::GET, Method::OPTIONS] {
        let answer = ask(method.clone(), listed).await;
        assert_eq!(answer.status(), StatusCode::OK);
        assert_eq!(header(&answer, "access-control-allow-origin").as_deref(), Some(listed));
        assert_eq!(header(&answer, "access-control-allow-credentials"), None, "cookies are for the own page");
        let other = ask(method, "https://other.example.org").await;
        assert_eq!(header(&other, "access-control-allow-origin"), None);
    }
    let farm = Farm::new().await;
    let answer = farm.viewer.request(Method::GET, "/v1/jobs").header("origin", listed).send().await.unwrap();
    assert_eq!(header(&answer, "access-control-allow-origin"), None, "without configuration, nobody may");
    let problem: Problem = farm.viewer.get("/v1/nothing").await.json().await.unwrap();
    assert_eq!(problem.status, 404);
}
