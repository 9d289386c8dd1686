//! What the files of pixels have in common: their frame, and how a pixel is written.
//!
//! Little-endian: magic bytes, origin, fingerprint, number of pixels, contents, BLAKE3 hash of everything
//! before.

use crate::pixel::Coverage;
use crate::{Origin, Pixel};

/// Bytes before the contents.
pub(crate) const HEADER: usize = 8 + Origin::BYTES + 32 + 4;
/// Bytes of a pixel.
pub(crate) const PIXEL: usize = 12 + 28 + 8 + 56 + 8 + 8 + 4 + 4 + (4 + 2) * Coverage::MOST + 2;
/// Bytes of the hash at the end.
pub(crate) const CHECKSUM: usize = 32;

/// Why bytes are not a valid file of pixels.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum PixelFileError {
    /// The magic bytes are wrong.
    #[error("not of this version (it must begin with {expected})")]
    Foreign {
        /// The magic bytes.
        expected: &'static str,
    },
    /// The length differs from what the contents say.
    #[error("damaged: it has {found} bytes instead of {expected}")]
    Length {
        /// Actual number of bytes.
        found: usize,
        /// Number of bytes according to the contents.
        expected: usize,
    },
    /// The checksum, or a number in the contents, is wrong.
    #[error("damaged: its checksum or its contents do not match")]
    Damaged,
}

/// The image that the pixels of a file belong to, and their number.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Header {
    pub origin: Origin,
    pub fingerprint: [u8; 32],
    pub count: u32,
}

impl Header {
    /// Begins a file of about so many bytes.
    pub fn begin(&self, magic: &str, bytes: usize) -> Vec<u8> {
        let mut out = Vec::with_capacity(HEADER + bytes + CHECKSUM);
        out.extend_from_slice(magic.as_bytes());
        out.extend_from_slice(bytemuck::bytes_of(&self.origin));
        out.extend_from_slice(&self.fingerprint);
        out.extend_from_slice(&self.count.to_le_bytes());
        out
    }

    /// Checks magic bytes and checksum. Returns the header and the contents.
    pub fn read<'a>(bytes: &'a [u8], magic: &'static str) -> Result<(Self, Reader<'a>), PixelFileError> {
        if !bytes.starts_with(magic.as_bytes()) {
            return Err(PixelFileError::Foreign { expected: magic });
        }
        if bytes.len() < HEADER + CHECKSUM {
            return Err(PixelFileError::Length { found: bytes.len(), expected: HEADER + CHECKSUM });
        }
        let (body, checksum) = bytes.split_at(bytes.len() - CHECKSUM);
        if blake3::hash(body).as_bytes() != checksum {
            return Err(PixelFileError::Damaged);
        }
        let mut reader = Reader { bytes: &body[magic.len()..] };
        let mut header = || {
            let origin = bytemuck::pod_read_unaligned(&reader.array::<{ Origin::BYTES }>()?);
            Some(Self { origin, fingerprint: reader.array()?, count: reader.u32()? })
        };
        let header = header().ok_or(PixelFileError::Damaged)?;
        Ok((header, reader))
    }
}

/// Ends a file.
pub(crate) fn sealed(mut out: Vec<u8>) -> Vec<u8> {
    let checksum = blake3::hash(&out);
    out.extend_from_slice(checksum.as_bytes());
    out
}

/// Writes a pixel: colour, rays, work, work by ray, extra work, CPU nanoseconds, uncovered, stratum, strata
/// of the coverage, their samples, all samples.
pub(crate) fn push_pixel(out: &mut Vec<u8>, pixel: &Pixel) {
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

/// Reads a file's contents. Every method returns `None` at its end.
pub(crate) struct Reader<'a> {
    bytes: &'a [u8],
}

impl<'a> Reader<'a> {
    /// Bytes that are left.
    pub fn left(&self) -> usize {
        self.bytes.len()
    }

    pub fn bytes(&mut self, count: usize) -> Option<&'a [u8]> {
        let (head, rest) = self.bytes.split_at_checked(count)?;
        self.bytes = rest;
        Some(head)
    }

    pub fn array<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (head, rest) = self.bytes.split_first_chunk()?;
        self.bytes = rest;
        Some(*head)
    }

    pub fn u8(&mut self) -> Option<u8> {
        self.array().map(u8::from_le_bytes)
    }

    pub fn u16(&mut self) -> Option<u16> {
        self.array().map(u16::from_le_bytes)
    }

    pub fn u32(&mut self) -> Option<u32> {
        self.array().map(u32::from_le_bytes)
    }

    pub fn u64(&mut self) -> Option<u64> {
        self.array().map(u64::from_le_bytes)
    }

    pub fn f64(&mut self) -> Option<f64> {
        self.array().map(f64::from_le_bytes)
    }

    /// What [`push_pixel`] wrote.
    pub fn pixel(&mut self) -> Option<Pixel> {
        let mut color = [0.0; 3];
        for channel in &mut color {
            *channel = f32::from_le_bytes(self.array()?);
        }
        let mut rays = [0; 7];
        for count in &mut rays {
            *count = self.u32()?;
        }
        let work = self.u64()?;
        let mut work_by_ray = [0; 7];
        for work in &mut work_by_ray {
            *work = self.u64()?;
        }
        let (extra_work, cpu_nanos) = (self.u64()?, self.u64()?);
        let (uncovered, stratum) = (self.u32()?, self.u32()?);
        let mut coverage = Coverage::NONE;
        for stratum in &mut coverage.strata {
            *stratum = self.u32()?;
        }
        for samples in &mut coverage.samples {
            *samples = self.u16()?;
        }
        coverage.all = self.u16()?;
        Some(Pixel { color, rays, work, work_by_ray, extra_work, cpu_nanos, uncovered, stratum, coverage })
    }
}
