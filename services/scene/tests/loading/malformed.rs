//! Every malformed bundle gets one clear line that names the file, the place in it and the reason.

use crate::made::{Files, MTL, OBJ, line, load_zip, png, zip};
use forelight_scene::{Limits, Scene};
use serde_json::json;
use std::path::Path;

fn light(light: serde_json::Value) -> Files {
    Files::good().set("/lights", json!([light]))
}

fn track(track: serde_json::Value) -> Files {
    Files::good().set("/animation", json!({"fps": 24, "frames": 10, "tracks": [track]}))
}

#[test]
fn a_path_that_does_not_exist() {
    let error = line(Scene::load(Path::new("no/such/bundle"), &Limits::default()));
    assert_eq!(error, "no/such/bundle: cannot be read: No such file or directory (os error 2)");
}

#[test]
fn a_file_that_is_no_archive() {
    let error = line(load_zip(b"this is not a zip archive", &Limits::default()));
    assert!(error.contains("bundle.zip: is neither a folder nor a readable .zip"), "{error}");
}

#[test]
fn an_empty_folder() {
    let files = Files(Default::default());
    assert!(files.error().ends_with(": has neither a `scene.json` nor a glTF file"));
}

#[test]
fn geometry_without_a_description() {
    let error = Files::good().without("scene.json").error();
    assert!(error.ends_with(": has no `scene.json`, which says which of scene.obj is the scene"), "{error}");
}

#[test]
fn an_archive_entry_that_climbs_out() {
    let error = line(load_zip(&zip(&[("../evil.obj", b"v")]), &Limits::default()));
    assert!(
        error.ends_with("bundle.zip/../evil.obj: the archive entry does not stay inside the bundle"),
        "{error}"
    );
}

#[test]
fn an_archive_entry_with_an_absolute_path() {
    let twice = zip(&[("scene.json", b"{}"), ("./scene.json", b"{}")]);
    let error = line(load_zip(&twice, &Limits::default()));
    assert!(error.ends_with("./scene.json: the archive has two entries of this name"), "{error}");
    let error = line(load_zip(&zip(&[("/etc/evil", b"v")]), &Limits::default()));
    assert!(error.ends_with("/etc/evil: the archive entry does not stay inside the bundle"), "{error}");
}

#[test]
fn an_archive_entry_with_backslashes_or_a_drive() {
    for name in ["..\\evil", "C:/evil", "a//b", "a/./b"] {
        let error = line(load_zip(&zip(&[(name, b"v")]), &Limits::default()));
        assert!(error.contains("does not stay inside the bundle"), "{error}");
    }
}

#[test]
fn an_archive_with_a_symbolic_link() {
    let mut writer = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    writer.add_symlink("scene.json", "/etc/passwd", zip::write::SimpleFileOptions::default()).unwrap();
    let error = line(load_zip(&writer.finish().unwrap().into_inner(), &Limits::default()));
    assert!(error.ends_with("scene.json: symbolic links are not allowed in an archive"), "{error}");
}

#[test]
fn an_archive_that_expands_without_measure() {
    let bomb = vec![0; 4 << 20];
    let error = line(load_zip(&zip(&[("scene.json", &bomb)]), &Limits::default()));
    assert!(error.contains("scene.json: expanded bytes for each compressed byte"), "{error}");
    assert!(error.ends_with("is more than the limit of 200"), "{error}");
}

#[test]
fn an_archive_with_too_many_entries() {
    let limits = Limits { entries: 2, ..Limits::default() };
    let error = line(load_zip(&zip(&[("a", b""), ("b", b""), ("c", b"")]), &limits));
    assert!(error.ends_with("bundle.zip: archive entries: 3 is more than the limit of 2"), "{error}");
}

#[test]
fn an_archive_whose_files_are_too_large_together() {
    let limits = Limits { total_bytes: 5, ..Limits::default() };
    let error = line(load_zip(&zip(&[("a", b"123"), ("b", b"456")]), &limits));
    assert!(error.ends_with("expanded bytes of the archive: 6 is more than the limit of 5"), "{error}");
}

