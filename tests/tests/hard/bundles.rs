//! Difficult bundles, through the loader. Meaningless ones are refused in one line, degenerate ones are
//! rendered.

use forelight_protocol::Integrator;
use forelight_scene::{Limits, Scene, SceneError};
use forelight_tests::case::case;
use forelight_tests::repository;
use forelight_tests::world::{render, unsound};
use forelight_tracer::{CacheSettings, Settings};
use std::collections::BTreeMap;
use tempfile::TempDir;

/// The files of a bundle made in code.
#[derive(Default)]
pub struct Files(BTreeMap<String, Vec<u8>>);

impl Files {
    pub fn with(mut self, name: &str, content: impl Into<Vec<u8>>) -> Self {
        self.0.insert(name.into(), content.into());
        self
    }

    /// Writes all files into a new folder.
    pub fn folder(&self) -> TempDir {
        let folder = TempDir::new().expect("a temporary folder can be made");
        for (name, content) in &self.0 {
            std::fs::write(folder.path().join(name), content).expect("a temporary file can be written");
        }
        folder
    }

    pub fn load(&self) -> Result<Scene, SceneError> {
        Scene::load(self.folder().path(), &Limits::default())
    }
}

/// `scene.json` with a camera at (0.3, 0.5, 3) that looks at the origin, a lamp above, and a grey sky.
fn description(geometry: &str) -> String {
    format!(
        r#"{{"version":1,"name":"nasty","geometry":["{geometry}"],
        "camera":{{"origin":[0.3,0.5,3],"target":[0,0,0],"up":[0,1,0],"fov_deg":60,"fov_axis":"x","width":16,"height":16}},
        "environment":{{"type":"constant","radiance":[0.2,0.2,0.2]}},
        "lights":[{{"type":"quad","corner":[-0.5,2,-0.5],"edge_u":[1,0,0],"edge_v":[0,0,1],"radiance":[3,3,3]}}]}}"#
    )
}

fn obj(text: &str) -> Files {
    let mtl = "newmtl grey\nKd 0.5 0.5 0.5\nillum 1\nnewmtl glass\nillum 7\nNi 1.5\nnewmtl metal\nillum 3\nKs 0.8 0.8 0.8\nPr 0.3\n\
               newmtl glow\nKd 0 0 0\nillum 1\nKe 5 5 5\n";
    Files::default()
        .with("scene.json", description("scene.obj"))
        .with("scene.mtl", mtl)
        .with("scene.obj", format!("mtllib scene.mtl\n{text}"))
}

fn settings() -> Settings {
    Settings {
        width: 16,
        height: 16,
        spp: 4,
        ambient_bounces: 1,
        ambient_divisions: 4,
        ..Settings::default()
    }
}

/// Renders all frames of a scene in every way. Returns the numbers of unsound pixels and of all.
fn rendered(scene: &Scene) -> (u64, u64) {
    let ways = [
        settings(),
        Settings { cache: Some(CacheSettings::default()), ..settings() },
        Settings { integrator: Integrator::Path, ambient_bounces: 8, ..settings() },
    ];
    let (mut wrong, mut all) = (0, 0);
    for frame in 0..scene.frame_count() {
        let frame = scene.frame(frame).expect("the frame is within the shot");
        for settings in &ways {
            wrong += unsound(&render(&frame, settings));
            all += 256;
        }
    }
    (wrong, all)
}

/// A floor that makes every bundle a valid scene.
const FLOOR: &str = "o floor\nusemtl grey\nv -2 -0.5 -2\nv 2 -0.5 -2\nv 2 -0.5 2\nv -2 -0.5 2\nf 4 3 2 1\n";

#[test]
fn vertices_that_are_no_numbers_or_beyond_all_measure_are_refused_with_file_line_and_reason() {
    let bad = ["nan 0 0", "0 inf 0", "0 0 -infinity", "1e39 0 0", "0 1e10 0", "0 0 -1e30", "1e-400 x 0"];
    let mut wrong = 0;
    for vertex in bad {
        let text = format!("{FLOOR}o bad\nv {vertex}\nv 1 0 0\nv 0 1 0\nf -3 -2 -1\n");
        match obj(&text).load() {
            Ok(_) => {
                println!("         accepted: {vertex}");
                wrong += 1;
            }
            Err(error) => {
                let line = error.to_string();
                wrong += u64::from(line.contains('\n') || !line.starts_with("scene.obj"));
            }
        }
    }
    case(11, "vertices that are no number or too large, not refused in one line")
        .never(wrong, bad.len() as u64);
}

