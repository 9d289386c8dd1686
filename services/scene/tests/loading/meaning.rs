//! What the values of a bundle come to mean.

use crate::made::{Files, OBJ, encoded, load_zip, png, zip};
use forelight_scene::{Bundle, Environment, Frame, Limits, Material, MaterialClass, Scene, Surface, Texels};
use glam::{Quat, Vec2, Vec3};
use serde_json::json;
use std::num::NonZeroU8;
use std::sync::Arc;

fn frame(files: &Files) -> Frame {
    files.scene().frame(0).unwrap()
}

fn material(mtl: &str) -> Material {
    let files = Files::good()
        .with("scene.mtl", format!("newmtl white\n{mtl}"))
        .with("a.png", png(2, 2, [255, 0, 0, 128]));
    frame(&files).materials[0].clone()
}

#[test]
fn every_row_of_the_material_table_has_its_surface() {
    let Surface::Lambert { albedo } = material("illum 0\nKd 0.1 0.2 0.3\n").surface else { panic!() };
    assert_eq!((albedo.factor, albedo.texture), (Vec3::new(0.1, 0.2, 0.3), None));
    let Surface::Lambert { albedo } = material("illum 1\nKd 0.1 0.2 0.3\nmap_Kd a.png\n").surface else {
        panic!()
    };
    assert!(albedo.factor == Vec3::ONE && albedo.texture.is_some(), "the texture replaces Kd");
    let plastic = material("illum 2\nKs 0.04 0.04 0.04\nPr 0.3\nNi 1.4\n");
    let Surface::Plastic { ior, alpha, .. } = plastic.surface else { panic!() };
    assert_eq!((ior, alpha), (1.4, 0.3 * 0.3));
    assert_eq!(plastic.class(), MaterialClass::Specular);
    let Surface::Plastic { ior, alpha, .. } = material("illum 2\nKs 0.04 0.04 0.04\n").surface else {
        panic!()
    };
    assert_eq!((ior, alpha), (1.5, 0.0));
    assert!(matches!(material("illum 2\nKd 1 1 1\n").surface, Surface::Lambert { .. }));
    assert!(matches!(material("illum 2\nKs 0 0 0\n").surface, Surface::Lambert { .. }));
    let Surface::Metal { f0, alpha } = material("illum 3\nKs 0.9 0.8 0.7\n").surface else { panic!() };
    assert_eq!((f0.factor, alpha), (Vec3::new(0.9, 0.8, 0.7), 0.0));
    let Surface::ThinGlass { ior, transmittance } = material("illum 4\nTf 0.9 1 0.9\nNi 1.6\n").surface
    else {
        panic!()
    };
    assert_eq!((ior, transmittance.factor), (1.6, Vec3::new(0.9, 1.0, 0.9)));
    let Surface::Glass { ior, transmittance, alpha, priority: None } = material("illum 7\nPr 0.5\n").surface
    else {
        panic!()
    };
    assert_eq!((ior, transmittance.factor, alpha), (1.5, Vec3::ONE, 0.25));
    assert_eq!(material("illum 7\npriority 3\n").surface.priority(), NonZeroU8::new(3));
    assert_eq!(material("illum 4\npriority 3\n").surface.priority(), None, "a pane has no inside");
}

#[test]
fn a_priority_is_a_whole_number_and_few_materials_have_one() {
    for wrong in ["0", "256", "-1", "1.5", "high", ""] {
        let files = Files::good().with("scene.mtl", format!("newmtl white\nillum 7\npriority {wrong}\n"));
        let error = files.load().unwrap_err().to_string();
        assert!(error.contains("scene.mtl: line 3: `priority") && error.contains("1 to 255"), "{error}");
    }
    let many = |count: u32| {
        let glass = |n| format!("newmtl glass{n}\nillum 7\npriority 1\n");
        Files::good().with("scene.mtl", (0..count).map(glass).collect::<String>() + "newmtl white\n").load()
    };
    assert!(many(32).is_ok());
    let error = many(33).unwrap_err().to_string();
    assert!(error.contains("33") && error.contains("materials with a priority"), "{error}");
}

