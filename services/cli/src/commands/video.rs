//! `forelight video`: a job's frames as a video.

use super::cancel::find_any;
use super::submit::report::ended;
use crate::connection::{ConnectionOptions, connect};
use crate::job_options::mp4_file;
use anyhow::{Context, Result, bail};
use forelight_client::Client;
use forelight_protocol::{FrameRate, FrameState, Job, JobId, JobState, JobVideo, VideoRequest};
use forelight_terminal::atomic_file::{check, write_with};
use forelight_terminal::failure::{BadInput, Interrupted};
use forelight_terminal::interrupt::Interrupt;
use forelight_terminal::output::{self, Bars};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Time between two looks at a video that is being made.
const LOOK: Duration = Duration::from_millis(500);

/// Who does not wait for a node waits so long for one to take the video.
const PATIENCE: Duration = Duration::from_secs(120);

/// Make a video of a job's frames, and fetch it
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight video kitchen --out kitchen.mp4 --data farm-data
  forelight video kitchen --fps 12 --out slow.mp4 --server http://farm:7878 --token-file me.token
  forelight video kitchen --data farm-data            ask for it, and do not wait
  forelight video kitchen --delete --data farm-data

A node with ffmpeg encodes the finished frames as one task, when the last of them is finished. `forelight submit \
--video` asks for the video in advance. The file is MP4 with H.264. Cancelled frames are left out.")]
pub struct Args {
    /// Id of the job. A name works if only one job has it
    #[arg(value_name = "JOB")]
    job: String,
    /// Frames per second, 1 to 240, such as 24 or 23.976. Replaces a video of another rate [default: that of
    /// the video that there is; else those of the scene, or 24]
    #[arg(long, value_name = "RATE")]
    fps: Option<FrameRate>,
    /// Wait for the video, and write it to this file
    #[arg(long, value_name = "FILE", value_parser = mp4_file)]
    out: Option<PathBuf>,
    /// Delete the job's video
    #[arg(long, conflicts_with_all = ["fps", "out"])]
    delete: bool,
    /// Print the job as JSON to standard output
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    connection: ConnectionOptions,
}

pub async fn run(args: Args, interrupt: Interrupt) -> Result<()> {
    check([args.out.as_deref()])?;
    let bars = Bars::new(args.json);
    let client = connect(&args.connection)?;
    let id = find_any(&client, &args.job).await?;
    if args.delete {
        let job = client.delete_video(id).await.context("cannot delete the video")?;
        return tell(&args, &job, "it has no video");
    }
    let mut job = client.job(id).await.with_context(|| format!("cannot read job {id}"))?;
    if args.out.is_some() && !job.state.is_final() {
        let reason = format!("job {} is {}: its video is made when it is done", job.name, job.state);
        let hint = "leave out --out to ask for it; `forelight submit --job ID --out DIR` waits for the job";
        return Err(BadInput::new(reason).hint(hint).into());
    }
    if is_to_be_made(job.video.as_ref(), args.fps) {
        let present = job.video.as_ref().map(|video| video.frames_per_second);
        let request = VideoRequest { frames_per_second: args.fps.or(present) };
        job = client.set_video(id, &request).await.context("cannot have a video made")?;
    }
    let Some(out) = &args.out else {
        let said = match job.video.as_ref().map(|video| video.state) {
            Some(FrameState::Done) => "its video is there; --out fetches it",
            Some(FrameState::Ready | FrameState::Leased) => "its video is being made; --out waits for it",
            _ => "its video is made when the last frame is finished",
        };
        return tell(&args, &job, said);
    };
    let job = fetch(&client, id, (out, true), &bars, &interrupt).await?;
    tell(&args, &job, &format!("its video is {}", out.display()))
}

fn tell(args: &Args, job: &Job, what: &str) -> Result<()> {
    if args.json { output::json(job) } else { output::line(format!("{} ({}): {what}", job.name, job.id)) }
}

/// Whether a video has to be asked for: there is none of this rate, or it failed.
fn is_to_be_made(video: Option<&JobVideo>, fps: Option<FrameRate>) -> bool {
    video.is_none_or(|video| {
        fps.is_some_and(|fps| fps != video.frames_per_second)
            || matches!(video.state, FrameState::Failed | FrameState::Cancelled)
    })
}

/// Waits for the video of a job that is done, and writes it. With `for_node`, also until a node can make it.
pub(super) async fn fetch(
    client: &Client,
    id: JobId,
    (path, for_node): (&Path, bool),
    bars: &Bars,
    interrupt: &Interrupt,
) -> Result<Job> {
    let bar = bars.bar("video", 100);
    let stopped = interrupt.token();
    let waiting = async {
        let mut said = None;
        let since = Instant::now();
        loop {
            let job = client.job(id).await.context("cannot read the job")?;
            let Some(video) = job.video.clone() else { bail!("the job's video was deleted") };
            bar.set_position((video.progress * 100.0) as u64);
            match (video.file, video.state, &job.state) {
                (Some(file), _, _) => return Ok((job, file)),
                (None, FrameState::Failed, _) => {
                    bail!("the video failed: {}", video.error.as_deref().unwrap_or("no reason was given"))
                }
                (None, _, JobState::Done) => {}
                (None, _, state) => bail!("the job {}, so its video is not made now", ended(*state)),
            }
            let is_left = video.state == FrameState::Ready && since.elapsed() > PATIENCE;
            if !for_node && (is_left || video.waits.is_some()) {
                let reason = video.waits.as_deref().unwrap_or("no node has taken it yet");
                bail!("the video waits ({reason}); `forelight video {id} --out FILE` fetches it later");
            }
            if video.waits != said {
                video.waits.iter().for_each(|reason| bars.note(format!("the video waits: {reason}")));
                said = video.waits;
            }
            tokio::time::sleep(LOOK).await;
        }
    };
    let (job, file) = tokio::select! {
        done = waiting => done?,
        () = stopped.cancelled() => return Err(Interrupted.into()),
    };
    bar.finish_and_clear();
    let runtime = tokio::runtime::Handle::current();
    let (client, path) = (client.clone(), path.to_owned());
    let fetched = tokio::task::spawn_blocking(move || {
        write_with(&path, |temporary| Ok(runtime.block_on(client.artifact_to_file(file.hash, temporary))?))
    });
    fetched.await?.context("cannot fetch the video")?;
    Ok(job)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_video_is_asked_for_unless_there_is_one_of_this_rate() {
        let rate = |text: &str| text.parse::<FrameRate>().unwrap();
        let video = |state| JobVideo {
            frames_per_second: rate("24"),
            state,
            progress: 0.0,
            file: None,
            error: None,
            waits: None,
        };
        assert!(is_to_be_made(None, None));
        for state in [FrameState::Waiting, FrameState::Ready, FrameState::Leased, FrameState::Done] {
            assert!(!is_to_be_made(Some(&video(state)), None));
            assert!(!is_to_be_made(Some(&video(state)), Some(rate("24.0"))));
            assert!(is_to_be_made(Some(&video(state)), Some(rate("12"))));
        }
        assert!(is_to_be_made(Some(&video(FrameState::Failed)), None));
    }

    #[test]
    fn videos_are_mp4_files() {
        assert!(mp4_file("a/b.MP4").is_ok());
        assert!(mp4_file("video.webm").is_err());
    }
}
