//! The GPU against its CPU twin on whole scenes.

mod common;

use common::gpu;
use forelight_preview::{Choice, NOTHING, Preview, Previewer};
use forelight_scene::{Frame, Limits, Scene};
use forelight_test_needs::shared;

/// Share of pixels that must show the same stratum.
const SAME_STRATUM: f64 = 0.999;

/// Image side, pixels.
const SIDE: u32 = 512;

/// What two previews of one frame have in common.
struct Agreement {
    /// Share of pixels of the same stratum.
    stratum: f64,
    /// Of pixels with the same surface: share with positions within a thousandth of their distance.
    position: f64,
    /// And whose normals are within 2.5°.
    normal: f64,
    /// And that are the same in every bit of both.
    exact: f64,
}

fn compare(frame: &Frame, a: &Preview, b: &Preview) -> Agreement {
    assert_eq!((a.width, a.height, &a.pairs), (b.width, b.height, &b.pairs));
    let (mut same, mut surface, mut position, mut normal, mut exact) = (0, 0, 0, 0, 0);
    for i in 0..a.stratum.len() {
        if a.stratum[i] != b.stratum[i] {
            continue;
        }
        same += 1;
        if a.stratum[i] == NOTHING {
            continue;
        }
        surface += 1;
        let distance = (a.position[i] - frame.camera.origin).length();
        assert!(a.position[i].is_finite() && b.position[i].is_finite());
        position += u64::from((a.position[i] - b.position[i]).length() <= 1e-3 * distance);
        normal += u64::from(a.normal[i].dot(b.normal[i]) > 0.999);
        exact += u64::from(a.position[i] == b.position[i] && a.normal[i] == b.normal[i]);
    }
    let share = |n: u64| n as f64 / (surface as f64).max(1.0);
    Agreement {
        stratum: same as f64 / a.stratum.len() as f64,
        position: share(position),
        normal: share(normal),
        exact: share(exact),
    }
}

/// Compares both makers on up to `most` frames of a bundle, spread from the first to the last.
fn agree(path: &str, most: u32) {
    let Some(bundle) = shared(&format!("scenes/{path}")) else { return };
    let Some(mut gpu) = gpu() else { return };
    let mut cpu = Previewer::new(Choice::Cpu).expect("the CPU is always there");
    let scene = Scene::load(&bundle, &Limits::default()).expect("the bundle loads");
    let last = scene.frame_count() - 1;
    let mut numbers: Vec<u32> = (0..most).map(|i| i * last / (most - 1).max(1)).collect();
    numbers.dedup();
    for number in numbers {
        let mut frame = scene.frame(number).expect("the frame is in the shot");
        frame.camera = frame.camera.resized(SIDE, SIDE);
        let a = cpu.preview(&frame).expect("a preview");
        let b = gpu.preview(&frame).expect("a preview");
        let agreement = compare(&frame, &a, &b);
        let counts = b.counts();
        println!(
            "{path} frame {number}: {} triangles, {} strata ({} seen, {} background pixels); same stratum {:.4} %, of these \
             position {:.4} %, normal {:.4} %, every bit {:.4} %; cpu {:.0} ms, gpu {:.0} + {:.0} ms",
            frame.geometry.triangles.len(),
            counts.per_stratum.len(),
            counts.per_stratum.iter().filter(|&&n| n > 0).count(),
            counts.background,
            agreement.stratum * 100.0,
            agreement.position * 100.0,
            agreement.normal * 100.0,
            agreement.exact * 100.0,
            cpu.cost().cpu_nanos as f64 / 1e6,
            gpu.cost().cpu_nanos as f64 / 1e6,
            gpu.cost().device_nanos as f64 / 1e6,
        );
        assert_eq!(
            gpu.counts(&frame).expect("counts"),
            counts,
            "the compute shader counts what the preview shows"
        );
        assert!(agreement.stratum >= SAME_STRATUM, "{path} frame {number}: {}", agreement.stratum);
        assert!(agreement.position >= SAME_STRATUM, "{path} frame {number}: {}", agreement.position);
        assert!(agreement.normal >= SAME_STRATUM, "{path} frame {number}: {}", agreement.normal);
    }
}

#[test]
fn makers_agree_on_the_country_kitchen() {
    agree("country-kitchen", 4);
}

#[test]
fn makers_agree_on_the_modern_hall() {
    agree("modern-hall", 4);
}

#[test]
fn makers_agree_on_the_door_that_stands_ajar() {
    agree("veach-ajar", 1);
}

#[test]
fn makers_agree_on_the_living_room() {
    agree("living-room", 1);
}

#[test]
fn makers_agree_on_the_cornell_box() {
    agree("cornell-box", 1);
}

#[test]
fn makers_agree_on_the_door_that_moves() {
    agree("veach-ajar-animated", 6);
}

#[test]
fn makers_agree_on_the_glass_table() {
    agree("pc-glass-table", 3);
}

#[test]
fn makers_agree_on_the_small_animations() {
    let tests = [
        "02_node_hierarchy",
        "03_all_animations",
        "03_animated_cube",
        "06_parent-inverse-anim",
        "15_transmission",
    ];
    for test in tests {
        agree(&format!("gltf-anim-tests/{test}.gltf"), 3);
    }
}
