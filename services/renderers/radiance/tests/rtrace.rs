//! The four questions, to real scenes of Radiance. `tests/peers/radiance_renderer.sh` installs it and runs
//! this; `FORELIGHT_RADIANCE` names the folder of its programs.

use forelight_renderer::door::{
    Artefact, AssetState, Capability, Common, Limits, Part, Region, Rendered, Renderer as _, RendererError,
    Run, Settings, Shot, Shown, TakenOver,
};
use forelight_renderer::process::{Program, run};
use forelight_renderer_radiance::Radiance;
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

#[path = "rtrace/frames.rs"]
mod frames;

static RADIANCE: LazyLock<Radiance> = LazyLock::new(|| Radiance::find().unwrap());

const MATERIALS: &str = "void plastic white 0 0 5 .7 .7 .7 0 0
void glass pane 0 0 3 .9 .9 .9
void metal mirror 0 0 5 .8 .8 .8 1 0
void metal satin 0 0 5 .8 .8 .8 .9 .15
void light lamp 0 0 3 20 20 20
";

const ROOM: &str = "white polygon floor 0 0 12 0 0 0 4 0 0 4 4 0 0 4 0
white polygon ceiling 0 0 12 0 0 3 0 4 3 4 4 3 4 0 3
white polygon back 0 0 12 0 4 0 4 4 0 4 4 3 0 4 3
white polygon left 0 0 12 0 0 0 0 4 0 0 4 3 0 0 3
white polygon right 0 0 12 4 0 0 4 0 3 4 4 3 4 4 0
pane polygon window 0 0 12 1 2 .5 2 2 .5 2 2 2 1 2 2
mirror sphere ball 0 0 4 3 3 .5 .5
satin sphere bead 0 0 4 1 3.4 .3 .3
lamp polygon bulb 0 0 12 1.8 1.8 2.95 1.8 2.2 2.95 2.2 2.2 2.95 2.2 1.8 2.95
!genbox white box 1 1 1 | xform -t .5 2.5 0
";

const RIF: &str = "ZONE= Interior 0 4 0 4 0 3
materials= room.mat
scene= room.rad
view= front -vtv -vp 2 .2 1.5 -vd 0 1 0 -vu 0 0 1 -vh 60 -vv 46
view= side -vtv -vp .2 .2 1.5 -vd 1 1 0 -vu 0 0 1 -vh 60 -vv 46
RESOLUTION= 64
render= -ab 0 -dt 0 -dj 0 -ss 0 -lr 6 -lw 1e-4 -ps 1
";

struct World {
    folder: tempfile::TempDir,
}

