//! Multi-layer EXR files of Cycles: ids and times of pixels, and merging shares of the samples.

use exr::prelude::{
    AnyChannel, AnyChannels, FlatImage, FlatSamples, Layer, ReadChannels as _, ReadLayers as _, Text,
    WritableImage as _, read,
};
use forelight_pictures::{id_color, tone_map};
use forelight_renderer::door::{BlockCosts, PixelCount, RendererError, StratumCost};
use image::{Rgb, RgbImage};
use std::collections::BTreeMap;
use std::path::Path;

/// Side of the blocks by which costs are located, pixels.
const BLOCK: u32 = 8;

/// Passes, by the names of Blender 5 and of those before it.
const OBJECT: [&str; 2] = ["Object Index", "IndexOB"];
const MATERIAL: [&str; 2] = ["Material Index", "IndexMA"];
const TIME: [&str; 1] = ["Render Time"];
const SAMPLES: &str = "Debug Sample Count";
const COMBINED: &str = "Combined";

/// Passes that hold the first sample alone.
const OF_FIRST_SAMPLE: [&str; 7] =
    ["Object Index", "IndexOB", "Material Index", "IndexMA", "Depth", "Z", "Position"];

/// Object and material of a pixel, by index. `None` where there is none.
pub(crate) type Stratum = (Option<u32>, Option<u32>);

/// The index that Cycles wrote plus one. Zero is nothing.
fn index(value: f32) -> Option<u32> {
    (value as u32).checked_sub(1)
}

/// A multi-layer image.
pub(crate) struct Image {
    exr: FlatImage,
}

/// A share of the samples of a frame.
pub(crate) struct Share {
    pub image: Image,
    pub samples: u32,
}

impl Image {
    pub fn read(path: &Path) -> Result<Self, RendererError> {
        let reader = read().no_deep_data().largest_resolution_level().all_channels().all_layers();
        let exr = reader.all_attributes().from_file(path).map_err(failed(path))?;
        Ok(Self { exr })
    }

    /// Writes the image under a temporary name first: a file of this name is whole.
    pub fn write(&self, path: &Path) -> Result<(), RendererError> {
        let partial = path.with_extension("partial");
        self.exr.write().to_file(&partial).map_err(failed(&partial))?;
        std::fs::rename(&partial, path).map_err(RendererError::io(path))
    }

    fn width(&self) -> usize {
        self.exr.layer_data.first().map_or(1, |layer| layer.size.x().max(1))
    }

    /// A channel of the first layer that has such a pass.
    fn pass(&self, names: &[&str]) -> Option<&[f32]> {
        let channels = self.exr.layer_data.iter().flat_map(|layer| &layer.channel_data.list);
        channels.filter(|c| names.contains(&pass_of(c))).find_map(floats)
    }

    /// Milliseconds of each pixel, in all view layers together. `None` if the image does not hold times.
    fn times(&self) -> Option<Vec<f64>> {
        let channels = self.exr.layer_data.iter().flat_map(|layer| &layer.channel_data.list);
        let mut layers = channels.filter(|c| TIME.contains(&pass_of(c))).filter_map(floats);
        let mut sums: Vec<f64> = layers.next()?.iter().copied().map(f64::from).collect();
        for layer in layers {
            sums.iter_mut().zip(layer).for_each(|(sum, &time)| *sum += f64::from(time));
        }
        Some(sums)
    }

    /// Mean number of samples of a pixel, weighted by what a sample of it costs, where the image holds times.
    /// `rendered`: how many samples the image has, by view layer; `most` where that is not known.
    pub fn mean_samples(&self, rendered: &BTreeMap<String, u32>, most: u32) -> Result<f64, RendererError> {
        let channels = || self.exr.layer_data.iter().flat_map(|layer| &layer.channel_data.list);
        let mut pixels = Vec::new();
        for counted in channels().filter(|c| pass_of(c) == SAMPLES) {
            let of = view_layer(counted);
            let mut times = channels().filter(|c| TIME.contains(&pass_of(c)) && view_layer(c) == of);
            let times = times.find_map(floats);
            // Cycles writes shares of the samples that the image has.
            let rendered = f64::from(rendered.get(of).copied().unwrap_or(most));
            for (pixel, &share) in floats(counted).unwrap_or_default().iter().enumerate() {
                let samples = (f64::from(share) * rendered).max(1.0);
                let time = times.map_or(samples, |times| f64::from(times[pixel]));
                pixels.push((samples, time / samples));
            }
        }
        weighted_mean(&mut pixels).ok_or_else(|| {
            RendererError::Answer("the image does not say how many samples its pixels took".to_owned())
        })
    }

