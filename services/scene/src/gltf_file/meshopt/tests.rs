//! Streams that the reference encoder (npm `meshoptimizer` 1.2.0) made of our own numbers, and what its
//! decoder makes of them.

use super::{Compressed, Filter, Mode};

const POSITIONS_V0: [u8; 195] = [
    160, 31, 0, 47, 47, 47, 47, 47, 240, 47, 47, 47, 47, 47, 240, 47, 47, 47, 47, 47, 240, 47, 47, 47, 47,
    47, 240, 47, 47, 47, 47, 47, 240, 47, 255, 0, 0, 0, 47, 47, 47, 47, 42, 6, 136, 136, 246, 136, 136, 246,
    136, 37, 37, 136, 246, 136, 136, 246, 136, 136, 246, 37, 37, 37, 136, 136, 0, 0, 0, 0, 0, 0, 5, 0, 12, 0,
    192, 47, 47, 12, 0, 192, 12, 47, 47, 47, 5, 0, 12, 0, 192, 6, 8, 12, 0, 192, 12, 8, 8, 8, 31, 0, 88, 87,
    88, 87, 88, 87, 162, 13, 162, 13, 162, 54, 236, 60, 236, 60, 236, 196, 201, 134, 201, 134, 201, 173, 127,
    208, 127, 208, 127, 31, 53, 255, 0, 0, 0, 229, 53, 229, 53, 25, 38, 102, 102, 103, 4, 18, 50, 20, 20, 82,
    2, 4, 114, 55, 0, 0, 0, 4, 4, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0,
    0, 0, 0, 0, 0, 0, 0, 0, 0,
];
const POSITIONS_V1: [u8; 165] = [
    161, 7, 167, 0, 47, 47, 47, 47, 47, 240, 47, 47, 47, 47, 47, 240, 47, 47, 47, 47, 47, 240, 47, 47, 47,
    47, 47, 240, 47, 47, 47, 47, 47, 240, 47, 47, 47, 47, 47, 10, 6, 136, 136, 246, 136, 136, 246, 136, 37,
    37, 136, 246, 136, 136, 246, 136, 136, 246, 37, 37, 37, 15, 0, 8, 8, 8, 8, 5, 64, 16, 47, 47, 4, 65, 47,
    47, 47, 5, 64, 16, 6, 8, 4, 65, 8, 8, 8, 0, 88, 87, 88, 87, 88, 87, 162, 13, 162, 13, 162, 201, 236, 195,
    236, 195, 236, 59, 54, 121, 54, 121, 54, 173, 128, 47, 128, 47, 128, 31, 202, 229, 202, 229, 202, 9, 42,
    170, 170, 230, 3, 18, 83, 19, 19, 99, 19, 19, 131, 10, 0, 3, 3, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0,
    0, 0, 0, 0, 0, 0, 0, 0, 0, 1,
];
const TRIANGLES: [u8; 80] = [
    225, 254, 30, 16, 14, 16, 14, 16, 14, 16, 14, 254, 30, 25, 14, 24, 14, 23, 14, 22, 14, 255, 30, 22, 14,
    22, 14, 22, 14, 22, 14, 255, 30, 22, 14, 22, 14, 22, 14, 22, 14, 255, 30, 22, 14, 22, 14, 22, 14, 22, 14,
    15, 12, 159, 2, 95, 9, 12, 95, 9, 12, 95, 9, 12, 0, 118, 135, 86, 103, 120, 169, 134, 101, 137, 104, 152,
    1, 105, 0, 0,
];
const INDICES: [u8; 155] = [
    209, 0, 4, 20, 18, 24, 2, 18, 4, 20, 18, 24, 2, 18, 4, 20, 18, 24, 2, 18, 4, 20, 18, 24, 2, 18, 4, 20,
    18, 24, 2, 14, 4, 20, 18, 24, 2, 18, 4, 20, 18, 24, 2, 18, 4, 20, 18, 24, 2, 18, 4, 20, 18, 24, 2, 18, 4,
    20, 18, 24, 2, 14, 4, 20, 18, 24, 2, 18, 4, 20, 18, 24, 2, 18, 4, 20, 18, 24, 2, 18, 4, 20, 18, 24, 2,
    18, 4, 20, 18, 24, 2, 14, 4, 20, 18, 24, 2, 18, 4, 20, 18, 24, 2, 18, 4, 20, 18, 24, 2, 18, 4, 20, 18,
    24, 2, 18, 4, 20, 18, 24, 2, 14, 4, 20, 18, 24, 2, 18, 4, 20, 18, 24, 2, 18, 4, 20, 18, 24, 2, 18, 4, 20,
    18, 24, 2, 18, 4, 20, 18, 24, 2, 0, 0, 0, 0,
];
const OCTAHEDRAL_4: [u8; 57] = [
    160, 1, 63, 252, 0, 0, 253, 254, 202, 226, 169, 254, 1, 63, 252, 0, 0, 253, 111, 71, 243, 170, 254, 0, 0,
    0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 127, 0, 127, 0,
];
const OCTAHEDRAL_8: [u8; 75] = [
    160, 1, 39, 244, 0, 0, 128, 44, 169, 2, 13, 239, 233, 224, 0, 0, 0, 0, 17, 1, 47, 244, 0, 0, 221, 117,
    168, 170, 1, 63, 252, 0, 0, 15, 24, 3, 15, 12, 14, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0,
    0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 255, 7, 0, 0, 255, 7, 0, 0,
];
const QUATERNION: [u8; 88] = [
    160, 1, 15, 192, 0, 0, 178, 177, 65, 1, 15, 192, 0, 0, 11, 12, 3, 1, 15, 192, 0, 0, 177, 68, 244, 1, 14,
    192, 0, 0, 10, 7, 1, 15, 192, 0, 0, 177, 178, 199, 1, 15, 192, 0, 0, 10, 9, 7, 1, 51, 0, 0, 0, 5, 6, 0,
    0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 255, 7,
];
const EXPONENTIAL: [u8; 99] = [
    160, 1, 48, 0, 0, 0, 254, 1, 48, 0, 0, 0, 144, 1, 48, 0, 0, 0, 12, 1, 48, 0, 0, 0, 4, 1, 48, 0, 0, 0, 90,
    1, 48, 0, 0, 0, 124, 1, 32, 0, 0, 0, 1, 48, 0, 0, 0, 33, 0, 1, 48, 0, 0, 0, 238, 1, 48, 0, 0, 0, 5, 1,
    48, 0, 0, 0, 30, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 237, 0, 0, 4, 238,
    0, 0, 251, 239,
];
const COLOR: [u8; 42] = [
    161, 255, 0, 76, 203, 1, 0, 156, 102, 0, 0, 126, 0, 0, 0, 125, 127, 254, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0,
    0, 0, 0, 0, 0, 0, 0, 0, 64, 127, 193, 255, 0,
];
const FLOATS_V1: [u8; 101] = [
    161, 127, 0, 146, 0, 145, 155, 23, 180, 200, 0, 199, 179, 214, 222, 155, 155, 199, 146, 0, 145, 155, 0,
    237, 0, 237, 196, 4, 200, 118, 0, 118, 200, 163, 36, 196, 196, 118, 237, 0, 237, 196, 0, 252, 0, 132,
    126, 138, 135, 254, 128, 130, 136, 143, 8, 126, 128, 253, 252, 0, 132, 126, 0, 102, 156, 124, 1, 247,
    249, 246, 248, 1, 126, 3, 0, 124, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0,
    1,
];

