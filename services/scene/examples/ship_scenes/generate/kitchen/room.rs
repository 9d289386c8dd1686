//! Walls, window, garden, and the objects on the walls.

use glam::dvec3;

use crate::generate::bundle::Scene;
use crate::generate::mesh::{Axis, Mesh, sine_cosine};
use crate::generate::shapes::*;

/// Adds the room, the garden and the objects on the walls.
pub fn furnish(scene: &mut Scene) {
    shell(scene);
    window(scene);
    lamp(scene);
    on_the_walls(scene);
}

/// Floor, ceiling and walls: x from -2.4 to 2.4, z from -1.8 to 3.4, y from 0 to 2.6. They overlap by 5 cm,
/// so that light enters only through the window.
fn shell(scene: &mut Scene) {
    let (width, depth, height) = (4.9, 5.3, 2.7);
    let floor = quad(dvec3(-2.45, 0.0, 3.45), dvec3(width, 0.0, 0.0), dvec3(0.0, 0.0, -depth));
    scene.add("floor", "floor_tiles", floor.textured(1.4, Axis::X));
    let ceiling = quad(dvec3(-2.45, 2.6, -1.85), dvec3(width, 0.0, 0.0), dvec3(0.0, 0.0, depth));
    scene.add("ceiling", "ceiling_paint", ceiling);
    let back = frame([-2.45, -0.05], [2.45, 2.65], [-0.45, 1.1], [0.85, 2.1], 0.2).at(0.0, 0.0, -1.8);
    scene.add("wall_back", "wall_paint", back);
    let left = quad(dvec3(-2.4, -0.05, 3.45), dvec3(0.0, 0.0, -depth), dvec3(0.0, height, 0.0));
    scene.add("wall_left", "wall_paint", left);
    let right = quad(dvec3(2.4, -0.05, -1.85), dvec3(0.0, 0.0, depth), dvec3(0.0, height, 0.0));
    scene.add("wall_right", "wall_paint", right);
    let front = quad(dvec3(2.45, -0.05, 3.4), dvec3(-width, 0.0, 0.0), dvec3(0.0, height, 0.0));
    scene.add("wall_front", "wall_paint", front);
    let skirting = rounded_cuboid([2.385, -0.01, -1.0], [2.42, 0.09, 3.42], 0.004, 1);
    scene.add("skirting", "white_paint", skirting);
    // Tiles above the worktops. Their backs are inside the wall.
    let (back_face, front_face, low) = (-1.805, -1.791, 0.88);
    let splash = [
        cuboid([-2.41, low, back_face], [-0.531, 1.507, front_face]),
        cuboid([-0.53, low, back_face], [0.93, 1.06, front_face]),
        cuboid([0.931, low, back_face], [1.64, 1.507, front_face]),
    ];
    scene.add("tiles_back", "wall_tiles", Mesh::join(splash).textured(0.62, Axis::X));
    let splash = cuboid([-2.405, low, -1.79], [-2.391, 1.35, 0.57]);
    scene.add("tiles_left", "wall_tiles", splash.textured(0.62, Axis::Z));
}