    /// The image for viewing. Black where the file has no image.
    pub fn picture(&self) -> RgbImage {
        let channels = || self.exr.layer_data.iter().flat_map(|layer| &layer.channel_data.list);
        let find = |component: &str| {
            let mut combined = channels().filter(|c| pass_of(c) == COMBINED && component_of(c) == component);
            combined.find_map(floats).unwrap_or_default()
        };
        let colours = ["R", "G", "B"].map(find);
        let width = self.width();
        let height = self.exr.layer_data.first().map_or(1, |layer| layer.size.y().max(1));
        let side = |length: usize| u32::try_from(length).unwrap_or(u32::MAX);
        RgbImage::from_fn(side(width), side(height), |x, y| {
            let pixel = y as usize * width + x as usize;
            Rgb(tone_map(colours.map(|channel| channel.get(pixel).copied().unwrap_or(0.0))))
        })
    }

    /// Object and material of every pixel as a colour. `None` if the image does not hold them.
    pub fn ids(&self) -> Option<RgbImage> {
        let strata = self.strata()?;
        let width = u32::try_from(self.width()).ok()?;
        let height = u32::try_from(strata.len() / self.width()).ok()?;
        let colour = |x: u32, y: u32| match strata.get((y * width + x) as usize) {
            None | Some((None, None)) => [0; 3],
            Some((object, material)) => id_color(object.map_or(0, |o| o + 1), material.map_or(0, |m| m + 1)),
        };
        Some(RgbImage::from_fn(width, height, |x, y| Rgb(colour(x, y))))
    }

    /// Object and material of every pixel, by index. `None` if the image does not hold them.
    fn strata(&self) -> Option<Vec<Stratum>> {
        // A share without the first sample has nothing but zeros.
        let is_empty = self.pass(&OBJECT)?.iter().all(|&value| value <= 0.0);
        if is_empty { None } else { Some(self.index_pass().ok()?.collect()) }
    }

    /// Object and material of every pixel of an image that should hold them.
    fn index_pass(&self) -> Result<impl Iterator<Item = Stratum>, RendererError> {
        let missing = || RendererError::Answer("the image has no object and material index".to_owned());
        let (objects, materials) =
            (self.pass(&OBJECT).ok_or_else(missing)?, self.pass(&MATERIAL).ok_or_else(missing)?);
        Ok(objects.iter().zip(materials).map(|(&object, &material)| (index(object), index(material))))
    }

    /// Pixels by stratum, scaled to an image of `pixels`.
    pub fn counts(&self, pixels: u64) -> Result<Vec<PixelCount>, RendererError> {
        let mut counts = BTreeMap::new();
        for stratum in self.index_pass()? {
            *counts.entry(stratum).or_insert(0u64) += 1;
        }
        let own = counts.values().sum::<u64>().max(1);
        let count = |((object, material), n)| PixelCount { object, material, pixels: scaled(n, pixels, own) };
        Ok(counts.into_iter().map(count).collect())
    }

    /// Share of the pixels that show these objects and materials, in rows from the top.
    pub fn agreement(&self, shown: impl Iterator<Item = Stratum>) -> Result<f64, RendererError> {
        let strata = self.index_pass()?;
        let (mut pixels, mut same) = (0u64, 0u64);
        for (own, other) in strata.zip(shown) {
            pixels += 1;
            same += u64::from(own == other);
        }
        Ok(same as f64 / pixels.max(1) as f64)
    }

    /// Costs by stratum. Empty if the image does not hold ids and times. Of several view layers, the first says
    /// what a pixel shows.
    pub fn stratum_costs(&self) -> Vec<StratumCost> {
        let (Some(strata), Some(times)) = (self.strata(), self.times()) else { return Vec::new() };
        let mut sums = BTreeMap::new();
        for (stratum, time) in strata.into_iter().zip(times) {
            let (pixels, millis) = sums.entry(stratum).or_insert((0u64, 0.0));
            *pixels += 1;
            *millis += time;
        }
        let cost = |((object, material), (pixels, millis))| StratumCost {
            count: PixelCount { object, material, pixels },
            nanos: nanos(millis),
        };
        sums.into_iter().map(cost).collect()
    }

