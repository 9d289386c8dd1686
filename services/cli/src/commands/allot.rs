//! `forelight render --within` and `--error`: choose the camera samples for a time, a price or an error.

use crate::job_options::png_file;
use anyhow::{Context, Result, bail};
use clap::ValueEnum;
use forelight_protocol::{
    AllottedForecast, AllottedStats, BudgetClock, Confidence, ErrorTarget, Money, Per, Within, WithinStats,
};
use forelight_renderer_own::{Aim, AllotOptions, Budget, Stopwatch};
use forelight_scene::Frame;
use forelight_terminal::atomic_file::write_bytes;
use forelight_terminal::failure::BadInput;
use forelight_terminal::foreign::refuse_because;
use forelight_terminal::quantities::{count, money, parse_money, parse_seconds, seconds};
use forelight_tracer::{Image, SampleCounts};
use image::{DynamicImage, ImageBuffer, ImageFormat, ImageReader, Luma};
use std::io::Cursor;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// The goal of a frame, in place of a number of camera samples.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Camera samples by time, price or error")]
pub struct AllotArgs {
    /// Render the best image in this time: seconds, or 5m, 1h30m. Replaces --spp: each part of the image gets
    /// the camera samples that help most there. The time includes loading, preview, profile, cache and
    /// writing. The render checks the clock as it goes. With --server, it is CPU time on a node of speed 1
    #[arg(long, value_name = "TIME", group = "aim", conflicts_with_all = ["spp", "profile"], value_parser = parse_seconds)]
    within: Option<f64>,
    /// Render the best image for this amount of money. Needs --price
    #[arg(long, value_name = "AMOUNT", group = "aim", requires = "price", conflicts_with_all = ["spp", "profile", "clock"], value_parser = parse_money)]
    within_money: Option<i64>,
    /// Price of an hour of wall time on this machine
    #[arg(long, value_name = "AMOUNT", requires = "within_money", value_parser = parse_money)]
    price: Option<i64>,
    /// Clock of --within
    #[arg(long, value_name = "CLOCK", default_value = "wall", requires = "within")]
    clock: ClockName,
    /// Render the cheapest image with at most this noise, as a percentage of its mean (root mean square over
    /// the pixels). It may exceed the noise by a hundredth. A pixel gets at most 65,535 camera samples
    #[arg(long, value_name = "PERCENT", group = "aim", conflicts_with_all = ["spp", "profile"], value_parser = error_target)]
    error: Option<ErrorTarget>,
    /// Probability with which the image stays below --error, or with which the smallest image fits into
    /// --within
    #[arg(long, value_name = "QUANTILE", default_value = "p80", requires = "aim")]
    confidence: Confidence,
    /// Number of pixels to profile, 16 to a million: for the choice of samples, or with --error for the forecast
    #[arg(long, value_name = "PIXELS", default_value_t = 256, requires = "aim", value_parser = clap::value_parser!(u32).range(16..=1_000_000))]
    samples: u32,
    /// Write the number of camera samples of each pixel, as a grey PNG of 16 bits
    #[arg(long, value_name = "FILE.png", value_parser = png_file)]
    samples_map: Option<PathBuf>,
    /// Give each pixel the camera samples that a file from --samples-map says. The image has the same bits
    /// again
    #[arg(long, value_name = "FILE.png", conflicts_with_all = ["spp", "within", "within_money", "error", "profile"])]
    samples_from: Option<PathBuf>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum ClockName {
    /// Wall time, from start to end.
    Wall,
    /// CPU time of all threads.
    Cpu,
}

/// The goal, and the instant from which wall time counts.
pub struct Wish<'a> {
    args: &'a AllotArgs,
    started: Instant,
}

/// Parses an error in per cent of an image's mean.
pub fn error_target(text: &str) -> Result<ErrorTarget, String> {
    let percent = text.parse().map_err(|_| "expected a number such as 1.5".to_owned())?;
    ErrorTarget::of_percent(percent, Confidence::default())
}

impl AllotArgs {
    /// Refuses a price of which nothing is paid. clap would not require --within-money, which other flags
    /// exclude.
    pub fn check(&self) -> Result<()> {
        let is_unused = self.price.is_some() && self.within_money.is_none();
        let hint = "add --within-money AMOUNT, or leave it out";
        refuse_because(&[("--price", is_unused)], "only --within-money uses a price", hint)
    }

    /// Whether anything is asked for.
    pub fn is_given(&self) -> bool {
        self.within.is_some() || self.error.is_some() || self.is_for_this_machine()
    }

    /// Whether anything is asked for that only a render on this machine can do.
    pub fn is_for_this_machine(&self) -> bool {
        self.within_money.is_some() || self.samples_map.is_some() || self.samples_from.is_some()
    }

