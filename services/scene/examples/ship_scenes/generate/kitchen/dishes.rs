//! Crockery, glasses, bottles, jars, books and plants: everything that stands on worktops and shelves.

use glam::{DVec3, dvec3};

use super::{CLEARANCE, WORKTOP};
use crate::generate::bundle::Scene;
use crate::generate::mesh::{Axis, Mesh, sine_cosine};
use crate::generate::shapes::*;

/// Adds everything that stands on a worktop, a shelf or the window sill.
pub fn furnish(scene: &mut Scene) {
    shelf(scene);
    left_worktop(scene);
    beside_the_hob(scene);
    right_worktop(scene);
    glass_cupboard(scene);
    sill(scene);
}

/// A plate of the given radius on y = 0.
pub fn plate(radius: f64) -> Mesh {
    turned_body(
        &[
            (0.0, 0.0),
            (radius * 0.55, 0.0),
            (radius * 0.62, 0.003),
            (radius * 0.97, 0.017),
            (radius, 0.02),
            (radius * 0.98, 0.0215),
            (radius * 0.64, 0.0085),
            (radius * 0.58, 0.006),
            (0.0, 0.005),
        ],
        24,
    )
}

/// A bowl on y = 0, with the given radius and depth.
pub fn bowl(radius: f64, depth: f64) -> Mesh {
    let outside = |t: f64| {
        let (sin, cos) = sine_cosine(t * 90.0);
        (radius * (0.42 + 0.58 * sin), depth * (0.04 + 0.96 * (1.0 - cos)))
    };
    let wall = 0.0045;
    let mut profile = vec![(0.0, 0.0), (radius * 0.4, 0.0)];
    profile.extend((0..=4).map(|i| outside(f64::from(i) / 4.0)));
    let (rim_radius, rim_height) = outside(1.0);
    profile.push((rim_radius - wall * 0.5, rim_height + 0.0015));
    profile.extend((0..=4).rev().map(|i| {
        let (r, y) = outside(f64::from(i) / 4.0);
        (r - wall, y.max(0.004) + if i < 4 { wall * 0.6 } else { 0.0 })
    }));
    profile.push((0.0, 0.0065));
    turned_body(&profile, 24)
}

/// A cup of the given radius and height on y = 0, with its handle on the +x side.
pub fn cup(radius: f64, height: f64) -> Mesh {
    let body = turned_body(
        &[
            (0.0, 0.0),
            (radius * 0.78, 0.0),
            (radius * 0.9, 0.006),
            (radius, 0.024),
            (radius, height - 0.001),
            (radius - 0.0015, height),
            (radius - 0.004, height - 0.002),
            (radius - 0.004, 0.026),
            (radius * 0.85, 0.008),
            (0.0, 0.006),
        ],
        20,
    );
    let r = radius - 0.002;
    let path = [
        dvec3(r, height * 0.8, 0.0),
        dvec3(r + radius * 0.75, height * 0.8, 0.0),
        dvec3(r + radius * 0.65, height * 0.25, 0.0),
        dvec3(r, height * 0.25, 0.0),
    ];
    body.with(tube(&rounded_path(&path, radius * 0.4, 4), 0.0045, 6))
}

/// A solid glass tumbler on y = 0: outer wall, rim, inner wall, thick bottom.
pub fn tumbler(radius: f64, height: f64) -> Mesh {
    let wall = 0.0025;
    turned_body(
        &[
            (0.0, 0.0),
            (radius * 0.82, 0.0),
            (radius * 0.86, 0.002),
            (radius * 0.93, height * 0.4),
            (radius, height - 0.001),
            (radius - wall * 0.5, height),
            (radius - wall, height - 0.001),
            (radius * 0.93 - wall, height * 0.4),
            (radius * 0.86 - wall, 0.011),
            (radius * 0.8 - wall, 0.008),
            (0.0, 0.008),
        ],
        20,
    )
}