#[test]
fn an_archive_that_lies_about_the_size_of_a_file() {
    let mut bytes = zip(&[("scene.json", &[b'x'; 1000])]);
    // The uncompressed size stands in the central directory, 24 bytes after its signature.
    let directory = bytes.windows(4).position(|w| w == b"PK\x01\x02").unwrap();
    bytes[directory + 24..directory + 28].copy_from_slice(&10u32.to_le_bytes());
    let error = line(load_zip(&bytes, &Limits::default()));
    assert_eq!(error, "scene.json: expanded bytes: 11 is more than the limit of 10");
}

#[test]
fn an_archive_with_damaged_contents() {
    let mut bytes = zip(&[("scene.json", b"{\"version\": 1}")]);
    let at = 30 + "scene.json".len();
    bytes[at] ^= 0x55;
    let error = line(load_zip(&bytes, &Limits::default()));
    assert!(error.starts_with("scene.json: cannot be expanded: "), "{error}");
}

#[test]
fn a_file_larger_than_the_limit() {
    let limits = Limits { file_bytes: 100, ..Limits::default() };
    let error = line(Files::good().load_within(&limits));
    assert!(
        error.starts_with("scene.json: bytes: ") && error.ends_with("is more than the limit of 100"),
        "{error}"
    );
}

#[test]
fn more_bytes_than_the_limit_in_a_folder() {
    let total: usize = Files::good().0.values().map(Vec::len).sum();
    assert!(Files::good().load_within(&Limits { total_bytes: total as u64, ..Limits::default() }).is_ok());
    let limits = Limits { total_bytes: total as u64 - 1, ..Limits::default() };
    let error = line(Files::good().load_within(&limits));
    assert!(error.contains(": bytes read from the bundle: "), "{error}");
}

#[cfg(unix)]
#[test]
fn a_symbolic_link_that_leads_out_of_the_folder() {
    let (secret, folder) =
        (tempfile::NamedTempFile::new().unwrap(), Files::good().without("scene.mtl").folder());
    std::os::unix::fs::symlink(secret.path(), folder.path().join("scene.mtl")).unwrap();
    let error = line(Scene::load(folder.path(), &Limits::default()));
    assert_eq!(error, "scene.obj: line 1: `mtllib`: scene.mtl: a symbolic link leads out of the bundle");
}

#[test]
fn a_folder_in_the_place_of_a_file() {
    let folder = Files::good().without("scene.mtl").folder();
    std::fs::create_dir(folder.path().join("scene.mtl")).unwrap();
    let error = line(Scene::load(folder.path(), &Limits::default()));
    assert_eq!(error, "scene.obj: line 1: `mtllib`: scene.mtl: is not a regular file");
}

#[test]
fn a_description_that_is_no_json() {
    let error = Files::good().with("scene.json", "{\"version\": 1,").error();
    assert_eq!(error, "scene.json: EOF while parsing a value at line 1 column 14");
}

#[test]
fn a_description_with_something_after_its_end() {
    let error = Files::good().with("scene.json", "{\"version\": 1} {}").error();
    assert_eq!(error, "scene.json: trailing characters at line 1 column 16");
}

#[test]
fn a_description_of_another_version() {
    let error = Files::good().set("/version", json!(2)).set("/future", json!(true)).error();
    assert_eq!(
        error,
        "scene.json: /version: version 2 is not understood; this program understands version 1"
    );
}

#[test]
fn a_description_without_a_version() {
    let error = Files::good().with("scene.json", "{}").error();
    assert_eq!(error, "scene.json: /version: is missing; this program understands version 1");
}

#[test]
fn unknown_keys_are_named() {
    for (pointer, key) in [("/colour", "colour"), ("/camera/zoom", "zoom")] {
        let error = Files::good().set(pointer, json!(1)).error();
        assert!(error.starts_with(&format!("scene.json: {pointer}: unknown field `{key}`")), "{error}");
    }
}

#[test]
fn a_value_of_the_wrong_type() {
    let error = Files::good().set("/camera/fov_deg", json!("wide")).error();
    assert!(
        error.starts_with("scene.json: /camera/fov_deg: invalid type: string \"wide\", expected f64"),
        "{error}"
    );
}

