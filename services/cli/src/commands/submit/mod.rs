//! `forelight submit`: a job for the farm, followed to its images.

mod follow;
mod foreign;
pub mod images;
pub mod report;
pub mod upload;

use super::allot::error_target;
use super::cache_error::CacheErrorOption;
use super::cancel::find_any;
use super::video;
use super::worker::task_limits;
use crate::arguments::Flags;
use crate::connection::ConnectionOptions;
use crate::connection::connect;
use crate::failure::in_words;
use crate::job_options::deadline;
use crate::named;
use anyhow::{Context, Result, bail};
use forelight_client::Client;
use forelight_protocol::words::counted;
use forelight_protocol::{
    BundleRef, CacheSharing, Confidence, Division, ErrorTarget, FrameRate, FrameSet, Job, JobRequest,
    JobState, Ladders, MOST_PARTS, Money, OutputPattern, PartCount, Per, RenderSettingsRequest,
    RendererRequest, SceneSummary, Timestamp, VideoRequest, Within,
};
use forelight_terminal::atomic_file;
use forelight_terminal::failure::{BadInput, Interrupted};
use forelight_terminal::foreign::{OwnSetting, is_foreign, own_setting, refuse_own_settings};
use forelight_terminal::interrupt::Interrupt;
use forelight_terminal::local::settings_request;
use forelight_terminal::options::{MachineOptions, QualityOptions, duration};
use forelight_terminal::output::{self, Bars};
use forelight_terminal::quantities::{
    Deadline, clock, parse_bytes, parse_deadline, parse_money, parse_seconds,
};
use std::path::{Path, PathBuf};
use uuid::Uuid;

/// Submit a job to the farm, follow it, and fetch its images
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight submit kitchen/ --frames 0-47 --deadline 2h --data farm-data --out images/
  forelight submit kitchen/ --frames 0-47 --within 3h --confidence p95 --data farm-data
  forelight submit kitchen/ --frames 0-47 --error 2 --data farm-data
  forelight submit kitchen.zip --frames 0,12 --budget 12.50 --server http://farm:7878
  forelight submit /mnt/shots/kitchen --shared --frames 0-47 --deadline 'tomorrow 06:00'
  forelight submit /mnt/shots/kitchen.blend --shared --frames 1-250 --spp 256 --set denoise=false
  forelight submit kitchen/ --frames 0-47 --deadline 2h --hold --follow --data farm-data
  forelight submit /mnt/shots/hall.rif --shared --frames 1-12 --set ambient_bounces=1
  forelight submit --job 0192f0c1-7a3b-7c55-8f00-0123456789ab --follow --out images/

Without --follow and --out, the command prints the job's id and ends. A folder is packed and uploaded, unless the farm \
already has this bundle. Of a .blend file, Blender on this machine packs a copy that holds all files that it refers \
to; without Blender here, pack them yourself, or use --shared. With --follow or --out, the exit code is 0 only if all \
frames were delivered.

