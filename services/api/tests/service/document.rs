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
        let open = ["/healthz", "/readyz", "/openapi.yaml"].contains(&path.as_str());
        // Whoever signs in has no token yet.
        let signs_in = method == Method::POST && path == "/v1/sessions";
        let expected = match (open, signs_in) {
            (true, _) => StatusCode::OK,
            (_, true) => StatusCode::UNSUPPORTED_MEDIA_TYPE,
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
