//! The kitchen: a closed room with a window, a hundred objects of all sizes, and one rolling apple.

mod appliances;
mod cabinets;
mod dishes;
mod room;
mod table;

use super::bundle::{
    Animation, Base::Colour, Base::Texture, Camera, Environment, Light, Scene, Surface, Surface::*,
    camera_track,
};
use super::paint;

/// Height of the worktops' upper side, metres.
const WORKTOP: f64 = 0.9;

/// Gap between an object and its support, in metres. It keeps two surfaces from sharing a plane.
const CLEARANCE: f64 = 0.001;

/// Number of frames in the shot.
const FRAMES: u32 = 48;

/// Keyframes of the camera's position and target.
const EYE: [(u32, [f64; 3]); 3] = [(0, [1.45, 1.68, 2.95]), (24, [0.95, 1.6, 2.75]), (47, [0.38, 1.52, 2.6])];
const TARGET: [(u32, [f64; 3]); 3] =
    [(0, [-0.2, 0.98, -1.2]), (24, [-0.12, 0.94, -1.2]), (47, [0.02, 0.88, -1.2])];

/// The whole scene.
pub fn scene() -> Scene {
    let mut scene = Scene {
        name: "kitchen",
        camera: Camera {
            origin: EYE[0].1,
            target: TARGET[0].1,
            up: [0.0, 1.0, 0.0],
            fov_deg: 58.0,
            fov_axis: "x",
            width: 640,
            height: 360,
        },
        environment: Environment::Constant { radiance: [2.6, 3.0, 3.5] },
        lights: vec![
            // The ceiling lamp.
            Light::Quad {
                corner: [-0.55, 2.53, 0.15],
                edge_u: [1.3, 0.0, 0.0],
                edge_v: [0.0, 0.0, 0.8],
                radiance: [33.0, 30.5, 26.5],
            },
            // The light strip under the glass cupboard.
            Light::Quad {
                corner: [1.05, 1.495, -1.56],
                edge_u: [0.46, 0.0, 0.0],
                edge_v: [0.0, 0.0, 0.04],
                radiance: [22.0, 18.5, 13.5],
            },
        ],
        animation: Animation {
            fps: 24,
            frames: FRAMES,
            tracks: vec![camera_track("origin", &EYE), camera_track("target", &TARGET)],
        },
        materials: materials(),
        textures: textures(),
        objects: Vec::new(),
    };
    room::furnish(&mut scene);
    cabinets::furnish(&mut scene);
    appliances::furnish(&mut scene);
    dishes::furnish(&mut scene);
    table::furnish(&mut scene);
    scene
}

fn materials() -> Vec<(&'static str, Surface)> {
    vec![
        // The room.
        ("wall_paint", Matte(Colour([0.8, 0.78, 0.72]))),
        ("ceiling_paint", Matte(Colour([0.82, 0.82, 0.8]))),
        ("white_paint", Plastic(Colour([0.78, 0.77, 0.74]), 0.4)),
        ("floor_tiles", Plastic(Texture("floor"), 0.32)),
        ("wall_tiles", Plastic(Texture("wall_tiles"), 0.15)),
        ("window_glass", Pane([0.97, 0.98, 0.97])),
        ("hedge", Matte(Texture("leaves"))),
        ("lawn", Matte(Colour([0.16, 0.3, 0.07]))),
        ("blind", Matte(Texture("stripes"))),
        ("painting", Matte(Texture("landscape"))),
        ("clock_face", Matte(Texture("clock"))),
        // Cabinets.
        ("sage_paint", Plastic(Colour([0.19, 0.29, 0.25]), 0.38)),
        ("cream_paint", Plastic(Colour([0.74, 0.7, 0.6]), 0.38)),
        ("plinth", Matte(Colour([0.06, 0.07, 0.065]))),
        ("oak", Plastic(Texture("oak"), 0.4)),
        ("walnut", Plastic(Texture("walnut"), 0.35)),
        ("pale_wood", Matte(Colour([0.62, 0.44, 0.26]))),
        // Metals.
        ("brushed_steel", Metal([0.62, 0.61, 0.59], 0.36)),
        ("chrome", Metal([0.78, 0.78, 0.79], 0.0)),
        ("polished_steel", Metal([0.7, 0.69, 0.67], 0.18)),
        ("copper", Metal([0.93, 0.6, 0.45], 0.22)),
        ("brass", Metal([0.88, 0.68, 0.36], 0.3)),
        ("cast_iron", Plastic(Colour([0.025, 0.025, 0.027]), 0.5)),
        // Plastics and glazes.
        ("black_gloss", Plastic(Colour([0.015, 0.015, 0.017]), 0.08)),
        ("black_plastic", Plastic(Colour([0.03, 0.03, 0.032]), 0.35)),
        ("red_enamel", Plastic(Colour([0.56, 0.035, 0.025]), 0.1)),
        ("blue_enamel", Plastic(Colour([0.35, 0.55, 0.6]), 0.12)),
        ("white_porcelain", Plastic(Colour([0.7, 0.69, 0.66]), 0.1)),
        ("blue_porcelain", Plastic(Colour([0.08, 0.17, 0.4]), 0.12)),
        ("yellow_porcelain", Plastic(Colour([0.78, 0.5, 0.07]), 0.12)),
        ("green_porcelain", Plastic(Colour([0.14, 0.36, 0.22]), 0.14)),
        ("stoneware", Plastic(Colour([0.52, 0.43, 0.34]), 0.4)),
        ("terracotta", Matte(Colour([0.55, 0.22, 0.1]))),
        // Glass.
        ("clear_glass", Glass([1.0, 1.0, 1.0])),
        ("green_glass", Glass([0.45, 0.75, 0.4])),
        ("amber_glass", Glass([0.9, 0.6, 0.2])),
        ("cabinet_pane", Pane([0.96, 0.98, 0.97])),
        // Food and cloth.
        ("apple_skin", Plastic(Texture("apple"), 0.22)),
        ("green_apple", Plastic(Colour([0.36, 0.5, 0.06]), 0.22)),
        ("orange_peel", Plastic(Colour([0.85, 0.33, 0.03]), 0.4)),
        ("lemon_peel", Plastic(Colour([0.85, 0.66, 0.05]), 0.38)),
        ("stalk", Matte(Colour([0.13, 0.07, 0.03]))),
        ("leaf", Plastic(Colour([0.1, 0.28, 0.05]), 0.4)),
        ("soil", Matte(Colour([0.06, 0.04, 0.03]))),
        ("pasta", Matte(Colour([0.8, 0.56, 0.22]))),
        ("beans", Plastic(Colour([0.3, 0.06, 0.04]), 0.3)),
        ("flour", Matte(Colour([0.82, 0.8, 0.74]))),
        ("coffee", Plastic(Colour([0.045, 0.02, 0.01]), 0.1)),
        ("orange_juice", Matte(Colour([0.85, 0.4, 0.03]))),
        ("bread", Matte(Texture("crust"))),
        ("gingham", Matte(Texture("gingham"))),
        ("towel", Matte(Texture("towel"))),
        ("cushion", Matte(Colour([0.55, 0.16, 0.1]))),
        ("paper", Matte(Colour([0.8, 0.77, 0.7]))),
        ("book_red", Plastic(Colour([0.42, 0.05, 0.05]), 0.4)),
        ("book_blue", Plastic(Colour([0.06, 0.14, 0.34]), 0.4)),
        ("book_green", Plastic(Colour([0.08, 0.25, 0.14]), 0.4)),
        ("book_yellow", Plastic(Colour([0.72, 0.48, 0.1]), 0.4)),
        // Lamps.
        ("hood_lamp", Lamp([40.0, 33.0, 24.0])),
        ("display", Lamp([0.4, 2.2, 1.7])),
    ]
}

