//! Writes triangles, rays and their hits to a file for other programs.
//!
//! All numbers are little-endian, 32 bits, without padding:
//!
//! | field | type |
//! | --- | --- |
//! | magic | the eight bytes `FLRAYS1\n` |
//! | numbers of vertices, triangles and sets | 3 × u32 |
//! | vertices | 3 × f32 each |
//! | triangles | 3 × u32 each: indices of vertices |
//! | sets, each: | |
//! | – name | 16 bytes of ASCII, padded with zeros |
//! | – query | u32: 0 the closest hit, 1 any hit |
//! | – number of rays | u32 |
//! | – rays, each: origin, t_min, direction, t_max, triangle, t | 8 × f32, u32, f32 |
//!
//! A hit has t in (t_min, t_max]; t_max may be infinite. `triangle` is 2³² − 1 without a hit. Otherwise it is
//! the index of the closest triangle (query 0) or 0 (query 1). `t` is the distance of the closest hit (query
//! 0) or 0.

use super::workload::{Query, RaySet};
use anyhow::Result;
use forelight_scene::Geometry;
use forelight_terminal::atomic_file::write_with;
use forelight_terminal::failure::BadInput;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;

const MAGIC: &[u8; 8] = b"FLRAYS1\n";
const NAME_BYTES: usize = 16;

/// The result of a ray, as in the file.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Answer {
    pub triangle: u32,
    pub t: f32,
}

impl Answer {
    pub const NOTHING: Self = Self { triangle: u32::MAX, t: 0.0 };
    /// A hit of an any-hit query.
    pub const SOMETHING: Self = Self { triangle: 0, t: 0.0 };
}

/// Writes the file. `answers` are by set and ray.
pub fn write(path: &Path, geometry: &Geometry, sets: &[RaySet], answers: &[Vec<Answer>]) -> Result<()> {
    if path.is_dir() {
        return Err(BadInput::new(format!("{} is a folder, not a file", path.display())).into());
    }
    write_with(path, |temporary| {
        let mut out = BufWriter::new(File::create(temporary)?);
        put(&mut out, geometry, sets, answers)?;
        Ok(out.flush()?)
    })
}

fn put(
    out: &mut impl Write,
    geometry: &Geometry,
    sets: &[RaySet],
    answers: &[Vec<Answer>],
) -> std::io::Result<()> {
    out.write_all(MAGIC)?;
    words(out, [geometry.positions.len(), geometry.triangles.len(), sets.len()].map(|n| n as u32))?;
    for position in &geometry.positions {
        words(out, position.to_array().map(f32::to_bits))?;
    }
    for &triangle in &geometry.triangles {
        words(out, triangle)?;
    }
    for (set, answers) in sets.iter().zip(answers) {
        let mut name = [0; NAME_BYTES];
        for (to, from) in name.iter_mut().zip(set.name.bytes()) {
            *to = from;
        }
        out.write_all(&name)?;
        words(out, [u32::from(set.query == Query::Any), set.rays.len() as u32])?;
        for (ray, answer) in set.rays.iter().zip(answers) {
            let ([ox, oy, oz], [dx, dy, dz]) = (ray.origin.to_array(), ray.direction.to_array());
            words(out, [ox, oy, oz, ray.t_min, dx, dy, dz, ray.t_max].map(f32::to_bits))?;
            words(out, [answer.triangle, answer.t.to_bits()])?;
        }
    }
    Ok(())
}

fn words<const N: usize>(out: &mut impl Write, words: [u32; N]) -> std::io::Result<()> {
    words.into_iter().try_for_each(|word| out.write_all(&word.to_le_bytes()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use forelight_bvh::Ray;
    use glam::Vec3;

    #[test]
    fn the_file_is_as_its_description_says() {
        let geometry = Geometry {
            positions: vec![Vec3::X, Vec3::Y, Vec3::Z],
            triangles: vec![[0, 1, 2]],
            ..Geometry::default()
        };
        let rays = vec![Ray::new(Vec3::ZERO, Vec3::ONE)];
        let sets = [RaySet { name: "primary", query: Query::Closest, rays }];
        let mut bytes = Vec::new();
        put(&mut bytes, &geometry, &sets, &[vec![Answer { triangle: 0, t: 0.5 }]]).unwrap();
        assert_eq!(bytes.len(), 8 + 12 + 3 * 12 + 12 + 16 + 8 + 40);
        let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
        assert_eq!(&bytes[..8], b"FLRAYS1\n");
        assert_eq!([8, 12, 16].map(word), [3, 1, 1]);
        assert_eq!(f32::from_bits(word(20)), 1.0);
        assert_eq!([56, 60, 64].map(word), [0, 1, 2]);
        assert_eq!(&bytes[68..84], b"primary\0\0\0\0\0\0\0\0\0");
        assert_eq!([84, 88].map(word), [0, 1]);
        assert_eq!([104, 108, 120].map(|at| f32::from_bits(word(at))), [0.0, 1.0, f32::INFINITY]);
        assert_eq!((word(124), f32::from_bits(word(128))), (0, 0.5));
    }
}