#[test]
fn a_vector_of_two_numbers() {
    let error = Files::good().set("/camera/origin", json!([1, 2])).error();
    assert!(error.starts_with("scene.json: /camera/origin: invalid length 2"), "{error}");
}

#[test]
fn numbers_that_are_not_finite() {
    let text = String::from_utf8(Files::good().0["scene.json"].clone()).unwrap();
    let huge = Files::good().with("scene.json", text.replace("\"fov_deg\":40", "\"fov_deg\":1e999"));
    assert!(huge.error().starts_with("scene.json: "), "{}", huge.error());
    assert!(huge.error().contains("number out of range"), "{}", huge.error());
    let nan = Files::good().with("scene.json", text.replace("\"fov_deg\":40", "\"fov_deg\":NaN"));
    assert!(nan.error().contains("expected value at line 1"), "{}", nan.error());
    let far = Files::good().set("/camera/origin", json!([1e300, 0, 0]));
    assert_eq!(far.error(), "scene.json: /camera/origin: a coordinate is larger than 1e9 m");
}

#[test]
fn no_geometry() {
    assert_eq!(Files::good().set("/geometry", json!([])).error(), "scene.json: /geometry: names no file");
}

#[test]
fn geometry_that_is_not_there() {
    let error = Files::good().set("/geometry", json!(["scene.obj", "other.obj"])).error();
    assert_eq!(error, "scene.json: /geometry/1: the bundle has no file `other.obj`");
}

#[test]
fn geometry_of_an_unknown_kind() {
    let error = Files::good().set("/geometry", json!(["scene.mtl"])).error();
    assert_eq!(error, "scene.mtl: is not geometry that is understood (.obj, .gltf, .glb)");
}

#[test]
fn geometry_outside_the_bundle() {
    let error = Files::good().set("/geometry", json!(["../scene.obj"])).error();
    assert_eq!(error, "scene.json: /geometry/0: `../scene.obj` leaves the bundle");
    let error = Files::good().set("/geometry", json!(["/scene.obj"])).error();
    assert_eq!(error, "scene.json: /geometry/0: `/scene.obj`: a path in a bundle is relative");
}

#[test]
fn a_camera_that_looks_at_itself() {
    let error = Files::good().set("/camera/target", json!([0.5, 0.5, 3])).error();
    assert_eq!(error, "scene.json: /camera: `target` is `origin` at frame 0");
}

#[test]
fn a_camera_whose_up_is_its_view() {
    let error = Files::good().set("/camera/up", json!([0, 0, -2])).error();
    assert_eq!(error, "scene.json: /camera: `up` is zero or along the view direction at frame 0");
}

#[test]
fn a_camera_that_looks_at_itself_in_the_middle_of_the_shot() {
    let keys = json!([{"frame": 0, "value": [0.5, 0.5, 6]}, {"frame": 10, "value": [0.5, 0.5, 1]}]);
    let track = json!({"target": "camera", "property": "target", "interpolation": "linear", "keys": keys});
    let files = Files::good().set("/animation", json!({"frames": 11, "tracks": [track]}));
    assert_eq!(files.error(), "scene.json: /camera: `target` is `origin` at frame 6");
}

#[test]
fn a_name_that_no_table_can_show() {
    for name in ["".to_owned(), "x".repeat(201), "red\u{1b}[31m".to_owned(), "two\nlines".to_owned()] {
        let error = Files::good().set("/name", json!(name)).error();
        assert!(error.contains("/name: must have 1 to 200 characters, none of them a control"), "{error}");
    }
}

#[test]
fn a_field_of_view_out_of_range() {
    for fov in [0.0, -10.0, 180.0] {
        let error = Files::good().set("/camera/fov_deg", json!(fov)).error();
        assert!(error.ends_with("the field of view must lie between 0 and 180 degrees"), "{error}");
    }
}

