//! Decodes the streams of `EXT_meshopt_compression` and `KHR_meshopt_compression`, by the specifications of
//! these extensions. A stream is the content of one buffer view.
//!
//! Hazard: a stream of a few bytes may claim many elements. Output grows as input is read, and a byte of
//! input gives at most about a thousand bytes of output.

mod filters;
mod indices;
mod vertices;

use serde::Deserialize;

/// The extension object of a buffer view: where the stream is, and what it decodes to.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Compressed {
    /// Index of the buffer with the stream.
    pub(super) buffer: usize,
    /// First byte of the stream in its buffer.
    #[serde(default)]
    pub(super) byte_offset: usize,
    /// Bytes of the stream.
    pub(super) byte_length: usize,
    /// Bytes of one decoded element.
    byte_stride: usize,
    /// Number of decoded elements.
    count: usize,
    mode: Mode,
    #[serde(default)]
    filter: Filter,
}

/// What the elements are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "UPPERCASE")]
enum Mode {
    Attributes,
    Triangles,
    Indices,
}

/// What is done to decoded attributes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "UPPERCASE")]
enum Filter {
    #[default]
    None,
    Octahedral,
    Quaternion,
    Exponential,
    Color,
}

impl Compressed {
    /// Number of bytes after decoding. `None` if it does not fit.
    pub(super) fn decoded_length(&self) -> Option<usize> {
        self.count.checked_mul(self.byte_stride)
    }

    /// Decodes a stream. Fails with a reason if it is malformed, or does not fit the extension object.
    pub(super) fn decode(&self, stream: &[u8]) -> Result<Vec<u8>, &'static str> {
        let stride = self.byte_stride;
        let fits = match self.mode {
            Mode::Attributes => stride.is_multiple_of(4) && (4..=256).contains(&stride),
            Mode::Triangles | Mode::Indices => stride == 2 || stride == 4,
        };
        if !fits {
            return Err("`byteStride` is not allowed in this mode");
        }
        if self.mode == Mode::Triangles && !self.count.is_multiple_of(3) {
            return Err("`count` is not a multiple of 3, as triangles need");
        }
        let filter_fits = match self.filter {
            Filter::None => true,
            _ if self.mode != Mode::Attributes => false,
            Filter::Octahedral | Filter::Color => stride == 4 || stride == 8,
            Filter::Quaternion => stride == 8,
            Filter::Exponential => true,
        };
        if !filter_fits {
            return Err("`filter` is not allowed in this mode or with this `byteStride`");
        }
        let mut bytes = match self.mode {
            Mode::Attributes => vertices::decode(stream, self.count, stride)?,
            Mode::Triangles => indices::triangles(stream, self.count, stride)?,
            Mode::Indices => indices::sequence(stream, self.count, stride)?,
        };
        match self.filter {
            Filter::None => {}
            Filter::Octahedral => filters::octahedral(&mut bytes, stride / 4),
            Filter::Quaternion => filters::quaternion(&mut bytes),
            Filter::Exponential => filters::exponential(&mut bytes),
            Filter::Color => filters::color(&mut bytes, stride / 4),
        }
        Ok(bytes)
    }
}

/// Reads a stream from its beginning.
struct Input<'a>(&'a [u8]);

impl<'a> Input<'a> {
    const ENDED: &'static str = "the compressed stream is truncated";
    const TOO_LONG: &'static str = "the compressed stream is longer than its elements";

    fn take(&mut self, length: usize) -> Result<&'a [u8], &'static str> {
        let (taken, rest) = self.0.split_at_checked(length).ok_or(Self::ENDED)?;
        self.0 = rest;
        Ok(taken)
    }

    fn byte(&mut self) -> Result<u8, &'static str> {
        Ok(self.take(1)?[0])
    }

    /// A number of up to five groups of seven bits, least significant first.
    fn varint(&mut self) -> Result<u32, &'static str> {
        let mut value = 0;
        for shift in (0..35).step_by(7) {
            let byte = self.byte()?;
            value |= u32::from(byte & 127) << shift;
            if byte < 128 {
                break;
            }
        }
        Ok(value)
    }
}

/// Undoes zigzag encoding: 0, 1, 2, 3 become 0, -1, 1, -2 (modulo 2³²).
fn unzigzag(value: u32) -> u32 {
    (value >> 1) ^ (value & 1).wrapping_neg()
}

#[cfg(test)]
mod tests;
