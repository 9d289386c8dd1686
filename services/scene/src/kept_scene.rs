//! Loaded scenes that a machine keeps, so that it parses a bundle once. A kept scene equals the loaded one to
//! the last bit.
//!
//! A kept scene is used if the bundle still has the content that it was loaded from. Of a folder, every file
//! that was read is read again and hashed, within the limits; of an archive, the archive itself.

use crate::Scene;
use crate::bundle::Bundle;
use crate::error::SceneError;
use crate::limits::Limits;
use crate::scene::Entry;
use blake3::Hash;
use forelight_kept::{Folder, LARGEST, named};
use forelight_threads::clocked;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Bundles of fewer bytes are parsed faster than a kept scene is found.
const LEAST_BYTES: u64 = 1 << 20;

/// What precedes a kept scene.
#[derive(Serialize, Deserialize)]
struct Head {
    /// Hash of the bundle's content.
    content: [u8; 32],
    /// Files of the bundle that the scene was loaded from.
    files: Vec<String>,
    /// CPU time of loading it, nanoseconds.
    nanos: u64,
}

impl Scene {
    /// Like [`Scene::load`], but takes the scene from `folder` if it was kept there, and keeps it
    /// otherwise. Also returns the CPU time of loading the bundle itself, now or when the scene was kept,
    /// in nanoseconds.
    ///
    /// # Errors
    /// As [`Scene::load`]. Whatever is wrong with the folder is logged, and no error.
    pub fn load_or_keep(path: &Path, limits: &Limits, folder: &Folder) -> Result<(Self, u64), SceneError> {
        Self::load_or_keep_from(LEAST_BYTES, path, limits, folder)
    }

    /// The same for bundles of at least `least` bytes. What is made of larger ones than a kept file is not
    /// copied.
    fn load_or_keep_from(
        least: u64,
        path: &Path,
        limits: &Limits,
        folder: &Folder,
    ) -> Result<(Self, u64), SceneError> {
        let (bundle, entry) = Self::opened(path, limits)?;
        let name = name(&bundle, &entry, limits);
        if let Some((scene, nanos)) = kept(folder, &name, &bundle) {
            scene.warnings().iter().for_each(|warning| tracing::warn!("{warning}"));
            return Ok((scene, nanos));
        }
        // Opened again, because a bundle counts the bytes that are read from it.
        let (loaded, nanos) = clocked(|| {
            let (bundle, entry) = Self::opened(path, limits)?;
            Self::of(&bundle, &entry).map(|scene| (scene, bundle))
        });
        let (scene, bundle) = loaded?;
        if (least..=LARGEST).contains(&bundle.bytes_read()) {
            keep(folder, &name, &scene, &bundle, nanos);
        }
        Ok((scene, nanos))
    }
}

fn name(bundle: &Bundle, entry: &Entry, limits: &Limits) -> Hash {
    let mut hasher = named("scene");
    hasher.update(format!("{:?} {entry:?} {limits:?}", bundle.place()).as_bytes());
    hasher.finalize()
}

fn kept(folder: &Folder, name: &Hash, bundle: &Bundle) -> Option<(Scene, u64)> {
    let bytes = folder.read(name)?;
    let (head, scene) = postcard::take_from_bytes::<Head>(&bytes).ok()?;
    (bundle.content_of(&head.files) == Some(head.content)).then_some(())?;
    Some((postcard::from_bytes(scene).ok()?, head.nanos))
}

