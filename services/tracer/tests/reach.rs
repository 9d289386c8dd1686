//! What cannot matter to the picture is found, and nothing else.

mod support;

use forelight_scene::{
    AlphaMask, Color, Environment, Frame, PointLight, Sun, Surface, Texels, Texture, TextureId,
};
use forelight_tracer::{Excluded, Reach, Reason, reachable};
use glam::{Vec2, Vec3};
use std::sync::Arc;
use support::{Builder, lambert, material};

const SKY: Environment = Environment::Constant(Vec3::ONE);

fn sun(irradiance: f32) -> Sun {
    Sun { direction: Vec3::new(0.6, 0.8, 0.0), irradiance: Vec3::splat(irradiance), angle_deg: 0.5 }
}

fn point(position: Vec3) -> PointLight {
    PointLight { position, intensity: Vec3::ONE, cone: None }
}

fn reach(frame: &Frame) -> Reach {
    reachable(frame, &frame.materials)
}

fn left_out(frame: &Frame) -> Vec<String> {
    reach(frame).left_out().iter().map(ToString::to_string).collect()
}

/// A room of 4 × 3 × 4 m with table, lamp and camera; another room; sun, sky, street lamp. The room's walls
/// are triangles 0 … 11.
fn rooms() -> Builder {
    Builder::default()
        .cuboid(
            Vec3::new(-2.0, 0.0, -2.0),
            Vec3::new(2.0, 3.0, 2.0),
            true,
            material("room", lambert(0.7), 0.0),
        )
        .cuboid(
            Vec3::new(-0.5, 0.0, -1.5),
            Vec3::new(0.5, 0.7, -0.7),
            false,
            material("table", lambert(0.5), 0.0),
        )
        .quad(Vec3::new(-0.5, 2.9, -0.5), Vec3::X, Vec3::Z, material("lamp", lambert(0.0), 9.0))
        .cuboid(
            Vec3::new(2.2, 0.0, -2.0),
            Vec3::new(6.0, 3.0, 2.0),
            true,
            material("next", lambert(0.7), 0.0),
        )
        .sphere(Vec3::new(4.0, 0.7, 0.0), 0.5, material("ball", lambert(0.5), 0.0))
        .quad(Vec3::new(3.0, 2.9, -0.5), Vec3::X, Vec3::Z, material("next lamp", lambert(0.0), 9.0))
}

fn seen_from(builder: Builder, camera: Vec3) -> Frame {
    let mut frame = builder.frame(camera, Vec3::new(0.0, 1.0, -1.0), 32, SKY);
    frame.suns.push(sun(1.0));
    frame.points.push(point(Vec3::new(0.0, 5.0, 0.0)));
    frame
}

fn from_inside() -> Frame {
    seen_from(rooms(), Vec3::new(0.3, 1.6, 1.5))
}

const OUTSIDE: &str = "outside the closed room room that holds the camera";

#[test]
fn a_closed_room_that_holds_the_camera_keeps_everything_else_out() {
    let expected = [
        "light of next lamp",
        "point light 0",
        "sun 0",
        "environment",
        "next (12 triangles)",
        "ball (16128 triangles)",
        "next lamp (2 triangles)",
    ];
    assert_eq!(left_out(&from_inside()), expected.map(|what| format!("{what}: {OUTSIDE}")));
    let (frame, reach) = (from_inside(), reach(&from_inside()));
    assert!(reach.hides_triangles());
    assert!(
        (0..26).all(|t| reach.triangle(t))
            && !(26..frame.geometry.triangles.len() as u32).any(|t| reach.triangle(t))
    );
    assert!(reach.area_light(2) && !reach.area_light(5) && !reach.sun(0) && !reach.point_light(0));
    assert!(!reach.environment());
}

#[test]
fn from_outside_a_closed_room_hides_what_is_in_it() {
    let frame = seen_from(rooms(), Vec3::new(0.3, 1.6, 9.0));
    let expected = [
        "light of lamp: enclosed in room",
        "light of next lamp: enclosed in next",
        "ball (16128 triangles): enclosed in next",
        "lamp (2 triangles): enclosed in room",
        "next lamp (2 triangles): enclosed in next",
    ];
    let mut found = left_out(&frame);
    found.sort();
    assert_eq!(found, {
        let mut e = expected.to_vec();
        e.sort();
        e
    });
    // The table touches the floor, so it stays, seen or not.
}

