//! Writes an explanation in sentences.

use forelight_protocol::{Explanation, Halving, ObjectShare, PartShare, RenderSettings};

/// Number of objects, and of categories of rays, that are named.
const NAMED: usize = 3;

/// The sentences, most important first.
pub(super) fn sentences(
    explanation: &Explanation,
    settings: &RenderSettings,
    shares_cache: bool,
) -> Vec<String> {
    let mut words = Vec::new();
    if let Some(PartShare { part, share, .. }) = explanation.parts.first() {
        words.push(format!("{} of the work is {part}", percent(*share)));
    }
    words.extend(explanation.objects.iter().take(NAMED).map(object));
    words.extend(rays(explanation));
    if explanation.camera_sample > 0.0 {
        words.push(format!(
            "one more camera sample per pixel costs {} of the whole",
            percent(explanation.camera_sample)
        ));
    }
    if shares_cache {
        words.push(
            "building the irradiance cache that the frames share is not included: the quote lists it separately"
                .to_owned(),
        );
    }
    words.push(match &explanation.halving[..] {
        [] => "no single setting halves the work: lower samples, pixels or gather rays together".to_owned(),
        ways => {
            let ways: Vec<String> = ways.iter().map(|way| halving(way, settings)).collect();
            format!("to halve the work: {}", ways.join("; or "))
        }
    });
    words
}

fn percent(share: f64) -> String {
    format!("{:.1} %", 100.0 * share)
}

fn object(object: &ObjectShare) -> String {
    let ObjectShare { share, share_of_pixels, times_mean_pixel, samples, .. } = object;
    let rests_on = match samples {
        0 => "no pixel profiled: taken from others of its material".to_owned(),
        1 => "1 pixel profiled".to_owned(),
        samples => format!("{samples} pixels profiled"),
    };
    format!(
        "{}: {} of the work, {} of the pixels; a pixel costs {times_mean_pixel:.2} times the mean ({rests_on})",
        object.name(),
        percent(*share),
        percent(*share_of_pixels),
    )
}

/// Categories with the most work, or with the most rays if the profiles lack their work.
fn rays(explanation: &Explanation) -> Option<String> {
    let known = explanation.rays.iter().all(|ray| ray.share_of_work.is_some());
    let mut named = explanation.rays.iter().take(NAMED);
    let first = named.next()?;
    let share = |ray: &forelight_protocol::RayShare| percent(ray.share_of_work.unwrap_or(ray.share));
    let mut text = match known {
        true => format!("{} of the work is for {} rays", share(first), first.category),
        false => format!("{} of the rays are {}", share(first), first.category),
    };
    for ray in named {
        text += &match known {
            true => format!(", {} for {} rays", share(ray), ray.category),
            false => format!(", {} {}", share(ray), ray.category),
        };
    }
    Some(text)
}

fn halving(way: &Halving, settings: &RenderSettings) -> String {
    match way.setting.as_str() {
        "spp" => {
            let samples = if way.to == 1.0 { "sample" } else { "samples" };
            format!("{} camera {samples} per pixel instead of {}", way.to, way.from)
        }
        "width" => {
            let RenderSettings { width, height, .. } = settings;
            let lower = (f64::from(*height) * way.to / way.from).floor().max(1.0);
            format!("--width {} --height {lower} instead of {width} x {height}", way.to)
        }
        setting => format!("--{setting} {} instead of {}", way.to, way.from),
    }
}
