//! The table and its cloth, the chairs, the objects on the table, and the rolling apple.

use glam::{DVec3, dvec2, dvec3};

use super::dishes::{bottle, bowl, cup, plate, tumbler};
use super::{CLEARANCE, FRAMES};
use crate::generate::bundle::{Key, Scene, Track, rounded};
use crate::generate::mesh::{Axis, Mesh, sine_cosine};
use crate::generate::shapes::*;

/// Centre of the table, x and z.
const MIDDLE: (f64, f64) = (0.78, 0.62);

/// Half the table's length (along x) and half its width.
const HALF: (f64, f64) = (0.66, 0.42);

/// Height of the cloth's upper side, metres.
const CLOTH: f64 = 0.752;

/// Radius of an apple, metres.
const APPLE: f64 = 0.038;

/// Adds the table, the chairs and the objects on the table.
pub fn furnish(scene: &mut Scene) {
    let (x, z) = MIDDLE;
    let top = rounded_cuboid([-HALF.0, 0.715, -HALF.1], [HALF.0, 0.748, HALF.1], 0.004, 2);
    let legs = [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)].map(|(sx, sz)| {
        let (cx, cz) = (sx * (HALF.0 - 0.07), sz * (HALF.1 - 0.07));
        cuboid([cx - 0.03, 0.0015, cz - 0.03], [cx + 0.03, 0.72, cz + 0.03])
    });
    let table = Mesh::join(legs).with(top).at(x, 0.0, z);
    scene.add("table", "oak", table.textured(0.8, Axis::X));
    scene.add("tablecloth", "gingham", cloth().at(x, 0.0, z));
    let chairs = [("left", -0.16, 0.66, -84.0), ("back", 0.72, -0.12, 176.0), ("right", 1.75, 0.55, 80.0)];
    for (name, x, z, turn) in chairs {
        let place = |mesh: Mesh| mesh.turned(Axis::Y, turn).at(x, 0.0015, z);
        scene.add(format!("chair_{name}"), "walnut", place(chair().textured(0.6, Axis::Y)));
        let cushion = rounded_cuboid([-0.19, 0.461, -0.18], [0.19, 0.5, 0.19], 0.019, 2);
        scene.add(format!("chair_{name}"), "cushion", place(cushion));
    }
    on_the_table(scene);
    rolling_apple(scene);
}

/// The cloth: flat on the table and bent over its edges. Its folds grow downwards.
fn cloth() -> Mesh {
    let hang = 0.2;
    let bend = 0.018;
    // The flat part takes 40 % of the grid lines, the overhang the rest, so the bend is smooth.
    let along = |t: f64, half: f64| {
        let side = if t < 0.5 { -1.0 } else { 1.0 };
        let from_middle = (t - 0.5).abs() * 2.0;
        let reach = if from_middle < 0.4 {
            from_middle / 0.4 * half
        } else {
            half + ((from_middle - 0.4) / 0.6).powi(2) * hang
        };
        side * reach
    };
    let mut cloth = surface(40, 34, |u, v| {
        // The surface faces up if u runs along x and v runs against z.
        let (s, t) = (along(u, HALF.0 + 0.002), along(1.0 - v, HALF.1 + 0.002));
        let (over_x, over_z) = ((s.abs() - HALF.0 - 0.002).max(0.0), (t.abs() - HALF.1 - 0.002).max(0.0));
        let over = libm::sqrt(over_x * over_x + over_z * over_z);
        let flat = dvec3(s - over_x * s.signum(), CLOTH, t - over_z * t.signum());
        if over == 0.0 {
            return flat;
        }
        let outwards = dvec3(over_x * s.signum(), 0.0, over_z * t.signum()) / over;
        let quarter = bend * core::f64::consts::FRAC_PI_2;
        let (out, down) = if over < quarter {
            let (sin, cos) = sine_cosine(90.0 * over / quarter);
            (bend * sin, bend * (1.0 - cos))
        } else {
            (bend, bend + over - quarter)
        };
        let (fold_x, _) = sine_cosine(s * 1700.0);
        let (fold_z, _) = sine_cosine(t * 1900.0 + 60.0);
        let fold = 0.1 * down * (1.0 + 0.5 * (fold_x + fold_z)) + 0.6 * down * (over_x.min(over_z) / hang);
        flat + outwards * (out + fold) - DVec3::Y * down
    });
    // The checks have the same size all over the cloth: four per 24 cm.
    for vertex in &mut cloth.vertices {
        let (u, v) = (vertex.uv.x, vertex.uv.y);
        vertex.uv = dvec2(along(u, HALF.0), along(v, HALF.1)) / 0.24;
    }
    cloth
}

