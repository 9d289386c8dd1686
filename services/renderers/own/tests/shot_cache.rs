//! The shared cache of a shot.

use forelight_preview::Choice;
use forelight_protocol::{CacheMode, CacheStats, RenderSettings, RenderSettingsRequest};
use forelight_renderer_own::{Given, OwnRenderer, OwnShot, RenderError, Rendered, plan_shared, render_frame};
use forelight_tracer::Cache;
use serde_json::json;
use std::path::Path;
use std::sync::atomic::AtomicBool;

fn open(name: &str) -> OwnShot {
    let bundle = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../deploy/scenes").join(name);
    OwnRenderer::new(Choice::Cpu).open(&bundle).unwrap()
}

fn settings(bounces: u32) -> RenderSettings {
    let settings = RenderSettingsRequest {
        spp: Some(2),
        ambient_bounces: Some(bounces),
        cache: Some(CacheMode::On),
        cache_rays: Some(48),
        ..Default::default()
    };
    settings.complete((40, 24))
}

fn plan(shot: &OwnShot, frames: &[u32], settings: &RenderSettings) -> Cache {
    shot.plan_cache(frames, settings, &|_| (), &AtomicBool::new(false)).unwrap().expect("a cache")
}

fn fill(shot: &OwnShot, cache: Cache, settings: &RenderSettings, part: (u32, u32)) -> Cache {
    let filled = shot.fill_cache(cache, settings, part, &|_, _| (), &AtomicBool::new(false));
    filled.unwrap().expect("nobody cancels")
}

fn render(shot: &OwnShot, frame: u32, settings: &RenderSettings, cache: Option<&Cache>) -> Rendered {
    let given = Given { cache: cache.cloned(), ..Given::default() };
    render_frame(shot, frame, settings, given, &|_| (), &AtomicBool::new(false)).unwrap().unwrap()
}

fn bits(rendered: &Rendered) -> Vec<[u32; 3]> {
    rendered.image.pixels.iter().map(|pixel| pixel.color.map(f32::to_bits)).collect()
}

fn stats(rendered: &Rendered) -> CacheStats {
    rendered.stats.cache.expect("a cache")
}

#[test]
fn a_cache_that_is_filled_in_parts_gives_every_frame_the_image_of_one_that_is_filled_at_once() {
    let shot = open("kitchen");
    for bounces in [1, 2] {
        let settings = settings(bounces);
        let planned = plan(&shot, &[0, 20], &settings);
        let whole = fill(&shot, planned.clone(), &settings, (0, 1));
        let mut merged = planned;
        for _ in 0..bounces {
            let parts: Vec<Cache> =
                (0..3).map(|part| fill(&shot, merged.clone(), &settings, (part, 3))).collect();
            parts.iter().for_each(|part| merged.merge(part).unwrap());
            merged.smooth_full();
        }
        assert_eq!(merged.without_times().to_bytes(), whole.without_times().to_bytes());
        for frame in [0, 9, 20] {
            let (one, other) = (
                render(&shot, frame, &settings, Some(&whole)),
                render(&shot, frame, &settings, Some(&merged)),
            );
            assert_eq!(bits(&one), bits(&other), "{bounces} bounces, frame {frame}");
            assert_eq!(one.stats.work, other.stats.work);
        }
    }
}

#[test]
fn a_frame_makes_only_the_records_that_the_shot_has_not_and_is_charged_for_these_alone() {
    let shot = open("corridor");
    let settings = settings(1);
    let cache = fill(&shot, plan(&shot, &[0, 24], &settings), &settings, (0, 1));
    for (frame, planned) in [(0, true), (24, true), (12, false)] {
        let (shared, alone) =
            (render(&shot, frame, &settings, Some(&cache)), render(&shot, frame, &settings, None));
        let use_of = stats(&shared);
        println!("frame {frame}: {:?}, {use_of:?}", shared.stats.cache_records);
        let own: u64 = shared.stats.cache_records.iter().sum::<u64>() - use_of.shared_records;
        assert_eq!(own == 0, planned, "frame {frame}: {own} of its own");
        assert_eq!((use_of.shared_records, use_of.dropped_records), (cache.records().iter().sum(), 0));
        assert!(own < alone.stats.cache_records.iter().sum::<u64>() / 2, "frame {frame}: {own} of its own");
        assert!(use_of.fill_work < stats(&alone).fill_work / 2, "{use_of:?}");
        assert!(shared.stats.work < alone.stats.work);
    }
}