#[test]
fn an_image_without_pixels_or_with_too_many() {
    let error = Files::good().set("/camera/width", json!(0)).error();
    assert_eq!(error, "scene.json: /camera/width: an image has at least one pixel");
    let error = Files::good().set("/camera/width", json!(4_000_000_000_u32)).error();
    assert_eq!(
        error,
        "scene.json: /camera: pixels of the image: 96000000000 is more than the limit of 268435456"
    );
    let error = Files::good().set("/camera/height", json!(-5)).error();
    assert!(
        error.starts_with("scene.json: /camera/height: invalid value: integer `-5`, expected u32"),
        "{error}"
    );
}

#[test]
fn a_lens_that_cannot_be() {
    let error = Files::good().set("/camera/aperture_radius", json!(-1)).error();
    assert_eq!(error, "scene.json: /camera/aperture_radius: must not be negative");
    let error = Files::good().set("/camera/focus_distance", json!(0)).error();
    assert_eq!(error, "scene.json: /camera/focus_distance: must be more than 0");
}

#[test]
fn an_environment_of_an_unknown_kind_or_with_a_wrong_key() {
    let error = Files::good().set("/environment", json!({"type": "fog"})).error();
    assert_eq!(error, "scene.json: /environment/type: `fog` is not one of `constant`, `image`");
    let wrong = json!({"type": "constant", "radiance": [1, 1, 1], "scale": 2});
    let error = Files::good().set("/environment", wrong).error();
    assert_eq!(error, "scene.json: /environment/scale: a constant environment has no key `scale`");
    let error = Files::good().set("/environment", json!({"type": "constant"})).error();
    assert_eq!(error, "scene.json: /environment/radiance: is missing");
    let error = Files::good().set("/environment/radiance", json!([1, -1, 1])).error();
    assert_eq!(error, "scene.json: /environment/radiance: every channel must lie in 0 to 1e12");
}

#[test]
fn an_environment_image_that_is_missing_or_not_finite() {
    let sky = json!({"type": "image", "path": "sky.exr"});
    let files = Files::good().set("/environment", sky);
    let error = files.error();
    assert!(
        error.starts_with("scene.json: /environment/path: the environment: sky.exr: cannot be read"),
        "{error}"
    );
    let mut image = image::Rgb32FImage::new(4, 2);
    image.put_pixel(3, 1, image::Rgb([1.0, f32::NAN, 1.0]));
    let exr = crate::made::encoded(&image.into(), image::ImageFormat::OpenExr);
    assert_eq!(
        files.with("sky.exr", exr).error(),
        "scene.json: /environment/path: the environment: sky.exr: the pixel in column 3, row 1 is not finite"
    );
}

#[test]
fn a_quad_light_with_parallel_edges() {
    for edge_v in [[-2, -2, 0], [0, 0, 0]] {
        let quad = json!({"type": "quad", "corner": [0, 0, 0], "edge_u": [1, 1, 0], "edge_v": edge_v, "radiance": [1, 1, 1]});
        assert_eq!(
            light(quad).error(),
            "scene.json: /lights/0: `edge_u` and `edge_v` are parallel or have no length"
        );
    }
}

#[test]
fn lights_with_missing_foreign_or_unknown_parts() {
    let error = light(json!({"type": "point", "position": [0, 0, 0]})).error();
    assert_eq!(error, "scene.json: /lights/0/intensity: is missing");
    let error =
        light(json!({"type": "point", "position": [0, 0, 0], "intensity": [1, 1, 1], "corner": [0, 0, 0]}));
    assert_eq!(error.error(), "scene.json: /lights/0/corner: a point light has no key `corner`");
    let error = light(json!({"type": "laser"})).error();
    assert_eq!(error, "scene.json: /lights/0/type: `laser` is not one of `quad`, `point`, `sun`");
    let error = light(json!({"type": "sun", "direction": [0, 0, 0], "irradiance": [1, 1, 1]})).error();
    assert_eq!(error, "scene.json: /lights/0/direction: the vector has no length");
    let sun = json!({"type": "sun", "direction": [0, 1, 0], "irradiance": [1, 1, 1], "angle_deg": 200});
    assert_eq!(
        light(sun).error(),
        "scene.json: /lights/0/angle_deg: must be at least 0 and less than 180 degrees"
    );
}