With --hold, the job waits with its complete quote, and nothing is booked. `forelight accept` books it; `forelight \
cancel` drops it.")]
pub struct Args {
    /// Scene: a .glb or .gltf file, or a bundle, which is a folder or a zip file. Or a .blend file, which nodes
    /// with Blender render, or a .rif file or octree, which nodes with Radiance render
    #[arg(required_unless_present = "job")]
    bundle: Option<PathBuf>,
    /// Follow this earlier job, by its id or name, instead of submitting a bundle
    #[arg(long, value_name = "JOB", conflicts_with_all = ["bundle", "frames", "deadline", "budget", "shared"])]
    job: Option<String>,
    /// Pass the bundle's path instead of uploading it. The service and all workers must share the storage
    #[arg(long)]
    shared: bool,
    /// Frames, such as 0-47 or 0,5,9-12 [default: the whole shot]
    #[arg(long, value_name = "LIST")]
    frames: Option<FrameSet>,
    /// Time by which all frames must be ready: 2h, 06:00, 'tomorrow 06:00', or 2030-03-01T06:00:00Z
    #[arg(long, value_name = "WHEN", value_parser = parse_deadline, allow_hyphen_values = true)]
    deadline: Option<Deadline>,
    /// Largest cost of the job, such as 12.50. Plans keep to it if possible, but it stops nothing.
    /// `forelight budget` sets limits that do
    #[arg(long, value_name = "AMOUNT", value_parser = parse_money)]
    budget: Option<i64>,
    /// Take as many camera samples as fit into this CPU time, for all frames together, and put them where
    /// they help most. Seconds or such as 90m, on a node of speed 1. --spp then sets only the samples of the
    /// profile
    #[arg(long, value_name = "TIME", group = "limit", value_parser = parse_seconds)]
    within: Option<f64>,
    /// The same for an amount of money, at the mean price of the farm's nodes
    #[arg(long, value_name = "AMOUNT", group = "limit", value_parser = parse_money)]
    within_money: Option<i64>,
    /// Apply --within or --within-money to each frame, instead of all frames together
    #[arg(long, requires = "limit")]
    per_frame: bool,
    /// Take the camera samples that keep the noise of each image at or below this percentage of its mean (root
    /// mean square over the pixels), and put them where they help most. --spp then sets only the samples of the
    /// profile. A pixel gets at most 65,535 camera samples
    #[arg(long, value_name = "PERCENT", conflicts_with_all = ["limit", "ladders"], value_parser = error_target)]
    error: Option<ErrorTarget>,
    /// Probability with which an image keeps to --error
    #[arg(long, value_name = "LEVEL", default_value = "p80", requires = "error")]
    error_confidence: Confidence,
    /// Quantile of the forecast that the booking and the choice of samples use
    #[arg(long, value_name = "LEVEL", default_value = "p80")]
    confidence: Confidence,
    /// Name of the job [default: the bundle's name]
    #[arg(long, value_name = "NAME")]
    name: Option<String>,
    /// Project of the job
    #[arg(long, value_name = "NAME", default_value = "default")]
    project: String,
    /// Priority among jobs with the same deadline, -1000 to 1000. A larger number goes first
    #[arg(long, value_name = "NUMBER", default_value_t = 0, value_parser = clap::value_parser!(i32).range(-1000..=1000))]
    priority: i32,
    /// Value of the job among jobs of equal priority, 1 to 1000. A job of 2 counts as much as two of 1
    #[arg(long, value_name = "NUMBER", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=1000))]
    weight: u32,
    /// Number of pixels to profile in each profiled frame, 16 to a million
    #[arg(long, value_name = "PIXELS", default_value_t = 256, value_parser = clap::value_parser!(u32).range(16..=1_000_000))]
    samples: u32,
    /// Largest number of frames to profile [default: 5, and up to 16 if the forecast is still uncertain and
    /// they cost less than 1 % of the shot]
    #[arg(long, value_name = "FRAMES", value_parser = clap::value_parser!(u32).range(1..=1000))]
    profile_frames: Option<u32>,
    /// Quote all ladders of qualities; `forelight accuracy --job` shows them. One frame is profiled with
    /// other settings too, which costs about 500,000 camera samples: a few percent of a large frame, several
    /// times a small one. With --denoise, the ladders show what is left of the error, for up to 2.5 million
    /// more [default: the ladders that the job's own profile covers]
    #[arg(long, conflicts_with = "limit")]
    ladders: bool,
    /// Share one irradiance cache between frames. Needs --cache on or --cache-error
    #[arg(long, value_name = "WAY", default_value = "auto")]
    cache_sharing: CacheSharing,
    /// Divide frames into parts that several nodes render at the same time: auto divides long frames where
    /// that keeps the deadline or ends the job earlier; a number divides every frame into as many parts; 1
    /// divides none
    #[arg(long, value_name = "auto|N", default_value = "auto", value_parser = division)]
    parts: Division,
    /// Also have the service write each image below its --output-root, such as
    /// {project}/{job}/{frame:04}.exr. Placeholders: {project}, {job}, {id}, {frame}, {frame:04}
    #[arg(long, value_name = "PATTERN")]
    output: Option<OutputPattern>,
    /// Remove the noise of the images by Open Image Denoise, and measure the error that is left. Nodes need it.
    /// An .exr file keeps the noisy image as noisy.R, G, B
    #[arg(long, conflicts_with_all = ["limit", "error"])]
    denoise: bool,
    /// Make a video of the frames when the last of them is finished. A node needs ffmpeg. With --out, it is
    /// written as video.mp4. The exit code does not depend on it
    #[arg(long)]
    video: bool,
    /// Frames per second of the video, 1 to 240, such as 24 or 23.976 [default: those of the scene, or 24]
    #[arg(long, value_name = "RATE", requires = "video")]
    fps: Option<FrameRate>,
    /// Renderer other than forelight's own, with its version or the beginning of it, such as "cycles 5.0"
    /// [default: any version of cycles for a .blend file, and of radiance for a .rif file or octree]. The
    /// version that previews the job also renders it
    #[arg(long, value_name = "NAME[ VERSION]", value_parser = renderer)]
    renderer: Option<RendererRequest>,
    /// Change a setting of another renderer, such as adaptive_sampling=false. May be repeated
    #[arg(long = "set", value_name = "NAME=VALUE", value_parser = own_setting())]
    own: Vec<OwnSetting>,
    /// Memory limit of a task, such as 8GiB. A task that exceeds it is ended [default: no limit]
    #[arg(long, value_name = "SIZE", value_parser = parse_bytes)]
    task_memory: Option<u64>,
    /// Time limit of a task. A task that exceeds it is ended [default: no limit]
    #[arg(long, value_name = "DURATION", value_parser = duration)]
    task_time: Option<std::time::Duration>,
    /// Idempotency key: a second submission with the same key submits nothing. Set the deadline as an instant
    /// then, because 2h from now differs each time
    #[arg(long, value_name = "UUID", value_parser = named::id::<Uuid>)]
    idempotency_key: Option<Uuid>,
    /// Wait with the complete quote until `forelight accept`. Book nothing before
    #[arg(long, conflicts_with_all = ["job", "out"])]
    hold: bool,
    /// Wait until the job ends, and print forecast and true cost of each frame. With --hold, wait for the
    /// quote
    #[arg(long)]
    follow: bool,
    /// Follow the job, and write images, cost maps and a contact sheet into this folder
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Print the result as JSON to standard output
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    quality: QualityOptions,
    #[command(flatten)]
    cache_error: CacheErrorOption,
    #[command(flatten)]
    connection: ConnectionOptions,
}
/// Reads `NAME` or `NAME VERSION`.
fn renderer(text: &str) -> Result<RendererRequest, String> {
    let (name, version) = match text.split_once(' ') {
        Some((name, version)) => (name, Some(version.to_owned())),
        None => (text, None),
    };
    let request = RendererRequest { name: name.to_owned(), version };
    request.check().map_err(|(_, reason)| reason)?;
    Ok(request)
}

