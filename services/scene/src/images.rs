//! The textures of a scene. Each image is decoded once, however many materials use it.

use crate::bundle::Bundle;
use crate::error::SceneError;
use crate::{Texels, Texture, TextureId};
use exr::meta::MetaData;
use exr::meta::header::Header;
use glam::{DVec3, Vec3};
use image::{ImageFormat, ImageReader};
use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use std::io::Cursor;

/// The textures loaded so far, by the name of their source.
pub(crate) struct TextureLibrary<'a> {
    bundle: &'a Bundle,
    textures: Vec<Texture>,
    by_name: BTreeMap<String, TextureId>,
    /// For each texture, whether any texel has an alpha below 1.
    translucent: Vec<bool>,
    pixels: u64,
    /// Texels of the images that only a mean was taken of.
    averaged: u64,
    /// Textures that were decoded and are not loaded yet.
    ready: BTreeMap<String, (Head, Result<Texels, SceneError>)>,
}

/// What an image says before its pixels.
struct Head {
    format: ImageFormat,
    width: u32,
    height: u32,
    /// Pixels that are decoded. Those outside of the image's window are lost then.
    pixels: u64,
}

impl Head {
    /// The format is determined by a file's contents, not by its name.
    fn of(name: &str, bytes: &[u8]) -> Result<Self, SceneError> {
        let reader = ImageReader::new(Cursor::new(bytes)).with_guessed_format();
        let reader = reader.map_err(|e| SceneError::file(name, e.to_string()))?;
        let Some(
            format @ (ImageFormat::Png
            | ImageFormat::Jpeg
            | ImageFormat::WebP
            | ImageFormat::Hdr
            | ImageFormat::OpenExr),
        ) = reader.format()
        else {
            return Err(SceneError::file(
                name,
                "is not a supported image (PNG, JPEG, WebP, Radiance HDR, OpenEXR)",
            ));
        };
        let (width, height) = reader.into_dimensions().map_err(|e| unreadable(name, &e))?;
        if width == 0 || height == 0 {
            return Err(SceneError::file(name, "the image has no pixels"));
        }
        let window = u64::from(width) * u64::from(height);
        let pixels = if format == ImageFormat::OpenExr { window.max(data_pixels(bytes)) } else { window };
        Ok(Self { format, width, height, pixels })
    }

    /// The texels. The image's size is allowed by now.
    fn decode(&self, name: &str, bytes: &[u8]) -> Result<Texels, SceneError> {
        if self.format == ImageFormat::Jpeg && is_cut_short(bytes) {
            return Err(SceneError::file(name, "is not a readable image: the JPEG file is truncated"));
        }
        let mut reader = ImageReader::with_format(Cursor::new(bytes), self.format);
        // 16 bytes per pixel, and 64 MiB for decoder and other data.
        let mut limits = image::Limits::default();
        limits.max_alloc = Some(self.pixels.saturating_mul(16).saturating_add(64 << 20));
        reader.limits(limits);
        let decoded = reader.decode().map_err(|e| unreadable(name, &e))?;
        match self.format {
            ImageFormat::Png | ImageFormat::Jpeg | ImageFormat::WebP => {
                Ok(Texels::Srgb8(decoded.into_rgba8().pixels().map(|p| p.0).collect()))
            }
            _ => linear(name, &decoded.into_rgb32f(), self.width),
        }
    }
}

fn unreadable(name: &str, error: &image::ImageError) -> SceneError {
    SceneError::file(name, format!("is not a readable image: {error}"))
}

impl<'a> TextureLibrary<'a> {
    pub(crate) fn new(bundle: &'a Bundle) -> Self {
        Self {
            bundle,
            textures: Vec::new(),
            by_name: BTreeMap::new(),
            translucent: Vec::new(),
            pixels: 0,
            averaged: 0,
            ready: BTreeMap::new(),
        }
    }

    /// Decodes files of the bundle that will be loaded, on all threads. It stops at the first that cannot be
    /// decoded: errors appear when that one is loaded.
    pub(crate) fn prefetch(&mut self, paths: impl Iterator<Item = String>) {
        let mut pixels = self.pixels;
        let mut found = Vec::new();
        let wanted: BTreeSet<String> = paths.filter(|path| self.known(path).is_none()).collect();
        for path in wanted {
            let Ok(bytes) = self.bundle.read(&path) else { break };
            let Ok(head) = Head::of(&path, &bytes) else { break };
            pixels = pixels.saturating_add(head.pixels);
            if pixels > self.bundle.limits().texture_pixels {
                break;
            }
            found.push((path, bytes, head));
        }
        let decoded = forelight_threads::map(&found, 1, |(path, bytes, head)| head.decode(path, bytes));
        for ((path, _, head), texels) in found.into_iter().zip(decoded) {
            self.ready.insert(path, (head, texels));
        }
    }

    /// Loads a texture from a file of the bundle.
    pub(crate) fn load(&mut self, path: &str) -> Result<TextureId, SceneError> {
        if let Some(id) = self.known(path) {
            return Ok(id);
        }
        if let Some((head, texels)) = self.ready.remove(path) {
            self.check_limit(path, &head)?;
            return Ok(self.add(path, &head, texels?));
        }
        let bytes = self.bundle.read(path)?;
        self.decode(path, &bytes)
    }

    /// Decodes a texture from `bytes`. A second call with the same name returns the same texture.
    pub(crate) fn decode(&mut self, name: &str, bytes: &[u8]) -> Result<TextureId, SceneError> {
        if let Some(id) = self.known(name) {
            return Ok(id);
        }
        let head = Head::of(name, bytes)?;
        self.check_limit(name, &head)?;
        let texels = head.decode(name, bytes)?;
        Ok(self.add(name, &head, texels))
    }

