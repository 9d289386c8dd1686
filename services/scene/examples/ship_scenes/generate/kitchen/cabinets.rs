//! Cupboards, drawers, worktops, shelves and the sink.

use glam::dvec3;

use super::WORKTOP;
use crate::generate::bundle::Scene;
use crate::generate::mesh::{Axis, Mesh};
use crate::generate::shapes::*;

/// Z of the door fronts of the base cupboards along the back wall.
const BACK_FRONT: f64 = -1.197;

/// X of the door fronts of the base cupboards along the left wall.
const LEFT_FRONT: f64 = -1.797;

/// Adds cupboards, worktops, sink and shelves.
pub fn furnish(scene: &mut Scene) {
    base_cupboards(scene);
    worktops(scene);
    sink(scene);
    wall_cupboards(scene);
    shelves(scene);
}

/// A door with a raised border, from (0, 0) to (width, height). Its front is at z = 0, its back at z = -0.02.
fn door(width: f64, height: f64) -> Mesh {
    let border = 0.065;
    let rim = frame([0.0, 0.0], [width, height], [border, border], [width - border, height - border], 0.02);
    let panel = cuboid(
        [border - 0.004, border - 0.004, -0.016],
        [width - border + 0.004, height - border + 0.004, -0.008],
    );
    rim.with(panel)
}

/// A bar handle along x, on a front at z = 0.
fn bar_handle(length: f64) -> Mesh {
    let half = length / 2.0;
    let path = [
        dvec3(-half, 0.0, -0.004),
        dvec3(-half, 0.0, 0.032),
        dvec3(half, 0.0, 0.032),
        dvec3(half, 0.0, -0.004),
    ];
    tube(&rounded_path(&path, 0.014, 2), 0.0055, 6)
}

/// A round knob on a front at z = 0.
fn knob() -> Mesh {
    turned_body(
        &[
            (0.0, -0.003),
            (0.007, -0.003),
            (0.006, 0.012),
            (0.014, 0.018),
            (0.016, 0.024),
            (0.012, 0.029),
            (0.0, 0.031),
        ],
        12,
    )
    .turned(Axis::X, 90.0)
}

fn base_cupboards(scene: &mut Scene) {
    // The carcass has an opening for the sink, from top to bottom.
    let carcass = slab_with_hole([-2.39, 0.1, -1.79], [1.585, 0.865, -1.22], [-0.2, -1.74], [0.5, -1.24]);
    scene.add("carcass_back", "sage_paint", carcass);
    let carcass = cuboid([-2.39, 0.1, -1.215], [-1.82, 0.865, 0.555]);
    scene.add("carcass_left", "sage_paint", carcass);
    let plinth = cuboid([-2.385, -0.01, -1.785], [1.58, 0.105, -1.27])
        .with(cuboid([-2.385, -0.01, -1.265], [-1.87, 0.105, 0.55]));
    scene.add("plinth", "plinth", plinth);

    let (low, high) = (0.12, 0.85);
    let doors = [
        ("corner", -1.78, 0.26, true),
        ("sink_left", -0.26, 0.44, true),
        ("sink_right", 0.19, 0.44, false),
        ("right_1", 0.645, 0.46, true),
        ("right_2", 1.115, 0.46, false),
    ];
    let mut handles = Vec::new();
    for (name, x, width, handle_right) in doors {
        scene.add(format!("door_{name}"), "sage_paint", door(width, high - low).at(x, low, BACK_FRONT));
        let handle_x = if handle_right { x + width - 0.033 } else { x + 0.033 };
        let handle = bar_handle(0.14).turned(Axis::Z, 90.0).at(handle_x, high - 0.13, BACK_FRONT);
        handles.push(handle);
    }
    scene.add("handles_back", "brass", Mesh::join(handles));
    let drawers = [(0.12, 0.28), (0.41, 0.24), (0.66, 0.19)];
    let mut handles = Vec::new();
    for (i, (y, height)) in drawers.into_iter().enumerate() {
        scene.add(format!("drawer_{i}"), "sage_paint", door(0.6, height).at(-0.88, y, BACK_FRONT));
        // The handle sits on the recessed panel.
        handles.push(bar_handle(0.2).at(-0.58, y + height / 2.0, BACK_FRONT - 0.008));
    }
    scene.add("handles_drawers", "brass", Mesh::join(handles));
    let mut handles = Vec::new();
    for (i, z) in [-1.12, -0.56, 0.0].into_iter().enumerate() {
        let front = door(0.55, high - low).turned(Axis::Y, 90.0).at(LEFT_FRONT, low, z + 0.55);
        scene.add(format!("door_left_{i}"), "sage_paint", front);
        let handle = bar_handle(0.14).turned(Axis::Z, 90.0).turned(Axis::Y, 90.0);
        handles.push(handle.at(LEFT_FRONT, high - 0.13, z + 0.033));
    }
    scene.add("handles_left", "brass", Mesh::join(handles));
}