pub async fn run(args: Args, interrupt: Interrupt) -> Result<()> {
    // The sheet is written last, after everything else was done.
    atomic_file::check([args.out.as_ref().map(|folder| folder.join(images::SHEET)).as_deref()])
        .context("--out")?;
    let bars = Bars::new(args.json);
    let client = connect(&args.connection)?;
    let job = match (&args.job, &args.bundle) {
        (Some(wanted), _) => {
            let id = find_any(&client, wanted).await?;
            client.job(id).await.with_context(|| format!("cannot follow job {id}"))?
        }
        (None, Some(bundle)) => {
            let is_new = is_new_project(&client, &args.project).await;
            let job = submit(&args, bundle, &client, &bars, &interrupt).await?;
            if is_new {
                bars.note(format!("project \"{}\" is new; `forelight project` lists all", args.project));
            }
            job
        }
        (None, None) => return Err(BadInput::new("name a bundle, or a job by --job").into()),
    };
    if let (Some(at), None) = (job.deadline, &args.job) {
        bars.note(format!("deadline {}", clock(at, Timestamp::now())));
    }
    if !args.follow && args.out.is_none() {
        return if args.json { output::json(&job) } else { output::line(job.id.to_string()) };
    }
    bars.note(format!("job {} \"{}\", {}", job.id, job.name, counted(job.frames_total, "frame")));
    let mut job = follow::follow(&client, job, &bars, &interrupt).await?;
    if job.state == JobState::Quoted {
        return show_quote(&client, &job, args.json).await;
    }
    let frames = client.frames(job.id).await.context("cannot read the frames")?;
    let forecast = client.forecast(job.id).await.ok();
    let mut deleted = None;
    if let Some(folder) = &args.out {
        deleted = images::fetch(&client, &job, &frames, folder, &bars, &interrupt).await?;
        if job.state == JobState::Done && job.video.is_some() {
            // The frames are what was asked for: they are reported whatever becomes of the video.
            let file = folder.join("video.mp4");
            match video::fetch(&client, job.id, (&file, false), &bars, &interrupt).await {
                Ok(with_video) => job = with_video,
                Err(error) if error.is::<Interrupted>() => return Err(error),
                Err(error) => bars.note(in_words(&error, &Flags::default())),
            }
        }
    }
    if args.json {
        output::json(&report::Document { job: &job, forecast: forecast.as_ref(), frames: &frames })?;
    } else {
        output::print(&report::report(&job, forecast.as_ref(), &frames, Timestamp::now()))?;
    }
    if let Some(deleted) = deleted {
        bail!("{}; {}", images::were_deleted(&deleted), images::again(&job, &deleted));
    }
    match job.state {
        JobState::Done => Ok(()),
        JobState::Failed => {
            bail!("the job failed: {}", job.error.as_deref().unwrap_or("no reason was given"))
        }
        state => {
            bail!("the job is {state}; delivered: {}", report::delivered(job.frames_done, job.frames_total))
        }
    }
}