/// A solid glass jar on y = 0.
pub fn jar(radius: f64, height: f64) -> Mesh {
    let wall = 0.003;
    turned_body(
        &[
            (0.0, 0.0),
            (radius - 0.006, 0.0),
            (radius - 0.001, 0.002),
            (radius, 0.007),
            (radius, height - 0.025),
            (radius * 0.95, height - 0.014),
            (radius * 0.86, height - 0.008),
            (radius * 0.86, height - 0.001),
            (radius * 0.86 - wall, height),
            (radius * 0.86 - wall, height - 0.01),
            (radius * 0.95 - wall, height - 0.017),
            (radius - wall, height - 0.027),
            (radius - wall, 0.01),
            (radius - wall - 0.002, 0.007),
            (radius - wall - 0.006, 0.005),
            (0.0, 0.005),
        ],
        20,
    )
}

/// The contents of a jar up to `level`. The body keeps a gap of a millimetre to the glass.
fn filling(radius: f64, level: f64) -> Mesh {
    let inner = radius - 0.0042;
    turned_body(
        &[
            (0.0, 0.0062),
            (inner - 0.007, 0.0062),
            (inner - 0.001, 0.0105),
            (inner, 0.013),
            (inner, level - 0.006),
            (inner - 0.006, level),
            (0.0, level + 0.004),
        ],
        18,
    )
}

/// A solid glass bottle on y = 0.
pub fn bottle(radius: f64, height: f64) -> Mesh {
    let neck = radius * 0.36;
    let wall = 0.0028;
    let shoulder = height * 0.62;
    let outer = [
        (radius - 0.005, 0.0),
        (radius, 0.005),
        (radius, shoulder),
        (radius * 0.9, shoulder + 0.02),
        (neck * 1.25, height * 0.78),
        (neck, height * 0.83),
        (neck, height - 0.014),
        (neck + 0.003, height - 0.012),
        (neck + 0.003, height - 0.002),
        (neck, height),
    ];
    let inner = [
        (neck - wall, height - 0.002),
        (neck - wall, height * 0.83),
        (neck * 1.25 - wall, height * 0.78),
        (radius * 0.9 - wall, shoulder + 0.018),
        (radius - wall, shoulder - 0.002),
        (radius - wall, 0.009),
        (radius - wall - 0.005, 0.005),
    ];
    let mut profile = vec![(0.0, 0.0)];
    profile.extend(outer);
    profile.extend(inner);
    profile.push((0.0, 0.005));
    turned_body(&profile, 20)
}

/// A book that stands on y = 0 with its spine towards +z: cover and pages.
fn book(thickness: f64, height: f64, depth: f64) -> (Mesh, Mesh) {
    let half = thickness / 2.0;
    let board = 0.0025;
    let cover = Mesh::join([
        cuboid([-half, 0.0012, -depth], [-half + board, height - 0.0012, -0.0012]),
        cuboid([half - board, 0.0012, -depth], [half, height - 0.0012, -0.0012]),
        cuboid([-half - 0.0012, 0.0, -0.006], [half + 0.0012, height, 0.0]),
    ]);
    let pages = cuboid(
        [-half + board - 0.0012, 0.004, -depth + 0.005],
        [half - board + 0.0012, height - 0.004, -0.004],
    );
    (cover, pages)
}

