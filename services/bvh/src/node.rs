//! The tree as it lies in memory.

use glam::Vec4;

/// Marks a child that is a leaf: the other bits are the index of its triangle group.
pub(crate) const LEAF: u32 = 1 << 31;

/// No child: what lies below the last subtree that waits to be visited. A leaf of no group.
pub(crate) const END: u32 = u32::MAX;

/// Children of a node, at most.
pub(crate) const WIDTH: usize = 8;

/// Triangles in a group, at most.
pub(crate) const GROUP: usize = 4;

/// Eight boxes, axis by axis, and what is in them. A slot without child holds an inverted box that no ray meets.
///
/// The later a slot, the sooner a ray that looks for any hit should go there: see [`crate::collapse`].
#[repr(C, align(32))]
#[derive(Debug, Clone, Copy)]
pub(crate) struct Node {
    /// `bounds[0]` the lower and `bounds[1]` the upper planes, each by axis and slot.
    pub bounds: [[[f32; WIDTH]; 3]; 2],
    pub children: [u32; WIDTH],
}

impl Node {
    pub const EMPTY: Self = Self {
        bounds: [[[f32::INFINITY; WIDTH]; 3], [[f32::NEG_INFINITY; WIDTH]; 3]],
        children: [END; WIDTH],
    };
}

/// Up to four triangles, `corners[corner][axis]` by lane. Unused lanes repeat the last triangle.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Group {
    pub corners: [[Vec4; 3]; 3],
    pub primitives: [u32; GROUP],
}

/// Bounding volume hierarchy over triangles.
#[derive(Debug, Clone, Default)]
pub struct Bvh {
    pub(crate) nodes: Vec<Node>,
    pub(crate) groups: Vec<Group>,
    /// Nodes on the longest way from the root, counted with the root.
    pub(crate) depth: usize,
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

    /// Room that a traversal needs for subtrees that wait. A node on the way down leaves at most seven behind, as its
    /// eighth child is the next node; the last one may write eight before one is taken; and below them lies [`END`].
    pub(crate) fn waiting(&self) -> usize {
        (WIDTH - 1) * self.depth.saturating_sub(1) + WIDTH + 1
    }
}
