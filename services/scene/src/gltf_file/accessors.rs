//! Reads the numbers in glTF buffers, with types and bounds checked. The iterators of the `gltf` crate panic
//! on unexpected types.

use super::document::Opened;
use crate::error::SceneError;
use gltf::Accessor;
use gltf::accessor::sparse::IndexType;
use gltf::accessor::{DataType, Dimensions};

impl Opened {
    /// All elements of an accessor with `N` components. Normalised integers become fractions; others keep
    /// their value (`KHR_mesh_quantization`). `most` limits the number of elements, because a file may claim
    /// more than it holds.
    pub(super) fn floats<const N: usize>(
        &self,
        accessor: &Accessor<'_>,
        most: u64,
    ) -> Result<Vec<[f32; N]>, SceneError> {
        let pointer = format!("/accessors/{}", accessor.index());
        let expected = [Dimensions::Scalar, Dimensions::Vec2, Dimensions::Vec3, Dimensions::Vec4]
            .get(N.wrapping_sub(1))
            .copied();
        if expected != Some(accessor.dimensions()) {
            let reason = format!("is of type {:?} where {N} components are needed", accessor.dimensions());
            return self.fail(&pointer, reason);
        }
        self.check_count(accessor, most)?;
        let (kind, normalised) = (accessor.data_type(), accessor.normalized());
        let read = |bytes: &[u8]| {
            let size = bytes.len() / N;
            std::array::from_fn(|c| component(&bytes[c * size..(c + 1) * size], kind, normalised))
        };
        let mut elements = self.elements(accessor, N * size_of(kind), [0.0; N], &read)?;
        self.apply_sparse(accessor, N * size_of(kind), &mut elements, &read)?;
        if let Some(i) = elements.iter().position(|e| e.iter().any(|c| !c.is_finite())) {
            return self.fail(&pointer, format!("element {i} is not finite"));
        }
        Ok(elements)
    }

    /// All elements of an accessor of vertex indices.
    pub(super) fn indices(&self, accessor: &Accessor<'_>, most: u64) -> Result<Vec<u32>, SceneError> {
        let pointer = format!("/accessors/{}", accessor.index());
        let kind = accessor.data_type();
        if accessor.dimensions() != Dimensions::Scalar
            || !matches!(kind, DataType::U8 | DataType::U16 | DataType::U32)
        {
            return self.fail(&pointer, "indices must be unsigned integer scalars");
        }
        self.check_count(accessor, most)?;
        let mut elements = self.elements(accessor, size_of(kind), 0, &unsigned)?;
        self.apply_sparse(accessor, size_of(kind), &mut elements, &unsigned)?;
        Ok(elements)
    }

    fn check_count(&self, accessor: &Accessor<'_>, most: u64) -> Result<(), SceneError> {
        let found = accessor.count() as u64;
        if found == 0 {
            return self.fail(&format!("/accessors/{}", accessor.index()), "has no element");
        }
        if found > most {
            let file = format!("{}: /accessors/{}", self.file, accessor.index());
            return Err(SceneError::Limit { file, what: "elements", found, limit: most });
        }
        Ok(())
    }

    /// The elements before sparse values replace some of them.
    fn elements<T: Copy>(
        &self,
        accessor: &Accessor<'_>,
        size: usize,
        zero: T,
        read: &impl Fn(&[u8]) -> T,
    ) -> Result<Vec<T>, SceneError> {
        let Some(view) = accessor.view() else { return Ok(vec![zero; accessor.count()]) };
        let pointer = format!("/accessors/{}", accessor.index());
        let stride = view.stride().unwrap_or(size);
        let place =
            Strided { view: view.index(), offset: accessor.offset(), stride, size, count: accessor.count() };
        self.strided(&pointer, place, read)
    }