/// A chair that stands on y = 0 and faces -z. Its backrest is at +z.
fn chair() -> Mesh {
    let seat = rounded_cuboid([-0.21, 0.43, -0.2], [0.21, 0.46, 0.21], 0.01, 2);
    let leg = |x: f64, z: f64| {
        tube(&[dvec3(x * 1.12, 0.0, z * 1.12), dvec3(x * 1.06, 0.22, z * 1.06), dvec3(x, 0.44, z)], 0.016, 8)
    };
    let post = |x: f64| {
        tube(
            &[dvec3(x, 0.44, 0.18), dvec3(x, 0.62, 0.195), dvec3(x, 0.78, 0.22), dvec3(x, 0.92, 0.255)],
            0.015,
            8,
        )
    };
    let slat = |y: f64, z: f64| {
        cuboid([-0.18, -0.03, -0.007], [0.18, 0.03, 0.007]).turned(Axis::X, 10.0).at(0.0, y, z)
    };
    let legs = [leg(-0.17, -0.16), leg(0.17, -0.16), leg(-0.17, 0.17), leg(0.17, 0.17)];
    let back = [post(-0.175), post(0.175), slat(0.88, 0.244), slat(0.77, 0.219), slat(0.66, 0.202)];
    Mesh::join(legs.into_iter().chain(back)).with(seat)
}

/// An apple about the origin, with its stalk along +y: flesh and stalk.
fn apple() -> (Mesh, Mesh) {
    let rings = 14;
    let profile: Vec<(f64, f64)> = (0..=rings)
        .map(|i| {
            let (sin, cos) = sine_cosine(180.0 * f64::from(i) / f64::from(rings));
            let radius = if i == 0 || i == rings { 0.0 } else { sin * (1.0 - 0.1 * cos) / 1.005 };
            // The dimple at the stalk is deeper than the one at the bottom.
            let dimple = |depth: f64, width: f64| depth / (1.0 + (radius / width) * (radius / width));
            let height = -0.92 * cos - if cos < 0.0 { dimple(0.34, 0.26) } else { -dimple(0.2, 0.2) };
            (radius * APPLE, height * APPLE)
        })
        .collect();
    let stalk = [dvec3(0.0, 0.5, 0.0), dvec3(0.02, 0.8, 0.0), dvec3(0.1, 1.1, 0.03)].map(|p| p * APPLE);
    (turned_body(&profile, 20), tube(&stalk, 0.0018, 5))
}

