//! Finished images: linear EXR with identity and cost layers, tone-mapped PNG, and cost map.

use crate::cost::add_rays;
use crate::cryptomatte::Matte;
use crate::exr_file;
use crate::{Feature, Pixel, RAY_NAMES, Rays, WorkByRay};
use exr::prelude as exr;
use forelight_pictures::{cost_map, tone_map};
use forelight_scene::Frame;
use std::path::Path;

/// All pixels of a frame.
#[derive(Debug, Clone)]
pub struct Image {
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// Pixels in row-major order.
    pub pixels: Vec<Pixel>,
    /// For each pixel, whether it was taken from a profile.
    pub reused: Vec<bool>,
    /// Its colours without noise, by a denoiser. Files and pictures have these in place of the pixels' own.
    pub denoised: Option<DenoisedColors>,
}

/// Colours from a denoiser, and what it was given beside the noisy ones.
#[derive(Debug, Clone)]
pub struct DenoisedColors {
    /// The denoiser and its version.
    pub by: String,
    /// Linear Rec. 709 radiance of every pixel.
    pub colors: Vec<[f32; 3]>,
    /// What every pixel shows.
    pub features: Vec<Feature>,
}

/// Why an image could not be written.
#[derive(Debug, thiserror::Error)]
#[error("cannot write {path}: {reason}")]
pub struct ImageError {
    path: String,
    reason: String,
}

/// Rays, work and CPU time, summed over pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Totals {
    /// Number of pixels.
    pub pixels: u64,
    /// Rays by category.
    pub rays: Rays,
    /// Deterministic work.
    pub work: u64,
    /// Work by the category of the ray that caused it.
    pub work_by_ray: WorkByRay,
    /// CPU time, nanoseconds.
    pub cpu_nanos: u64,
}

/// What a channel holds of a pixel.
enum Value<'a> {
    Float(Box<dyn Fn(&Pixel) -> f32 + Sync + 'a>),
    Integer(Box<dyn Fn(&Pixel) -> u32 + Sync + 'a>),
}

impl Totals {
    /// Sums over pixels, in their order.
    pub fn of<'a>(pixels: impl Iterator<Item = &'a Pixel>) -> Self {
        pixels.fold(Self::default(), |mut t, p| {
            t.pixels += 1;
            add_rays(&mut t.rays, &p.rays);
            t.work += p.work;
            add_rays(&mut t.work_by_ray, &p.work_by_ray);
            t.cpu_nanos += p.cpu_nanos;
            t
        })
    }
}

impl Totals {
    /// The sum of two totals.
    #[must_use]
    pub fn plus(self, other: Self) -> Self {
        Self {
            pixels: self.pixels + other.pixels,
            rays: std::array::from_fn(|kind| self.rays[kind] + other.rays[kind]),
            work: self.work + other.work,
            work_by_ray: std::array::from_fn(|kind| self.work_by_ray[kind] + other.work_by_ray[kind]),
            cpu_nanos: self.cpu_nanos + other.cpu_nanos,
        }
    }

    /// The difference from an earlier total of the same pixels.
    #[must_use]
    pub fn minus(&self, before: &Self) -> Self {
        Self {
            pixels: self.pixels,
            rays: std::array::from_fn(|kind| self.rays[kind].saturating_sub(before.rays[kind])),
            work: self.work.saturating_sub(before.work),
            work_by_ray: std::array::from_fn(|kind| {
                self.work_by_ray[kind].saturating_sub(before.work_by_ray[kind])
            }),
            cpu_nanos: self.cpu_nanos.saturating_sub(before.cpu_nanos),
        }
    }
}

impl Image {
    /// Sums over all pixels, including those from a profile.
    pub fn totals(&self) -> Totals {
        Totals::of(self.pixels.iter())
    }

    /// Sums over the pixels from a profile.
    pub fn reused_totals(&self) -> Totals {
        Totals::of(self.pixels.iter().zip(&self.reused).filter(|p| *p.1).map(|p| p.0))
    }