/// Six by six points on a curved surface: x, y, z and padding.
fn surface() -> Vec<u8> {
    let point = |i: u16| [i % 6 * 1000, i / 6 * 1000, i % 6 * (i / 6) * 37 + 300 * (i % 2), 0];
    (0..36).flat_map(point).flat_map(u16::to_le_bytes).collect()
}

/// Two triangles in each square of `surface`.
fn squares() -> Vec<u32> {
    let square = |i: u32| [i, i + 1, i + 6, i + 1, i + 7, i + 6];
    (0..30).filter(|i| i % 6 < 5).flat_map(square).collect()
}

fn compressed(mode: Mode, filter: Filter, byte_stride: usize, count: usize) -> Compressed {
    Compressed { buffer: 0, byte_offset: 0, byte_length: 0, byte_stride, count, mode, filter }
}

fn words(bytes: &[u8]) -> Vec<i16> {
    bytes.as_chunks().0.iter().map(|&word| i16::from_le_bytes(word)).collect()
}

#[test]
fn vertices_of_both_versions_come_back() {
    let vertices = compressed(Mode::Attributes, Filter::None, 8, 36);
    assert_eq!(vertices.decode(&POSITIONS_V0), Ok(surface()));
    assert_eq!(vertices.decode(&POSITIONS_V1), Ok(surface()));
    let float = |i: u8| f32::from(i % 5) * 0.25 - f32::from(i % 3) * 1.5e-3;
    let floats = compressed(Mode::Attributes, Filter::None, 4, 20).decode(&FLOATS_V1).unwrap();
    assert!(
        floats.as_chunks().0.iter().zip(0..).all(|(&b, i)| (f32::from_le_bytes(b) - float(i)).abs() < 1e-6)
    );
}

