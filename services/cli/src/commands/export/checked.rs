//! What of a shot goes into a template, checked against what a template can hold, and against files of other
//! shots.

use super::openjd::{Chunk, ExportedShot};
use super::template::{GREATEST_INTEGER, LARGEST_CHUNK, LONGEST_JOB_NAME, LONGEST_VALUE};
use super::{Args, Source};
use crate::commands::cache::NO_USE_FOR_A_CACHE;
use anyhow::Result;
use forelight_protocol::words::counted;
use forelight_protocol::{
    CacheMode, ForecastDoc, FrameSet, JobSettings, ProcessCosts, QuotedShot, RenderSettings, Spent,
};
use forelight_terminal::failure::BadInput;
use forelight_terminal::quantities::{money, seconds};
use serde::Deserialize;
use serde::Serialize;
use serde_json::{Map, Value};
use std::collections::BTreeSet;
use std::path::Path;
use std::time::Duration;

/// Time limit of a task, relative to its P95. Other machines may be slower or busy.
const PATIENCE: f64 = 4.0;

/// Shortest time limit from a forecast, seconds. A machine also has to load the scene.
const SHORTEST_LIMIT: f64 = 600.0;

/// Fails if a template cannot hold the shot, or if --forecast or --stats belongs to something else.
pub fn exported(
    args: &Args,
    source: Source,
    forecast: Option<&ForecastDoc>,
    stats: Option<&FrameStats>,
) -> Result<ExportedShot> {
    if let JobSettings::Own(settings) = &source.settings {
        check_own(args, settings)?;
    }
    let frames = source.frames.iter().copied();
    let frames = FrameSet::from_frames(frames).ok_or_else(|| BadInput::new("--frames: the list is empty"))?;
    let list = frames.to_string();
    if list.len() > LONGEST_VALUE {
        let why = format!("the list has {} characters; a template holds at most {LONGEST_VALUE}", list.len());
        return Err(BadInput::new(format!("--frames: {why}")).hint("export the shot as several jobs").into());
    }
    if let Some(quote) = forecast {
        check_quoted(quote, &source)?;
    }
    let size = source.settings.size().unwrap_or((1, 1));
    let other_size = stats.and_then(FrameStats::size).filter(|of_stats| *of_stats != size);
    if let Some((width, height)) = other_size {
        let why = format!(
            "it is of an image of {width} x {height} pixels, not of {} x {}; memory depends on the size",
            size.0, size.1
        );
        return Err(BadInput::new(format!("--stats: {why}")).into());
    }
    let name = args.name.as_deref().unwrap_or(&source.name);
    let chunk = args
        .chunk
        .zip(forecast)
        .map(|(time, quote)| chunk(time, quote, args.threads.unwrap_or(1)))
        .transpose()?;
    let limits = Limits::new(args.timeout, forecast, &frames, chunk)?;
    Ok(ExportedShot {
        name: job_name(name)?.to_owned(),
        description: description(&source, &frames, forecast),
        bundle: bundle_default(&args.bundle, args.out.as_deref())?,
        bundle_is_folder: args.bundle.is_dir(),
        frames,
        settings: source.settings,
        set: source.set,
        formats: source.formats,
        cache_parts: args.cache_parts,
        threads: args.threads,
        chunk,
        memory_mib: stats.map(|stats| stats.peak_rss_bytes.div_ceil(1 << 20)).filter(|&mib| mib > 0),
        frame_limit: limits.frame,
        cache_limit: limits.cache,
    })
}

/// The statistics of a frame that a template needs, of any renderer.
#[derive(Debug, Deserialize)]
pub struct FrameStats {
    peak_rss_bytes: u64,
    width: Option<u32>,
    height: Option<u32>,
    /// Where another renderer's size is.
    settings: Option<FrameSize>,
}

#[derive(Debug, Clone, Copy, Deserialize)]
struct FrameSize {
    width: u32,
    height: u32,
}

impl FrameStats {
    fn size(&self) -> Option<(u32, u32)> {
        let other = self.settings.map(|size| (size.width, size.height));
        self.width.zip(self.height).or(other)
    }
}

/// Checks what only our own renderer has.
fn check_own(args: &Args, settings: &RenderSettings) -> Result<()> {
    if settings.cache == CacheMode::On && settings.ambient_bounces == 0 {
        return Err(BadInput::new(format!("--cache: {NO_USE_FOR_A_CACHE}")).into());
    }
    if settings.cache == CacheMode::Off && args.cache_parts > 1 {
        return Err(BadInput::new("--cache-parts: there is no cache; add --cache on or --cache-error").into());
    }
    if settings.seed > GREATEST_INTEGER {
        let why = format!(
            "{} is greater than {GREATEST_INTEGER}, the largest integer of a template",
            settings.seed
        );
        return Err(BadInput::new(format!("--seed: {why}")).into());
    }
    Ok(())
}