#[test]
fn a_room_is_open_if_one_triangle_is_missing() {
    for missing in 0..12 {
        let mut frame = from_inside();
        let geometry = Arc::make_mut(&mut frame.geometry);
        geometry.triangles.remove(missing);
        geometry.triangle_stratum.remove(missing);
        // The other room is closed still, and its own lamp and ball remain hidden.
        let kept = left_out(&frame);
        assert_eq!(kept.len(), 3, "without {missing}: {kept:?}");
        assert!(kept.iter().all(|l| l.ends_with("enclosed in next")), "without {missing}: {kept:?}");
    }
}

#[test]
fn a_room_is_open_if_one_triangle_lets_light_pass() {
    let grey = Color::plain(Vec3::splat(0.5));
    let texture = TextureId(0);
    let mut cut_out = material("leaf", lambert(0.5), 0.0);
    cut_out.mask = Some(AlphaMask { texture, cutoff: 0.5 });
    let mut veil = material("veil", lambert(0.5), 0.0);
    veil.opacity = 0.9;
    let glass = Surface::Glass { ior: 1.5, transmittance: grey, alpha: 0.3, priority: None };
    let pane = Surface::ThinGlass { ior: 1.5, transmittance: grey };
    for window in [cut_out, veil, material("glass", glass, 0.0), material("pane", pane, 0.0)] {
        let mut frame = from_inside();
        let geometry = Arc::make_mut(&mut frame.geometry);
        let stratum = geometry.strata.pairs.len() as u32;
        geometry.strata.pairs.push((0, stratum));
        geometry.triangle_stratum[7] = stratum;
        frame.materials = frame.materials.iter().cloned().chain([window]).collect();
        let white = Texels::Srgb8(vec![[255; 4]]);
        frame.textures = vec![Texture { name: "t".into(), width: 1, height: 1, texels: white }].into();
        let kept = left_out(&frame);
        assert_eq!(kept.len(), 3, "{kept:?}");
        assert!(kept.iter().all(|l| l.ends_with("enclosed in next")), "{kept:?}");
    }
}

#[test]
fn a_mirror_on_the_wall_does_not_open_a_room() {
    let mirror = Surface::Metal { f0: Color::plain(Vec3::ONE), alpha: 0.0 };
    let (corner, u, v) = (Vec3::new(-1.99, 1.0, 1.0), Vec3::new(0.0, 0.0, -1.0), Vec3::Y);
    let frame =
        seen_from(rooms().quad(corner, u, v, material("mirror", mirror, 0.0)), Vec3::new(0.3, 1.6, 1.5));
    assert_eq!(left_out(&frame), left_out(&from_inside()));
}

#[test]
fn what_stands_in_a_room_undoes_its_proof_only_where_rays_may_slip_past_the_floor() {
    let clear =
        Surface::Glass { ior: 1.5, transmittance: Color::plain(Vec3::ONE), alpha: 0.0, priority: None };
    let camera = Vec3::new(0.3, 1.6, 1.5);
    let glass = |base: f32| {
        let glass = material("glass", clear, 0.0);
        seen_from(
            rooms().cuboid(Vec3::new(1.0, base, 0.0), Vec3::new(1.2, base + 0.2, 0.2), false, glass),
            camera,
        )
    };
    let ball = |height: f32| {
        seen_from(rooms().sphere(Vec3::new(1.0, height, 0.0), 0.3, material("b", lambert(0.5), 0.0)), camera)
    };
    let box_at = |base: f32| {
        let wood = material("box", lambert(0.5), 0.0);
        seen_from(
            rooms().cuboid(Vec3::new(1.0, base, 0.0), Vec3::new(1.2, base + 0.2, 0.2), false, wood),
            camera,
        )
    };
    let proven = |frame: &Frame| !reach(frame).environment();
    assert!(!proven(&glass(0.0)), "its bottom lets light pass to the floor's other side");
    assert!(proven(&glass(0.01)));
    assert!(!proven(&ball(0.3)), "rays start off its underside");
    assert!(proven(&ball(0.31)));
    assert!(proven(&box_at(0.0)), "flush");
    assert!(proven(&box_at(-0.1)), "let into the floor");
    assert!(!proven(&box_at(2e-5)), "a gap narrower than the step off its underside");
    assert!(proven(&box_at(2e-3)), "a wider gap");
}