#[test]
fn emission_and_opacity_belong_to_any_material_but_glass_has_no_opacity() {
    let lamp = material("illum 1\nKe 4 5 6\nd 0.25\n");
    assert_eq!(
        (lamp.emission.factor, lamp.opacity, lamp.emits_both_sides),
        (Vec3::new(4.0, 5.0, 6.0), 0.25, false)
    );
    assert_eq!(material("illum 7\nd 0.25\n").opacity, 1.0);
    assert_eq!(material("illum 4\nd 0.25\n").opacity, 1.0);
    assert_eq!(material("Kd 1 1 1\n").opacity, 1.0);
}

#[test]
fn textures_are_srgb_with_alpha_and_shared_by_those_who_name_them() {
    let mtl = "newmtl white\nmap_Kd a.png\nnewmtl other\nmap_Kd ./a.png\n";
    let files = Files::good().with("scene.mtl", mtl).with("a.png", png(2, 3, [255, 0, 0, 128]));
    let frame = frame(&files);
    assert_eq!(frame.textures.len(), 1);
    let texture = &frame.textures[0];
    assert_eq!((texture.width, texture.height, texture.name.as_str()), (2, 3, "a.png"));
    assert_eq!(texture.texels, Texels::Srgb8(vec![[255, 0, 0, 128]; 6]));
}

#[test]
fn ignored_keys_are_told_once_for_each_file() {
    let files = Files::good()
        .with("scene.mtl", "newmtl white\nNs 10\nKa 1 1 1\nnewmtl b\nNs 3\n")
        .with("scene.obj", format!("{OBJ}l 1 2\nl 2 3\n"));
    let scene = files.scene();
    assert_eq!(
        scene.warnings(),
        [
            "scene.obj: these keys are ignored: `l` (2×)",
            "scene.mtl: these keys are ignored: `Ka` (1×), `Ns` (2×)"
        ]
    );
}

#[test]
fn groups_of_one_name_are_one_object_with_a_stratum_for_each_material() {
    let obj = "mtllib scene.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\no box\nusemtl a\nf 1 2 3\nusemtl b\nf 1 2 4\n\
               g lid\nf 2 3 4\no box\nusemtl a\nf 1 3 4\n";
    let files = Files::good().with("scene.obj", obj).with("scene.mtl", "newmtl a\nnewmtl b\n");
    let g = frame(&files).geometry;
    assert_eq!(g.strata.objects, ["box", "lid"]);
    assert_eq!(g.strata.pairs, [(0, 0), (0, 1), (1, 1)]);
    assert_eq!(g.triangle_stratum, [0, 1, 2, 0]);
}

#[test]
fn equal_object_names_in_two_files_become_distinct() {
    let scene = Files::good().with("b/scene.obj", OBJ).with("b/scene.mtl", "newmtl white\nKd 0 0 0\n");
    let scene = scene.set("/geometry", json!(["scene.obj", "b/scene.obj"])).scene();
    assert_eq!(scene.strata().objects, ["wall", "wall (2)"]);
    assert_eq!(scene.strata().pairs, [(0, 0), (1, 1)]);
    assert!(scene.warnings()[0].contains("another file has an object `wall`"));
}

#[test]
fn faces_with_and_without_normals_in_one_object_keep_their_own() {
    let obj = "o a\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0 2\nvt 0.25 0.5\nf 1 2 3\nf 1//1 2//1 3//1\nf 1/1/1 2/1/1 3/1/1\nf 1/1 2/1 3/1\n";
    let g = frame(&Files::good().with("scene.obj", obj)).geometry;
    let attributes = |t: usize| {
        let v = g.triangles[t][0] as usize;
        (g.normals[v], g.uvs[v])
    };
    let uv = Vec2::new(0.25, 0.5);
    assert_eq!(attributes(0), (Vec3::ZERO, Vec2::ZERO));
    assert_eq!(attributes(1), (Vec3::Z, Vec2::ZERO));
    assert_eq!(attributes(2), (Vec3::Z, uv));
    assert_eq!(attributes(3), (Vec3::ZERO, uv));
    assert_eq!(g.strata.objects, ["a"]);
}

