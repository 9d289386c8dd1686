//! The four questions, to real Blender files. `tests/peers/blender.sh` makes the files and runs this.
//!
//! | variable | value |
//! | --- | --- |
//! | `FORELIGHT_BLENDS` | folder with the files of `tests/peers/blender_scenes.py` |
//! | `FORELIGHT_BPY_PYTHON` | Python with `bpy`, where `blender` is not installed |

mod files;
mod previews;
mod renders;

use exr::prelude::{ReadChannels as _, ReadLayers as _, read};
use forelight_preview::{Choice, SharedPreviewer};
use forelight_renderer::door::{
    AssetState, Capability, Common, FrameCounts, Limits, Part, PixelCount, PreviewBackend, Region,
    Renderer as _, RendererError, Run, Settings, Shot,
};
use forelight_renderer_blender::Cycles;
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, LazyLock};
use std::time::Duration;

static CYCLES: LazyLock<Cycles> =
    LazyLock::new(|| Cycles::find(Arc::new(SharedPreviewer::new(Choice::Auto))).unwrap());

/// Whether this version of Cycles says what every pixel took.
fn locates_costs() -> bool {
    CYCLES.capabilities().contains(&Capability::LocateCosts)
}

fn blends() -> PathBuf {
    std::env::var_os("FORELIGHT_BLENDS").expect("set FORELIGHT_BLENDS").into()
}

/// Names of the files that were made from bundles.
fn names() -> Vec<String> {
    let files = std::fs::read_dir(blends()).unwrap().map(|entry| entry.unwrap().path());
    let mut names: Vec<String> = files
        .filter(|path| path.extension().is_some_and(|e| e == "json"))
        .map(|path| path.file_stem().unwrap().to_string_lossy().into_owned())
        .collect();
    names.sort();
    names
}

fn with<T>(
    scratch: &Path,
    cancelled: &AtomicBool,
    progress: &(dyn Fn(f64) + Sync),
    f: impl FnOnce(&Run<'_>) -> T,
) -> T {
    let limits =
        Limits { time: Some(Duration::from_secs(300)), grace: Duration::from_secs(2), ..Limits::default() };
    f(&Run { progress, ..Run::silent(cancelled, scratch, limits) })
}

/// Opens a file and asks something.
fn ask<T>(name: &str, question: impl FnOnce(&dyn Shot, &Run<'_>) -> T) -> T {
    let scratch = tempfile::tempdir().unwrap();
    with(scratch.path(), &AtomicBool::new(false), &|_| {}, |run| {
        let shot = CYCLES.open(&blends().join(format!("{name}.blend")), run).unwrap();
        question(&*shot, run)
    })
}

/// Every channel of an EXR file.
fn channels(path: &Path) -> BTreeMap<String, Vec<f32>> {
    let reader = read().no_deep_data().largest_resolution_level().all_channels().all_layers();
    let image = reader.all_attributes().from_file(path).unwrap();
    let list = image.layer_data.iter().flat_map(|layer| &layer.channel_data.list);
    list.map(|c| (c.name.to_string(), c.sample_data.values_as_f32().collect())).collect()
}

fn seconds(nanos: u64) -> f64 {
    nanos as f64 / 1e9
}

fn processes_of_ours() -> usize {
    let mark = format!("FORELIGHT_PROCESS={}-", std::process::id());
    let entries = std::fs::read_dir("/proc").unwrap().flatten();
    let marked = entries.filter(|entry| {
        std::fs::read(entry.path().join("environ"))
            .is_ok_and(|text| text.split(|&b| b == 0).any(|line| line.starts_with(mark.as_bytes())))
    });
    marked.count()
}

#[test]
#[ignore = "tests/peers/blender.sh makes its files"]
fn a_file_is_described_as_it_was_made() {
    for name in names() {
        let text = std::fs::read_to_string(blends().join(format!("{name}.json"))).unwrap();
        let expected: Value = serde_json::from_str(&text).unwrap();
        ask(&name, |shot, _| {
            let found = shot.description();
            assert_eq!(
                json!([found.frames.first, found.frames.last]),
                json!([expected["first"], expected["last"]])
            );
            let objects = found.objects.as_ref().unwrap();
            let triangles: BTreeMap<&str, u64> =
                objects.iter().map(|o| (o.name.as_str(), o.triangles.unwrap())).collect();
            assert_eq!(json!(triangles), expected["objects"]);
            assert_eq!(json!(found.materials.as_ref().unwrap()), expected["materials"]);
            let images: Vec<&str> =
                found.assets.iter().filter(|a| a.kind == "image").map(|a| a.name.as_str()).collect();
            let mut images = images;
            images.sort_unstable();
            assert_eq!(json!(images), expected["images"]);
            assert!(found.assets.iter().all(|asset| asset.state == AssetState::Present));
            let common = Common { width: 96, height: 96, samples: 64, seed: 0 };
            assert_eq!(found.settings.common, common);
            assert_eq!((found.cameras.len(), found.cameras[0].active), (1, true));
            assert_eq!(found.settings.check(&CYCLES.settings_schema()), Ok(()));
            found.require_assets().unwrap();
            let opening = &found.opening;
            println!(
                "{name}: opened in {:.2} CPU s, {} MiB",
                seconds(opening.cpu_nanos),
                opening.peak_memory_bytes >> 20
            );
        });
    }
}