impl World {
    fn new() -> Self {
        let world = Self { folder: tempfile::tempdir().unwrap() };
        for (name, text) in [("room.mat", MATERIALS), ("room.rad", ROOM), ("room.rif", RIF)] {
            world.write(name, text);
        }
        world
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn write(&self, name: &str, text: &str) {
        fs::write(self.path(name), text).unwrap();
    }

    fn open(&self, name: &str) -> Result<Box<dyn Shot>, RendererError> {
        with(self.folder.path(), 1, |run| RADIANCE.open(&self.path(name), run))
    }

    fn shot(&self) -> Box<dyn Shot> {
        self.open("room.rif").unwrap()
    }

    fn run<T>(&self, question: impl FnOnce(&Run<'_>) -> T) -> T {
        with(self.folder.path(), 1, question)
    }
}

fn with<T>(scratch: &Path, threads: u32, question: impl FnOnce(&Run<'_>) -> T) -> T {
    let cancelled = AtomicBool::new(false);
    let limits = Limits { time: Some(Duration::from_secs(60)), threads, ..Limits::default() };
    question(&Run::silent(&cancelled, scratch, limits))
}

fn changed(shot: &dyn Shot, own: Value) -> Settings {
    shot.description().settings.clone().with_own(own.as_object().unwrap())
}

/// One bounce without interpolation.
fn gathered(shot: &dyn Shot) -> Settings {
    changed(
        shot,
        json!({"ambient_bounces": 1, "ambient_accuracy": 0, "ambient_divisions": 16, "ambient_super_samples": 0}),
    )
}

/// One bounce whose values pixels share.
fn interpolated(shot: &dyn Shot) -> Settings {
    changed(
        shot,
        json!({"ambient_bounces": 1, "ambient_accuracy": 0.2, "ambient_divisions": 64, "ambient_super_samples": 0}),
    )
}

fn pixels_of(rendered: &Rendered) -> Vec<[f32; 3]> {
    let image = image::open(&rendered.files[0]).unwrap().to_rgb32f();
    image.pixels().map(|pixel| pixel.0).collect()
}

fn processes_of_ours() -> usize {
    let mark = format!("FORELIGHT_PROCESS={}-", std::process::id());
    let entries = fs::read_dir("/proc").unwrap().flatten();
    let marked = entries.filter(|entry| {
        fs::read(entry.path().join("environ"))
            .is_ok_and(|text| text.split(|&b| b == 0).any(|line| line.starts_with(mark.as_bytes())))
    });
    marked.count()
}

/// Profiles these pixels, in this order.
fn profile(
    world: &World,
    shot: &dyn Shot,
    settings: &Settings,
    pixels: &[u32],
) -> (Vec<[u64; 7]>, Vec<u64>, Artefact) {
    world.run(|run| {
        let mut profiler = shot.profile_pixels(1, settings, run).unwrap();
        let costs = profiler.measure(pixels).unwrap();
        let found = profiler.finish().unwrap();
        assert!(found.cost.cpu_nanos > costs.iter().map(|cost| cost.cpu_nanos).sum());
        assert!(found.fixed["prepare"] > 0);
        let rays = costs.iter().map(|cost| cost.rays).collect();
        (rays, costs.iter().map(|cost| cost.cpu_nanos).collect(), found.artefact.unwrap())
    })
}

#[test]
#[ignore = "tests/peers/radiance_renderer.sh installs Radiance"]
fn a_scene_is_described_with_its_views_options_and_files() {
    let world = World::new();
    let shot = world.shot();
    let found = shot.description();
    assert_eq!(found.frames.numbers().collect::<Vec<_>>(), [1, 2]);
    assert_eq!(
        found.cameras.iter().map(|camera| camera.name.as_str()).collect::<Vec<_>>(),
        ["front", "side"]
    );
    let Common { width, height, samples, .. } = found.settings.common;
    assert_eq!((width, height, samples), (64, 47, 1));
    assert_eq!(found.settings.own["direct_threshold"], 0.0);
    assert!(found.settings.own["ambient_divisions"].as_i64().unwrap() > 0, "a default of the program");
    assert!(found.notes.iter().any(|note| note.contains("runs commands")), "{:?}", found.notes);
    let names: Vec<&str> = found.assets.iter().map(|asset| asset.name.as_str()).collect();
    assert_eq!(names, ["room.mat", "room.rad"]);
    assert!(found.assets.iter().all(|asset| asset.state == AssetState::Present));
    assert!(found.opening.cpu_nanos > 0);
    assert_eq!(found.settings.check(&RADIANCE.settings_schema()), Ok(()));
    let version = &RADIANCE.id().version;
    assert!(version.starts_with(|c: char| c.is_ascii_digit()), "{version}");
}

#[test]
#[ignore = "tests/peers/radiance_renderer.sh installs Radiance"]
fn what_is_wrong_with_a_scene_is_named() {
    let world = World::new();
    let error = |name: &str| world.open(name).err().unwrap().to_string();
    world.write("lost.rif", &RIF.replace("room.rad", "nowhere.rad"));
    assert!(error("lost.rif").contains("nowhere.rad"), "{}", error("lost.rif"));
    world.write("blind.rif", &RIF.replace("-vd 0 1 0", "-vx 0 1 0"));
    assert!(error("blind.rif").contains("blind.rif: view: option -vx"), "{}", error("blind.rif"));
    world.write("broken.rad", "white polygon floor 0 0 3 1 2\n");
    world.write("broken.rif", &RIF.replace("room.rad", "broken.rad"));
    assert!(error("broken.rif").contains("broken.rad"), "{}", error("broken.rif"));
    assert!(error("none.rif").contains("none.rif"));
    world.write(
        "wood.mat",
        &format!("void colorpict wood 7 red green blue wood.hdr . frac(Lu) frac(Lv) 0 0\n{MATERIALS}"),
    );
    world.write("wood.rif", &RIF.replace("room.mat", "wood.mat"));
    let shot = world.open("wood.rif").unwrap();
    let missing: Vec<&str> = shot.description().missing().map(|asset| asset.name.as_str()).collect();
    assert_eq!(missing, ["wood.hdr"]);
    let error = world.run(|run| shot.preview(&[1], &shot.description().settings, run)).unwrap_err();
    assert!(matches!(&error, RendererError::MissingAssets(assets) if assets.len() == 1), "{error}");
    world.run(|run| shot.preview(&[1], &changed(&*shot, json!({"allow_missing": true})), run)).unwrap();
    let error = world.run(|run| shot.preview(&[3], &changed(&*shot, json!({"allow_missing": true})), run));
    assert!(error.unwrap_err().to_string().contains("no frame 3"));
    let wrong = changed(&*shot, json!({"ambient_bounces": -1}));
    let error = world.run(|run| shot.render(1, &wrong, &[], run)).err().unwrap().to_string();
    assert!(error.starts_with("setting /own/ambient_bounces"), "{error}");
}

#[test]
#[ignore = "tests/peers/radiance_renderer.sh installs Radiance"]
fn pixels_are_counted_by_what_a_view_shows() {
    let world = World::new();
    let shot = world.shot();
    let settings = shot.description().settings.clone();
    let counts = world.run(|run| shot.preview(&[1, 2], &settings, run)).unwrap();
    for frame in &counts {
        assert_eq!(frame.counts.iter().map(|count| count.pixels).sum::<u64>(), settings.pixels());
        assert!(frame.cost.cpu_nanos > 0);
    }
    assert_ne!(counts[0].counts, counts[1].counts);
    let names: BTreeSet<(String, String)> = counts[0]
        .counts
        .iter()
        .map(|count| shot.names(Shown { object: count.object, material: count.material }))
        .map(|(object, material)| (object.unwrap_or_default(), material.unwrap_or_default()))
        .collect();
    // The box is moved by a command, and its six sides are one object.
    for (object, material) in [("ball", "mirror"), ("window", "pane"), ("box", "white"), ("floor", "white")] {
        assert!(names.contains(&(object.to_owned(), material.to_owned())), "{names:?}");
    }
    // Another process gives the same numbers.
    let again = world.shot();
    let settings = again.description().settings.clone();
    let other = world.run(|run| again.preview(&[1], &settings, run)).unwrap();
    assert_eq!(other[0].counts, counts[0].counts);
}

#[test]
#[ignore = "tests/peers/radiance_renderer.sh installs Radiance"]
fn a_frame_is_what_rpict_renders() {
    let world = World::new();
    let shot = world.shot();
    let settings = shot.description().settings.clone();
    let rendered = world.run(|run| shot.render(1, &settings, &[], run)).unwrap();
    assert!(rendered.files[1].ends_with("frame-0001.hdr"));
    assert!(rendered.cost.cpu_nanos > rendered.fixed["prepare"]);
    let blocks = rendered.blocks.as_ref().unwrap();
    assert_eq!((blocks.side, blocks.columns, blocks.nanos.len()), (8, 8, 48));
    let folder = PathBuf::from(std::env::var_os("FORELIGHT_RADIANCE").unwrap());
    let library = folder.parent().unwrap().join("lib");
    let options = "-vtv -vp 2 .2 1.5 -vd 0 1 0 -vu 0 0 1 -vh 60 -vv 46 -x 64 -y 47 -pa 0 -ps 1 -pj 0 -ab 0 -dt 0 -dj 0 -ss 0 -lr 6 -lw 1e-4";
    let text = fs::read_to_string(world.path("room.rif")).unwrap();
    assert!(text.contains("-ab 0 -dt 0"));
    world.run(|run_| {
        let octree = Program::new("/bin/sh", world.folder.path())
            .env("PATH", format!("{}:/usr/bin:/bin", folder.display()))
            .env("RAYPATH", format!(".:{}", library.display()))
            .args(["-c", "oconv room.mat room.rad >o.oct && rpict $OPTIONS o.oct >theirs.hdr"])
            .env("OPTIONS", format!("{options} {}", quality(&settings)));
        run(&octree, &[], run_, &mut |_| {}).unwrap();
    });
    let theirs = image::open(world.path("theirs.hdr")).unwrap().to_rgb32f();
    let ours = image::open(&rendered.files[1]).unwrap().to_rgb32f();
    assert_eq!(ours.dimensions(), theirs.dimensions());
    let mut differ = 0;
    for (ours, theirs) in ours.pixels().zip(theirs.pixels()) {
        let most = theirs.0.iter().copied().fold(1e-3, f32::max);
        // The format has a common exponent and eight bits.
        differ += u32::from(ours.0.iter().zip(&theirs.0).any(|(a, b)| (a - b).abs() > most / 100.0));
    }
    assert!(differ <= 6, "{differ} of {} pixels differ from rpict's", 64 * 47);
}

/// The direct and specular options of these settings, as rpict takes them.
fn quality(settings: &Settings) -> String {
    [
        ("-ds", "direct_sampling"),
        ("-dr", "direct_relays"),
        ("-st", "specular_threshold"),
        ("-dc", "direct_certainty"),
    ]
    .map(|(option, name)| format!("{option} {}", settings.own[name]))
    .join(" ")
        + " -av "
        + &settings.own["ambient_value"]
            .as_array()
            .unwrap()
            .iter()
            .map(Value::to_string)
            .collect::<Vec<_>>()
            .join(" ")
}

#[test]
#[ignore = "tests/peers/radiance_renderer.sh installs Radiance"]
fn pixels_that_are_taken_over_give_the_bits_of_one_render_without_random_numbers() {
    let world = World::new();
    let shot = world.shot();
    let settings = shot.description().settings.clone();
    let whole = world.run(|run| shot.render(1, &settings, &[], run)).unwrap();
    let all = pixels_of(&whole);
    assert_eq!(whole.taken_over, TakenOver::default());
    let every_third: Vec<u32> = (0..64 * 47).filter(|pixel| pixel % 3 == 0).collect();
    let (.., artefact) = profile(&world, &*shot, &settings, &every_third);
    let rest = world.run(|run| shot.render(1, &settings, std::slice::from_ref(&artefact), run)).unwrap();
    assert_eq!(pixels_of(&rest), all);
    assert_eq!(rest.taken_over.pixels, every_third.len() as u64);
    assert!(rest.taken_over.cpu_nanos > 0);
    // Nothing is left to trace.
    let every: Vec<u32> = (0..64 * 47).collect();
    let (.., artefact) = profile(&world, &*shot, &settings, &every);
    let nothing = world.run(|run| shot.render(1, &settings, std::slice::from_ref(&artefact), run)).unwrap();
    assert_eq!(pixels_of(&nothing), all);
    let error = |frame, settings: &Settings| {
        world
            .run(|run| shot.render(frame, settings, std::slice::from_ref(&artefact), run))
            .err()
            .unwrap()
            .to_string()
    };
    assert!(error(2, &settings).contains("part of frame 1"));
    assert!(error(1, &gathered(&*shot)).contains("other settings"));
}

#[test]
#[ignore = "tests/peers/radiance_renderer.sh installs Radiance"]
fn with_random_numbers_pixels_that_are_taken_over_are_kept_and_the_others_have_the_same_mean() {
    let world = World::new();
    let shot = world.shot();
    let settings = gathered(&*shot);
    let pixels: Vec<u32> = (0..64 * 47).step_by(5).collect();
    let (.., artefact) = profile(&world, &*shot, &settings, &pixels);
    let kept = fs::read(&artefact.path).unwrap();
    let merged = pixels_of(&world.run(|run| shot.render(1, &settings, &[artefact], run)).unwrap());
    for (at, pixel) in pixels.iter().enumerate() {
        let own = &kept[32 + 24 * at..][4..16];
        let colour = merged[*pixel as usize].map(f32::to_le_bytes).concat();
        assert_eq!(own, colour, "pixel {pixel}");
    }
    let whole = pixels_of(&world.run(|run| shot.render(1, &settings, &[], run)).unwrap());
    assert_ne!(merged, whole);
    let mean = |pixels: &[[f32; 3]]| {
        pixels.iter().flatten().map(|&v| f64::from(v)).sum::<f64>() / pixels.len() as f64
    };
    let error = mean(&merged) / mean(&whole) - 1.0;
    assert!(error.abs() < 0.01, "{error}");
}

#[test]
#[ignore = "tests/peers/radiance_renderer.sh installs Radiance"]
fn values_that_a_profile_gathered_are_those_that_the_render_begins_with() {
    let world = World::new();
    let shot = world.shot();
    let settings = interpolated(&*shot);
    let grid =
        |step: usize| (0..47).step_by(step).flat_map(move |y| (0..64).step_by(step).map(move |x| y * 64 + x));
    let coarse: Vec<u32> = grid(8).collect();
    let finer: Vec<u32> = grid(2).filter(|pixel| !coarse.contains(pixel)).collect();
    let size = |artefact: &Artefact| fs::metadata(&artefact.path).unwrap().len();
    let gather =
        |rays: &[[u64; 7]]| rays.iter().filter(|rays| rays[5] > 0).count() as f64 / rays.len() as f64;
    let (rays, _, few) = profile(&world, &*shot, &settings, &coarse);
    let (of_few, first) = (size(&few), gather(&rays));
    assert!(of_few > 32 + 24 * 48, "the file has values");
    let (rays, _, more) = profile(&world, &*shot, &settings, &[coarse, finer].concat());
    let later = gather(&rays[48..]);
    assert!(
        size(&more) > of_few && later < first,
        "{later} of the later pixels gather, {first} of the first"
    );
    let mean = |pixels: &[[f32; 3]]| {
        pixels.iter().flatten().map(|&v| f64::from(v)).sum::<f64>() / pixels.len() as f64
    };
    let image = |threads, over: &[Artefact]| {
        with(world.folder.path(), threads, |run| {
            mean(&pixels_of(&shot.render(1, &settings, over, run).unwrap()))
        })
    };
    let alone = image(1, &[]);
    for (threads, over) in [(1, std::slice::from_ref(&more)), (4, &[]), (4, std::slice::from_ref(&more))] {
        let error = image(threads, over) / alone - 1.0;
        assert!(error.abs() < 0.03, "{threads} threads: {error}");
    }
    let left = fs::read_dir(world.folder.path()).unwrap().flatten();
    assert!(left.into_iter().all(|entry| !entry.file_name().to_string_lossy().starts_with("ambient-")));
}

#[test]
#[ignore = "tests/peers/radiance_renderer.sh installs Radiance"]
fn rays_are_counted_by_kind() {
    let world = World::new();
    let shot = world.shot();
    let settings = gathered(&*shot);
    let every: Vec<u32> = (0..64 * 47).collect();
    let (rays, nanos, _) = profile(&world, &*shot, &settings, &every);
    assert!(rays.iter().all(|rays| rays[0] == 1), "one primary ray a pixel");
    assert!(nanos.iter().all(|&nanos| nanos > 0));
    let sum = |kind: usize| rays.iter().map(|rays| rays[kind]).sum::<u64>();
    for kind in [1, 2, 3, 5] {
        assert!(sum(kind) > 0, "kind {kind}");
    }
    // A pixel of a wall gathers 16 rays, and nothing there reflects.
    let floor: Vec<&[u64; 7]> =
        rays.iter().filter(|rays| rays[2] == 0 && rays[3] == 0 && rays[6] == 0).collect();
    let sixteen = floor.iter().filter(|rays| rays[5] == 16).count();
    assert!(sixteen * 10 > floor.len() * 7, "{sixteen} of {}", floor.len());
    let without = shot.description().settings.clone();
    let (direct, ..) = profile(&world, &*shot, &without, &every);
    assert_eq!(direct.iter().map(|rays| rays[5] + rays[6]).sum::<u64>(), 0);
}

#[test]
#[ignore = "tests/peers/radiance_renderer.sh installs Radiance"]
fn parts_are_measured_on_any_number_of_threads() {
    let world = World::new();
    let shot = world.shot();
    let mut settings = shot.description().settings.clone();
    settings.common.samples = 4;
    assert!(shot.capabilities(&settings).contains(&Capability::TakeOverPixels));
    let of = |threads| {
        with(world.folder.path(), threads, |run| pixels_of(&shot.render(1, &settings, &[], run).unwrap()))
    };
    let (one, three) = (of(1), of(3));
    assert_eq!(one, three);
    let ask = |part: &Part| world.run(|run| shot.measure(1, &settings, part, run));
    let two = ask(&Part::Samples { offset: 1, count: 2 }).unwrap();
    assert!(two.blocks.is_some() && two.cost.cpu_nanos > two.fixed["prepare"]);
    let regions =
        vec![Region { x: 0, y: 8, width: 16, height: 8 }, Region { x: 48, y: 0, width: 8, height: 8 }];
    let measured = ask(&Part::Regions(regions.clone())).unwrap();
    assert!(measured.pieces.iter().map(|piece| piece.region).eq(regions));
    assert!(measured.pieces.iter().all(|piece| piece.cpu_nanos > 0));
    for (part, reason) in [
        (Part::Samples { offset: 3, count: 2 }, "samples 3 to 5 of 4"),
        (Part::Regions(vec![Region { x: 60, y: 0, width: 8, height: 8 }]), "(60, 0)"),
        (Part::Pixels(vec![64 * 47]), "pixel 3008"),
    ] {
        let error = ask(&part).unwrap_err().to_string();
        assert!(error.contains(reason), "{error}");
    }
    let interpolated = shot.capabilities(&interpolated(&*shot));
    assert!(
        interpolated.contains(&Capability::ShareCache) && !interpolated.contains(&Capability::MeasureRegions)
    );
}

#[test]
#[ignore = "tests/peers/radiance_renderer.sh installs Radiance"]
fn numbered_octrees_are_frames_and_views_come_from_files_beside_them() {
    let world = World::new();
    let folder = PathBuf::from(std::env::var_os("FORELIGHT_RADIANCE").unwrap());
    world.run(|run_| {
        let program = Program::new("/bin/sh", world.folder.path())
            .env("PATH", format!("{}:/usr/bin:/bin", folder.display()))
            .args(["-c", "oconv -f room.mat room.rad >walk004.oct && cp walk004.oct walk006.oct && cp walk004.oct still.oct"]);
        run(&program, &[], run_, &mut |_| {}).unwrap();
    });
    assert!(world.open("walk004.oct").err().unwrap().to_string().contains("walk004.vf"));
    world.write("walk.vf", "VIEW= -vtv -vp 2 .2 1.5 -vd 0 1 0 -vu 0 0 1 -vh 60 -vv 60\nVIEW= -vp 2 1 1.5\n");
    let shot = world.open("walk006.oct").unwrap();
    assert_eq!(shot.description().frames.numbers().collect::<Vec<_>>(), [4, 6]);
    world.write("still.vf", "VIEW= -vtv -vp 2 .2 1.5 -vd 0 1 0 -vu 0 0 1 -vh 60 -vv 60\n");
    let still = world.open("still.oct").unwrap();
    let mut settings = still.description().settings.clone();
    assert_eq!((settings.common.width, settings.common.height), (512, 512));
    (settings.common.width, settings.common.height) = (24, 24);
    let image = |shot: &dyn Shot, frame| {
        pixels_of(&world.run(|run| shot.render(frame, &settings, &[], run)).unwrap())
    };
    assert_eq!(image(&*shot, 4), image(&*still, 1));
    assert_ne!(image(&*shot, 6), image(&*still, 1));
}

#[test]
#[ignore = "tests/peers/radiance_renderer.sh installs Radiance"]
fn a_cancelled_render_leaves_no_process_and_a_limit_is_named() {
    let world = World::new();
    let shot = world.shot();
    let mut settings = gathered(&*shot);
    settings.own.insert("ambient_divisions".to_owned(), 4096.into());
    settings.common.samples = 64;
    let cancelled = AtomicBool::new(false);
    let stop = |_: f64| cancelled.store(true, Ordering::Relaxed);
    let silent = Run::silent(&cancelled, world.folder.path(), Limits::default());
    let outside = Run { progress: &stop, ..silent };
    let error = shot.render(1, &settings, &[], &outside).err().unwrap();
    assert!(matches!(error, RendererError::Cancelled), "{error}");
    assert_eq!(processes_of_ours(), 0);
    cancelled.store(false, Ordering::Relaxed);
    let limits = Limits { memory_bytes: Some(1 << 20), ..Limits::default() };
    let error = shot.render(1, &settings, &[], &Run { limits, progress: &|_| {}, ..outside }).err().unwrap();
    assert!(matches!(error, RendererError::OutOfMemory(_)), "{error}");
    assert_eq!(processes_of_ours(), 0);
}
