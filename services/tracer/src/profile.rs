//! Profiles: pixels, or the cache, that were finished during a forecast. The render takes them over.

use crate::pixel_file::{CHECKSUM, HEADER, Header, PIXEL, PixelFileError, push_pixel, sealed};
use crate::{Origin, Pixel};

/// Magic bytes of the format, including its version.
const MAGIC: &str = "FLprof07";
/// Bytes of the size of the cache.
const CACHE_SIZE: usize = 8;
/// Bytes of a pixel and its index.
const INDEXED: usize = 4 + PIXEL;

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

impl Profile {
    /// Serialises the profile. Its contents are the size of the cache (0 without one), each pixel's index and
    /// the pixel, and the cache.
    pub fn to_bytes(&self) -> Vec<u8> {
        let cache = self.cache.as_deref().unwrap_or_default();
        let count = self.pixels.len() as u32;
        let header = Header { origin: self.origin, fingerprint: self.fingerprint, count };
        let mut out = header.begin(MAGIC, CACHE_SIZE + self.pixels.len() * INDEXED + cache.len());
        out.extend_from_slice(&(cache.len() as u64).to_le_bytes());
        for (index, pixel) in &self.pixels {
            out.extend_from_slice(&index.to_le_bytes());
            push_pixel(&mut out, pixel);
        }
        out.extend_from_slice(cache);
        sealed(out)
    }

    /// Parses the output of [`Self::to_bytes`]. Fails if the bytes are not a profile of this version, have
    /// the wrong length, or are damaged.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, PixelFileError> {
        let (Header { origin, fingerprint, count }, mut reader) = Header::read(bytes, MAGIC)?;
        let cache = reader.u64().ok_or(PixelFileError::Damaged)?;
        let cache = usize::try_from(cache).unwrap_or(usize::MAX);
        let expected = (count as usize * INDEXED).saturating_add(cache);
        if reader.left() != expected {
            let others = HEADER + CACHE_SIZE + CHECKSUM;
            return Err(PixelFileError::Length {
                found: bytes.len(),
                expected: expected.saturating_add(others),
            });
        }
        let mut pixels = Vec::with_capacity(count as usize);
        for _ in 0..count {
            let (index, pixel) = (reader.u32(), reader.pixel());
            pixels.push(index.zip(pixel).ok_or(PixelFileError::Damaged)?);
        }
        let cache = reader.bytes(cache).filter(|cache| !cache.is_empty()).map(<[u8]>::to_vec);
        Ok(Self { origin, fingerprint, pixels, cache })
    }

    /// Size in bytes of a profile with this number of pixels and no cache.
    pub const fn bytes_of(pixels: u64) -> u64 {
        pixels.saturating_mul(INDEXED as u64).saturating_add((HEADER + CACHE_SIZE + CHECKSUM) as u64)
    }

    /// Returns `true` if every pixel index is below `pixels`, the number of pixels in the image.
    pub fn fits(&self, pixels: usize) -> bool {
        self.pixels.iter().all(|p| (p.0 as usize) < pixels)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pixel::Coverage;

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
