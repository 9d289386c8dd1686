//! A shell prepared for queries: which points it contains, and what comes close to it.

use super::facet::{Facet, Sides};
use super::shell::Shell;
use super::tree::Tree;
use crate::bounds::Bounds;
use forelight_scene::Geometry;
use glam::DVec3;

/// Directions of the rays that tell inside from outside, far from the axes along which most faces lie.
const PROBES: [DVec3; 8] = [
    DVec3::new(0.531, 0.293, 0.795),
    DVec3::new(-0.417, 0.811, 0.409),
    DVec3::new(0.713, -0.561, -0.421),
    DVec3::new(-0.239, -0.607, 0.758),
    DVec3::new(0.177, 0.643, -0.745),
    DVec3::new(-0.859, -0.311, -0.407),
    DVec3::new(0.379, -0.887, 0.263),
    DVec3::new(-0.673, 0.167, -0.721),
];

/// Number of probes that must agree.
const AGREEING: usize = 3;

pub struct Wall<'a> {
    shell: &'a Shell,
    facets: Vec<Facet>,
    tree: Tree,
    /// Anything closer than this may touch the shell, metres.
    margin: f32,
    /// Smallest length by which positions can differ, metres: several ulps of the largest coordinate.
    rounding: f64,
}

impl<'a> Wall<'a> {
    /// Prepares a shell. `extent` is the largest coordinate of anything that rays start from or end at.
    pub fn new(geometry: &Geometry, shell: &'a Shell, extent: f32) -> Self {
        let tree = Tree::new(shell.triangles.iter().map(|&t| Bounds::of(geometry.corners(t))));
        let facets = shell.triangles.iter().map(|&t| Facet::new(geometry, t)).collect();
        let rounding = f64::from((shell.bounds.reach() / 1_048_576.0).max(extent / 2_097_152.0));
        Self { shell, facets, tree, margin: margin(shell, extent), rounding }
    }

    /// A box with everything that comes close to the shell.
    pub fn reach(&self) -> Bounds {
        self.shell.bounds.grown(self.margin)
    }

    /// Returns whether a point is inside. `None` if the probes cannot decide.
    pub fn holds(&self, point: DVec3) -> Option<bool> {
        let mut answers = [0; 2];
        for probe in PROBES {
            let direction = probe.normalize();
            let (mut crossings, mut clear) = (0usize, true);
            self.tree.ahead(point, direction, |i| match self.facets[i as usize].crossed(point, direction) {
                Some(crossed) => crossings += usize::from(crossed),
                None => clear = false,
            });
            answers[crossings % 2] += usize::from(clear);
            if answers == [AGREEING, 0] || answers == [0, AGREEING] {
                return Some(answers[1] > 0);
            }
        }
        None
    }

    /// Returns `true` if a sphere comes close to the shell.
    pub fn is_near_point(&self, centre: DVec3, radius: f32) -> bool {
        let distance = self.margin + radius;
        let bounds = Bounds::of([centre.as_vec3()]).grown(distance);
        let point = Facet::point(centre);
        let near = |i| !self.facets[i as usize].is_apart(&point, f64::from(distance));
        self.tree.any_overlapping(&bounds, near)
    }

    /// Returns `true` if anything in a box may come close to the shell.
    pub fn may_meet(&self, bounds: &Bounds) -> bool {
        self.tree.any_overlapping(&bounds.grown(self.margin), |_| true)
    }

    /// How another triangle meets the shell. `sealed`: no ray leaves the triangle on the side it did not come
    /// from.
    pub fn meets(&self, facet: &Facet, sealed: bool, camera_inside: bool) -> Meeting {
        let (lit, mut meeting) = (self.lit_sides(camera_inside), Meeting::Apart);
        let bounds = Bounds::of(facet.corners.map(|p| p.as_vec3())).grown(self.margin);
        self.tree.any_overlapping(&bounds, |i| {
            let own = &self.facets[i as usize];
            if own.is_apart(facet, f64::from(self.margin)) {
                return false;
            }
            let slips = facet.may_slip(Sides::Both, sealed, own, lit, self.rounding);
            meeting = if slips { Meeting::Leaks } else { Meeting::Touches };
            slips
        });
        meeting
    }

    /// Whether rays that leave the shell on the camera's side may cross it, where it meets itself at an acute
    /// angle.
    pub fn leaks(&self, camera_inside: bool) -> bool {
        let lit = self.lit_sides(camera_inside);
        self.facets.iter().enumerate().any(|(i, facet)| {
            // Most neighbours do not face each other, which is quicker to test than their distance.
            let bounds = Bounds::of(facet.corners.map(|p| p.as_vec3())).grown(self.margin);
            self.tree.any_overlapping(&bounds, |j| {
                let own = &self.facets[j as usize];
                i != j as usize
                    && facet.may_slip(lit, true, own, lit, self.rounding)
                    && !own.is_apart(facet, f64::from(self.margin))
            })
        })
    }

    /// Sides of the triangles that face the camera's side of the shell.
    fn lit_sides(&self, camera_inside: bool) -> Sides {
        match self.shell.outward {
            None => Sides::Both,
            Some(outward) if outward == camera_inside => Sides::Back,
            Some(_) => Sides::Front,
        }
    }
}

/// How a triangle meets a shell.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Meeting {
    /// It does not touch the shell.
    Apart,
    /// It touches the shell, or may touch it.
    Touches,
    /// It touches the shell, and rays that leave it may start beyond the shell.
    Leaks,
}

/// Distance within which something may touch the shell: several times the offset of ray origins, 2⁻¹⁸ of the
/// largest coordinate of the triangle's corners (`forelight_bvh::offset_origin`), and well above rounding
/// errors of distant rays.
fn margin(shell: &Shell, extent: f32) -> f32 {
    (shell.bounds.reach() / 16_384.0).max(extent / 65_536.0)
}
