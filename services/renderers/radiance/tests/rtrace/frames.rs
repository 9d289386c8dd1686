//! Which octrees and views are frames, and which sizes fit them.

use super::{RIF, World, pixels_of};
use forelight_renderer::door::{Common, Part, RendererError, Settings};
use forelight_renderer::process::{Program, run};
use std::path::PathBuf;

#[test]
#[ignore = "tests/peers/radiance_renderer.sh installs Radiance"]
fn views_are_frames_where_a_number_is_a_part_of_the_name_of_an_octree() {
    let world = World::new();
    let first = "VIEW= -vtv -vp 2 .2 1.5 -vd 0 1 0 -vu 0 0 1 -vh 60 -vv 60\n";
    let views =
        |count: usize| (1..count).fold(first.to_owned(), |all, n| all + &format!("VIEW= -vp 2 {n} 1\n"));
    let frames = |name: &str| world.open(name).unwrap().description().frames.numbers().collect::<Vec<_>>();
    world.write("office2.oct", "");
    world.write("office2.vf", first);
    assert_eq!(frames("office2.oct"), [1]);
    world.write("office2.vf", &views(5));
    assert_eq!(frames("office2.oct"), [1, 2, 3, 4, 5]);
    // With other octrees, several views of its own are its frames, and a view of each is a frame of all.
    for name in ["room1", "room2", "room3"] {
        world.write(&format!("{name}.oct"), "");
        world.write(&format!("{name}.vf"), first);
    }
    assert_eq!(frames("room2.oct"), [1, 2, 3]);
    world.write("room2.vf", &views(2));
    assert_eq!(frames("room2.oct"), [1, 2]);
    world.write("room3.vf", &views(4));
    assert_eq!(frames("room3.oct"), [1, 2, 3, 4]);
}

#[test]
#[ignore = "tests/peers/radiance_renderer.sh installs Radiance"]
fn octrees_are_evenly_spaced_frames_or_the_missing_ones_are_named() {
    let world = World::new();
    world.write("walk.vf", "VIEW= -vtv -vp 2 .2 1.5 -vd 0 1 0 -vu 0 0 1 -vh 60 -vv 60\n");
    for name in ["walk0002.oct", "walk0010.oct", "walk0006.oct"] {
        world.write(name, "");
    }
    let shot = world.open("walk0002.oct").unwrap();
    let settings = shot.description().settings.clone();
    assert_eq!(shot.description().frames.numbers().collect::<Vec<_>>(), [2, 6, 10]);
    let error = world.run(|run| shot.preview(&[3], &settings, run)).unwrap_err().to_string();
    assert_eq!(error, "there is no frame 3; the scene has 2 to 10 in steps of 4");
    world.write("walk0009.oct", "");
    let error = world.open("walk0002.oct").err().unwrap();
    assert!(error.is_permanent(), "{error}");
    let error = error.to_string();
    for said in [
        "walk0002.oct: octrees are missing",
        "walk0003.oct, walk0004.oct, walk0005.oct and 2 more",
        "a folder",
    ] {
        assert!(error.contains(said), "{error}");
    }
}

/// What `vwrays -d` says of a view in an image of this size.
fn size_of(world: &World, view: &str, (width, height): (u32, u32)) -> (u32, u32) {
    let folder = PathBuf::from(std::env::var_os("FORELIGHT_RADIANCE").unwrap());
    let mut printed = String::new();
    world.run(|run_| {
        let program = Program::new(folder.join("vwrays"), world.folder.path())
            .args(["-d".to_owned(), "-x".to_owned(), width.to_string(), "-y".to_owned(), height.to_string()])
            .args(view.split_whitespace());
        run(&program, &[], run_, &mut |line| printed.push_str(&line.text)).unwrap();
    });
    let words: Vec<&str> = printed.split_whitespace().collect();
    (words[1].parse().unwrap(), words[3].parse().unwrap())
}