/// Whether a submission makes its project. Its name may be misspelt then.
async fn is_new_project(client: &Client, project: &str) -> bool {
    let known = client.projects().await;
    known.is_ok_and(|known| known.items.iter().all(|known| known.project != project))
}

/// Prints the quote of a job that waits to be accepted.
async fn show_quote(client: &Client, job: &Job, as_json: bool) -> Result<()> {
    let forecast = client.forecast(job.id).await.context("cannot read the quote")?;
    if as_json {
        return output::json(&report::Document { job, forecast: Some(&forecast), frames: &[] });
    }
    let answers = client.answers(job.id, None, None).await.context("cannot ask what a plan would do")?;
    output::print(&report::quoted(job, &forecast, &answers, Timestamp::now()))
}

async fn submit(
    args: &Args,
    bundle: &Path,
    client: &Client,
    bars: &Bars,
    interrupt: &Interrupt,
) -> Result<Job> {
    let key = args.idempotency_key.unwrap_or_else(Uuid::now_v7);
    if is_foreign(bundle) || args.renderer.is_some() {
        let request = foreign::request(args, bundle, client, (key, bars, interrupt)).await?;
        return client.submit(&request, key).await.context("cannot submit the job");
    }
    refuse_own_settings(&args.own)?;
    let here = (bundle, &MachineOptions::default());
    let frames = args.frames.clone();
    let quality = args.cache_error.for_farm(&args.quality, frames, here, (bars, interrupt)).await?;
    let (reference, scene) = if args.shared {
        shared(args, bundle, client).await?
    } else {
        upload::upload(bundle, client, upload_key(key), bars).await?
    };
    let frames = args.frames.clone().unwrap_or_else(|| FrameSet::range(0, scene.frames.saturating_sub(1)));
    let settings = settings_request(&quality, (scene.width, scene.height));
    let request = request(args, reference, scene.name, frames, settings)?;
    client.submit(&request, key).await.context("cannot submit the job")
}

