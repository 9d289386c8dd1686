//! Solid dielectrics that overlap: what a point is inside of, and which of it fills the place.
//!
//! Where solids with a priority overlap, the one of highest priority fills the place, and the others' faces inside it are not there (Schmidt
//! and Budge 2002, Simple Nested Dielectrics in Ray Traced Images). Of equal priorities the material that is listed first counts as the
//! higher, whichever was entered first, so that light takes the same way in both directions.

use forelight_scene::{MOST_NESTED, Material, Surface};

/// Bits that count one medium.
const BITS: u32 = 4;
/// How often a medium counts as entered at most.
const MOST: u128 = (1 << BITS) - 1;
const _: () = assert!(MOST_NESTED as u32 * BITS == u128::BITS);

/// The media that a point is inside of: of each, by its rank, how many solids' faces were entered and not left.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Media(u128);

impl Media {
    /// Rank of the medium that fills the place; none: nothing does.
    pub fn top(self) -> Option<u8> {
        (self.0 != 0).then(|| ((u128::BITS - 1 - self.0.leading_zeros()) / BITS) as u8)
    }

    /// Into one more solid.
    pub fn enter(&mut self, rank: u8) {
        if self.times(rank) < MOST {
            self.0 += 1 << shift(rank);
        }
    }

    /// Out of a solid; nothing happens outside.
    pub fn leave(&mut self, rank: u8) {
        if self.holds(rank) {
            self.0 -= 1 << shift(rank);
        }
    }

    /// Whether the point is inside a solid of this medium.
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

/// The media of a frame in the order of their priorities.
#[derive(Debug, Clone, Default)]
pub struct Ranks {
    /// Materials and their indices of refraction, the lowest priority first.
    media: Vec<(usize, f32)>,
    /// Of every material.
    of_material: Vec<Option<u8>>,
}

impl Ranks {
    /// The ranks of a scene's materials, of which at most [`MOST_NESTED`] have a priority.
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

    /// Whether no material has a priority.
    pub fn is_empty(&self) -> bool {
        self.media.is_empty()
    }

    /// Rank of a material.
    pub fn of(&self, material: usize) -> Option<u8> {
        self.of_material[material]
    }

    /// The material of a rank.
    pub fn material(&self, rank: u8) -> usize {
        self.media[usize::from(rank)].0
    }

    /// Index of refraction where this medium fills the place, or none.
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
