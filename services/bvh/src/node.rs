//! The tree's memory layout.

use bytemuck::{Pod, Zeroable};
use glam::Vec4;

/// Marks a child that is a leaf. The other bits are the index of its triangle group.
pub(crate) const LEAF: u32 = 1 << 31;

/// No child. It also marks the bottom of the traversal stack. Its bits read as a leaf without a group.
pub(crate) const END: u32 = u32::MAX;

/// Maximum number of children per node.
pub(crate) const WIDTH: usize = 8;

/// Maximum number of triangles per group.
pub(crate) const GROUP: usize = 4;

/// Eight boxes, stored axis by axis, and their children. An empty slot has an inverted box that no ray meets.
/// Later slots have higher priority in an any-hit query; see [`crate::collapse`].
#[repr(C, align(32))]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
pub(crate) struct Node {
    /// `bounds[0]` holds the lower planes and `bounds[1]` the upper planes, each indexed by axis and slot.
    pub bounds: [[[f32; WIDTH]; 3]; 2],
    pub children: [u32; WIDTH],
}

impl Node {
    pub const EMPTY: Self = Self {
        bounds: [[[f32::INFINITY; WIDTH]; 3], [[f32::NEG_INFINITY; WIDTH]; 3]],
        children: [END; WIDTH],
    };
}

/// Up to four triangles, as `corners[corner][axis]`, one per lane. Unused lanes repeat the last.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
pub(crate) struct Group {
    pub corners: [[Vec4; 3]; 3],
    pub primitives: [u32; GROUP],
}

/// Bounding volume hierarchy over triangles.
#[derive(Debug, Clone, Default)]
pub struct Bvh {
    pub(crate) nodes: Vec<Node>,
    pub(crate) groups: Vec<Group>,
    /// Number of nodes on the longest path from the root, including the root.
    pub(crate) depth: usize,
}

impl Bvh {
    /// Number of nodes and number of triangle groups. They measure the cost of a build deterministically.
    pub fn size(&self) -> (usize, usize) {
        (self.nodes.len(), self.groups.len())
    }

    /// Memory used by nodes and groups, in bytes.
    pub fn bytes(&self) -> usize {
        size_of_val(self.nodes.as_slice()) + size_of_val(self.groups.as_slice())
    }

    /// Number of stack entries that a traversal needs: at most seven per node on the way down, eight for the
    /// last, and one for [`END`].
    pub(crate) fn waiting(&self) -> usize {
        (WIDTH - 1) * self.depth.saturating_sub(1) + WIDTH + 1
    }
}