#[test]
fn what_crosses_or_touches_a_wall_from_beyond_stays() {
    let crossing = |x: f32| {
        let bar = material("bar", lambert(0.5), 0.0);
        let frame = seen_from(
            rooms().cuboid(Vec3::new(x, 1.0, 0.0), Vec3::new(x + 0.1, 1.1, 0.1), false, bar),
            Vec3::new(0.3, 1.6, 1.5),
        );
        left_out(&frame).contains(&format!("bar (12 triangles): {OUTSIDE}"))
    };
    assert!(crossing(2.01), "in the gap between the rooms");
    assert!(!crossing(1.95), "through the wall");
    assert!(!crossing(2.0), "touching it");
    assert!(!crossing(2.0 + 5e-5), "closer to it than the margin");
}

#[test]
fn a_lamp_in_an_opaque_housing_lights_nothing() {
    let scene = |inward: bool, lift: f32| {
        Builder::default()
            .quad(
                Vec3::new(-3.0, 0.0, 3.0),
                Vec3::X * 6.0,
                Vec3::Z * -6.0,
                material("floor", lambert(0.5), 0.0),
            )
            .cuboid(Vec3::splat(0.0), Vec3::splat(1.0), inward, material("housing", lambert(0.5), 0.0))
            .sphere(Vec3::new(0.5, 0.5 + lift, 0.5), 0.3, material("bulb", lambert(0.5), 5.0))
            .frame(Vec3::new(0.5, 2.0, 4.0), Vec3::ZERO, 32, Environment::Black)
    };
    for inward in [false, true] {
        let expected = ["light of bulb: enclosed in housing", "bulb (16128 triangles): enclosed in housing"];
        assert_eq!(left_out(&scene(inward, 0.0)), expected);
        assert_eq!(left_out(&scene(inward, 0.21)), Vec::<String>::new(), "the bulb pierces the housing");
    }
}

#[test]
fn a_housing_with_interpolated_normals_is_not_relied_on() {
    // Rays may leave through it: their directions are chosen about another normal than the triangle's own.
    let shaded = |smooth: bool| {
        let mut frame = Builder::default()
            .sphere(Vec3::ZERO, 1.0, material("shade", lambert(0.5), 0.0))
            .sphere(Vec3::ZERO, 0.5, material("bulb", lambert(0.5), 5.0))
            .frame(Vec3::new(0.0, 0.0, 4.0), Vec3::ZERO, 32, Environment::Black);
        if !smooth {
            Arc::make_mut(&mut frame.geometry).normals.fill(Vec3::ZERO);
        }
        frame
    };
    // The sphere's seam repeats positions, but by other arithmetic: it is open there.
    assert!(left_out(&shaded(true)).is_empty());
    let mut flat = shaded(false);
    close_seam(&mut flat);
    assert_eq!(left_out(&flat).len(), 2);
    let mut smooth = shaded(true);
    close_seam(&mut smooth);
    assert!(left_out(&smooth).is_empty());
}

/// Makes the first and last column of the spheres' vertices, and all those at the poles, equal.
fn close_seam(frame: &mut Frame) {
    let geometry = Arc::make_mut(&mut frame.geometry);
    for ball in geometry.positions.chunks_mut(65 * 129) {
        for ring in 0..65 {
            let row = &mut ball[ring * 129..(ring + 1) * 129];
            let first = row[0];
            row[128] = first;
            if ring == 0 || ring == 64 {
                row.fill(first);
            }
        }
    }
}

