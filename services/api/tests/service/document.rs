//! Compares the OpenAPI document with the running service.

use crate::support::Farm;
use reqwest::{Method, StatusCode};

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
            "    delete:" => Method::DELETE,
            "    head:" => Method::HEAD,
            _ => continue,
        };
        let address = path.replace("{frame}", "0").replace("{blake3}", &"0".repeat(64));
        let address = address.replace("{id}", "0197a8a5-0000-7000-8000-000000000000");
        let status = farm.nobody.request(method.clone(), &address).send().await.unwrap().status();
        // Whoever signs in has no token yet. This farm has no provider.
        let expected = match (method.as_str(), path.as_str()) {
            (_, "/healthz" | "/readyz" | "/openapi.yaml" | "/v1/sign-in") => StatusCode::OK,
            ("POST", "/v1/sessions") => StatusCode::UNSUPPORTED_MEDIA_TYPE,
            (_, "/v1/sign-in/begin" | "/v1/sign-in/callback") => StatusCode::NOT_FOUND,
            _ => StatusCode::UNAUTHORIZED,
        };
        assert_eq!(status, expected, "{method} {path}");
        operations += 1;
    }
    assert!(operations >= 34, "{operations}");
    for reference in served.lines().filter_map(|line| line.trim().strip_prefix("$ref: ")) {
        let name = reference.trim_matches(['\'', '"']).strip_prefix("#/components/schemas/").unwrap();
        assert!(served.contains(&format!("\n    {name}:\n")), "{name} is referred to and not described");
    }
}
