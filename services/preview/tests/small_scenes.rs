//! What previews say of worlds small enough to know the answer.

mod common;

use common::{World, alpha_texture, camera, cut_out, gpu, grey, makers};
use forelight_preview::{Choice, NOTHING, PreviewError, Previewer};
use forelight_scene::{Frame, Material};
use glam::{Vec2, Vec3};
use std::sync::Arc;

/// A square at distance 2 that covers the middle 4 × 4 of 8 × 8 pixels.
fn one_square() -> Frame {
    let mut world = World::default();
    world.facing(Vec3::new(0.0, 0.0, -2.0), 2.0, grey());
    world.frame(camera(8, 8))
}

/// The strata of an image as rows of letters: A is stratum 0, a dot is nothing.
fn letters(strata: &[u32], width: u32) -> Vec<String> {
    let letter = |&s: &u32| if s == NOTHING { '.' } else { char::from(b'A' + s as u8) };
    strata.chunks(width as usize).map(|row| row.iter().map(letter).collect()).collect()
}

#[test]
fn a_square_covers_the_pixels_whose_centres_it_covers() {
    let frame = one_square();
    for mut maker in makers() {
        let preview = maker.preview(&frame).expect("a preview");
        let edge = "........";
        let middle = "..AAAA..";
        let expected = [edge, edge, middle, middle, middle, middle, edge, edge];
        assert_eq!(letters(&preview.stratum, 8), expected, "{}", maker.backend());
        let first = 2 * 8 + 2;
        assert_eq!(preview.position[first], Vec3::new(-0.75, 0.75, -2.0));
        assert_eq!(preview.normal[first], Vec3::Z);
        assert_eq!((preview.object(first), preview.material(first)), (Some(0), Some(0)));
        assert_eq!(
            (preview.object(0), preview.position[0], preview.normal[0]),
            (None, Vec3::ZERO, Vec3::ZERO)
        );
        assert_eq!(preview.object(64), None);
        let counts = preview.counts();
        assert_eq!((counts.per_stratum.as_slice(), counts.background), (&[16][..], 48));
        assert_eq!(maker.counts(&frame).expect("counts"), counts);
    }
}

#[test]
fn a_back_face_is_seen_and_keeps_its_normal() {
    let mut world = World::default();
    world.quad(Vec3::new(-9.0, -9.0, -2.0), Vec3::Y * 18.0, Vec3::X * 18.0, grey());
    let frame = world.frame(camera(4, 4));
    for mut maker in makers() {
        let preview = maker.preview(&frame).expect("a preview");
        assert!(preview.stratum.iter().all(|&s| s == 0));
        assert!(preview.normal.iter().all(|&n| n == Vec3::NEG_Z));
    }
}

#[test]
fn the_nearer_surface_hides_the_farther_whatever_their_order() {
    for swap in [false, true] {
        let mut world = World::default();
        let (near, far) = (Vec3::new(0.0, 0.0, -2.0), Vec3::new(0.0, 0.0, -2.001));
        let first = world.facing(if swap { far } else { near }, 2.0, grey());
        let second = world.facing(if swap { near } else { far }, 9.0, grey());
        let frame = world.frame(camera(8, 8));
        for mut maker in makers() {
            let counts = maker.counts(&frame).expect("counts");
            let (a, b) = (counts.per_stratum[first as usize], counts.per_stratum[second as usize]);
            assert_eq!((a, b), if swap { (0, 64) } else { (16, 48) }, "{}", maker.backend());
        }
    }
}

#[test]
fn of_surfaces_at_the_same_depth_the_lowest_index_is_seen() {
    let mut world = World::default();
    for _ in 0..3 {
        world.quad(Vec3::new(-3.0, -1.0, -1.5), Vec3::new(6.0, 0.1, -0.7), Vec3::new(0.2, 4.0, -2.0), grey());
    }
    let frame = world.frame(camera(64, 64));
    for mut maker in makers() {
        let counts = maker.counts(&frame).expect("counts");
        assert!(counts.per_stratum[0] > 1000, "{counts:?}");
        assert_eq!(counts.per_stratum[1..], [0, 0], "{}", maker.backend());
    }
}

