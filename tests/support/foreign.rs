//! Parsers of what other programs, providers and people write: files of renderers, answers of schedulers, claims,
//! patterns, and files that a machine keeps.

use crate::parsers::{Parser, one_line};
use forelight_api::SignInProvider;
use forelight_bvh::Bvh;
use forelight_kept::Folder;
use forelight_protocol::{
    ArtifactHash, JobId, NodeCalendar, NodeCalibration, OutputOf, OutputPattern, SceneDigest,
};
use forelight_renderer_radiance::reading;
use forelight_scene::{Limits, Scene};
use glam::Vec3;
use std::path::{Component, Path, PathBuf};
use std::sync::OnceLock;

/// All of them.
pub(crate) const PARSERS: [Parser; 8] = [
    Parser { name: "command_file", read: command_file, seeds: || vec![COMMAND.into()] },
    Parser { name: "radiance", read: radiance, seeds: radiance_seeds },
    Parser { name: "slurm", read: slurm, seeds: slurm_seeds },
    Parser { name: "sign_in", read: sign_in, seeds: sign_in_seeds },
    Parser { name: "patterns", read: patterns, seeds: pattern_seeds },
    Parser { name: "tree", read: tree, seeds: || vec![small_tree().to_bytes()] },
    Parser { name: "kept", read: kept, seeds: || vec![kept_content()] },
    Parser { name: "calibration", read: calibration, seeds: || vec![CALIBRATION.into()] },
];

const COMMAND: &str = r#"name = "pov-ray"
version_command = ["povray", "--version"]
version_pattern = 'POV-Ray (\S+)'
scene = "hall.pov"
output = "frame-{frame:04}.png"
arguments = ["povray", "{scene}", "+O{out}", "+W{width}", "+H{height}", "+K{frame}", "+WT{threads}", "+SC{crop_left}", "+SR{crop_top}", "+EC{crop_right}", "+ER{crop_bottom}", "+A{antialias}"]
can = ["size", "crop"]
[frames]
first = 1
last = 24
[defaults]
width = 640
height = 360
[crop]
first = 1
inclusive = true
[environment]
SCENES = "{folder}"
[parameters.antialias]
type = "number"
default = 0.3
minimum = 0
[progress]
pattern = '\((\d+)%\)'
unit = "percent"
"#;

/// A folder for one file, which is gone at the end.
fn with_file(name: &str, bytes: &[u8], read: impl FnOnce(&Path)) {
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    let path = folder.path().join(name);
    std::fs::write(&path, bytes).expect("a temporary file can be written");
    read(&path);
}

/// A file that describes a plain command. Nothing of it is started.
pub fn command_file(bytes: &[u8]) {
    with_file("a.command.toml", bytes, |path| {
        if let Err(error) = forelight_renderer_command::check_file(path) {
            one_line(&error.to_string());
        }
    });
}

/// What `rad` prints, options, views, and trees of rays.
pub fn radiance(bytes: &[u8]) {
    let text = String::from_utf8_lossy(bytes);
    for read in [reading::rad(&text), reading::options(&text)] {
        if let Err(error) = read {
            one_line(&error);
        }
    }
    with_file("a.vf", bytes, |path| {
        let _ = reading::views(path);
    });
    let ends = bytes.iter().filter(|&&byte| byte == b'~').count();
    if let Ok(trees) = reading::trees(bytes) {
        assert!(trees <= ends, "{trees} trees with {ends} ends");
    }
}

fn radiance_seeds() -> Vec<Vec<u8>> {
    [
        "OCTREE=x.oct\nRESOLUTION= 512 384\nmaterials= m.mat\nscene= s.rad t.rad\nview= front -vp 2 .2 1.5 -vd 0 1 0\n\toconv -r 4096 m.mat s.rad > /tmp/o.oct\n\trpict -vp 2 .2 1.5 -x 1536 -y 1536 -dp 4096 -ab 1 -aa .1 -ps 3 /tmp/o.oct > p.unf\n\tpfilt -1 -e 2 -x /3 -y /3 p.unf > p.hdr\n",
        "-ab 2 -aa .1 -ad 512 -dv- -av 0 0 0 -lw 1e-4 -af a.amb",
        "rvu -vtv -vp 1 2 3 -vd 0 1 0 -vu 0 0 1\nVIEW= -vh 40 -vv 30\n",
        "\t0.1\t0.2\t0.9\t0\t0\t-1\t0.5\tpaint\n0\t0\t1\t0\t0\t-1\t1\tpaint\n~\n~\n",
    ]
    .map(|text| text.as_bytes().to_vec())
    .to_vec()
}

