//! Every malformed description gets one clear line that names the file, the place in it and the reason.

use crate::made::{Files, MTL, OBJ};
use serde_json::json;

fn light(light: serde_json::Value) -> Files {
    Files::good().set("/lights", json!([light]))
}

fn track(track: serde_json::Value) -> Files {
    Files::good().set("/animation", json!({"fps": 24, "frames": 10, "tracks": [track]}))
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
    assert_eq!(error, "scene.json: /version: version 2 is not supported; this program reads version 1");
}

#[test]
fn a_description_without_a_version() {
    let error = Files::good().with("scene.json", "{}").error();
    assert_eq!(error, "scene.json: /version: is missing; this program reads version 1");
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
    assert_eq!(
        Files::good().set("/geometry", json!([])).error(),
        "scene.json: /geometry: must name at least one file"
    );
}

#[test]
fn geometry_that_is_not_there() {
    let error = Files::good().set("/geometry", json!(["scene.obj", "other.obj"])).error();
    assert_eq!(error, "scene.json: /geometry/1: the bundle has no file `other.obj`");
}

#[test]
fn geometry_of_an_unknown_kind() {
    let error = Files::good().set("/geometry", json!(["scene.mtl"])).error();
    assert_eq!(error, "scene.mtl: is not a supported geometry file (.obj, .gltf, .glb)");
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
        assert!(error.contains("/name: must have 1 to 200 characters, and no control"), "{error}");
    }
}

#[test]
fn a_field_of_view_out_of_range() {
    for fov in [0.0, -10.0, 180.0] {
        let error = Files::good().set("/camera/fov_deg", json!(fov)).error();
        assert!(error.ends_with("the field of view must be between 0 and 180 degrees"), "{error}");
    }
}

#[test]
fn an_image_without_pixels_or_with_too_many() {
    let error = Files::good().set("/camera/width", json!(0)).error();
    assert_eq!(error, "scene.json: /camera/width: an image must have at least one pixel");
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
    assert_eq!(error, "scene.json: /environment/radiance: every channel must be in the range 0 to 1e12");
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
            "scene.json: /lights/0: `edge_u` and `edge_v` are parallel or have zero length"
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
    assert_eq!(error, "scene.json: /lights/0/direction: the vector has zero length");
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
    assert_eq!(files.error(), "scene.json: /animation/tracks/0/keys: a track must have at least one key");
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
        format!("{at}: a rotation must be a unit quaternion x y z w")
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
    assert_eq!(
        with(json!({"frames": 0})),
        "scene.json: /animation/frames: a shot must have at least one frame"
    );
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