#[test]
fn keys_that_descend_or_stand_still() {
    for second in [5, 3] {
        let keys = json!([{"frame": 5, "value": [0, 0, 9]}, {"frame": second, "value": [0, 0, 8]}]);
        let files =
            track(json!({"target": "camera", "property": "origin", "interpolation": "step", "keys": keys}));
        let expected = format!(
            "scene.json: /animation/tracks/0/keys/1/frame: frame {second} does not come after frame 5"
        );
        assert_eq!(files.error(), expected);
    }
}

#[test]
fn a_track_without_keys() {
    let files = track(json!({"target": "camera", "property": "up", "interpolation": "step", "keys": []}));
    assert_eq!(files.error(), "scene.json: /animation/tracks/0/keys: a track has at least one key");
}

#[test]
fn tracks_of_unknown_targets() {
    let keys = json!([{"frame": 0, "value": [1, 1, 1]}]);
    let with = |target: &str, property: &str| {
        track(json!({"target": target, "property": property, "interpolation": "linear", "keys": keys}))
            .error()
    };
    let at = "scene.json: /animation/tracks/0";
    assert_eq!(with("object:door", "scale"), format!("{at}/target: there is no object `door`"));
    assert_eq!(
        with("light:0", "radiance"),
        format!("{at}/target: there is no light `0`; the scene has 0 lights")
    );
    assert_eq!(
        with("sky", "radiance"),
        format!("{at}/target: `sky` is not `camera`, `object:NAME` or `light:INDEX`")
    );
}

#[test]
fn tracks_of_unknown_properties() {
    let keys = json!([{"frame": 0, "value": [1, 1, 1]}]);
    let with = |target: &str, property: &str| {
        let point = json!({"type": "point", "position": [0, 0, 1], "intensity": [1, 1, 1]});
        let track = json!({"target": target, "property": property, "interpolation": "linear", "keys": keys});
        light(point).set("/animation", json!({"tracks": [track]})).error()
    };
    let at = "scene.json: /animation/tracks/0/property";
    assert_eq!(
        with("camera", "roll"),
        format!("{at}: a camera has no property `roll`; it has origin, target, up, fov_deg")
    );
    assert_eq!(
        with("object:wall", "colour"),
        format!("{at}: an object has no property `colour`; it has translation, rotation, scale")
    );
    assert_eq!(
        with("light:0", "radiance"),
        format!("{at}: a point light has no property `radiance`; it has intensity")
    );
}

#[test]
fn key_values_of_the_wrong_length_or_meaning() {
    let with = |property: &str, value: serde_json::Value| {
        let keys = json!([{"frame": 0, "value": value}]);
        track(json!({"target": "object:wall", "property": property, "interpolation": "linear", "keys": keys}))
            .error()
    };
    let at = "scene.json: /animation/tracks/0/keys/0/value";
    assert_eq!(with("translation", json!([1, 2])), format!("{at}: `translation` takes 3 numbers, not 2"));
    assert_eq!(with("rotation", json!([0, 0, 1])), format!("{at}: `rotation` takes 4 numbers, not 3"));
    assert_eq!(
        with("rotation", json!([0, 0, 0, 0])),
        format!("{at}: a rotation is a unit quaternion x y z w")
    );
    assert!(
        with("scale", json!(["a"])).starts_with(&format!("{at}/0: invalid type")),
        "{}",
        with("scale", json!(["a"]))
    );
}

#[test]
fn an_unknown_interpolation() {
    let keys = json!([{"frame": 0, "value": [1, 1, 1]}]);
    let files = track(json!({"target": "camera", "property": "up", "interpolation": "bezier", "keys": keys}));
    let error = files.error();
    assert!(
        error.starts_with("scene.json: /animation/tracks/0/interpolation: unknown variant `bezier`"),
        "{error}"
    );
}

#[test]
fn two_tracks_of_the_same_property() {
    let one = json!({"target": "camera", "property": "up", "interpolation": "step", "keys": [{"frame": 0, "value": [0, 1, 0]}]});
    let files = Files::good().set("/animation", json!({"tracks": [one, one]}));
    assert_eq!(files.error(), "scene.json: /animation/tracks/1: `up` of `camera` has two tracks");
}

