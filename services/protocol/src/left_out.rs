//! Parts of a scene that do not affect its images.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// A light or an object that provably does not affect an image.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct LeftOut {
    /// Name or number of it.
    pub what: String,
    /// Why it has no effect.
    pub reason: String,
}

impl LeftOut {
    /// Largest number of entries per frame. The last of them stands for all that follow.
    pub const MOST: usize = 100;

    /// The entries that all frames have in common, in the order of the first frame.
    pub fn of_all<'a>(frames: impl IntoIterator<Item = &'a [Self]>) -> Vec<Self> {
        let mut frames = frames.into_iter();
        let Some(first) = frames.next() else { return Vec::new() };
        frames.fold(first.to_vec(), |kept, frame| {
            kept.into_iter().filter(|left| frame.contains(left)).collect()
        })
    }
}
