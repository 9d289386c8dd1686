//! Inspects bundles: whether they are scenes, and what they contain.

use std::path::{Path, PathBuf};

use forelight_protocol::{ProblemKind, SceneDigest, SceneSummary};
use forelight_scene::{Scene, SceneError};

use crate::error::{ApiError, ApiResult};
use crate::state::App;

/// Loads and describes a bundle. Errors call it `shown`, the client's name, instead of its path on the
/// service's disk. Loading needs a core and memory, so it runs on its own thread, and only a few run at a
/// time.
pub(crate) async fn inspect(app: &App, path: PathBuf, shown: &str) -> ApiResult<SceneSummary> {
    let stopped = |_| ApiError::new(ProblemKind::Busy, "the service is stopping");
    let _permit = app.checks.clone().acquire_owned().await.map_err(stopped)?;
    let limits = app.limits.scene;
    let own_path = path.display().to_string();
    let own_name = path.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
    let summary = tokio::task::spawn_blocking(move || summary(&path, &limits)).await.map_err(|error| {
        tracing::error!(%error, bundle = own_path, "loading a bundle panicked");
        ApiError::new(
            ProblemKind::Internal,
            "the bundle could not be inspected; the service's log has the cause",
        )
    })?;
    match summary {
        Ok(mut scene) => {
            // A scene without a name is named after its file. For an upload that is an internal name.
            if scene.name == own_name {
                scene.name = Path::new(shown)
                    .file_stem()
                    .map_or(shown.into(), |stem| stem.to_string_lossy().into_owned());
            }
            Ok(scene)
        }
        Err(error) => {
            Err(ApiError::new(ProblemKind::InvalidBundle, error.to_string().replace(&own_path, shown)))
        }
    }
}

fn summary(path: &Path, limits: &forelight_scene::Limits) -> Result<SceneSummary, SceneError> {
    let scene = Scene::load(path, limits)?;
    let first = scene.frame(0)?;
    let strata = scene.strata();
    Ok(SceneSummary {
        name: scene.name().to_owned(),
        digest: SceneDigest(scene.digest()),
        frames: scene.frame_count(),
        width: first.camera.width,
        height: first.camera.height,
        objects: strata.objects.len() as u64,
        materials: strata.materials() as u64,
        triangles: first.geometry.triangles.len() as u64,
    })
}

/// Canonical path of a bundle on shared storage.
///
/// Hazard: with `/scenes/../etc`, or a link out of a root, a client could have the service read files that it
/// may not see. So the canonical path must lie below a canonical root. Missing and forbidden paths get the
/// same answer, against probing.
pub(crate) async fn resolve(app: &App, path: &str) -> ApiResult<PathBuf> {
    let refused = || {
        let reason = if app.bundle_roots.is_empty() {
            "this service takes no bundles by path; upload it"
        } else {
            "there is no such bundle under the service's bundle roots"
        };
        ApiError::invalid("/bundle/path", reason)
    };
    if !Path::new(path).is_absolute() || path.contains('\0') {
        return Err(refused());
    }
    let canonical = tokio::fs::canonicalize(path).await.map_err(|_| refused())?;
    if app.bundle_roots.iter().any(|root| canonical.starts_with(root)) {
        Ok(canonical)
    } else {
        Err(refused())
    }
}