#[test]
fn indices_come_back_and_triangles_may_be_turned() {
    let indices = compressed(Mode::Indices, Filter::None, 4, 150).decode(&INDICES).unwrap();
    assert_eq!(indices, squares().into_iter().flat_map(u32::to_le_bytes).collect::<Vec<u8>>());
    let short = compressed(Mode::Indices, Filter::None, 2, 150).decode(&INDICES).unwrap();
    assert_eq!(words(&short), squares().into_iter().map(|i| i as i16).collect::<Vec<i16>>());
    let triangles = compressed(Mode::Triangles, Filter::None, 2, 150).decode(&TRIANGLES).unwrap();
    for (found, expected) in words(&triangles).chunks(3).zip(squares().chunks(3)) {
        let first = expected.iter().position(|&i| i as i16 == found[0]).unwrap();
        assert!((0..3).all(|k| found[k] == expected[(first + k) % 3] as i16), "{found:?} {expected:?}");
    }
}

#[test]
fn filters_give_what_the_reference_decoder_gives() {
    // The reference's fast decoder may round the last bit in another way.
    let close = |found: &[i16], expected: &[i16]| {
        assert_eq!(found.len(), expected.len());
        assert!(found.iter().zip(expected).all(|(a, b)| a.abs_diff(*b) <= 1), "{found:?} {expected:?}");
    };
    let bytes = compressed(Mode::Attributes, Filter::Octahedral, 4, 7).decode(&OCTAHEDRAL_4).unwrap();
    let found: Vec<i16> = bytes.iter().map(|&byte| i16::from(byte as i8)).collect();
    let expected = [
        127, 0, 0, 0, 0, -127, 0, 0, 76, 0, -102, 0, -46, 61, 102, 0, 73, -73, -74, 0, 0, 0, 127, 0, 0, 0,
        -127, 0,
    ];
    close(&found, &expected);
    let bytes = compressed(Mode::Attributes, Filter::Octahedral, 8, 7).decode(&OCTAHEDRAL_8).unwrap();
    let expected = [
        32767, 0, 0, 0, 0, -32767, 0, 0, 19653, 0, -26219, 0, -11785, 15723, 26222, 0, 18909, -18909, -18937,
        0, 0, 0, 32767, 0, 0, 0, -32767, 0,
    ];
    close(&words(&bytes), &expected);
    let bytes = compressed(Mode::Attributes, Filter::Quaternion, 8, 5).decode(&QUATERNION).unwrap();
    let expected = [
        0, 0, 0, 32767, 32767, 0, 0, 0, 16399, -16378, 16378, 16378, 0, 19661, 0, 26213, -3271, 6554, -9825,
        30389,
    ];
    close(&words(&bytes), &expected);
    let bytes = compressed(Mode::Attributes, Filter::Exponential, 12, 2).decode(&EXPONENTIAL).unwrap();
    let found: Vec<f32> = bytes.as_chunks().0.iter().map(|&word| f32::from_le_bytes(word)).collect();
    assert_eq!(found, [0.0, 1.0, -2.5, 3.141_594, 9.999_989e-6, -123_456.0]);
    let bytes = compressed(Mode::Attributes, Filter::Color, 4, 4).decode(&COLOR).unwrap();
    let expected = [254, 1, 0, 255, 51, 102, 153, 128, 0, 0, 0, 0, 255, 255, 255, 255];
    close(&bytes.into_iter().map(i16::from).collect::<Vec<_>>(), &expected);
}

