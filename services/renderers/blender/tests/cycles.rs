//! The four questions, to real Blender files. `tests/peers/blender.sh` makes the files and runs this.
//!
//! | variable | value |
//! | --- | --- |
//! | `FORELIGHT_BLENDS` | folder with the files of `tests/peers/blender_scenes.py` |
//! | `FORELIGHT_BPY_PYTHON` | Python with `bpy`, where `blender` is not installed |

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

#[test]
#[ignore = "tests/peers/blender.sh makes its files"]
fn merged_shares_are_the_image_of_one_render() {
    for name in names() {
        ask(&name, |shot, run| {
            let mut settings = shot.description().settings.clone();
            settings.common.samples = 16;
            if !CYCLES.capabilities().contains(&Capability::TakeOverSamples) {
                let measured =
                    shot.measure(3, &settings, &Part::Samples { offset: 1, count: 4 }, run).unwrap();
                let whole = shot.render(3, &settings, &[], run).unwrap();
                assert_eq!(measured.artefact, None);
                assert!(measured.cost.cpu_nanos < whole.cost.cpu_nanos / 2);
                return;
            }
            assert!(shot.capabilities(&settings).contains(&Capability::TakeOverSamples));
            let part = |offset, count| Part::Samples { offset, count };
            let measured: Vec<_> = [part(0, 1), part(1, 4)]
                .iter()
                .map(|p| shot.measure(3, &settings, p, run).unwrap())
                .collect();
            let artefacts: Vec<_> = measured.iter().filter_map(|m| m.artefact.clone()).collect();
            let merged = shot.render(3, &settings, &artefacts, run).unwrap();
            let merged_file = run.scratch.join("merged.exr");
            std::fs::rename(&merged.files[0], &merged_file).unwrap();
            let whole = shot.render(3, &settings, &[], run).unwrap();
            let (ours, theirs) = (channels(&merged_file), channels(&whole.files[0]));
            assert!(ours.keys().eq(theirs.keys()));
            let mut worst = 0.0f64;
            for (channel, theirs) in theirs.iter().filter(|(c, _)| !c.contains("Render Time")) {
                let mean = theirs.iter().map(|&v| f64::from(v.abs())).sum::<f64>() / theirs.len() as f64;
                let differences = ours[channel].iter().zip(theirs).map(|(&a, &b)| f64::from((a - b).abs()));
                let largest = differences.fold(0.0, f64::max);
                worst = worst.max(largest / mean.max(1e-12));
                assert!(largest <= 1e-5 * mean, "{name}, {channel}: {largest} of a mean of {mean}");
            }
            println!("{name}: largest difference {worst:.1e} of the mean");
            let (strata, blocks) = (!merged.strata.is_empty(), merged.blocks.is_some());
            assert_eq!((strata, blocks), (locates_costs(), locates_costs()));
            let gap = shot.render(3, &settings, &artefacts[1..], run).unwrap_err();
            assert!(matches!(gap, RendererError::Artefact { .. }), "{gap}");
            let other = shot.render(4, &settings, &artefacts, run).unwrap_err();
            assert!(other.to_string().contains("frame 3, not 4"), "{other}");
            let mut adaptive = settings;
            adaptive.own.insert("adaptive_sampling".to_owned(), true.into());
            assert!(!shot.capabilities(&adaptive).contains(&Capability::TakeOverSamples));
            assert_eq!(shot.measure(3, &adaptive, &part(0, 1), run).unwrap().artefact, None);
        });
    }
}

#[test]
#[ignore = "tests/peers/blender.sh makes its files"]
fn a_share_of_the_samples_says_what_is_fixed_and_where_time_goes() {
    for name in names() {
        ask(&name, |shot, run| {
            let settings = shot.description().settings.clone();
            let first = Part::Samples { offset: 0, count: 1 };
            let measured = shot.measure(0, &settings, &first, run).unwrap();
            let fixed: u64 = measured.fixed.values().sum();
            assert!(fixed > 0 && fixed < measured.cost.cpu_nanos, "{measured:?}");
            println!("{name}: fixed CPU ns: {:?}", measured.fixed);
            let size = (settings.common.width, settings.common.height);
            assert_eq!(measured.ids.as_ref().unwrap().dimensions(), size);
            for part in ["prepare", "scene", "tree", "pixels", "write"] {
                assert!(
                    measured.fixed.get(part).is_some_and(|&nanos| nanos > 0),
                    "{part}: {:?}",
                    measured.fixed
                );
            }
            let pixels: u64 = measured.strata.iter().map(|stratum| stratum.count.pixels).sum();
            assert_eq!(pixels, if locates_costs() { settings.pixels() } else { 0 });
            assert_eq!(measured.strata.len() > 3, locates_costs());
        });
    }
}

