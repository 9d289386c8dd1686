//! `forelight render --within` and `--error`: the camera samples follow from what the frame is to come to.

use crate::job_options::png_file;
use anyhow::{Context, Result, bail};
use clap::ValueEnum;
use forelight_protocol::{AllottedForecast, AllottedStats, BudgetClock, Confidence, Money, WithinStats};
use forelight_renderer_own::{Aim, AllotOptions, Budget, NEAR_ENOUGH, Stopwatch};
use forelight_scene::Frame;
use forelight_terminal::atomic_file::write_bytes;
use forelight_terminal::failure::BadInput;
use forelight_terminal::options::positive;
use forelight_terminal::quantities::{count, money, parse_money, parse_seconds, seconds};
use forelight_tracer::{Image, SampleCounts};
use image::{DynamicImage, ImageBuffer, ImageFormat, ImageReader, Luma};
use std::io::Cursor;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// What a frame is to come to, in place of a number of camera samples.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Camera samples by what they come to")]
pub struct AllotArgs {
    /// Make the best image for this time: seconds, or 5m, 1h30m. In place of --spp, every part of the image gets as many camera
    /// samples as pay there. All that you wait for counts: loading, preview, profile, cache and writing. The render looks at its clock as it goes, and
    /// holds to the time
    #[arg(long, value_name = "TIME", group = "aim", conflicts_with_all = ["spp", "profile"], value_parser = parse_seconds)]
    within: Option<f64>,
    /// The same for an amount of money, at --price an hour of wall time
    #[arg(long, value_name = "AMOUNT", group = "aim", requires = "price", conflicts_with_all = ["spp", "profile", "clock"], value_parser = parse_money)]
    within_money: Option<i64>,
    /// What an hour of this machine costs
    #[arg(long, value_name = "AMOUNT", requires = "within_money", value_parser = parse_money)]
    price: Option<i64>,
    /// Which seconds --within counts
    #[arg(long, value_name = "CLOCK", default_value = "wall", requires = "within")]
    clock: ClockName,
    /// Make the cheapest image whose noise is at most this share of its mean, in percent (root mean square over the pixels; a hundredth
    /// above is near enough), with at most 65,535 camera samples a pixel
    #[arg(long, value_name = "PERCENT", group = "aim", conflicts_with_all = ["spp", "profile"], value_parser = positive)]
    error: Option<f64>,
    /// How sure an error is to be kept; of a time, how sure the least image must fit for the render to begin
    #[arg(long, value_name = "QUANTILE", default_value = "p80", requires = "aim")]
    confidence: Confidence,
    /// Pixels to profile for it, 16 to a million
    #[arg(long, value_name = "PIXELS", default_value_t = 256, requires = "aim", value_parser = clap::value_parser!(u32).range(16..=1_000_000))]
    samples: u32,
    /// Write how many camera samples each pixel got, as a grey PNG of 16 bits
    #[arg(long, value_name = "FILE.png", value_parser = png_file)]
    samples_map: Option<PathBuf>,
    /// Give every pixel as many camera samples as such a file says: the same image again, bit by bit, whatever the clock
    #[arg(long, value_name = "FILE.png", conflicts_with_all = ["spp", "within", "within_money", "error", "profile"])]
    samples_from: Option<PathBuf>,
}

/// Which seconds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum ClockName {
    /// Those that you wait, from start to end.
    Wall,
    /// CPU time of all threads.
    Cpu,
}

/// What was asked for, with clocks that are running.
pub struct Wish<'a> {
    args: &'a AllotArgs,
    started: Instant,
}

