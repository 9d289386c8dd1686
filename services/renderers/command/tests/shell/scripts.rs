//! Texts of a job that a shell would run.

use super::{FILE, FILE_OF_JOB, JOB, World, with};
use forelight_renderer::door::{Part, RendererError};
use forelight_renderer_command::open_command;

#[test]
fn a_script_gets_no_path_that_it_would_run() {
    let world = World::new(&FILE_OF_JOB.replace("scene.txt", "scene $(touch x).txt"));
    std::fs::write(world.folder.path().join("scene $(touch x).txt"), "a scene").unwrap();
    let error = world.ask(|shot, run| {
        let settings = shot.description().settings.clone();
        shot.render(3, &settings, &[], run).unwrap_err().to_string()
    });
    assert!(error.contains("the path may have ASCII letters"), "{error}");
}

#[test]
fn the_name_of_an_image_has_no_text_that_a_script_would_run() {
    let file = FILE_OF_JOB.replace("image-{frame:04}.txt", "{camera}-{mode}-{frame:04}.txt")
        + "\n[parameters.camera]\ntype = \"string\"\ndefault = \"left\"\n"
        + "[parameters.mode]\ntype = \"string\"\ndefault = \"a b\"\nchoices = [\"a b\"]\n";
    let world = World::new(&file);
    world.write_job(&JOB.replace("exec sh", ": {{Param.Out}}\n            exec sh"));
    let made = world.folder.path().join("made");
    world.ask(|shot, run| {
        let odd = [format!("x$(id>{})", made.display()), "x`id`".into(), "a b".into(), "a;b".into()];
        for camera in odd {
            let settings = with(shot, "camera", camera.into());
            assert_eq!(shot.image_extensions(&settings), ["txt"]);
            let fewer = Part::Samples { offset: 0, count: 4 };
            for error in [
                shot.measure(3, &settings, &fewer, run).err().unwrap(),
                shot.render(3, &settings, &[], run).err().unwrap(),
            ] {
                let said =
                    "setting /own/camera: it is part of the image's name, which a script takes: it may have ASCII";
                assert!(error.is_permanent() && error.to_string().starts_with(said), "{error}");
            }
        }
        // Choices are texts of the file, not of a job.
        let rendered = shot.render(3, &with(shot, "camera", "cam_2.b".into()), &[], run).unwrap();
        assert!(rendered.files[0].ends_with("cam_2.b-a b-0003.txt"));
    });
    assert!(!made.exists());
}

#[test]
fn the_script_of_a_shell_takes_no_text_of_a_job() {
    let start = |arguments: &str| {
        let (before, rest) = FILE.split_once("arguments = ").unwrap();
        let (_, after) = rest.split_once("scene = ").unwrap();
        let file = format!("{before}arguments = {arguments}\nscene = {after}");
        file.replace(r#"can = ["samples", "size", "crop"]"#, "can = []")
    };
    for arguments in [
        r#"["sh", "-c", "cat {scene} {mode} >{out}"]"#,
        r#"["/bin/sh", "-ec", "cat {scene} {mode} >{out}", "x", "{scene}"]"#,
        r#"["env", "bash", "-euo", "pipefail", "-c", "cat {scene} {mode} >{out}"]"#,
    ] {
        let error = World::error(&start(arguments));
        assert!(error.contains("arguments: the argument after -c of "), "{error}");
        assert!(error.contains("sh contains `{mode}`, any text of a job"), "{error}");
    }
    let rendered = |file: &str, scene: &str| -> Result<String, RendererError> {
        let world = World::new(&file.replace("scene.txt", scene));
        std::fs::write(world.folder.path().join(scene), "a scene").unwrap();
        let files = world.ask(|shot, run| {
            shot.render(3, &shot.description().settings, &[], run).map(|rendered| rendered.files)
        })?;
        Ok(std::fs::read_to_string(&files[0]).unwrap())
    };
    let odd = "scene $(touch x).txt";
    let inside = start(r#"["sh", "-c", "cat {scene} >{out}; : {depth}"]"#);
    assert_eq!(rendered(&inside, "scene.txt").unwrap(), "a scene");
    let error = rendered(&inside, odd).unwrap_err();
    let said = "script takes the path of the scene into the argument after -c of sh: the path may have ASCII letters";
    assert!(error.is_permanent() && error.to_string().starts_with(said), "{error}");
    // What comes after the script are its parameters.
    let after = start(r#"["sh", "-c", 'cat "$1" >"$2"', "x", "{scene}", "{out}", "{mode}"]"#);
    assert_eq!(rendered(&after, odd).unwrap(), "a scene");
}

#[test]
fn the_shell_of_a_job_of_other_farms_takes_no_text_of_a_job() {
    let (before, rest) = JOB.split_once("command: \"{{Task.File.Run}}\"").unwrap();
    let (_, after) = rest.split_once("timeout: 2").unwrap();
    let script = |text: &str| format!("{before}command: bash\n          args: [\"-c\", {text:?}]{after}");
    let job = script("cat {{Param.Scene}} >{{Param.Out}}; : {{RawParam.Samples}}")
        .replace("\"{{Param.Scene}}\" ", "");
    let render = |scene: &str| {
        let world = World::new(&FILE_OF_JOB.replace("scene.txt", scene));
        world.write_job(&job);
        std::fs::write(world.folder.path().join(scene), "a scene").unwrap();
        world.ask(|shot, run| shot.render(3, &shot.description().settings, &[], run).map(drop))
    };
    render("scene.txt").unwrap();
    let error = render("scene$(touch x).txt").unwrap_err().to_string();
    assert!(error.contains("into the argument after -c of bash: the path may have"), "{error}");
    let free = FILE_OF_JOB.replace("[openjd.parameters]", "[openjd.parameters]\nName = \"{mode}\"")
        + "\n[parameters.mode]\ntype = \"string\"\ndefault = \"good\"\n";
    let world = World::new(&free);
    world.write_job(&script("echo {{Param.Name}} {{RawParam.Samples}} >{{Param.Out}}"));
    let error = open_command(&world.file()).unwrap_err().to_string();
    assert!(error.contains("openjd: the argument after -c of bash contains `{mode}`"), "{error}");
}
