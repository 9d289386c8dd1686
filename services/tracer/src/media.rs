//! Overlapping solid dielectrics: which solids contain a point, and which of them fills it.
//!
//! The solid with the highest priority fills the space; the others' faces inside it are ignored (Schmidt and
//! Budge 2002, "Simple Nested Dielectrics in Ray Traced Images"). Ties go to the material that is listed
//! first, so light behaves the same in both directions.

use forelight_scene::{MOST_NESTED, Material, Surface};

/// Bits that count how often one medium was entered.
const BITS: u32 = 4;
/// Largest count per medium. Further entries are not counted.
const MOST: u128 = (1 << BITS) - 1;
const _: () = assert!(MOST_NESTED as u32 * BITS == u128::BITS);

/// The media at a point: per rank, how many solids were entered and not left.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Media(u128);

impl Media {
    /// Rank of the medium that fills the space. `None` if no solid does.
    pub fn top(self) -> Option<u8> {
        (self.0 != 0).then(|| ((u128::BITS - 1 - self.0.leading_zeros()) / BITS) as u8)
    }

    /// Enters a solid.
    pub fn enter(&mut self, rank: u8) {
        if self.times(rank) < MOST {
            self.0 += 1 << shift(rank);
        }
    }

    /// Leaves a solid. Does nothing outside of it.
    pub fn leave(&mut self, rank: u8) {
        if self.holds(rank) {
            self.0 -= 1 << shift(rank);
        }
    }

    /// Returns `true` if the point is inside a solid of this medium.
    pub fn holds(self, rank: u8) -> bool {
        self.times(rank) > 0
    }

    fn times(self, rank: u8) -> u128 {
        self.0 >> shift(rank) & MOST
    }
}

fn shift(rank: u8) -> u32 {
    u32::from(rank) * BITS
}

/// The media of a frame, ordered by priority.
#[derive(Debug, Clone, Default)]
pub struct Ranks {
    /// Material index and index of refraction of each rank. The lowest priority comes first.
    media: Vec<(usize, f32)>,
    /// Rank of each material.
    of_material: Vec<Option<u8>>,
}

impl Ranks {
    /// The ranks of a scene's materials. At most [`MOST_NESTED`] materials may have a priority.
    pub fn new(materials: &[Material]) -> Self {
        let mut ordered: Vec<(u8, std::cmp::Reverse<usize>, f32)> = Vec::new();
        for (index, material) in materials.iter().enumerate() {
            if let Surface::Glass { ior, priority: Some(priority), .. } = material.surface {
                ordered.push((priority.get(), std::cmp::Reverse(index), ior));
            }
        }
        ordered.sort_by_key(|&(priority, index, _)| (priority, index));
        ordered.truncate(MOST_NESTED);
        let mut ranks =
            Self { media: Vec::with_capacity(ordered.len()), of_material: vec![None; materials.len()] };
        for (rank, (_, std::cmp::Reverse(index), ior)) in (0u8..).zip(ordered) {
            ranks.media.push((index, ior));
            ranks.of_material[index] = Some(rank);
        }
        ranks
    }

    /// Returns `true` if no material has a priority.
    pub fn is_empty(&self) -> bool {
        self.media.is_empty()
    }

    /// Rank of a material. `None` if it has no priority.
    pub fn of(&self, material: usize) -> Option<u8> {
        self.of_material[material]
    }

    /// The material of a rank.
    pub fn material(&self, rank: u8) -> usize {
        self.media[usize::from(rank)].0
    }

    /// Index of refraction of the medium that fills the space; 1 for `None`.
    pub fn ior(&self, top: Option<u8>) -> f32 {
        top.map_or(1.0, |rank| self.media[usize::from(rank)].1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_highest_rank_fills_the_place_until_it_was_left_as_often_as_entered() {
        let mut media = Media::default();
        assert_eq!(media.top(), None);
        media.enter(3);
        media.enter(3);
        media.enter(31);
        media.enter(0);
        assert_eq!(media.top(), Some(31));
        media.leave(31);
        media.leave(3);
        assert_eq!(media.top(), Some(3));
        media.leave(3);
        assert_eq!(media.top(), Some(0));
        media.leave(0);
        assert_eq!(media, Media::default());
    }

    #[test]
    fn counts_stay_in_their_range() {
        let mut media = Media::default();
        media.leave(5);
        assert_eq!(media, Media::default());
        (0..40).for_each(|_| media.enter(5));
        assert_eq!((media.top(), media.holds(6), media.holds(4)), (Some(5), false, false));
        (0..15).for_each(|_| media.leave(5));
        assert_eq!(media, Media::default());
    }
}
