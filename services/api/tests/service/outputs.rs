//! Images that are written where their job wants them.

use std::os::unix::fs::PermissionsExt as _;

use crate::support::{Answer, Farm, eventually, until};
use forelight_protocol::{FrameRow, Job, JobState, ProblemKind};
use reqwest::StatusCode;
use serde_json::json;

/// A farm with an output root beside its data.
async fn with_root() -> Farm {
    Farm::with(|config| {
        let root = config.data_dir.with_file_name("images");
        std::fs::create_dir(&root).unwrap();
        std::fs::set_permissions(&root, std::fs::Permissions::from_mode(0o2775)).unwrap();
        config.output_root = Some(root);
    })
    .await
}

impl Farm {
    fn images(&self) -> std::path::PathBuf {
        self.folder.path().join("images")
    }

    async fn with_output(&self, name: &str, pattern: &str) -> Job {
        let mut request = self.job_request("0-1");
        (request["name"], request["output"]) = (json!(name), json!(pattern));
        self.submitter.post("/v1/jobs", &request).await.parsed(StatusCode::CREATED).await
    }

    async fn row(&self, job: &Job, frame: u32) -> FrameRow {
        self.viewer.get(&format!("/v1/jobs/{}/frames/{frame}", job.id)).await.parsed(StatusCode::OK).await
    }

    /// Waits until the frame's image is written, or cannot be.
    async fn until_told(&self, job: &Job, frame: u32) -> FrameRow {
        eventually("the image is written", async || {
            let row = self.row(job, frame).await;
            let is_told = row.output.as_ref().is_some_and(|output| output.written || output.error.is_some());
            is_told.then_some(row)
        })
        .await
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn images_are_written_below_the_root_as_soon_as_their_frames_are_done() {
    let farm = with_root().await;
    let node = farm.node("a").await;
    let job = farm.with_output("../shot 12", "{project}/{job}/{frame:04}.exr").await;
    assert_eq!(farm.work_off(&node, &job).await.state, JobState::Done);
    for frame in 0..2 {
        let row = farm.until_told(&job, frame).await;
        let output = row.output.unwrap();
        assert_eq!(output.path, format!("default/_._shot 12/{frame:04}.exr"));
        assert!(output.written && output.error.is_none());
        let written = std::fs::read(farm.images().join(&output.path)).unwrap();
        assert_eq!(blake3::hash(&written).as_bytes(), &row.artifacts.image_exr.unwrap().0);
    }
    let folder = farm.images().join("default/_._shot 12");
    let mode = |path: &std::path::Path| std::fs::metadata(path).unwrap().permissions().mode() & 0o7777;
    let modes = (mode(&farm.images().join("default")), mode(&folder), mode(&folder.join("0000.exr")));
    assert_eq!(modes, (0o2775, 0o2775, 0o664), "those of the root, so that others can read them");
    assert_eq!(std::fs::read_dir(folder).unwrap().count(), 2, "nothing unfinished is left");
}

#[tokio::test(flavor = "multi_thread")]
async fn an_image_that_cannot_be_written_says_why_and_is_written_once_it_can_be() {
    let farm = with_root().await;
    let node = farm.node("a").await;
    // A file is in the way of the folder.
    std::fs::write(farm.images().join("shots"), "in the way").unwrap();
    let job = farm.with_output("a job", "shots/{frame}.png").await;
    assert_eq!(farm.work_off(&node, &job).await.state, JobState::Done);
    let row = farm.until_told(&job, 0).await;
    let output = row.output.unwrap();
    assert!(!output.written && output.error.unwrap().starts_with("shots/0.png: "));
    std::fs::remove_file(farm.images().join("shots")).unwrap();
    // It stays due when the service is killed.
    let root = farm.images();
    let farm = farm.restarted_with(|config| config.output_root = Some(root)).await;
    until("the image is there", async || farm.images().join("shots/1.png").exists()).await;
    let row = farm.until_told(&job, 1).await;
    let written = std::fs::read(farm.images().join("shots/1.png")).unwrap();
    assert_eq!(blake3::hash(&written).as_bytes(), &row.artifacts.image_png.unwrap().0);
}

#[tokio::test(flavor = "multi_thread")]
async fn no_link_below_the_root_leads_out_of_it() {
    let farm = with_root().await;
    let node = farm.node("a").await;
    let outside = farm.folder.path().join("outside");
    std::fs::create_dir(&outside).unwrap();
    std::os::unix::fs::symlink(&outside, farm.images().join("link")).unwrap();
    let job = farm.with_output("a job", "link/{frame}.exr").await;
    assert_eq!(farm.work_off(&node, &job).await.state, JobState::Done);
    let row = farm.until_told(&job, 0).await;
    assert!(row.output.unwrap().error.is_some());
    assert_eq!(std::fs::read_dir(&outside).unwrap().count(), 0);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_pattern_without_a_root_or_that_is_none_is_refused() {
    let farm = Farm::new().await;
    let mut request = farm.job_request("0");
    request["output"] = json!("{frame}.exr");
    let problem = farm.submitter.post("/v1/jobs", &request).await.problem(ProblemKind::Invalid).await;
    assert_eq!(problem.pointer.as_deref(), Some("/output"));
    let farm = with_root().await;
    for pattern in ["../{frame}.exr", "/tmp/{frame}.exr", "{job}.exr"] {
        request["output"] = json!(pattern);
        let problem = farm.submitter.post("/v1/jobs", &request).await.problem(ProblemKind::Invalid).await;
        assert_eq!(problem.pointer.as_deref(), Some("/output"), "{pattern}");
    }
}

#[tokio::test]
async fn a_token_of_some_projects_writes_into_their_folders_alone() {
    let farm = with_root().await;
    farm.project("ads").await;
    let (ads, _) = farm.new_token(json!({"name": "ads", "projects": {"ads": "submitter"}})).await;
    let mut request = farm.job_request("0");
    request["project"] = json!("ads");
    for (pattern, status) in [
        ("film/{frame:04}.exr", StatusCode::UNPROCESSABLE_ENTITY),
        ("{job}/{project}/{frame}.exr", StatusCode::UNPROCESSABLE_ENTITY),
        ("{project}/{frame:04}.exr", StatusCode::CREATED),
    ] {
        request["output"] = json!(pattern);
        assert_eq!(ads.post("/v1/jobs", &request).await.status(), status, "{pattern}");
    }
}
