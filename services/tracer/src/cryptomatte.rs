//! Object and material ids that other programs can read: Cryptomatte, version 1.2.0 of the specification
//! (<https://github.com/Psyop/Cryptomatte>). An id is the hash of a name. A pixel has ids by falling coverage,
//! two in each layer of four channels, and the file's header names them.

use crate::pixel::{Coverage, Pixel};
use std::collections::BTreeMap;
use std::fmt::Write;

/// Pairs of id and coverage in one layer: R and G, B and A.
const PAIRS: usize = 2;
/// Layers that hold every pair of a pixel.
const LAYERS: usize = Coverage::MOST / PAIRS;

/// One set of ids, such as those of the objects.
pub(crate) struct Matte<'a> {
    /// Name of the layers, before their number.
    name: &'static str,
    /// What is named in the header, sorted.
    names: Vec<&'a str>,
    /// For each stratum, the name's place among `names`.
    of_stratum: Vec<usize>,
}

impl<'a> Matte<'a> {
    /// A set of ids, from the name of each stratum. Equal names are one id.
    pub fn new(name: &'static str, of_strata: impl Iterator<Item = &'a str> + Clone) -> Self {
        let mut names: Vec<&str> = of_strata.clone().collect();
        names.sort_unstable();
        names.dedup();
        let of_stratum = of_strata.map(|name| names.partition_point(|known| *known < name)).collect();
        Self { name, names, of_stratum }
    }

    /// All channels with their names, row by row.
    pub fn channels(&self, pixels: &[Pixel]) -> Vec<(String, Vec<f32>)> {
        let ids: Vec<f32> = self.names.iter().map(|name| f32::from_bits(id(name))).collect();
        let mut channels: Vec<(String, Vec<f32>)> = Vec::new();
        for layer in 0..LAYERS {
            for letter in ["R", "G", "B", "A"] {
                let name = format!("{}{layer:02}.{letter}", self.name);
                channels.push((name, Vec::with_capacity(pixels.len())));
            }
        }
        for pixel in pixels {
            let ranks = self.ranks(&pixel.coverage);
            for ((place, share), pair) in ranks.into_iter().zip(channels.as_chunks_mut::<2>().0) {
                pair[0].1.push(if share > 0.0 { ids[place] } else { 0.0 });
                pair[1].1.push(share);
            }
        }
        channels
    }

    /// The names that cover a pixel and their shares of its samples, the largest first.
    fn ranks(&self, coverage: &Coverage) -> [(usize, f32); Coverage::MOST] {
        let mut counts = [(0, 0u16); Coverage::MOST];
        for (stratum, samples) in coverage.strata.iter().zip(coverage.samples) {
            let Some(&place) = self.of_stratum.get(*stratum as usize) else { continue };
            // Two strata may share an object or a material.
            if let Some(count) = counts.iter_mut().find(|(known, n)| *n == 0 || *known == place) {
                *count = (place, count.1 + samples);
            }
        }
        counts.sort_by_key(|&(_, samples)| std::cmp::Reverse(samples));
        counts.map(|(place, samples)| (place, f32::from(samples) / f32::from(coverage.all.max(1))))
    }

    /// The attributes of the file's header.
    pub fn attributes(&self) -> [(String, String); 4] {
        let key = &format!("{:08x}", murmur3(self.name.as_bytes()))[..7];
        let attribute = |name: &str, value: String| (format!("cryptomatte/{key}/{name}"), value);
        [
            attribute("name", self.name.into()),
            attribute("hash", "MurmurHash3_32".into()),
            attribute("conversion", "uint32_to_float32".into()),
            attribute("manifest", self.manifest()),
        ]
    }

    /// The names and their ids, as JSON in ASCII.
    fn manifest(&self) -> String {
        let ids: BTreeMap<&str, String> =
            self.names.iter().map(|&name| (name, format!("{:08x}", id(name)))).collect();
        let mut ascii = String::new();
        for c in serde_json::json!(ids).to_string().chars() {
            if c.is_ascii() {
                ascii.push(c);
            } else {
                for unit in c.encode_utf16(&mut [0; 2]) {
                    // Writing to a string does not fail.
                    let _ = write!(ascii, "\\u{unit:04x}");
                }
            }
        }
        ascii
    }
}

/// The bits of a name's id as a float: its hash, with an exponent that is neither 0 nor 255. Such floats
/// would be denormal, infinite or not a number.
fn id(name: &str) -> u32 {
    let hash = murmur3(name.as_bytes());
    if matches!(hash >> 23 & 255, 0 | 255) { hash ^ 1 << 23 } else { hash }
}

/// MurmurHash3_x86_32 with seed 0, by A. Appleby.
fn murmur3(bytes: &[u8]) -> u32 {
    let scrambled = |block: u32| block.wrapping_mul(0xcc9e_2d51).rotate_left(15).wrapping_mul(0x1b87_3593);
    let (blocks, tail) = bytes.as_chunks::<4>();
    let mut hash = 0u32;
    for &block in blocks {
        hash ^= scrambled(u32::from_le_bytes(block));
        hash = hash.rotate_left(13).wrapping_mul(5).wrapping_add(0xe654_6b64);
    }
    hash ^= scrambled(tail.iter().rev().fold(0, |block, &byte| block << 8 | u32::from(byte)));
    hash ^= bytes.len() as u32;
    hash = (hash ^ hash >> 16).wrapping_mul(0x85eb_ca6b);
    hash = (hash ^ hash >> 13).wrapping_mul(0xc2b2_ae35);
    hash ^ hash >> 16
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hashes_are_those_of_the_reference() {
        // Values of `mmh3.hash(name, signed=False)` 5.3.1.
        for (name, expected) in [
            ("hello", 0x248b_fa47),
            ("CryptoObject", 0x3ae3_9a58),
            ("CryptoMaterial", 0xbe35_9d67),
            ("floor", 0x7819_c83c),
            ("a", 0x3c25_69b2),
            ("ab", 0x9bbf_d75f),
            ("abc", 0xb3dd_93fa),
            ("Bär", 0x2e62_0738),
            ("", 0x0000_0000),
        ] {
            assert_eq!(murmur3(name.as_bytes()), expected, "{name}");
        }
    }

    #[test]
    fn ids_are_floats_that_can_be_compared() {
        for i in 0..20_000 {
            assert!(f32::from_bits(id(&format!("name {i}"))).is_normal());
        }
        assert_eq!(id(""), 1 << 23);
    }

    #[test]
    fn strata_of_one_object_are_one_rank_and_the_largest_is_first() {
        let matte = Matte::new("CryptoObject", ["a", "b", "b"].into_iter());
        let coverage = Coverage { strata: [0, 1, 2, Pixel::NOTHING], samples: [3, 2, 2, 0], all: 8 };
        let ranks = matte.ranks(&coverage);
        assert_eq!(ranks[..2], [(1, 0.5), (0, 0.375)]);
        assert!(ranks[2..].iter().all(|rank| rank.1 == 0.0));
        assert!(matte.ranks(&Coverage::NONE).iter().all(|rank| rank.1 == 0.0));
    }

    #[test]
    fn manifests_are_json_in_ascii() {
        let matte = Matte::new("CryptoObject", ["Bär 🐻", "\"q\""].into_iter());
        let manifest = matte.manifest();
        assert!(manifest.is_ascii(), "{manifest}");
        let read: BTreeMap<String, String> = serde_json::from_str(&manifest).unwrap();
        assert_eq!(read["Bär 🐻"], format!("{:08x}", id("Bär 🐻")));
        assert!(read.contains_key("\"q\""));
    }
}