#[test]
#[ignore = "tests/peers/blender.sh makes its files"]
fn the_samples_at_which_pixels_stop_by_their_noise_are_known_from_few_of_them() {
    ask("counted", |shot, run| {
        let mut settings = shot.description().settings.clone();
        (settings.common.width, settings.common.height, settings.common.samples) = (128, 96, 256);
        settings.own.insert("adaptive_sampling".to_owned(), true.into());
        settings.own.insert("noise_threshold".to_owned(), 0.006.into());
        let measured = shot.measure(1, &settings, &Part::Samples { offset: 0, count: 1 }, run).unwrap();
        let stopping = measured.stopping.unwrap();
        let whole = shot.render(1, &settings, &[], run).unwrap();
        let image = channels(&whole.files[0]);
        let pass = |name: &str| image.iter().find_map(|(c, values)| c.contains(name).then_some(values));
        // Shares of the samples of the image. At this threshold, the first pixels stop after 80.
        let shares = pass("Debug Sample Count").unwrap();
        let first = shares.iter().copied().fold(f32::INFINITY, f32::min);
        let samples: Vec<f64> = shares.iter().map(|share| 80.0 * f64::from(share / first)).collect();
        let times: Vec<f64> = match pass("Render Time") {
            Some(times) => times.iter().copied().map(f64::from).collect(),
            None => samples.clone(),
        };
        let single: f64 = times.iter().zip(&samples).map(|(time, samples)| time / samples).sum();
        let truth = times.iter().sum::<f64>() / single;
        println!("{:.1} samples of a pixel, {truth:.1} in the image", stopping.samples);
        // Few pixels are noisy, in thin edges of shadows, so few of them are looked at. Times have noise, too.
        assert!((85.0..200.0).contains(&truth) && (stopping.samples / truth - 1.0).abs() < 0.25, "{truth}");
        assert!(stopping.cost.cpu_nanos > 0);
        // A later share does not look again.
        let later = shot.measure(1, &settings, &Part::Samples { offset: 1, count: 2 }, run).unwrap();
        assert_eq!(later.stopping, None);
    });
}

#[test]
#[ignore = "tests/peers/blender.sh makes its files"]
fn the_samples_of_all_view_layers_count() {
    ask("layers", |shot, run| {
        let mut settings = shot.description().settings.clone();
        (settings.common.width, settings.common.height) = (256, 256);
        settings.own.insert("adaptive_sampling".to_owned(), false.into());
        let samples = Part::Samples { offset: 0, count: 8 };
        let measured = shot.measure(0, &settings, &samples, run).unwrap();
        // Half of the samples would count as images, if one layer's time stood for both.
        let images = measured.fixed.get("images").copied().unwrap_or_default();
        assert!(images < measured.sample_nanos() / 3, "{measured:?}");
    });
}

#[test]
#[ignore = "tests/peers/blender.sh makes its files"]
fn previews_count_pixels_and_regions_have_costs() {
    for name in names() {
        ask(&name, |shot, run| {
            let settings = shot.description().settings.clone();
            let frames = [0, 1, shot.description().frames.last];
            let counted = shot.preview(&frames, &settings, run).unwrap();
            assert!(counted.iter().map(|c| c.frame).eq(frames));
            for frame in &counted {
                assert_eq!(frame.counts.iter().map(|c| c.pixels).sum::<u64>(), settings.pixels());
                let objects = shot.description().objects.as_ref().unwrap().len();
                assert!(frame.counts.iter().filter_map(|c| c.object).all(|o| (o as usize) < objects));
                assert!(frame.counts.len() > 3);
            }
            assert_ne!(counted[0].counts, counted[2].counts, "the camera moves");
            let costs: Vec<String> =
                counted.iter().map(|c| format!("{:.3}", seconds(c.cost.cpu_nanos))).collect();
            println!("{name}: {} strata, previews of {} CPU s", counted[0].counts.len(), costs.join(", "));

            let mut settings = settings;
            settings.common.samples = 4;
            let regions: Vec<Region> =
                (0..4).map(|i| Region { x: 48 * (i % 2), y: 48 * (i / 2), width: 48, height: 48 }).collect();
            let parts = Part::Regions(regions.clone());
            let measured = shot.measure(0, &settings, &parts, run).unwrap();
            assert!(measured.pieces.iter().map(|p| p.region).eq(regions.iter().copied()));
            for part in ["prepare", "scene", "tree", "write"] {
                assert!(measured.fixed.contains_key(part), "{part}: {:?}", measured.fixed);
            }
            let sum: u64 = measured.pieces.iter().map(|p| p.cpu_nanos).sum();
            let whole = shot.render(0, &settings, &[], run).unwrap();
            let sampled = whole.cost.cpu_nanos - whole.fixed.values().sum::<u64>();
            println!("{name}: four quarters cost {:.2} of the frame", sum as f64 / sampled as f64);
            settings.own.insert("denoise".to_owned(), true.into());
            let denoised = shot.measure(0, &settings, &parts, run).unwrap();
            println!("{name}: denoising takes {:.3} CPU s", seconds(denoised.fixed["finish"]));
            assert!(denoised.fixed["finish"] > 10_000_000, "{:?}", denoised.fixed);
            let outside = Part::Regions(vec![Region { x: 90, y: 0, width: 8, height: 8 }]);
            assert!(matches!(shot.measure(0, &settings, &outside, run), Err(RendererError::Unsupported(_))));
        });
    }
}

