//! Bundles, jobs, their quotes and their frames.

use crate::client::Client;
use crate::error::ClientError;
use crate::transport::{Payload, Request, parameters};
use bytes::Bytes;
use forelight_protocol::{
    AcceptRequest, AccuracyDoc, AnswersDoc, Bundle, ForecastDoc, FramePage, FrameRow, FramesRequest, Job,
    JobChange, JobCheck, JobId, JobPage, JobRequest, LeaveOutRequest, LeftOutJob, Money, TaskPage, TaskRow,
    Timestamp, VideoRequest,
};
use reqwest::Method;
use std::path::Path;
use std::time::Duration;
use uuid::Uuid;

/// Limit of one attempt at an answer about a plan. The service computes one at a time, and a large farm takes
/// long.
const PLANNING: Duration = Duration::from_secs(90);

/// The pictures that a frame may have.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FramePicture {
    /// Object and material ids in colour.
    Preview,
    /// The cost of each pixel in colour.
    CostMap,
    /// The image for viewing, 8 bits a channel.
    Png,
    /// The image in linear radiance.
    Exr,
}

impl FramePicture {
    /// The last part of the picture's address.
    pub const fn file_name(self) -> &'static str {
        match self {
            Self::Preview => "preview.png",
            Self::CostMap => "cost-map.png",
            Self::Png => "image.png",
            Self::Exr => "image.exr",
        }
    }
}

impl Client {
    /// Uploads a bundle as a zip file. Repeated with the same key, it is one upload.
    pub async fn upload_bundle(&self, file: &Path, key: Uuid) -> Result<Bundle, ClientError> {
        let is_blend = file.extension().is_some_and(|end| end.eq_ignore_ascii_case("blend"));
        let media_type = if is_blend { "application/x-blender" } else { "application/zip" };
        let payload = Payload::File(file.into(), media_type);
        let request = Request::new(Method::POST, "/v1/bundles").payload(payload);
        self.transport.json(&request.with_key(key)).await
    }

    /// Submits a job. Repeated with the same key, it is one job.
    pub async fn submit(&self, job: &JobRequest, key: Uuid) -> Result<Job, ClientError> {
        self.transport.json(&Request::json(Method::POST, "/v1/jobs", job).with_key(key)).await
    }

    /// What a submission of this job would answer. The service stores nothing.
    pub async fn check(&self, job: &JobRequest) -> Result<JobCheck, ClientError> {
        self.transport.json(&Request::json(Method::POST, "/v1/jobs/check", job)).await
    }

    /// One job.
    pub async fn job(&self, id: JobId) -> Result<Job, ClientError> {
        self.get(format!("/v1/jobs/{id}")).await
    }

    /// Accepts the quote of a job on hold. Repeated without changes, it changes nothing.
    pub async fn accept(&self, id: JobId, request: &AcceptRequest) -> Result<Job, ClientError> {
        let path = format!("/v1/jobs/{id}/accept");
        self.transport.json(&Request::json(Method::POST, path, request)).await
    }

    /// Changes deadline, budget or confidence of a job.
    pub async fn change_job(&self, id: JobId, change: &JobChange) -> Result<Job, ClientError> {
        self.transport.json(&Request::json(Method::PATCH, format!("/v1/jobs/{id}"), change)).await
    }

    /// Renders frames of a job again.
    pub async fn retry_frames(&self, id: JobId, request: &FramesRequest) -> Result<Job, ClientError> {
        self.transport
            .json(&Request::json(Method::POST, format!("/v1/jobs/{id}/frames/retry"), request))
            .await
    }

    /// Takes a job out of the track record.
    pub async fn leave_out(&self, id: JobId, request: &LeaveOutRequest) -> Result<LeftOutJob, ClientError> {
        let path = format!("/v1/jobs/{id}/left-out");
        self.transport.json(&Request::json(Method::PUT, path, request)).await
    }

    /// Puts a job back into the track record.
    pub async fn put_back(&self, id: JobId) -> Result<(), ClientError> {
        self.transport.send(&Request::new(Method::DELETE, format!("/v1/jobs/{id}/left-out"))).await.map(drop)
    }

