//! Inspects bundles: whether they are scenes, and what they contain.

use std::io::Read as _;
use std::path::{Path, PathBuf};

use forelight_protocol::{ProblemKind, SceneDigest, SceneSummary};
use forelight_scene::open_regular;

use crate::error::{ApiError, ApiResult};
use crate::state::App;

/// Loads and describes a bundle. Errors call it `shown`, the client's name, instead of its path on the
/// service's disk.
pub(crate) async fn inspect(app: &App, path: PathBuf, shown: &str) -> ApiResult<SceneSummary> {
    let own_path = path.display().to_string();
    let own_name = path.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
    match app.inspector.inspect(path).await? {
        Ok(mut scene) => {
            // A scene without a name is named after its file. For an upload that is an internal name.
            if scene.name == own_name {
                scene.name = Path::new(shown)
                    .file_stem()
                    .map_or(shown.into(), |stem| stem.to_string_lossy().into_owned());
            }
            Ok(scene)
        }
        Err(reason) => Err(ApiError::new(ProblemKind::InvalidBundle, reason.replace(&own_path, shown))),
    }
}

/// Summary of a scene that only its renderer can open: name and hash of its file.
pub(crate) async fn unopened(path: PathBuf) -> ApiResult<SceneSummary> {
    let name =
        path.file_stem().map_or_else(|| "scene".to_owned(), |stem| stem.to_string_lossy().into_owned());
    let hash = tokio::task::spawn_blocking(move || {
        let mut hasher = blake3::Hasher::new();
        hasher.update_reader(open_regular(&path)?)?;
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
        open_regular(&path)?.take(BLENDER.len() as u64).read_to_end(&mut first).map(|_| first)
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
    SceneSummary {
        name,
        digest,
        frames: 0,
        width: 0,
        height: 0,
        objects: 0,
        materials: 0,
        triangles: 0,
        frames_per_second: None,
    }
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
            "this service takes no bundles by path: upload it, or have the service started with --bundle-root"
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
