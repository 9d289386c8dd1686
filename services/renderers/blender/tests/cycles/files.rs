//! What a file refers to, and what it must not do.

use super::*;

#[test]
#[ignore = "tests/peers/blender.sh makes its files"]
fn a_missing_texture_is_named_before_anything_is_rendered() {
    ask("missing", |shot, run| {
        let mut settings: Settings = shot.description().settings.clone();
        settings.common.samples = 1;
        let error = shot.render(0, &settings, &[], run).unwrap_err();
        assert!(matches!(error, RendererError::MissingAssets(_)) && error.is_permanent());
        assert!(error.to_string().contains("textures/wood.png"), "{error}");
        settings.own.insert("allow_missing".to_owned(), true.into());
        shot.render(0, &settings, &[], run).unwrap();
    });
}

#[test]
#[ignore = "tests/peers/blender.sh makes its files"]
fn a_packed_copy_has_textures_and_libraries_inside_and_renders_the_same_image() {
    for name in names().into_iter().chain(["linked".to_owned()]) {
        ask(&name, |shot, run| {
            let mut settings = shot.description().settings.clone();
            settings.common.samples = 1;
            let copy = run.scratch.join("copy.blend");
            assert!(shot.pack(&settings, &copy, run).unwrap(), "{name} refers to files outside");
            let packed = CYCLES.open(&copy, run).unwrap();
            assert!(packed.description().assets.iter().all(|asset| asset.state == AssetState::Packed));
            assert!(!packed.pack(&settings, &run.scratch.join("again.blend"), run).unwrap());
            let image = |shot: &dyn Shot| {
                let rendered = shot.render(0, &settings, &[], run).unwrap();
                let mut found = channels(&rendered.files[0]);
                found.retain(|name, _| !name.contains("Render Time"));
                found
            };
            assert!(image(shot) == image(&*packed), "{name}");
        });
    }
}

#[test]
#[ignore = "tests/peers/blender.sh makes its files"]
fn what_cannot_be_inside_a_file_is_named() {
    ask("sequence", |shot, run| {
        let settings = shot.description().settings.clone();
        let error = shot.pack(&settings, &run.scratch.join("copy.blend"), run).unwrap_err();
        assert!(matches!(error, RendererError::NotPacked(_)) && error.is_permanent());
        assert!(
            error.to_string().contains("image sea (") && error.to_string().contains("sea-0001.png"),
            "{error}"
        );
    });
    ask("missing", |shot, run| {
        let settings = shot.description().settings.clone();
        let error = shot.pack(&settings, &run.scratch.join("copy.blend"), run).unwrap_err();
        assert!(matches!(error, RendererError::MissingAssets(_)), "{error}");
    });
}

#[test]
#[ignore = "tests/peers/blender.sh makes its files"]
fn caches_and_light_profiles_that_are_missing_are_named() {
    ask("caches", |shot, run| {
        let assets = &shot.description().assets;
        let found: Vec<_> = assets.iter().map(|a| (a.kind.as_str(), a.name.as_str(), a.state)).collect();
        let expected = [
            ("cache", "Cube", AssetState::Missing),
            ("cache", "Cube", AssetState::Present),
            ("light profile", "Shader Nodetree", AssetState::Missing),
        ];
        assert_eq!(found, expected);
        let error = shot.render(0, &shot.description().settings, &[], run).unwrap_err().to_string();
        assert!(error.contains("cube.pc2") && error.contains("lamp.ies"), "{error}");
    });
}

#[test]
#[ignore = "tests/peers/blender.sh makes its files"]
fn scripts_of_a_file_are_not_run_and_said() {
    ask("script", |shot, run| {
        assert!(
            shot.description().notes.iter().any(|note| note.contains("startup.py")),
            "{:?}",
            shot.description().notes
        );
        let mut settings = shot.description().settings.clone();
        settings.common.samples = 1;
        shot.render(1, &settings, &[], run).unwrap();
        assert!(!blends().join("script-was-run").exists());
    });
}

#[test]
#[ignore = "tests/peers/blender.sh makes its files"]
fn a_camera_that_does_not_exist_is_named() {
    ask("script", |shot, run| {
        let mut settings = shot.description().settings.clone();
        settings.own.insert("camera".to_owned(), "Elsewhere".into());
        let error = shot.preview(&[1], &settings, run).unwrap_err();
        let RendererError::Settings(error) = error else { panic!("{error}") };
        assert_eq!(error.path, "/own/camera");
        assert!(error.reason.contains("no camera Elsewhere; its cameras are: Camera"), "{error}");
    });
}

#[test]
#[ignore = "tests/peers/blender.sh makes its files"]
fn markers_choose_the_camera_unless_the_job_does() {
    ask("markers", |shot, run| {
        let mut settings = shot.description().settings.clone();
        assert_eq!((settings.common.width, settings.common.height), (896, 1008), "as Blender computes them");
        assert_eq!(settings.own.get("camera"), None);
        let mut shows_the_cube = |camera: Option<&str>| {
            settings.own.remove("camera");
            settings.own.extend(camera.map(|name| ("camera".to_owned(), name.into())));
            let seen = shot.preview(&[1, 2], &settings, run).unwrap();
            [&seen[0], &seen[1]].map(|frame| frame.counts.iter().any(|count| count.object.is_some()))
        };
        assert_eq!(shows_the_cube(None), [true, false]);
        assert_eq!(shows_the_cube(Some("Camera")), [true, true]);
        assert_eq!(shows_the_cube(Some("Away")), [false, false]);
        assert_eq!(shows_the_cube(None), [true, false]);
    });
}

#[test]
#[ignore = "tests/peers/blender.sh makes its files"]
fn files_that_are_none_are_refused() {
    let scratch = tempfile::tempdir().unwrap();
    with(scratch.path(), &AtomicBool::new(false), &|_| {}, |run| {
        let absent = CYCLES.open(Path::new("/nowhere/shot.blend"), run).err().unwrap();
        assert!(matches!(absent, RendererError::MissingFile(_)), "{absent}");
        let text = scratch.path().join("text.blend");
        std::fs::write(&text, "no scene").unwrap();
        let error = CYCLES.open(&text, run).err().unwrap();
        assert!(matches!(error, RendererError::Scene { .. }), "{error}");
        assert!(error.to_string().contains("text.blend"), "{error}");
        let error = CYCLES.open(&blends().join("stereo.blend"), run).err().unwrap();
        assert!(error.is_permanent() && error.to_string().contains("Stereoscopy"), "{error}");
    });
}