fn on_the_table(scene: &mut Scene) {
    let top = CLOTH + CLEARANCE;
    // A bowl of fruit.
    let (x, z) = (1.0, 0.42);
    scene.add("fruit_bowl", "blue_porcelain", bowl(0.15, 0.085).at(x, top, z));
    let fruit = |name: &str, scene: &mut Scene, skin: &'static str, turn: f64, lean: f64, place: [f64; 3]| {
        let (flesh, stalk) = apple();
        let put = |mesh: Mesh| {
            mesh.turned(Axis::Z, lean).turned(Axis::Y, turn).at(x + place[0], top + place[1], z + place[2])
        };
        scene.add_parts(name, vec![(skin, put(flesh)), ("stalk", put(stalk))]);
    };
    fruit("apple_1", scene, "apple_skin", 20.0, 25.0, [-0.065, 0.062, 0.035]);
    fruit("apple_2", scene, "green_apple", 140.0, 35.0, [0.035, 0.062, 0.065]);
    fruit("apple_3", scene, "apple_skin", 250.0, 20.0, [0.01, 0.118, 0.0]);
    scene.add("orange_1", "orange_peel", sphere(0.04, 20).at(x + 0.068, top + 0.064, z - 0.03));
    scene.add("orange_2", "orange_peel", sphere(0.039, 20).at(x - 0.035, top + 0.062, z - 0.065));
    let lemon = sphere(0.029, 20).stretched(1.35, 1.0, 1.0).turned(Axis::Z, 20.0).turned(Axis::Y, 35.0);
    scene.add("lemon", "lemon_peel", lemon.at(x - 0.045, top + 0.112, z + 0.055));

    // Breakfast: a plate with toast, a mug of coffee, a glass of juice.
    scene.add("breakfast_plate", "white_porcelain", plate(0.125).at(0.52, top, 0.82));
    let toast = rounded_cuboid([-0.055, 0.0, -0.055], [0.055, 0.014, 0.055], 0.006, 2);
    scene.add(
        "breakfast_plate",
        "bread",
        toast.turned(Axis::Y, 25.0).at(0.52, top + 0.0065, 0.82).textured(0.2, Axis::X),
    );
    let knife = rounded_cuboid([-0.009, 0.0, -0.11], [0.009, 0.003, 0.1], 0.0012, 1).turned(Axis::Y, -6.0);
    scene.add("table_knife", "polished_steel", knife.at(0.69, top, 0.83));
    scene.add("breakfast_mug", "red_enamel", cup(0.042, 0.095).turned(Axis::Y, -30.0).at(0.5, top, 0.53));
    let coffee = turned_body(&[(0.0, 0.07), (0.0385, 0.07), (0.0385, 0.078), (0.0, 0.078)], 28);
    scene.add("breakfast_mug", "coffee", coffee.at(0.5, top, 0.53));
    scene.add("juice_glass", "clear_glass", tumbler(0.036, 0.125).at(0.78, top, 0.92));
    let juice = turned_body(
        &[(0.0, 0.0095), (0.0255, 0.0095), (0.0268, 0.0125), (0.0297, 0.05), (0.0318, 0.085), (0.0, 0.085)],
        28,
    );
    scene.add("juice_glass", "orange_juice", juice.at(0.78, top, 0.92));
    scene.add("water_bottle", "clear_glass", bottle(0.042, 0.3).at(1.24, top, 0.6));
    scene.add("water_glass", "clear_glass", tumbler(0.034, 0.11).at(1.33, top, 0.74));
    // An open book.
    let page = |side: f64| {
        surface(12, 2, move |u, v| {
            let across = if side < 0.0 { 1.0 - u } else { u };
            let (rise, _) = sine_cosine(150.0 * across);
            dvec3(side * 0.15 * across, 0.006 + 0.012 * rise, 0.1 - 0.2 * v)
        })
    };
    let covers = rounded_cuboid([-0.156, 0.0, -0.105], [0.156, 0.004, 0.105], 0.0015, 1);
    let put = |mesh: Mesh| mesh.turned(Axis::Y, 14.0).at(1.1, top, 0.92);
    scene.add_parts(
        "open_book",
        vec![("book_green", put(covers)), ("paper", put(page(-1.0).with(page(1.0))))],
    );
}

/// The apple on its side about the origin, stalk towards the camera. Its track rolls it over the cloth
/// towards -x, without slipping.
fn rolling_apple(scene: &mut Scene) {
    let (flesh, stalk) = apple();
    let lay = |mesh: Mesh| mesh.turned(Axis::X, 90.0);
    let widest = flesh.vertices.iter().map(|v| libm::hypot(v.position.x, v.position.z)).fold(0.0, f64::max);
    scene.add_parts("rolling_apple", vec![("apple_skin", lay(flesh)), ("stalk", lay(stalk))]);
    let start = dvec3(0.9, CLOTH + CLEARANCE + widest, 0.66);
    let last = FRAMES - 1;
    let (mut places, mut turns) = (Vec::new(), Vec::new());
    for frame in (0..last).step_by(2).chain([last]) {
        let left = 1.0 - f64::from(frame) / f64::from(last);
        let way = 0.27 * (1.0 - left * left);
        let (sin, cos) = sine_cosine((way / widest).to_degrees() / 2.0);
        places.push(Key { frame, value: rounded(start - dvec3(way, 0.0, 0.0)).to_vec() });
        turns.push(Key { frame, value: vec![0.0, 0.0, six_places(sin), six_places(cos)] });
    }
    let track = |property, keys| Track {
        target: "object:rolling_apple".into(),
        property,
        interpolation: "linear",
        keys,
    };
    scene.animation.tracks.push(track("translation", places));
    scene.animation.tracks.push(track("rotation", turns));
}

fn six_places(x: f64) -> f64 {
    (x * 1e6).round() / 1e6
}