    /// Costs by block. `None` if the image does not hold times.
    pub fn block_costs(&self) -> Option<BlockCosts> {
        let times = self.times()?;
        let (width, side) = (self.width(), BLOCK as usize);
        let columns = width.div_ceil(side);
        let mut sums = vec![0.0; columns * (times.len() / width).div_ceil(side)];
        for (pixel, time) in times.iter().enumerate() {
            sums[pixel / width / side * columns + pixel % width / side] += time;
        }
        let columns = u32::try_from(columns).unwrap_or(u32::MAX);
        Some(BlockCosts { side: BLOCK, columns, nanos: sums.into_iter().map(nanos).collect() })
    }
}

/// Merges shares of the samples, in their order, into the image of all `samples`. One share at a time is in memory.
///
/// A pass is the mean of its samples, so its shares are weighted by their numbers of samples. Times add up.
/// What only the first sample writes is the first share's. Cryptomatte ranks are merged by id.
pub(crate) fn merge(
    samples: u32,
    mut shares: impl Iterator<Item = Result<Share, RendererError>>,
) -> Result<Image, RendererError> {
    let mut merging = Merging::begin(shares.next().ok_or_else(differ)??, samples)?;
    for share in shares {
        merging.add(share?)?;
    }
    Ok(merging.end())
}

/// Shares that are being merged.
struct Merging {
    samples: f64,
    /// The first share. Channels that are added up hold nothing until the end.
    image: FlatImage,
    /// Names and lengths of the channels of each layer.
    channels: Vec<Vec<(Text, usize)>>,
    sums: Sums,
}

/// What is known of the merged image so far.
struct Sums {
    /// Layer of a channel, number in it, and sums of its values.
    channels: Vec<(usize, usize, Vec<f64>)>,
    cryptomattes: Vec<Cryptomatte>,
}

/// A Cryptomatte that is being merged.
struct Cryptomatte {
    /// Layer and (id, weight) channels of each rank.
    ranks: Vec<(usize, [usize; 2])>,
    /// Bits of the ids in each pixel, with their weights so far.
    pixels: Vec<Vec<(u32, f64)>>,
}

impl Merging {
    fn begin(first: Share, samples: u32) -> Result<Self, RendererError> {
        let mut image = first.image.exr;
        let (samples, channels) = (f64::from(samples), channels(&image));
        let mut sums = Sums::of(&image)?;
        sums.add(&image, f64::from(first.samples) / samples)?;
        for &(layer, channel, _) in &sums.channels {
            image.layer_data[layer].channel_data.list[channel].sample_data = FlatSamples::F32(Vec::new());
        }
        Ok(Self { samples, image, channels, sums })
    }

    fn add(&mut self, Share { image, samples }: Share) -> Result<(), RendererError> {
        if channels(&image.exr) != self.channels {
            return Err(differ());
        }
        self.sums.add(&image.exr, f64::from(samples) / self.samples)
    }

    fn end(mut self) -> Image {
        let mut set = |layer: usize, channel: usize, values: Vec<f32>| {
            self.image.layer_data[layer].channel_data.list[channel].sample_data = FlatSamples::F32(values);
        };
        for (layer, channel, sums) in self.sums.channels {
            set(layer, channel, sums.into_iter().map(|sum| sum as f32).collect());
        }
        for Cryptomatte { ranks, mut pixels } in self.sums.cryptomattes {
            // The heaviest ids are kept.
            pixels.iter_mut().for_each(|ids| ids.sort_by(|a, b| b.1.total_cmp(&a.1)));
            for (rank, (layer, [id, weight])) in ranks.into_iter().enumerate() {
                let at = |ids: &Vec<(u32, f64)>| ids.get(rank).copied().unwrap_or((0, 0.0));
                set(layer, id, pixels.iter().map(|ids| f32::from_bits(at(ids).0)).collect());
                set(layer, weight, pixels.iter().map(|ids| at(ids).1 as f32).collect());
            }
        }
        Image { exr: self.image }
    }
}