#[test]
fn thin_materials_are_not_drawn_and_masks_cut_out_what_their_alpha_says() {
    let mut world = World::default();
    world.textures.push(alpha_texture(1, &[9]));
    // Left column opaque, right column not, and the bottom right in between.
    world.textures.push(alpha_texture(2, &[255, 0, 255, 126]));
    world.facing(Vec3::new(0.0, 0.0, -1.0), 2.0, Material { opacity: 0.49, ..grey() });
    world.facing(Vec3::new(0.0, 0.0, -1.5), 9.0, cut_out(0));
    let cut = world.facing(Vec3::new(0.0, 0.0, -2.0), 4.0, cut_out(1));
    let back = world.facing(Vec3::new(0.0, 0.0, -3.0), 9.0, Material { opacity: 0.5, ..grey() });
    let frame = world.frame(camera(64, 64));
    let texture = &frame.textures[1];
    let mut previews = Vec::new();
    for mut maker in makers() {
        let preview = maker.preview(&frame).expect("a preview");
        for (i, &stratum) in preview.stratum.iter().enumerate() {
            let uv = Vec2::new((i % 64) as f32 + 0.5, 63.5 - (i / 64) as f32) / 64.0;
            let expected = if texture.alpha(uv) >= 0.5 { cut } else { back };
            assert_eq!(stratum, expected, "pixel {i} of {}", maker.backend());
        }
        let counts = maker.counts(&frame).expect("counts");
        assert!(
            counts.per_stratum[cut as usize] > 1000 && counts.per_stratum[back as usize] > 1000,
            "{counts:?}"
        );
        previews.push(preview);
    }
    assert!(previews.windows(2).all(|pair| pair[0] == pair[1]));
}

#[test]
fn masks_repeat_outside_of_the_unit_square_as_on_the_cpu() {
    let mut world = World::default();
    let alpha: Vec<u8> = (0..15).map(|i| (i * 89 % 256) as u8).collect();
    world.textures.push(alpha_texture(5, &alpha));
    world.quad(Vec3::new(-3.0, -2.0, -2.0), Vec3::new(6.0, 0.0, -1.0), Vec3::new(0.0, 5.0, -2.0), cut_out(0));
    for uv in &mut world.geometry.uvs {
        *uv = *uv * Vec2::new(7.3, -4.1) - Vec2::new(2.2, -1.7);
    }
    let frame = world.frame(camera(128, 128));
    let mut previews = makers().into_iter().map(|mut maker| maker.preview(&frame).expect("a preview"));
    let cpu = previews.next().expect("the CPU is always there");
    let counts = cpu.counts();
    assert!(counts.per_stratum[0] > 2000 && counts.background > 2000, "{counts:?}");
    for gpu in previews {
        let different = cpu.stratum.iter().zip(&gpu.stratum).filter(|(a, b)| a != b).count();
        assert!(different <= 4, "{different} pixels differ"); // where alpha is within rounding of the cutoff
    }
}

#[test]
fn what_is_behind_the_camera_is_not_seen_and_what_passes_it_is_cut() {
    let mut world = World::default();
    world.facing(Vec3::new(0.0, 0.0, 2.0), 9.0, grey());
    // A floor from far behind to far ahead, one metre down.
    let floor =
        world.quad(Vec3::new(-1e4, -1.0, 1e4), Vec3::new(2e4, 0.0, 0.0), Vec3::new(0.0, 0.0, -2e4), grey());
    let frame = world.frame(camera(64, 64));
    for mut maker in makers() {
        let preview = maker.preview(&frame).expect("a preview");
        for (i, &stratum) in preview.stratum.iter().enumerate() {
            let expected = if i / 64 >= 32 { floor } else { NOTHING };
            assert_eq!(stratum, expected, "pixel {i} of {}", maker.backend());
            if stratum == floor {
                assert_eq!(preview.position[i].y, -1.0);
                assert_eq!(preview.normal[i], Vec3::Y);
            }
        }
    }
}

#[test]
fn from_inside_a_box_no_pixel_sees_out_and_a_hand_before_the_eye_is_seen() {
    let mut world = World::default();
    let (a, b) = (Vec3::new(-50.0, -40.0, -30.0), Vec3::new(30.0, 60.0, 70.0));
    let size = b - a;
    let (x, y, z) = (Vec3::X * size.x, Vec3::Y * size.y, Vec3::Z * size.z);
    for (corner, u, v) in [(a, x, y), (a, y, z), (a, z, x), (b, -x, -y), (b, -y, -z), (b, -z, -x)] {
        world.quad(corner, u, v, grey());
    }
    let hand = world.facing(Vec3::new(0.0, 0.0, -1e-4), 1e-4, grey());
    let frame = world.frame(camera(64, 64));
    for mut maker in makers() {
        let counts = maker.counts(&frame).expect("counts");
        assert_eq!(counts.background, 0, "{}", maker.backend());
        assert_eq!(counts.per_stratum[hand as usize], 32 * 32, "{}", maker.backend());
    }
}

