//! Compares the OpenAPI document with the repository's copy.

use std::path::Path;

fn committed() -> std::path::PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../openapi.yaml")
}

/// To rewrite the file: `FORELIGHT_REWRITE_OPENAPI=1 cargo test -p forelight-api --test openapi`.
#[test]
fn openapi_yaml_is_current() {
    let generated = forelight_api::openapi_yaml();
    assert!(generated.starts_with("openapi: 3.1"), "{}", generated.lines().next().unwrap_or_default());
    if std::env::var_os("FORELIGHT_REWRITE_OPENAPI").is_some() {
        std::fs::write(committed(), generated).unwrap();
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

#[test]
fn every_operation_has_an_id_of_its_own() {
    let document = forelight_api::openapi_yaml();
    let mut ids: Vec<&str> = document.lines().filter(|line| line.contains(" operationId: ")).collect();
    let count = ids.len();
    ids.sort_unstable();
    ids.dedup();
    assert!(count > 50 && ids.len() == count, "{} of {count}: {ids:?}", ids.len());
}