    /// Writes an OpenEXR file with the channels R, G, B (linear Rec. 709), `object.id` and `material.id` (1 +
    /// index of what the first sample met, 0 where nothing was hit), `cost.work`, `cost.cpu_nanos`,
    /// `rays.NAME`, and objects and materials as Cryptomatte. Identity and ray channels are u32, the others
    /// f32. A denoised image also has `noisy.R`, G, B; `albedo.R`, G, B; `normal.X`, Y, Z; and the attribute
    /// `denoised`, which names the denoiser. Fails if the file cannot be written.
    pub fn write_exr(&self, path: &Path, frame: &Frame) -> Result<(), ImageError> {
        use exr::{
            AnyChannel, AnyChannels, Encoding, FlatSamples, Image as ExrImage, Layer, LayerAttributes,
        };
        let pair = |p: &Pixel| frame.geometry.strata.pairs.get(p.stratum as usize);
        let mut plain: Vec<(String, Value<'_>)> = Vec::new();
        let traced = if self.denoised.is_some() { "noisy." } else { "" };
        for (c, name) in ["R", "G", "B"].into_iter().enumerate() {
            plain.push((format!("{traced}{name}"), Value::Float(Box::new(move |p| p.color[c]))));
        }
        let object = move |p: &Pixel| pair(p).map_or(0, |ids| ids.0 + 1);
        let material = move |p: &Pixel| pair(p).map_or(0, |ids| ids.1 + 1);
        plain.push(("object.id".into(), Value::Integer(Box::new(object))));
        plain.push(("material.id".into(), Value::Integer(Box::new(material))));
        plain.push(("cost.work".into(), Value::Float(Box::new(|p| p.work as f32))));
        plain.push(("cost.cpu_nanos".into(), Value::Float(Box::new(|p| p.cpu_nanos as f32))));
        for (k, name) in RAY_NAMES.into_iter().enumerate() {
            plain.push((format!("rays.{name}"), Value::Integer(Box::new(move |p| p.rays[k]))));
        }
        let samples = forelight_threads::map(&plain, 1, |(_, value)| match value {
            Value::Float(value) => FlatSamples::F32(self.pixels.iter().map(value).collect()),
            Value::Integer(value) => FlatSamples::U32(self.pixels.iter().map(value).collect()),
        });
        let named = plain.iter().zip(samples);
        let mut channels: exr::SmallVec<[AnyChannel<FlatSamples>; 4]> =
            named.map(|((name, _), samples)| AnyChannel::new(name.as_str(), samples)).collect();
        let mut attributes = LayerAttributes::default();
        let mattes = mattes(frame);
        let ids = forelight_threads::map(&mattes, 1, |matte| matte.channels(&self.pixels));
        let denoised = self.denoised.iter().flat_map(DenoisedColors::channels);
        for (name, values) in ids.into_iter().flatten().chain(denoised) {
            channels.push(AnyChannel::new(name.as_str(), FlatSamples::F32(values)));
        }
        for (name, value) in mattes.iter().flat_map(Matte::attributes) {
            let text = |value: &str| exr::Text::new_or_panic(value);
            attributes.other.insert(text(&name), exr::AttributeValue::Text(text(&value)));
        }
        if let Some(denoised) = &self.denoised {
            let by = exr::Text::new_or_none(&denoised.by).unwrap_or_default();
            attributes.other.insert(exr::Text::new_or_panic("denoised"), exr::AttributeValue::Text(by));
        }
        let layer = Layer::new(
            (self.width as usize, self.height as usize),
            attributes,
            // ZIP by lines. Wavelets (PIZ) compress hashes of names badly, and some readers want lines.
            Encoding::SMALL_LOSSLESS,
            AnyChannels::sort(channels),
        );
        let error = |e: exr::Error| ImageError { path: path.display().to_string(), reason: e.to_string() };
        exr_file::write(&ExrImage::from_layer(layer), path).map_err(error)
    }

    /// The image as 8-bit sRGB, tone-mapped for viewing.
    pub fn picture(&self) -> image::RgbImage {
        let denoised = self.denoised.as_ref().map(|denoised| &denoised.colors);
        image::RgbImage::from_fn(self.width, self.height, |x, y| {
            let place = (y * self.width + x) as usize;
            image::Rgb(tone_map(denoised.map_or(self.pixels[place].color, |colors| colors[place])))
        })
    }

    /// Work per pixel in false colours: [`cost_map`].
    pub fn cost_map(&self) -> image::RgbImage {
        let work: Vec<u64> = self.pixels.iter().map(|p| p.work).collect();
        cost_map(self.width, self.height, &work)
    }
}

impl DenoisedColors {
    /// The channels of a file, with their names.
    fn channels(&self) -> Vec<(String, Vec<f32>)> {
        let colors = |c: usize| self.colors.iter().map(|color| color[c]).collect();
        let features = |of: &dyn Fn(&Feature) -> f32| self.features.iter().map(of).collect();
        let mut channels: Vec<(String, Vec<f32>)> = Vec::new();
        for (c, (color, axis)) in [("R", "X"), ("G", "Y"), ("B", "Z")].into_iter().enumerate() {
            channels.push((color.into(), colors(c)));
            channels.push((format!("albedo.{color}"), features(&|feature| feature.albedo[c])));
            channels.push((format!("normal.{axis}"), features(&|feature| feature.normal[c])));
        }
        channels
    }
}

/// The objects and materials of a frame, for Cryptomatte.
fn mattes(frame: &Frame) -> [Matte<'_>; 2] {
    let strata = &frame.geometry.strata;
    let objects = strata.pairs.iter().map(|pair| strata.objects[pair.0 as usize].as_str());
    let materials = strata.pairs.iter().map(|pair| frame.materials[pair.1 as usize].name.as_str());
    [Matte::new("CryptoObject", objects), Matte::new("CryptoMaterial", materials)]
}
