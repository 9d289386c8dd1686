//! Malformed geometry, materials and textures give one clear line with file, place and reason.

use crate::made::{Files, OBJ, encoded, line, png};
use exr::prelude::{Encoding, Image, Layer, LayerAttributes, SpecificChannels, Vec2, WritableImage};
use forelight_scene::Limits;

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
        let exr = encoded(&image.clone().into(), image::ImageFormat::OpenExr);
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
    assert!(error.contains("textures/wood.jpg: is not a supported image"), "{error}");
    let mut cut = png(8, 8, [1, 2, 3, 255]);
    cut.truncate(40);
    let error = files.clone().with("textures/wood.jpg", cut).error();
    assert!(error.contains("textures/wood.jpg: is not a readable image"), "{error}");
    let image = image::RgbImage::from_fn(64, 64, |x, y| image::Rgb([x as u8, y as u8, (x * y) as u8]));
    let jpeg = encoded(&image.into(), image::ImageFormat::Jpeg);
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
fn pixels_outside_of_an_image_s_window_count_as_texels() {
    let pixels = SpecificChannels::rgb(|_| (0.5f32, 0.5f32, 0.5f32));
    let layer = Layer::new((64, 32), LayerAttributes::default(), Encoding::FAST_LOSSLESS, pixels);
    let mut image = Image::from_layer(layer);
    image.attributes.display_window.size = Vec2(1, 1);
    let mut exr = std::io::Cursor::new(Vec::new());
    image.write().to_buffered(&mut exr).unwrap();
    let files =
        Files::good().with("scene.mtl", "newmtl white\nmap_Kd a.exr\n").with("a.exr", exr.into_inner());
    let within = |texture_pixels| files.load_within(&Limits { texture_pixels, ..Limits::default() });
    let texture = within(64 * 32).unwrap().frame(0).unwrap().textures[0].clone();
    assert_eq!((texture.width, texture.height), (1, 1));
    let error = line(within(64 * 32 - 1));
    assert_eq!(error, "a.exr: texels of all textures: 2048 is more than the limit of 2047");
}

#[test]
fn material_values_out_of_range() {
    for (text, expected) in [
        ("Kd 0.5 1.5 0.5", "`Kd`: 1.5 is not in the range 0 to 1"),
        ("Kd nan 0 0", "`Kd`: NaN is not in the range 0 to 1"),
        ("Ke -1 0 0", "`Ke`: -1 is not in the range 0 to 1000000000000"),
        ("Ni 0.05", "`Ni`: 0.05 is not in the range 0.1 to 10"),
        ("Pr 2", "`Pr`: 2 is not in the range 0 to 1"),
        ("d x", "`d`: `x` is not a number"),
        ("d -halo x", "`d`: `x` is not a number"),
        ("illum 11", "`illum 11` is not a whole number from 0 to 10"),
        ("map_Kd -wood a.png", "`map_Kd`: `-wood` is not an option of a texture"),
        ("map_Kd -mm 1", "`map_Kd`: `-mm` needs 2 or more values"),
        ("map_Kd -s a.png", "`map_Kd`: `-s` needs 1 or more values"),
        ("map_Kd -s 1 1 1", "`map_Kd` needs a name"),
        ("map_Kd", "`map_Kd` needs a name"),
        ("newmtl", "`newmtl` needs a name"),
    ] {
        let error = Files::good().with("scene.mtl", format!("newmtl white\n{text}\n")).error();
        assert_eq!(error, format!("scene.mtl: line 2: {expected}"));
    }
}

#[test]
fn a_material_key_before_any_material() {
    let error = Files::good().with("scene.mtl", "Kd 1 1 1\nnewmtl white\n").error();
    assert_eq!(error, "scene.mtl: line 1: `Kd` comes before the first `newmtl`");
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
        ("f 1 9", "`f`: there is no vertex 9; there are 4 so far"),
        ("f 1 2 99999999999", "`f`: there is no vertex 99999999999; there are 4 so far"),
        ("f 1 2 999999999999999999999", "`f`: `999999999999999999999` is not an index"),
        ("f 1 2 -5", "`f`: there is no vertex -5; there are 4 so far"),
        ("f 0 1 2", "`f`: there is no vertex 0; there are 4 so far"),
        ("f 1/9 2/1 3/1", "`f`: there is no texture coordinate 9; there are 4 so far"),
        ("f 1//7 2//1 3//1", "`f`: there is no normal 7; there are 1 so far"),
        ("f 1/1 2 3/1", "`f`: all corners must have the same attributes"),
        ("f 1/1/1/1 2 3", "`f`: `1/1/1/1` is not `v`, `v/vt`, `v//vn` or `v/vt/vn`"),
        ("f /1 /1 /1", "`f`: `/1` is not `v`, `v/vt`, `v//vn` or `v/vt/vn`"),
        ("usemtl", "`usemtl` needs a name"),
        ("mtllib", "`mtllib` needs a name"),
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
    let expected = "scene.obj: line 40014: `f`: the non-convex faces have too many corners to triangulate here; triangulate them in the exporter";
    assert_eq!(round(40_000, 0.5).error(), expected);
}

#[test]
fn an_obj_file_that_is_no_text() {
    let error = Files::good().with("scene.obj", b"v 0 0 0\n\xff\xfe\0\n").error();
    assert_eq!(error, "scene.obj: line 2: is not UTF-8 text; save the file as UTF-8");
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
