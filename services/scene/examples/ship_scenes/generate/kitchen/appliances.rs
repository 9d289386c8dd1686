//! The oven, hob, hood, fridge, kettle and toaster, and the pots on the hob.

use glam::dvec3;

use super::{CLEARANCE, WORKTOP};
use crate::generate::bundle::Scene;
use crate::generate::mesh::{Axis, Mesh, sine_cosine};
use crate::generate::shapes::*;

/// Adds all appliances.
pub fn furnish(scene: &mut Scene) {
    oven(scene);
    hob(scene);
    hood(scene);
    fridge(scene);
    pots(scene);
    kettle(scene);
    toaster(scene);
}

fn oven(scene: &mut Scene) {
    let (left, right) = (-1.497, -0.903);
    let door = rounded_cuboid([left, 0.12, -1.235], [right, 0.73, -1.195], 0.004, 1);
    let panel = rounded_cuboid([left, 0.735, -1.235], [right, 0.856, -1.192], 0.004, 1);
    scene.add("oven", "brushed_steel", door.with(panel));
    let window = rounded_cuboid([left + 0.06, 0.18, -1.21], [right - 0.06, 0.62, -1.191], 0.003, 1);
    scene.add("oven_window", "black_gloss", window);
    let path = [
        dvec3(left + 0.05, 0.68, -1.2),
        dvec3(left + 0.05, 0.68, -1.145),
        dvec3(right - 0.05, 0.68, -1.145),
        dvec3(right - 0.05, 0.68, -1.2),
    ];
    scene.add("oven_handle", "chrome", tube(&rounded_path(&path, 0.02, 4), 0.009, 12));
    let knob = turned_body(
        &[(0.0, -0.004), (0.024, -0.004), (0.022, 0.006), (0.019, 0.024), (0.016, 0.027), (0.0, 0.027)],
        16,
    );
    let knobs = [-1.43, -1.35, -1.05, -0.97].map(|x| knob.clone().turned(Axis::X, 90.0).at(x, 0.797, -1.192));
    scene.add("oven_knobs", "black_plastic", Mesh::join(knobs));
    let surround = rounded_cuboid([-1.27, 0.765, -1.2], [-1.13, 0.83, -1.189], 0.003, 1);
    let digits = [-1.245, -1.216, -1.184, -1.155]
        .map(|x| quad(dvec3(x - 0.009, 0.782, -1.1875), dvec3(0.018, 0.0, 0.0), dvec3(0.0, 0.03, 0.0)));
    scene.add_parts("oven_clock", vec![("black_gloss", surround), ("display", Mesh::join(digits))]);
    // A towel over the handle.
    let towel = surface(10, 26, |u, v| {
        let (fold, _) = sine_cosine(u * 800.0);
        let sway = 0.006 * fold;
        let x = -1.36 + 0.26 * u;
        let (front, bend, back) = (0.36, 0.036, 0.22);
        let way = v * (front + bend + back);
        let radius = 0.0115;
        if way < front {
            let hang = front - way;
            dvec3(x, 0.68 - hang, -1.145 + radius + sway * (hang / front))
        } else if way < front + bend {
            let (sin, cos) = sine_cosine((way - front) / bend * 180.0);
            dvec3(x, 0.68 + radius * sin, -1.145 + radius * cos)
        } else {
            dvec3(x, 0.68 - (way - front - bend), -1.145 - radius)
        }
    });
    scene.add("towel", "towel", towel);
}

fn hob(scene: &mut Scene) {
    let plate = rounded_cuboid([-1.49, WORKTOP - 0.004, -1.74], [-0.91, WORKTOP + 0.008, -1.22], 0.004, 1);
    scene.add("hob", "polished_steel", plate);
    let places = [(-1.34, -1.6), (-1.06, -1.6), (-1.34, -1.36), (-1.06, -1.36)];
    let burner = turned_body(
        &[
            (0.0, -0.002),
            (0.055, -0.002),
            (0.05, 0.008),
            (0.038, 0.008),
            (0.038, 0.012),
            (0.034, 0.0155),
            (0.0, 0.0155),
        ],
        12,
    );
    let burners = places.map(|(x, z)| burner.clone().at(x, WORKTOP + 0.008, z));
    scene.add("burners", "black_plastic", Mesh::join(burners));
    for (name, x) in [("grate_left", -1.34), ("grate_right", -1.06)] {
        let top = WORKTOP + 0.036;
        let bar = |x0: f64, z0: f64, x1: f64, z1: f64| {
            let (low, high) = ([x0 - 0.004, top - 0.01, z0 - 0.004], [x1 + 0.004, top, z1 + 0.004]);
            cuboid(low, high)
        };
        // The bars along z lie 1.2 mm lower than those along x, so that no two surfaces share a plane.
        let across = [-1.72, -1.6, -1.48, -1.36, -1.24].map(|z| bar(x - 0.12, z, x + 0.12, z));
        let along = [-0.12, 0.0, 0.12].map(|dx| bar(x + dx, -1.72, x + dx, -1.24).at(0.0, -0.0012, 0.0));
        let feet = [(-0.12, -1.72), (0.12, -1.72), (-0.12, -1.24), (0.12, -1.24)].map(|(dx, z)| {
            cuboid([x + dx - 0.003, WORKTOP + 0.006, z - 0.003], [x + dx + 0.003, top - 0.006, z + 0.003])
        });
        scene.add(name, "cast_iron", Mesh::join(across.into_iter().chain(along).chain(feet)));
    }
}

