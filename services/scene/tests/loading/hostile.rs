//! Bundles that were made to hang, to panic or to take what they can.

use crate::made::{Files, OBJ};
use forelight_scene::{Limits, Scene};
use rustix::fs::{CWD, FileType, Mode, mknodat};
use serde_json::json;
use std::os::unix::net::UnixListener;
use std::path::Path;

fn error(path: &Path) -> String {
    Scene::load(path, &Limits::default()).unwrap_err().to_string()
}

fn pipe(path: &Path) {
    mknodat(CWD, path, FileType::Fifo, Mode::RUSR | Mode::WUSR, 0).unwrap();
}

#[test]
fn a_pipe_a_socket_or_a_device_is_no_bundle_and_no_file_of_one() {
    let folder = Files::good().folder();
    let beside = |name: &str| folder.path().join(name);
    pipe(&beside("bundle.zip"));
    assert!(error(&beside("bundle.zip")).ends_with("cannot be read: it is a pipe, not a regular file"));
    assert!(error(Path::new("/dev/zero")).ends_with("it is a device, not a regular file"));
    let _socket = UnixListener::bind(beside("socket")).unwrap();
    assert!(error(&beside("socket")).ends_with("it is a socket, not a regular file"));
    // Files in the bundle: geometry, materials, the description itself.
    std::fs::remove_file(beside("scene.mtl")).unwrap();
    pipe(&beside("scene.mtl"));
    let found = error(folder.path());
    assert!(
        found.starts_with("scene.obj: line 1: `mtllib`: scene.mtl: cannot be read: it is a pipe"),
        "{found}"
    );
    std::fs::remove_file(beside("scene.obj")).unwrap();
    pipe(&beside("scene.obj"));
    assert_eq!(error(folder.path()), "scene.json: /geometry/0: the bundle has no file `scene.obj`");
    std::fs::remove_file(beside("scene.json")).unwrap();
    pipe(&beside("scene.json"));
    pipe(&beside("a.gltf"));
    assert!(error(folder.path()).contains("has neither a `scene.json` nor a glTF file"));
    assert!(error(&beside("a.gltf")).contains("not a regular file"));
}

#[test]
fn a_material_library_that_is_named_again_is_the_same() {
    let once = Files::good().scene();
    for again in ["mtllib scene.mtl\n", "mtllib ./scene.mtl\n", "mtllib x/../scene.mtl\nmtllib scene.mtl\n"] {
        let scene = Files::good().with("scene.obj", format!("{again}{OBJ}{again}")).scene();
        assert_eq!(scene.frame(0).unwrap().materials, once.frame(0).unwrap().materials);
    }
}

#[test]
fn a_file_that_is_listed_many_times_is_read_once() {
    // Read each time, it would be beyond the limit.
    let many = 50_000;
    let content = OBJ.len() * 4;
    let limits = Limits { total_bytes: 100_000_000, ..Limits::default() };
    let comment = "#".repeat(content);
    let geometry = vec!["scene.obj"; many];
    let files =
        Files::good().with("scene.obj", format!("{comment}\n{OBJ}")).set("/geometry", json!(geometry));
    let folder = files.folder();
    let scene = Scene::load(folder.path(), &limits).unwrap();
    assert_eq!(scene.frame(0).unwrap().geometry.triangles.len(), 2);
    assert!(scene.warnings().iter().any(|warning| warning.contains("49999 times one that it lists before")));
    // A library under many names, and a buffer of many glTF buffers.
    let names: String = (0..many).map(|n| format!("mtllib {}scene.mtl\n", "./".repeat(n % 9))).collect();
    let folder = Files::good().with("scene.obj", names + OBJ).folder();
    Scene::load(folder.path(), &limits).unwrap();
    let buffers = vec![json!({"uri": "a.bin", "byteLength": 100_000}); many];
    let gltf = json!({"asset": {"version": "2.0"}, "buffers": buffers});
    let files = Files::good().with("a.gltf", gltf.to_string()).with("a.bin", vec![0; 100_000]);
    let folder = files.set("/geometry", json!(["scene.obj", "a.gltf"])).folder();
    let error = Scene::load(folder.path(), &limits).unwrap_err().to_string();
    assert!(!error.contains("limit"), "{error}");
}
