//! The tree as it lies in memory.

use glam::Vec4;

/// Marks a child that is a leaf: the other bits are the index of its triangle group.
pub(crate) const LEAF: u32 = 1 << 31;

/// Eight boxes, axis by axis, and what is in them. A slot without child holds an inverted box that no ray meets.
#[repr(C, align(32))]
#[derive(Debug, Clone, Copy)]
pub(crate) struct Node {
    /// `bounds[0]` the lower and `bounds[1]` the upper planes, each by axis and slot.
    pub bounds: [[[f32; 8]; 3]; 2],
    pub children: [u32; 8],
}

impl Node {
    pub const EMPTY: Self =
        Self { bounds: [[[f32::INFINITY; 8]; 3], [[f32::NEG_INFINITY; 8]; 3]], children: [LEAF; 8] };
}

/// Up to four triangles, `corners[corner][axis]` by lane. Unused lanes repeat the last triangle.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Group {
    pub corners: [[Vec4; 3]; 3],
    pub primitives: [u32; 4],
}

/// Bounding volume hierarchy over triangles.
#[derive(Debug, Clone, Default)]
pub struct Bvh {
    pub(crate) nodes: Vec<Node>,
    pub(crate) groups: Vec<Group>,
}

impl Bvh {
    /// Number of nodes and of triangle groups: the deterministic cost of a build.
    pub fn size(&self) -> (usize, usize) {
        (self.nodes.len(), self.groups.len())
    }

    /// Memory held, bytes.
    pub fn bytes(&self) -> usize {
        size_of_val(self.nodes.as_slice()) + size_of_val(self.groups.as_slice())
    }
}
