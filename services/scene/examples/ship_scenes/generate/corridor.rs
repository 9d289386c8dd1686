//! The corridor: a long hall with few large surfaces, lit from its ceiling and through the window at its end.

use glam::dvec3;

use super::bundle::{
    Animation, Base::Colour, Base::Texture, Camera, Environment, Light, Scene, Surface, Surface::*,
    camera_track,
};
use super::mesh::{Axis, Mesh, sine_cosine};
use super::paint;
use super::shapes::*;

/// Half the hall's width, metres. The hall's axis is x = 0.
const HALF_WIDTH: f64 = 1.3;

/// Height of the hall, metres.
const HEIGHT: f64 = 2.7;

/// Z of the end wall, and of the wall behind the camera.
const ENDS: (f64, f64) = (-10.0, 4.0);

/// Z of the glass doors.
const GLASS_DOORS: f64 = -3.2;

/// Z range of the niche in the left wall. The bench stands in it.
const NICHE: (f64, f64) = (-2.4, 0.0);

/// Z of the ceiling lamps' centres.
const LAMPS: [f64; 4] = [2.0, -1.2, -5.0, -8.2];

/// Keyframes of the camera's position: a slow dolly.
const EYE: [(u32, [f64; 3]); 3] = [(0, [0.42, 1.56, 3.3]), (24, [0.3, 1.52, 2.5]), (47, [0.12, 1.48, 1.5])];

/// Keyframes of the camera's target.
const TARGET: [(u32, [f64; 3]); 3] =
    [(0, [-0.16, 1.22, -3.0]), (24, [-0.12, 1.22, -3.5]), (47, [-0.04, 1.24, -4.5])];

/// The whole scene.
pub fn scene() -> Scene {
    let lamp = |z: f64| Light::Quad {
        corner: [-0.3, HEIGHT - 0.035, z - 0.6],
        edge_u: [0.6, 0.0, 0.0],
        edge_v: [0.0, 0.0, 1.2],
        radiance: [21.0, 20.0, 18.4],
    };
    let mut scene = Scene {
        name: "corridor",
        camera: Camera {
            origin: EYE[0].1,
            target: TARGET[0].1,
            up: [0.0, 1.0, 0.0],
            fov_deg: 62.0,
            fov_axis: "x",
            width: 640,
            height: 360,
        },
        environment: Environment::Constant { radiance: [2.8, 3.2, 3.8] },
        lights: LAMPS.map(lamp).to_vec(),
        animation: Animation {
            fps: 24,
            frames: 48,
            tracks: vec![camera_track("origin", &EYE), camera_track("target", &TARGET)],
        },
        materials: materials(),
        textures: textures(),
        objects: Vec::new(),
    };
    shell(&mut scene);
    end_window(&mut scene);
    glass_doors(&mut scene);
    side_doors(&mut scene);
    furniture(&mut scene);
    scene
}

fn materials() -> Vec<(&'static str, Surface)> {
    vec![
        ("wall_paint", Matte(Colour([0.76, 0.74, 0.69]))),
        ("accent_paint", Matte(Colour([0.2, 0.33, 0.38]))),
        ("ceiling_paint", Matte(Colour([0.82, 0.82, 0.8]))),
        ("floor_stone", Plastic(Texture("stone"), 0.16)),
        ("skirting", Plastic(Colour([0.1, 0.1, 0.1]), 0.3)),
        ("white_metal", Plastic(Colour([0.75, 0.75, 0.74]), 0.35)),
        ("dark_metal", Metal([0.22, 0.22, 0.23], 0.4)),
        ("brushed_steel", Metal([0.66, 0.65, 0.63], 0.3)),
        ("mirror", Metal([0.9, 0.91, 0.9], 0.0)),
        ("door_glass", Pane([0.95, 0.98, 0.96])),
        ("window_glass", Pane([0.97, 0.98, 0.97])),
        ("oak", Plastic(Texture("oak"), 0.38)),
        ("walnut", Plastic(Texture("walnut"), 0.3)),
        ("canvas", Matte(Texture("landscape"))),
        ("paper", Matte(Colour([0.82, 0.8, 0.76]))),
        ("leather", Plastic(Colour([0.36, 0.13, 0.06]), 0.42)),
        ("runner", Matte(Texture("runner"))),
        ("planter", Plastic(Colour([0.05, 0.05, 0.055]), 0.2)),
        ("soil", Matte(Colour([0.06, 0.04, 0.03]))),
        ("leaf", Plastic(Colour([0.09, 0.27, 0.07]), 0.35)),
        ("vase_glass", Glass([0.55, 0.8, 0.85])),
        ("hill", Matte(Texture("leaves"))),
        ("exit_sign", Lamp([0.1, 1.6, 0.5])),
    ]
}

