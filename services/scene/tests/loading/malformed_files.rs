//! Every bundle that is no readable folder or archive gets one clear line that names the file and the reason.

use crate::made::{Files, line, load_zip, triangle_glb, zip};
use forelight_scene::{Limits, Scene};
use std::path::Path;

#[test]
fn a_path_that_does_not_exist() {
    let error = line(Scene::load(Path::new("no/such/bundle"), &Limits::default()));
    assert_eq!(error, "no/such/bundle: cannot be read: No such file or directory (os error 2)");
}

#[test]
fn a_file_that_is_no_archive() {
    let error = line(load_zip(b"this is not a zip archive", &Limits::default()));
    assert!(error.contains("bundle.zip: is neither a folder nor a readable .zip: "), "{error}");
    let read = "this program reads a .glb or .gltf file, a folder with a `scene.json`, or a .zip of one";
    let single = "is a single glTF or JSON file; put it into a folder, with the files that it names";
    let folder = Files::good()
        .with("x.usd", "#usda")
        .with("hall", "#")
        .with("upload", triangle_glb())
        .with("upload2", " {}")
        .folder();
    for (name, reason) in [
        ("x.usd", &*format!("is a .usd file; {read}")),
        ("hall", &format!("is neither a folder nor a readable .zip; {read}")),
        ("scene.obj", "is a single .obj file; put it into a folder with a `scene.json` that names it"),
        ("upload", single),
        ("upload2", single),
    ] {
        let error = line(Scene::load(&folder.path().join(name), &Limits::default()));
        assert!(error.ends_with(&format!("/{name}: {reason}")), "{error}");
    }
}

#[test]
fn an_empty_folder() {
    let files = Files(Default::default());
    assert!(files.error().ends_with(": has neither a `scene.json` nor a glTF file"));
}

#[test]
fn geometry_without_a_description() {
    let error = Files::good().without("scene.json").error();
    assert!(
        error.ends_with(": needs a `scene.json` that lists its geometry files; it has scene.obj"),
        "{error}"
    );
}

#[test]
fn an_archive_entry_that_climbs_out() {
    let error = line(load_zip(&zip(&[("../evil.obj", b"v")]), &Limits::default()));
    assert!(error.ends_with("bundle.zip/../evil.obj: the archive entry is outside the bundle"), "{error}");
}

#[test]
fn an_archive_entry_with_an_absolute_path() {
    let twice = zip(&[("scene.json", b"{}"), ("./scene.json", b"{}")]);
    let error = line(load_zip(&twice, &Limits::default()));
    assert!(error.ends_with("./scene.json: the archive has two entries of this name"), "{error}");
    let error = line(load_zip(&zip(&[("/etc/evil", b"v")]), &Limits::default()));
    assert!(error.ends_with("/etc/evil: the archive entry is outside the bundle"), "{error}");
}

#[test]
fn an_archive_entry_with_backslashes_or_a_drive() {
    for (name, reason) in [
        ("..\\evil", "may not have (`:`, `\\` or NUL); rename the file"),
        ("C:/evil", "may not have (`:`, `\\` or NUL); rename the file"),
        ("a//b", "is outside the bundle"),
        ("a/./b", "is outside the bundle"),
    ] {
        let error = line(load_zip(&zip(&[(name, b"v")]), &Limits::default()));
        assert!(error.ends_with(reason), "{error}");
    }
}

#[test]
fn a_file_whose_name_is_not_allowed_in_a_bundle() {
    let folder = Files::good().with("a:b.gltf", "{}").with("a\\b.gltf", "{}").folder();
    for name in ["a:b.gltf", "a\\b.gltf"] {
        let error = line(Scene::load(&folder.path().join(name), &Limits::default()));
        let reason =
            "has a character that names in a bundle may not have (`:`, `\\` or NUL); rename the file";
        assert_eq!(error, format!("{name}: the path {reason}"));
    }
}