#[test]
fn shells_within_shells_are_each_looked_at_for_themselves() {
    let cube =
        |size: f32, name: &str| (Vec3::splat(-size), Vec3::splat(size), material(name, lambert(0.5), 0.0));
    let build = |camera: Vec3| {
        let mut builder = Builder::default();
        for (size, name) in [(4.0, "outer"), (3.0, "middle"), (2.0, "inner"), (1.0, "kernel")] {
            let (low, high, material) = cube(size, name);
            builder = builder.cuboid(low, high, false, material);
        }
        left_out(&builder.frame(camera, camera + Vec3::Z + 0.1 * Vec3::X, 32, SKY))
    };
    let hidden = |name: &str, why: &str| format!("{name} (12 triangles): {why}");
    let outside = "enclosed in outer";
    assert_eq!(build(Vec3::splat(5.0)), ["middle", "inner", "kernel"].map(|n| hidden(n, outside)));
    // Between middle and inner.
    let outside = |room: &str| format!("outside the closed room {room} that holds the camera");
    let sky = format!("environment: {}", outside("outer"));
    let expected = [sky, hidden("outer", &outside("middle")), hidden("kernel", "enclosed in inner")];
    assert_eq!(build(Vec3::splat(2.5)), expected);
}

#[test]
fn a_camera_close_to_a_wall_leaves_everything_in() {
    let at = |z: f32, aperture: f32| {
        let mut frame = seen_from(rooms(), Vec3::new(0.3, 1.6, z));
        frame.camera.aperture_radius = aperture;
        !reach(&frame).environment()
    };
    assert!(at(1.9, 0.0) && at(1.9, 0.05));
    assert!(!at(1.9, 0.11), "the lens reaches through the wall");
    assert!(!at(1.99999, 0.0) && !at(2.00001, 0.0));
}

#[test]
fn an_acute_corner_on_the_cameras_side_undoes_the_proof() {
    // A roof whose eaves meet the floor at 27 degrees: a ray from there may start beyond the roof.
    let tent = |camera: Vec3| {
        let mut frame = Builder::default()
            .cuboid(Vec3::ZERO, Vec3::new(4.0, 1.0, 4.0), true, material("tent", lambert(0.5), 0.0))
            .quad(Vec3::new(1.5, 0.3, 1.5), Vec3::X, Vec3::Z, material("lamp", lambert(0.5), 1.0))
            .frame(camera, Vec3::new(2.0, 0.5, 2.0), 32, SKY);
        for p in &mut Arc::make_mut(&mut frame.geometry).positions {
            if p.y == 1.0 {
                p.x = 2.0; // both upper edges become one ridge
            }
        }
        left_out(&frame)
    };
    assert!(tent(Vec3::new(2.0, 0.5, 3.9)).is_empty());
    // From outside its edges stick out, and what it holds is hidden.
    assert_eq!(
        tent(Vec3::new(2.0, 0.5, 9.0)),
        ["light of lamp: enclosed in tent", "lamp (2 triangles): enclosed in tent"]
    );
}

#[test]
fn a_light_that_faces_away_from_everything_is_left_out() {
    let scene = |height: f32, black: bool, both: bool, tilt: f32| {
        let mut lamp = material("lamp", lambert(if black { 0.0 } else { 0.5 }), 5.0);
        lamp.emits_both_sides = both;
        Builder::default()
            .quad(
                Vec3::new(-3.0, 0.0, 3.0),
                Vec3::X * 6.0,
                Vec3::Z * -6.0,
                material("floor", lambert(0.5), 0.0),
            )
            .quad(Vec3::new(-0.5, height, 0.5), Vec3::X + tilt * Vec3::Y, -Vec3::Z, lamp)
            .frame(Vec3::new(0.0, 0.8, 4.0), Vec3::ZERO, 32, SKY)
    };
    assert_eq!(left_out(&scene(1.0, true, false, 0.0)), ["light of lamp: faces away from everything"]);
    assert!(!reach(&scene(1.0, true, false, 0.0)).hides_triangles(), "it throws shadows still");
    let tilted = scene(1.0, true, false, 0.5);
    assert!(left_out(&tilted).is_empty(), "its plane meets the floor");
    assert!(left_out(&scene(0.5, true, false, 0.0)).is_empty(), "the camera is above it");
    assert!(left_out(&scene(1.0, true, true, 0.0)).is_empty(), "it shines down, too");
    assert!(left_out(&scene(1.0, false, false, 0.0)).is_empty(), "it is lit itself");
    assert!(left_out(&scene(0.0, true, false, 0.0)).is_empty(), "flush with the floor");
}