#[test]
fn shots_without_frames_with_too_many_or_without_time() {
    let with = |animation| Files::good().set("/animation", animation).error();
    assert_eq!(with(json!({"frames": 0})), "scene.json: /animation/frames: a shot has at least one frame");
    assert_eq!(
        with(json!({"frames": 200_000})),
        "scene.json: /animation/frames: frames: 200000 is more than the limit of 100000"
    );
    assert_eq!(
        with(json!({"fps": 0})),
        "scene.json: /animation/fps: 0: must be more than 0 and at most 10000"
    );
    let far = json!([{"frame": 1e8, "value": [0, 1, 0]}]);
    let track = json!({"target": "camera", "property": "up", "interpolation": "step", "keys": far});
    assert_eq!(
        with(json!({"tracks": [track]})),
        "scene.json: frames: 100000001 is more than the limit of 100000"
    );
}

#[test]
fn a_material_library_that_is_missing() {
    let error = Files::good().without("scene.mtl").error();
    assert!(error.starts_with("scene.obj: line 1: `mtllib`: scene.mtl: cannot be read: "), "{error}");
}

#[test]
fn a_material_that_no_library_has() {
    let error = Files::good().with("scene.mtl", "newmtl black\nKd 0 0 0\n").error();
    assert_eq!(error, "scene.obj: line 12: no material library has a material `white`");
}

#[test]
fn a_colour_that_reflects_more_than_arrives() {
    let mut image = image::Rgb32FImage::from_pixel(4, 2, image::Rgb([0.5, 1.0, 0.0]));
    let files = |image: &image::Rgb32FImage| {
        let exr = crate::made::encoded(&image.clone().into(), image::ImageFormat::OpenExr);
        Files::good().with("scene.mtl", "newmtl white\nmap_Kd a.exr\n").with("a.exr", exr)
    };
    files(&image).scene();
    image.put_pixel(3, 1, image::Rgb([1.0, 5.0, 1.0]));
    let error = files(&image).error();
    assert!(error.contains("`map_Kd`: a.exr: the pixel in column 3, row 1 is [1.0, 5.0, 1.0]"), "{error}");
}

#[test]
fn a_texture_that_is_missing_or_no_image() {
    let files = Files::good().with("scene.mtl", "newmtl white\nmap_Kd textures/wood.jpg\n");
    let error = files.error();
    assert!(
        error.starts_with("scene.mtl: material `white`: `map_Kd`: textures/wood.jpg: cannot be read: "),
        "{error}"
    );
    let error = files.clone().with("textures/wood.jpg", "no image").error();
    assert!(error.contains("textures/wood.jpg: is not an image that is understood"), "{error}");
    let mut cut = png(8, 8, [1, 2, 3, 255]);
    cut.truncate(40);
    let error = files.clone().with("textures/wood.jpg", cut).error();
    assert!(error.contains("textures/wood.jpg: is not a readable image"), "{error}");
    let image = image::RgbImage::from_fn(64, 64, |x, y| image::Rgb([x as u8, y as u8, (x * y) as u8]));
    let jpeg = crate::made::encoded(&image.into(), image::ImageFormat::Jpeg);
    for cut in [jpeg.len() - 2, jpeg.len() / 2] {
        let error = files.clone().with("textures/wood.jpg", &jpeg[..cut]).error();
        assert!(error.contains("textures/wood.jpg: is not a readable image: "), "{error}");
    }
    let with_more = [&jpeg[..], b"and what a camera writes behind it"].concat();
    for whole in [jpeg, with_more] {
        files.clone().with("textures/wood.jpg", whole).scene();
    }
}

#[test]
fn a_texture_outside_the_bundle_or_with_backslashes() {
    let with = |path: &str| Files::good().with("scene.mtl", format!("newmtl white\nmap_Kd {path}\n")).error();
    assert_eq!(with("../wood.jpg"), "scene.mtl: material `white`: `../wood.jpg` leaves the bundle");
    assert_eq!(
        with("textures\\wood.jpg"),
        "scene.mtl: material `white`: `textures\\wood.jpg`: a path in a bundle is written with `/`"
    );
}

