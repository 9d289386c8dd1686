//! `forelight render --server`: renders one frame on the farm, and shows it as its parts come in.

use super::{Args, EffectsSwitch, Format, format_of};
use crate::commands::submit::report::ended;
use crate::commands::submit::upload::upload;
use crate::commands::submit::{self, division};
use crate::connection::{ConnectionOptions, Credentials, ServerOptions, connect};
use anyhow::{Context, Result, bail};
use forelight_client::{Client, FramePicture};
use forelight_pictures::{png, tone_map};
use forelight_protocol::words::counted;
use forelight_protocol::{
    ArtifactHash, CACHE_BYTES, Division, FrameSet, Job, JobId, JobRequest, JobState, TaskKind, TaskRow,
    Timestamp,
};
use forelight_renderer_own::colors_of_part;
use forelight_terminal::atomic_file::{self, write_bytes};
use forelight_terminal::failure::{BadInput, Interrupted};
use forelight_terminal::foreign::{is_foreign, refuse_because, refuse_own_settings};
use forelight_terminal::interrupt::Interrupt;
use forelight_terminal::json_file;
use forelight_terminal::local::settings_request;
use forelight_terminal::output::{self, Bars};
use forelight_terminal::quantities::{seconds, with_local_times};
use image::{ImageFormat, Rgb, RgbImage};
use std::collections::BTreeSet;
use std::path::PathBuf;
use std::time::Duration;
use uuid::Uuid;

/// How often the farm is asked for news.
const GLANCE: Duration = Duration::from_millis(500);

/// Colour of pixels that are not there yet: a dark grey.
const MISSING: Rgb<u8> = Rgb([24, 24, 24]);

/// Rendering on the farm.
#[derive(Debug, Clone, clap::Args)]
#[command(next_help_heading = "On the farm")]
pub struct FarmOptions {
    /// Render on the farm of this service, not on this machine
    #[arg(long, value_name = "URL")]
    server: Option<String>,
    /// Divide the frame into parts that several nodes render at the same time: auto as the plan sees fit, or a
    /// number of parts
    #[arg(long, value_name = "auto|N", default_value = "auto", value_parser = division, requires = "server")]
    parts: Division,
    /// Picture file to replace as parts come in, coarse at first. Image viewers that reload files show the frame
    /// grow
    #[arg(long, value_name = "FILE.png", value_parser = crate::job_options::png_file, requires = "server")]
    watch: Option<PathBuf>,
    /// Project that is charged for the job
    #[arg(long, default_value = "default", requires = "server")]
    project: String,
    #[command(flatten)]
    credentials: Credentials,
    /// Certificates in PEM form, to one of which that of an https:// service must lead [default: those of the
    /// system]
    #[arg(long, value_name = "FILE", env = "FORELIGHT_CA_FILE")]
    ca_file: Option<PathBuf>,
}

impl FarmOptions {
    /// The connection; `None` if the frame is rendered on this machine.
    fn connection(&self) -> Option<ConnectionOptions> {
        let server = ServerOptions { server: self.server.clone()?, ca_file: self.ca_file.clone() };
        Some(ConnectionOptions { server, credentials: self.credentials.clone() })
    }

    /// Refuses flags that say who asks a farm, if none is named: the frame would be rendered here.
    pub fn refuse_without_server(&self) -> Result<()> {
        let Credentials { data, token_file, .. } = &self.credentials;
        let flags = [("--data", data.is_some()), ("--token-file", token_file.is_some())];
        refuse_because(&flags, "only a render on the farm uses this", "add --server URL, or leave it out")
    }

    /// Whether the frame is rendered on the farm.
    pub fn is_asked(&self) -> bool {
        self.server.is_some()
    }
}

