//! The index codecs: modes `TRIANGLES` and `INDICES`, versions 0 and 1.

use super::{Input, unzigzag};

/// The last 16 values that were pushed. Before that, all bits are set.
struct Recent<T> {
    values: [T; 16],
    next: usize,
}

impl<T: Copy> Recent<T> {
    fn new(nothing: T) -> Self {
        Self { values: [nothing; 16], next: 0 }
    }

    fn push(&mut self, value: T) {
        self.values[self.next] = value;
        self.next = (self.next + 1) % 16;
    }

    /// The value that was pushed `ago` pushes before the last one.
    fn get(&self, ago: usize) -> T {
        self.values[(self.next + 15 - ago % 16) % 16]
    }
}

fn version(header: u8, kind: u8) -> Result<u8, &'static str> {
    match header.wrapping_sub(kind) {
        version @ 0..=1 => Ok(version),
        _ => Err("is not a compressed stream of indices of version 0 or 1 in this mode"),
    }
}

fn push_index(bytes: &mut Vec<u8>, index: u32, stride: usize) {
    bytes.extend_from_slice(&index.to_le_bytes()[..stride]);
}

/// Decodes `count` indices, in triangles. Each triangle has one code, which refers to edges and vertices of
/// recent triangles where it can.
pub(super) fn triangles(stream: &[u8], count: usize, stride: usize) -> Result<Vec<u8>, &'static str> {
    const TABLE: usize = 16;
    let mut input = Input(stream);
    let version = version(input.byte()?, 0xe0)?;
    let codes = input.take(count / 3)?;
    let (data, table) = input.0.split_at_checked(input.0.len().wrapping_sub(TABLE)).ok_or(Input::ENDED)?;
    let mut decoder = Triangles {
        data: Input(data),
        edges: Recent::new([u32::MAX; 2]),
        vertices: Recent::new(u32::MAX),
        next: 0,
        last: 0,
        fresh_codes: if version == 0 { 15 } else { 13 },
    };
    let mut bytes = Vec::with_capacity(count * stride);
    for &code in codes {
        let triangle = match code {
            0..=0xef => decoder.on_edge(code)?,
            0xf0..=0xfd => decoder.free(table[usize::from(code & 15)], true, false)?,
            0xfe.. => {
                let pair = decoder.data.byte()?;
                if pair == 0 {
                    decoder.next = 0;
                }
                decoder.free(pair, code == 0xfe, true)?
            }
        };
        triangle.into_iter().for_each(|index| push_index(&mut bytes, index, stride));
    }
    if decoder.data.0.is_empty() { Ok(bytes) } else { Err(Input::TOO_LONG) }
}

struct Triangles<'a> {
    /// What does not fit into the codes.
    data: Input<'a>,
    edges: Recent<[u32; 2]>,
    vertices: Recent<u32>,
    /// The lowest index that was not used before.
    next: u32,
    /// The last index that was stored in full.
    last: u32,
    /// Codes of a vertex below this refer to a new or a recent vertex.
    fresh_codes: u8,
}

impl Triangles<'_> {
    fn fresh(&mut self) -> u32 {
        let index = self.next;
        self.next = self.next.wrapping_add(1);
        index
    }

    fn stored(&mut self) -> Result<u32, &'static str> {
        self.last = self.last.wrapping_add(unzigzag(self.data.varint()?));
        Ok(self.last)
    }

    /// A triangle that shares an edge with a recent one.
    fn on_edge(&mut self, code: u8) -> Result<[u32; 3], &'static str> {
        let [a, b] = self.edges.get(usize::from(code >> 4));
        let vertex = code & 15;
        let c = if vertex == 0 {
            self.fresh()
        } else if vertex < self.fresh_codes {
            self.vertices.get(usize::from(vertex))
        } else if vertex == 15 {
            self.stored()?
        } else {
            self.last = if vertex == 13 { self.last.wrapping_sub(1) } else { self.last.wrapping_add(1) };
            self.last
        };
        if vertex == 0 || vertex >= self.fresh_codes {
            self.vertices.push(c);
        }
        self.edges.push([c, b]);
        self.edges.push([a, c]);
        Ok([a, b, c])
    }

    /// A triangle that shares no edge. `pair` holds the codes of its second and third vertex.
    fn free(&mut self, pair: u8, first_is_fresh: bool, may_store: bool) -> Result<[u32; 3], &'static str> {
        let codes = [if first_is_fresh { 0 } else { 15 }, pair >> 4, pair & 15];
        if !may_store && codes.contains(&15) {
            return Err("the table of a compressed stream of triangles is damaged");
        }
        let mut triangle = [0; 3];
        for (index, code) in triangle.iter_mut().zip(codes) {
            *index = match code {
                0 => self.fresh(),
                15 => 0,
                // Code 1 is the last vertex before this triangle.
                recent => self.vertices.get(usize::from(recent) - 1),
            };
        }
        for (index, code) in triangle.iter_mut().zip(codes) {
            if code == 15 {
                *index = self.stored()?;
            }
        }
        let [a, b, c] = triangle;
        for (index, code) in triangle.into_iter().zip(codes) {
            if code == 0 || code == 15 {
                self.vertices.push(index);
            }
        }
        self.edges.push([b, a]);
        self.edges.push([c, b]);
        self.edges.push([a, c]);
        Ok(triangle)
    }
}

/// Decodes `count` indices in any order. Each is a difference to one of two earlier ones.
pub(super) fn sequence(stream: &[u8], count: usize, stride: usize) -> Result<Vec<u8>, &'static str> {
    const TAIL: usize = 4;
    let mut input = Input(stream);
    version(input.byte()?, 0xd0)?;
    let length = input.0.len().checked_sub(TAIL).filter(|&length| length >= count).ok_or(Input::ENDED)?;
    let mut input = Input(&input.0[..length]);
    let mut last = [0u32; 2];
    let mut bytes = Vec::with_capacity(count * stride);
    for _ in 0..count {
        let value = input.varint()?;
        let index = &mut last[(value & 1) as usize];
        *index = index.wrapping_add(unzigzag(value >> 1));
        push_index(&mut bytes, *index, stride);
    }
    if input.0.is_empty() { Ok(bytes) } else { Err(Input::TOO_LONG) }
}
