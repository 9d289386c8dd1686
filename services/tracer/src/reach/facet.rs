//! Tests of single triangles: distance of two, crossing by a ray, and rays that start beyond another.

use forelight_scene::Geometry;
use glam::DVec3;

/// Smaller cosines count as a right angle: a step along one normal does not show along the other in f32.
const SQUARE: f64 = 1.0 / 4096.0;

/// A triangle in f64, where differences of f32 coordinates are exact.
#[derive(Debug, Clone, Copy)]
pub struct Facet {
    pub corners: [DVec3; 3],
    /// Unit normal, on the side from which the triangle is counter-clockwise. Zero if there is none.
    pub normal: DVec3,
}

/// Sides of a triangle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sides {
    /// The side that the normal points to.
    Front,
    /// The opposite side.
    Back,
    /// Both sides.
    Both,
}

impl Sides {
    fn signs(self) -> &'static [f64] {
        match self {
            Self::Front => &[1.0],
            Self::Back => &[-1.0],
            Self::Both => &[1.0, -1.0],
        }
    }
}

impl Facet {
    pub fn new(geometry: &Geometry, triangle: u32) -> Self {
        let corners = geometry.corners(triangle).map(|p| p.as_dvec3());
        let [a, b, c] = corners;
        Self { corners, normal: (b - a).cross(c - a).normalize_or_zero() }
    }

    /// A triangle that degenerates to one point.
    pub fn point(at: DVec3) -> Self {
        Self { corners: [at; 3], normal: DVec3::ZERO }
    }

    fn edges(&self) -> [DVec3; 3] {
        let [a, b, c] = self.corners;
        [b - a, c - b, a - c]
    }

    /// Whether an axis separates the two triangles by more than `distance`. `false` may be wrong, on the safe
    /// side.
    pub fn is_apart(&self, other: &Self, distance: f64) -> bool {
        let (own, theirs) = (self.edges(), other.edges());
        let gap_along = |axis: DVec3| {
            let length = axis.length();
            let reach = |corners: &[DVec3; 3]| {
                let [a, b, c] = corners.map(|p| (p - self.corners[0]).dot(axis));
                (a.min(b).min(c), a.max(b).max(c))
            };
            let ((low, high), (their_low, their_high)) = (reach(&self.corners), reach(&other.corners));
            length > 0.0 && (their_low - high).max(low - their_high) > distance * length
        };
        let across = |edges: &[DVec3; 3], normal: DVec3| edges.iter().any(|&e| gap_along(e.cross(normal)));
        gap_along(self.normal)
            || gap_along(other.normal)
            || across(&own, self.normal)
            || across(&theirs, other.normal)
            || own.iter().any(|&a| theirs.iter().any(|&b| gap_along(a.cross(b))))
            || gap_along(other.corners[0] - self.corners[0])
    }

    /// Whether the half-line from `origin` along the unit `direction` crosses. `None` if f64 cannot decide.
    pub fn crossed(&self, origin: DVec3, direction: DVec3) -> Option<bool> {
        let [a, b, c] = self.corners.map(|p| p - origin);
        let size = a.abs().max(b.abs()).max(c.abs()).max_element();
        // Tetrahedra of the direction and the edges: their signs tell on which side of each edge the line
        // passes.
        let sides = [direction.dot(b.cross(c)), direction.dot(c.cross(a)), direction.dot(a.cross(b))];
        let least = 1e-12 * size * size;
        if sides.iter().any(|&s| s > least) && sides.iter().any(|&s| s < -least) {
            return Some(false);
        }
        let volume = a.dot(b.cross(c));
        if sides.iter().any(|s| s.abs() <= least) || volume.abs() <= 1e-12 * size * size * size {
            return None;
        }
        Some((volume > 0.0) == (sides[0] > 0.0))
    }