/// Renders one frame on the farm. If it is interrupted, the job is cancelled.
pub async fn run(args: &Args, interrupt: &Interrupt) -> Result<()> {
    refuse_others(args)?;
    let Some(connection) = args.farm.connection() else { bail!("no service was named") };
    let format = args.out.as_deref().map(format_of).transpose()?;
    atomic_file::check([args.out.as_deref(), args.farm.watch.as_deref(), args.stats.as_deref(), None])?;
    let client = connect(&connection)?;
    let bars = Bars::new(args.json);
    let job = submit_frame(args, &client, &bars, interrupt).await?;
    let stopped = interrupt.token();
    let done = tokio::select! {
        done = watch(args, &client, &job, &bars) => done?,
        () = stopped.cancelled() => {
            client.cancel(job.id).await.with_context(|| format!("cannot cancel job {}", job.id))?;
            return Err(anyhow::Error::from(Interrupted).context(format!("job {} was cancelled", job.id)));
        }
    };
    if done.state != JobState::Done {
        bail!(
            "job {} {} and was not rendered: {}",
            done.id,
            ended(done.state),
            done.error.as_deref().unwrap_or("no reason was given")
        );
    }
    let frame = frame_of(args)?;
    let row = client.frame(done.id, frame).await.context("cannot read the frame")?;
    if let (Some(path), Some(format)) = (&args.out, format) {
        let picture = match format {
            Format::Exr => FramePicture::Exr,
            Format::Png => FramePicture::Png,
        };
        let content = client.picture(done.id, frame, picture).await.context("cannot fetch the image")?;
        write_bytes(path, &content)?;
    }
    let stats = row.actual.context("the farm has no cost of the frame")?;
    json_file::write(args.stats.as_deref(), &stats)?;
    if args.json {
        output::json(&stats)?
    } else {
        let since = done.finished_at.map_or(0, |at| at.micros_since(done.created_at));
        let all = seconds(since as f64 * 1e-6);
        output::print(&super::report(&stats, args.effects))?;
        output::line(format!("on the farm {all} from the submission to the image"))?
    }
    stats.allotted.iter().try_for_each(|allotted| args.allot.check_error(allotted))
}

/// Options that only a render on this machine has.
fn refuse_others(args: &Args) -> Result<()> {
    if is_foreign(&args.bundle) {
        let reason = format!("{}: frames of other renderers are submitted as jobs", args.bundle.display());
        return Err(BadInput::new(reason).hint("use forelight submit --frames N --out FOLDER").into());
    }
    refuse_own_settings(&args.own)?;
    let others = [
        ("--effects", args.effects != EffectsSwitch::CalledFor),
        ("--cost-map", args.cost_map.is_some()),
        ("--profile", args.profile.is_some()),
        ("--cache-file", args.cache_file.is_some()),
        ("--within-money, --samples-map and --samples-from", args.allot.is_for_this_machine()),
    ];
    let hint = "leave it out, or leave out --server";
    refuse_because(&others, "only a render on this machine can do this", hint)
}

fn frame_of(args: &Args) -> Result<u32> {
    let frame = args.frame.unwrap_or(0);
    Ok(u32::try_from(frame).map_err(|_| BadInput::new(format!("--frame {frame}: frames begin at 0")))?)
}

async fn submit_frame(args: &Args, client: &Client, bars: &Bars, interrupt: &Interrupt) -> Result<Job> {
    let frame = frame_of(args)?;
    let (only, here) = (FrameSet::range(frame, frame), (&*args.bundle, &args.machine));
    let quality = args.cache_error.for_farm(&args.quality, Some(only), here, (bars, interrupt)).await?;
    let key = Uuid::now_v7();
    let (bundle, scene) = upload(&args.bundle, client, submit::upload_key(key), bars).await?;
    let settings = settings_request(&quality, (scene.width, scene.height));
    let request = JobRequest {
        division: args.farm.parts,
        project: args.farm.project.clone(),
        settings,
        denoise: args.denoise,
        within: args.allot.cpu_time(),
        error_target: args.allot.error_target(),
        samples: args.allot.samples(),
        confidence: args.allot.confidence(),
        ..JobRequest::new(format!("{} frame {frame}", scene.name), bundle, FrameSet::range(frame, frame))
    };
    client.submit(&request, key).await.context("cannot submit the frame")
}

