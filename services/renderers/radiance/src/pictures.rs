//! Image files: OpenEXR with floats, and Radiance's own RGBE.

use crate::finished::write_new;
use crate::scene::SceneFrame;
use crate::tracer::Colour;
use forelight_pictures::tone_map;
use forelight_renderer::door::{Common, RendererError};
use image::codecs::hdr::HdrEncoder;
use image::{ImageFormat, Rgb, Rgb32FImage, RgbImage};
use std::io::Cursor;
use std::path::Path;

/// Writes the image with floats.
pub(crate) fn write_exr(path: &Path, pixels: &[Colour], common: &Common) -> Result<(), RendererError> {
    let colour = |x, y| Rgb(at(pixels, common, x, y));
    let image = Rgb32FImage::from_fn(common.width, common.height, colour);
    let mut bytes = Cursor::new(Vec::new());
    image.write_to(&mut bytes, ImageFormat::OpenExr).map_err(failed(path))?;
    write_new(path, bytes.get_ref())
}

/// Writes Radiance's own kind of picture. Its header holds the view, so that Radiance's programs know it.
pub(crate) fn write_hdr(
    path: &Path,
    pixels: &[Colour],
    common: &Common,
    frame: &SceneFrame,
) -> Result<(), RendererError> {
    let rgb: Vec<Rgb<f32>> = pixels.iter().map(|&colour| Rgb(colour)).collect();
    let mut bytes = Vec::new();
    HdrEncoder::new(&mut bytes)
        .encode(&rgb, common.width as usize, common.height as usize)
        .map_err(failed(path))?;
    let first = bytes.iter().position(|&byte| byte == b'\n').map_or(0, |end| end + 1);
    let view = format!("VIEW= {}\n", frame.view.arguments.join(" "));
    bytes.splice(first..first, view.bytes());
    write_new(path, &bytes)
}

/// The image for viewing.
pub(crate) fn picture(pixels: &[Colour], common: &Common) -> RgbImage {
    RgbImage::from_fn(common.width, common.height, |x, y| Rgb(tone_map(at(pixels, common, x, y))))
}

fn at(pixels: &[Colour], common: &Common, x: u32, y: u32) -> Colour {
    pixels.get((y * common.width + x) as usize).copied().unwrap_or_default()
}

fn failed(path: &Path) -> impl FnOnce(image::ImageError) -> RendererError {
    move |error| RendererError::Answer(format!("{}: {error}", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::views::View;
    use std::fs;

    #[test]
    fn both_files_hold_the_image_and_the_header_its_view() {
        let folder = tempfile::tempdir().unwrap();
        let common = Common { width: 9, height: 2, samples: 1, seed: 0 };
        let pixels: Vec<Colour> = (0..18).map(|n| [n as f32, 0.25, 1000.0]).collect();
        let arguments = ["-vp", "1", "2", "3"].map(str::to_owned).to_vec();
        let view = View { name: String::new(), arguments };
        let frame = SceneFrame { number: 1, octree: "a.oct".into(), view };
        let (exr, hdr) = (folder.path().join("a.exr"), folder.path().join("a.hdr"));
        write_exr(&exr, &pixels, &common).unwrap();
        write_hdr(&hdr, &pixels, &common, &frame).unwrap();
        let text = String::from_utf8_lossy(&fs::read(&hdr).unwrap()).into_owned();
        assert!(text.starts_with("#?RADIANCE\nVIEW= -vp 1 2 3\n"), "{text}");
        let read = image::open(&exr).unwrap().to_rgb32f();
        assert!(read.pixels().zip(&pixels).all(|(read, pixel)| read.0 == *pixel));
        let read = image::open(&hdr).unwrap().to_rgb32f();
        let is_near = |(read, pixel): (&Rgb<f32>, &Colour)| {
            let most = pixel.iter().copied().fold(0.0, f32::max);
            read.0.iter().zip(pixel).all(|(a, b)| (a - b).abs() <= most / 128.0)
        };
        assert!(read.pixels().zip(&pixels).all(is_near));
    }
}
