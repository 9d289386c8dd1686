//! Tasks of the farm that encode videos.

use crate::encoder::Encoder;
use bytes::Bytes;
use forelight_protocol::{ArtifactHash, Spent, TaskResult, TaskSpec, VIDEO_BYTES, VideoFile, VideoResult};
use forelight_renderer::door::{RendererError, Run};
use forelight_renderer::process::Sandbox;
use forelight_renderer::{Assignment, Control, Execute, ExecuteError, FETCHED, Outcome, failure, with_run};
use std::fs;
use std::sync::Arc;

/// Executes tasks that encode videos.
pub struct VideoTasks {
    encoder: Encoder,
    sandbox: Option<Arc<Sandbox>>,
}

impl VideoTasks {
    /// With this ffmpeg, in the sandbox if there is one.
    pub fn new(encoder: Encoder, sandbox: Option<Arc<Sandbox>>) -> Self {
        Self { encoder, sandbox }
    }
}

impl Execute for VideoTasks {
    fn execute(&self, assignment: &Assignment, control: &Control) -> Result<Outcome, ExecuteError> {
        let (TaskSpec::Video(spec), Some(pictures)) = (&assignment.spec, &assignment.pictures) else {
            return Err(ExecuteError::Permanent("the task is no video, or has no pictures".to_owned()));
        };
        let count = spec.pictures.len();
        with_run(assignment, control, self.sandbox.as_deref(), |run| {
            let progress = |share: f64| (run.progress)(FETCHED + (1.0 - FETCHED) * share);
            let encode = || {
                let run = Run { progress: &progress, ..*run };
                let encoded = self.encoder.encode((pictures.path(), count), spec.frames_per_second, &run)?;
                let bytes = fs::metadata(&encoded.path).map_err(RendererError::io(&encoded.path))?.len();
                if bytes > VIDEO_BYTES {
                    let reason = format!("the video has {bytes} bytes; at most {VIDEO_BYTES} are kept");
                    return Err(RendererError::Unsupported(reason));
                }
                let content = fs::read(&encoded.path).map_err(RendererError::io(&encoded.path))?;
                Ok((Bytes::from(content), encoded.usage))
            };
            let (content, usage) = encode().map_err(|error| failure(error, assignment))?;
            let file = VideoFile {
                hash: ArtifactHash(*blake3::hash(&content).as_bytes()),
                bytes: content.len() as u64,
                frames: u32::try_from(count).unwrap_or(u32::MAX),
            };
            let spent = Spent { work: 0, cpu_nanos: usage.cpu_nanos };
            let result = VideoResult { file, spent, peak_memory_bytes: usage.peak_memory_bytes };
            Ok(Outcome { result: TaskResult::Video(result), artifacts: vec![content] })
        })
    }
}