/// A row of books along x on y = 0, as one object. Each book is (thickness, height, cover material).
fn row_of_books(scene: &mut Scene, books: &[(f64, f64, &'static str)], place: impl Fn(Mesh) -> Mesh) {
    let mut x = 0.0;
    let mut parts = Vec::new();
    let mut papers = Vec::new();
    for &(thickness, height, cover) in books {
        let (boards, pages) = book(thickness, height, 0.16);
        let shift = |mesh: Mesh| place(mesh.at(x + thickness / 2.0, 0.0, 0.0));
        parts.push((cover, shift(boards)));
        papers.push(shift(pages));
        x += thickness + 0.004;
    }
    parts.push(("paper", Mesh::join(papers)));
    scene.add_parts("books", parts);
}

/// A pot plant on y = 0: leaves on arching stalks.
fn plant(leaves: usize, reach: f64, height: f64) -> Mesh {
    let leaf = |i: usize| {
        let turn = 137.508 * i as f64;
        let rank = (i as f64 + 0.5) / leaves as f64;
        let (tip_out, tip_up) = (reach * (1.0 - 0.75 * rank), height * (0.55 + 0.45 * rank));
        surface(2, 4, move |u, v| {
            let (bulge, _) = sine_cosine(180.0 * (0.06 + 0.9 * v));
            let width = reach * 0.28 * bulge * (u - 0.5);
            let lift = tip_up * (2.0 * v - v * v) - 0.25 * height * v * v * (1.0 - rank);
            dvec3(0.006 + tip_out * v, lift + 0.5 * width.abs(), width)
        })
        .turned(Axis::Y, turn)
    };
    Mesh::join((0..leaves).map(leaf))
}

/// A flower pot on y = 0: pot and soil.
fn flower_pot(radius: f64, height: f64) -> (Mesh, Mesh) {
    let pot = turned_body(
        &[
            (0.0, 0.0),
            (radius * 0.7, 0.0),
            (radius * 0.92, height * 0.75),
            (radius, height * 0.76),
            (radius, height),
            (radius - 0.006, height),
            (radius * 0.86, height * 0.7),
            (0.0, height * 0.7),
        ],
        28,
    );
    let soil = turned_body(&[(0.0, height * 0.72), (radius * 0.9, height * 0.84), (0.0, height * 0.88)], 20);
    (pot, soil)
}

fn shelf(scene: &mut Scene) {
    let top = 1.548 + CLEARANCE;
    let jars: [(&str, f64, f64, f64, &'static str); 4] = [
        ("pasta", -1.12, 0.052, 0.2, "pasta"),
        ("beans", -0.99, 0.048, 0.15, "beans"),
        ("flour", -0.87, 0.05, 0.17, "flour"),
        ("coffee", -0.75, 0.045, 0.13, "coffee"),
    ];
    for (name, z, radius, height, contents) in jars {
        store(scene, name, contents, (radius, height), dvec3(-2.285, top, z));
    }
    let books = [
        (0.034, 0.23, "book_red"),
        (0.022, 0.21, "book_yellow"),
        (0.04, 0.25, "book_blue"),
        (0.028, 0.22, "book_green"),
        (0.02, 0.2, "white_porcelain"),
    ];
    row_of_books(scene, &books, |mesh| mesh.turned(Axis::Y, 90.0).at(-2.2, top, -0.4));
    let stack = |i: f64| bowl(0.08 - 0.003 * i, 0.05).at(-2.29, top + 0.017 * i, -0.2);
    scene.add_parts("shelf_bowls", vec![("stoneware", stack(0.0)), ("yellow_porcelain", stack(1.0))]);
    let (pot, soil) = flower_pot(0.065, 0.11);
    let place = |mesh: Mesh| mesh.at(-2.285, top, 0.0);
    scene.add_parts("shelf_pot", vec![("terracotta", place(pot)), ("soil", place(soil))]);
    scene.add("shelf_pot", "leaf", place(plant(26, 0.19, 0.2).at(0.0, 0.09, 0.0)));
}

/// A jar with contents and a wooden lid, as one object. `place` is where it stands.
fn store(scene: &mut Scene, name: &str, contents: &'static str, (radius, height): (f64, f64), place: DVec3) {
    let put = |mesh: Mesh| mesh.at(place.x, place.y, place.z);
    scene.add(format!("jar_{name}"), "clear_glass", put(jar(radius, height)));
    scene.add(format!("jar_{name}"), contents, put(filling(radius, height * 0.68)));
    let lid = cylinder(radius * 0.95, 0.022, 0.004, 28).at(0.0, height + CLEARANCE, 0.0);
    scene.add(format!("jar_{name}"), "walnut", put(lid).textured(0.3, Axis::X));
}

fn left_worktop(scene: &mut Scene) {
    let top = WORKTOP + CLEARANCE;
    let board = rounded_cuboid([-0.13, 0.0, -0.2], [0.13, 0.022, 0.2], 0.006, 1)
        .turned(Axis::Y, 12.0)
        .at(-1.98, top, 0.3);
    scene.add("bread_board", "walnut", board.textured(0.5, Axis::Z));
    let loaf = surface_of_loaf().turned(Axis::Y, 8.0).at(-2.0, top + 0.023, 0.28);
    scene.add("loaf", "bread", loaf.textured(0.2, Axis::Z));
    let blade = rounded_cuboid([-0.016, 0.0, -0.2], [0.016, 0.002, 0.0], 0.001, 1);
    let grip = rounded_cuboid([-0.012, -0.004, 0.0], [0.012, 0.014, 0.11], 0.005, 1);
    let place = |mesh: Mesh| mesh.turned(Axis::Y, 20.0).at(-1.9, top + 0.028, 0.35);
    scene.add_parts("bread_knife", vec![("polished_steel", place(blade)), ("black_plastic", place(grip))]);
    // In the corner: a board that leans against the tiles, and two jars in front of it.
    let tray = rounded_cuboid([-0.17, 0.0, -0.008], [0.17, 0.42, 0.008], 0.006, 1);
    scene.add(
        "chopping_board",
        "walnut",
        tray.turned(Axis::X, -12.0).at(-1.98, top + 0.002, -1.68).textured(0.6, Axis::Y),
    );
    store(scene, "spaghetti", "pasta", (0.05, 0.28), dvec3(-2.2, top, -1.45));
    store(scene, "lentils", "orange_peel", (0.055, 0.18), dvec3(-2.05, top, -1.38));
}

/// A loaf of bread on y = 0, with a rounded top.
fn surface_of_loaf() -> Mesh {
    sphere(1.0, 20).stretched(0.068, 0.062, 0.145).at(0.0, 0.05, 0.0)
}

fn beside_the_hob(scene: &mut Scene) {
    let top = WORKTOP + CLEARANCE;
    // A crock with wooden spoons.
    let crock = turned_body(
        &[
            (0.0, 0.0),
            (0.052, 0.0),
            (0.06, 0.008),
            (0.062, 0.15),
            (0.059, 0.153),
            (0.055, 0.15),
            (0.053, 0.01),
            (0.0, 0.008),
        ],
        24,
    );
    let (x, z) = (-0.76, -1.62);
    scene.add("crock", "stoneware", crock.at(x, top, z));
    let tool = |lean: f64, turn: f64, head: f64| {
        let stick = tube(&[dvec3(0.0, 0.0, 0.0), dvec3(0.0, 0.15, 0.0), dvec3(0.0, 0.27, 0.0)], 0.006, 8);
        let blade = sphere(0.03, 10).stretched(head, 1.35, 0.3).at(0.0, 0.285, 0.0);
        stick.with(blade).turned(Axis::Z, lean).turned(Axis::Y, turn).at(x, top + 0.02, z)
    };
    scene.add(
        "wooden_spoons",
        "pale_wood",
        Mesh::join([tool(8.0, 20.0, 1.0), tool(11.0, 150.0, 0.7), tool(9.0, 260.0, 1.1)]),
    );
    scene.add("oil_bottle", "amber_glass", bottle(0.034, 0.27).at(-0.6, top, -1.66));
    scene.add("oil_bottle", "pale_wood", cylinder(0.0085, 0.03, 0.002, 16).at(-0.6, top + 0.252, -1.66));
    scene.add("vinegar_bottle", "green_glass", bottle(0.03, 0.23).at(-0.5, top, -1.62));
    scene.add("vinegar_bottle", "pale_wood", cylinder(0.0072, 0.03, 0.002, 16).at(-0.5, top + 0.212, -1.62));
    let mill = turned_body(
        &[
            (0.0, 0.0),
            (0.026, 0.0),
            (0.028, 0.01),
            (0.019, 0.06),
            (0.024, 0.1),
            (0.024, 0.108),
            (0.014, 0.114),
            (0.022, 0.13),
            (0.02, 0.146),
            (0.008, 0.154),
            (0.0, 0.156),
        ],
        20,
    );
    scene.add("pepper_mill", "walnut", mill.at(-0.66, top, -1.5).textured(0.3, Axis::Y));
    let cellar = turned_body(
        &[(0.0, 0.0), (0.024, 0.0), (0.027, 0.004), (0.02, 0.06), (0.013, 0.072), (0.0, 0.076)],
        20,
    );
    scene.add("salt_cellar", "white_porcelain", cellar.at(-0.585, top, -1.47));
}

fn right_worktop(scene: &mut Scene) {
    let top = WORKTOP + CLEARANCE;
    // A coffee press of glass and steel.
    let (x, z) = (1.45, -1.6);
    let beaker = turned_body(
        &[
            (0.0, 0.012),
            (0.045, 0.012),
            (0.048, 0.015),
            (0.048, 0.178),
            (0.0465, 0.18),
            (0.0455, 0.178),
            (0.0455, 0.018),
            (0.043, 0.0155),
            (0.0, 0.0155),
        ],
        24,
    );
    scene.add("coffee_press", "clear_glass", beaker.at(x, top, z));
    let drink = cylinder(0.0442, 0.075, 0.003, 28).at(0.0, 0.0168, 0.0);
    scene.add("coffee_press", "coffee", drink.at(x, top, z));
    let band = |y: f64| ring(0.0515, 0.0022, 24, 6).at(0.0, y, 0.0);
    let post = |turn: f64| {
        let path = [dvec3(0.0535, 0.0, 0.0), dvec3(0.0535, 0.09, 0.0), dvec3(0.0535, 0.165, 0.0)];
        tube(&path, 0.0028, 6).turned(Axis::Y, turn)
    };
    let cap = turned_body(
        &[
            (0.0, 0.184),
            (0.05, 0.184),
            (0.051, 0.19),
            (0.03, 0.2),
            (0.004, 0.203),
            (0.004, 0.225),
            (0.011, 0.23),
            (0.011, 0.238),
            (0.0, 0.242),
        ],
        20,
    );
    let foot = cylinder(0.052, 0.0095, 0.002, 24);
    let posts = [60.0, 180.0, 300.0].map(post);
    let metal = Mesh::join([band(0.05), band(0.16), cap, foot].into_iter().chain(posts));
    let path =
        [dvec3(0.05, 0.16, 0.0), dvec3(0.095, 0.16, 0.0), dvec3(0.095, 0.05, 0.0), dvec3(0.05, 0.05, 0.0)];
    let grip = tube(&rounded_path(&path, 0.02, 3), 0.007, 6);
    let face = |mesh: Mesh| mesh.turned(Axis::Y, -40.0).at(x, top, z);
    scene.add_parts("coffee_press", vec![("chrome", face(metal)), ("black_plastic", face(grip))]);
    // A knife block.
    let block = |mesh: Mesh| mesh.turned(Axis::X, -20.0).turned(Axis::Y, -25.0).at(1.2, top + 0.025, -1.62);
    let wood = rounded_cuboid([-0.05, -0.01, -0.06], [0.05, 0.19, 0.05], 0.006, 1);
    scene.add("knife_block", "oak", block(wood).textured(0.5, Axis::Y));
    let grip = |x: f64, z: f64| {
        rounded_cuboid([x - 0.009, 0.185, z - 0.012], [x + 0.009, 0.275, z + 0.012], 0.005, 1)
    };
    let grips =
        [grip(-0.028, -0.03), grip(0.0, -0.03), grip(0.028, -0.03), grip(-0.018, 0.015), grip(0.018, 0.015)];
    scene.add("knife_block", "black_plastic", block(Mesh::join(grips)));
    // Two mugs, and a stack of plates.
    scene.add("mug_blue", "blue_porcelain", cup(0.04, 0.092).turned(Axis::Y, 30.0).at(0.98, top, -1.42));
    scene.add("mug_yellow", "yellow_porcelain", cup(0.04, 0.092).turned(Axis::Y, -70.0).at(1.08, top, -1.34));
    let plates = (0..3).map(|i| plate(0.13).at(0.72, top + 0.0075 * f64::from(i), -1.53));
    scene.add("plates", "white_porcelain", Mesh::join(plates));
    scene.add("soap_bottle", "green_porcelain", soap_bottle().at(0.56, top, -1.7));
    let sponge = rounded_cuboid([-0.045, 0.0, -0.03], [0.045, 0.03, 0.03], 0.006, 1).turned(Axis::Y, 15.0);
    scene.add("sponge", "lemon_peel", sponge.at(-0.24, top, -1.62));
}

fn soap_bottle() -> Mesh {
    let body = turned_body(
        &[
            (0.0, 0.0),
            (0.027, 0.0),
            (0.03, 0.004),
            (0.03, 0.11),
            (0.022, 0.125),
            (0.01, 0.13),
            (0.01, 0.145),
            (0.005, 0.147),
            (0.005, 0.165),
            (0.0, 0.166),
        ],
        24,
    );
    let spout =
        tube(&[dvec3(0.0, 0.162, -0.006), dvec3(0.0, 0.164, 0.02), dvec3(0.0, 0.16, 0.036)], 0.005, 8);
    body.with(spout)
}

fn glass_cupboard(scene: &mut Scene) {
    let levels = [1.519 + CLEARANCE, 1.76 + CLEARANCE, 2.01 + CLEARANCE];
    let glasses = [1.08, 1.18, 1.4, 1.5].map(|x| tumbler(0.036, 0.12).at(x, levels[1], -1.6));
    scene.add("cupboard_glasses", "clear_glass", Mesh::join(glasses));
    let plates = (0..3).map(|i| plate(0.11).at(1.14, levels[0] + 0.0075 * f64::from(i), -1.62));
    scene.add("cupboard_plates", "blue_porcelain", Mesh::join(plates));
    let stack = |level: f64| bowl(0.075, 0.06).at(1.43, levels[0] + level, -1.6);
    let bowls = vec![("yellow_porcelain", stack(0.0)), ("white_porcelain", stack(0.018))];
    scene.add_parts("cupboard_bowls", bowls);
    scene.add("cupboard_teapot", "red_enamel", teapot().at(1.12, levels[2], -1.62));
    let cups = [(1.36, -60.0), (1.48, -40.0)]
        .map(|(x, turn)| cup(0.038, 0.08).turned(Axis::Y, turn).at(x, levels[2], -1.6));
    scene.add("cupboard_cups", "green_porcelain", Mesh::join(cups));
}

fn teapot() -> Mesh {
    let body = sphere(0.065, 20).stretched(1.0, 0.85, 1.0).at(0.0, 0.055, 0.0);
    let lid = turned_body(
        &[(0.0, 0.1), (0.04, 0.1), (0.034, 0.112), (0.006, 0.12), (0.011, 0.13), (0.0, 0.137)],
        20,
    );
    let foot = cylinder(0.04, 0.01, 0.002, 24);
    let spout = tube(&[dvec3(0.05, 0.04, 0.0), dvec3(0.085, 0.07, 0.0), dvec3(0.1, 0.105, 0.0)], 0.01, 10);
    let path = [
        dvec3(-0.05, 0.085, 0.0),
        dvec3(-0.11, 0.085, 0.0),
        dvec3(-0.1, 0.025, 0.0),
        dvec3(-0.05, 0.03, 0.0),
    ];
    Mesh::join([body, lid, foot, spout, tube(&rounded_path(&path, 0.025, 3), 0.007, 6)])
}

fn sill(scene: &mut Scene) {
    let top = 1.104 + CLEARANCE;
    for (i, (x, size)) in [(-0.3, 0.058), (0.66, 0.05)].into_iter().enumerate() {
        let (pot, soil) = flower_pot(size, size * 1.6);
        let place = |mesh: Mesh| mesh.at(x, top, -1.795);
        scene.add_parts(format!("herb_pot_{i}"), vec![("terracotta", place(pot)), ("soil", place(soil))]);
        let herb = plant(22, size * 1.7, size * 2.6).at(0.0, size * 1.3, 0.0);
        scene.add(format!("herb_pot_{i}"), "leaf", place(herb));
    }
    scene.add("sill_bottle", "green_glass", bottle(0.03, 0.2).at(0.44, top, -1.8));
}