/// As many frames as take this time by the forecast (P50), with each thread on a core of its own.
fn chunk(time: Duration, quote: &ForecastDoc, threads: u16) -> Result<Chunk> {
    let cores = f64::from(threads);
    let once = once_seconds(quote);
    let frame = quote.total.cpu_seconds.p50 / quote.frames.len().max(1) as f64 / cores;
    let frames = ((time.as_secs_f64() - once) / frame).floor();
    if !(frame > 0.0 && frames >= 1.0) {
        let why = format!(
            "a frame takes {} by the forecast with --threads {threads}, after {} for loading and building",
            seconds(frame),
            seconds(once)
        );
        let hint = "name a longer time, or leave --chunk out: each task then renders one frame";
        return Err(BadInput::new(format!("--chunk: {why}")).hint(hint).into());
    }
    Ok(Chunk { frames: (frames as u64).min(LARGEST_CHUNK), seconds: time.as_secs().max(1) })
}

/// CPU time for loading the scene and building its tree, which each process pays.
fn once_seconds(quote: &ForecastDoc) -> f64 {
    let ProcessCosts { load, build } = quote.once.unwrap_or_default();
    load.plus(build).cpu_nanos as f64 * 1e-9
}

/// Checks that a quote is of this scene and quality.
fn check_quoted(quote: &ForecastDoc, source: &Source) -> Result<()> {
    let Some(QuotedShot { scene, renderer, settings }) = &quote.of else { return Ok(()) };
    let hint = "`forelight forecast --json` makes a quote of this shot";
    if *scene != source.digest {
        let why = "it is of another scene, or of an earlier version of this one";
        return Err(BadInput::new(format!("--forecast: {why}")).hint(hint).into());
    }
    if quote.fixed.is_some_and(|fixed| fixed.denoise != Spent::default()) {
        let why = "it includes removing the noise of images, which exported steps leave in";
        return Err(BadInput::new(format!("--forecast: {why}"))
            .hint("make the quote without --denoise")
            .into());
    }
    let differences = match (settings, &source.settings) {
        (JobSettings::Own(asked), JobSettings::Own(settings)) => {
            let spp = quote.chosen_spp.unwrap_or(asked.spp);
            differences_of(&RenderSettings { spp, ..asked.clone() }, settings)
        }
        (JobSettings::Shot(asked), JobSettings::Shot(settings))
            if renderer
                .as_ref()
                .zip(source.renderer.as_ref())
                .is_some_and(|(asked, id)| asked.allows(id)) =>
        {
            differences_of(asked, settings)
        }
        _ => vec!["another renderer or version".to_owned()],
    };
    if !differences.is_empty() {
        let why = format!("it is of another quality ({})", differences.join("; "));
        return Err(BadInput::new(format!("--forecast: {why}")).hint(hint).into());
    }
    Ok(())
}

/// Settings that differ by their JSON names, with both values, such as `spp: 4 and 16`.
fn differences_of(asked: &impl Serialize, settings: &impl Serialize) -> Vec<String> {
    let (asked, settings) = (fields(asked), fields(settings));
    let names: BTreeSet<&String> = asked.keys().chain(settings.keys()).collect();
    let value = |of: &Map<String, Value>, name: &str| of.get(name).cloned().unwrap_or_default();
    let pairs = names.into_iter().map(|name| (name, value(&asked, name), value(&settings, name)));
    pairs.filter(|(_, a, b)| a != b).map(|(name, a, b)| format!("{name}: {a} and {b}")).collect()
}

/// Settings by name. A renderer's own settings stand beside the common ones.
fn fields(settings: &impl Serialize) -> Map<String, Value> {
    let Ok(Value::Object(mut fields)) = serde_json::to_value(settings) else { return Map::new() };
    if let Some(Value::Object(own)) = fields.remove("own") {
        fields.extend(own);
    }
    fields
}

fn job_name(name: &str) -> Result<&str> {
    let length = name.chars().count();
    let wrong = match length {
        0 => "a job has to have a name".to_owned(),
        _ if length > LONGEST_JOB_NAME => {
            format!("the name has {length} characters; a job's name has at most {LONGEST_JOB_NAME}")
        }
        _ if name.contains(char::is_control) => format!("{name:?} holds control characters"),
        _ => return Ok(name),
    };
    Err(BadInput::new(format!("--name: {wrong}"))
        .hint("set another name than the scene's with --name")
        .into())
}

