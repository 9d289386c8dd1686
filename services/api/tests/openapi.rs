//! The document against the repository's copy and against the running service.

mod support;

use std::path::Path;

use reqwest::{Method, StatusCode};
use support::Farm;

fn committed() -> std::path::PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../openapi.yaml")
}

/// To rewrite the file: `FORELIGHT_REWRITE_OPENAPI=1 cargo test -p forelight-api --test openapi`.
#[test]
fn openapi_yaml_is_current() {
    let generated = forelight_api::openapi_yaml();
    assert!(generated.starts_with("openapi: 3.1"), "{}", generated.lines().next().unwrap_or_default());
    if std::env::var_os("FORELIGHT_REWRITE_OPENAPI").is_some() {
        std::fs::write(committed(), &generated).unwrap();
    }
    let kept = std::fs::read_to_string(committed()).unwrap_or_default();
    let differing =
        generated.lines().zip(kept.lines().chain(std::iter::repeat(""))).position(|(a, b)| a != b);
    assert!(
        generated == kept,
        "openapi.yaml is not what the code says, from line {:?} on; rewrite it with FORELIGHT_REWRITE_OPENAPI=1",
        differing.map(|line| line + 1)
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn every_documented_operation_is_there_and_every_reference_leads_somewhere() {
    let farm = Farm::new().await;
    let served = farm.nobody.get("/openapi.yaml").await.text().await.unwrap();
    assert_eq!(served, forelight_api::openapi_yaml());
    let mut path = String::new();
    let mut operations = 0;
    for line in served.lines() {
        if let Some(rest) = line.strip_prefix("  /") {
            path = format!("/{}", rest.trim_end_matches(':'));
        }
        let method = match line {
            "    get:" => Method::GET,
            "    post:" => Method::POST,
            "    put:" => Method::PUT,
            "    patch:" => Method::PATCH,
            "    head:" => Method::HEAD,
            _ => continue,
        };
        let address = path.replace("{frame}", "0").replace("{blake3}", &"0".repeat(64));
        let address = address.replace("{id}", "0197a8a5-0000-7000-8000-000000000000");
        let status = farm.nobody.request(method.clone(), &address).send().await.unwrap().status();
        let open = ["/healthz", "/readyz", "/openapi.yaml"].contains(&path.as_str());
        let expected = if open { StatusCode::OK } else { StatusCode::UNAUTHORIZED };
        assert_eq!(status, expected, "{method} {path}");
        operations += 1;
    }
    assert!(operations >= 34, "{operations}");
    for reference in served.lines().filter_map(|line| line.trim().strip_prefix("$ref: ")) {
        let name = reference.trim_matches(['\'', '"']).strip_prefix("#/components/schemas/").unwrap();
        assert!(served.contains(&format!("\n    {name}:\n")), "{name} is referred to and not described");
    }
}