/// Answers of `squeue`, `sinfo` and `sbatch`.
pub fn slurm(bytes: &[u8]) {
    let _ = forelight_engine::slurm::can_read(bytes);
}

fn slurm_seeds() -> Vec<Vec<u8>> {
    [
        r#"{"jobs":[{"job_id":7,"array_job_id":{"set":true,"infinite":false,"number":7},"array_task_id":{"set":true,"infinite":false,"number":3},"array_task_string":"0-2,5","job_state":["PENDING"],"state_reason":"Resources","comment":"forelight 1","exit_code":{"return_code":{"set":true,"number":1},"signal":{"id":{"set":true,"number":9}}}}]}"#,
        r#"{"jobs":[{"job_id":7,"array_job_id":7,"array_task_id":null,"array_task_string":"0-9","job_state":"RUNNING","state_reason":"None","comment":"","exit_code":0}]}"#,
        "n1|4|idle|all\nn2|8|down*|all\n",
        "Submitted batch job 17",
        "17;cluster",
    ]
    .map(|text| text.as_bytes().to_vec())
    .to_vec()
}

const PROVIDER: &str = r#"{"issuer":"https://id.example.org","client_id":"forelight","grants":[{"group":"wranglers","role":"operator"},{"group":"film","role":"submitter","project":"film"},{"group":"*","role":"viewer"}]}"#;

/// A provider of identities as a file describes it, and a claim about groups: JSON of both in a list.
pub fn sign_in(bytes: &[u8]) {
    let fixed: SignInProvider = serde_json::from_str(PROVIDER).expect("it is well formed");
    let Ok(claim) = serde_json::from_slice::<serde_json::Value>(bytes) else { return };
    // Everybody may view here, whatever a claim says.
    assert!(fixed.rights_of(Some(&claim)).is_some());
    let list = claim.as_array().filter(|list| list.len() == 2);
    if let Some([described, claim]) = list.map(Vec::as_slice)
        && let Ok(provider) = serde_json::from_value::<SignInProvider>(described.clone())
    {
        match provider.check() {
            Ok(()) => drop(provider.rights_of(Some(claim))),
            Err(reason) => one_line(&reason),
        }
    }
}