impl Sums {
    /// Nothing, of the channels of this image.
    fn of(image: &FlatImage) -> Result<Self, RendererError> {
        let ranks = cryptomattes(image);
        let is_rank = |at: usize, channel: usize| {
            ranks.iter().flatten().any(|&(layer, pair)| layer == at && pair.contains(&channel))
        };
        let mut channels = Vec::new();
        for (at, layer) in image.layer_data.iter().enumerate() {
            for (number, channel) in layer.channel_data.list.iter().enumerate() {
                if !OF_FIRST_SAMPLE.contains(&pass_of(channel)) && !is_rank(at, number) {
                    channels.push((at, number, vec![0.0; channel.sample_data.len()]));
                }
            }
        }
        let cryptomatte = |ranks: Vec<(usize, [usize; 2])>| {
            let (layer, [id, _]) = ranks[0];
            let pixels = image.layer_data[layer].channel_data.list[id].sample_data.len();
            Cryptomatte { ranks, pixels: vec![Vec::new(); pixels] }
        };
        Ok(Self { channels, cryptomattes: ranks.into_iter().map(cryptomatte).collect() })
    }

    /// Adds a share that has this part of all samples, and the same channels.
    fn add(&mut self, share: &FlatImage, weight: f64) -> Result<(), RendererError> {
        let channel = |layer: usize, channel: usize| &share.layer_data[layer].channel_data.list[channel];
        for (layer, number, sums) in &mut self.channels {
            let channel = channel(*layer, *number);
            let weight = if TIME.contains(&pass_of(channel)) { 1.0 } else { weight };
            let values = floats(channel).ok_or_else(differ)?;
            sums.iter_mut().zip(values).for_each(|(sum, &value)| *sum += f64::from(value) * weight);
        }
        for Cryptomatte { ranks, pixels } in &mut self.cryptomattes {
            for &(layer, pair) in &*ranks {
                let [ids, weights] = pair.map(|number| floats(channel(layer, number)));
                let (ids, weights) = (ids.ok_or_else(differ)?, weights.ok_or_else(differ)?);
                for ((known, id), &of_share) in pixels.iter_mut().zip(ids).zip(weights) {
                    let (id, weight) = (id.to_bits(), f64::from(of_share) * weight);
                    match known.iter_mut().find(|known| known.0 == id) {
                        Some(known) => known.1 += weight,
                        None if weight > 0.0 => known.push((id, weight)),
                        None => {}
                    }
                }
            }
        }
        Ok(())
    }
}

fn differ() -> RendererError {
    RendererError::Answer("shares of a frame have different passes".to_owned())
}

/// Names and lengths of the channels of each layer.
fn channels(image: &FlatImage) -> Vec<Vec<(Text, usize)>> {
    let of_layer = |layer: &Layer<AnyChannels<FlatSamples>>| {
        layer.channel_data.list.iter().map(|c| (c.name.clone(), c.sample_data.len())).collect()
    };
    image.layer_data.iter().map(of_layer).collect()
}

/// Indices of the (id, weight) channels of a layer that belong to a Cryptomatte.
fn cryptomatte_ranks(layer: &Layer<AnyChannels<FlatSamples>>) -> Vec<[usize; 2]> {
    let list = &layer.channel_data.list;
    let find = |pass: &str, component: &str| {
        list.iter().position(|c| pass_of(c) == pass && component_of(c).eq_ignore_ascii_case(component))
    };
    let mut passes: Vec<&str> = list.iter().map(pass_of).filter(|pass| pass.starts_with("Crypto")).collect();
    passes.sort_unstable();
    passes.dedup();
    let pairs = passes.into_iter().flat_map(|pass| {
        [("r", "g"), ("b", "a")].map(|(id, weight)| Some([find(pass, id)?, find(pass, weight)?]))
    });
    pairs.flatten().collect()
}