    /// Whether a ray that leaves this triangle, close to the triangle `wall` of a shell, may start beyond the
    /// wall. Rays start at an offset along the normal, on one of the `sides`. `sealed` means that no ray
    /// leaves on the other side. `wall_sides` are the wall's sides that light can reach. `rounding` is the
    /// smallest difference of positions, in metres.
    pub fn may_slip(
        &self,
        sides: Sides,
        sealed: bool,
        wall: &Self,
        wall_sides: Sides,
        rounding: f64,
    ) -> bool {
        let ahead = |of: &Self, normal: DVec3, points: &[DVec3; 3]| {
            points.iter().map(|&p| normal.dot(p - of.corners[0])).fold(f64::NEG_INFINITY, f64::max)
        };
        wall_sides.signs().iter().any(|wall_sign| {
            let towards_light = *wall_sign * wall.normal;
            let before_wall = ahead(wall, towards_light, &self.corners);
            sides.signs().iter().any(|sign| {
                let step = *sign * self.normal;
                let cos = step.dot(towards_light);
                if sealed {
                    // The offset leads towards the wall, and surface and wall are partly in front of each
                    // other.
                    cos < -SQUARE && before_wall > rounding && ahead(self, step, &wall.corners) > rounding
                } else {
                    cos.abs() > SQUARE && before_wall >= -rounding
                }
            })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn facet(corners: [[f64; 3]; 3]) -> Facet {
        let [a, b, c] = corners.map(DVec3::from);
        Facet { corners: [a, b, c], normal: (b - a).cross(c - a).normalize_or_zero() }
    }

    /// A triangle in the plane y = `height`, with its normal up.
    fn level(height: f64) -> Facet {
        facet([[0.0, height, 0.0], [0.0, height, 1.0], [1.0, height, 0.0]])
    }

    #[test]
    fn distance_is_shown_in_every_position() {
        let floor = level(0.0);
        assert!(floor.is_apart(&level(0.1), 0.09) && !floor.is_apart(&level(0.1), 0.11));
        let beside = facet([[1.2, 0.0, 0.0], [2.0, 0.0, 0.0], [2.0, 0.0, 1.0]]);
        assert!(floor.is_apart(&beside, 0.1) && !floor.is_apart(&beside, 0.3));
        let through = facet([[0.2, -1.0, 0.2], [0.2, 1.0, 0.2], [0.3, 0.0, 5.0]]);
        assert!(!floor.is_apart(&through, 0.0));
        let point = Facet::point(DVec3::new(0.2, 0.5, 0.2));
        assert!(floor.is_apart(&point, 0.4) && !floor.is_apart(&point, 0.6));
    }

    #[test]
    fn a_half_line_crosses_what_lies_ahead_of_it() {
        let (floor, below) = (level(0.0), DVec3::new(0.2, -1.0, 0.2));
        let up = DVec3::new(0.1, 1.0, 0.05).normalize();
        assert_eq!(floor.crossed(below, up), Some(true));
        assert_eq!(floor.crossed(below, -up), Some(false));
        assert_eq!(floor.crossed(below + DVec3::X, up), Some(false));
        assert_eq!(floor.crossed(DVec3::new(0.0, -1.0, 0.5), DVec3::Y), None, "through an edge");
        assert_eq!(floor.crossed(DVec3::new(0.2, 0.0, 0.2), up), None, "from its own plane");
    }

    #[test]
    fn rays_slip_past_a_wall_that_the_step_leads_towards() {
        let floor = level(0.0);
        let slips = |x: &Facet, sealed| x.may_slip(Sides::Both, sealed, &floor, Sides::Front, 1e-6);
        let upright = facet([[0.1, 0.0, 0.1], [0.1, 1.0, 0.1], [0.6, 0.0, 0.1]]);
        let leaning = facet([[0.1, 0.0, 0.1], [0.1, 1.0, 0.4], [0.6, 0.0, 0.1]]);
        assert!(!slips(&upright, true) && !slips(&upright, false));
        assert!(slips(&leaning, true));
        assert!(!slips(&level(0.0), true), "a rug that lies in the floor's plane");
        assert!(slips(&level(0.0), false), "a pane that does");
        assert!(slips(&level(1e-5), true), "a shelf closely above the floor");
        assert!(!slips(&level(-1e-5), true) && !slips(&level(-1e-5), false), "what lies below it");
    }
}