fn textures() -> Vec<(&'static str, image::RgbImage)> {
    let tile = |column: i64, row: i64, u: f64, v: f64| {
        let pale = (column + row) % 2 == 0;
        let clay = if pale { [0.86, 0.82, 0.74] } else { [0.42, 0.47, 0.47] };
        let tone =
            0.92 + 0.1 * paint::hash(column, row, 5) + 0.08 * (paint::turbulence(u, v, (8, 8), 3) - 0.5);
        paint::shade(clay, tone)
    };
    let glaze = |column: i64, row: i64, _: f64, _: f64| {
        paint::shade([0.93, 0.93, 0.9], 0.93 + 0.07 * paint::hash(column, row, 9))
    };
    let floor = paint::Laying { columns: 4, rows: 4, bond: false, joint: [0.03, 0.03] };
    let wall = paint::Laying { columns: 4, rows: 8, bond: true, joint: [0.02, 0.04] };
    vec![
        ("floor", paint::tiles(256, floor, [0.55, 0.53, 0.5], tile)),
        ("wall_tiles", paint::tiles(256, wall, [0.68, 0.67, 0.64], glaze)),
        ("leaves", paint::leaves(128, [0.4, 0.52, 0.3], [0.1, 0.19, 0.1], 4)),
        (
            "stripes",
            paint::picture(64, 64, |u, _| {
                if (u * 8.0).floor() as i64 % 2 == 0 { [0.92, 0.9, 0.84] } else { [0.55, 0.68, 0.7] }
            }),
        ),
        ("landscape", paint::landscape(256, 192)),
        ("clock", paint::clock_face(128)),
        ("oak", paint::wood(256, 5, [0.82, 0.64, 0.42], [0.56, 0.38, 0.2], 1)),
        ("walnut", paint::wood(256, 3, [0.5, 0.33, 0.2], [0.24, 0.14, 0.08], 2)),
        (
            "apple",
            paint::picture(128, 64, |u, v| {
                let streak = paint::noise(u, v, (40, 3), 6) * 0.6 + paint::noise(u, v, (9, 2), 8) * 0.6;
                let towards_stalk = (v - 0.75).max(0.0) * 2.4;
                paint::blend([0.72, 0.08, 0.07], [0.9, 0.72, 0.25], (streak - 0.62) * 1.8 + towards_stalk)
            }),
        ),
        (
            "crust",
            paint::picture(64, 64, |u, v| {
                paint::blend(
                    [0.74, 0.5, 0.24],
                    [0.46, 0.25, 0.09],
                    paint::turbulence(u, v, (6, 6), 12) * 1.5 - 0.25,
                )
            }),
        ),
        ("gingham", paint::gingham(128, 4, [0.87, 0.86, 0.83], [0.2, 0.36, 0.62])),
        (
            "towel",
            paint::picture(64, 64, |_, v| {
                let stripe = [0.08, 0.12, 0.16, 0.84, 0.88, 0.92].iter().any(|s| (v - s).abs() < 0.013);
                if stripe { [0.75, 0.16, 0.12] } else { [0.93, 0.91, 0.86] }
            }),
        ),
    ]
}