fn hood(scene: &mut Scene) {
    let lip = rounded_cuboid([-1.5, 1.6, -1.81], [-0.9, 1.655, -1.3], 0.004, 2);
    // The canopy from the lip to the chimney: three sloping sides. The wall closes the fourth.
    let (low, high) = (1.65, 1.93);
    let bottom = [
        dvec3(-1.49, low, -1.8),
        dvec3(-1.49, low, -1.31),
        dvec3(-0.91, low, -1.31),
        dvec3(-0.91, low, -1.8),
    ];
    let top = [
        dvec3(-1.33, high, -1.8),
        dvec3(-1.33, high, -1.56),
        dvec3(-1.07, high, -1.56),
        dvec3(-1.07, high, -1.8),
    ];
    let mut canopy = Mesh::default();
    for i in 0..3 {
        canopy.flat_patch([bottom[i], bottom[i + 1], top[i + 1], top[i]]);
    }
    let chimney = cuboid([-1.331, high - 0.01, -1.81], [-1.069, 2.62, -1.559]);
    scene.add("hood", "brushed_steel", Mesh::join([lip, canopy, chimney]));
    let lamps = [-1.33, -1.07]
        .map(|x| quad(dvec3(x - 0.035, 1.598, -1.6), dvec3(0.07, 0.0, 0.0), dvec3(0.0, 0.0, 0.07)));
    scene.add("hood_lamps", "hood_lamp", Mesh::join(lamps));
}

fn fridge(scene: &mut Scene) {
    let (left, right) = (1.66, 2.33);
    let body = rounded_cuboid([left, 0.04, -1.78], [right, 1.86, -1.19], 0.03, 1);
    let upper = rounded_cuboid([left, 0.66, -1.2], [right, 1.86, -1.1], 0.035, 2);
    let lower = rounded_cuboid([left, 0.05, -1.2], [right, 0.65, -1.1], 0.035, 2);
    scene.add("fridge", "blue_enamel", Mesh::join([body, upper, lower]));
    let handle = |y: f64, length: f64| {
        let x = left + 0.07;
        let path = [
            dvec3(x, y, -1.105),
            dvec3(x, y, -1.05),
            dvec3(x, y + length, -1.05),
            dvec3(x, y + length, -1.105),
        ];
        tube(&rounded_path(&path, 0.025, 4), 0.011, 8)
    };
    scene.add("fridge", "chrome", handle(0.82, 0.4).with(handle(0.42, 0.17)));
    let feet = [(1.72, -1.7), (2.27, -1.7), (1.72, -1.2), (2.27, -1.2)]
        .map(|(x, z)| cylinder(0.025, 0.06, 0.003, 12).at(x, -0.002, z));
    scene.add("fridge", "black_plastic", Mesh::join(feet));
}

/// An open pot that stands on y = 0: flat bottom, straight sides, rolled rim.
fn pot(radius: f64, height: f64, wall: f64) -> Mesh {
    let inner = radius - wall;
    turned_body(
        &[
            (0.0, 0.0),
            (radius - 0.012, 0.0),
            (radius - 0.003, 0.004),
            (radius, 0.013),
            (radius, height - 0.004),
            (radius + 0.004, height),
            (radius + 0.002, height + 0.003),
            (inner, height),
            (inner, 0.014),
            (inner - 0.003, wall + 0.004),
            (inner - 0.012, wall),
            (0.0, wall),
        ],
        28,
    )
}

/// A domed lid that rests at y = 0, and its knob.
fn lid(radius: f64) -> (Mesh, Mesh) {
    let dome = turned_body(
        &[
            (0.0, -0.002),
            (radius - 0.006, -0.002),
            (radius + 0.004, 0.004),
            (radius + 0.002, 0.008),
            (radius * 0.8, 0.02),
            (radius * 0.5, 0.03),
            (radius * 0.2, 0.034),
            (0.0, 0.035),
        ],
        28,
    );
    let knob = turned_body(
        &[(0.0, 0.03), (0.009, 0.03), (0.007, 0.045), (0.018, 0.054), (0.016, 0.062), (0.0, 0.065)],
        12,
    );
    (dome, knob)
}

/// Two loop handles, left and right of a pot.
fn loops(radius: f64, height: f64) -> Mesh {
    let one = |side: f64| {
        let r = side * (radius - 0.002);
        let path = [
            dvec3(r, height, -0.035),
            dvec3(r + side * 0.04, height, -0.035),
            dvec3(r + side * 0.04, height, 0.035),
            dvec3(r, height, 0.035),
        ];
        tube(&rounded_path(&path, 0.018, 3), 0.006, 6)
    };
    one(1.0).with(one(-1.0))
}