#[test]
fn textures_of_more_texels_than_the_limit() {
    let files = Files::good()
        .with("scene.mtl", "newmtl white\nmap_Kd a.png\nnewmtl b\nmap_Kd b.png\n")
        .with("a.png", png(8, 8, [0; 4]))
        .with("b.png", png(8, 8, [0; 4]));
    let limits = Limits { texture_pixels: 100, ..Limits::default() };
    let error = line(files.load_within(&limits));
    assert_eq!(error, "b.png: texels of all textures: 128 is more than the limit of 100");
}

#[test]
fn material_values_out_of_range() {
    for (text, expected) in [
        ("Kd 0.5 1.5 0.5", "`Kd`: 1.5 does not lie in 0 to 1"),
        ("Kd nan 0 0", "`Kd`: NaN does not lie in 0 to 1"),
        ("Ke -1 0 0", "`Ke`: -1 does not lie in 0 to 1000000000000"),
        ("Ni 0", "`Ni`: 0 does not lie in 0.1 to 10"),
        ("Pr 2", "`Pr`: 2 does not lie in 0 to 1"),
        ("d x", "`d`: `x` is not a number"),
        ("illum 9", "`illum 9` is not one of 0, 1, 2, 3, 4, 7"),
        ("map_Kd -s 2 2 2 a.png", "`map_Kd -s 2 2 2 a.png`: texture options are not understood"),
        ("map_Kd", "`map_Kd` names nothing"),
        ("newmtl", "`newmtl` names nothing"),
    ] {
        let error = Files::good().with("scene.mtl", format!("newmtl white\n{text}\n")).error();
        assert_eq!(error, format!("scene.mtl: line 2: {expected}"));
    }
}

#[test]
fn a_material_key_before_any_material() {
    let error = Files::good().with("scene.mtl", "Kd 1 1 1\nnewmtl white\n").error();
    assert_eq!(error, "scene.mtl: line 1: `Kd` stands before the first `newmtl`");
}

#[test]
fn a_metal_without_reflectance() {
    let error = Files::good().with("scene.mtl", "newmtl white\nillum 3\n").error();
    assert_eq!(error, "scene.mtl: material `white`: `illum 3` needs `Ks`, the reflectance of the metal");
}

#[test]
fn malformed_lines_of_an_obj_file() {
    for (text, expected) in [
        ("v 0 0 nan", "`v`: nan is not finite"),
        ("v 0 inf 0", "`v`: inf is not finite"),
        ("v 0 1e39 0", "`v`: 1e39 is not finite"),
        ("v 0 0", "`v` takes 3 to 6 numbers, not 2"),
        ("v 0 0 0 0 0", "`v` takes 3 numbers, not 5"),
        ("v 0 0 0 0", "`v`: the weight is zero"),
        ("v a b c", "`v`: `a` is not a number"),
        ("vt nan 0", "`vt`: nan is not finite"),
        ("vn 1 0", "`vn` takes 3 to 3 numbers, not 2"),
        ("f 1 2", "`f`: a face has at least 3 corners, not 2"),
        ("f", "`f`: a face has at least 3 corners, not 0"),
        ("f 1 2 99999999999", "`f`: there is no vertex 99999999999; there are 4 so far"),
        ("f 1 2 999999999999999999999", "`f`: `999999999999999999999` is not an index"),
        ("f 1 2 -5", "`f`: there is no vertex -5; there are 4 so far"),
        ("f 0 1 2", "`f`: there is no vertex 0; there are 4 so far"),
        ("f 1/9 2/1 3/1", "`f`: there is no texture coordinate 9; there are 4 so far"),
        ("f 1//7 2//1 3//1", "`f`: there is no normal 7; there are 1 so far"),
        ("f 1/1 2 3/1", "`f`: the corners have not all the same attributes"),
        ("f 1/1/1/1 2 3", "`f`: `1/1/1/1` is not `v`, `v/vt`, `v//vn` or `v/vt/vn`"),
        ("f /1 /1 /1", "`f`: `/1` is not `v`, `v/vt`, `v//vn` or `v/vt/vn`"),
        ("usemtl", "`usemtl` names nothing"),
        ("mtllib", "`mtllib` names nothing"),
    ] {
        let error = Files::good().with("scene.obj", format!("{OBJ}{text}\n")).error();
        assert_eq!(error, format!("scene.obj: line 14: {expected}"));
    }
}