/// Follows the job until it is over. Paints parts as they come in.
async fn watch(args: &Args, client: &Client, job: &Job, bars: &Bars) -> Result<Job> {
    let frame = frame_of(args)?;
    let bar = bars.bar("frame", 100);
    bars.note(format!("job {} on {}", job.id, client.address()));
    let size = job.settings.size().unwrap_or_default();
    let mut picture = Growing::new(size, args.farm.watch.clone());
    let mut waits = None;
    loop {
        let now = client.job(job.id).await.context("cannot follow the job")?;
        bar.set_position((now.progress * 100.0) as u64);
        let because = now.waits.as_ref().map(|waits| waits.because.clone());
        if because != waits {
            because.iter().for_each(|because| bars.note(with_local_times(because, Timestamp::now())));
            waits = because;
        }
        let tasks = client.tasks_of_frame(job.id, frame).await.context("cannot list the parts")?;
        bar.set_message(words(&now, &tasks));
        picture.add(client, job.id, &tasks).await?;
        if now.state.is_final() {
            bar.finish_and_clear();
            picture.finish(client, &now, frame).await?;
            return Ok(now);
        }
        tokio::time::sleep(GLANCE).await;
    }
}

/// What goes on, in a few words.
fn words(job: &Job, tasks: &[TaskRow]) -> String {
    let parts = || tasks.iter().filter(|task| task.kind == TaskKind::RenderPart);
    let done = parts().filter(|task| task.finished.is_some()).count();
    match parts().count() {
        0 => job.state.to_string(),
        all => format!("{}, {done} of {}", job.state, counted(all, "part")),
    }
}

/// A picture that grows by parts, in a file if one is named. It begins as a coarse picture of the frame; each
/// pass over a frame replaces it by a better one.
struct Growing {
    picture: RgbImage,
    file: Option<PathBuf>,
    there: BTreeSet<ArtifactHash>,
}

impl Growing {
    fn new((width, height): (u32, u32), file: Option<PathBuf>) -> Self {
        Self { picture: RgbImage::from_pixel(width, height, MISSING), file, there: BTreeSet::new() }
    }

    /// Paints the finished parts that are not there yet.
    async fn add(&mut self, client: &Client, job: JobId, tasks: &[TaskRow]) -> Result<()> {
        let Some(file) = self.file.clone() else { return Ok(()) };
        let coarse = tasks.iter().find_map(|task| task.coarse_png);
        let has_begun = match coarse.filter(|hash| !self.there.contains(hash)) {
            Some(hash) => self.begin(client, hash).await,
            None => false,
        };
        let new: Vec<ArtifactHash> =
            tasks.iter().filter_map(|task| task.pixels).filter(|hash| !self.there.contains(hash)).collect();
        for hash in &new {
            // A part is gone once the frame is put together. Then there is the image.
            let Ok(bytes) = client.artifact(*hash, CACHE_BYTES).await else { continue };
            let colors = colors_of_part(&bytes);
            let colors = colors.with_context(|| format!("a part of job {job} cannot be read"))?;
            for (index, color) in colors {
                let (x, y) = (index % self.picture.width(), index / self.picture.width());
                if let Some(place) = self.picture.get_pixel_mut_checked(x, y) {
                    *place = Rgb(tone_map(color));
                }
            }
            self.there.insert(*hash);
        }
        if has_begun || !new.is_empty() {
            write_bytes(&file, &png(&self.picture)?)?;
        }
        Ok(())
    }

    /// Begins with a coarse picture, or with that of the last pass over the frame. Without it, parts that are
    /// not there yet stay grey. Returns whether it was painted.
    async fn begin(&mut self, client: &Client, coarse: ArtifactHash) -> bool {
        let Ok(bytes) = client.artifact(coarse, CACHE_BYTES).await else { return false };
        // Parts are painted over it.
        self.there = BTreeSet::from([coarse]);
        let Ok(picture) = image::load_from_memory_with_format(&bytes, ImageFormat::Png) else { return false };
        let fits = (picture.width(), picture.height()) == self.picture.dimensions();
        if fits {
            self.picture = picture.into_rgb8();
        }
        fits
    }

    /// Replaces the picture by the finished one.
    async fn finish(&self, client: &Client, job: &Job, frame: u32) -> Result<()> {
        let Some(file) = self.file.as_ref().filter(|_| job.state == JobState::Done) else { return Ok(()) };
        let content =
            client.picture(job.id, frame, FramePicture::Png).await.context("cannot fetch the image")?;
        write_bytes(file, &content)
    }
}