#[test]
fn records_whose_light_has_moved_are_dropped_and_made_anew() {
    let shot = open("kitchen");
    let settings = settings(1);
    let cache = fill(&shot, plan(&shot, &[0, 40], &settings), &settings, (0, 1));
    let moved = render(&shot, 40, &settings, Some(&cache));
    let use_of = stats(&moved);
    println!("{:?}, {use_of:?}", moved.stats.cache_records);
    assert!(use_of.shared_records > 0 && use_of.dropped_records > 0, "{use_of:?}");
    assert_eq!(use_of.shared_records + use_of.dropped_records, cache.records().iter().sum::<u64>());
    assert!(moved.stats.cache_records.iter().sum::<u64>() > use_of.shared_records, "some are made anew");
    // The light matches a frame that makes all its records itself, except for the noise of 48 rays.
    let alone = render(&shot, 40, &settings, None);
    let mean = |r: &Rendered| {
        let sum: f64 = r.image.pixels.iter().flat_map(|p| p.color).map(f64::from).sum();
        sum / r.image.pixels.len() as f64
    };
    assert!((mean(&moved) / mean(&alone) - 1.0).abs() < 0.01, "{} and {}", mean(&moved), mean(&alone));
}

/// A closed room with a lamp. In frame 1 the camera is outside, where there is no light.
fn in_and_out() -> (OwnShot, tempfile::TempDir) {
    let folder = tempfile::tempdir().unwrap();
    let step = |property: &str, [inside, outside]: [[f64; 3]; 2]| {
        let keys = json!([{"frame": 0, "value": inside}, {"frame": 1, "value": outside}]);
        json!({"target": "camera", "property": property, "interpolation": "step", "keys": keys})
    };
    let description = json!({
        "version": 1, "name": "in and out", "geometry": ["room.obj"],
        "camera": {"origin": [0, 0, 0.9], "target": [0, 0, -1], "up": [0, 1, 0], "fov_deg": 60, "fov_axis": "x", "width": 40, "height": 24},
        "lights": [{"type": "quad", "corner": [-0.5, 0.9, -0.5], "edge_u": [1, 0, 0], "edge_v": [0, 0, 1], "radiance": [5, 5, 5]}],
        "animation": {"fps": 24, "frames": 2, "tracks": [
            step("origin", [[0.0, 0.0, 0.9], [0.0, 0.0, 9.0]]),
            step("target", [[0.0, 0.0, -1.0], [0.0, 0.0, 20.0]]),
        ]},
    });
    let corners = (0..8).map(|i| {
        let at = |bit: u32| if i >> bit & 1 == 0 { -1 } else { 1 };
        format!("v {} {} {}\n", at(0), at(1), at(2))
    });
    let obj =
        corners.collect::<String>() + "f 1 2 4 3\nf 5 7 8 6\nf 1 3 7 5\nf 2 6 8 4\nf 1 5 6 2\nf 3 4 8 7\n";
    std::fs::write(folder.path().join("scene.json"), description.to_string()).unwrap();
    std::fs::write(folder.path().join("room.obj"), obj).unwrap();
    (OwnRenderer::new(Choice::Cpu).open(folder.path()).unwrap(), folder)
}

#[test]
fn a_frame_without_use_for_a_cache_takes_nothing_from_the_others() {
    let (shot, _folder) = in_and_out();
    let settings = settings(1);
    let records = plan(&shot, &[0], &settings).records();
    assert!(records[0] > 0);
    for frames in [&[0, 1][..], &[1, 0], &[1, 0, 1]] {
        assert_eq!(plan(&shot, frames, &settings).records(), records);
    }
    let never = AtomicBool::new(false);
    assert!(shot.plan_cache(&[1], &settings, &|_| (), &never).unwrap().is_none());
    let shared = plan_shared(&shot, &[0, 1], &settings, &|_| (), &never).unwrap().unwrap();
    let own: Vec<Vec<u32>> = shared.frames.iter().map(|frame| frame.own.clone()).collect();
    assert_eq!((own[0].iter().sum::<u32>(), own[1].iter().sum::<u32>()), (0, 0), "{own:?}");
}

#[test]
fn a_cache_of_other_settings_or_another_scene_is_refused() {
    let (kitchen, corridor) = (open("kitchen"), open("corridor"));
    let made_for = settings(1);
    let cache = plan(&kitchen, &[0], &made_for);
    let refused = |shot: &OwnShot, settings: &RenderSettings| {
        let given = Given { cache: Some(cache.clone()), ..Given::default() };
        render_frame(shot, 0, settings, given, &|_| (), &AtomicBool::new(false)).map(|_| ()).unwrap_err()
    };
    for (shot, settings) in [
        (&corridor, made_for.clone()),
        (&kitchen, RenderSettings { seed: 1, ..made_for.clone() }),
        (&kitchen, RenderSettings { cache_accuracy: 300, ..made_for.clone() }),
    ] {
        assert!(matches!(refused(shot, &settings), RenderError::Cache(_)), "{settings:?}");
    }
    // The size of the image and its samples do not affect the light.
    let larger = RenderSettings { width: 50, spp: 1, ..made_for };
    render(&kitchen, 0, &larger, Some(&cache));
}
