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
mod tests {
    use super::*;
    use forelight_protocol::{RendererId, RendererRequest, SceneDigest, ShotSettings, Spent};
    use std::collections::BTreeMap;
    use std::fs;

    fn message<T: std::fmt::Debug>(result: Result<T>) -> String {
        result.unwrap_err().to_string()
    }

    #[test]
    fn a_name_that_a_job_cannot_have_is_refused() {
        let longest = "ä".repeat(LONGEST_JOB_NAME);
        assert_eq!(job_name(&longest).unwrap(), longest);
        assert!(message(job_name(&format!("{longest}x"))).contains("129 characters"));
        assert!(message(job_name("a\nb")).contains("control"));
        assert!(message(job_name("")).contains("has to have a name"));
    }

    #[test]
    fn a_bundle_is_named_from_the_templates_folder_or_not_at_all() {
        let dir = tempfile::tempdir().unwrap();
        let bundle = dir.path().join("shots/a {{b}} \"c\"");
        fs::create_dir_all(&bundle).unwrap();
        let seen = |out: &str| bundle_default(&bundle, Some(&dir.path().join(out))).unwrap();
        assert_eq!(seen("job.json").as_deref(), Some("shots/a {{b}} \"c\""));
        assert_eq!(seen("shots/job.json").as_deref(), Some("a {{b}} \"c\""));
        assert_eq!(seen("shots/a {{b}} \"c\"/job.json").as_deref(), Some("."));
        assert_eq!(seen("shots/../job.json").as_deref(), Some("shots/a {{b}} \"c\""));
        fs::create_dir(dir.path().join("jobs")).unwrap();
        assert_eq!(seen("jobs/job.json"), None);
        assert_eq!(seen("to/be/made/job.json"), None);

        let odd = dir.path().join("a\nb");
        fs::create_dir(&odd).unwrap();
        let refused = bundle_default(&odd, Some(&dir.path().join("job.json")));
        assert!(message(refused).contains("control characters"));
    }

    fn quote(frames: &str, p95: f64) -> ForecastDoc {
        let quantiles = |p95: f64| serde_json::json!({"mean": p95, "p50": p95, "p80": p95, "p95": p95});
        let rays = |value: f64| {
            let names = ["primary", "shadow", "transparent", "reflected", "refracted", "ambient", "specular"];
            names
                .map(|name| (name.to_owned(), quantiles(value)))
                .into_iter()
                .collect::<serde_json::Map<_, _>>()
        };
        let forecast = |value: f64| serde_json::json!({"rays": rays(1.0), "cache_records": [], "work": quantiles(1.0), "cpu_seconds": quantiles(value)});
        let frames: FrameSet = frames.parse().unwrap();
        let each = frames.iter().map(|frame| {
            let mut one = forecast(p95);
            one["frame"] = frame.into();
            one
        });
        serde_json::from_value(serde_json::json!({
            "frames": each.collect::<Vec<_>>(),
            "total": forecast(p95 * frames.count() as f64),
            "profiled": {"frames": [], "pixels": 0},
            "spent": {"work": 0, "cpu_seconds": 0.0, "fraction_of_forecast": 0.0},
            "calibrated": false,
            "cost": {"mean": 0, "p50": 12_500_000, "p80": 0, "p95": 0},
        }))
        .unwrap()
    }

    #[test]
    fn a_forecast_sets_limits_of_time_unless_one_is_asked_for() {
        let frames: FrameSet = "0-9".parse().unwrap();
        let limits = |asked, quote: Option<&ForecastDoc>| Limits::new(asked, quote, &frames, None);
        assert_eq!(limits(None, None).unwrap(), Limits { frame: None, cache: None });
        let dear = quote("0-9", 1000.25);
        assert_eq!(limits(None, Some(&dear)).unwrap(), Limits { frame: Some(4001), cache: Some(40010) });
        let cheap = quote("0-9", 20.0);
        assert_eq!(limits(None, Some(&cheap)).unwrap(), Limits { frame: Some(600), cache: Some(800) });
        let build = Spent { work: 9, cpu_nanos: 12_000_000_000 };
        let once = Some(ProcessCosts { load: Spent { work: 0, cpu_nanos: 500_000_000 }, build });
        let loaded = ForecastDoc { once, ..dear.clone() };
        assert_eq!(limits(None, Some(&loaded)).unwrap(), Limits { frame: Some(4051), cache: Some(40060) });
        let asked = Some(Duration::from_millis(1500));
        assert_eq!(limits(asked, Some(&dear)).unwrap(), Limits { frame: Some(2), cache: Some(2) });
        assert!(message(limits(None, Some(&quote("0-8", 1.0)))).contains("the frames 0-8, not of 0-9"));
        assert!(message(limits(None, Some(&quote("0-9", -1.0)))).contains("out of range"));
        assert!(message(limits(None, Some(&quote("0-9", 1e300)))).contains("out of range"));
    }

