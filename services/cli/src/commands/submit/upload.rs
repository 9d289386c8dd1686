//! Uploads what a job renders. Folders and single files are packed first.

use crate::archive;
use anyhow::{Context, Result};
use forelight_client::Client;
use forelight_protocol::{BundleRef, SceneSummary};
use forelight_scene::{Limits, Scene};
use forelight_terminal::failure::BadInput;
use forelight_terminal::output::Bars;
use std::fs::{File, metadata};
use std::io::{BufWriter, Read as _};
use std::path::Path;
use tempfile::NamedTempFile;
use uuid::Uuid;

/// What a zip file begins with.
const ZIP: [u8; 2] = *b"PK";

/// Uploads a bundle: a folder, a zip file, or a single scene file with the files that it refers to.
pub async fn upload(
    bundle: &Path,
    client: &Client,
    key: Uuid,
    bars: &Bars,
) -> Result<(BundleRef, SceneSummary)> {
    let about =
        metadata(bundle).map_err(|error| BadInput::new(format!("bundle {}: {error}", bundle.display())))?;
    let spinner = bars.spinner(format!("uploading {}", bundle.display()));
    // The temporary file must exist until the upload ends.
    let packed;
    let file = if about.is_dir() || is_single(bundle) {
        let bundle = bundle.to_owned();
        packed = tokio::task::spawn_blocking(move || pack(&bundle)).await??;
        packed.path()
    } else {
        check(bundle)?;
        bundle
    };
    let uploaded = client.upload_bundle(file, key).await;
    spinner.finish_and_clear();
    let uploaded = uploaded.with_context(|| format!("cannot upload {}", bundle.display()))?;
    Ok((BundleRef { id: Some(uploaded.id), path: None }, uploaded.scene))
}

/// Whether the scene is a single file, beside which others may lie: glTF, or the description of a bundle.
fn is_single(path: &Path) -> bool {
    let ending = path.extension().map(|end| end.to_string_lossy().to_lowercase());
    matches!(ending.as_deref(), Some("glb" | "gltf" | "json"))
}

/// A folder, or a single file with those that it refers to, as a zip file.
fn pack(bundle: &Path) -> Result<NamedTempFile> {
    let file = NamedTempFile::new().context("cannot create a temporary file")?;
    let target = BufWriter::new(file.reopen()?);
    let written = if bundle.is_dir() {
        archive::pack(bundle, target)?
    } else {
        let folder = bundle.parent().unwrap_or(Path::new(""));
        let names = Scene::files(bundle, &Limits::default())
            .map_err(|error| BadInput::new(format!("bundle {}: {error}", bundle.display())))?;
        archive::pack_files(names.iter().map(|name| (name.clone(), folder.join(name))).collect(), target)?
    };
    written.into_inner().context("cannot pack the bundle")?;
    Ok(file)
}

/// Refuses a file that is no bundle before it is uploaded.
fn check(path: &Path) -> Result<(), BadInput> {
    let wrong = |why: String| BadInput::new(format!("bundle {}: {why}", path.display()));
    let mut begin = Vec::new();
    let read = File::open(path).and_then(|file| file.take(ZIP.len() as u64).read_to_end(&mut begin));
    read.map_err(|error| wrong(error.to_string()))?;
    if begin == ZIP || path.extension().is_some_and(|end| end.eq_ignore_ascii_case("blend")) {
        return Ok(());
    }
    let hint = "give a .glb or .gltf file, a folder or .zip with a scene.json, or a .blend file";
    Err(wrong("it is no scene that can be uploaded".to_owned()).hint(hint))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    #[test]
    fn a_single_file_is_packed_with_what_it_refers_to_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        let positions: Vec<u8> =
            [0f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0].iter().flat_map(|v| v.to_le_bytes()).collect();
        fs::create_dir(at("data")).unwrap();
        fs::write(at("data/a table.bin"), &positions).unwrap();
        fs::write(at("secret.txt"), "not of the scene").unwrap();
        let scene = serde_json::json!({
            "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
            "buffers": [{"uri": "data/a%20table.bin", "byteLength": 36}],
            "bufferViews": [{"buffer": 0, "byteLength": 36}],
            "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3",
                "min": [0, 0, 0], "max": [1, 1, 0]}],
        });
        fs::write(at("table.gltf"), scene.to_string()).unwrap();
        let packed = pack(&at("table.gltf")).unwrap();
        let archive = zip::ZipArchive::new(packed.reopen().unwrap()).unwrap();
        assert_eq!(archive.file_names().collect::<Vec<_>>(), ["data/a table.bin", "table.gltf"]);
        Scene::load(packed.path(), &Limits::default()).unwrap();
        fs::write(at("table.gltf"), "{}").unwrap();
        assert!(pack(&at("table.gltf")).unwrap_err().to_string().contains("table.gltf"));
    }

    #[test]
    fn other_files_are_refused_before_they_are_uploaded() {
        let folder = tempfile::tempdir().unwrap();
        for (name, content, is_good) in [
            ("a.zip", "PK..", true),
            ("a.blend", "BL", true),
            ("hall.pov", "camera", false),
            ("a", "", false),
        ] {
            let path = folder.path().join(name);
            fs::write(&path, content).unwrap();
            assert_eq!(check(&path).is_ok(), is_good, "{name}");
        }
    }
}
