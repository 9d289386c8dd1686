//! Unfinished pixels: what one task of a frame that is refined in passes hands to the next.

use crate::pixel::{Pixel, Underway};
use crate::pixel_file::{Header, PIXEL, PixelFileError, Reader, push_pixel, sealed};
use crate::random::Drawn;
use crate::{Origin, Totals};
use glam::DVec3;

/// Magic bytes of the format, including its version.
const MAGIC: &str = "FLpass01";
/// Bytes of an unfinished pixel without its random sequences.
const FIXED: usize = 4 + 4 + 24 + 8 + 2 * (4 + 24) + PIXEL + 2;
/// Bytes of a random sequence.
const SEQUENCE: usize = 1 + 4;

/// Pixels of one frame with the samples that they have so far. [`crate::Passes`] continues them.
#[derive(Debug, Clone)]
pub struct Unfinished {
    /// The frame and settings that it was made for.
    pub origin: Origin,
    /// [`crate::Tracer::fingerprint`] of the image that the pixels belong to.
    pub fingerprint: [u8; 32],
    /// Row-major index and state of each pixel.
    pub(crate) pixels: Vec<(u32, Underway)>,
}

impl Unfinished {
    /// Serialises the pixels. Each is: index, number of samples, their sum, sum of their squares, number and
    /// sum at the last two powers of two, the pixel, number of random sequences, and each sequence's
    /// dimension and how far it is drawn.
    pub fn to_bytes(&self) -> Vec<u8> {
        let count = self.pixels.len() as u32;
        let header = Header { origin: self.origin, fingerprint: self.fingerprint, count };
        let sequences: usize = self.pixels.iter().map(|(_, pixel)| pixel.drawn.sequences().len()).sum();
        let mut out = header.begin(MAGIC, self.pixels.len() * FIXED + sequences * SEQUENCE);
        let sum = |out: &mut Vec<u8>, sum: DVec3| {
            sum.to_array().iter().for_each(|channel| out.extend_from_slice(&channel.to_le_bytes()));
        };
        for (index, underway) in &self.pixels {
            out.extend_from_slice(&index.to_le_bytes());
            out.extend_from_slice(&underway.samples.to_le_bytes());
            sum(&mut out, underway.sum);
            out.extend_from_slice(&underway.squares.to_le_bytes());
            for (samples, before) in underway.before {
                out.extend_from_slice(&samples.to_le_bytes());
                sum(&mut out, before);
            }
            push_pixel(&mut out, &underway.pixel);
            let sequences = underway.drawn.sequences();
            // A sampler has at most 256 sequences.
            out.extend_from_slice(&(sequences.len() as u16).to_le_bytes());
            for (dimension, drawn) in sequences {
                out.push(*dimension);
                out.extend_from_slice(&drawn.to_le_bytes());
            }
        }
        sealed(out)
    }

    /// Parses the output of [`Self::to_bytes`]. Fails if the bytes are not a file of this version, have the
    /// wrong length, or are damaged.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, PixelFileError> {
        let (Header { origin, fingerprint, count }, mut reader) = Header::read(bytes, MAGIC)?;
        // A damaged count must not reserve memory.
        let mut pixels = Vec::with_capacity((count as usize).min(reader.left() / FIXED));
        for _ in 0..count {
            pixels.push(pixel(&mut reader).ok_or(PixelFileError::Damaged)?);
        }
        match reader.left() {
            0 => Ok(Self { origin, fingerprint, pixels }),
            left => Err(PixelFileError::Length { found: bytes.len(), expected: bytes.len() - left }),
        }
    }

    /// Largest size in bytes of this number of pixels, if each has as many random sequences as pixels of
    /// direct light and diffuse bounces have.
    pub const fn bytes_of(pixels: u64) -> u64 {
        const SEQUENCES: usize = 16;
        pixels.saturating_mul((FIXED + SEQUENCES * SEQUENCE) as u64)
    }

    /// Returns `true` if every pixel index is below `pixels`, the number of pixels in the image.
    pub fn fits(&self, pixels: usize) -> bool {
        self.pixels.iter().all(|(index, _)| (*index as usize) < pixels)
    }

    /// Row-major index of each pixel and its colour so far.
    pub fn colors(&self) -> impl Iterator<Item = (u32, [f32; 3])> {
        self.pixels.iter().map(|(index, underway)| (*index, underway.finished().color))
    }

    /// Cost of all samples.
    pub fn totals(&self) -> Totals {
        Totals::of(self.pixels.iter().map(|(_, underway)| &underway.pixel))
    }
}