#[test]
#[ignore = "tests/peers/radiance_renderer.sh installs Radiance"]
fn a_frame_of_another_shape_needs_a_size_that_fits_its_view() {
    let world = World::new();
    let flat = "-vtv -vp 2 .2 1.5 -vd 0 1 0 -vu 0 0 1 -vh 60 -vv 30";
    let square = flat.replace("-vv 30", "-vv 60");
    let views = format!("view= a {square}\nview= b {flat}\nview= c {square} -vo .1\nview= d -vtv -vh 200\n");
    let without_views = RIF.replace("view=", "#");
    world.write("room.rif", &format!("{without_views}{views}"));
    let shot = world.shot();
    let own = shot.description().settings.clone();
    assert_eq!((own.common.width, own.common.height), (64, 64));
    let sized = |(width, height): (u32, u32)| {
        let common = Common { width, height, ..own.common };
        Settings { common, ..own.clone() }
    };
    let render = |frame: i32, settings: &Settings| world.run(|run| shot.render(frame, settings, &[], run));
    for frame in [1, 3] {
        assert!(render(frame, &own).is_ok() && render(frame, &sized((16, 16))).is_ok());
    }
    for asked in [(64, 64), (33, 64), (100, 30)] {
        let (width, height) = size_of(&world, flat, asked);
        let settings = sized(asked);
        let errors = world.run(|run| {
            [
                shot.preview(&[1, 2], &settings, run).err(),
                shot.measure(2, &settings, &Part::Samples { offset: 0, count: 1 }, run).err(),
                shot.profile_pixels(2, &settings, run).err(),
                shot.render(2, &settings, &[], run).err(),
            ]
        });
        for error in errors.into_iter().map(Option::unwrap) {
            assert!(matches!(error, RendererError::Settings(_)) && error.is_permanent(), "{error}");
        }
        let error = render(2, &settings).err().unwrap().to_string();
        let said =
            format!("the view b of frame 2 needs {width} × {height} pixels, not {} × {}", asked.0, asked.1);
        assert!(error.contains(&said), "{error}");
        assert!(error.contains(&format!("--width {width} --height {height}")), "{error}");
        assert!(render(2, &sized((width, height))).is_ok());
        assert!(render(1, &sized((width, height))).is_err(), "the same size distorts the others");
    }
    // A view that is wrong fails by itself.
    let error = render(4, &own).err().unwrap().to_string();
    assert!(error.contains("illegal"), "{error}");
    // The pixels are those of a scene with this view alone.
    let of_flat = pixels_of(&render(2, &sized((64, 30))).unwrap());
    world.write("flat.rif", &format!("{without_views}view= {flat}\n"));
    let alone = world.open("flat.rif").unwrap();
    let settings = alone.description().settings.clone();
    assert_eq!((settings.common.width, settings.common.height), (64, 30));
    assert_eq!(pixels_of(&world.run(|run| alone.render(1, &settings, &[], run)).unwrap()), of_flat);
    // Where all views have one shape, a job may ask for any pixels.
    assert!(world.run(|run| alone.preview(&[1], &sized((64, 64)), run)).is_ok());
    let larger = flat.replace("-vh 60 -vv 30", "-vh 90 -vv 49.8");
    world.write("flat.rif", &format!("{without_views}view= {flat}\nview= {larger}\n"));
    let alike = world.open("flat.rif").unwrap();
    assert!(world.run(|run| alike.preview(&[1, 2], &sized((64, 64)), run)).is_ok());
}

#[test]
#[ignore = "tests/peers/radiance_renderer.sh installs Radiance"]
fn a_width_alone_keeps_the_rounding_of_the_scenes_own_size() {
    let world = World::new();
    let views = "view= -vtv -vd 0 1 0 -vh 60 -vv 46\nview= -vtv -vd 0 1 0 -vh 60 -vv 20\n";
    world.write("room.rif", &format!("{}{views}", RIF.replace("view=", "#")));
    let shot = world.shot();
    let own = shot.description().settings.clone();
    // As 64 × 47 is scaled. Of this width, the view alone would have 3011 rows.
    let common = Common { width: 4096, height: 3008, ..own.common };
    let wide = Settings { common, ..own };
    assert_eq!(size_of(&world, "-vtv -vd 0 1 0 -vh 60 -vv 46", (4096, 4096)), (4096, 3011));
    assert!(world.run(|run| shot.preview(&[1], &wide, run)).is_ok());
    assert!(world.run(|run| shot.preview(&[2], &wide, run)).is_err());
}