fn textures() -> Vec<(&'static str, image::RgbImage)> {
    let slab = |column: i64, row: i64, u: f64, v: f64| {
        let tone = 0.9 + 0.1 * paint::hash(column, row, 41);
        let cloud = paint::turbulence(u, v, (7, 7), 43);
        let vein = (paint::turbulence(u, v, (5, 5), 47) - 0.5).abs();
        let stone = paint::blend([0.58, 0.56, 0.53], [0.72, 0.7, 0.66], cloud * 1.4 - 0.2);
        paint::shade(paint::blend([0.82, 0.8, 0.77], stone, vein * 22.0), tone)
    };
    let laying = paint::Laying { columns: 2, rows: 2, bond: false, joint: [0.008, 0.008] };
    let runner = paint::picture(96, 192, |u, v| {
        let edge = u.min(1.0 - u);
        let diamond = ((u - 0.5).abs() * 2.0 + ((v * 6.0).fract() - 0.5).abs() * 2.0) % 0.8;
        let wool = 0.92 + 0.12 * paint::noise(u, v, (48, 96), 51);
        let dye = if edge < 0.05 {
            [0.2, 0.13, 0.1]
        } else if edge < 0.12 {
            [0.8, 0.66, 0.44]
        } else if diamond < 0.28 {
            [0.72, 0.56, 0.36]
        } else {
            [0.5, 0.14, 0.12]
        };
        paint::shade(dye, wool)
    });
    vec![
        ("stone", paint::tiles(256, laying, [0.42, 0.41, 0.4], slab)),
        ("oak", paint::wood(256, 2, [0.8, 0.62, 0.42], [0.6, 0.42, 0.25], 61)),
        ("walnut", paint::wood(256, 2, [0.46, 0.3, 0.19], [0.24, 0.14, 0.08], 67)),
        ("landscape", paint::landscape(256, 192)),
        ("runner", runner),
        ("leaves", paint::leaves(128, [0.42, 0.55, 0.34], [0.16, 0.27, 0.16], 71)),
    ]
}