fn sign_in_seeds() -> Vec<Vec<u8>> {
    let both = format!(r#"[{PROVIDER},["film","others"]]"#);
    [r#""wranglers""#, r#"["film",7,null]"#, "{}", &both].map(|text| text.as_bytes().to_vec()).to_vec()
}

/// Patterns of output paths, calendars, names of artefacts, places in lists.
pub fn patterns(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    match text.parse::<OutputPattern>() {
        Ok(pattern) => {
            assert_eq!(pattern.to_string().parse::<OutputPattern>().as_ref(), Ok(&pattern));
            let id = JobId::default();
            for name in ["a job", "../..", "/etc/passwd", "a\0b\n", "", "con.", &"ü".repeat(200)] {
                let path = PathBuf::from(pattern.path(OutputOf { project: name, job: name, id, frame: 7 }));
                let stays = path.components().all(|part| matches!(part, Component::Normal(_)));
                assert!(stays, "{text:?} leads to {}", path.display());
            }
        }
        Err(error) => one_line(&error.to_string()),
    }
    if let Ok(calendar) = text.parse::<NodeCalendar>() {
        assert_eq!(calendar.to_string().parse::<NodeCalendar>().as_ref(), Ok(&calendar));
    }
    if let Ok(hash) = text.parse::<ArtifactHash>() {
        assert_eq!(hash.to_string(), text.to_ascii_lowercase());
    }
    let _ = text.parse::<SceneDigest>();
}

fn pattern_seeds() -> Vec<Vec<u8>> {
    [
        "{project}/{job}/{frame:04}.exr",
        "shots/{id}/{frame}.png",
        "Mon-Fri 20:00-08:00, Sat-Sun 00:00-00:00 Europe/Berlin",
        "0123456789abcdef0123456789abcdef0123456789abcdef0123456789abcdef",
    ]
    .map(|text| text.as_bytes().to_vec())
    .to_vec()
}

/// A tree over the triangles of a strip.
fn small_tree() -> Bvh {
    let corner = |n: usize| Vec3::new(n as f32, (n % 2) as f32, (n % 3) as f32);
    let positions: Vec<Vec3> = (0..12).map(corner).collect();
    let triangles: Vec<[u32; 3]> = (0..TRIANGLES as u32).map(|n| [n, n + 1, n + 2]).collect();
    Bvh::build(&positions, &triangles)
}

const TRIANGLES: usize = 10;

/// A kept tree.
pub fn tree(bytes: &[u8]) {
    if let Some(tree) = Bvh::from_bytes(bytes, TRIANGLES) {
        assert_eq!(tree.to_bytes(), bytes, "reading and writing give back every byte");
    }
}

/// A bundle that is large enough to be kept, the folder that keeps it, and the name of the file there.
struct Kept {
    bundle: tempfile::TempDir,
    _files: tempfile::TempDir,
    folder: Folder,
    /// The file in which the scene is kept.
    file: PathBuf,
}

fn kept_once() -> &'static Kept {
    static KEPT: OnceLock<Kept> = OnceLock::new();
    KEPT.get_or_init(|| {
        let temporary = || tempfile::tempdir().expect("a temporary folder can be made");
        let (bundle, files) = (temporary(), temporary());
        let scene = r#"{"version":1,"name":"n","geometry":["a.obj"],"camera":{"origin":[0,0,3],"target":[0,0,0],"up":[0,1,0],"fov_deg":40,"fov_axis":"x","width":8,"height":8},"environment":{"type":"constant","radiance":[1,1,1]},"animation":{"fps":24,"frames":1,"tracks":[]}}"#;
        let geometry = format!("mtllib a.mtl\no q\nv -1 -1 0\nv 1 -1 0\nv 1 1 0\nusemtl p\nf 1 2 3\n# {}\n", "x".repeat(1 << 20));
        let materials = "newmtl p\nillum 1\nKd 0.5 0.5 0.5\n";
        for (name, content) in [("scene.json", scene), ("a.obj", &geometry), ("a.mtl", materials)] {
            std::fs::write(bundle.path().join(name), content).expect("a temporary file can be written");
        }
        let folder = Folder::new(&files.path().join("kept")).expect("the folder is private");
        Scene::load_or_keep(bundle.path(), &Limits::default(), &folder).expect("the bundle is good");
        let entry = std::fs::read_dir(folder.path()).expect("the folder can be read").next();
        let file = entry.expect("the scene was kept").expect("the folder can be read").path();
        Kept { bundle, _files: files, folder, file }
    })
}

fn kept_content() -> Vec<u8> {
    std::fs::read(&kept_once().file).expect("the scene was kept")
}

/// The file of a kept scene. If it is damaged, the bundle is read instead.
pub fn kept(bytes: &[u8]) {
    let Kept { bundle, folder, file, .. } = kept_once();
    std::fs::write(file, bytes).expect("a temporary file can be written");
    let (scene, _) =
        Scene::load_or_keep(bundle.path(), &Limits::default(), folder).expect("the bundle is good");
    let _ = scene.frame(0);
}

const CALIBRATION: &str = r#"{"picos_per_work":{"rays":1000,"traversal":1000,"memory":1000,"shading":1000,"texture":1000,"records":1000}}"#;

/// A machine's calibration.
pub fn calibration(bytes: &[u8]) {
    if let Ok(calibration) = serde_json::from_slice::<NodeCalibration>(bytes) {
        match calibration.check() {
            Ok(()) => assert!(calibration.speed(&Default::default()).is_none_or(|speed| speed > 0.0)),
            Err((field, reason)) => one_line(&format!("{field} {reason}")),
        }
    }
}