impl AllotArgs {
    /// The flag by which time is limited, if it is.
    pub fn limit(&self) -> &'static str {
        if self.within_money.is_some() { "--within-money" } else { "--within" }
    }

    /// Counts wall time from `started` on.
    pub fn wish(&self, started: Instant) -> Wish<'_> {
        Wish { args: self, started }
    }

    /// The samples of each pixel, if they were given, for an image of this size.
    pub fn given_samples(&self, (width, height): (u32, u32)) -> Result<Option<SampleCounts>> {
        let Some(path) = &self.samples_from else { return Ok(None) };
        read_samples(path, width, height)
            .map(Some)
            .with_context(|| format!("--samples-from {}", path.display()))
    }

    /// Writes the samples of each pixel, if that is wanted.
    pub fn write_samples(&self, samples: &SampleCounts, (width, height): (u32, u32)) -> Result<()> {
        let Some(path) = &self.samples_map else { return Ok(()) };
        let pixels = ImageBuffer::<Luma<u16>, _>::from_raw(width, height, samples.as_slice().to_vec());
        let pixels = pixels.context("there are not as many camera samples as pixels")?;
        let mut bytes = Vec::new();
        pixels.write_to(&mut Cursor::new(&mut bytes), ImageFormat::Png)?;
        write_bytes(path, &bytes)
    }

    /// Whether samples that differ by pixel are wanted in a file; equally many everywhere are not worth one.
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
    /// How samples are to be allotted, if they are; `rehearse` writes an image for seeing how long that takes.
    pub fn options<'a>(
        &self,
        rehearse: &'a (dyn Fn(&Image, &Frame) + Sync),
    ) -> Result<Option<AllotOptions<'a>>> {
        let clock = match self.args.clock {
            ClockName::Wall => Stopwatch::Wall(self.started),
            ClockName::Cpu => Stopwatch::Cpu(0),
        };
        let within = |seconds: f64| Aim::Within(Budget { seconds, clock, rehearse });
        let aim = match (self.args.within, self.args.within_money, self.args.error) {
            (Some(seconds), ..) => within(seconds),
            (_, Some(amount), _) => within(self.affordable(amount)?),
            (.., Some(percent)) => Aim::Error(percent / 100.0),
            _ => return Ok(None),
        };
        let AllotArgs { confidence, samples, .. } = *self.args;
        Ok(Some(AllotOptions { aim, confidence, samples, seed: 0 }))
    }

    /// Seconds that an amount of money buys.
    fn affordable(&self, amount: i64) -> Result<f64> {
        match self.args.price {
            Some(price) if price > 0 && amount > 0 => Ok(3600.0 * amount as f64 / price as f64),
            _ => Err(BadInput::new("--within-money: amount and --price must be more than nothing").into()),
        }
    }

    /// That the image is as good as was asked for.
    ///
    /// # Errors
    /// If it is not, though its pixels have as many samples as they can.
    pub fn check_error(&self, allotted: &AllottedStats) -> Result<()> {
        let Some(percent) = self.args.error else { return Ok(()) };
        let reached = 100.0 * allotted.error.at(self.args.confidence);
        if reached <= percent * (1.0 + NEAR_ENOUGH) || allotted.most < u32::from(u16::MAX) {
            return Ok(());
        }
        bail!(
            "--error {percent}: the image is written, but its noise is {reached:.2} % of the mean: a pixel has at most {} camera samples",
            u16::MAX
        )
    }

    /// Now that everything is written: what it took in the end.
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
            "it is for {} x {} pixels and the image has {width} x {height}: give --width and --height as they were",
            found.0, found.1
        )));
    }
    let reader = ImageReader::open(path).map_err(|e| wrong(e.to_string()))?;
    let reader = reader.with_guessed_format().map_err(|e| wrong(e.to_string()))?;
    match reader.decode().map_err(|e| wrong(e.to_string()))? {
        DynamicImage::ImageLuma16(pixels) => {
            SampleCounts::new(pixels.into_raw()).map_err(|e| wrong(e.to_string()))
        }
        _ => Err(wrong("not a grey PNG of 16 bits, as --samples-map writes it".into())),
    }
}

/// Lines of the report.
pub fn report(allotted: &AllottedStats) -> String {
    let AllottedStats { least, most, mean, error, .. } = allotted;
    let mut text = format!(
        "allotted    {least} to {most} camera samples per pixel, {mean:.1} on average\n\
         noise       {:.2} % of the mean, as the image says itself (at 95 % {:.2} %)\n",
        100.0 * error.p50,
        100.0 * error.p95,
    );
    if let Some(AllottedForecast { work, cpu_seconds, profiling_cpu_seconds, .. }) = &allotted.forecast {
        text += &format!(
            "forecast    {} operations, {} CPU time (at 95 % {}) for these samples\n\
             profiled    {} of CPU time to find that out\n",
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
        text += &cost.map_or_else(String::new, |cost| format!("; {} of money", money(cost.0)));
        text += "\n";
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use forelight_terminal::options::parsed;

    /// Beside the flags that they exclude.
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
