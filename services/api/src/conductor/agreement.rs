//! The service's estimate and the quote that a worker's machine makes alone are one and the same.

use std::collections::BTreeSet;
use std::path::Path;

use forelight_forecast::{FIRST_FRAMES, MOST_FRAMES};
use forelight_protocol::{ArtifactHash, ProfileArtifacts, RenderSettings, RenderSettingsRequest};
use forelight_store::MeasuredProfile;
use forelight_worker::{
    Ambient, Observer, ProfiledFrame, QuoteOptions, ShotInfo, preview_result, profile_result, quote,
};

use super::choose::{frames_to_profile, more_to_profile};
use super::estimate::calibrated;
use super::explain::explained;

/// Forty small things of ten materials, in front of a floor, while the camera moves along them: more strata than samples
/// can tell apart, so that both sides have to join the same ones.
fn write_bundle(folder: &Path) {
    let scene = serde_json::json!({
        "version": 1, "name": "shelf", "geometry": ["shelf.obj"],
        "camera": {"origin": [-3, 2, 6], "target": [0, 0.5, 0], "up": [0, 1, 0], "fov_deg": 60, "fov_axis": "x", "width": 48, "height": 32},
        "lights": [{"type": "quad", "corner": [-1, 4, -1], "edge_u": [2, 0, 0], "edge_v": [0, 0, 2], "radiance": [9, 9, 9]}],
        "animation": {"fps": 24, "frames": 24, "tracks": [{
            "target": "camera", "property": "origin", "interpolation": "linear",
            "keys": [{"frame": 0, "value": [-3, 2, 6]}, {"frame": 5, "value": [3, 1, 5]}],
        }]},
    });
    std::fs::write(folder.join("scene.json"), scene.to_string()).unwrap();
    let mut materials = String::new();
    let mut geometry = String::from("mtllib shelf.mtl\n");
    let mut quad = |name: &str, material: u32, x: f64, y: f64, z: f64, size: f64, flat: bool| {
        geometry += &format!("o {name}\nusemtl m{material}\n");
        for (u, v) in [(0.0, 0.0), (size, 0.0), (size, size), (0.0, size)] {
            let (dy, dz) = if flat { (0.0, -v) } else { (v, 0.0) };
            geometry += &format!("v {} {} {}\n", x + u, y + dy, z + dz);
        }
        geometry += "f -4 -3 -2 -1\n";
    };
    for material in 0..10 {
        materials += &match material % 3 {
            0 => format!("newmtl m{material}\nillum 1\nKd 0.5 0.{material} 0.3\n"),
            1 => format!("newmtl m{material}\nillum 3\nKs 0.9 0.9 0.{material}\n"),
            _ => format!("newmtl m{material}\nillum 4\nNi 1.{material}\nTf 1 1 1\n"),
        };
    }
    quad("floor", 0, -4.0, 0.0, 4.0, 8.0, true);
    for i in 0..40u32 {
        let (column, row) = (f64::from(i % 10), f64::from(i / 10));
        let size = 0.1 + 0.1 * f64::from(i % 4);
        quad(&format!("thing{i}"), (i * 7) % 10, -3.0 + 0.6 * column, 0.1 + 0.5 * row, -row, size, false);
    }
    std::fs::write(folder.join("shelf.mtl"), materials).unwrap();
    std::fs::write(folder.join("shelf.obj"), geometry).unwrap();
}

/// An observer that looks away.
struct Nobody;

impl Observer for Nobody {
    fn previewed(&self, _: usize, _: usize) {}
    fn profiled(&self, _: usize, _: usize) {}
    fn is_cancelled(&self) -> bool {
        false
    }
}

/// Profiles as the service has them, from the machine that quoted.
fn measured<'a>(
    info: &ShotInfo,
    settings: &RenderSettings,
    profiled: impl Iterator<Item = &'a ProfiledFrame>,
) -> Vec<MeasuredProfile> {
    let artifacts = ProfileArtifacts { profile: ArtifactHash([0; 32]), preview_png: None };
    let profile = |profiled| MeasuredProfile {
        result: profile_result(info, settings, profiled, artifacts),
        node_speed: 1.0,
        spp: settings.spp,
    };
    profiled.map(profile).collect()
}