    /// The time of `--within`, as a farm counts it.
    pub fn cpu_time(&self) -> Option<Within> {
        let cpu_micros = self.within.map(|seconds| Some((seconds * 1e6).ceil() as i64))?;
        Some(Within { cpu_micros, money: None, per: Per::Frame })
    }

    /// The error of `--error`, with its confidence.
    pub fn error_target(&self) -> Option<ErrorTarget> {
        self.error.map(|target| ErrorTarget { confidence: self.confidence, ..target })
    }

    /// Fails if the noise exceeds `--error`, although a pixel has the most samples that it can have.
    pub fn check_error(&self, allotted: &AllottedStats) -> Result<()> {
        let Some(target) = self.error_target() else { return Ok(()) };
        if target.is_met(&allotted.error, 0) {
            return Ok(());
        }
        bail!(
            "--error {}: the image is written, but its noise is {:.2} % of the mean, and a pixel has at most {} camera samples",
            100.0 * target.share(),
            100.0 * allotted.error.at(target.confidence),
            ErrorTarget::MOST_SAMPLES
        )
    }

    pub fn confidence(&self) -> Confidence {
        self.confidence
    }

    /// Number of pixels to profile.
    pub fn samples(&self) -> u32 {
        self.samples
    }

    /// The flag that limits the time.
    pub fn limit(&self) -> &'static str {
        if self.within_money.is_some() { "--within-money" } else { "--within" }
    }

    pub fn wish(&self, started: Instant) -> Wish<'_> {
        Wish { args: self, started }
    }

    /// The samples of each pixel from `--samples-from`, for an image of this size.
    pub fn given_samples(&self, (width, height): (u32, u32)) -> Result<Option<SampleCounts>> {
        let Some(path) = &self.samples_from else { return Ok(None) };
        read_samples(path, width, height)
            .map(Some)
            .with_context(|| format!("--samples-from {}", path.display()))
    }

    /// Writes the file of `--samples-map`, if there is one.
    pub fn write_samples(&self, samples: &SampleCounts, (width, height): (u32, u32)) -> Result<()> {
        let Some(path) = &self.samples_map else { return Ok(()) };
        let pixels = ImageBuffer::<Luma<u16>, _>::from_raw(width, height, samples.as_slice().to_vec());
        let pixels = pixels.context("the number of camera samples differs from the number of pixels")?;
        let mut bytes = Vec::new();
        pixels.write_to(&mut Cursor::new(&mut bytes), ImageFormat::Png)?;
        write_bytes(path, &bytes)
    }

    /// The file of `--samples-map`. Fails if no flag varies the samples.
    pub fn check_map(&self) -> Result<Option<&Path>> {
        let allots = self.within.is_some()
            || self.within_money.is_some()
            || self.error.is_some()
            || self.samples_from.is_some();
        if self.samples_map.is_some() && !allots {
            return Err(BadInput::new(
                "--samples-map: without --within, --within-money or --error all pixels get --spp samples",
            )
            .into());
        }
        Ok(self.samples_map.as_deref())
    }
}

impl Wish<'_> {
    /// `None` without a goal. `rehearse` writes an image, to measure how long writing takes.
    pub fn options<'a>(
        &self,
        rehearse: &'a (dyn Fn(&Image, &Frame) + Sync),
    ) -> Result<Option<AllotOptions<'a>>> {
        let clock = match self.args.clock {
            ClockName::Wall => Stopwatch::Wall(self.started),
            ClockName::Cpu => Stopwatch::Cpu(0),
        };
        let within = |seconds: f64| Aim::Within(Budget { seconds, clock, rehearse });
        let aim = match (self.args.within, self.args.within_money) {
            (Some(seconds), _) => within(seconds),
            (_, Some(amount)) => within(self.affordable(amount)?),
            _ => match self.args.error_target() {
                Some(target) => Aim::Error(target.share()),
                None => return Ok(None),
            },
        };
        let AllotArgs { confidence, samples, .. } = *self.args;
        Ok(Some(AllotOptions { aim, confidence, samples, seed: 0 }))
    }

    fn affordable(&self, amount: i64) -> Result<f64> {
        match self.args.price {
            Some(price) if price > 0 && amount > 0 => Ok(3600.0 * amount as f64 / price as f64),
            _ => Err(BadInput::new("--within-money: the amount and --price must be greater than 0").into()),
        }
    }

    /// Sets the time and cost after everything is written.
    pub fn settle(&self, within: &mut WithinStats) {
        let clock = match within.clock {
            BudgetClock::Wall => Stopwatch::Wall(self.started),
            BudgetClock::Cpu => Stopwatch::Cpu(0),
        };
        within.spent_seconds = clock.elapsed();
        let micros = (self.started.elapsed().as_secs_f64() * 1e6).ceil() as i64;
        within.cost = self.args.price.map(|price| Money(price).for_micros_at_hourly_rate(micros));
    }
}