fn pixel(reader: &mut Reader<'_>) -> Option<(u32, Underway)> {
    fn sum(reader: &mut Reader<'_>) -> Option<DVec3> {
        Some(DVec3::new(reader.f64()?, reader.f64()?, reader.f64()?))
    }
    let (index, samples) = (reader.u32()?, reader.u32()?);
    let (sum_of_all, squares) = (sum(reader)?, reader.f64()?);
    let mut before = [(0, DVec3::ZERO); 2];
    for (samples, sum_before) in &mut before {
        (*samples, *sum_before) = (reader.u32()?, sum(reader)?);
    }
    let pixel: Pixel = reader.pixel()?;
    let sequences = reader.u16()?;
    let sequences: Option<Vec<_>> = (0..sequences).map(|_| Some((reader.u8()?, reader.u32()?))).collect();
    let drawn = Drawn::of(sequences?)?;
    // A pixel has at most as many samples as [`crate::SampleCounts`] can ask for.
    let fits = samples <= u32::from(u16::MAX);
    fits.then_some((index, Underway { drawn, sum: sum_of_all, squares, samples, before, pixel }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pixel::Coverage;
    use glam::Vec3;

    fn file() -> Unfinished {
        let pixel = |index: u32| {
            let mut underway = Underway::default();
            for sample in 0..index {
                underway.add(Vec3::new(0.25, sample as f32, 1e-30));
            }
            underway.squares = 0.1 * f64::from(index);
            underway.drawn = Drawn::of(vec![(0, index), (191, 7)]).unwrap();
            underway.pixel.work = 1000 * u64::from(index);
            underway.pixel.coverage = Coverage { all: index as u16, ..Coverage::NONE };
            (31 * index, underway)
        };
        Unfinished { origin: Origin::default(), fingerprint: [9; 32], pixels: (0..5).map(pixel).collect() }
    }

    #[test]
    fn a_file_reads_back_as_it_was_written() {
        let bytes = file().to_bytes();
        let read = Unfinished::from_bytes(&bytes).unwrap();
        assert_eq!(read.to_bytes(), bytes);
        assert_eq!((read.totals().pixels, read.totals().work), (5, 10_000));
        assert!(read.fits(125) && !read.fits(124));
        assert!(read.colors().eq(file().colors()));
    }

    #[test]
    fn every_truncation_and_every_flipped_bit_is_refused() {
        let bytes = file().to_bytes();
        for length in 0..bytes.len() {
            assert!(Unfinished::from_bytes(&bytes[..length]).is_err(), "{length} bytes were accepted");
        }
        for bit in 0..bytes.len() * 8 {
            let mut damaged = bytes.clone();
            damaged[bit / 8] ^= 1 << (bit % 8);
            assert!(Unfinished::from_bytes(&damaged).is_err(), "bit {bit} was not missed");
        }
    }

    #[test]
    fn sequences_and_numbers_of_samples_that_cannot_be_are_refused() {
        assert!(Drawn::of(vec![(192, 1)]).is_none());
        let mut file = file();
        file.pixels[0].1.samples = 65_536;
        assert_eq!(Unfinished::from_bytes(&file.to_bytes()).unwrap_err(), PixelFileError::Damaged);
    }
}