/// Key of the upload. It differs from the submission's, and both follow from the user's key, if there is one.
pub(super) fn upload_key(key: Uuid) -> Uuid {
    Uuid::from_u128(key.as_u128() ^ 1)
}

fn request(
    args: &Args,
    bundle: BundleRef,
    scene_name: String,
    frames: FrameSet,
    settings: RenderSettingsRequest,
) -> Result<JobRequest> {
    let deadline = deadline(args.deadline, jiff::Timestamp::now())?;
    Ok(JobRequest {
        name: args.name.clone().unwrap_or(scene_name),
        project: args.project.clone(),
        bundle,
        renderer: None,
        frames,
        settings,
        cache: args.cache_sharing,
        division: args.parts,
        output: args.output.clone(),
        video: args.video.then_some(VideoRequest { frames_per_second: args.fps }),
        denoise: args.denoise,
        samples: args.samples,
        profile_frames: args.profile_frames,
        ladders: if args.ladders { Ladders::All } else { Ladders::Own },
        within: within(args),
        error_target: args.error.map(|target| ErrorTarget { confidence: args.error_confidence, ..target }),
        deadline,
        budget: args.budget.map(Money),
        confidence: args.confidence,
        priority: args.priority,
        weight: args.weight,
        limits: task_limits(args.task_memory, args.task_time),
        hold: args.hold,
    })
}

/// Into how many parts frames are divided, as `--parts` has it.
pub(super) fn division(text: &str) -> Result<Division, String> {
    match text.parse() {
        _ if text == "auto" => Ok(Division::Auto),
        Ok(1) => Ok(Division::Whole),
        Ok(parts) if (2..=MOST_PARTS).contains(&parts) => Ok(Division::Into(PartCount(parts))),
        _ => Err(format!("use auto or a number from 1 to {MOST_PARTS}")),
    }
}

/// The limit on the cost of the frames, if one sets the samples.
fn within(args: &Args) -> Option<Within> {
    let per = if args.per_frame { Per::Frame } else { Per::Job };
    let cpu_micros = args.within.map(|seconds| (seconds * 1e6).ceil() as i64);
    let money = args.within_money.map(Money);
    (cpu_micros.is_some() || money.is_some()).then_some(Within { cpu_micros, money, per })
}

/// The bundle's absolute path.
fn on_shared_storage(bundle: &Path) -> Result<BundleRef> {
    let absolute = bundle
        .canonicalize()
        .map_err(|error| BadInput::new(format!("bundle {}: {error}", bundle.display())))?;
    let path = absolute
        .to_str()
        .ok_or_else(|| BadInput::new(format!("bundle {}: the path must be UTF-8", bundle.display())))?;
    Ok(BundleRef { id: None, path: Some(path.to_owned()) })
}

/// A bundle on shared storage. The service describes its content.
async fn shared(args: &Args, bundle: &Path, client: &Client) -> Result<(BundleRef, SceneSummary)> {
    let reference = on_shared_storage(bundle)?;
    let question = request(
        args,
        reference.clone(),
        "check".into(),
        FrameSet::range(0, 0),
        RenderSettingsRequest::default(),
    )?;
    // This request only reads the scene. The job's submission checks whether its caches can be shared.
    let question = JobRequest { cache: CacheSharing::Auto, ..question };
    let check = client.check(&question).await.context("the farm cannot use the bundle")?;
    Ok((reference, check.scene))
}