fn read_samples(path: &Path, width: u32, height: u32) -> Result<SampleCounts> {
    let wrong = |reason: String| anyhow::Error::from(BadInput::new(reason));
    let reader = ImageReader::open(path).map_err(|e| wrong(e.to_string()))?;
    let reader = reader.with_guessed_format().map_err(|e| wrong(e.to_string()))?;
    let found = reader.into_dimensions().map_err(|e| wrong(e.to_string()))?;
    if found != (width, height) {
        return Err(wrong(format!(
            "it is for {} x {} pixels, but the image has {width} x {height}; set the same --width and --height",
            found.0, found.1
        )));
    }
    let reader = ImageReader::open(path).map_err(|e| wrong(e.to_string()))?;
    let reader = reader.with_guessed_format().map_err(|e| wrong(e.to_string()))?;
    match reader.decode().map_err(|e| wrong(e.to_string()))? {
        DynamicImage::ImageLuma16(pixels) => {
            SampleCounts::new(pixels.into_raw()).map_err(|e| wrong(e.to_string()))
        }
        _ => Err(wrong("it is not a grey PNG of 16 bits from --samples-map".into())),
    }
}

pub fn report(allotted: &AllottedStats) -> String {
    let AllottedStats { least, most, mean, error, .. } = allotted;
    let mut text = format!(
        "allotted    {least} to {most} camera samples per pixel, {mean:.1} on average\n\
         noise       {:.2} % of the mean, estimated from the image (P95 {:.2} %)\n",
        100.0 * error.p50,
        100.0 * error.p95,
    );
    if let Some(AllottedForecast { work, cpu_seconds, profiling_cpu_seconds, .. }) = &allotted.forecast {
        text += &format!(
            "forecast    {} operations, {} CPU time (P95 {}) for these samples\n\
             profiling   {} of CPU time\n",
            count(work.mean),
            seconds(cpu_seconds.mean),
            seconds(cpu_seconds.p95),
            seconds(*profiling_cpu_seconds),
        );
    }
    if let Some(within) = &allotted.within {
        let WithinStats { clock, given_seconds, spent_seconds, passes, cost } = within;
        let clock = match clock {
            BudgetClock::Wall => "wall",
            BudgetClock::Cpu => "CPU",
        };
        text += &format!(
            "time        {} of {} {clock} time used ({:.1} %), in {passes} {}",
            seconds(*spent_seconds),
            seconds(*given_seconds),
            100.0 * spent_seconds / given_seconds,
            if *passes == 1 { "pass" } else { "passes" },
        );
        text += &cost.map_or_else(String::new, |cost| format!("; price {}", money(cost.0)));
        text += "\n";
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use forelight_terminal::options::parsed;

    /// The flags, with those that they exclude.
    #[derive(clap::Args)]
    struct Render {
        #[command(flatten)]
        allot: AllotArgs,
        #[arg(long)]
        spp: Option<u32>,
        #[arg(long)]
        profile: Option<String>,
    }

    fn flags<const N: usize>(flags: [&str; N]) -> AllotArgs {
        let Render { allot, spp, profile } = parsed(["render"].into_iter().chain(flags));
        assert_eq!((spp, profile), (None, None));
        allot
    }

    #[test]
    fn a_price_is_refused_where_nothing_is_paid() {
        let unused = flags(["--within", "60", "--price", "3"]).check().unwrap_err();
        assert!(unused.to_string().starts_with("--price: only --within-money"), "{unused}");
        flags(["--within-money", "1", "--price", "3"]).check().unwrap();
        flags([]).check().unwrap();
    }

    #[test]
    fn money_buys_hours() {
        let args = flags(["--within-money", "0.25", "--price", "1.80"]);
        assert_eq!(args.wish(Instant::now()).affordable(250_000).unwrap(), 500.0);
        let free = flags(["--within-money", "0.25", "--price", "0"]);
        assert!(free.wish(Instant::now()).options(&|_, _| ()).is_err());
    }

    #[test]
    fn a_map_of_samples_reads_back_and_only_for_its_size() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("samples.png");
        let text = path.to_str().unwrap();
        let counts = SampleCounts::new((1..=12).map(|i| i * 5000).collect()).unwrap();
        let args = flags(["--error", "2", "--samples-map", text]);
        args.write_samples(&counts, (4, 3)).unwrap();
        let args = flags(["--samples-from", text]);
        assert_eq!(args.given_samples((4, 3)).unwrap(), Some(counts));
        let error = format!("{:#}", args.given_samples((3, 4)).unwrap_err());
        assert!(error.contains("4 x 3") && error.contains("--samples-from"), "{error}");
        std::fs::write(&path, "no picture").unwrap();
        assert!(args.given_samples((4, 3)).is_err());
    }
}