/// Objects, materials and pixels of a preview.
type Counts = Vec<(Option<u32>, Option<u32>, u64)>;

/// Previews of some frames, and how they were made.
fn previews(shot: &dyn Shot, frames: &[i32], run: &Run<'_>) -> Vec<(PreviewBackend, Counts)> {
    let of_frame = |frame: FrameCounts| {
        let count = |c: PixelCount| (c.object, c.material, c.pixels);
        (frame.backend, frame.counts.into_iter().map(count).collect())
    };
    shot.preview(frames, &shot.description().settings, run).unwrap().into_iter().map(of_frame).collect()
}

/// Pixels by which two previews differ.
fn differences(one: &Counts, other: &Counts) -> u64 {
    let of = |counts: &Counts| -> BTreeMap<(Option<u32>, Option<u32>), u64> {
        counts.iter().map(|&(object, material, pixels)| ((object, material), pixels)).collect()
    };
    let (one, other) = (of(one), of(other));
    let strata: BTreeSet<_> = one.keys().chain(other.keys()).collect();
    let pixels = |counts: &BTreeMap<_, u64>, stratum| counts.get(stratum).copied().unwrap_or(0);
    strata.into_iter().map(|stratum| pixels(&one, stratum).abs_diff(pixels(&other, stratum))).sum()
}

#[test]
#[ignore = "tests/peers/blender.sh makes its files"]
fn what_changes_from_frame_to_frame_is_drawn_as_cycles_renders_it() {
    let frames = [0, 1, 2, 3, 4, 5];
    for name in names().into_iter().chain(["changing".to_owned()]) {
        let series = ask(&name, |shot, run| {
            let series = previews(shot, &frames, run);
            for frame in frames.into_iter().rev() {
                // Cycles renders a single frame.
                let (backend, rendered) = previews(shot, &[frame], run).remove(0);
                assert_eq!(backend, PreviewBackend::Renderer);
                let off = differences(&series[frame as usize].1, &rendered);
                assert!(off <= shot.description().settings.pixels() / 100, "{name}, {frame}: {off} pixels");
            }
            series
        });
        assert!(series.iter().all(|(backend, _)| *backend != PreviewBackend::Renderer), "{name} is drawn");
        assert!(series.windows(2).all(|pair| pair[0] != pair[1]), "{name} moves");
    }
}

#[test]
#[ignore = "tests/peers/blender.sh makes its files"]
fn cycles_renders_the_preview_of_what_triangles_do_not_show() {
    let by_cycles = |name: &str| {
        ask(name, |shot, run| {
            let found = previews(shot, &[0, 1, 2], run);
            assert!(found.iter().all(|(backend, _)| *backend == PreviewBackend::Renderer), "{name}");
            shot.description().notes.join("; ")
        })
    };
    let note = by_cycles("leaf");
    assert!(note.contains("material Material is transparent"), "{note}");
    // Nothing in the file says so, but Cycles shows something else.
    assert_eq!(by_cycles("clipped"), "");
    // Only the evaluated scene tells.
    assert_eq!(by_cycles("points"), "");
}