#[test]
fn obj_oddities_are_read_as_they_are_meant() {
    // Negative indices, tabs, carriage returns, vertex colour and weight, a pentagon, a late library.
    let obj = "  o\tfive\r\nv 0 0 0 1 0 0\r\nv 2 0 0 2\r\nv 2 1 0\r\nv 1 2 0\r\nv\t0 1 0\r\nusemtl\twhite\r\nf -5 -4 -3 -2 -1\r\nmtllib scene.mtl\r\n";
    let frame = frame(&Files::good().with("scene.obj", obj));
    let g = &frame.geometry;
    assert_eq!(g.strata.objects, ["five"]);
    assert_eq!(g.triangles.len(), 3);
    assert_eq!(g.positions[1], Vec3::X, "the weight divides");
    assert_eq!(frame.materials[g.material(0) as usize].name, "white");
}

#[test]
fn a_face_that_is_not_convex_has_the_area_that_it_encloses() {
    // An L about a corner at the third vertex, from each of its corners on, with texture coordinates.
    let corners = ["0 0 5", "2 0 5", "1 1 5", "1 2 5", "0 2 5"];
    for first in 0..corners.len() {
        let mut obj = "mtllib scene.mtl\nusemtl white\n".to_owned();
        for corner in 0..corners.len() {
            let corner = corners[(first + corner) % corners.len()];
            let [x, y, _] = corner.split(' ').collect::<Vec<_>>()[..] else { panic!() };
            obj += &format!("v {corner}\nvt {x} {y}\n");
        }
        let g = frame(&Files::good().with("scene.obj", obj + "f 1/1 -4/-4 3/3 4/4 5/5\n")).geometry;
        assert_eq!((g.triangles.len(), g.positions.len()), (3, 5));
        let area = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|v| g.positions[v as usize]);
            0.5 * (b - a).cross(c - a)
        };
        assert!(g.triangles.iter().all(|t| area(t).z > 0.0), "{:?}", g.triangles);
        assert!((g.triangles.iter().map(|t| area(t).z).sum::<f32>() - 2.5).abs() < 1e-6);
        for (position, uv) in g.positions.iter().zip(&g.uvs) {
            assert_eq!((position.x, position.y), (uv.x, uv.y));
        }
    }
}

#[test]
fn triangles_without_area_are_left_out_and_counted() {
    let scene = Files::good().with("scene.obj", format!("{OBJ}f 1 1 2\nf 1 2 2\n")).scene();
    assert_eq!(scene.frame(0).unwrap().geometry.triangles.len(), 2);
    assert_eq!(scene.warnings(), ["scene.json: 2 triangles have no area and are left out"]);
}

#[test]
fn degenerate_normals_count_as_absent() {
    let g = frame(&Files::good().with("scene.obj", OBJ.replace("vn 0 0 1", "vn 0 0 0"))).geometry;
    assert!(g.normals.iter().all(|n| *n == Vec3::ZERO));
    let g = frame(&Files::good().with("scene.obj", OBJ.replace("vn 0 0 1", "vn 0 0 1e-30"))).geometry;
    assert!(g.normals.iter().all(|n| *n == Vec3::Z));
}

#[test]
fn a_zip_and_one_with_the_folder_inside_are_the_same_scene() {
    let files = Files::good();
    let folder = files.scene();
    let flat: Vec<(&str, &[u8])> = files.0.iter().map(|(p, c)| (p.as_str(), c.as_slice())).collect();
    let inside: Vec<(String, &[u8])> =
        files.0.iter().map(|(p, c)| (format!("made/{p}"), c.as_slice())).collect();
    let inside: Vec<(&str, &[u8])> = inside.iter().map(|(p, c)| (p.as_str(), *c)).collect();
    // As bsdtar writes it, and as macOS does.
    let dotted: Vec<(String, &[u8])> = flat.iter().map(|(p, c)| (format!("./{p}"), *c)).collect();
    let dotted: Vec<(&str, &[u8])> = dotted.iter().map(|(p, c)| (p.as_str(), *c)).collect();
    let mut mac = inside.clone();
    mac.push(("__MACOSX/made/._scene.json", b"what the Finder knows"));
    for archive in [zip(&flat), zip(&inside), zip(&dotted), zip(&mac)] {
        let scene = load_zip(&archive, &Limits::default()).unwrap();
        assert_eq!(*scene.frame(0).unwrap().geometry, *folder.frame(0).unwrap().geometry);
        assert_eq!(scene.digest(), folder.digest());
    }
    assert_ne!(files.with("scene.mtl", "newmtl white\nKd 0 0 0\n").scene().digest(), folder.digest());
}