    fn apply_sparse<T: Copy>(
        &self,
        accessor: &Accessor<'_>,
        size: usize,
        elements: &mut [T],
        read: &impl Fn(&[u8]) -> T,
    ) -> Result<(), SceneError> {
        let Some(sparse) = accessor.sparse() else { return Ok(()) };
        let pointer = format!("/accessors/{}/sparse", accessor.index());
        let count = sparse.count();
        if count > elements.len() {
            return self.fail(&pointer, "replaces more elements than there are");
        }
        let (indices, values) = (sparse.indices(), sparse.values());
        let index_size = match indices.index_type() {
            IndexType::U8 => 1,
            IndexType::U16 => 2,
            IndexType::U32 => 4,
        };
        let packed = |view, offset, size| Strided { view, offset, stride: size, size, count };
        let (view, offset) = (indices.view().index(), indices.offset());
        let places = self.strided(&pointer, packed(view, offset, index_size), &unsigned)?;
        let (view, offset) = (values.view().index(), values.offset());
        let values = self.strided(&pointer, packed(view, offset, size), read)?;
        for (place, value) in places.into_iter().zip(values) {
            match elements.get_mut(place as usize) {
                Some(element) => *element = value,
                None => return self.fail(&pointer, format!("there is no element {place}")),
            }
        }
        Ok(())
    }

    fn strided<T>(
        &self,
        pointer: &str,
        place: Strided,
        read: &impl Fn(&[u8]) -> T,
    ) -> Result<Vec<T>, SceneError> {
        let Strided { view, offset, stride, size, count } = place;
        let bytes = self.view(view)?;
        let last = count.saturating_sub(1).checked_mul(stride).and_then(|o| o.checked_add(offset));
        let end = last.and_then(|o| o.checked_add(size));
        if stride < size || end.is_none_or(|end| end > bytes.len()) {
            return self.fail(pointer, "reaches beyond the end of its buffer view");
        }
        Ok((0..count).map(|i| read(&bytes[offset + i * stride..offset + i * stride + size])).collect())
    }
}

/// Where the elements of an accessor are in a buffer view. Lengths are in bytes.
struct Strided {
    view: usize,
    offset: usize,
    stride: usize,
    size: usize,
    count: usize,
}

fn size_of(kind: DataType) -> usize {
    match kind {
        DataType::I8 | DataType::U8 => 1,
        DataType::I16 | DataType::U16 => 2,
        DataType::U32 | DataType::F32 => 4,
    }
}

/// A little-endian unsigned integer of one to four bytes.
fn unsigned(bytes: &[u8]) -> u32 {
    bytes.iter().rev().fold(0, |value, &byte| value << 8 | u32::from(byte))
}

/// One component. Normalised integers are converted by section 3.6.2.2 of the glTF 2.0 specification.
fn component(bytes: &[u8], kind: DataType, normalised: bool) -> f32 {
    let value = unsigned(bytes);
    let plain = match kind {
        DataType::F32 => return f32::from_bits(value),
        DataType::U32 => return value as f32,
        DataType::I8 => f32::from(value as u8 as i8),
        DataType::U8 => f32::from(value as u8),
        DataType::I16 => f32::from(value as u16 as i16),
        DataType::U16 => f32::from(value as u16),
    };
    if normalised { fraction(plain, kind) } else { plain }
}

/// The fraction that a normalised integer means.
pub(super) fn fraction(value: f32, kind: DataType) -> f32 {
    let largest = match kind {
        DataType::I8 => 127.0,
        DataType::U8 => 255.0,
        DataType::I16 => 32767.0,
        DataType::U16 => 65535.0,
        DataType::U32 | DataType::F32 => return value,
    };
    (value / largest).max(-1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn normalised_integers_become_fractions() {
        assert_eq!(component(&[0x80], DataType::I8, true), -1.0);
        assert_eq!(component(&[127], DataType::I8, true), 1.0);
        assert_eq!(component(&[0xff, 0xff], DataType::U16, true), 1.0);
        assert_eq!(component(&[0x00, 0x80], DataType::I16, false), -32768.0);
        assert_eq!(component(&1.5f32.to_le_bytes(), DataType::F32, false), 1.5);
    }
}
