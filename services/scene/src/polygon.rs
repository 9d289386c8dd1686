//! Triangulates polygons: convex ones as a fan about the first corner, others by ear clipping (Meisters 1975,
//! as implemented by `earcut`) in the plane of the Newell normal.

use earcut::Earcut;
use earcut::utils3d::project3d_to_2d;
use glam::DVec3;

/// Relative tolerance: a corner this close to the line of its neighbours may be off by rounding to `f32`.
const ROUNDING: f64 = 4.0 * f32::EPSILON as f64;

/// Whether a fan about the first corner is valid: the polygon is convex or has no area.
pub(crate) fn is_fan(corners: &[DVec3]) -> bool {
    let Some(normal) = normal(corners) else { return true };
    let at = |corner: usize| corners[corner % corners.len()];
    let rounding =
        ROUNDING * corners.iter().fold(0.0f64, |most, corner| most.max(corner.abs().max_element()));
    (0..corners.len()).all(|corner| {
        let (into, out) = (at(corner + 1) - at(corner), at(corner + 2) - at(corner + 1));
        into.cross(out).dot(normal) >= -rounding * (into.length() + out.length())
    })
}

/// Triangulates a polygon by ear clipping, as corner indices with its winding. `None` if no triangle can be
/// cut. At worst quadratic time.
pub(crate) fn ears(corners: &[DVec3]) -> Option<Vec<[usize; 3]>> {
    let normal = normal(corners)?;
    let points: Vec<[f64; 3]> = corners.iter().map(|&corner| (corner - corners[0]).to_array()).collect();
    let mut flat = Vec::with_capacity(points.len());
    if !project3d_to_2d(&points, points.len(), &mut flat) {
        return None;
    }
    let mut cut: Vec<usize> = Vec::new();
    Earcut::new().earcut(flat, &[], &mut cut);
    let triangle = |&[a, b, c]: &[usize; 3]| {
        let turns = (corners[b] - corners[a]).cross(corners[c] - corners[a]).dot(normal);
        if turns < 0.0 { [a, c, b] } else { [a, b, c] }
    };
    let (triangles, _) = cut.as_chunks();
    Some(triangles.iter().map(triangle).collect()).filter(|found: &Vec<_>| !found.is_empty())
}

/// Newell's normal, the sum of the cross products of neighbouring corners, relative to the first corner to
/// keep digits.
fn normal(corners: &[DVec3]) -> Option<DVec3> {
    let (&first, others) = corners.split_first()?;
    others.windows(2).map(|pair| (pair[0] - first).cross(pair[1] - first)).sum::<DVec3>().try_normalize()
}

#[cfg(test)]
mod tests {
    use super::{ears, is_fan};
    use glam::{DQuat, DVec3};
    use proptest::prelude::*;

    fn area(corners: &[DVec3], [a, b, c]: [usize; 3]) -> DVec3 {
        0.5 * (corners[b] - corners[a]).cross(corners[c] - corners[a])
    }

    /// A closed polygon about a centre, with one radius per corner. It never intersects itself.
    fn star(radii: &[f64], at: DVec3, turned: DQuat) -> Vec<DVec3> {
        let step = std::f64::consts::TAU / radii.len() as f64;
        let corner = |(i, radius): (usize, &f64)| {
            let (sin, cos) = libm::sincos(step * i as f64);
            at + turned * DVec3::new(radius * cos, radius * sin, 0.0)
        };
        radii.iter().enumerate().map(corner).collect()
    }

    #[test]
    fn a_fan_will_do_for_what_is_convex_or_has_no_area() {
        let square = [DVec3::ZERO, DVec3::X, DVec3::new(1.0, 1.0, 0.0), DVec3::Y];
        assert!(is_fan(&square) && is_fan(&square.map(|corner| -3e7 + corner)));
        assert!(is_fan(&[DVec3::ZERO, DVec3::X * 0.5, DVec3::X, DVec3::new(1.0, 1.0, 0.0), DVec3::Y]));
        assert!(is_fan(&[0.0, 1.0, 2.0, 3.0].map(|x| DVec3::X * x)));
        assert!(is_fan(&[DVec3::ZERO; 5]) && is_fan(&[]));
        assert_eq!((ears(&[DVec3::ZERO; 5]), ears(&[])), (None, None));
    }

    #[test]
    fn an_arrow_head_is_cut_where_it_has_its_notch() {
        let arrow = [DVec3::X, DVec3::Y, DVec3::NEG_X, DVec3::Y * 0.25];
        assert!(!is_fan(&arrow));
        let from_the_notch = |triangle: [usize; 3]| {
            let mut turned = triangle;
            turned.rotate_left(triangle.iter().position(|&corner| corner == 3).unwrap());
            turned
        };
        let mut found: Vec<[usize; 3]> = ears(&arrow).unwrap().into_iter().map(from_the_notch).collect();
        found.sort_unstable();
        assert_eq!(found, [[3, 0, 1], [3, 1, 2]]);
    }

    proptest! {
        #[test]
        fn the_areas_of_the_ears_are_that_of_the_polygon_and_turn_as_it_does(
            radii in prop::collection::vec(0.05f64..1.0, 4..40),
            at in prop::array::uniform3(-100.0f64..100.0),
            axis in prop::array::uniform3(-1.0f64..1.0),
            angle in 0.0f64..6.0,
        ) {
            let axis = DVec3::from(axis).try_normalize().unwrap_or(DVec3::X);
            let corners = star(&radii, DVec3::from(at), DQuat::from_axis_angle(axis, angle));
            let fan: Vec<[usize; 3]> = (2..corners.len()).map(|c| [0, c - 1, c]).collect();
            let whole: DVec3 = fan.iter().map(|&triangle| area(&corners, triangle)).sum();
            let found = if is_fan(&corners) { fan } else { ears(&corners).unwrap() };
            prop_assert!(found.len() <= corners.len() - 2);
            let unsigned: f64 = found.iter().map(|&triangle| area(&corners, triangle).length()).sum();
            prop_assert!((unsigned / whole.length() - 1.0).abs() < 1e-9, "{unsigned} in place of {}", whole.length());
            for triangle in found {
                prop_assert!(area(&corners, triangle).dot(whole) >= 0.0);
            }
        }
    }
}
