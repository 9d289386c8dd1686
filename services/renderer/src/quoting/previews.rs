//! What frames show, as the wire has it.

use crate::door::{
    Cost, Description, FrameCounts, PixelCount, RendererError, RendererId, Run, Settings, Shot, Shown,
};
use forelight_protocol::{
    Described, FrameRate, FrameStrata, PreviewBackend, PreviewResult, SceneDigest, SceneSummary, Spent,
    Stratum, StratumName,
};
use forelight_quote::stratum_key;
use std::collections::BTreeMap;

/// Expected cost of a pixel of the background, relative to one that shows an object.
pub(super) const BACKGROUND_COST: f64 = 0.1;

/// Most notes about a scene.
const MOST_NOTES: usize = 100;

/// Previews frames of a shot: what they show, and the shot itself.
///
/// # Errors
/// If the renderer fails or the run is stopped.
pub fn preview_result(
    renderer: &RendererId,
    shot: &dyn Shot,
    (name, digest): (&str, SceneDigest),
    frames: &[u32],
    settings: &Settings,
    run: &Run<'_>,
) -> Result<PreviewResult, RendererError> {
    let numbers = frames.iter().map(|&frame| own_number(frame)).collect::<Result<Vec<i32>, _>>()?;
    let previews = shot.preview(&numbers, settings, run)?;
    let mut spent = Cost::default();
    previews.iter().for_each(|preview| spent += &preview.cost);
    let description = shot.description();
    let key = key(description);
    let strata = strata(shot, &previews, key);
    let places: BTreeMap<(u32, u32), usize> = strata.iter().map(Stratum::identity).zip(0..).collect();
    let of_frame = |(&frame, preview): (&u32, &FrameCounts)| {
        frame_strata(frame, preview, key, &places, settings.pixels())
    };
    Ok(PreviewResult {
        frames: frames.iter().zip(&previews).map(of_frame).collect(),
        strata,
        background_prior_cost: BACKGROUND_COST,
        record_prior_cost: None,
        backend: previews.first().map_or(PreviewBackend::Renderer, |preview| preview.backend),
        spent: Spent::uncounted(spent.cpu_nanos),
        described: Some(Box::new(described(renderer, description, (name, digest), settings))),
    })
}

/// The renderer's number of a frame.
pub(crate) fn own_number(frame: u32) -> Result<i32, RendererError> {
    i32::try_from(frame)
        .map_err(|_| RendererError::Unsupported(format!("frame {frame}: the number is too large")))
}

/// Numbers of object and material of a pixel, as the wire has them. `None`: the background.
type Key = fn(Option<u32>, Option<u32>) -> Option<(u32, u32)>;

/// How pixels are numbered. Those without object and material are the background if the renderer knows
/// objects or materials. Otherwise nobody knows what they are, and they are a stratum like any other.
fn key(description: &Description) -> Key {
    if description.objects.is_some() || description.materials.is_some() {
        stratum_key
    } else {
        |object, material| Some((object.unwrap_or(0), material.unwrap_or(0)))
    }
}

/// Everything that any frame shows, without the background.
fn strata(shot: &dyn Shot, previews: &[FrameCounts], key: Key) -> Vec<Stratum> {
    let shown = previews.iter().flat_map(|preview| &preview.counts);
    let shown: BTreeMap<(u32, u32), &PixelCount> =
        shown.filter_map(|count| Some((key(count.object, count.material)?, count))).collect();
    let stratum = |((key_object, key_material), count): ((u32, u32), &PixelCount)| {
        let shown = Shown { object: count.object, material: count.material };
        Stratum { name: name_of(shot, shown), object: key_object, material: key_material, prior_cost: 1.0 }
    };
    shown.into_iter().map(stratum).collect()
}

/// Names of what pixels show.
pub(super) fn name_of(shot: &dyn Shot, shown: Shown) -> StratumName {
    let named = |name: Option<String>| name.unwrap_or_else(|| "none".to_owned());
    let (object, material) = shot.names(shown);
    StratumName { object: named(object), material: named(material) }
}

/// Pixels of one frame by stratum. They add up to those of the image: a small preview's counts are rounded,
/// and the largest takes the difference.
fn frame_strata(
    frame: u32,
    preview: &FrameCounts,
    key: Key,
    places: &BTreeMap<(u32, u32), usize>,
    pixels: u64,
) -> FrameStrata {
    let mut counts = vec![0u64; places.len() + 1];
    for count in &preview.counts {
        let place = key(count.object, count.material).and_then(|key| places.get(&key).copied());
        counts[place.unwrap_or(places.len())] += count.pixels;
    }
    let all: u64 = counts.iter().sum();
    if let Some(largest) = counts.iter_mut().max() {
        *largest = (*largest + pixels).saturating_sub(all);
    }
    let mut counts: Vec<u32> = counts.into_iter().map(|n| u32::try_from(n).unwrap_or(u32::MAX)).collect();
    let background = counts.pop().unwrap_or(0);
    FrameStrata {
        frame,
        pixels: counts,
        background,
        cache_records: Vec::new(),
        cache_plan: None,
        lights: 0,
        shining: 0,
        triangles: 0,
        preview_png: None,
    }
}

fn described(
    renderer: &RendererId,
    description: &Description,
    (name, digest): (&str, SceneDigest),
    settings: &Settings,
) -> Described {
    let objects = description.objects.as_deref().unwrap_or_default();
    let count = |length: usize| u64::try_from(length).unwrap_or(u64::MAX);
    Described {
        renderer: renderer.clone(),
        scene: SceneSummary {
            name: name.to_owned(),
            digest,
            frames: u32::try_from(description.frames.numbers().count()).unwrap_or(u32::MAX),
            width: description.settings.common.width,
            height: description.settings.common.height,
            objects: count(objects.len()),
            materials: count(description.materials.as_ref().map_or(0, Vec::len)),
            triangles: objects.iter().filter_map(|object| object.triangles).sum(),
            frames_per_second: FrameRate::try_from(description.frames_per_second).ok(),
        },
        settings: settings.complete(),
        notes: description.notes.iter().take(MOST_NOTES).cloned().collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_of_a_small_preview_add_up_to_the_image() {
        let count = |object, pixels| PixelCount { object: Some(object), material: None, pixels };
        let background = PixelCount { object: None, material: None, pixels: 3 };
        let preview = FrameCounts {
            frame: 7,
            counts: vec![count(0, 33), count(1, 66), background],
            sampled_pixels: 10,
            backend: PreviewBackend::Renderer,
            cost: Cost::default(),
        };
        let keys = [0, 1].map(|object| stratum_key(Some(object), None).unwrap());
        let places = keys.into_iter().zip(0..).collect();
        for pixels in [100, 102, 105] {
            let found = frame_strata(7, &preview, stratum_key, &places, pixels);
            assert_eq!(found.pixels.iter().map(|&n| u64::from(n)).sum::<u64>() + 3, pixels);
            assert_eq!((found.pixels[0], found.background), (33, 3));
        }
    }
}