    #[test]
    fn a_task_has_as_many_frames_as_take_its_time() {
        let frames_of = |time: u64, quote: &ForecastDoc, threads| {
            chunk(Duration::from_secs(time), quote, threads).map(|chunk| (chunk.frames, chunk.seconds))
        };
        // Ten frames of 20 s each, and 100 s for loading.
        let load = Spent { work: 0, cpu_nanos: 100_000_000_000 };
        let once = Some(ProcessCosts { load, build: Spent::default() });
        let loaded = ForecastDoc { once, ..quote("0-9", 20.0) };
        assert_eq!(frames_of(600, &loaded, 1).unwrap(), (25, 600));
        assert_eq!(frames_of(600, &loaded, 4).unwrap(), (100, 600));
        assert_eq!(frames_of(86_400, &loaded, 1).unwrap(), (LARGEST_CHUNK, 86_400));
        assert_eq!(frames_of(120, &loaded, 1).unwrap(), (1, 120));
        let refused = message(frames_of(119, &loaded, 1));
        assert!(
            refused.starts_with(
                "--chunk: a frame takes 20.0 s by the forecast with --threads 1, after 1 min 40 s"
            ),
            "{refused}"
        );
        assert!(message(frames_of(60, &quote("0-9", 0.0), 1)).starts_with("--chunk: a frame takes"));
        // The time limit leaves room for the dearest frames in a row, and for more frames than were forecast.
        let mut uneven = loaded.clone();
        (3..5).for_each(|frame| uneven.frames[frame].cpu_seconds.p95 = 200.0);
        let frames: FrameSet = "0-9".parse().unwrap();
        let limit_of = |number| {
            let chunk = Some(Chunk { frames: number, seconds: 60 });
            Limits::new(None, Some(&uneven), &frames, chunk).unwrap().frame.unwrap()
        };
        assert_eq!([limit_of(1), limit_of(2), limit_of(3), limit_of(99)], [1200, 2000, 2080, 2640]);
        let Typed { args } = clap::Parser::try_parse_from(["export", "b"]).unwrap();
        let args = Args { chunk: Some(Duration::from_secs(600)), ..args };
        let settings = forelight_protocol::RenderSettingsRequest::default().complete((4, 2));
        let shot = exported(&args, source(settings, &frames), Some(&loaded), None).unwrap();
        assert_eq!((shot.chunk.unwrap().frames, shot.frame_limit), (25, Some(2400)));
    }

    fn source(settings: RenderSettings, frames: &FrameSet) -> Source {
        Source {
            name: "x".into(),
            digest: "00".repeat(32).parse().unwrap(),
            renderer: None,
            settings: settings.into(),
            set: BTreeMap::new(),
            formats: vec!["exr".into()],
            frames: frames.iter().collect(),
        }
    }

    #[derive(Debug, clap::Parser)]
    struct Typed {
        #[command(flatten)]
        args: Args,
    }

    #[test]
    fn what_a_job_cannot_hold_or_has_no_use_for_is_refused_by_its_flag() {
        let every_second = |frames: u32| FrameSet::from_frames((0..frames).map(|frame| 2 * frame)).unwrap();
        let exported = |flags: &str, change: fn(&mut RenderSettings), frames: u32| {
            let Typed { args } = clap::Parser::try_parse_from(flags.split(' ')).unwrap();
            let mut settings = forelight_protocol::RenderSettingsRequest::default().complete((4, 2));
            change(&mut settings);
            super::exported(&args, source(settings, &every_second(frames)), None, None)
        };
        assert_eq!(exported("export b", |_| (), 270).unwrap().frames.count(), 270);
        for (message, flag) in [
            (message(exported("export b", |_| (), 271)), "--frames: the list has 1028 characters"),
            (message(exported("export b", |settings| settings.seed = u64::MAX, 1)), "--seed"),
            (message(exported("export b --cache off --cache-parts 2", |_| (), 1)), "--cache-parts"),
            (
                message(exported(
                    "export b --cache on",
                    |settings| {
                        settings.cache = CacheMode::On;
                        settings.ambient_bounces = 0;
                    },
                    1,
                )),
                "--cache: these settings use no",
            ),
        ] {
            assert!(message.starts_with(flag), "{message}");
        }
    }