/// Floor, ceiling and walls. They overlap by 5 cm, so that light enters only through the end window.
fn shell(scene: &mut Scene) {
    let (end, start) = ENDS;
    let length = start - end + 0.1;
    let floor = quad(
        dvec3(-2.0, 0.0, start + 0.05),
        dvec3(2.0 + HALF_WIDTH + 0.05, 0.0, 0.0),
        dvec3(0.0, 0.0, -length),
    );
    scene.add("floor", "floor_stone", floor.textured(1.6, Axis::X));
    let ceiling = quad(
        dvec3(-2.0, HEIGHT, end - 0.05),
        dvec3(2.0 + HALF_WIDTH + 0.05, 0.0, 0.0),
        dvec3(0.0, 0.0, length),
    );
    scene.add("ceiling", "ceiling_paint", ceiling);
    let right =
        quad(dvec3(HALF_WIDTH, -0.05, end - 0.05), dvec3(0.0, 0.0, length), dvec3(0.0, HEIGHT + 0.1, 0.0));
    scene.add("wall_right", "wall_paint", right);
    // The left wall is 40 cm thick at the niche. In the plane of `frame`, x runs along -z of the hall.
    let left =
        frame([-start - 0.05, -0.05], [-end + 0.05, HEIGHT + 0.05], [-NICHE.1, -0.02], [-NICHE.0, 2.3], 0.4);
    scene.add("wall_left", "wall_paint", left.turned(Axis::Y, 90.0).at(-HALF_WIDTH, 0.0, 0.0));
    let niche = quad(
        dvec3(-1.66, -0.04, NICHE.1 + 0.1),
        dvec3(0.0, 0.0, NICHE.0 - NICHE.1 - 0.2),
        dvec3(0.0, 2.5, 0.0),
    );
    scene.add("niche", "accent_paint", niche);
    let front =
        quad(dvec3(HALF_WIDTH + 0.05, -0.05, start), dvec3(-3.4, 0.0, 0.0), dvec3(0.0, HEIGHT + 0.1, 0.0));
    scene.add("wall_front", "wall_paint", front);
    let skirting = |low: [f64; 3], high: [f64; 3]| rounded_cuboid(low, high, 0.003, 1);
    let x = HALF_WIDTH;
    let pieces = [
        skirting([x - 0.012, -0.01, -4.3], [x + 0.02, 0.08, 0.495]),
        skirting([x - 0.012, -0.01, 1.625], [x + 0.02, 0.08, start - 0.002]),
        skirting([x - 0.012, -0.01, end + 0.02], [x + 0.02, 0.08, -5.43]),
        skirting([-x - 0.02, -0.01, NICHE.1 + 0.001], [-x + 0.012, 0.08, start - 0.002]),
        skirting([-x - 0.02, -0.01, -6.3], [-x + 0.012, 0.08, NICHE.0 - 0.001]),
        skirting([-x - 0.02, -0.01, end + 0.02], [-x + 0.012, 0.08, -7.43]),
    ];
    scene.add("skirting", "skirting", Mesh::join(pieces));
    let housings = LAMPS.map(|z| {
        slab_with_hole(
            [-0.33, HEIGHT - 0.05, z - 0.63],
            [0.33, HEIGHT + 0.02, z + 0.63],
            [-0.305, z - 0.605],
            [0.305, z + 0.605],
        )
    });
    scene.add("lamps", "white_metal", Mesh::join(housings));
}

/// The end wall with its window, and the hill outside.
fn end_window(scene: &mut Scene) {
    let end = ENDS.0;
    let wall = frame([-2.0, -0.06], [1.35, HEIGHT + 0.06], [-0.75, 0.5], [0.75, 2.3], 0.25).at(0.0, 0.0, end);
    scene.add("wall_end", "accent_paint", wall);
    let z = end - 0.12;
    let casing = frame([-0.76, 0.49], [0.76, 2.31], [-0.7, 0.55], [0.7, 2.25], 0.06).at(0.0, 0.0, z);
    let bars = [
        rounded_cuboid([-0.025, 0.54, z - 0.05], [0.025, 2.26, z - 0.01], 0.004, 1),
        rounded_cuboid([-0.71, 1.58, z - 0.045], [-0.02, 1.61, z - 0.015], 0.004, 1),
        rounded_cuboid([0.02, 1.58, z - 0.045], [0.71, 1.61, z - 0.015], 0.004, 1),
    ];
    scene.add("window_frame", "white_metal", casing.with(Mesh::join(bars)));
    for x in [-0.71, 0.02] {
        let pane = quad(dvec3(x, 0.54, z - 0.03), dvec3(0.69, 0.0, 0.0), dvec3(0.0, 1.72, 0.0));
        scene.add("window_panes", "window_glass", pane);
    }
    let sill = rounded_cuboid([-0.8, 0.475, end - 0.13], [0.8, 0.504, end + 0.07], 0.006, 2);
    scene.add("window_sill", "walnut", sill.textured(0.8, Axis::X));
    let hill = surface(48, 12, |u, v| {
        let (crest, _) = sine_cosine(u * 400.0 + 30.0);
        let (wave, _) = sine_cosine(u * 1900.0 + v * 300.0);
        dvec3(-14.0 + 28.0 * u, -1.5 + (2.9 + 0.35 * crest + 0.06 * wave) * v, end - 4.0 - 5.0 * v)
    });
    scene.add("hill", "hill", hill.textured(3.0, Axis::X));
}

