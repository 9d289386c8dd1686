//! Inspects bundles: whether they are scenes, and what they contain.

use std::io::Read as _;
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

/// Summary of a scene that only its renderer can open: name and hash of its file.
pub(crate) async fn unopened(path: PathBuf) -> ApiResult<SceneSummary> {
    let name =
        path.file_stem().map_or_else(|| "scene".to_owned(), |stem| stem.to_string_lossy().into_owned());
    let hash = tokio::task::spawn_blocking(move || {
        let mut hasher = blake3::Hasher::new();
        hasher.update_reader(std::fs::File::open(path)?)?;
        Ok::<_, std::io::Error>(*hasher.finalize().as_bytes())
    });
    let unreadable = |reason: String| ApiError::new(ProblemKind::InvalidBundle, reason);
    let hash = hash.await.map_err(|error| unreadable(error.to_string()))?;
    let hash = hash.map_err(|error| unreadable(format!("the scene cannot be read as one file: {error}")))?;
    Ok(unknown(name, SceneDigest(hash)))
}

/// Summary of an uploaded Blender file. Only its first bytes are read.
pub(crate) async fn blend(path: PathBuf, digest: SceneDigest) -> ApiResult<SceneSummary> {
    let first = tokio::task::spawn_blocking(move || {
        let mut first = Vec::new();
        std::fs::File::open(path)?.take(BLENDER.len() as u64).read_to_end(&mut first).map(|_| first)
    });
    let unreadable = |reason: String| ApiError::new(ProblemKind::InvalidBundle, reason);
    let first = first.await.map_err(|error| unreadable(error.to_string()))?;
    let first = first.map_err(|error| unreadable(error.to_string()))?;
    if first == BLENDER || COMPRESSED.iter().any(|magic| first.starts_with(magic)) {
        return Ok(unknown("blender-file".to_owned(), digest));
    }
    Err(unreadable(
        "this is no Blender file: save it with Blender, or send a zip file as application/zip".to_owned(),
    ))
}

/// How Blender files begin, and how they begin if they are compressed: Zstandard (RFC 8878), before Blender 3.0
/// gzip (RFC 1952).
const BLENDER: &[u8] = b"BLENDER";
const COMPRESSED: [&[u8]; 2] = [&[0x28, 0xb5, 0x2f, 0xfd], &[0x1f, 0x8b]];

/// A scene of which nothing is known yet.
fn unknown(name: String, digest: SceneDigest) -> SceneSummary {
    SceneSummary { name, digest, frames: 0, width: 0, height: 0, objects: 0, materials: 0, triangles: 0 }
}

/// Whether only another renderer can open the scene.
pub(crate) fn is_unknown(scene: &SceneSummary) -> bool {
    scene.frames == 0
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