#[test]
#[ignore = "tests/peers/blender.sh makes its files"]
fn a_missing_texture_is_named_before_anything_is_rendered() {
    ask("missing", |shot, run| {
        let mut settings: Settings = shot.description().settings.clone();
        settings.common.samples = 1;
        let error = shot.render(0, &settings, &[], run).unwrap_err();
        assert!(matches!(error, RendererError::MissingAssets(_)) && error.is_permanent());
        assert!(error.to_string().contains("textures/wood.png"), "{error}");
        settings.own.insert("allow_missing".to_owned(), true.into());
        shot.render(0, &settings, &[], run).unwrap();
    });
}

#[test]
#[ignore = "tests/peers/blender.sh makes its files"]
fn a_packed_copy_has_textures_and_libraries_inside_and_renders_the_same_image() {
    for name in names().into_iter().chain(["linked".to_owned()]) {
        ask(&name, |shot, run| {
            let mut settings = shot.description().settings.clone();
            settings.common.samples = 1;
            let copy = run.scratch.join("copy.blend");
            assert!(shot.pack(&settings, &copy, run).unwrap(), "{name} refers to files outside");
            let packed = CYCLES.open(&copy, run).unwrap();
            assert!(packed.description().assets.iter().all(|asset| asset.state == AssetState::Packed));
            assert!(!packed.pack(&settings, &run.scratch.join("again.blend"), run).unwrap());
            let image = |shot: &dyn Shot| {
                let rendered = shot.render(0, &settings, &[], run).unwrap();
                let mut found = channels(&rendered.files[0]);
                found.retain(|name, _| !name.contains("Render Time"));
                found
            };
            assert!(image(shot) == image(&*packed), "{name}");
        });
    }
}

#[test]
#[ignore = "tests/peers/blender.sh makes its files"]
fn what_cannot_be_inside_a_file_is_named() {
    ask("sequence", |shot, run| {
        let settings = shot.description().settings.clone();
        let error = shot.pack(&settings, &run.scratch.join("copy.blend"), run).unwrap_err();
        assert!(matches!(error, RendererError::NotPacked(_)) && error.is_permanent());
        assert!(
            error.to_string().contains("image sea (") && error.to_string().contains("sea-0001.png"),
            "{error}"
        );
    });
    ask("missing", |shot, run| {
        let settings = shot.description().settings.clone();
        let error = shot.pack(&settings, &run.scratch.join("copy.blend"), run).unwrap_err();
        assert!(matches!(error, RendererError::MissingAssets(_)), "{error}");
    });
}

#[test]
#[ignore = "tests/peers/blender.sh makes its files"]
fn caches_and_light_profiles_that_are_missing_are_named() {
    ask("caches", |shot, run| {
        let assets = &shot.description().assets;
        let found: Vec<_> = assets.iter().map(|a| (a.kind.as_str(), a.name.as_str(), a.state)).collect();
        let expected = [
            ("cache", "Cube", AssetState::Missing),
            ("cache", "Cube", AssetState::Present),
            ("light profile", "Shader Nodetree", AssetState::Missing),
        ];
        assert_eq!(found, expected);
        let error = shot.render(0, &shot.description().settings, &[], run).unwrap_err().to_string();
        assert!(error.contains("cube.pc2") && error.contains("lamp.ies"), "{error}");
    });
}

#[test]
#[ignore = "tests/peers/blender.sh makes its files"]
fn measuring_writes_no_files_of_the_compositor() {
    ask("composited", |shot, run| {
        let written = || std::fs::read_dir(blends().join("written")).map_or(0, Iterator::count);
        let mut settings = shot.description().settings.clone();
        assert_eq!(settings.own["compositing"], true);
        (settings.common.width, settings.common.height, settings.common.samples) = (32, 32, 2);
        let region = Region { x: 0, y: 0, width: 8, height: 8 };
        for part in [Part::Samples { offset: 0, count: 1 }, Part::Regions(vec![region])] {
            shot.measure(0, &settings, &part, run).unwrap();
            assert_eq!(written(), 0, "{part:?}");
        }
        shot.render(0, &settings, &[], run).unwrap();
        assert_eq!(written(), 1, "a render writes what the file says");
    });
}

#[test]
#[ignore = "tests/peers/blender.sh makes its files"]
fn shadow_catchers_are_rendered_in_one_piece() {
    ask("catcher", |shot, run| {
        let mut settings = shot.description().settings.clone();
        settings.own.insert("adaptive_sampling".to_owned(), false.into());
        assert!(!shot.capabilities(&settings).contains(&Capability::TakeOverSamples));
        let part = Part::Samples { offset: 0, count: 1 };
        assert_eq!(shot.measure(0, &settings, &part, run).unwrap().artefact, None);
        settings.common.seed = u32::MAX;
        let error = shot.measure(0, &settings, &part, run).unwrap_err();
        assert!(matches!(&error, RendererError::Settings(error) if error.path == "/seed"), "{error}");
    });
}