/// Two glass door leaves in a steel frame across the hall, with a fanlight above. The right leaf is ajar.
fn glass_doors(scene: &mut Scene) {
    let z = GLASS_DOORS;
    let x = HALF_WIDTH;
    let bar = |low: [f64; 2], high: [f64; 2]| {
        rounded_cuboid([low[0], low[1], z - 0.035], [high[0], high[1], z + 0.035], 0.004, 1)
    };
    let posts = [
        bar([-x - 0.025, -0.015], [-x + 0.06, HEIGHT + 0.01]),
        bar([x - 0.06, -0.015], [x + 0.025, HEIGHT + 0.01]),
        bar([-x + 0.05, 2.15], [x - 0.05, 2.22]),
        bar([-x + 0.05, HEIGHT - 0.05], [x - 0.05, HEIGHT + 0.01]),
    ];
    scene.add("glass_wall_frame", "dark_metal", Mesh::join(posts));
    let fanlight = quad(dvec3(-x + 0.05, 2.2, z), dvec3(2.0 * x - 0.1, 0.0, 0.0), dvec3(0.0, 0.47, 0.0));
    scene.add("fanlight", "door_glass", fanlight);
    // A leaf's hinge is at x = 0. The leaf extends to +x and faces +z.
    let (width, height) = (1.225, 2.13);
    let leaf = || {
        frame([0.0, 0.008], [width, height], [0.06, 0.16], [width - 0.06, height - 0.06], 0.04)
            .at(0.0, 0.0, 0.02)
    };
    let pane =
        || quad(dvec3(0.055, 0.155, 0.0), dvec3(width - 0.11, 0.0, 0.0), dvec3(0.0, height - 0.21, 0.0));
    let grip = |side: f64| {
        let path = [
            dvec3(width - 0.03, 0.8, side * 0.018),
            dvec3(width - 0.03, 0.8, side * 0.075),
            dvec3(width - 0.03, 1.35, side * 0.075),
            dvec3(width - 0.03, 1.35, side * 0.018),
        ];
        tube(&rounded_path(&path, 0.02, 4), 0.013, 12)
    };
    let left = |mesh: Mesh| mesh.turned(Axis::Y, 2.0).at(-x + 0.065, 0.0, z);
    let right = |mesh: Mesh| mesh.turned(Axis::Y, 180.0 - 34.0).at(x - 0.065, 0.0, z);
    for (name, place) in [("left", &left as &dyn Fn(Mesh) -> Mesh), ("right", &right)] {
        let parts = vec![("dark_metal", place(leaf())), ("brushed_steel", place(grip(1.0).with(grip(-1.0))))];
        scene.add_parts(format!("glass_door_{name}"), parts);
        scene.add(format!("glass_door_{name}"), "door_glass", place(pane()));
    }
    let sign = rounded_cuboid([-0.17, 2.36, z + 0.05], [0.17, 2.5, z + 0.08], 0.004, 1);
    let rod = cuboid([-0.012, 2.49, z + 0.058], [0.012, HEIGHT + 0.01, z + 0.072]);
    let face = quad(dvec3(-0.15, 2.38, z + 0.082), dvec3(0.3, 0.0, 0.0), dvec3(0.0, 0.1, 0.0));
    scene.add_parts("exit_sign", vec![("white_metal", sign.with(rod)), ("exit_sign", face)]);
}

/// A closed wooden door in its case, with a lever handle. Its front is at z = 0, its middle at x = 0.
fn wooden_door(scene: &mut Scene, name: &str, place: impl Fn(Mesh) -> Mesh) {
    let case = frame([-0.57, -0.02], [0.57, 2.23], [-0.48, -0.01], [0.48, 2.13], 0.05).at(0.0, 0.0, 0.025);
    let leaf = rounded_cuboid([-0.477, 0.006, -0.03], [0.477, 2.127, 0.012], 0.003, 1);
    let panel = |low: f64, high: f64| {
        frame([-0.36, low], [0.36, high], [-0.325, low + 0.035], [0.325, high - 0.035], 0.015)
            .at(0.0, 0.0, 0.02)
    };
    scene.add(format!("door_{name}"), "walnut", place(case.textured(0.8, Axis::Y)));
    let panels = leaf.with(panel(0.15, 0.95)).with(panel(1.1, 2.0));
    scene.add(format!("door_{name}"), "oak", place(panels.textured(0.9, Axis::Y)));
    let rose = cylinder(0.027, 0.008, 0.002, 24).turned(Axis::X, 90.0).at(0.41, 1.02, 0.011);
    let path = [dvec3(0.41, 1.02, 0.015), dvec3(0.41, 1.02, 0.065), dvec3(0.28, 1.02, 0.065)];
    let lever = tube(&rounded_path(&path, 0.02, 5), 0.01, 14);
    let plate = cylinder(0.02, 0.006, 0.002, 20).turned(Axis::X, 90.0).at(0.41, 0.93, 0.011);
    scene.add(format!("door_{name}"), "brushed_steel", place(Mesh::join([rose, lever, plate])));
}