#[test]
fn faces_with_thousands_of_corners_have_to_be_convex() {
    let round = |corners: usize, notch: f64| {
        let mut text = OBJ.to_owned();
        for corner in 0..corners {
            let (y, x) = (std::f64::consts::TAU * corner as f64 / corners as f64).sin_cos();
            let radius = if corner == 7 { notch } else { 1.0 };
            text += &format!("v {} {} 0\n", radius * x, radius * y);
        }
        text += "f";
        (0..corners).rev().for_each(|corner| text += &format!(" -{}", corner + 1));
        Files::good().with("scene.obj", text)
    };
    assert_eq!(round(40_000, 1.0).scene().frame(0).unwrap().geometry.triangles.len(), 2 + 39_998);
    assert_eq!(round(4000, 0.5).scene().frame(0).unwrap().geometry.triangles.len(), 2 + 3998);
    let expected = "scene.obj: line 40014: `f`: the faces that are not convex have too many corners to be cut into triangles here; let the exporter do it";
    assert_eq!(round(40_000, 0.5).error(), expected);
}

#[test]
fn an_obj_file_that_is_no_text() {
    let error = Files::good().with("scene.obj", b"v 0 0 0\n\xff\xfe\n").error();
    assert_eq!(error, "scene.obj: line 2: is not UTF-8 text");
}

#[test]
fn an_obj_file_without_faces() {
    for text in ["", "v 0 0 0\nv 1 0 0\nv 0 1 0\n"] {
        assert_eq!(Files::good().with("scene.obj", text).error(), "scene.obj: has no face");
    }
}

#[test]
fn geometry_in_which_no_triangle_has_an_area() {
    let line = "v 0 0 0\nv 1 1 1\nv 2 2 2\nf 1 2 3\n";
    let error = Files::good().with("scene.obj", line).error();
    assert_eq!(error, "scene.json: the scene has no triangle with an area");
}

#[test]
fn a_vertex_too_far_away_for_arithmetic() {
    let error = Files::good().with("scene.obj", "o far\nv 0 0 0\nv 1 0 0\nv 0 1e30 0\nf 1 2 3\n").error();
    assert_eq!(error, "scene.obj: vertex 2 of `far` is not within 1e9 m of the origin in world space");
}

#[test]
fn more_triangles_than_the_limit() {
    let limits = Limits { triangles: 1, ..Limits::default() };
    let error = line(Files::good().load_within(&limits));
    assert_eq!(error, "scene.obj: triangles: 2 is more than the limit of 1");
}

#[test]
fn an_object_that_moves_out_of_the_world() {
    let keys = json!([{"frame": 0, "value": [0, 0, 0]}, {"frame": 9, "value": [0, 0, 9e8]}]);
    let one = json!({"target": "object:wall", "property": "translation", "interpolation": "catmull_rom", "keys": keys});
    let big = json!({"target": "object:wall", "property": "scale", "interpolation": "linear", "keys": [
        {"frame": 0, "value": [1, 1, 1]}, {"frame": 9, "value": [9e8, 9e8, 9e8]}]});
    let obj = OBJ.replace("v 1 1 0", "v 2 2 0");
    let scene = Files::good()
        .with("scene.obj", obj)
        .with("scene.mtl", MTL)
        .set("/animation", json!({"frames": 10, "tracks": [one, big]}))
        .scene();
    assert!(scene.frame(3).is_ok());
    let error = scene.frame(9).unwrap_err().to_string();
    assert_eq!(error, "scene.obj: vertex 2 of `wall` is not within 1e9 m of the origin in world space");
}