#[test]
fn streams_that_are_cut_off_or_too_long_are_refused() {
    let cases = [
        (compressed(Mode::Attributes, Filter::None, 8, 36), POSITIONS_V0.as_slice()),
        (compressed(Mode::Attributes, Filter::None, 8, 36), &POSITIONS_V1),
        (compressed(Mode::Triangles, Filter::None, 4, 150), &TRIANGLES),
        (compressed(Mode::Indices, Filter::None, 4, 150), &INDICES),
    ];
    for (view, stream) in cases {
        for length in 0..stream.len() {
            assert!(view.decode(&stream[..length]).is_err(), "{view:?} of {length} bytes was accepted");
        }
        for count in [0, 3, 66, 300, 3_000_000_000] {
            let view = Compressed { count, ..view };
            assert!(view.decode(stream).is_err(), "{view:?} was accepted");
        }
        let longer = [stream, &[0]].concat();
        assert!(view.decode(&longer).is_err() || view.mode == Mode::Attributes, "{view:?}");
    }
}

#[test]
fn damaged_streams_never_end_the_program() {
    let cases = [
        (Mode::Attributes, Filter::Octahedral, 8, 36, POSITIONS_V1.as_slice()),
        (Mode::Attributes, Filter::Exponential, 4, 20, &FLOATS_V1),
        (Mode::Attributes, Filter::Quaternion, 8, 5, &QUATERNION),
        (Mode::Attributes, Filter::Color, 4, 4, &COLOR),
        (Mode::Triangles, Filter::None, 2, 150, &TRIANGLES),
        (Mode::Indices, Filter::None, 4, 150, &INDICES),
    ];
    for (mode, filter, stride, count, stream) in cases {
        for at in 0..stream.len() {
            for value in 0..=u8::MAX {
                let mut stream = stream.to_vec();
                stream[at] = value;
                let decoded = compressed(mode, filter, stride, count).decode(&stream);
                assert!(decoded.is_err() || decoded.is_ok_and(|bytes| bytes.len() == count * stride));
            }
        }
    }
}

#[test]
fn sizes_and_filters_that_do_not_fit_are_refused() {
    for (mode, filter, stride, count) in [
        (Mode::Attributes, Filter::None, 0, 36),
        (Mode::Attributes, Filter::None, 6, 36),
        (Mode::Attributes, Filter::None, 260, 36),
        (Mode::Attributes, Filter::Octahedral, 12, 36),
        (Mode::Attributes, Filter::Quaternion, 4, 36),
        (Mode::Attributes, Filter::Color, 12, 36),
        (Mode::Triangles, Filter::None, 8, 36),
        (Mode::Triangles, Filter::None, 2, 37),
        (Mode::Indices, Filter::Exponential, 4, 36),
    ] {
        let reason = compressed(mode, filter, stride, count).decode(&POSITIONS_V0).unwrap_err();
        assert!(reason.starts_with('`'), "{reason}");
    }
}