fn side_doors(scene: &mut Scene) {
    let right = |z: f64| move |mesh: Mesh| mesh.turned(Axis::Y, -90.0).at(HALF_WIDTH, 0.0, z);
    wooden_door(scene, "near", right(1.06));
    wooden_door(scene, "far", right(-4.865));
    wooden_door(scene, "left", |mesh| mesh.turned(Axis::Y, 90.0).at(-HALF_WIDTH, 0.0, -6.865));
}

fn furniture(scene: &mut Scene) {
    bench(scene);
    pictures(scene);
    // A runner on the floor.
    let mut rug = rounded_cuboid([-0.5, 0.001, -2.6], [0.5, 0.009, 1.4], 0.003, 1);
    for vertex in &mut rug.vertices {
        vertex.uv = glam::dvec2(vertex.position.x + 0.5, (1.4 - vertex.position.z) / 2.0);
    }
    scene.add("runner", "runner", rug);

    // One plant at the far end, and one in front of the glass doors.
    for (i, (x, z)) in [(-0.95, -9.2), (0.98, -2.8)].into_iter().enumerate() {
        plant(scene, i, x, z);
    }
    console(scene);
}

/// The bench in the niche: an oak seat on steel legs, with two leather cushions.
fn bench(scene: &mut Scene) {
    let z = (NICHE.0 + NICHE.1) / 2.0;
    let seat = rounded_cuboid([-1.64, 0.4, z - 1.0], [-1.22, 0.44, z + 1.0], 0.006, 2);
    let leg = |z: f64| {
        let path =
            [dvec3(-1.6, 0.402, z), dvec3(-1.6, 0.012, z), dvec3(-1.26, 0.012, z), dvec3(-1.26, 0.402, z)];
        tube(&rounded_path(&path, 0.04, 5), 0.012, 12)
    };
    let cushion = |z: f64| rounded_cuboid([-1.62, 0.441, z - 0.46], [-1.24, 0.52, z + 0.46], 0.03, 3);
    let parts = vec![
        ("oak", seat.textured(0.8, Axis::Z)),
        ("brushed_steel", leg(z - 0.8).with(leg(z + 0.8))),
        ("leather", cushion(z - 0.48).with(cushion(z + 0.48))),
    ];
    scene.add_parts("bench", parts);
}

/// Two pictures: a large one between the doors on the right, and a small one in the niche.
fn pictures(scene: &mut Scene) {
    let picture = |half: [f64; 2]| {
        let (w, h) = (half[0], half[1]);
        let border = frame([-w, -h], [w, h], [-w + 0.035, -h + 0.035], [w - 0.035, h - 0.035], 0.04);
        let mount = frame(
            [-w + 0.03, -h + 0.03],
            [w - 0.03, h - 0.03],
            [-w + 0.12, -h + 0.12],
            [w - 0.12, h - 0.12],
            0.006,
        );
        let canvas = quad(
            dvec3(-w + 0.11, -h + 0.11, -0.022),
            dvec3(2.0 * w - 0.22, 0.0, 0.0),
            dvec3(0.0, 2.0 * h - 0.22, 0.0),
        );
        [("walnut", border), ("paper", mount.at(0.0, 0.0, -0.014)), ("canvas", canvas)]
    };
    let hang =
        |material: &str, mesh: Mesh| if material == "walnut" { mesh.textured(0.6, Axis::X) } else { mesh };
    let large = picture([0.75, 0.58]).map(|(material, mesh)| {
        (material, hang(material, mesh).turned(Axis::Y, -90.0).at(HALF_WIDTH - 0.035, 1.55, -1.3))
    });
    scene.add_parts("picture_large", large.to_vec());
    let z = (NICHE.0 + NICHE.1) / 2.0;
    let small = picture([0.48, 0.38])
        .map(|(material, mesh)| (material, hang(material, mesh).turned(Axis::Y, 90.0).at(-1.625, 1.5, z)));
    scene.add_parts("picture_small", small.to_vec());
}