/// Layer and (id, weight) channels of the ranks of each Cryptomatte.
fn cryptomattes(image: &FlatImage) -> Vec<Vec<(usize, [usize; 2])>> {
    // Ranks of one Cryptomatte may be in several parts of the file: CryptoObject00, CryptoObject01, …
    let mut groups: BTreeMap<String, Vec<(usize, [usize; 2])>> = BTreeMap::new();
    for (index, layer) in image.layer_data.iter().enumerate() {
        for pair in cryptomatte_ranks(layer) {
            let name = layer.channel_data.list[pair[0]].name.to_string();
            let group = name.rsplit_once('.').map_or(name.as_str(), |(pass, _)| pass);
            groups
                .entry(group.trim_end_matches(|c: char| c.is_ascii_digit()).to_owned())
                .or_default()
                .push((index, pair));
        }
    }
    groups.into_values().collect()
}

/// `Object Index` of `ViewLayer.Object Index.X`.
fn pass_of(channel: &AnyChannel<FlatSamples>) -> &str {
    let name = channel.name.as_slice();
    std::str::from_utf8(name).ok().and_then(|name| name.rsplit('.').nth(1)).unwrap_or("")
}

/// `ViewLayer` of `ViewLayer.Object Index.X`.
fn view_layer(channel: &AnyChannel<FlatSamples>) -> &str {
    let name = std::str::from_utf8(channel.name.as_slice()).unwrap_or("");
    name.rsplitn(3, '.').nth(2).unwrap_or("")
}

/// `X` of `ViewLayer.Object Index.X`.
fn component_of(channel: &AnyChannel<FlatSamples>) -> &str {
    std::str::from_utf8(channel.name.as_slice()).ok().and_then(|name| name.rsplit('.').next()).unwrap_or("")
}

fn floats(channel: &AnyChannel<FlatSamples>) -> Option<&[f32]> {
    match &channel.sample_data {
        FlatSamples::F32(values) => Some(values),
        _ => None,
    }
}

fn nanos(millis: f64) -> u64 {
    (millis * 1e6).max(0.0).round() as u64
}

/// `n · to / from`, rounded.
pub(crate) fn scaled(n: u64, to: u64, from: u64) -> u64 {
    let exact = (u128::from(n) * u128::from(to) + u128::from(from) / 2) / u128::from(from);
    u64::try_from(exact).unwrap_or(u64::MAX)
}

fn failed(path: &Path) -> impl FnOnce(exr::error::Error) -> RendererError {
    move |error| RendererError::Answer(format!("{}: {error}", path.display()))
}

/// A pixel in which the process lost the processor seems to cost many times what it does. So no sample of a pixel
/// weighs more than this many times one of the dearest twentieth.
const MOST_WEIGHT: f64 = 3.0;

/// Mean of the first numbers, weighted by the second ones. `None` if these are all 0.
fn weighted_mean(pixels: &mut [(f64, f64)]) -> Option<f64> {
    pixels.sort_by(|one, other| one.1.total_cmp(&other.1));
    let (_, dear) = *pixels.get(pixels.len() * 19 / 20)?;
    let weight = |weight: f64| weight.min(MOST_WEIGHT * dear);
    let all: f64 = pixels.iter().map(|&(samples, cost)| samples * weight(cost)).sum();
    let weights: f64 = pixels.iter().map(|&(_, cost)| weight(cost)).sum();
    (weights > 0.0).then(|| all / weights)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pixel_that_was_interrupted_does_not_decide_the_mean() {
        let even = |samples: f64| (samples, 1.0);
        let mut pixels: Vec<(f64, f64)> =
            (0..100).map(|i| even(if i < 50 { 100.0 } else { 200.0 })).collect();
        assert_eq!(weighted_mean(&mut pixels), Some(150.0));
        pixels.push((200.0, 1000.0));
        let found = weighted_mean(&mut pixels).unwrap();
        assert!((found - (150.0 * 100.0 + 200.0 * 3.0) / 103.0).abs() < 1e-9, "{found}");
        // What is dear everywhere counts whole.
        let mut dear: Vec<(f64, f64)> =
            (0..100).map(|i| if i < 90 { (10.0, 1.0) } else { (50.0, 40.0) }).collect();
        assert!((weighted_mean(&mut dear).unwrap() - (900.0 + 20_000.0) / 490.0).abs() < 1e-9);
        assert_eq!(weighted_mean(&mut []), None);
        assert_eq!(weighted_mean(&mut [(4.0, 0.0)]), None);
    }
}
