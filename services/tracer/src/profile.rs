//! Profiles: pixels, or the cache, that were finished during a forecast. The render takes them over.

use crate::pixel::Coverage;
use crate::{Origin, Pixel};

/// Magic bytes of the format, including its version.
const MAGIC: &[u8; 8] = b"FLprof07";
const HEADER: usize = 8 + Origin::BYTES + 32 + 4 + 8;
const PIXEL: usize = 4 + 12 + 28 + 8 + 56 + 8 + 8 + 4 + 4 + (4 + 2) * Coverage::MOST + 2;
const CHECKSUM: usize = 32;

/// Finished pixels of one frame, or its irradiance cache, since colours are unknown until the cache is
/// filled.
#[derive(Debug, Clone, PartialEq)]
pub struct Profile {
    /// The frame and settings that it was made for.
    pub origin: Origin,
    /// [`crate::Tracer::fingerprint`] of the image that the pixels belong to.
    pub fingerprint: [u8; 32],
    /// Row-major index and value of each pixel.
    pub pixels: Vec<(u32, Pixel)>,
    /// The cache in its own format: planned, with the records gathered so far. Never empty.
    pub cache: Option<Vec<u8>>,
}

/// Why bytes are not a valid profile.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ProfileError {
    /// The magic bytes are wrong.
    #[error("not a profile of this version (it must begin with FLprof07)")]
    Foreign,
    /// The length differs from what the header says.
    #[error("damaged profile: it has {found} bytes instead of {expected}")]
    Length {
        /// Actual number of bytes.
        found: usize,
        /// Number of bytes according to the header.
        expected: usize,
    },
    /// The checksum is wrong.
    #[error("damaged profile: the checksum does not match")]
    Damaged,
}

impl Profile {
    /// Serialises the profile, little-endian: magic, origin, fingerprint, number of pixels, size of the cache
    /// (0 without one), pixels, cache, BLAKE3 hash of everything before. A pixel is: index, colour, rays,
    /// work, work by ray, extra work, CPU nanoseconds, uncovered, stratum, strata of the coverage, their
    /// samples, all samples.
    pub fn to_bytes(&self) -> Vec<u8> {
        let cache = self.cache.as_deref().unwrap_or_default();
        let mut out = Vec::with_capacity(HEADER + self.pixels.len() * PIXEL + cache.len() + CHECKSUM);
        out.extend_from_slice(MAGIC);
        out.extend_from_slice(bytemuck::bytes_of(&self.origin));
        out.extend_from_slice(&self.fingerprint);
        out.extend_from_slice(&(self.pixels.len() as u32).to_le_bytes());
        out.extend_from_slice(&(cache.len() as u64).to_le_bytes());
        for (index, pixel) in &self.pixels {
            out.extend_from_slice(&index.to_le_bytes());
            pixel.color.iter().for_each(|c| out.extend_from_slice(&c.to_le_bytes()));
            pixel.rays.iter().for_each(|r| out.extend_from_slice(&r.to_le_bytes()));
            out.extend_from_slice(&pixel.work.to_le_bytes());
            pixel.work_by_ray.iter().for_each(|w| out.extend_from_slice(&w.to_le_bytes()));
            out.extend_from_slice(&pixel.extra_work.to_le_bytes());
            out.extend_from_slice(&pixel.cpu_nanos.to_le_bytes());
            out.extend_from_slice(&pixel.uncovered.to_le_bytes());
            out.extend_from_slice(&pixel.stratum.to_le_bytes());
            let Coverage { strata, samples, all } = pixel.coverage;
            strata.iter().for_each(|s| out.extend_from_slice(&s.to_le_bytes()));
            samples.iter().chain([&all]).for_each(|n| out.extend_from_slice(&n.to_le_bytes()));
        }
        out.extend_from_slice(cache);
        let checksum = blake3::hash(&out);
        out.extend_from_slice(checksum.as_bytes());
        out
    }