#[test]
fn an_empty_world_shows_nothing() {
    let frame = World::default().frame(camera(5, 3));
    for mut maker in makers() {
        let preview = maker.preview(&frame).expect("a preview");
        assert_eq!(preview.stratum, [NOTHING; 15]);
        let counts = maker.counts(&frame).expect("counts");
        assert_eq!((counts.per_stratum.len(), counts.background), (0, 15));
        // And a world with something still works afterwards.
        assert_eq!(maker.counts(&one_square()).expect("counts").per_stratum, [16]);
    }
}

#[test]
fn images_without_pixels_or_with_too_many_are_errors() {
    for mut maker in makers() {
        for (width, height) in [(0, 4), (4, 0), (0, 0)] {
            let mut frame = one_square();
            frame.camera.width = width;
            frame.camera.height = height;
            assert_eq!(maker.preview(&frame), Err(PreviewError::EmptyImage { width, height }));
            assert_eq!(maker.counts(&frame), Err(PreviewError::EmptyImage { width, height }));
        }
        let mut frame = one_square();
        frame.camera.width = u32::MAX;
        assert!(matches!(maker.counts(&frame), Err(PreviewError::ImageTooLarge { .. })));
        let mut frame = one_square();
        frame.camera.up.y = f32::NAN;
        assert_eq!(maker.preview(&frame), Err(PreviewError::Camera("up")));
    }
}

#[test]
fn images_larger_than_a_tile_have_no_seams() {
    let Some(mut gpu) = gpu() else { return };
    let mut cpu = Previewer::new(Choice::Cpu).expect("the CPU is always there");
    let mut wide = World::default();
    for i in 0..10 {
        let centre = Vec3::new(-0.9 + 0.2 * i as f32, 0.0005 * i as f32, -1.0);
        wide.facing(centre, 0.11 + 0.008 * i as f32, grey());
    }
    let mut frame = wide.frame(camera(9001, 24));
    for turned in [false, true] {
        if turned {
            let camera = &mut frame.camera;
            (camera.width, camera.height) = (camera.height, camera.width);
            (camera.tan_half_x, camera.tan_half_y) = (camera.tan_half_y, camera.tan_half_x);
            (camera.right, camera.up) = (-camera.up, camera.right);
        }
        let (a, b) = (cpu.preview(&frame).expect("a preview"), gpu.preview(&frame).expect("a preview"));
        let different = a.stratum.iter().zip(&b.stratum).filter(|(a, b)| a != b).count();
        assert!(different <= 10 * 24, "{different} pixels differ: more than snapping of edges explains");
        assert_eq!(gpu.counts(&frame).expect("counts"), b.counts());
    }
}

#[test]
fn counts_are_those_of_the_preview_for_few_and_for_many_strata() {
    for side in [3, 60] {
        let mut world = World::default();
        for i in 0..side * side {
            let (x, y) = ((i % side) as f32 + 0.5, (i / side) as f32 + 0.5);
            let centre = Vec3::new(x, y, 0.0) * (2.0 / side as f32) - Vec3::ONE;
            world.facing(centre, 1.4 / side as f32, grey());
        }
        let frame = world.frame(camera(333, 333));
        let mut all = Vec::new();
        for mut maker in makers() {
            let counts = maker.counts(&frame).expect("counts");
            assert_eq!(counts, maker.preview(&frame).expect("a preview").counts(), "{}", maker.backend());
            assert_eq!(counts.pixels(), 333 * 333);
            assert!(counts.per_stratum.iter().all(|&n| n > 0));
            all.push(counts);
        }
        assert!(all.windows(2).all(|pair| pair[0] == pair[1]));
    }
}