    /// Cancels a job. Cancelling it again changes nothing.
    pub async fn cancel(&self, id: JobId) -> Result<Job, ClientError> {
        self.transport.json(&Request::new(Method::POST, format!("/v1/jobs/{id}/cancel"))).await
    }

    /// Has a video made of a job's frames, in place of an earlier one.
    pub async fn set_video(&self, id: JobId, request: &VideoRequest) -> Result<Job, ClientError> {
        self.transport.json(&Request::json(Method::PUT, format!("/v1/jobs/{id}/video"), request)).await
    }

    /// Deletes the video of a job.
    pub async fn delete_video(&self, id: JobId) -> Result<Job, ClientError> {
        self.transport.json(&Request::new(Method::DELETE, format!("/v1/jobs/{id}/video"))).await
    }

    /// The newest jobs of exactly this name, at most 50.
    pub async fn jobs_named(&self, name: &str) -> Result<Vec<Job>, ClientError> {
        self.newest_jobs(&[("name", name)], 50).await
    }

    /// The newest jobs that match the filters (`state`, `project`, `name`). `most` is at most 200.
    pub async fn newest_jobs(&self, filters: &[(&str, &str)], most: u32) -> Result<Vec<Job>, ClientError> {
        let page: JobPage = self.get(format!("/v1/jobs?page_size={most}{}", parameters(filters))).await?;
        Ok(page.items)
    }

    /// A job's quote.
    pub async fn forecast(&self, id: JobId) -> Result<ForecastDoc, ClientError> {
        self.get(format!("/v1/jobs/{id}/forecast")).await
    }

    /// The ladders of qualities in a job's quote.
    pub async fn accuracy(&self, id: JobId) -> Result<AccuracyDoc, ClientError> {
        self.get(format!("/v1/jobs/{id}/accuracy")).await
    }

    /// Answers about a job's plan. A given deadline or budget replaces the job's own.
    pub async fn answers(
        &self,
        id: JobId,
        deadline: Option<Timestamp>,
        budget: Option<Money>,
    ) -> Result<AnswersDoc, ClientError> {
        let deadline = deadline.map(|deadline| format!("deadline={deadline}"));
        let budget = budget.map(|budget| format!("budget={}", budget.micro_units()));
        let query: Vec<String> = deadline.into_iter().chain(budget).collect();
        let path = format!("/v1/jobs/{id}/answers?{}", query.join("&"));
        self.transport.json(&Request::get(path).timeout(Some(PLANNING))).await
    }

    /// A job's price against its deadline, as SVG.
    pub async fn price_curve(&self, id: JobId) -> Result<Bytes, ClientError> {
        self.bytes(&Request::get(format!("/v1/jobs/{id}/price-curve.svg")).timeout(Some(PLANNING))).await
    }

    /// Deletes a job that has ended.
    pub async fn delete_job(&self, id: JobId) -> Result<(), ClientError> {
        self.transport.send(&Request::new(Method::DELETE, format!("/v1/jobs/{id}"))).await.map(drop)
    }

    /// All frames of a job, ascending.
    pub async fn frames(&self, id: JobId) -> Result<Vec<FrameRow>, ClientError> {
        let parts = |page: FramePage| (page.items, page.next_page_token);
        self.all_pages(&format!("/v1/jobs/{id}/frames"), &[], parts).await
    }

    /// One frame.
    pub async fn frame(&self, id: JobId, frame: u32) -> Result<FrameRow, ClientError> {
        self.get(format!("/v1/jobs/{id}/frames/{frame}")).await
    }

    /// The tasks of one frame, oldest first.
    pub async fn tasks_of_frame(&self, id: JobId, frame: u32) -> Result<Vec<TaskRow>, ClientError> {
        let parts = |page: TaskPage| (page.items, page.next_page_token);
        let frame = frame.to_string();
        self.all_pages(&format!("/v1/jobs/{id}/tasks"), &[("frame", &frame)], parts).await
    }

    /// One picture of one frame.
    pub async fn picture(&self, id: JobId, frame: u32, picture: FramePicture) -> Result<Bytes, ClientError> {
        let path = format!("/v1/jobs/{id}/frames/{frame}/{}", picture.file_name());
        self.bytes(&Request::get(path).timeout(None)).await
    }
}
