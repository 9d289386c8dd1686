//! The picture of a preview.

mod common;

use common::{World, camera, grey};
use forelight_preview::{Choice, Previewer, palette, picture};
use forelight_scene::{Color, Material, MaterialClass, Surface};
use glam::Vec3;

fn material(class: MaterialClass) -> Material {
    let white = Color::plain(Vec3::ONE);
    let surface = match class {
        MaterialClass::Transparent => Surface::ThinGlass { ior: 1.5, transmittance: white },
        MaterialClass::Specular => Surface::Metal { f0: white, alpha: 0.0 },
        MaterialClass::Diffuse => return grey(),
    };
    Material { surface, ..grey() }
}

const CLASSES: [MaterialClass; 3] =
    [MaterialClass::Transparent, MaterialClass::Diffuse, MaterialClass::Specular];

#[test]
fn the_largest_channel_names_the_class_and_every_stratum_has_its_own_colour() {
    let mut world = World::default();
    for i in 0..300 {
        world.facing(Vec3::NEG_Z, 1.0, material(CLASSES[i % 3]));
    }
    let colours = palette(&world.frame(camera(8, 8)));
    for (i, colour) in colours.iter().enumerate() {
        for other in 0..3 {
            assert!(other == i % 3 || colour[i % 3] > colour[other] + 15, "{i}: {colour:?}");
        }
        assert!(!colours[..i].contains(colour), "{i}: {colour:?} is taken");
        if let Some(next) = colours.get(i + 3) {
            let distance: u32 = (0..3).map(|c| u32::from(colour[c].abs_diff(next[c]))).sum();
            assert!(distance > 60, "{i}: {colour:?} and {next:?} look alike");
        }
    }
}

#[test]
fn a_picture_shows_class_background_and_shape() {
    let mut world = World::default();
    let pane =
        world.quad(Vec3::new(-1.0, -1.0, -1.0), Vec3::X, Vec3::Y * 2.0, material(MaterialClass::Transparent));
    world.quad(
        Vec3::new(0.0, -1.0, -1.0),
        Vec3::new(1.0, 0.0, -2.0),
        Vec3::Y * 2.0,
        material(MaterialClass::Specular),
    );
    let frame = world.frame(camera(16, 16));
    let preview = Previewer::new(Choice::Cpu).and_then(|mut p| p.preview(&frame)).expect("a preview");
    let image = picture(&preview, &frame);
    assert_eq!(image.dimensions(), (16, 16));
    let colours = palette(&frame);
    let (left, right) = (image.get_pixel(4, 8).0, image.get_pixel(8, 8).0);
    assert_eq!(preview.stratum[8 * 16 + 4], pane);
    assert!(left[0] > left[1] && left[0] > left[2], "glass is red: {left:?}");
    assert!(right[2] > right[0] && right[2] > right[1], "metal is blue: {right:?}");
    assert!(left[0] >= (f32::from(colours[0][0]) * 0.9) as u8, "facing the eye: {left:?}");
    assert!(right[2] < (f32::from(colours[1][2]) * 0.95) as u8, "turned away: {right:?}");
    let background = image.get_pixel(15, 0).0;
    assert!(background.iter().all(|&c| c < 20), "{background:?}");
    assert_eq!(image, picture(&preview, &frame));
}