#[test]
fn an_archive_with_a_symbolic_link() {
    let mut writer = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    writer.add_symlink("scene.json", "/etc/passwd", zip::write::SimpleFileOptions::default()).unwrap();
    let error = line(load_zip(&writer.finish().unwrap().into_inner(), &Limits::default()));
    assert!(error.ends_with("scene.json: symbolic links are not allowed in an archive"), "{error}");
}

#[test]
fn an_archive_that_expands_without_measure() {
    let bomb = vec![0; 4 << 20];
    let error = line(load_zip(&zip(&[("scene.json", &bomb)]), &Limits::default()));
    assert!(error.contains("scene.json: expanded bytes for each compressed byte"), "{error}");
    assert!(error.ends_with("is more than the limit of 200"), "{error}");
}

#[test]
fn an_archive_with_too_many_entries() {
    let limits = Limits { entries: 2, ..Limits::default() };
    let error = line(load_zip(&zip(&[("a", b""), ("b", b""), ("c", b"")]), &limits));
    assert!(error.ends_with("bundle.zip: archive entries: 3 is more than the limit of 2"), "{error}");
}

#[test]
fn an_archive_whose_files_are_too_large_together() {
    let limits = Limits { total_bytes: 5, ..Limits::default() };
    let error = line(load_zip(&zip(&[("a", b"123"), ("b", b"456")]), &limits));
    assert!(error.ends_with("expanded bytes of the archive: 6 is more than the limit of 5"), "{error}");
}

#[test]
fn an_archive_that_lies_about_the_size_of_a_file() {
    let mut bytes = zip(&[("scene.json", &[b'x'; 1000])]);
    // The uncompressed size stands in the central directory, 24 bytes after its signature.
    let directory = bytes.windows(4).position(|w| w == b"PK\x01\x02").unwrap();
    bytes[directory + 24..directory + 28].copy_from_slice(&10u32.to_le_bytes());
    let error = line(load_zip(&bytes, &Limits::default()));
    assert_eq!(error, "scene.json: expanded bytes: 11 is more than the limit of 10");
}

#[test]
fn an_archive_with_damaged_contents() {
    let mut bytes = zip(&[("scene.json", b"{\"version\": 1}")]);
    let at = 30 + "scene.json".len();
    bytes[at] ^= 0x55;
    let error = line(load_zip(&bytes, &Limits::default()));
    assert!(error.starts_with("scene.json: cannot be expanded: "), "{error}");
}

#[test]
fn a_file_larger_than_the_limit() {
    let limits = Limits { file_bytes: 100, ..Limits::default() };
    let error = line(Files::good().load_within(&limits));
    assert!(
        error.starts_with("scene.json: bytes: ") && error.ends_with("is more than the limit of 100"),
        "{error}"
    );
}

#[test]
fn more_bytes_than_the_limit_in_a_folder() {
    let total: usize = Files::good().0.values().map(Vec::len).sum();
    assert!(Files::good().load_within(&Limits { total_bytes: total as u64, ..Limits::default() }).is_ok());
    let limits = Limits { total_bytes: total as u64 - 1, ..Limits::default() };
    let error = line(Files::good().load_within(&limits));
    assert!(error.contains(": bytes read from the bundle: "), "{error}");
}

#[cfg(unix)]
#[test]
fn a_symbolic_link_that_leads_out_of_the_folder() {
    let (secret, folder) =
        (tempfile::NamedTempFile::new().unwrap(), Files::good().without("scene.mtl").folder());
    std::os::unix::fs::symlink(secret.path(), folder.path().join("scene.mtl")).unwrap();
    let error = line(Scene::load(folder.path(), &Limits::default()));
    assert_eq!(error, "scene.obj: line 1: `mtllib`: scene.mtl: a symbolic link leads out of the bundle");
}

#[test]
fn a_folder_in_the_place_of_a_file() {
    let folder = Files::good().without("scene.mtl").folder();
    std::fs::create_dir(folder.path().join("scene.mtl")).unwrap();
    let error = line(Scene::load(folder.path(), &Limits::default()));
    assert_eq!(
        error,
        "scene.obj: line 1: `mtllib`: scene.mtl: cannot be read: it is a folder, not a regular file"
    );
}
