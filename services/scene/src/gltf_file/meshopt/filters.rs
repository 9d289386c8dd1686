//! The filters that turn decoded attributes into values. All work in place on elements of four components.

/// A component of `size` bytes (1 or 2), as a signed or unsigned number.
fn get(element: &[u8], component: usize, size: usize, signed: bool) -> i32 {
    match (size, signed) {
        (1, true) => i32::from(element[component] as i8),
        (1, false) => i32::from(element[component]),
        _ => {
            let bits = u16::from_le_bytes([element[2 * component], element[2 * component + 1]]);
            if signed { i32::from(bits as i16) } else { i32::from(bits) }
        }
    }
}

fn set(element: &mut [u8], component: usize, size: usize, value: i32) {
    element[component * size..][..size].copy_from_slice(&value.to_le_bytes()[..size]);
}

/// Rounds halves away from zero.
fn rounded(value: f32) -> i32 {
    (value + if value >= 0.0 { 0.5 } else { -0.5 }) as i32
}

/// `OCTAHEDRAL`: unit vectors from octahedral coordinates. The third component is 1 at their precision. The
/// fourth is kept.
pub(super) fn octahedral(bytes: &mut [u8], size: usize) {
    let one = ((1 << (8 * size - 1)) - 1) as f32;
    for element in bytes.chunks_exact_mut(4 * size) {
        let [mut x, mut y, scale] = [0, 1, 2].map(|c| get(element, c, size, true) as f32);
        let z = scale - x.abs() - y.abs();
        let fold = z.min(0.0);
        x += if x >= 0.0 { fold } else { -fold };
        y += if y >= 0.0 { fold } else { -fold };
        let scale = one / (x * x + y * y + z * z).sqrt();
        for (component, value) in [x, y, z].into_iter().enumerate() {
            set(element, component, size, rounded(value * scale));
        }
    }
}

/// `QUATERNION`: unit quaternions of 16-bit components, from the three smaller components. The fourth holds
/// their precision and, in its lowest two bits, which component was left out.
pub(super) fn quaternion(bytes: &mut [u8]) {
    for element in bytes.chunks_exact_mut(8) {
        let [x, y, z] = [0, 1, 2].map(|c| get(element, c, 2, true) as f32);
        let last = get(element, 3, 2, true);
        let one = (last | 3) as f32;
        let w = (one * one * 2.0 - x * x - y * y - z * z).max(0.0).sqrt();
        let scale = 32767.0 / std::f32::consts::SQRT_2 / one;
        for (i, value) in [w, x, y, z].into_iter().enumerate() {
            let component = ((last & 3) as usize + i) % 4;
            set(element, component, 2, rounded(value * scale));
        }
    }
}

/// `EXPONENTIAL`: floats from a mantissa of 24 bits and an exponent of 8 bits.
pub(super) fn exponential(bytes: &mut [u8]) {
    for element in bytes.chunks_exact_mut(4) {
        let bits = i32::from_le_bytes([element[0], element[1], element[2], element[3]]);
        let (exponent, mantissa) = (bits >> 24, bits << 8 >> 8);
        let power = f32::from_bits(((exponent + 127) as u32) << 23);
        element.copy_from_slice(&(power * mantissa as f32).to_le_bytes());
    }
}

/// `COLOR` (only in `KHR_meshopt_compression`): RGBA from YCoCg. The highest bit of alpha gives the
/// precision.
pub(super) fn color(bytes: &mut [u8], size: usize) {
    let one = ((1 << (8 * size)) - 1) as f32;
    for element in bytes.chunks_exact_mut(4 * size) {
        let alpha = get(element, 3, size, false);
        let precision = (1..i32::BITS).rev().fold(alpha, |bits, _| bits | bits >> 1);
        let luma = get(element, 0, size, false);
        let [orange, green] = [1, 2].map(|c| get(element, c, size, true));
        let alpha = alpha << 1 & precision | alpha & 1;
        let scale = one / precision as f32;
        let rgba = [luma + orange - green, luma + green, luma - orange - green, alpha];
        for (component, value) in rgba.into_iter().enumerate() {
            set(element, component, size, (value as f32 * scale + 0.5) as i32);
        }
    }
}
