//! Compares images bit by bit.

use exr::prelude::{FlatSamples, ReadChannels, ReadLayers, read};
use std::collections::BTreeMap;
use std::io::Cursor;

/// The one channel that may differ between runs.
const TIME: &str = "cost.cpu_nanos";

/// Size and channels of an OpenEXR image, as bits. The channel of CPU time is left out.
#[derive(Clone, PartialEq, Eq)]
pub struct Channels {
    /// Width and height in pixels.
    pub size: (usize, usize),
    /// Samples by name of the channel, row by row from the top.
    pub samples: BTreeMap<String, Vec<u32>>,
}

impl Channels {
    /// Reads an OpenEXR file. Panics if it is not one.
    pub fn of(file: &[u8]) -> Self {
        let image = read()
            .no_deep_data()
            .largest_resolution_level()
            .all_channels()
            .first_valid_layer()
            .all_attributes()
            .from_buffered(Cursor::new(file))
            .unwrap_or_else(|error| panic!("not an OpenEXR image: {error}"));
        let layer = image.layer_data;
        let channels = layer.channel_data.list.into_iter();
        let samples: BTreeMap<String, Vec<u32>> = channels
            .map(|channel| (channel.name.to_string(), bits(&channel.sample_data)))
            .filter(|(name, _)| name != TIME)
            .collect();
        Self { size: (layer.size.0, layer.size.1), samples }
    }

    /// Panics at the first difference.
    pub fn assert_same(&self, other: &Self, what: &str) {
        assert_eq!(self.size, other.size, "{what}");
        let names = |channels: &Self| channels.samples.keys().cloned().collect::<Vec<_>>();
        assert_eq!(names(self), names(other), "{what}");
        for (name, samples) in &self.samples {
            let differing =
                samples.iter().zip(&other.samples[name]).position(|(mine, theirs)| mine != theirs);
            assert_eq!(differing, None, "{what}: the first pixel that differs in channel {name}");
        }
    }
}

fn bits(samples: &FlatSamples) -> Vec<u32> {
    match samples {
        FlatSamples::F16(values) => values.iter().map(|value| u32::from(value.to_bits())).collect(),
        FlatSamples::F32(values) => values.iter().map(|value| value.to_bits()).collect(),
        FlatSamples::U32(values) => values.clone(),
    }
}

/// Panics unless `file` is a PNG of this size with more than one colour.
pub fn assert_png(file: &[u8], width: u32, height: u32, what: &str) {
    let picture = image::load_from_memory_with_format(file, image::ImageFormat::Png)
        .unwrap_or_else(|error| panic!("{what}: {error}"))
        .into_rgb8();
    assert_eq!(picture.dimensions(), (width, height), "{what}");
    let first = picture.get_pixel(0, 0);
    assert!(picture.pixels().any(|pixel| pixel != first), "{what}: the picture is of one colour");
}
