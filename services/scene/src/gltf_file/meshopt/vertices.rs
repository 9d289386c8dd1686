//! The vertex codec: mode `ATTRIBUTES`, versions 0 and 1.
//!
//! Vertices are stored in blocks. In a block, each byte of the vertices is a channel of its own, and a
//! channel holds differences from vertex to vertex, in groups of 16 with 0 to 8 bits each.

use super::{Input, unzigzag};

const GROUP: usize = 16;
const LARGEST_BLOCK: usize = 256;
const BLOCK_BYTES: usize = 8192;

/// Decodes `count` vertices of `stride` bytes, a multiple of 4.
pub(super) fn decode(stream: &[u8], count: usize, stride: usize) -> Result<Vec<u8>, &'static str> {
    let mut input = Input(stream);
    let version = match input.byte()? {
        0xa0 => 0,
        0xa1 => 1,
        _ => return Err("is not a compressed stream of vertices of version 0 or 1"),
    };
    // The stream ends with the first vertex and, in version 1, a kind of difference for every four bytes.
    let kinds_length = if version == 0 { 0 } else { stride / 4 };
    let padded = (stride + kinds_length).max(if version == 0 { 32 } else { 24 });
    let body = input.0.len().checked_sub(padded).ok_or(Input::ENDED)?;
    let mut input = Input(&input.0[..body]);
    let tail = &stream[stream.len() - stride - kinds_length..];
    let (mut previous, kinds) = (tail[..stride].to_vec(), &tail[stride..]);
    let largest = (BLOCK_BYTES / stride / GROUP * GROUP).min(LARGEST_BLOCK);
    let mut vertices = Vec::new();
    let mut left = count;
    while left > 0 {
        let size = left.min(largest);
        let start = vertices.len();
        let controls = input.take(kinds_length)?;
        vertices.resize(start + size * stride, 0);
        for word in 0..stride / 4 {
            let control = controls.get(word).copied();
            let channels = channels(&mut input, size, control)?;
            let kind = kinds.get(word).copied().unwrap_or(0);
            let first = [0, 1, 2, 3].map(|byte| previous[word * 4 + byte]);
            let words = vertices[start..].chunks_exact_mut(stride).map(|vertex| &mut vertex[word * 4..][..4]);
            sum(&channels, kind, first, words)?;
        }
        previous.copy_from_slice(&vertices[start + (size - 1) * stride..]);
        left -= size;
    }
    if input.0.is_empty() { Ok(vertices) } else { Err(Input::TOO_LONG) }
}

/// Reads four channels of differences.
fn channels(
    input: &mut Input<'_>,
    size: usize,
    control: Option<u8>,
) -> Result<[[u8; LARGEST_BLOCK]; 4], &'static str> {
    let mut channels = [[0; LARGEST_BLOCK]; 4];
    for (i, channel) in channels.iter_mut().enumerate() {
        match control.map(|control| control >> (2 * i) & 3) {
            None => groups(input, channel, size, [0, 2, 4, 8])?,
            Some(0) => groups(input, channel, size, [0, 1, 2, 4])?,
            Some(1) => groups(input, channel, size, [1, 2, 4, 8])?,
            Some(2) => {}
            Some(_) => channel[..size].copy_from_slice(input.take(size)?),
        }
    }
    Ok(channels)
}

/// Reads groups of 16 values, after a header with two bits per group that choose from `widths`.
fn groups(
    input: &mut Input<'_>,
    channel: &mut [u8; LARGEST_BLOCK],
    size: usize,
    widths: [u32; 4],
) -> Result<(), &'static str> {
    let count = size.div_ceil(GROUP);
    let header = input.take(count.div_ceil(4))?;
    for (i, group) in channel.chunks_exact_mut(GROUP).take(count).enumerate() {
        let bits = widths[usize::from(header[i / 4] >> (2 * (i % 4)) & 3)];
        if bits == 0 {
            group.fill(0);
            continue;
        }
        let packed = input.take(GROUP * bits as usize / 8)?;
        if bits == 8 {
            group.copy_from_slice(packed);
            continue;
        }
        // A value of all ones says that the value follows the packed ones as a whole byte.
        let escape = ((1u32 << bits) - 1) as u8;
        let per_byte = (8 / bits) as usize;
        for (k, value) in group.iter_mut().enumerate() {
            let (byte, place) = (packed[k / per_byte], (k % per_byte) as u32);
            // The first value is in the highest bits, but in the lowest ones if values have one bit.
            let shift = if bits == 1 { place } else { 8 - bits * (place + 1) };
            let small = byte >> shift & escape;
            *value = if small == escape { input.byte()? } else { small };
        }
    }
    Ok(())
}

/// Sums differences to four bytes of each vertex. The kinds are bytes, 16-bit integers, and exclusive-or of
/// rotated 32-bit integers.
fn sum<'v>(
    channels: &[[u8; LARGEST_BLOCK]; 4],
    kind: u8,
    first: [u8; 4],
    words: impl Iterator<Item = &'v mut [u8]>,
) -> Result<(), &'static str> {
    let read = |i: usize| [0, 1, 2, 3].map(|channel: usize| channels[channel][i]);
    let mut last = first;
    match kind & 3 {
        0 => {
            for (i, word) in words.enumerate() {
                let differences = read(i);
                for (value, difference) in last.iter_mut().zip(differences) {
                    *value = value.wrapping_add(unzigzag(u32::from(difference)) as u8);
                }
                word.copy_from_slice(&last);
            }
        }
        1 => {
            for (i, word) in words.enumerate() {
                let [a, b, c, d] = read(i);
                let add = |value: [u8; 2], difference: [u8; 2]| {
                    let difference = unzigzag(u32::from(u16::from_le_bytes(difference))) as u16;
                    u16::from_le_bytes(value).wrapping_add(difference).to_le_bytes()
                };
                let [low, high] = [add([last[0], last[1]], [a, b]), add([last[2], last[3]], [c, d])];
                last = [low[0], low[1], high[0], high[1]];
                word.copy_from_slice(&last);
            }
        }
        2 => {
            let rotation = u32::from(kind >> 4);
            for (i, word) in words.enumerate() {
                let difference = u32::from_le_bytes(read(i)).rotate_right(rotation);
                last = (u32::from_le_bytes(last) ^ difference).to_le_bytes();
                word.copy_from_slice(&last);
            }
        }
        _ => return Err("a kind of difference is not one of 0, 1, 2"),
    }
    Ok(())
}