fn worktops(scene: &mut Scene) {
    let back = slab_with_hole([-2.42, 0.86, -1.82], [1.6, WORKTOP, -1.17], [-0.15, -1.68], [0.45, -1.28]);
    scene.add("worktop_back", "oak", back.textured(0.7, Axis::X));
    let left = rounded_cuboid([-2.41, 0.861, -1.168], [-1.77, WORKTOP - 0.0005, 0.58], 0.003, 1);
    scene.add("worktop_left", "oak", left.textured(0.7, Axis::Z));
}

fn sink(scene: &mut Scene) {
    // The basin is a box seen from inside, cut open at the top, under a flat rim.
    let radius = 0.05;
    let basin = rounded_cuboid([-0.148, 0.7, -1.678], [0.448, WORKTOP + 0.002 + radius, -1.282], radius, 3)
        .cut_above(WORKTOP + 0.002)
        .inside_out();
    let rim =
        slab_with_hole([-0.185, 0.897, -1.715], [0.485, 0.903, -1.245], [-0.146, -1.676], [0.446, -1.284]);
    scene.add("sink", "brushed_steel", basin.with(rim));
    let drain = cylinder(0.04, 0.004, 0.0015, 24).at(0.15, 0.6995, -1.48);
    scene.add("sink_drain", "chrome", drain);

    let (x, z) = (0.15, -1.747);
    let spout = [
        dvec3(x, 0.93, z),
        dvec3(x, 1.17, z),
        dvec3(x, 1.23, z + 0.1),
        dvec3(x, 1.17, z + 0.19),
        dvec3(x, 1.12, z + 0.19),
    ];
    let neck = tube(&rounded_path(&spout, 0.045, 5), 0.012, 12);
    let foot = turned_body(
        &[(0.0, -0.004), (0.028, -0.004), (0.028, 0.004), (0.02, 0.01), (0.018, 0.04), (0.0, 0.042)],
        24,
    );
    let lever = tube(
        &[dvec3(x + 0.014, 0.945, z), dvec3(x + 0.05, 0.955, z + 0.01), dvec3(x + 0.1, 0.985, z + 0.02)],
        0.007,
        10,
    );
    scene.add("tap", "chrome", Mesh::join([neck, foot.at(x, WORKTOP, z), lever]));
}