#[test]
fn every_change_from_frame_to_frame_is_seen() {
    for mut maker in makers() {
        let frame = one_square();
        assert_eq!(maker.counts(&frame).expect("counts").per_stratum, [16]);
        let mut moved = frame.clone();
        let mut geometry = (*frame.geometry).clone();
        for p in &mut geometry.positions {
            p.x += 1.0;
        }
        moved.geometry = Arc::new(geometry);
        let preview = maker.preview(&moved).expect("a preview");
        assert_eq!(letters(&preview.stratum, 8)[3], "....AAAA");
        let mut hidden = moved.clone();
        hidden.materials = [Material { opacity: 0.0, ..grey() }].into();
        assert_eq!(maker.counts(&hidden).expect("counts").per_stratum, [0], "{}", maker.backend());
        let mut masked = moved.clone();
        masked.materials = [cut_out(0)].into();
        masked.textures = [alpha_texture(2, &[255, 0])].into();
        assert_eq!(maker.counts(&masked).expect("counts").per_stratum, [8], "{}", maker.backend());
        masked.textures = [alpha_texture(1, &[255])].into();
        assert_eq!(maker.counts(&masked).expect("counts").per_stratum, [16], "{}", maker.backend());
        let mut turned = moved.clone();
        turned.camera.right = Vec3::NEG_X;
        let preview = maker.preview(&turned).expect("a preview");
        assert_eq!(letters(&preview.stratum, 8)[3], "AAAA....");
        let mut two = World::default();
        two.facing(Vec3::new(0.0, 0.0, -2.0), 4.0, grey());
        two.facing(Vec3::new(0.0, 0.0, -1.0), 1.0, grey());
        assert_eq!(maker.counts(&two.frame(camera(8, 8))).expect("counts").per_stratum, [48, 16]);
        assert_eq!(maker.counts(&frame).expect("counts").per_stratum, [16], "{}", maker.backend());
    }
}

#[test]
fn a_device_can_be_opened_again_and_used_from_another_thread() {
    let Some(mut first) = gpu() else { return };
    let Some(mut second) = gpu() else { panic!("the second previewer found no device") };
    let frame = one_square();
    assert_eq!(first.preview(&frame), second.preview(&frame));
    drop(first);
    let frame_there = frame.clone();
    let elsewhere = std::thread::spawn(move || second.preview(&frame_there)).join().expect("no panic");
    let mut third = gpu().expect("the third previewer found no device");
    assert_eq!(third.preview(&frame), elsewhere);
}

#[test]
fn auto_names_what_it_uses_and_says_what_it_took() {
    let mut auto = Previewer::new(Choice::Auto).expect("auto never fails");
    assert_eq!(auto.backend() == "gpu", auto.adapter().is_some());
    assert_eq!(auto.backend() == "gpu", gpu().is_some());
    let mut cpu = Previewer::new(Choice::Cpu).expect("the CPU is always there");
    assert_eq!((cpu.backend(), cpu.adapter()), ("cpu", None));
    let frame = one_square();
    for maker in [&mut auto, &mut cpu] {
        maker.counts(&frame).expect("counts");
        let first = maker.cost();
        maker.counts(&frame).expect("counts");
        let second = maker.cost();
        assert!(first.cpu_nanos > 0 && second.cpu_nanos > 0);
        assert_eq!((first.nodes, first.triangles), (second.nodes, second.triangles));
        match maker.backend() {
            "cpu" => assert!(first.nodes >= 64 && first.triangles >= 64 && first.device_nanos == 0),
            _ => assert!(first.nodes == 0 && first.triangles == 0 && first.device_nanos > 0),
        }
        let mut broken = frame.clone();
        broken.camera.width = 0;
        assert!(maker.counts(&broken).is_err());
        assert_eq!(maker.cost(), Default::default());
    }
}

#[test]
fn the_cpu_twin_does_not_depend_on_the_number_of_threads() {
    let mut world = World::default();
    for i in 0..40 {
        let at = Vec3::new((i * 7 % 11) as f32 - 5.0, (i * 5 % 13) as f32 - 6.0, -4.0 - (i % 9) as f32);
        world.quad(at, Vec3::new(2.0, 0.3, -1.0), Vec3::new(-0.4, 1.5, 0.8), grey());
    }
    let frame = world.frame(camera(97, 61));
    let results = [1, 3].map(|threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        pool.install(|| {
            let mut maker = Previewer::new(Choice::Cpu).expect("the CPU is always there");
            let preview = maker.preview(&frame).expect("a preview");
            let cost = maker.cost();
            (preview, cost.nodes, cost.triangles, maker.counts(&frame).expect("counts"))
        })
    });
    assert_eq!(results[0], results[1]);
}
