//! What other programs write into OBJ and MTL files is read, as far as it can be, and told.

use crate::made::{Files, MTL, OBJ, png};
use forelight_scene::{Frame, Material, Surface, Texels};
use glam::Vec3;

fn frame(files: &Files) -> Frame {
    files.scene().frame(0).unwrap()
}

fn painted(mtl: &str) -> Files {
    let files = Files::good().with("scene.mtl", format!("newmtl white\n{mtl}"));
    files.with("a.png", png(1, 1, [255, 0, 0, 255])).with("my -s wood.png", png(1, 1, [0, 255, 0, 255]))
}

fn material(mtl: &str) -> Material {
    frame(&painted(mtl)).materials[0].clone()
}

#[test]
fn kinds_of_surface_that_are_not_rendered_become_their_likes() {
    let Surface::Metal { f0, .. } = material("illum 5\nKs 0.9 0.8 0.7\n").surface else { panic!() };
    assert_eq!(f0.factor, Vec3::new(0.9, 0.8, 0.7));
    assert!(matches!(material("illum 5\nKd 1 1 1\n").surface, Surface::Lambert { .. }));
    for model in [6, 8, 9, 10] {
        let like = material(&format!("Ks 0.5 0.5 0.5\nNi 1.4\nd 0.25\nillum {model}\n"));
        assert!(matches!(like.surface, Surface::Plastic { ior: 1.4, .. }), "{model}");
        assert_eq!(like.opacity, 0.25);
    }
    let scene = painted("illum 9\nnewmtl b\nillum 6\nnewmtl c\nillum 9\n").scene();
    assert_eq!(scene.warnings(), ["scene.mtl: not fully supported: `illum 6` (1×), `illum 9` (2×)"]);
}

#[test]
fn options_stand_before_the_name_of_a_texture() {
    let texel = |options: &str, name: &str| {
        let scene = painted(&format!("map_Kd {options} {name}\n")).scene();
        let frame = scene.frame(0).unwrap();
        let Texels::Srgb8(texels) = &frame.textures[0].texels else { panic!() };
        (texels[0], scene.warnings().to_vec())
    };
    let (red, green) = ([255, 0, 0, 255], [0, 255, 0, 255]);
    for same in [
        "-s 1.000000 1.000000 1.000000",
        "-o 0 -t 0 0 -s 1",
        "-blendu on -blendv on -cc off -clamp off -mm 0 1",
        "-imfchan l -texres 512 -bm 2 -boost 3 -type sphere",
    ] {
        assert_eq!(texel(same, "a.png"), (red, vec![]));
        assert_eq!(texel(same, "my -s wood.png"), (green, vec![]));
    }
    let (texel, warnings) = texel("-blendu off -clamp  on -mm 0 2 -s 2 2", "my -s wood.png");
    assert_eq!(texel, green);
    assert_eq!(
        warnings,
        ["scene.mtl: not fully supported: `map_Kd -blendu` (1×), `map_Kd -clamp` (1×), `map_Kd -mm` (1×), \
          `map_Kd -s` (1×)"]
    );
}

#[test]
fn a_halo_is_an_opacity_and_an_index_of_zero_is_none() {
    let scene = painted("illum 2\nKs 1 1 1\nd -halo 0.5\nNi 0.0\n").scene();
    let material = &scene.frame(0).unwrap().materials[0];
    assert_eq!(material.opacity, 0.5);
    assert!(matches!(material.surface, Surface::Plastic { ior: 1.5, .. }));
    assert_eq!(scene.warnings(), ["scene.mtl: not fully supported: `Ni 0` (1×), `d -halo` (1×)"]);
}

