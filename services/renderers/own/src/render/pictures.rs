//! The files of a finished frame, and the cost of making them.
//!
//! For a frame of a few CPU seconds, writing takes a considerable part of another second. So a profile
//! measures it on an image of the same size, made of the finished pixels.

use crate::profile::ProfiledFrame;
use forelight_kept::TemporaryFolder;
use forelight_protocol::Spent;
use forelight_renderer::ExecuteError;
use forelight_scene::Frame;
use forelight_tracer::{Image, Pixel, clocked};
use image::RgbImage;

/// The files of a finished frame.
pub struct Pictures {
    /// The image, linear, with identities and cost.
    pub image_exr: Vec<u8>,
    /// The image for viewing.
    pub image_png: Vec<u8>,
    /// Cost of each pixel in colour.
    pub cost_map_png: Vec<u8>,
    /// Object and material ids in colour.
    pub preview_png: Vec<u8>,
}

/// Encodes a frame's files on this thread. Also returns the CPU time in nanoseconds.
pub fn encode(image: &Image, frame: &Frame, preview: &RgbImage) -> Result<(Pictures, u64), ExecuteError> {
    let (pictures, nanos) = clocked(|| {
        Ok::<_, ExecuteError>(Pictures {
            image_exr: exr(image, frame)?,
            image_png: png(&image.picture())?,
            cost_map_png: png(&image.cost_map())?,
            preview_png: png(preview)?,
        })
    });
    Ok((pictures?, nanos))
}

/// Cost of a frame's files: preview and encoding. It is time only, since work counts tracing.
pub fn write_cost(encoding_nanos: u64, preview: Spent) -> Spent {
    Spent { work: 0, cpu_nanos: encoding_nanos.saturating_add(preview.cpu_nanos) }
}

/// A stand-in repeats its values, so its files are smaller than those of the image: by 19 % and 20 % of the two
/// shipped scenes, 160 × 90 pixels, 64 of them profiled. So a quarter is added.
const MORE_OF_AN_IMAGE: u64 = 4;

/// CPU time of encoding the files of a profiled frame, in nanoseconds, and their bytes, measured on a stand-in.
pub fn encoding_cost(profiled: &ProfiledFrame) -> Result<(u64, Option<u64>), ExecuteError> {
    let Some(image) = stand_in(profiled) else { return Ok((0, None)) };
    let (files, nanos) = encode(&image, &profiled.scene, &profiled.picture)?;
    let Pictures { image_exr, image_png, cost_map_png, preview_png } = &files;
    let bytes = [image_exr, image_png, cost_map_png, preview_png].map(|file| file.len() as u64);
    let sum: u64 = bytes.iter().sum();
    Ok((nanos, Some(sum + sum / MORE_OF_AN_IMAGE)))
}

/// An image of the frame's size made of its traced pixels. `None` if there are none.
///
/// Copies of pixels would encode a third faster than a real image, whose values hardly repeat. So each pixel
/// is a mixture of two traced ones of the same stratum, in its own proportion.
fn stand_in(profiled: &ProfiledFrame) -> Option<Image> {
    let camera = &profiled.scene.camera;
    let count = camera.width as usize * camera.height as usize;
    let mut finished: Vec<&Pixel> = profiled.traced.iter().map(|(_, pixel)| pixel).collect();
    if finished.is_empty() {
        return None;
    }
    finished.sort_by_key(|pixel| pixel.stratum);
    let pixel = |place: usize| {
        let (one, other) = (finished[place % finished.len()], finished[(place + 1) % finished.len()]);
        if one.stratum != other.stratum {
            return *one;
        }
        let mix = |a: f64, b: f64| a + place as f64 / count as f64 * (b - a);
        Pixel {
            color: std::array::from_fn(|c| mix(one.color[c].into(), other.color[c].into()) as f32),
            work: mix(one.work as f64, other.work as f64) as u64,
            cpu_nanos: mix(one.cpu_nanos as f64, other.cpu_nanos as f64) as u64,
            ..*one
        }
    };
    let pixels = (0..count).map(pixel).collect();
    Some(Image {
        width: camera.width,
        height: camera.height,
        pixels,
        reused: vec![true; count],
        denoised: None,
    })
}

/// A picture as a PNG file.
pub fn png(picture: &RgbImage) -> Result<Vec<u8>, ExecuteError> {
    let failed = |error| ExecuteError::Transient(format!("cannot encode a picture: {error}"));
    forelight_pictures::png(picture).map_err(failed)
}

/// The image as an OpenEXR file. The writer needs a file on disk.
fn exr(image: &Image, frame: &Frame) -> Result<Vec<u8>, ExecuteError> {
    let failed =
        |error: &dyn std::fmt::Display| ExecuteError::Transient(format!("cannot write the image: {error}"));
    let folder = TemporaryFolder::new().map_err(|e| failed(&e))?;
    let path = folder.path().join("image.exr");
    image.write_exr(&path, frame).map_err(|e| failed(&e))?;
    std::fs::read(&path).map_err(|e| failed(&e))
}