/// The bundle's path from the template's folder. `None` if it leads out of that folder, which a template may
/// not.
fn bundle_default(bundle: &Path, out: Option<&Path>) -> Result<Option<String>> {
    let folder = match out.and_then(Path::parent) {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    let (Ok(folder), Ok(bundle)) = (folder.canonicalize(), bundle.canonicalize()) else { return Ok(None) };
    let Ok(below) = bundle.strip_prefix(&folder) else { return Ok(None) };
    let wrong = |why: &str| BadInput::new(format!("bundle {}: {why}", bundle.display()));
    let below =
        below.to_str().ok_or_else(|| wrong("its name is not valid Unicode, as a template requires"))?;
    if below.contains(char::is_control) {
        return Err(wrong("its name holds control characters, which a template must not").into());
    }
    let length = below.chars().count();
    if length > LONGEST_VALUE {
        let why = format!("its name has {length} characters; a template holds at most {LONGEST_VALUE}");
        return Err(wrong(&why).into());
    }
    Ok(Some(if below.is_empty() { ".".to_owned() } else { below.to_owned() }))
}

/// Seconds.
#[derive(Debug, PartialEq, Eq)]
struct Limits {
    frame: Option<u64>,
    cache: Option<u64>,
}

impl Limits {
    /// The requested limit, or limits from a forecast. The limit of a task of frames is that of the most
    /// expensive row of so many frames, and at least `PATIENCE` times what a chunk should take, since a farm
    /// may give later tasks more frames. The cache's follows from all frames together. Fails if the forecast
    /// is of other frames, or out of range.
    fn new(
        asked: Option<Duration>,
        forecast: Option<&ForecastDoc>,
        frames: &FrameSet,
        chunk: Option<Chunk>,
    ) -> Result<Self> {
        let mut limits = Self { frame: None, cache: None };
        if let Some(quote) = forecast {
            let quoted = FrameSet::from_frames(quote.frames.iter().map(|frame| frame.frame));
            if quoted.as_ref() != Some(frames) {
                let quoted = quoted.map_or("no frames".to_owned(), |quoted| format!("the frames {quoted}"));
                return Err(BadInput::new(format!("--forecast: it is of {quoted}, not of {frames}")).into());
            }
            let costs: Vec<f64> = quote.frames.iter().map(|frame| frame.cpu_seconds.p95).collect();
            let Chunk { frames: row, seconds } = chunk.unwrap_or(Chunk { frames: 1, seconds: 0 });
            let row = usize::try_from(row).unwrap_or(usize::MAX).clamp(1, costs.len().max(1));
            let dearest = costs.windows(row).map(|costs| costs.iter().sum()).fold(0.0, f64::max);
            let once = once_seconds(quote);
            let all = quote.total.cpu_seconds.p95;
            let frame = limit(once + dearest)?.max((seconds as f64 * PATIENCE) as u64);
            limits = Self { frame: Some(frame), cache: Some(limit(once + all)?) };
        }
        if let Some(asked) = asked {
            let whole = asked.as_secs() + u64::from(asked.subsec_nanos() > 0);
            limits = Self { frame: Some(whole), cache: Some(whole) };
        }
        Ok(limits)
    }
}

/// The time limit of a task with this forecast (P95), both in seconds.
fn limit(p95: f64) -> Result<u64> {
    // About thirty years. A larger number means that the file is wrong.
    if !(0.0..=1e9).contains(&p95) {
        return Err(BadInput::new(format!("--forecast: {p95} seconds of CPU time is out of range")).into());
    }
    Ok((p95 * PATIENCE).max(SHORTEST_LIMIT).ceil() as u64)
}

/// The description of the job. It contains no names, since some characters are not allowed.
fn description(source: &Source, frames: &FrameSet, forecast: Option<&ForecastDoc>) -> String {
    let count = frames.count();
    let ((width, height), samples) =
        (source.settings.size().unwrap_or((1, 1)), source.settings.samples().unwrap_or(1));
    let mut text = format!(
        "{} of {width} x {height} pixels, {} a pixel.\nScene {}.\n",
        counted(count, "frame"),
        counted(samples, "sample"),
        source.digest
    );
    if let Some(renderer) = &source.renderer {
        let renderer = renderer.to_string().replace(char::is_control, " ");
        text += &format!("Renderer {renderer}.\n");
    }
    if let Some(quote) = forecast {
        let cpu = &quote.total.cpu_seconds;
        let [p50, p80, p95] = [cpu.p50, cpu.p80, cpu.p95].map(seconds);
        text += &format!(
            "Forecast: {p50} of CPU time (P50), {p80} (P80), {p95} (P95) on a machine of speed 1.\n"
        );
        if let Some(cost) = &quote.cost {
            let [p50, p80, p95] = [cost.p50, cost.p80, cost.p95].map(|cost| money(cost.micro_units()));
            text += &format!("Costs {p50} (P50), {p80} (P80), {p95} (P95).\n");
        }
    }
    text
}

#[cfg(test)]
mod tests;