    /// The mean of red, green and blue in each of several images of data, as stored, in the range 0 to 1.
    /// `None` for images that cannot be read, and for those beyond the limit on texels. The images are not
    /// kept.
    pub(crate) fn means(&mut self, images: &[Option<Cow<'_, [u8]>>]) -> Vec<Option<[f32; 3]>> {
        let limit = self.bundle.limits().texture_pixels;
        let mut head = |bytes: &[u8]| {
            let head = Head::of("", bytes).ok()?;
            let averaged = self.averaged.checked_add(head.pixels).filter(|&pixels| pixels <= limit)?;
            self.averaged = averaged;
            Some(head)
        };
        let heads = images.iter().map(|bytes| bytes.as_deref().and_then(|bytes| Some((head(bytes)?, bytes))));
        let heads: Vec<Option<(Head, &[u8])>> = heads.collect();
        forelight_threads::map(&heads, 1, |image| {
            let (head, bytes) = image.as_ref()?;
            head.decode("", bytes).ok().map(|texels| mean(&texels))
        })
    }

    /// Counts the texels of an image that is about to be decoded.
    fn check_limit(&mut self, name: &str, head: &Head) -> Result<(), SceneError> {
        self.pixels = self.pixels.saturating_add(head.pixels);
        let limit = self.bundle.limits().texture_pixels;
        if self.pixels > limit {
            let (file, found) = (name.to_owned(), self.pixels);
            return Err(SceneError::Limit { file, what: "texels of all textures", found, limit });
        }
        Ok(())
    }

    fn add(&mut self, name: &str, head: &Head, texels: Texels) -> TextureId {
        let id = TextureId(self.textures.len() as u32);
        self.translucent.push(match &texels {
            Texels::Srgb8(texels) => texels.iter().any(|texel| texel[3] < 255),
            Texels::Linear(_) => false,
        });
        let Head { width, height, .. } = *head;
        self.textures.push(Texture { name: name.to_owned(), width, height, texels });
        self.by_name.insert(name.to_owned(), id);
        id
    }

    /// The texture of this name, if it is loaded.
    pub(crate) fn known(&self, name: &str) -> Option<TextureId> {
        self.by_name.get(name).copied()
    }

    /// Rejects a surface colour above 1, which would reflect more light than arrives.
    pub(crate) fn check_reflectance(&self, id: TextureId) -> Result<(), SceneError> {
        let Texture { name, width, texels, .. } = &self.textures[id.0 as usize];
        let Texels::Linear(texels) = texels else { return Ok(()) };
        let Some(i) = texels.iter().position(|texel| texel.iter().any(|&c| c > 1.0)) else { return Ok(()) };
        let (x, y) = (i % *width as usize, i / *width as usize);
        let why = format!(
            "the pixel in column {x}, row {y} is {:?}; a surface's colour must be in the range 0 to 1",
            texels[i]
        );
        Err(SceneError::file(name, why))
    }

    /// Returns `true` if any texel has an alpha below 1.
    pub(crate) fn has_alpha(&self, id: TextureId) -> bool {
        self.translucent[id.0 as usize]
    }

    pub(crate) fn into_textures(self) -> Vec<Texture> {
        self.textures
    }
}

/// The pixels that decoding an OpenEXR file expands: its largest data window. Its image is the display
/// window. 0 if the file is damaged.
fn data_pixels(exr: &[u8]) -> u64 {
    let headers = MetaData::read_from_buffered(exr, false).map_or_else(|_| Default::default(), |m| m.headers);
    let pixels = |header: &Header| {
        (header.layer_size.width() as u64).saturating_mul(header.layer_size.height() as u64)
    };
    headers.iter().map(pixels).max().unwrap_or(0)
}

/// The mean of red, green and blue. 8-bit images are taken as linear.
fn mean(texels: &Texels) -> [f32; 3] {
    match texels {
        Texels::Srgb8(texels) => {
            let sum = texels.iter().fold([0u64; 3], |sum, &[r, g, b, _]| {
                [sum[0] + u64::from(r), sum[1] + u64::from(g), sum[2] + u64::from(b)]
            });
            sum.map(|sum| (sum as f64 / (255.0 * texels.len() as f64)) as f32)
        }
        Texels::Linear(texels) => {
            let sum: DVec3 = texels.iter().map(|&texel| Vec3::from(texel).min(Vec3::ONE).as_dvec3()).sum();
            (sum / texels.len() as f64).as_vec3().to_array()
        }
    }
}

/// Whether a JPEG file ends before its image does; decoders would fill the rest with grey. After the last
/// start-of-scan marker, the next end-of-image marker is genuine (ITU-T T.81, B.1.1.2).
fn is_cut_short(jpeg: &[u8]) -> bool {
    let last = |marker: u8| jpeg.windows(2).rposition(|pair| pair == [0xFF, marker]);
    let (start_of_scan, end_of_image) = (last(0xDA), last(0xD9));
    end_of_image.is_none() || end_of_image < start_of_scan
}

/// Linear texels. Filters and denoisers leave small negative values in images of light; they become 0.
fn linear(name: &str, image: &image::Rgb32FImage, width: u32) -> Result<Texels, SceneError> {
    let mut texels = Vec::with_capacity(image.len() / 3);
    for (i, pixel) in image.pixels().enumerate() {
        if !pixel.0.iter().all(|c| c.is_finite()) {
            let (x, y) = (i % width as usize, i / width as usize);
            return Err(SceneError::file(name, format!("the pixel in column {x}, row {y} is not finite")));
        }
        texels.push(pixel.0.map(|c| c.max(0.0)));
    }
    Ok(Texels::Linear(texels))
}