fn keep(folder: &Folder, name: &Hash, scene: &Scene, bundle: &Bundle, nanos: u64) {
    let files = bundle.files_read();
    let Some(content) = bundle.content_read() else { return };
    let head = Head { content, files, nanos };
    let bytes = postcard::to_allocvec(&head).and_then(|head| postcard::to_extend(scene, head));
    match bytes {
        Ok(bytes) => folder.write(name, &[&bytes]),
        Err(error) => tracing::warn!(%error, "a scene cannot be kept"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;
    use std::io::Write as _;
    use std::path::PathBuf;

    /// CPU time that no loading takes, to tell a kept scene by.
    const MARK: u64 = 123;

    fn folder() -> (Folder, tempfile::TempDir) {
        let beside = tempfile::tempdir().unwrap();
        (Folder::new(beside.path()).unwrap(), beside)
    }

    /// Loads a scene, and says whether it was kept. What is kept for it has [`MARK`] from then on.
    fn load(path: &Path, folder: &Folder) -> Result<(Scene, bool), SceneError> {
        let limits = Limits::default();
        let (scene, nanos) = Scene::load_or_keep_from(0, path, &limits, folder)?;
        let (bundle, entry) = Scene::opened(path, &limits)?;
        let name = name(&bundle, &entry, &limits);
        let bytes = folder.read(&name).expect("the scene is kept");
        let (head, rest) = postcard::take_from_bytes::<Head>(&bytes).unwrap();
        let head = postcard::to_allocvec(&Head { nanos: MARK, ..head }).unwrap();
        folder.write(&name, &[&head, rest]);
        Ok((scene, nanos == MARK))
    }

    /// Everything that a scene says, to the last bit.
    fn said(scene: &Scene) -> String {
        let frames = [0, scene.frame_count() / 2, scene.frame_count() - 1];
        let frames = frames.map(|frame| scene.frame(frame).map_err(|e| e.to_string()));
        let (name, fps, digest) = (scene.name(), scene.fps(), scene.digest());
        let (moves, strata, warnings) = (scene.geometry_moves(), scene.strata(), scene.warnings());
        format!("{name} {fps} {digest:?} {moves} {strata:?} {warnings:?} {frames:?}")
    }

    fn shipped() -> Vec<PathBuf> {
        let scenes = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../deploy/scenes");
        let mut paths: Vec<PathBuf> = fs::read_dir(scenes).unwrap().flatten().map(|e| e.path()).collect();
        paths.retain(|path| path.join("scene.json").exists());
        for more in [
            "veach-ajar-animated",
            "cornell-box",
            "pc-glass-table",
            "gltf-anim-tests/02_node_hierarchy.gltf",
            "gltf-anim-tests/03_all_animations.gltf",
            "gltf-anim-tests/15_transmission.gltf",
        ] {
            paths.extend(forelight_test_needs::shared(&format!("scenes/{more}")));
        }
        paths.sort();
        assert!(paths.len() > 1);
        paths
    }

    #[test]
    fn a_kept_scene_is_the_loaded_one_to_the_last_bit() {
        let (folder, _beside) = folder();
        for path in shipped() {
            let loaded = said(&Scene::load(&path, &Limits::default()).unwrap());
            for kept in [false, true, true] {
                let (scene, was_kept) = load(&path, &folder).unwrap();
                assert_eq!(was_kept, kept, "{}", path.display());
                assert!(said(&scene) == loaded, "{} differs when kept: {kept}", path.display());
            }
        }
    }

    /// A bundle of a triangle with a texture.
    fn bundle(folder: &Path) {
        let image = image::RgbImage::from_fn(4, 4, |x, y| image::Rgb([(x * 60) as u8, (y * 60) as u8, 7]));
        image.save(folder.join("t.png")).unwrap();
        fs::write(folder.join("t.mtl"), "newmtl a\nmap_Kd t.png\n").unwrap();
        let obj = "mtllib t.mtl\no t\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nusemtl a\nf 1/1 2/1 3/1\n";
        fs::write(folder.join("t.obj"), obj).unwrap();
        let camera = r#"{"origin":[0,0,4],"target":[0,0,0],"up":[0,1,0],"fov_deg":50,"fov_axis":"x","width":4,"height":4}"#;
        let description = format!(r#"{{"version":1,"name":"t","geometry":["t.obj"],"camera":{camera}}}"#);
        fs::write(folder.join("scene.json"), description).unwrap();
    }

    #[test]
    fn a_bundle_that_has_changed_is_loaded_again() {
        let (folder, _beside) = folder();
        let place = tempfile::tempdir().unwrap();
        bundle(place.path());
        assert!(!load(place.path(), &folder).unwrap().1);
        assert!(load(place.path(), &folder).unwrap().1);
        let black = place.path().join("black.png");
        image::RgbImage::new(4, 4).save(&black).unwrap();
        let replaced = |text: Vec<u8>, from: &str, to: &str| {
            String::from_utf8(text).unwrap().replacen(from, to, 1).into_bytes()
        };
        for (file, from, to) in
            [("scene.json", "4]", "5]"), ("t.obj", "v 1", "v 2"), ("t.mtl", " a", " b"), ("t.png", "", "")]
        {
            let path = place.path().join(file);
            let (before, time) = (fs::read(&path).unwrap(), fs::metadata(&path).unwrap().modified().unwrap());
            let changed =
                if file == "t.png" { fs::read(&black).unwrap() } else { replaced(before.clone(), from, to) };
            assert_ne!(changed, before, "{file}");
            fs::write(&path, changed).unwrap();
            fs::File::options().append(true).open(&path).unwrap().set_modified(time).unwrap();
            let fresh = Scene::load(place.path(), &Limits::default()).map(|scene| (said(&scene), false));
            let again = load(place.path(), &folder).map(|(scene, kept)| (said(&scene), kept));
            assert!(again.map_err(|e| e.to_string()) == fresh.map_err(|e| e.to_string()), "{file}");
            fs::write(&path, before).unwrap();
            load(place.path(), &folder).unwrap();
        }
        fs::remove_file(place.path().join("t.png")).unwrap();
        let gone = load(place.path(), &folder).unwrap_err().to_string();
        assert_eq!(gone, Scene::load(place.path(), &Limits::default()).unwrap_err().to_string());
    }

    #[test]
    fn an_archive_is_known_by_its_content_and_a_damaged_kept_scene_is_made_again() {
        let (folder, beside) = folder();
        let place = tempfile::tempdir().unwrap();
        bundle(place.path());
        let path = place.path().join("b.zip");
        let zipped = |extra: &str| {
            let mut zip = zip::ZipWriter::new(fs::File::create(&path).unwrap());
            for file in ["scene.json", "t.obj", "t.mtl", "t.png"] {
                zip.start_file(file, zip::write::SimpleFileOptions::default()).unwrap();
                zip.write_all(&fs::read(place.path().join(file)).unwrap()).unwrap();
            }
            zip.start_file("notes", zip::write::SimpleFileOptions::default()).unwrap();
            zip.write_all(extra.as_bytes()).unwrap();
            zip.finish().unwrap();
        };
        zipped("one");
        let loaded = said(&Scene::load(&path, &Limits::default()).unwrap());
        for kept in [false, true] {
            let (scene, was_kept) = load(&path, &folder).unwrap();
            assert!(said(&scene) == loaded && was_kept == kept);
        }
        zipped("two");
        assert!(!load(&path, &folder).unwrap().1);
        let files = fs::read_dir(beside.path()).unwrap().flatten();
        let kept: Vec<PathBuf> = files.map(|e| e.path()).filter(|p| p.extension().is_some()).collect();
        let [kept] = kept.as_slice() else { panic!("{kept:?}") };
        let mut bytes = fs::read(kept).unwrap();
        let middle = bytes.len() / 2;
        bytes[middle] ^= 1;
        fs::write(kept, bytes).unwrap();
        let (scene, was_kept) = load(&path, &folder).unwrap();
        assert!(said(&scene) == loaded && !was_kept);
        assert!(load(&path, &folder).unwrap().1);
    }

    #[test]
    fn a_kept_scene_does_not_lift_limits() {
        let (folder, _beside) = folder();
        let place = tempfile::tempdir().unwrap();
        bundle(place.path());
        load(place.path(), &folder).unwrap();
        let limits = Limits { texture_pixels: 15, ..Limits::default() };
        let refused = Scene::load_or_keep_from(0, place.path(), &limits, &folder).unwrap_err();
        assert_eq!(refused.to_string(), Scene::load(place.path(), &limits).unwrap_err().to_string());
    }
}