#[test]
fn numbers_may_be_commented_and_lines_may_go_on() {
    let plain = Files::good().scene();
    let commented =
        |text: &str| -> String {
            text.lines()
                .map(|line| {
                    if line.starts_with(['v', 'f']) { format!("{line} # why\n") } else { format!("{line}\n") }
                })
                .collect()
        };
    let went_on = OBJ
        .lines()
        .map(|line| if line.starts_with('f') { line.replacen(' ', " \\\r\n ", 2) } else { line.to_owned() });
    let went_on = format!("# not a line that goes on: C:\\\n{}\n", went_on.collect::<Vec<_>>().join("\n"));
    for obj in [commented(OBJ), went_on.clone()] {
        let files =
            Files::good().with("scene.obj", &obj).with("scene.mtl", "newmtl white\nKd .8 .8 .8 # grey\n");
        assert_eq!(*files.scene().frame(0).unwrap().geometry, *plain.frame(0).unwrap().geometry, "{obj}");
    }
    // Lines keep their numbers.
    let error = Files::good().with("scene.obj", format!("{went_on}v one\n")).error();
    let last = went_on.lines().count() + 1;
    assert_eq!(error, format!("scene.obj: line {last}: `v`: `one` is not a number"));
}

#[test]
fn a_lamp_shines_while_there_is_something_of_it() {
    let keys = json!([{"frame": 0, "value": [1, 1, 1]}, {"frame": 1, "value": [0, 0, 0]}]);
    let track = json!({"target": "object:wall", "property": "scale", "interpolation": "step", "keys": keys});
    let files = Files::good()
        .with("scene.mtl", "newmtl white\nKe 1 1 1\n")
        .set("/animation", json!({"frames": 2, "tracks": [track]}));
    let scene = files.scene();
    // The environment shines all the time.
    assert_eq!(
        [0, 1].map(|frame| scene.frame(frame).unwrap().shining()),
        [vec![true, true], vec![false, true]]
    );
}

#[test]
fn a_bundle_can_be_read_by_itself() {
    let folder = Files::good().folder();
    let bundle = Bundle::open(folder.path(), &Limits::default()).unwrap();
    assert!(bundle.contains("scene.obj") && !bundle.contains("scene") && !bundle.contains("../scene.obj"));
    assert_eq!(bundle.read("scene.obj").unwrap(), OBJ.as_bytes());
    assert_eq!(bundle.top_level().unwrap(), ["scene.json", "scene.mtl", "scene.obj"]);
    for outside in ["../scene.obj", "/etc/passwd", "a/../scene.obj", ""] {
        assert!(bundle.read(outside).unwrap_err().to_string().contains("is outside the bundle"), "{outside}");
    }
}

#[test]
fn a_description_may_be_named_itself_and_begin_with_a_byte_order_mark() {
    let files = Files::good();
    let marked = [b"\xEF\xBB\xBF".as_slice(), &files.0["scene.json"]].concat();
    let folder = files.with("scene.json", marked).folder();
    let scene = Scene::load(&folder.path().join("scene.json"), &Limits::default()).unwrap();
    assert_eq!(scene.name(), "made");
}

#[test]
fn an_environment_image_is_linear_with_scale_and_rotation() {
    let mut sky = image::Rgb32FImage::from_pixel(4, 2, image::Rgb([0.5, 2.0, 100.0]));
    sky.put_pixel(0, 0, image::Rgb([-0.25, 0.0, 1.0]));
    for (name, format) in [("sky.exr", image::ImageFormat::OpenExr), ("sky.hdr", image::ImageFormat::Hdr)] {
        if format == image::ImageFormat::Hdr {
            sky.put_pixel(0, 0, image::Rgb([0.0, 0.0, 1.0]));
        }
        let environment = json!({"type": "image", "path": name, "scale": 2, "rotation_deg": 90});
        let files =
            Files::good().set("/environment", environment).with(name, encoded(&sky.clone().into(), format));
        let frame = frame(&files);
        let Environment::Image { texture, scale: 2.0, rotation_deg: 90.0 } = frame.environment else {
            panic!()
        };
        let Texels::Linear(texels) = &frame.textures[texture.0 as usize].texels else { panic!() };
        assert_eq!(texels[0], [0.0, 0.0, 1.0], "{name}: nothing is darker than black");
        // Radiance HDR shares one exponent between the channels, so small ones lose their digits.
        let tolerance = if format == image::ImageFormat::Hdr { 0.5 } else { 0.0 };
        for (a, b) in texels[5].iter().zip([0.5, 2.0, 100.0]) {
            assert!((a - b).abs() <= tolerance, "{name}: {:?}", texels[5]);
        }
    }
}