fn window(scene: &mut Scene) {
    let bar = |low: [f64; 2], high: [f64; 2]| {
        rounded_cuboid([low[0], low[1], -1.925], [high[0], high[1], -1.885], 0.004, 1)
    };
    let casing = frame([-0.46, 1.09], [0.86, 2.11], [-0.39, 1.16], [0.79, 2.04], 0.06).at(0.0, 0.0, -1.875);
    let bars = [
        bar([0.165, 1.15], [0.235, 2.05]),
        bar([-0.4, 1.66], [0.17, 1.685]),
        bar([0.23, 1.66], [0.8, 1.685]),
    ];
    scene.add("window_frame", "white_paint", casing.with(Mesh::join(bars)));
    for (name, x) in [("window_pane_left", -0.4), ("window_pane_right", 0.225)] {
        let pane = quad(dvec3(x, 1.15, -1.905), dvec3(0.575, 0.0, 0.0), dvec3(0.0, 0.9, 0.0));
        scene.add(name, "window_glass", pane);
    }
    let sill = rounded_cuboid([-0.5, 1.072, -1.88], [0.9, 1.104, -1.73], 0.006, 1);
    scene.add("window_sill", "white_paint", sill);
    let catch = tube(
        &rounded_path(&[dvec3(0.2, 1.5, -1.89), dvec3(0.2, 1.5, -1.85), dvec3(0.2, 1.4, -1.85)], 0.02, 4),
        0.008,
        10,
    );
    scene.add("window_catch", "brass", catch);
    // A blind, gathered at the top of the window.
    let blind = surface(8, 32, |u, v| {
        let (wave, _) = sine_cosine(v * 4.0 * 360.0);
        let (sway, _) = sine_cosine(u * 500.0 + v * 900.0);
        dvec3(-0.44 + 1.28 * u, 1.86 + 0.235 * v, -1.83 + 0.016 * wave + 0.002 * sway)
    });
    scene.add("blind", "blind", blind);
    // The garden.
    let hedge = surface(28, 8, |u, v| {
        let (bulge, _) = sine_cosine(u * 2500.0 + 70.0 * v);
        let (billow, _) = sine_cosine(u * 1230.0 + 400.0 * v);
        dvec3(-6.0 + 12.0 * u, -0.7 + 2.35 * v + 0.08 * billow * v, -5.0 + 0.12 * bulge - 0.5 * v * v)
    });
    scene.add("hedge", "hedge", hedge.textured(1.5, Axis::X));
    let lawn = quad(dvec3(-6.0, -0.6, -2.1), dvec3(12.0, 0.0, 0.0), dvec3(0.0, 0.0, -4.0));
    scene.add("lawn", "lawn", lawn);
}

/// The housing of the ceiling light.
fn lamp(scene: &mut Scene) {
    let housing = slab_with_hole([-0.59, 2.495, 0.11], [0.79, 2.62, 0.99], [-0.555, 0.145], [0.755, 0.955]);
    scene.add("ceiling_lamp", "brushed_steel", housing);
}

fn on_the_walls(scene: &mut Scene) {
    // The clock, between hood and window.
    let (x, y, z) = (-0.68, 1.98, -1.795);
    let case = turned_body(
        &[
            (0.0, -0.01),
            (0.15, -0.01),
            (0.158, 0.0),
            (0.158, 0.028),
            (0.15, 0.034),
            (0.14, 0.028),
            (0.138, 0.012),
            (0.0, 0.012),
        ],
        40,
    );
    scene.add("clock", "copper", case.turned(Axis::X, 90.0).at(x, y, z));
    scene.add("clock", "clock_face", disc(0.136, 48).at(x, y, z + 0.014));
    let hand = |length: f64, width: f64, height: f64, degrees: f64| {
        cuboid([-width, -0.02, height], [width, length, height + 0.002]).turned(Axis::Z, -degrees)
    };
    let hands = hand(0.068, 0.005, 0.017, 305.0).with(hand(0.1, 0.0035, 0.021, 48.0));
    scene.add("clock", "black_plastic", hands.at(x, y, z));

    // The painting, on the left wall.
    let border = frame([-0.33, -0.255], [0.33, 0.255], [-0.285, -0.21], [0.285, 0.21], 0.035);
    let canvas = quad(dvec3(-0.29, -0.215, -0.012), dvec3(0.58, 0.0, 0.0), dvec3(0.0, 0.43, 0.0));
    let hang = |mesh: Mesh| mesh.turned(Axis::Y, 90.0).at(-2.37, 2.02, -0.62);
    scene.add("painting", "walnut", hang(border).textured(0.5, Axis::X));
    scene.add("painting", "painting", hang(canvas));

    // A socket above the left worktop.
    let plate = rounded_cuboid([-2.41, 1.1, -0.28], [-2.382, 1.18, -0.12], 0.005, 1);
    scene.add("socket", "white_paint", plate);
}
