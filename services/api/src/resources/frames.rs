//! A job's frames and their pictures.

use axum::extract::State;
use axum::http::{HeaderMap, Method};
use axum::response::Response;
use forelight_protocol::{ArtifactHash, FrameArtifacts, FramePage, FrameRow, JobId, ProblemKind};

use super::responses::tagged;
use crate::delivery::{Asked, Keep, deliver};
use crate::error::{ApiError, ApiResult, Problems};
use crate::extract::{QueryParameters, SeenFrame, SeenJob};
use crate::page::{PageQuery, cut};
use crate::schema::FileContent;
use crate::state::App;

/// The frames of a job, ascending: forecast, actual, error, booking, times, pictures.
#[utoipa::path(get, path = "/v1/jobs/{id}/frames", operation_id = "frame_list",
    tag = "jobs", params(("id" = JobId, Path), PageQuery),
    responses((status = 200, description = "A page of frames", body = FramePage),
              (status = 304, description = "It is still that of `If-None-Match`"), Problems))]
pub(crate) async fn list(
    State(app): State<App>,
    SeenJob(job): SeenJob,
    QueryParameters(query): QueryParameters<PageQuery>,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let size = query.size();
    let mut items = app.store.frames(job, query.key("frames")?, size + 1).await?;
    let next_page_token = cut(&mut items, size, "frames", |row| row.frame);
    tagged(&headers, &FramePage { items, next_page_token })
}

/// One frame.
#[utoipa::path(get, path = "/v1/jobs/{id}/frames/{frame}", operation_id = "frame_get",
    tag = "jobs", params(("id" = JobId, Path), ("frame" = u32, Path)),
    responses((status = 200, description = "The frame", body = FrameRow),
              (status = 304, description = "It is still that of `If-None-Match`"), Problems))]
pub(crate) async fn get(
    State(app): State<App>,
    SeenFrame(job, frame): SeenFrame,
    headers: HeaderMap,
) -> ApiResult<Response> {
    tagged(&headers, &app.store.frame(job, frame).await?)
}

macro_rules! picture {
    ($(#[doc = $doc:literal])* $name:ident, $path:literal, $media:literal, $choose:expr) => {
        $(#[doc = $doc])*
        #[utoipa::path(get, path = $path, operation_id = concat!("frame_", stringify!($name)), tag = "jobs",
            params(("id" = JobId, Path), ("frame" = u32, Path), ("Range" = Option<String>, Header, description = "Ranges of bytes, at most 16"), ("If-Match" = Option<String>, Header, description = "Tags of which the file must have one")),
            responses((status = 200, description = "The picture", body = inline(FileContent), content_type = $media), (status = 206, description = "The ranges of it; of several, each with its place", content((inline(FileContent) = $media), (inline(FileContent) = "multipart/byteranges"))), (status = 304, description = "The picture is still that of `If-None-Match`"), Problems))]
        pub(crate) async fn $name(
            State(app): State<App>,
            SeenFrame(job, frame): SeenFrame,
            method: Method,
            headers: HeaderMap,
        ) -> ApiResult<Response> {
            picture(&app, job, frame, &Asked { method, headers }, $media, $choose).await
        }
    };
}

picture!(
    /// Object and material ids of a frame, in colour.
    preview_png, "/v1/jobs/{id}/frames/{frame}/preview.png", "image/png", |artifacts| artifacts.preview_png
);
picture!(
    /// Cost of each pixel of a frame, in colour.
    cost_map_png, "/v1/jobs/{id}/frames/{frame}/cost-map.png", "image/png", |artifacts| artifacts.cost_map_png
);
picture!(
    /// The image of a frame as PNG.
    image_png, "/v1/jobs/{id}/frames/{frame}/image.png", "image/png", |artifacts| artifacts.image_png
);
picture!(
    /// The image of a frame as OpenEXR, linear.
    image_exr, "/v1/jobs/{id}/frames/{frame}/image.exr", "image/x-exr", |artifacts| artifacts.image_exr
);

async fn picture(
    app: &App,
    job: JobId,
    frame: u32,
    asked: &Asked,
    media_type: &'static str,
    choose: impl Fn(&FrameArtifacts) -> Option<ArtifactHash>,
) -> ApiResult<Response> {
    let row = app.store.frame(job, frame).await?;
    let Some(hash) = choose(&row.artifacts) else {
        let reason = match row.actual {
            Some(_) => "the frame has no such picture, or it was deleted: images are kept for a limited time",
            None => "the frame does not have this picture yet",
        };
        return Err(ApiError::new(ProblemKind::NotFound, reason));
    };
    deliver(app, asked, hash, media_type, Keep::WhileItIsThere).await
}
