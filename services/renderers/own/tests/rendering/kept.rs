//! Scenes and trees that a machine keeps: they change what is spent, and nothing else.

use forelight_kept::Folder;
use forelight_preview::Choice;
use forelight_protocol::{RenderSettings, RenderSettingsRequest};
use forelight_renderer_own::{Given, OwnRenderer, OwnShot, Rendered, render_frame};
use std::fmt::Write as _;
use std::fs;
use std::path::Path;
use std::sync::atomic::AtomicBool;

/// A bundle of waves, large enough to be kept. Its lamp moves if `moves` is set.
fn waves(folder: &Path, moves: bool) {
    const SIDE: usize = 140;
    let mut obj = String::from("o waves\n");
    for (x, y) in (0..=SIDE).flat_map(|x| (0..=SIDE).map(move |y| (x, y))) {
        let (x, y) = (x as f64 / 10.0, y as f64 / 10.0);
        writeln!(obj, "v {x:.9} {y:.9} {:.9}", (x * 1.3).sin() * (y * 0.9).cos()).unwrap();
    }
    for (x, y) in (0..SIDE).flat_map(|x| (0..SIDE).map(move |y| (x, y))) {
        let at = |x: usize, y: usize| x * (SIDE + 1) + y + 1;
        writeln!(obj, "f {} {} {} {}", at(x, y), at(x + 1, y), at(x + 1, y + 1), at(x, y + 1)).unwrap();
    }
    writeln!(obj, "o lamp\nv 6 6 9\nv 8 6 9\nv 7 8 9\nusemtl lamp\nf -3 -1 -2").unwrap();
    fs::write(folder.join("waves.obj"), format!("mtllib waves.mtl\nusemtl grey\n{obj}")).unwrap();
    let materials = "newmtl grey\nKd 0.5 0.5 0.5\nnewmtl lamp\nKd 0 0 0\nKe 20 20 20\n";
    fs::write(folder.join("waves.mtl"), materials).unwrap();
    let camera = r#"{"origin":[7,-8,12],"target":[7,7,0],"up":[0,0,1],"fov_deg":60,"fov_axis":"x","width":24,"height":16}"#;
    let keys = r#"[{"frame":0,"value":[0,0,0]},{"frame":1,"value":[1,0,0]}]"#;
    let track = format!(
        r#"{{"target":"object:lamp","property":"translation","interpolation":"linear","keys":{keys}}}"#
    );
    let tracks = if moves { &*track } else { "" };
    let description = format!(
        r#"{{"version":1,"name":"w","geometry":["waves.obj"],"camera":{camera},"animation":{{"frames":2,"tracks":[{tracks}]}}}}"#
    );
    fs::write(folder.join("scene.json"), description).unwrap();
}

fn settings() -> RenderSettings {
    let request =
        RenderSettingsRequest { spp: Some(2), ambient_bounces: Some(1), ..RenderSettingsRequest::default() };
    request.complete((24, 16))
}

fn rendered(shot: &OwnShot, frame: u32) -> Rendered {
    let never = AtomicBool::new(false);
    render_frame(shot, frame, &settings(), Given::default(), &|_| {}, &never).unwrap().unwrap()
}

/// All that must not depend on what is kept: bits, counters, work, and what a process pays that keeps
/// nothing.
fn results(rendered: &Rendered) -> String {
    let pixels = rendered.image.pixels.iter();
    let bits: Vec<_> =
        pixels.map(|pixel| (pixel.color.map(f32::to_bits), pixel.work, pixel.rays, pixel.stratum)).collect();
    let stats = &rendered.stats;
    let once = stats.once.unwrap();
    format!(
        "{bits:?} {} {:?} {:?} {:?}",
        stats.work,
        stats.rays,
        stats.effects,
        (once.load.work, once.build.work)
    )
}

#[test]
fn a_kept_scene_and_its_tree_change_what_is_spent_and_nothing_else() {
    for moves in [false, true] {
        let (bundle, kept) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        waves(bundle.path(), moves);
        let alone = OwnRenderer::new(Choice::Cpu);
        let keeping = alone.clone().keeping(Folder::new(kept.path()).unwrap());
        let plain = alone.open(bundle.path()).unwrap();
        let [first, second] = [0, 1].map(|_| keeping.open(bundle.path()).unwrap());
        for frame in [0, 1] {
            let expected = results(&rendered(&plain, frame));
            assert!(results(&rendered(&first, frame)) == expected, "frame {frame}, moves: {moves}");
            assert!(results(&rendered(&second, frame)) == expected, "frame {frame}, moves: {moves}");
        }
        let setup = |renderer: &OwnRenderer, frame| {
            let shot = renderer.open(bundle.path()).unwrap();
            shot.frame(frame, &settings()).unwrap().spent_on_setup().work
        };
        let (built, read) = (setup(&alone, 0), setup(&keeping, 0));
        assert!(0 < read && read * 10 < built, "{read} against {built}");
        assert_eq!(setup(&keeping, 1) < setup(&alone, 1), !moves, "only trees of all frames are kept");
        let files = fs::read_dir(kept.path()).unwrap().count();
        assert_eq!(files, 2, "one scene and one tree");
    }
}
