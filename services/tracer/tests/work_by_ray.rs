//! All work is attributed to the rays that caused it.

mod support;

use forelight_protocol::Integrator;
use forelight_scene::{Environment, Frame};
use forelight_tracer::{CacheSettings, RAY_NAMES, Settings, Totals, Tracer};
use std::sync::atomic::AtomicBool;
use support::everything;

const PRIMARY: usize = 0;
const AMBIENT: usize = 5;

/// Without a sky, for which a surface that gathers sends no rays of its own.
fn unlit_from_outside() -> Frame {
    Frame { environment: Environment::Black, ..everything() }
}

fn settings(ambient_bounces: u32) -> Settings {
    Settings { width: 40, height: 28, spp: 3, ambient_bounces, ambient_divisions: 8, ..Settings::default() }
}

fn totals(frame: &Frame, settings: &Settings) -> Totals {
    let tracer = Tracer::new(frame, settings);
    let image = tracer.render(None, &|_| {}, &AtomicBool::new(false)).expect("nobody cancels");
    for pixel in &image.pixels {
        assert_eq!(
            pixel.work_by_ray.iter().sum::<u64>(),
            pixel.work,
            "nothing is missing, nothing counts twice"
        );
    }
    image.totals()
}

#[test]
fn ambient_is_what_would_not_be_there_without_indirect_light() {
    let frame = unlit_from_outside();
    let direct = totals(&frame, &settings(0)).work_by_ray;
    assert!(direct[AMBIENT] == 0 && (0..7).all(|kind| kind == AMBIENT || direct[kind] > 0), "{direct:?}");
    let cache = Some(CacheSettings { accuracy: 300, rays: 48 });
    for settings in [settings(1), settings(2), Settings { cache, ..settings(2) }] {
        let by_ray = totals(&frame, &settings).work_by_ray;
        assert_eq!(by_ray[PRIMARY], direct[PRIMARY], "{settings:?}");
        // Points in mirrors share random sequences with gathered ones, so they see other points of the
        // lights.
        for kind in (0..7).filter(|&kind| kind != AMBIENT) {
            let times = by_ray[kind] as f64 / direct[kind] as f64;
            assert!((times - 1.0).abs() < 0.02, "{times} times {} with {settings:?}", RAY_NAMES[kind]);
        }
        assert!(by_ray[AMBIENT] > 0, "{settings:?}");
    }
}

#[test]
fn all_work_of_a_path_from_its_first_diffuse_bounce_on_is_ambient() {
    let frame = unlit_from_outside();
    let path = |ambient_bounces| Settings { integrator: Integrator::Path, ..settings(ambient_bounces) };
    let (few, many) = (totals(&frame, &path(0)), totals(&frame, &path(16)));
    assert_eq!(few.work_by_ray[PRIMARY], many.work_by_ray[PRIMARY]);
    assert!(many.work_by_ray[AMBIENT] > few.work_by_ray[AMBIENT] && few.work_by_ray[AMBIENT] > 0);
}