#[test]
fn degenerate_triangles_are_counted_left_out_and_reported() {
    // Zero area (twice the same vertex, a point, on a line), a duplicate, slivers and denormal sizes.
    let text = format!(
        "{FLOOR}o bad\nusemtl glass\nv 0 0 0\nv 1 0 0\nv 0.5 0 0\nv 0 1e-7 0\nv 1e-40 0 0\nv 0 1e-40 0\nv 1e-38 1e-38 0\n\
         f -7 -7 -6\nf -7 -7 -7\nf -7 -6 -5\nf -7 -6 -4\nf -7 -6 -4\nf -7 -3 -2\nf -7 -3 -1\n"
    );
    let scene = obj(&text).load().expect("degenerate triangles are no reason to refuse a scene");
    let warning = scene.warnings().iter().find(|w| w.contains("no area")).cloned().unwrap_or_default();
    println!("         {warning}");
    assert!(warning.starts_with("scene.json: 3 triangles"), "{:?}", scene.warnings());
    let (wrong, pixels) = rendered(&scene);
    case(11, "pixels of a scene with degenerate triangles that are no finite number").never(wrong, pixels);
}

#[test]
fn a_million_lights_without_area_are_no_lights() {
    // Compare with a single lamp. Both have the same objects and materials, because random choices may depend
    // on their numbers.
    let lamps = |count: usize| {
        let text =
            format!("{FLOOR}o lamps\nusemtl glow\nv 0 0.5 0\nv 1 0.5 0\n{}", "f -1 -2 -1\n".repeat(count));
        obj(&text).load().expect("it loads")
    };
    let (scene, single) = (lamps(1_000_000), lamps(1));
    let image = |scene: &Scene| render(&scene.frame(0).expect("a frame"), &settings());
    let (a, b) = (image(&scene), image(&single));
    let differing = a.pixels.iter().zip(&b.pixels).filter(|(a, b)| a.color != b.color || a.rays != b.rays);
    case(16, "pixels that a million lamps without area change").never(differing.count() as u64, 256);
    assert!(scene.warnings().iter().any(|w| w.contains("1000000 triangles")), "{:?}", scene.warnings());
}

#[test]
fn a_scene_with_nothing_in_it_is_refused_and_a_black_one_is_black() {
    let nothing = ["", "o empty\n", "o line\nv 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n"];
    let description = r#"{"version":1,"name":"black","geometry":["scene.obj"],
        "camera":{"origin":[0,1,3],"target":[0,0,0],"up":[0,1,0],"fov_deg":60,"fov_axis":"x","width":16,"height":16}}"#;
    let mut wrong = 0;
    for text in nothing {
        let refused = obj(text).with("scene.json", description).load();
        wrong += u64::from(!matches!(refused, Err(e) if !e.to_string().contains('\n')));
    }
    case(17, "bundles without a triangle that are not refused in one line")
        .never(wrong, nothing.len() as u64);
    let scene = obj(FLOOR).with("scene.json", description).load().expect("a scene without light loads");
    assert!(scene.warnings().iter().any(|w| w.contains("no light")), "{:?}", scene.warnings());
    let image = render(&scene.frame(0).expect("a frame"), &settings());
    let lit = image.pixels.iter().filter(|p| p.color != [0.0; 3]).count() as u64;
    case(17, "pixels of a scene without light that are not black").never(lit, 256);
}

#[test]
fn lights_are_accepted_up_to_1e12_and_refused_beyond() {
    let with = |radiance: &str| {
        obj(FLOOR).with("scene.json", description("scene.obj").replace("[3,3,3]", radiance)).load()
    };
    let (mut wrong, mut pixels) = (0, 0);
    for radiance in ["[0,0,0]", "[1e-30,1e-300,0]", "[1e12,1e12,1e12]"] {
        let (bad, all) = rendered(&with(radiance).expect("within the limits"));
        (wrong, pixels) = (wrong + bad, pixels + all);
    }
    case(17, "pixels under lights of 0, 1e-30 and 1e12 that are no finite number").never(wrong, pixels);
    let refused = ["[1e13,0,0]", "[-1,0,0]", "[1e400,0,0]"];
    let accepted = refused.iter().filter(|r| with(r).is_ok()).count() as u64;
    case(17, "lights beyond 1e12, below 0 or beyond numbers that are accepted")
        .never(accepted, refused.len() as u64);
}

#[test]
fn every_bundle_of_the_collection_is_rendered_finite_or_refused_in_one_line() {
    let folder = repository().join("tests/hard/bundles");
    let mut names: Vec<_> = std::fs::read_dir(&folder)
        .expect("the collection is there")
        .map(|entry| entry.expect("the folder can be read").path())
        .collect();
    names.sort();
    let mut wrong = 0;
    for path in &names {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let loaded = Scene::load(path, &Limits::default());
        // The name says whether the bundle must be refused.
        assert_eq!(name.starts_with("refused-"), loaded.is_err(), "{name}: {:?}", loaded.err());
        match loaded {
            Ok(scene) => {
                let (bad, all) = rendered(&scene);
                println!("         {name}: {bad} of {all} pixels are no finite number");
                wrong += u64::from(bad > 0);
            }
            Err(error) => {
                let line = error.to_string();
                println!("         {name}: {line}");
                wrong += u64::from(line.contains('\n'));
            }
        }
    }
    case(11, "bundles of the collection with a pixel that is no finite number, or a long error")
        .never(wrong, names.len() as u64);
}
