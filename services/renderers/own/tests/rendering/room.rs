//! A room written by the test, and tasks in it.

use forelight_preview::Choice;
use forelight_protocol::{
    BundleSource, CacheMode, JobId, LogLine, ProfileSpec, RenderSettings, RenderSettingsRequest, RenderSpec,
    SceneDigest, TaskResult, TaskSpec,
};
use forelight_renderer::{Assignment, Control, Execute, ExecuteError, Outcome};
use forelight_renderer_own::{Observer, OwnRenderer, TaskRunner};
use std::fs;
use std::path::Path;

/// A floor, a mirror, and a pane. The camera moves to the right over three frames.
fn write_bundle(folder: &Path) {
    let scene = serde_json::json!({
        "version": 1,
        "name": "room",
        "geometry": ["room.obj"],
        "camera": { "origin": [0, 1, 4], "target": [0, 0.5, 0], "up": [0, 1, 0], "fov_deg": 50, "fov_axis": "x", "width": 32, "height": 24 },
        "lights": [{ "type": "quad", "corner": [-1, 3, -1], "edge_u": [2, 0, 0], "edge_v": [0, 0, 2], "radiance": [9, 9, 9] }],
        "animation": { "fps": 24, "frames": 3, "tracks": [{
            "target": "camera", "property": "origin", "interpolation": "linear",
            "keys": [{ "frame": 0, "value": [0, 1, 4] }, { "frame": 2, "value": [1, 1, 4] }],
        }] },
    });
    fs::write(folder.join("scene.json"), scene.to_string()).unwrap();
    let materials = "newmtl wood\nillum 1\nKd 0.6 0.4 0.2\nnewmtl mirror\nillum 3\nKs 0.9 0.9 0.9\nnewmtl pane\nillum 4\nNi 1.5\nTf 1 1 1\n";
    fs::write(folder.join("room.mtl"), materials).unwrap();
    let mut geometry = String::from("mtllib room.mtl\n");
    let quads = [
        ("floor", "wood", [[-3, 0, 3], [3, 0, 3], [3, 0, -3], [-3, 0, -3]]),
        ("wall", "mirror", [[-3, 0, -3], [0, 0, -3], [0, 2, -3], [-3, 2, -3]]),
        ("window", "pane", [[0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]]),
    ];
    for (index, (object, material, corners)) in quads.iter().enumerate() {
        geometry += &format!("o {object}\nusemtl {material}\n");
        for [x, y, z] in corners {
            geometry += &format!("v {x} {y} {z}\n");
        }
        let first = 4 * index + 1;
        geometry += &format!("f {} {} {} {}\n", first, first + 1, first + 2, first + 3);
    }
    fs::write(folder.join("room.obj"), geometry).unwrap();
}

pub struct Rig {
    pub folder: tempfile::TempDir,
    pub runner: TaskRunner,
    pub settings: RenderSettings,
}

impl Rig {
    /// With an irradiance cache of this many levels, and a side wall to light the floor.
    pub fn cached(bounces: u32) -> Self {
        let mut rig = Self::new();
        let side = "o side\nusemtl wood\nv -3 0 3\nv -3 0 -3\nv -3 2 -3\nv -3 2 3\nf -4 -3 -2 -1\n";
        let path = rig.bundle().join("room.obj");
        fs::write(&path, fs::read_to_string(&path).unwrap() + side).unwrap();
        rig.settings.ambient_bounces = bounces;
        rig.settings.cache = CacheMode::On;
        rig.settings.cache_rays = 192;
        rig
    }

    pub fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let bundle = folder.path().join("bundle");
        fs::create_dir(&bundle).unwrap();
        write_bundle(&bundle);
        let settings = RenderSettingsRequest { spp: Some(2), ambient_bounces: Some(1), ..Default::default() };
        Self {
            folder,
            runner: TaskRunner::new(OwnRenderer::new(Choice::Cpu)),
            settings: settings.complete((32, 24)),
        }
    }

    /// Adds a track to the scene's animation.
    pub fn animate(&self, track: serde_json::Value) {
        let path = self.bundle().join("scene.json");
        let mut scene: serde_json::Value = serde_json::from_str(&fs::read_to_string(&path).unwrap()).unwrap();
        scene["animation"]["tracks"].as_array_mut().unwrap().push(track);
        fs::write(&path, scene.to_string()).unwrap();
    }

    pub fn bundle(&self) -> std::path::PathBuf {
        self.folder.path().join("bundle")
    }

    pub fn source(&self) -> BundleSource {
        BundleSource::Path(self.bundle().display().to_string())
    }

    /// The digest of the current bundle, if that is a scene.
    pub fn digest(&self) -> SceneDigest {
        let scene = forelight_scene::Scene::load(&self.bundle(), &forelight_scene::Limits::default());
        SceneDigest(scene.map_or([0; 32], |scene| scene.digest()))
    }

    pub fn run(&self, spec: TaskSpec, profile: Option<bytes::Bytes>) -> Result<Outcome, ExecuteError> {
        self.run_from(spec, profile, None, &Control::default())
    }

    pub fn run_from(
        &self,
        spec: TaskSpec,
        profile: Option<bytes::Bytes>,
        checkpoint: Option<bytes::Bytes>,
        control: &Control,
    ) -> Result<Outcome, ExecuteError> {
        self.runner
            .execute(&Assignment { profile, checkpoint, ..Assignment::new(spec, self.bundle()) }, control)
    }

    /// Checks that a render with an unusable profile says so, and makes the same image as without it.
    pub fn makes_the_same(&self, fresh: &Outcome, spec: TaskSpec, profile: bytes::Bytes) {
        let control = Control::default();
        let anyway = self.run_from(spec, Some(profile), None, &control).unwrap();
        let (TaskResult::Render(fresh), TaskResult::Render(anyway)) = (&fresh.result, &anyway.result) else {
            panic!("{fresh:?} {anyway:?}")
        };
        assert_eq!(fresh.artifacts.image_png, anyway.artifacts.image_png);
        assert_eq!((fresh.stats.work, anyway.stats.reused_work), (anyway.stats.work, 0));
        let said = |line: &LogLine| line.text.starts_with("the frame's profile cannot be used: ");
        assert!(control.unsent().iter().any(said), "{:?}", control.unsent());
    }

    pub fn profile_spec(&self, frame: u32) -> TaskSpec {
        TaskSpec::Profile(ProfileSpec {
            error_target: None,
            denoise: false,
            ladders: false,
            job_id: JobId::new(),
            bundle: self.source(),
            digest: self.digest(),
            frame,
            samples: 100,
            phase_seed: 5,
            settings: self.settings.clone().into(),
            renderer: None,
            cache: None,
        })
    }

    pub fn render_spec(&self, frame: u32) -> TaskSpec {
        TaskSpec::Render(RenderSpec {
            error_target: None,
            denoise: false,
            job_id: JobId::new(),
            bundle: self.source(),
            digest: self.digest(),
            frame,
            settings: self.settings.clone().into(),
            renderer: None,
            work: None,
            profile: None,
            cache: None,
            frame_cache: None,
            parts: Vec::new(),
            shares: Vec::new(),
        })
    }
}

/// An observer that ignores progress.
pub struct Nobody;

impl Observer for Nobody {
    fn previewed(&self, _: usize, _: usize) {}
    fn profiled(&self, _: usize, _: usize) {}
    fn is_cancelled(&self) -> bool {
        false
    }
}