#[test]
#[ignore = "tests/peers/blender.sh makes its files"]
fn scripts_of_a_file_are_not_run_and_said() {
    ask("script", |shot, run| {
        assert!(
            shot.description().notes.iter().any(|note| note.contains("startup.py")),
            "{:?}",
            shot.description().notes
        );
        let mut settings = shot.description().settings.clone();
        settings.common.samples = 1;
        shot.render(1, &settings, &[], run).unwrap();
        assert!(!blends().join("script-was-run").exists());
    });
}

#[test]
#[ignore = "tests/peers/blender.sh makes its files"]
fn a_camera_that_does_not_exist_is_named() {
    ask("script", |shot, run| {
        let mut settings = shot.description().settings.clone();
        settings.own.insert("camera".to_owned(), "Elsewhere".into());
        let error = shot.preview(&[1], &settings, run).unwrap_err();
        let RendererError::Settings(error) = error else { panic!("{error}") };
        assert_eq!(error.path, "/own/camera");
        assert!(error.reason.contains("no camera Elsewhere; its cameras are: Camera"), "{error}");
    });
}

#[test]
#[ignore = "tests/peers/blender.sh makes its files"]
fn markers_choose_the_camera_unless_the_job_does() {
    ask("markers", |shot, run| {
        let mut settings = shot.description().settings.clone();
        assert_eq!((settings.common.width, settings.common.height), (896, 1008), "as Blender computes them");
        assert_eq!(settings.own.get("camera"), None);
        let mut shows_the_cube = |camera: Option<&str>| {
            settings.own.remove("camera");
            settings.own.extend(camera.map(|name| ("camera".to_owned(), name.into())));
            let seen = shot.preview(&[1, 2], &settings, run).unwrap();
            [&seen[0], &seen[1]].map(|frame| frame.counts.iter().any(|count| count.object.is_some()))
        };
        assert_eq!(shows_the_cube(None), [true, false]);
        assert_eq!(shows_the_cube(Some("Camera")), [true, true]);
        assert_eq!(shows_the_cube(Some("Away")), [false, false]);
        assert_eq!(shows_the_cube(None), [true, false]);
    });
}

#[test]
#[ignore = "tests/peers/blender.sh makes its files"]
fn files_that_are_none_are_refused() {
    let scratch = tempfile::tempdir().unwrap();
    with(scratch.path(), &AtomicBool::new(false), &|_| {}, |run| {
        let absent = CYCLES.open(Path::new("/nowhere/shot.blend"), run).err().unwrap();
        assert!(matches!(absent, RendererError::MissingFile(_)), "{absent}");
        let text = scratch.path().join("text.blend");
        std::fs::write(&text, "no scene").unwrap();
        let error = CYCLES.open(&text, run).err().unwrap();
        assert!(matches!(error, RendererError::Scene { .. }), "{error}");
        assert!(error.to_string().contains("text.blend"), "{error}");
        let error = CYCLES.open(&blends().join("stereo.blend"), run).err().unwrap();
        assert!(error.is_permanent() && error.to_string().contains("Stereoscopy"), "{error}");
    });
}

#[test]
#[ignore = "tests/peers/blender.sh makes its files"]
fn a_cancelled_render_leaves_no_process_and_the_shot_goes_on() {
    let scratch = tempfile::tempdir().unwrap();
    let cancelled = AtomicBool::new(false);
    let name = names().remove(0);
    let shot = with(scratch.path(), &cancelled, &|_| {}, |run| {
        CYCLES.open(&blends().join(format!("{name}.blend")), run).unwrap()
    });
    assert_eq!(processes_of_ours(), 1);
    let mut settings = shot.description().settings.clone();
    settings.common.samples = 100_000;
    let stop = |_: f64| cancelled.store(true, Ordering::Relaxed);
    let error =
        with(scratch.path(), &cancelled, &stop, |run| shot.render(0, &settings, &[], run)).unwrap_err();
    assert!(matches!(error, RendererError::Cancelled), "{error}");
    assert_eq!(processes_of_ours(), 0);
    cancelled.store(false, Ordering::Relaxed);
    settings.common.samples = 1;
    with(scratch.path(), &cancelled, &|_| {}, |run| shot.render(0, &settings, &[], run)).unwrap();
    drop(shot);
    assert_eq!(processes_of_ours(), 0);
}

fn seconds(nanos: u64) -> f64 {
    nanos as f64 / 1e9
}