/// On the left wall near the camera: a console table with a vase, and a round mirror above it.
fn console(scene: &mut Scene) {
    let (z, x) = (1.15, -HALF_WIDTH);
    let top = rounded_cuboid([x + 0.003, 0.8, z - 0.5], [x + 0.3, 0.83, z + 0.5], 0.005, 2);
    let legs = [(0.03, -0.47), (0.27, -0.47), (0.03, 0.47), (0.27, 0.47)].map(|(dx, dz)| {
        cuboid([x + dx - 0.014, 0.001, z + dz - 0.014], [x + dx + 0.014, 0.81, z + dz + 0.014])
    });
    let parts = vec![("walnut", top.textured(0.7, Axis::Z)), ("dark_metal", Mesh::join(legs))];
    scene.add_parts("console", parts);
    let vase = turned_body(
        &[
            (0.0, 0.0),
            (0.05, 0.0),
            (0.06, 0.006),
            (0.085, 0.09),
            (0.08, 0.14),
            (0.045, 0.2),
            (0.035, 0.24),
            (0.045, 0.28),
            (0.043, 0.282),
            (0.041, 0.28),
            (0.031, 0.24),
            (0.041, 0.199),
            (0.076, 0.138),
            (0.081, 0.09),
            (0.057, 0.012),
            (0.048, 0.008),
            (0.0, 0.008),
        ],
        40,
    );
    scene.add("vase", "vase_glass", vase.at(x + 0.15, 0.831, z - 0.2));
    let bowl = turned_body(
        &[
            (0.0, 0.0),
            (0.05, 0.0),
            (0.1, 0.02),
            (0.15, 0.06),
            (0.153, 0.062),
            (0.15, 0.064),
            (0.1, 0.026),
            (0.05, 0.006),
            (0.0, 0.005),
        ],
        40,
    );
    scene.add("bowl", "brushed_steel", bowl.stretched(0.8, 1.0, 1.0).at(x + 0.15, 0.831, z + 0.2));
    let rim = ring(0.36, 0.018, 64, 10).turned(Axis::Z, -90.0).at(x + 0.02, 1.6, z);
    let glass = disc(0.355, 64).turned(Axis::Y, 90.0).at(x + 0.022, 1.6, z);
    scene.add_parts("round_mirror", vec![("dark_metal", rim), ("mirror", glass)]);
}

/// A planter with a bush of long leaves.
fn plant(scene: &mut Scene, number: usize, x: f64, z: f64) {
    let tub = turned_body(
        &[
            (0.0, 0.002),
            (0.12, 0.002),
            (0.125, 0.01),
            (0.17, 0.4),
            (0.172, 0.42),
            (0.165, 0.422),
            (0.155, 0.37),
            (0.0, 0.37),
        ],
        40,
    );
    let soil = turned_body(&[(0.0, 0.372), (0.152, 0.38), (0.0, 0.4)], 32);
    let leaves = (0..34).map(|i| {
        let rank = (i as f64 + 0.5) / 34.0;
        let turn = 137.508 * i as f64 + 40.0 * number as f64;
        let (reach, rise) = (0.2 - 0.11 * rank, 0.5 + 0.6 * rank);
        surface(4, 12, move |u, v| {
            let (body, _) = sine_cosine(180.0 * (0.05 + 0.9 * v));
            let width = 0.085 * body * (u - 0.5);
            let droop = 0.3 * v * v * v * (1.0 - 0.6 * rank);
            dvec3(0.015 + reach * (v + 0.4 * v * v), rise * v - droop + 0.6 * width.abs(), width)
        })
        .turned(Axis::Y, turn)
    });
    let place = |mesh: Mesh| mesh.at(x, 0.0, z);
    let bush = Mesh::join(leaves).at(0.0, 0.385, 0.0);
    scene.add_parts(
        format!("plant_{number}"),
        vec![("planter", place(tub)), ("soil", place(soil)), ("leaf", place(bush))],
    );
}