#[test]
fn lights_of_the_description_are_where_it_says() {
    let lights = json!([
        {"type": "quad", "corner": [0, 2, 0], "edge_u": [1, 0, 0], "edge_v": [0, 0, 1], "radiance": [5, 6, 7]},
        {"type": "point", "position": [1, 2, 3], "intensity": [4, 5, 6]},
        {"type": "sun", "direction": [0, 3, 4], "irradiance": [1, 2, 3], "angle_deg": 0.5}
    ]);
    let scene = Files::good().set("/lights", lights).scene();
    let frame = scene.frame(0).unwrap();
    assert_eq!(scene.strata().objects, ["wall", "light:0"]);
    let g = &frame.geometry;
    assert_eq!(g.triangles.len(), 4);
    assert_eq!((g.geometric_normal(2), g.geometric_normal(3)), (Vec3::NEG_Y, Vec3::NEG_Y));
    let lamp = &frame.materials[g.material(2) as usize];
    assert_eq!((lamp.name.as_str(), lamp.emission.factor), ("light:0", Vec3::new(5.0, 6.0, 7.0)));
    let Surface::Lambert { albedo } = lamp.surface else { panic!() };
    assert_eq!(albedo.factor, Vec3::ZERO);
    assert_eq!(
        (frame.points[0].position, frame.points[0].intensity),
        (Vec3::new(1.0, 2.0, 3.0), Vec3::new(4.0, 5.0, 6.0))
    );
    assert_eq!((frame.suns[0].direction, frame.suns[0].angle_deg), (Vec3::new(0.0, 0.6, 0.8), 0.5));
}

#[test]
fn light_tracks_change_emission_without_touching_geometry() {
    let lights = json!([
        {"type": "quad", "corner": [0, 2, 0], "edge_u": [1, 0, 0], "edge_v": [0, 0, 1], "radiance": [5, 5, 5]},
        {"type": "point", "position": [1, 2, 3], "intensity": [4, 5, 6]}
    ]);
    let ramp = |target: &str, property: &str| {
        json!({"target": target, "property": property, "interpolation": "linear", "keys": [
            {"frame": 0, "value": [0, 0, 0]}, {"frame": 4, "value": [8, 4, 2]}]})
    };
    let tracks = json!([ramp("light:0", "radiance"), ramp("light:1", "intensity")]);
    let scene =
        Files::good().set("/lights", lights).set("/animation", json!({"fps": 25, "tracks": tracks})).scene();
    assert_eq!((scene.frame_count(), scene.fps()), (5, 25.0));
    let (first, third) = (scene.frame(0).unwrap(), scene.frame(3).unwrap());
    let lamp = |f: &Frame| f.materials.iter().find(|m| m.name == "light:0").unwrap().emission.factor;
    assert_eq!((lamp(&first), lamp(&third)), (Vec3::ZERO, Vec3::new(6.0, 3.0, 1.5)));
    assert_eq!(third.points[0].intensity, Vec3::new(6.0, 3.0, 1.5));
    assert!(Arc::ptr_eq(&first.geometry, &third.geometry));
}

#[test]
fn splines_of_light_never_go_below_black() {
    let keys = json!([{"frame": 0, "value": [9, 9, 9]}, {"frame": 1, "value": [0, 0, 0]},
        {"frame": 3, "value": [0, 0, 0]}, {"frame": 4, "value": [9, 9, 9]}]);
    let track =
        json!({"target": "light:0", "property": "intensity", "interpolation": "catmull_rom", "keys": keys});
    let point = json!([{"type": "point", "position": [1, 2, 3], "intensity": [4, 5, 6]}]);
    let scene = Files::good().set("/lights", point).set("/animation", json!({"tracks": [track]})).scene();
    assert_eq!(scene.frame(2).unwrap().points[0].intensity, Vec3::ZERO);
}