#[test]
fn lights_that_emit_nothing_are_left_out() {
    let mut frame = Builder::default()
        .quad(Vec3::ZERO, Vec3::X, Vec3::Z, material("screen", lambert(0.5), 1.0))
        .quad(Vec3::Y, Vec3::X, Vec3::Z, material("poster", lambert(0.5), 1.0))
        .quad(Vec3::Y, Vec3::ZERO, Vec3::Z, material("line", lambert(0.5), 1.0))
        .frame(Vec3::new(0.0, 1.0, 4.0), Vec3::ZERO, 32, Environment::Constant(Vec3::ZERO));
    let image = |texels| Texture { name: "t".into(), width: 2, height: 1, texels };
    let black = image(Texels::Srgb8(vec![[0, 0, 0, 255]; 2]));
    let dim = image(Texels::Linear(vec![[0.0; 3], [0.0, 0.0, 1e-3]]));
    frame.textures = vec![black, dim].into();
    let textured = |index: usize, m: &forelight_scene::Material| {
        let texture = Some(TextureId(index as u32)).filter(|_| index < 2);
        forelight_scene::Material { emission: Color { texture, ..m.emission }, ..m.clone() }
    };
    frame.materials = frame.materials.iter().enumerate().map(|(i, m)| textured(i, m)).collect();
    frame.suns = vec![sun(0.0), sun(1.0)];
    frame.points = vec![PointLight { intensity: Vec3::ZERO, ..point(Vec3::ONE) }, point(Vec3::ONE)];
    let expected = [
        "light of screen: emits nothing",
        "light of line: has no area",
        "point light 0: emits nothing",
        "sun 0: emits nothing",
        "environment: emits nothing",
    ];
    assert_eq!(left_out(&frame), expected);
    frame.environment = Environment::Image { texture: TextureId(0), scale: 1.0, rotation_deg: 0.0 };
    assert_eq!(left_out(&frame), expected);
    frame.environment = Environment::Image { texture: TextureId(1), scale: 1.0, rotation_deg: 0.0 };
    assert_eq!(left_out(&frame), expected[..4]);
}

#[test]
fn a_spot_whose_cone_holds_nothing_is_left_out() {
    let spot = |axis: Vec3, outer: f32| {
        let mut frame = Builder::default()
            .sphere(Vec3::ZERO, 1.0, material("ball", lambert(0.5), 0.0))
            .frame(Vec3::new(0.0, 0.0, 4.0), Vec3::ZERO, 32, Environment::Black);
        let cone = Some((axis.normalize(), (0.5 * outer).cos(), outer.cos()));
        frame.points.push(PointLight { cone, ..point(Vec3::new(0.0, 3.0, 0.0)) });
        reach(&frame).left_out().first().map(|l| l.reason.clone())
    };
    assert_eq!(spot(Vec3::Y, 1.0), Some(Reason::EmptyCone));
    assert_eq!(spot(-Vec3::Y, 0.1), None);
    assert_eq!(spot(Vec3::X, 0.9), Some(Reason::EmptyCone));
    assert_eq!(spot(Vec3::X, 1.2), None, "the cone comes close to the ball");
}

#[test]
fn an_empty_frame_and_a_single_triangle_are_no_trouble() {
    let frame = Builder::default().frame(Vec3::Z, Vec3::ZERO, 8, SKY);
    assert_eq!(reach(&frame), Reach::everything(&frame));
    let mut frame = Builder::default()
        .quad(Vec3::ZERO, Vec3::X, Vec3::Y, material("q", lambert(0.5), 0.0))
        .frame(Vec3::Z, Vec3::ZERO, 8, SKY);
    Arc::make_mut(&mut frame.geometry).uvs.fill(Vec2::ONE);
    assert_eq!(reach(&frame), Reach::everything(&frame));
    assert!(!matches!(reach(&frame).left_out().first().map(|l| &l.what), Some(Excluded::Environment)));
}