#[test]
fn an_offline_quote_and_the_service_profile_the_same_frames_and_more_where_that_pays() {
    let folder = tempfile::tempdir().unwrap();
    write_bundle(folder.path());
    let shot = Ambient::new(forelight_preview::Choice::Cpu).open(folder.path()).unwrap();
    let info = forelight_worker::Renderer::info(&shot);
    let frames: Vec<u32> = (0..24).collect();
    let mut most = BTreeSet::new();
    for (cache, spp) in [("off", 1), ("off", 64), ("on", 1), ("on", 64)] {
        let settings: RenderSettingsRequest =
            serde_json::from_value(serde_json::json!({"spp": spp, "cache": cache, "cache_rays": 48}))
                .unwrap();
        let settings = settings.complete((192, 128));
        let options = QuoteOptions { samples: 16, seed: 3, ..QuoteOptions::default() };
        let quoted = quote(&shot, &frames, &settings, &options, &Nobody).unwrap();
        let preview = preview_result(info, &frames, &settings, &quoted.counted);
        let mut chosen = frames_to_profile(&preview, None).unwrap();
        assert_eq!(chosen.len(), FIRST_FRAMES);
        let of_first = quoted.profiled.iter().filter(|profiled| chosen.contains(&profiled.frame));
        let profiles = measured(info, &settings, of_first);
        chosen.extend(more_to_profile(&preview, &profiles).unwrap());
        chosen.sort_unstable();
        assert_eq!(chosen, quoted.profiled.iter().map(|profiled| profiled.frame).collect::<Vec<_>>());
        assert!(chosen.len() <= MOST_FRAMES);
        most.insert(chosen.len());
    }
    assert!(most.len() > 1 && most.last() > Some(&FIRST_FRAMES), "{most:?}");
}

#[test]
fn an_offline_quote_and_the_estimate_of_the_service_agree_to_the_last_bit_and_explain_themselves_alike() {
    let folder = tempfile::tempdir().unwrap();
    write_bundle(folder.path());
    let shot = Ambient::new(forelight_preview::Choice::Cpu).open(folder.path()).unwrap();
    let info = forelight_worker::Renderer::info(&shot);
    let frames = [0, 1, 2, 3, 4, 5];
    for (materials, samples, cache, ambient_bounces) in [
        ("full", 48, "off", 1),
        ("full", 100, "off", 1),
        ("lambert", 48, "off", 1),
        ("full", 48, "on", 1),
        ("full", 48, "on", 2),
    ] {
        let settings: RenderSettingsRequest = serde_json::from_value(serde_json::json!({
            "spp": 1, "ambient_bounces": ambient_bounces, "materials": materials, "cache": cache, "cache_rays": 48,
        }))
        .unwrap();
        let settings = settings.complete((48, 32));
        let options = QuoteOptions { samples, profile_frames: Some(2), seed: 3, ..QuoteOptions::default() };
        let quoted = quote(&shot, &frames, &settings, &options, &Nobody).unwrap();

        let preview = preview_result(info, &frames, &settings, &quoted.counted);
        assert!(preview.strata.len() > samples as usize / 4, "there is nothing to be joined");
        let levels = if cache == "on" { ambient_bounces } else { 0 };
        assert!(preview.frames.iter().all(|frame| frame.cache_records.len() == levels), "{preview:?}");
        let chosen = frames_to_profile(&preview, Some(2)).unwrap();
        assert_eq!(chosen, quoted.profiled.iter().map(|profiled| profiled.frame).collect::<Vec<_>>());
        let profiles = measured(info, &settings, quoted.profiled.iter());
        let estimated = calibrated(&preview, &profiles, None, None).unwrap();
        // Every field of the one is in the other.
        let of = quoted.document.of.clone().unwrap();
        assert_eq!(estimated.job.clone().document(of, estimated.frames), quoted.document);
        assert_eq!(estimated.job.total.cache_records.len(), levels);
        let explanation = explained(&settings, &preview, &profiles, None, None).unwrap();
        assert_eq!(explanation, quoted.explained(&info.strata, &settings));
        assert!(explanation.objects.len() > 1 && !explanation.words.is_empty(), "{explanation:?}");
    }
}