#[test]
fn object_tracks_scale_rotate_and_move_about_the_origin_of_the_world() {
    let track = |property: &str, a: serde_json::Value, b: serde_json::Value| {
        json!({"target": "object:wall", "property": property, "interpolation": "linear", "keys": [
            {"frame": 0, "value": a}, {"frame": 10, "value": b}]})
    };
    let half = std::f64::consts::FRAC_1_SQRT_2;
    let tracks = json!([
        track("translation", json!([0, 0, 0]), json!([10, 0, 0])),
        // A quarter turn about z, given at twice its length.
        track("rotation", json!([0, 0, 0, 1]), json!([0, 0, 2.0 * half, 2.0 * half])),
        track("scale", json!([1, 1, 1]), json!([3, 1, 1])),
    ]);
    let scene = Files::good().set("/animation", json!({"frames": 12, "tracks": tracks})).scene();
    for number in [0u8, 3, 5, 10, 11] {
        let s = f32::from(number.min(10)) / 10.0;
        let turn = Quat::from_rotation_z(std::f32::consts::FRAC_PI_2 * s);
        let g = scene.frame(number.into()).unwrap().geometry;
        for (at, from) in g.positions.iter().zip([Vec3::ZERO, Vec3::X, Vec3::new(1.0, 1.0, 0.0), Vec3::Y]) {
            let expected = turn * (from * Vec3::new(1.0 + 2.0 * s, 1.0, 1.0)) + Vec3::X * (10.0 * s);
            assert!((*at - expected).length() < 1e-5, "frame {number}: {at} is not {expected}");
        }
        assert!(g.normals.iter().all(|n| (*n - Vec3::Z).length() < 1e-6));
    }
    let (a, b) = (scene.frame(10).unwrap(), scene.frame(11).unwrap());
    assert!(Arc::ptr_eq(&a.geometry, &b.geometry), "after the last key nothing moves");
}

#[test]
fn camera_tracks_move_the_view_and_change_its_angle() {
    let tracks = json!([
        {"target": "camera", "property": "fov_deg", "interpolation": "linear", "keys": [
            {"frame": 0, "value": 90}, {"frame": 2, "value": [30]}]},
        {"target": "camera", "property": "origin", "interpolation": "step", "keys": [
            {"frame": 0, "value": [0.5, 0.5, 3]}, {"frame": 2, "value": [0.5, 0.5, 5]}]}
    ]);
    let scene = Files::good().set("/animation", json!({"tracks": tracks})).scene();
    let at = |frame| scene.camera(frame).unwrap();
    assert!((at(0).tan_half_x - 1.0).abs() < 1e-6);
    assert!((at(1).tan_half_x - 30f32.to_radians().tan()).abs() < 1e-6);
    assert!((at(2).tan_half_x - 15f32.to_radians().tan()).abs() < 1e-6);
    assert_eq!((at(1).origin.z, at(2).origin.z), (3.0, 5.0));
    assert_eq!((at(1).focus_distance, at(2).focus_distance), (3.0, 5.0));
}

#[test]
fn another_shape_keeps_the_angle_of_view_that_is_given() {
    for (axis, x, y) in [("x", 1.0, 4.0 / 3.0), ("y", 0.75, 1.0)] {
        let scene = Files::good().set("/camera/fov_axis", json!(axis)).scene();
        let (given, square) = (scene.camera(0).unwrap(), scene.camera_with(0, (9, 9)).unwrap());
        assert!((square.tan_half_x / given.tan_half_x - x).abs() < 1e-6, "{axis}");
        assert!((square.tan_half_y / given.tan_half_y - y).abs() < 1e-6, "{axis}");
    }
}

#[test]
fn frames_can_be_made_from_several_threads_at_once() {
    let track = json!({"target": "object:wall", "property": "translation", "interpolation": "linear", "keys": [
        {"frame": 0, "value": [0, 0, 0]}, {"frame": 39, "value": [39, 0, 0]}]});
    let scene = Files::good().set("/animation", json!({"tracks": [track]})).scene();
    std::thread::scope(|scope| {
        for thread in 0..4 {
            let scene = &scene;
            scope.spawn(move || {
                for number in (thread..40u8).step_by(4) {
                    let frame = scene.frame(number.into()).unwrap();
                    assert_eq!(frame.geometry.positions[0], Vec3::X * f32::from(number));
                }
            });
        }
    });
}