    #[test]
    fn a_quote_of_something_else_is_refused_with_what_differs() {
        let settings = forelight_protocol::RenderSettingsRequest::default().complete((4, 2));
        let of = |scene: SceneDigest, settings: &RenderSettings, chosen_spp| ForecastDoc {
            of: Some(QuotedShot { scene, renderer: None, settings: settings.clone().into() }),
            chosen_spp,
            ..quote("0-9", 1.0)
        };
        let frames: FrameSet = "0-9".parse().unwrap();
        let check = |quote: ForecastDoc, settings: &RenderSettings| {
            check_quoted(&quote, &source(settings.clone(), &frames))
        };
        let scene = || source(settings.clone(), &frames).digest;
        check(of(scene(), &settings, None), &settings).unwrap();
        let finer = RenderSettings { spp: 64, cache: CacheMode::On, ..settings.clone() };
        let refused = message(check(of(scene(), &settings, None), &finer));
        assert!(refused.contains("another quality (cache: \"off\" and \"on\"; spp: 16 and 64)"), "{refused}");
        let changed = "07".repeat(32).parse().unwrap();
        let refused = message(check(of(changed, &settings, None), &settings));
        assert!(refused.contains("another scene"), "{refused}");
        // The samples that a limit chose are those that count.
        let chosen = RenderSettings { spp: 37, ..settings.clone() };
        check(of(scene(), &settings, Some(37)), &chosen).unwrap();
        check(of(scene(), &settings, Some(37)), &settings).unwrap_err();
        // Quotes of older versions do not say what they are of.
        check(quote("0-9", 1.0), &settings).unwrap();
    }

    #[test]
    fn a_quote_of_another_renderer_is_held_against_its_version_and_settings() {
        let settings = |width, denoise: bool| ShotSettings {
            width: Some(width),
            height: Some(2),
            samples: Some(16),
            seed: Some(0),
            own: [("denoise".to_owned(), denoise.into())].into_iter().collect(),
        };
        let frames: FrameSet = "0-9".parse().unwrap();
        let source = |width, denoise| Source {
            renderer: Some(RendererId { name: "cycles".into(), version: "5.0.1".into() }),
            settings: JobSettings::Shot(settings(width, denoise)),
            ..source(forelight_protocol::RenderSettingsRequest::default().complete((4, 2)), &frames)
        };
        let asked = |version: &str| ForecastDoc {
            of: Some(QuotedShot {
                scene: source(4, true).digest,
                renderer: Some(RendererRequest { name: "cycles".into(), version: Some(version.into()) }),
                settings: JobSettings::Shot(settings(4, true)),
            }),
            ..quote("0-9", 1.0)
        };
        check_quoted(&asked("5.0"), &source(4, true)).unwrap();
        let refused = message(check_quoted(&asked("5.0.1"), &source(8, false)));
        assert!(refused.contains("(denoise: true and false; width: 4 and 8)"), "{refused}");
        let refused = message(check_quoted(&asked("4.5"), &source(4, true)));
        assert!(refused.contains("another renderer or version"), "{refused}");
    }

    #[test]
    fn the_memory_of_a_frame_is_asked_for_if_it_is_of_the_same_size() {
        let stats: FrameStats = serde_json::from_value(serde_json::json!({
            "frame": 0, "width": 4, "height": 2, "spp": 1, "effects": [], "work": 1, "cpu_seconds": 1.0, "wall_seconds": 1.0,
            "rays": {"primary": 8, "shadow": 0, "transparent": 0, "reflected": 0, "refracted": 0, "ambient": 0, "specular": 0},
            "peak_rss_bytes": (5u64 << 20) + 1,
        }))
        .unwrap();
        let Typed { args } = clap::Parser::try_parse_from(["export", "b"]).unwrap();
        let exported = |width: u32| {
            let settings = forelight_protocol::RenderSettingsRequest::default().complete((width, 2));
            super::exported(&args, source(settings, &"0".parse().unwrap()), None, Some(&stats))
        };
        assert_eq!(exported(4).unwrap().memory_mib, Some(6));
        assert!(message(exported(8)).contains("an image of 4 x 2 pixels, not of 8 x 2"));
    }

    #[test]
    fn the_description_says_what_the_shot_will_cost() {
        let settings = forelight_protocol::RenderSettingsRequest::default().complete((4, 2));
        let frames: FrameSet = "0-9".parse().unwrap();
        let text = description(&source(settings.clone(), &frames), &frames, Some(&quote("0-9", 20.0)));
        assert!(text.starts_with("10 frames of 4 x 2 pixels, 16 samples"), "{text}");
        assert!(text.contains("3 min 20 s (P95)") && text.contains("Costs 12.50 (P50)"), "{text}");
        assert!(!description(&source(settings, &frames), &frames, None).contains("Forecast"));
    }
}