fn pots(scene: &mut Scene) {
    let grate = WORKTOP + 0.036 + CLEARANCE;
    let stock = |mesh: Mesh| mesh.turned(Axis::Y, 25.0).at(-1.34, grate, -1.58);
    let (dome, knob) = lid(0.112);
    scene.add_parts(
        "stock_pot",
        vec![
            ("polished_steel", stock(pot(0.115, 0.16, 0.003))),
            ("black_plastic", stock(loops(0.115, 0.13))),
        ],
    );
    scene.add_parts(
        "stock_pot",
        vec![
            ("polished_steel", stock(dome.at(0.0, 0.167, 0.0))),
            ("black_plastic", stock(knob.at(0.0, 0.167, 0.0))),
        ],
    );
    let pan = |mesh: Mesh| mesh.turned(Axis::Y, 35.0).at(-1.05, grate, -1.58);
    let grip = tube(&[dvec3(0.0, 0.07, 0.08), dvec3(0.0, 0.085, 0.14), dvec3(0.0, 0.095, 0.26)], 0.008, 10);
    scene.add_parts("copper_pan", vec![("copper", pan(pot(0.088, 0.095, 0.0025))), ("brass", pan(grip))]);
    let frying = |mesh: Mesh| mesh.turned(Axis::Y, -28.0).at(-1.06, grate, -1.36);
    let bowl = turned_body(
        &[
            (0.0, 0.0),
            (0.095, 0.0),
            (0.103, 0.005),
            (0.125, 0.042),
            (0.127, 0.046),
            (0.123, 0.046),
            (0.1, 0.009),
            (0.094, 0.005),
            (0.0, 0.004),
        ],
        28,
    );
    let handle = tube(&[dvec3(0.0, 0.033, 0.11), dvec3(0.0, 0.055, 0.18), dvec3(0.0, 0.062, 0.3)], 0.01, 10);
    scene.add_parts("frying_pan", vec![("cast_iron", frying(bowl)), ("black_plastic", frying(handle))]);
}

fn kettle(scene: &mut Scene) {
    let place = |mesh: Mesh| mesh.turned(Axis::Y, -35.0).at(-2.08, WORKTOP + CLEARANCE, -0.62);
    let body = turned_body(
        &[
            (0.0, 0.02),
            (0.082, 0.02),
            (0.09, 0.028),
            (0.092, 0.05),
            (0.086, 0.1),
            (0.074, 0.15),
            (0.06, 0.19),
            (0.054, 0.205),
            (0.045, 0.212),
            (0.02, 0.219),
            (0.0, 0.22),
        ],
        28,
    );
    let spout = tube(
        &[
            dvec3(0.06, 0.13, 0.0),
            dvec3(0.095, 0.16, 0.0),
            dvec3(0.112, 0.185, 0.0),
            dvec3(0.128, 0.195, 0.0),
        ],
        0.014,
        12,
    );
    scene.add("kettle", "red_enamel", place(body.with(spout)));
    let base = cylinder(0.088, 0.018, 0.004, 36);
    let path = [
        dvec3(-0.05, 0.2, 0.0),
        dvec3(-0.11, 0.225, 0.0),
        dvec3(-0.125, 0.14, 0.0),
        dvec3(-0.085, 0.06, 0.0),
    ];
    let handle = tube(&rounded_path(&path, 0.03, 4), 0.011, 8);
    let knob = cylinder(0.013, 0.018, 0.004, 16).at(0.0, 0.218, 0.0);
    scene.add("kettle", "black_plastic", place(Mesh::join([base, handle, knob])));
}

fn toaster(scene: &mut Scene) {
    let place = |mesh: Mesh| mesh.turned(Axis::Y, 72.0).at(-2.1, WORKTOP + CLEARANCE, -0.18);
    scene.add(
        "toaster",
        "chrome",
        place(rounded_cuboid([-0.15, 0.012, -0.085], [0.15, 0.19, 0.085], 0.035, 3)),
    );
    let slots = [-0.035, 0.035]
        .map(|z| rounded_cuboid([-0.11, 0.18, z - 0.014], [0.11, 0.1915, z + 0.014], 0.001, 1));
    let feet = [-0.11, 0.11].map(|x| cuboid([x - 0.02, 0.0, -0.06], [x + 0.02, 0.02, 0.06]));
    let lever = rounded_cuboid([0.14, 0.11, -0.02], [0.172, 0.125, 0.02], 0.004, 1);
    scene.add("toaster", "black_plastic", place(Mesh::join(slots.into_iter().chain(feet).chain([lever]))));
    let slice = |z: f64| rounded_cuboid([-0.07, 0.16, z - 0.007], [0.07, 0.225, z + 0.007], 0.006, 1);
    scene.add("toast", "bread", place(slice(-0.035).with(slice(0.035))).textured(0.2, Axis::X));
}
