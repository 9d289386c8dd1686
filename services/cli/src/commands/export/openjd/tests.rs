use super::{Chunk, ExportedShot};
use crate::commands::Cli;
use clap::Parser;
use forelight_protocol::{
    CacheMode, Integrator, JobSettings, RenderSettings, RenderSettingsRequest, ShotSettings,
};
use serde_json::Value;
use std::collections::BTreeMap;

fn settings(cache: CacheMode) -> RenderSettings {
    let request =
        RenderSettingsRequest { cache: Some(cache), cache_accuracy: Some(150), ..Default::default() };
    request.complete((64, 36))
}

fn shot(cache: CacheMode, cache_parts: u32) -> ExportedShot {
    ExportedShot {
        name: "a {{shot}} of 'mine'".into(),
        description: "three frames".into(),
        bundle: Some("{{x}} \"y\" $(z)".into()),
        bundle_is_folder: true,
        frames: "0-1,5".parse().unwrap(),
        settings: settings(cache).into(),
        set: BTreeMap::new(),
        formats: vec!["exr".into(), "png".into()],
        cache_parts,
        threads: None,
        chunk: None,
        memory_mib: None,
        frame_limit: None,
        cache_limit: None,
    }
}

fn document(shot: &ExportedShot) -> Value {
    serde_json::to_value(shot.template()).unwrap()
}

fn parameter<'a>(document: &'a Value, name: &str) -> &'a Value {
    let all = document["parameterDefinitions"].as_array().unwrap();
    all.iter().find(|parameter| parameter["name"] == name).unwrap_or_else(|| panic!("no {name}"))
}

fn steps(document: &Value) -> Vec<(&str, Option<&str>, Option<&str>)> {
    let steps = document["steps"].as_array().unwrap().iter();
    steps
        .map(|step| {
            let range = &step["parameterSpace"]["taskParameterDefinitions"][0]["range"];
            let after = step["dependencies"][0]["dependsOn"].as_str();
            (step["name"].as_str().unwrap(), after, range.as_str())
        })
        .collect()
}

#[test]
fn frames_are_a_range_expression_over_which_the_renders_run() {
    let document = document(&shot(CacheMode::Off, 1));
    assert_eq!(parameter(&document, "Frames")["default"], "0-1,5");
    assert_eq!(steps(&document), [("Render", None, Some("{{Param.Frames}}"))]);
}

#[test]
fn a_task_of_several_frames_is_a_range_of_them() {
    let chunk = Some(Chunk { frames: 25, seconds: 600 });
    let document = document(&ExportedShot { chunk, ..shot(CacheMode::Off, 1) });
    assert_eq!(document["extensions"], serde_json::json!(["TASK_CHUNKING"]));
    assert_eq!(parameter(&document, "ChunkFrames")["default"], 25);
    assert_eq!(parameter(&document, "ChunkSeconds")["default"], 600);
    let step = &document["steps"][0];
    let frame = &step["parameterSpace"]["taskParameterDefinitions"][0];
    assert_eq!(frame["type"], "CHUNK[INT]");
    let chunks = serde_json::json!({
        "defaultTaskCount": "{{Param.ChunkFrames}}",
        "targetRuntimeSeconds": "{{Param.ChunkSeconds}}",
        "rangeConstraint": "CONTIGUOUS",
    });
    assert_eq!(frame["chunks"], chunks);
    let args = step["script"]["actions"]["onRun"]["args"].as_array().unwrap();
    let args: Vec<&str> = args.iter().filter_map(Value::as_str).collect();
    assert_eq!(args[2..4], ["--frames", "{{Task.Param.Frame}}"]);
    assert!(args.contains(&"{{Param.Images}}/#.{{Param.ImageFormat}}"), "{args:?}");
    let whole = super::tests::document(&shot(CacheMode::Off, 1));
    assert!(whole.get("extensions").is_none() && !whole.to_string().contains("Chunk"));
}

#[test]
fn a_cache_is_made_before_the_frames_that_read_it() {
    let whole = document(&shot(CacheMode::On, 1));
    assert_eq!(
        steps(&whole),
        [
            ("PlanCache", None, None),
            ("FillCache", Some("PlanCache"), None),
            ("Render", Some("FillCache"), Some("{{Param.Frames}}")),
        ]
    );
    assert_eq!(parameter(&whole, "CacheAccuracy")["default"], "0.15");
    let parts = document(&shot(CacheMode::On, 3));
    assert_eq!(
        steps(&parts),
        [
            ("PlanCache", None, None),
            ("FillCacheLevel2", Some("PlanCache"), Some("1-3")),
            ("MergeCacheLevel2", Some("FillCacheLevel2"), None),
            ("FillCacheLevel1", Some("MergeCacheLevel2"), Some("1-3")),
            ("MergeCacheLevel1", Some("FillCacheLevel1"), None),
            ("Render", Some("MergeCacheLevel1"), Some("{{Param.Frames}}")),
        ]
    );
    // The steps are for two levels.
    assert_eq!(parameter(&parts, "AmbientBounces")["allowedValues"], serde_json::json!([2]));
    assert!(parameter(&whole, "AmbientBounces").get("allowedValues").is_none());
}

