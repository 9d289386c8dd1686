//! Files of finished pixels and of values of indirect light, which a render takes over.

use crate::tracer::Colour;
use forelight_renderer::door::{Artefact, RendererError};
use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{ErrorKind, Write as _};
use std::path::Path;

/// What begins such a file.
const MAGIC: &[u8; 24] = b"forelight radiance px 2\n";

/// Bytes of a pixel: its index, three floats, and nanoseconds, all little endian.
const BYTES: usize = 24;

/// A finished pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Pixel {
    pub colour: Colour,
    /// CPU time that it took, nanoseconds.
    pub cpu_nanos: u64,
}

/// Finished pixels by index, in rows from the top.
pub(crate) type Finished = BTreeMap<u32, Pixel>;

/// What a file holds.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Content {
    pub pixels: Finished,
    /// Radiance's own file of ambient values. Empty if pixels share none.
    pub ambient: Vec<u8>,
}

/// Writes finished pixels and ambient values.
pub(crate) fn write(path: &Path, pixels: &Finished, ambient: &[u8]) -> Result<(), RendererError> {
    let mut bytes = MAGIC.to_vec();
    bytes.extend((pixels.len() as u64).to_le_bytes());
    for (index, pixel) in pixels {
        bytes.extend(index.to_le_bytes());
        bytes.extend(pixel.colour.iter().flat_map(|channel| channel.to_le_bytes()));
        bytes.extend(pixel.cpu_nanos.to_le_bytes());
    }
    bytes.extend_from_slice(ambient);
    write_new(path, &bytes)
}

/// Writes a new file in place of whatever has its name: a scene's commands could have made a link.
pub(crate) fn write_new(path: &Path, bytes: &[u8]) -> Result<(), RendererError> {
    let removed = match fs::remove_file(path) {
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(()),
        removed => removed,
    };
    let written = removed.and_then(|()| File::create_new(path)).and_then(|mut file| file.write_all(bytes));
    written.map_err(RendererError::io(path))
}

/// Reads the file of an image with so many pixels.
pub(crate) fn read(artefact: &Artefact, pixels: u64) -> Result<Content, RendererError> {
    let bytes = fs::read(&artefact.path).map_err(RendererError::io(&artefact.path))?;
    let body = bytes.strip_prefix(MAGIC).and_then(|body| body.split_first_chunk::<8>());
    let of_pixels = body.and_then(|(count, body)| {
        let length = usize::try_from(u64::from_le_bytes(*count)).ok()?.checked_mul(BYTES)?;
        body.split_at_checked(length)
    });
    let Some((of_pixels, ambient)) = of_pixels else {
        return Err(artefact.unusable("it is not a file of finished pixels, or not whole"));
    };
    let (records, _) = of_pixels.as_chunks::<BYTES>();
    let mut all = Finished::new();
    for record in records {
        let (words, _) = record.as_chunks::<4>();
        let index = u32::from_le_bytes(words[0]);
        if u64::from(index) >= pixels {
            return Err(artefact.unusable(format!("it has pixel {index}; the image has {pixels}")));
        }
        let colour = [1, 2, 3].map(|channel| f32::from_le_bytes(words[channel]));
        let [low, high] = [4, 5].map(|half| u64::from(u32::from_le_bytes(words[half])));
        let pixel = Pixel { colour, cpu_nanos: high << 32 | low };
        if all.insert(index, pixel).is_some() {
            return Err(artefact.unusable(format!("it has pixel {index} twice")));
        }
    }
    Ok(Content { pixels: all, ambient: ambient.to_vec() })
}

#[cfg(test)]
mod tests {
    use super::*;
    use forelight_renderer::door::{Common, Part, RendererId, Settings};

    fn artefact(path: &Path) -> Artefact {
        let common = Common { width: 4, height: 4, samples: 1, seed: 0 };
        Artefact {
            renderer: RendererId { name: "radiance".to_owned(), version: "6".to_owned() },
            frame: 1,
            settings: Settings { common, own: Default::default() },
            part: Part::Pixels(Vec::new()),
            path: path.to_owned(),
        }
    }

    #[test]
    fn a_link_is_replaced_and_not_followed() {
        let folder = tempfile::tempdir().unwrap();
        let (target, link) = (folder.path().join("target"), folder.path().join("link"));
        fs::write(&target, "of the worker").unwrap();
        std::os::unix::fs::symlink(&target, &link).unwrap();
        for _ in 0..2 {
            write_new(&link, b"new").unwrap();
        }
        assert_eq!(fs::read(&target).unwrap(), b"of the worker");
        assert_eq!(fs::read(&link).unwrap(), b"new");
    }

    #[test]
    fn pixels_are_read_as_they_were_written_and_other_files_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("pixels");
        let pixel = |colour, cpu_nanos| Pixel { colour, cpu_nanos };
        let pixels =
            Finished::from([(3, pixel([0.1, 0.2, 0.3], 41_000)), (15, pixel([1e30, 0.0, 5e-40], 7 << 33))]);
        write(&path, &pixels, b"values").unwrap();
        let ambient = b"values".to_vec();
        assert_eq!(read(&artefact(&path), 16).unwrap(), Content { pixels: pixels.clone(), ambient });
        write(&path, &pixels, &[]).unwrap();
        let error = |bytes: &[u8], pixels| {
            fs::write(&path, bytes).unwrap();
            read(&artefact(&path), pixels).unwrap_err().to_string()
        };
        let whole = fs::read(&path).unwrap();
        let twice = [&whole[..56], &whole[32..56]].concat();
        assert!(error(&whole, 15).contains("pixel 15; the image has 15"));
        assert!(error(&whole[..whole.len() - 1], 16).contains("not whole"));
        assert!(error(b"GIF89a", 16).contains("not a file"));
        assert!(error(&twice, 16).contains("pixel 3 twice"));
    }
}
