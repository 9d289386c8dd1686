//! A tree as the bytes that it has in memory, for machines that keep it.

use crate::node::{Bvh, END, Group, LEAF, Node};
use bytemuck::{cast_slice, pod_collect_to_vec};

/// Length of the numbers of nodes and of levels, which precede them.
const HEAD: usize = 2 * size_of::<u64>();

impl Bvh {
    /// The tree as bytes, in this machine's byte order.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(HEAD + self.bytes());
        bytes.extend_from_slice(&(self.nodes.len() as u64).to_ne_bytes());
        bytes.extend_from_slice(&(self.depth as u64).to_ne_bytes());
        bytes.extend_from_slice(cast_slice(&self.nodes));
        bytes.extend_from_slice(cast_slice(&self.groups));
        bytes
    }

    /// The tree of [`Self::to_bytes`]. `None` if the bytes are no tree over so many triangles.
    pub fn from_bytes(bytes: &[u8], triangles: usize) -> Option<Self> {
        let (nodes, bytes) = bytes.split_first_chunk()?;
        let (depth, bytes) = bytes.split_first_chunk()?;
        let nodes = usize::try_from(u64::from_ne_bytes(*nodes)).ok()?.checked_mul(size_of::<Node>())?;
        let (nodes, groups) = bytes.split_at_checked(nodes)?;
        groups.len().is_multiple_of(size_of::<Group>()).then_some(())?;
        let depth = usize::try_from(u64::from_ne_bytes(*depth)).ok()?;
        let tree = Self { nodes: pod_collect_to_vec(nodes), groups: pod_collect_to_vec(groups), depth };
        tree.is_sound(triangles).then_some(tree)
    }

    /// Whether a traversal stays inside of the tree, its stack and the triangles. Children come after their
    /// parents, so a traversal ends.
    fn is_sound(&self, triangles: usize) -> bool {
        let mut levels = vec![0; self.nodes.len()];
        if let Some(root) = levels.first_mut() {
            *root = 1;
        }
        for (index, node) in self.nodes.iter().enumerate() {
            let level = levels[index];
            for &child in node.children.iter().filter(|&&child| child != END) {
                let place = (child & !LEAF) as usize;
                if child & LEAF != 0 {
                    if place >= self.groups.len() {
                        return false;
                    }
                } else if place <= index || place >= self.nodes.len() {
                    return false;
                } else {
                    levels[place] = levels[place].max(level + 1);
                }
            }
        }
        let deepest = levels.into_iter().max().unwrap_or(0);
        let known = |group: &Group| group.primitives.iter().all(|&p| (p as usize) < triangles);
        deepest == self.depth && self.groups.iter().all(known)
    }
}
