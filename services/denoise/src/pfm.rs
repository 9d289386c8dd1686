//! Portable float maps: three 32-bit floats for each pixel, rows from the bottom
//! (<https://www.pauldebevec.com/Research/HDR/PFM/>).

use std::io::{Error, ErrorKind, Result};

/// Bytes of one pixel.
const PIXEL: usize = 12;

/// The file of an image whose rows come from the top.
pub fn write((width, height): (u32, u32), pixels: &[[f32; 3]]) -> Vec<u8> {
    // The negative scale says little-endian.
    let mut file = format!("PF\n{width} {height}\n-1.0\n").into_bytes();
    file.reserve(PIXEL * pixels.len());
    for row in pixels.chunks(width.max(1) as usize).rev() {
        file.extend(row.iter().flatten().flat_map(|value| value.to_le_bytes()));
    }
    file
}

/// The image of a file, with rows from the top. It must have this size.
pub fn read(file: &[u8], (width, height): (u32, u32)) -> Result<Vec<[f32; 3]>> {
    let wrong = |reason: String| Error::new(ErrorKind::InvalidData, reason);
    let mut rest = file;
    let mut word = || {
        let end = rest.iter().position(u8::is_ascii_whitespace)?;
        let (word, after) = rest.split_at(end);
        rest = &after[1..];
        std::str::from_utf8(word).ok()
    };
    let header = [word(), word(), word(), word()];
    let [Some("PF"), Some(columns), Some(rows), Some(scale)] = header else {
        return Err(wrong("it is not a colour image in PFM".to_owned()));
    };
    if (columns.parse(), rows.parse()) != (Ok(width), Ok(height)) {
        return Err(wrong(format!("it has {columns} × {rows} pixels in place of {width} × {height}")));
    }
    let is_little = scale.parse::<f32>().is_ok_and(|scale| scale < 0.0);
    let expected = PIXEL * width as usize * height as usize;
    if rest.len() != expected {
        return Err(wrong(format!("it has {} bytes of pixels in place of {expected}", rest.len())));
    }
    let value =
        |&bytes: &[u8; 4]| if is_little { f32::from_le_bytes(bytes) } else { f32::from_be_bytes(bytes) };
    let values: Vec<f32> = rest.as_chunks().0.iter().map(value).collect();
    let pixels = values.as_chunks::<3>().0;
    Ok(pixels.chunks(width.max(1) as usize).rev().flatten().copied().collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_image_reads_back_and_its_last_row_comes_first_in_the_file() {
        let pixels: Vec<[f32; 3]> = (0..6).map(|i| [i as f32, 0.5, -1e30]).collect();
        let file = write((2, 3), &pixels);
        assert!(file.starts_with(b"PF\n2 3\n-1.0\n\0\0\x80\x40"), "{file:?}");
        assert_eq!(read(&file, (2, 3)).unwrap(), pixels);
        let big: Vec<u8> = 2f32.to_be_bytes().repeat(3);
        assert_eq!(read(&[b"PF\n1 1\n1.0\n", big.as_slice()].concat(), (1, 1)).unwrap(), [[2.0; 3]]);
    }

    #[test]
    fn other_files_are_refused() {
        let file = write((2, 3), &[[0.0; 3]; 6]);
        for (wrong, reason) in [
            (b"".to_vec(), "not a colour image"),
            (b"Pf\n2 3\n-1.0\n".to_vec(), "not a colour image"),
            (write((3, 2), &[[0.0; 3]; 6]), "3 × 2 pixels"),
            (file[..file.len() - 1].to_vec(), "71 bytes"),
            ([file, vec![0]].concat(), "73 bytes"),
        ] {
            let error = read(&wrong, (2, 3)).unwrap_err().to_string();
            assert!(error.contains(reason), "{error}");
        }
    }
}