#[test]
fn a_line_may_name_several_libraries() {
    let libraries = |line: &str| {
        Files::good()
            .with("scene.obj", OBJ.replace("mtllib scene.mtl", line))
            .with("a b.mtl", "newmtl other\n")
            .with("x/c#1.mtl", "newmtl third\n")
    };
    for (line, count) in [
        ("mtllib scene.mtl x/c#1.mtl", 2),
        ("mtllib scene.mtl # the only one", 1),
        ("mtllib \"scene.mtl\"", 1),
        ("mtllib a b.mtl\nmtllib scene.mtl", 2),
        ("mtllib \"a b.mtl\" scene.mtl \"x/c#1.mtl\" # all", 3),
        ("mtllib a b.mtl # first\nmtllib scene.mtl", 2),
    ] {
        assert_eq!(frame(&libraries(line)).materials.len(), count, "{line}");
    }
    let error = libraries("mtllib scene.mtl none.mtl last.mtl").error();
    assert!(error.starts_with("scene.obj: line 1: `mtllib`: none.mtl: cannot be read: "), "{error}");
    let error = libraries("mtllib no such.mtl\nmtllib none.mtl").error();
    assert!(error.starts_with("scene.obj: line 1: `mtllib`: no such.mtl: cannot be read: "), "{error}");
    let error = libraries("mtllib \"\"").error();
    assert_eq!(error, "scene.obj: line 1: `mtllib`: the path is empty");
}

#[test]
fn text_may_be_latin_1_and_have_the_lines_of_old_macs() {
    let plain = Files::good().scene().frame(0).unwrap();
    let latin = |text: &str| [b"# f\xFCr\n".as_slice(), text.as_bytes()].concat();
    let named = |text: &str| {
        latin(&text.replace("white", "wei\u{1}")).into_iter().map(|byte| if byte == 1 { 0xDF } else { byte })
    };
    let files = Files::good()
        .with("scene.obj", named(OBJ).collect::<Vec<u8>>())
        .with("scene.mtl", named(MTL).collect::<Vec<u8>>());
    let frame = frame(&files);
    assert_eq!(*frame.geometry, *plain.geometry);
    assert_eq!(frame.materials[0].name, "weiß");
    let old = Files::good()
        .with("scene.obj", format!("# \\\n{OBJ}").replace('\n', "\r"))
        .with("scene.mtl", MTL.replace('\n', "\r"));
    assert_eq!(*self::frame(&old).geometry, *plain.geometry);
}

#[test]
fn faces_of_too_few_corners_are_left_out_and_counted() {
    let scene = Files::good().with("scene.obj", format!("{OBJ}f 1 2\nf\nf 3/3\n")).scene();
    assert_eq!(scene.frame(0).unwrap().geometry, Files::good().scene().frame(0).unwrap().geometry);
    assert_eq!(scene.warnings(), ["scene.obj: faces of fewer than 3 corners are left out (3×)"]);
}

#[test]
fn without_a_library_all_faces_are_grey() {
    let obj = OBJ.replace("mtllib scene.mtl\n", "").replace("f 1/1/1", "usemtl black\nf 1/1/1");
    let scene = Files::good().with("scene.obj", obj).scene();
    let frame = scene.frame(0).unwrap();
    assert_eq!((frame.materials.len(), frame.geometry.triangles.len()), (1, 2));
    let Surface::Lambert { albedo } = &frame.materials[0].surface else { panic!() };
    assert_eq!(albedo.factor, Vec3::splat(0.5));
    assert_eq!(scene.warnings(), ["scene.obj: faces of `wall` have no material and are rendered grey"]);
}

#[test]
fn vertices_that_lose_their_digits_far_out_are_told() {
    let obj = |x: f64| {
        format!("mtllib scene.mtl\nusemtl white\nv {x} 0 0\nv {} 0 0\nv {x} 1 0\nf 1 2 3\n", x + 1.0)
    };
    let warnings = |x: f64| Files::good().with("scene.obj", obj(x)).scene().warnings().to_vec();
    assert!(warnings(60_000.0).iter().all(|warning| !warning.contains("from the origin")));
    let told = warnings(432_099.0);
    assert!(told.iter().any(|warning| warning.contains("432100 m") && warning.contains("31 mm")), "{told:?}");
}