    /// Parses the output of [`Self::to_bytes`]. Fails if the bytes are not a profile of this version, have
    /// the wrong length, or are damaged.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, ProfileError> {
        if bytes.len() < 8 || &bytes[..8] != MAGIC {
            return Err(ProfileError::Foreign);
        }
        let length = |expected| Err(ProfileError::Length { found: bytes.len(), expected });
        if bytes.len() < HEADER + CHECKSUM {
            return length(HEADER + CHECKSUM);
        }
        let mut reader = Reader { bytes: &bytes[8..] };
        let origin = bytemuck::pod_read_unaligned(&reader.take::<{ Origin::BYTES }>());
        let fingerprint = reader.take();
        let count = reader.u32() as usize;
        let cache = usize::try_from(reader.u64()).unwrap_or(usize::MAX);
        let expected = (HEADER + count * PIXEL + CHECKSUM).saturating_add(cache);
        if bytes.len() != expected {
            return length(expected);
        }
        let (body, checksum) = bytes.split_at(bytes.len() - CHECKSUM);
        if blake3::hash(body).as_bytes() != checksum {
            return Err(ProfileError::Damaged);
        }
        let pixels = (0..count)
            .map(|_| {
                let index = reader.u32();
                let color = std::array::from_fn(|_| f32::from_le_bytes(reader.take()));
                let rays = std::array::from_fn(|_| reader.u32());
                let work = reader.u64();
                let work_by_ray = std::array::from_fn(|_| reader.u64());
                let (extra_work, cpu_nanos) = (reader.u64(), reader.u64());
                let (uncovered, stratum) = (reader.u32(), reader.u32());
                let strata = std::array::from_fn(|_| reader.u32());
                let samples = std::array::from_fn(|_| u16::from_le_bytes(reader.take()));
                let coverage = Coverage { strata, samples, all: u16::from_le_bytes(reader.take()) };
                let pixel = Pixel {
                    color,
                    rays,
                    work,
                    work_by_ray,
                    extra_work,
                    cpu_nanos,
                    uncovered,
                    stratum,
                    coverage,
                };
                (index, pixel)
            })
            .collect();
        let cache = (cache > 0).then(|| body[body.len() - cache..].to_vec());
        Ok(Self { origin, fingerprint, pixels, cache })
    }

    /// Size in bytes of a profile with this number of pixels and no cache.
    pub const fn bytes_of(pixels: u64) -> u64 {
        pixels.saturating_mul(PIXEL as u64).saturating_add((HEADER + CHECKSUM) as u64)
    }

    /// Returns `true` if every pixel index is below `pixels`, the number of pixels in the image.
    pub fn fits(&self, pixels: usize) -> bool {
        self.pixels.iter().all(|p| (p.0 as usize) < pixels)
    }
}

/// Reads from bytes whose length is already checked.
struct Reader<'a> {
    bytes: &'a [u8],
}

impl Reader<'_> {
    fn take<const N: usize>(&mut self) -> [u8; N] {
        let (head, rest) = self.bytes.split_at(N);
        self.bytes = rest;
        std::array::from_fn(|i| head[i])
    }

    fn u32(&mut self) -> u32 {
        u32::from_le_bytes(self.take())
    }

    fn u64(&mut self) -> u64 {
        u64::from_le_bytes(self.take())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn profile() -> Profile {
        let pixel = |i| Pixel {
            color: [0.5, f32::MIN_POSITIVE, 3.0e7],
            rays: [1, 2, 3, 4, 5, 6, i],
            work: u64::MAX - 7,
            work_by_ray: [u64::MAX, 2, 3, 4, 5, 6, 7],
            extra_work: 1 << 40,
            cpu_nanos: 12_345,
            uncovered: 3,
            stratum: i,
            coverage: Coverage { strata: [i, 9, u32::MAX, 7], samples: [1, 20, 300, 65_535], all: 65_535 },
        };
        let pixels = (0..5).map(|i| (i * 31, pixel(i))).collect();
        Profile { origin: Origin::default(), fingerprint: [9; 32], pixels, cache: Some(b"records".to_vec()) }
    }

    #[test]
    fn a_profile_reads_back_as_it_was_written() {
        assert_eq!(Profile::from_bytes(&profile().to_bytes()), Ok(profile()));
        let without = Profile { cache: None, ..profile() };
        assert_eq!(Profile::from_bytes(&without.to_bytes()), Ok(without));
        let empty = Profile { pixels: Vec::new(), ..profile() };
        assert_eq!(Profile::from_bytes(&empty.to_bytes()), Ok(empty));
    }

    #[test]
    fn every_truncation_and_every_flipped_bit_is_refused() {
        let bytes = profile().to_bytes();
        for length in 0..bytes.len() {
            assert!(Profile::from_bytes(&bytes[..length]).is_err(), "{length} bytes were accepted");
        }
        for bit in 0..bytes.len() * 8 {
            let mut damaged = bytes.clone();
            damaged[bit / 8] ^= 1 << (bit % 8);
            assert!(Profile::from_bytes(&damaged).is_err(), "bit {bit} was not missed");
        }
    }
}