#[test]
fn what_the_user_named_is_a_default_and_never_part_of_a_format_string() {
    let mut document = document(&shot(CacheMode::On, 2));
    assert_eq!(parameter(&document, "JobName")["default"], "a {{shot}} of 'mine'");
    assert_eq!(parameter(&document, "Bundle")["default"], "{{x}} \"y\" $(z)");
    document["parameterDefinitions"] = Value::Null;
    let rest = document.to_string();
    assert!(!rest.contains("{{shot}}") && !rest.contains("{{x}}"), "{rest}");
}

#[test]
fn what_is_not_known_is_left_out() {
    let mut exported = shot(CacheMode::On, 1);
    exported.bundle = None;
    let unknown = document(&exported);
    assert!(parameter(&unknown, "Bundle").get("default").is_none());
    for step in unknown["steps"].as_array().unwrap() {
        assert!(step["hostRequirements"].get("amounts").is_none());
        assert!(step["script"]["actions"]["onRun"].get("timeout").is_none());
    }
    (exported.threads, exported.memory_mib) = (Some(4), Some(900));
    (exported.frame_limit, exported.cache_limit) = (Some(700), Some(7000));
    let known = document(&exported);
    let limits = known["steps"].as_array().unwrap().iter().map(|step| {
        let amounts = &step["hostRequirements"]["amounts"];
        assert_eq!((&amounts[0]["min"], &amounts[1]["min"]), (&4.into(), &900.into()));
        step["script"]["actions"]["onRun"]["timeout"].as_u64().unwrap()
    });
    assert_eq!(limits.collect::<Vec<_>>(), [7000, 7000, 700]);
}

/// Puts the defaults of all parameters into a format string, as a farm does.
fn resolved(text: &str, values: &BTreeMap<String, String>) -> String {
    let mut out = String::new();
    let mut rest = text;
    while let Some((before, after)) = rest.split_once("{{") {
        let (name, behind) = after.split_once("}}").expect("every brace is closed");
        out.push_str(before);
        out.push_str(values.get(name).unwrap_or_else(|| panic!("{name} is not defined")));
        rest = behind;
    }
    out + rest
}

#[test]
fn every_command_of_a_job_can_be_typed() {
    let mut path = shot(CacheMode::Off, 1);
    path.settings = RenderSettings { integrator: Integrator::Path, ..settings(CacheMode::Off) }.into();
    path.threads = Some(3);
    let chunk = Some(Chunk { frames: 25, seconds: 600 });
    let chunked = ExportedShot { chunk, ..shot(CacheMode::On, 1) };
    let others = [shot(CacheMode::Off, 1), shot(CacheMode::On, 1), shot(CacheMode::On, 4)];
    let other = ExportedShot {
        settings: JobSettings::Shot(ShotSettings {
            width: Some(64),
            height: Some(36),
            samples: Some(16),
            seed: Some(0),
            own: Default::default(),
        }),
        set: ["a-b", "a b", "größe"].map(|name| (name.to_owned(), "it's {{mine}}".into())).into(),
        ..shot(CacheMode::Off, 1)
    };
    for exported in others.into_iter().chain([path, chunked, other]) {
        let document = document(&exported);
        let frame = if exported.chunk.is_some() { "0-24" } else { "1" };
        let mut values = BTreeMap::from(
            [("Frame", frame), ("Part", "1")]
                .map(|(name, value)| (format!("Task.Param.{name}"), value.into())),
        );
        for parameter in document["parameterDefinitions"].as_array().unwrap() {
            let name = parameter["name"].as_str().unwrap();
            let is_identifier = name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_');
            assert!(is_identifier && name.len() <= 64, "{name}");
            assert!(!values.contains_key(&format!("Param.{name}")), "{name} is there twice");
            let default = &parameter["default"];
            let allowed = parameter["allowedValues"].as_array();
            assert!(allowed.is_none_or(|allowed| allowed.contains(default)), "{parameter}");
            let value = default.as_str().map_or_else(|| default.to_string(), str::to_owned);
            values.insert(format!("Param.{name}"), value);
        }
        for step in document["steps"].as_array().unwrap() {
            let run = &step["script"]["actions"]["onRun"];
            let words = [&run["command"]].into_iter().chain(run["args"].as_array().unwrap());
            let words: Vec<String> = words.map(|word| resolved(word.as_str().unwrap(), &values)).collect();
            Cli::try_parse_from(&words).unwrap_or_else(|error| panic!("{words:?}: {error}"));
        }
    }
}