fn wall_cupboards(scene: &mut Scene) {
    let (low, high) = (1.5, 2.25);
    // The closed cupboard in the corner.
    scene.add("wall_cupboard", "cream_paint", cuboid([-2.405, low, -1.81], [-1.57, high, -1.46]));
    let mut knobs = Vec::new();
    for (i, x) in [-2.38, -1.978].into_iter().enumerate() {
        scene.add(
            format!("wall_door_{i}"),
            "cream_paint",
            door(0.395, high - low - 0.01).at(x, low + 0.005, -1.437),
        );
        let knob_x = if i == 0 { x + 0.362 } else { x + 0.033 };
        knobs.push(knob().at(knob_x, low + 0.09, -1.437));
    }
    // The cupboard with glass doors, right of the window: an open box, two shelves, two framed panes.
    let (left, right, back, front) = (0.98, 1.6, -1.81, -1.46);
    let walls = [
        cuboid([left, low, back], [left + 0.018, high, front]),
        cuboid([right - 0.018, low, back], [right, high, front]),
        cuboid([left + 0.017, low + 0.001, back], [right - 0.017, low + 0.019, front + 0.001]),
        cuboid([left + 0.017, high - 0.019, back], [right - 0.017, high - 0.001, front + 0.001]),
        cuboid([left + 0.016, low + 0.01, back + 0.001], [right - 0.016, high - 0.01, -1.785]),
        cuboid([left + 0.016, 1.745, back + 0.002], [right - 0.016, 1.76, front - 0.02]),
        cuboid([left + 0.016, 1.995, back + 0.002], [right - 0.016, 2.01, front - 0.02]),
    ];
    scene.add("glass_cupboard", "cream_paint", Mesh::join(walls));
    for (i, x) in [left + 0.002, left + 0.312].into_iter().enumerate() {
        let (width, height) = (0.306, high - low - 0.006);
        let rim = frame([0.0, 0.0], [width, height], [0.045, 0.045], [width - 0.045, height - 0.045], 0.02);
        scene.add(format!("glass_door_{i}"), "cream_paint", rim.at(x, low + 0.003, -1.437));
        let pane =
            quad(dvec3(0.04, 0.04, -0.01), dvec3(width - 0.08, 0.0, 0.0), dvec3(0.0, height - 0.08, 0.0));
        scene.add(format!("glass_door_pane_{i}"), "cabinet_pane", pane.at(x, low + 0.003, -1.437));
        let knob_x = if i == 0 { x + width - 0.022 } else { x + 0.022 };
        knobs.push(knob().at(knob_x, low + 0.1, -1.437));
    }
    scene.add("knobs", "brass", Mesh::join(knobs));
    scene.add(
        "cupboard_lamp",
        "brushed_steel",
        slab_with_hole([1.04, 1.488, -1.57], [1.52, 1.505, -1.51], [1.048, -1.562], [1.512, -1.518]),
    );
}

fn shelves(scene: &mut Scene) {
    let board = rounded_cuboid([-2.41, 1.52, -1.25], [-2.17, 1.548, 0.35], 0.003, 1);
    scene.add("shelf", "oak", board.textured(0.7, Axis::Z));
    let bracket = |z: f64| {
        let path = [
            dvec3(-2.405, 1.4, z),
            dvec3(-2.388, 1.4, z),
            dvec3(-2.388, 1.508, z),
            dvec3(-2.2, 1.508, z),
            dvec3(-2.2, 1.525, z),
        ];
        tube(&rounded_path(&path, 0.008, 2), 0.007, 6)
    };
    scene.add("shelf_brackets", "brass", Mesh::join([-1.05, -0.45, 0.15].map(bracket)));
    // A rail with kitchen tools, below the clock.
    let rail = tube(&[dvec3(-0.88, 1.4, -1.74), dvec3(-0.7, 1.4, -1.74), dvec3(-0.5, 1.4, -1.74)], 0.007, 10);
    let holder =
        |x: f64| tube(&[dvec3(x, 1.4, -1.795), dvec3(x, 1.4, -1.765), dvec3(x, 1.4, -1.738)], 0.006, 8);
    scene.add("tool_rail", "brass", Mesh::join([rail, holder(-0.86), holder(-0.52)]));
    let shaft = |x: f64| {
        let path = [
            dvec3(x, 1.4, -1.728),
            dvec3(x, 1.413, -1.74),
            dvec3(x, 1.4, -1.752),
            dvec3(x, 1.39, -1.735),
            dvec3(x, 1.14, -1.735),
        ];
        tube(&rounded_path(&path, 0.006, 2), 0.0045, 6)
    };
    let ladle_bowl = turned_body(
        &[
            (0.0, -0.04),
            (0.022, -0.036),
            (0.037, -0.02),
            (0.042, 0.0),
            (0.04, 0.0),
            (0.035, -0.019),
            (0.021, -0.034),
            (0.0, -0.038),
        ],
        20,
    );
    scene.add(
        "ladle",
        "polished_steel",
        shaft(-0.8).with(ladle_bowl.turned(Axis::X, 20.0).at(-0.8, 1.125, -1.71)),
    );
    let blade = rounded_cuboid([-0.04, -0.1, -0.0015], [0.04, 0.0, 0.0015], 0.0015, 1);
    scene.add("spatula", "polished_steel", shaft(-0.69).with(blade.at(-0.69, 1.145, -1.735)));
    let spoon = sphere(0.04, 14).stretched(0.8, 1.2, 0.18);
    scene.add("spoon", "pale_wood", shaft(-0.58).with(spoon.at(-0.58, 1.1, -1.735)));
}
