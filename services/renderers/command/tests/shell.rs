//! The four questions, to a shell script that writes its arguments into its image.

use forelight_renderer::door::{
    Capability, Description, Limits, Part, Region, Renderer as _, RendererError, Run, Settings, Shot,
};
use forelight_renderer_command::open_command;
use serde_json::json;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

#[path = "shell/scripts.rs"]
mod scripts;

const SCRIPT: &str = r#"
echo "done 25 %"
echo "done 100 %"
case $1 in
  missing) echo "cannot open texture wood.png" >&2; exit 3;;
  crash) echo "some trouble" >&2; exit 4;;
  silent) exit 0;;
  slow) sleep 60;;
esac
i=0
while [ $i -lt 20000 ]; do i=$((i + 1)); done
out=$2
shift 2
{ printf '%s\n' "$@"; echo "$GREETING"; pwd; echo "home $HOME"; } >"$out"
"#;

const FILE: &str = r#"
name = "script"
version_command = ["sh", "-c", "echo This is script 1.2"]
version_pattern = 'script (\S+)'
arguments = ["sh", "{folder}/script.sh", "{mode}", "{out}", "{scene}", "{frame:03}", "{width}x{height}", "{samples}",
             "{crop}", "{crop_width}", "{seed}", "{threads}", "{depth}", "{{{fast}}}"]
scene = "scene.txt"
output = "image-{frame:04}.txt"
can = ["samples", "size", "crop"]

[frames]
first = 3
last = 9
step = 2

[defaults]
width = 80
height = 40
samples = 16
seed = 7

[crop]
first = 1
inclusive = true

[environment]
GREETING = "hello {frame}"

[parameters.mode]
type = "string"
default = "good"

[parameters.depth]
type = "integer"
default = 3
minimum = 1
description = "Bounces."

[parameters.fast]
type = "boolean"
default = true

[progress]
pattern = '(\d+) %'
unit = "percent"

[[errors]]
pattern = "cannot open texture"
means = "missing_file"

[limits]
seconds = 2
"#;

/// The same program as a step of a job for other farms.
const JOB: &str = r#"
specificationVersion: jobtemplate-2023-09
name: "{{Param.Name}}"
parameterDefinitions:
  - {name: Name, type: STRING, default: a shot}
  - {name: Frames, type: STRING, default: "3-9:2"}
  - {name: Scene, type: PATH, objectType: FILE, dataFlow: IN}
  - {name: Out, type: PATH}
  - {name: Samples, type: INT, default: 16}
  - {name: Script, type: PATH, default: script.sh}
  - {name: Depth, type: INT, default: 5}
jobEnvironments:
  - {name: Greeting, variables: {GREETING: "hello {{Param.Name}}"}}
steps:
  - name: Check
    script: {actions: {onRun: {command: "true"}}}
  - name: Render
    parameterSpace:
      taskParameterDefinitions:
        - {name: Frame, type: INT, range: "{{Param.Frames}}"}
    script:
      actions:
        onRun:
          command: "{{Task.File.Run}}"
          args: ["good", "{{Param.Out}}", "{{Task.Param.Frame}}"]
          timeout: 2
      embeddedFiles:
        - name: Run
          type: TEXT
          filename: run.sh
          runnable: true
          data: |
            #!/bin/sh
            exec sh "{{Param.Script}}" "$@" "{{Param.Scene}}" {{RawParam.Samples}} "{{Param.Depth}}" {braces}
"#;

const FILE_OF_JOB: &str = r#"
name = "script"
version = "1.2"
scene = "scene.txt"
output = "image-{frame:04}.txt"
can = ["samples"]

[openjd]
template = "shot.job.yaml"

[openjd.parameters]
Scene = "{scene}"
Out = "{out}"
Samples = "{samples}"

[defaults]
width = 80
height = 40
samples = 16
"#;

struct World {
    folder: tempfile::TempDir,
}

impl World {
    fn new(file: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        for (name, text) in [
            ("script.sh", SCRIPT),
            ("scene.txt", "a scene"),
            ("shot.command.toml", file),
            ("shot.job.yaml", JOB),
        ] {
            std::fs::write(folder.path().join(name), text).unwrap();
        }
        std::fs::create_dir(folder.path().join("scratch")).unwrap();
        Self { folder }
    }

    fn file(&self) -> PathBuf {
        self.folder.path().join("shot.command.toml")
    }

    fn write_job(&self, job: &str) {
        std::fs::write(self.folder.path().join("shot.job.yaml"), job).unwrap();
    }

    fn ask<T>(&self, question: impl FnOnce(&dyn Shot, &Run<'_>) -> T) -> T {
        let (cancelled, scratch) = (AtomicBool::new(false), self.folder.path().join("scratch"));
        let limits = Limits { grace: Duration::from_millis(100), threads: 2, ..Limits::default() };
        let run = Run::silent(&cancelled, &scratch, limits);
        let renderer = open_command(&self.file()).unwrap();
        question(&*renderer.open(&self.file(), &run).unwrap(), &run)
    }

    fn error(file: &str) -> String {
        open_command(&Self::new(file).file()).unwrap_err().to_string()
    }

    fn left(&self) -> Vec<String> {
        let entries = std::fs::read_dir(self.folder.path().join("scratch")).unwrap();
        entries.map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned()).collect()
    }
}

fn with(shot: &dyn Shot, name: &str, value: serde_json::Value) -> Settings {
    let mut settings = shot.description().settings.clone();
    settings.own.insert(name.to_owned(), value);
    settings
}

#[test]
fn the_file_describes_renderer_and_shot() {
    let world = World::new(FILE);
    let renderer = open_command(&world.file()).unwrap();
    assert_eq!(renderer.id().to_string(), "script 1.2");
    let schema = renderer.settings_schema();
    let depth = json!({"type": "integer", "default": 3, "minimum": 1.0, "description": "Bounces."});
    assert_eq!(schema["properties"]["depth"], depth);
    world.ask(|shot, _| {
        let found = shot.description();
        assert_eq!(found.frames.numbers().collect::<Vec<_>>(), [3, 5, 7, 9]);
        assert_eq!(found.settings.own["fast"], true);
        let all = [Capability::MeasureSamples, Capability::MeasureRegions, Capability::Resize];
        assert!(shot.capabilities(&found.settings).iter().eq(&all));
    });
}

#[test]
fn a_frame_is_rendered_with_its_arguments_in_an_environment_of_its_own() {
    let world = World::new(FILE);
    let progress = Mutex::new(Vec::new());
    world.ask(|shot, run| {
        let settings = with(shot, "depth", 5.into());
        let tell = |share| progress.lock().unwrap().push(share);
        let rendered = shot.render(7, &settings, &[], &Run { progress: &tell, ..*run }).unwrap();
        assert!(rendered.files[0].ends_with("scratch/image-0007.txt"));
        assert!(rendered.cost.cpu_nanos > 0 && rendered.cost.wall_nanos > 0);
        let text = std::fs::read_to_string(&rendered.files[0]).unwrap();
        let lines: Vec<&str> = text.lines().collect();
        assert!(lines[0].ends_with("/scene.txt") && lines[0].starts_with('/'), "{text}");
        let expected = ["007", "80x40", "16", "1,1,80,40", "80", "7", "2", "5", "{true}", "hello 7"];
        assert_eq!(lines[1..11], expected);
        assert!(
            lines[11].contains("/scratch/command-") && lines[12] == format!("home {}", lines[11]),
            "{text}"
        );
    });
    assert_eq!(*progress.lock().unwrap(), [0.25, 1.0]);
    assert_eq!(world.left(), ["image-0007.txt"]);
}

#[test]
fn parts_are_measured_and_leave_nothing_behind() {
    let world = World::new(FILE);
    world.ask(|shot, run| {
        let settings = shot.description().settings.clone();
        let samples = Part::Samples { offset: 1, count: 4 };
        let measured = shot.measure(3, &settings, &samples, run).unwrap();
        assert!(measured.cost.cpu_nanos > 0 && measured.artefact.is_none() && measured.pieces.is_empty());
        let regions =
            [Region { x: 0, y: 8, width: 16, height: 8 }, Region { x: 64, y: 0, width: 16, height: 8 }];
        let measured = shot.measure(3, &settings, &Part::Regions(regions.to_vec()), run).unwrap();
        assert!(measured.pieces.iter().map(|piece| piece.region).eq(regions));
        let sum: u64 = measured.pieces.iter().map(|piece| piece.cpu_nanos).sum();
        assert_eq!(sum, measured.cost.cpu_nanos);
        let counts = shot.preview(&[3, 5], &settings, run).unwrap();
        assert_eq!((counts.len(), counts[0].counts[0].pixels), (2, 3200));
        for (part, reason) in [
            (Part::Samples { offset: 10, count: 7 }, "samples 10 to 17 of 16"),
            (Part::Pixels(vec![1]), "single pixels"),
            (Part::Regions(vec![Region { x: 70, y: 0, width: 16, height: 8 }]), "(70, 0)"),
        ] {
            let error = shot.measure(3, &settings, &part, run).unwrap_err();
            assert!(matches!(error, RendererError::Unsupported(_)), "{error}");
            assert!(error.to_string().contains(reason), "{error}");
        }
    });
    assert!(world.left().is_empty(), "{:?}", world.left());
}

#[test]
fn what_went_wrong_is_told_by_known_messages_limits_and_missing_images() {
    let world = World::new(FILE);
    world.ask(|shot, run| {
        let error = |mode: &str| shot.render(3, &with(shot, "mode", mode.into()), &[], run).unwrap_err();
        let missing = error("missing");
        assert!(
            matches!(&missing, RendererError::MissingFile(line) if line == "cannot open texture wood.png")
        );
        let crash = error("crash").to_string();
        assert!(crash.contains("sh ended with exit code 4") && crash.contains("some trouble"), "{crash}");
        let silent = error("silent").to_string();
        assert!(silent.contains("did not write") && silent.contains("image-0003.txt"), "{silent}");
        assert!(matches!(error("slow"), RendererError::TimeLimit(limit) if limit == Duration::from_secs(2)));
        let wrong = shot.render(3, &with(shot, "depth", 0.into()), &[], run).unwrap_err();
        assert!(wrong.to_string().starts_with("setting /own/depth"), "{wrong}");
    });
    assert!(world.left().is_empty(), "{:?}", world.left());
}

#[test]
fn what_the_command_cannot_change_is_refused() {
    let world = World::new(&FILE.replace(r#"can = ["samples", "size", "crop"]"#, "can = []"));
    world.ask(|shot, run| {
        let mut settings = shot.description().settings.clone();
        assert!(shot.capabilities(&settings).is_empty());
        // A whole frame can always be measured.
        shot.measure(3, &settings, &Part::Samples { offset: 0, count: 16 }, run).unwrap();
        let fewer = shot.measure(3, &settings, &Part::Samples { offset: 0, count: 8 }, run).unwrap_err();
        assert!(fewer.to_string().contains("cannot render fewer samples"), "{fewer}");
        let region = Region { x: 0, y: 0, width: 8, height: 8 };
        assert!(shot.measure(3, &settings, &Part::Regions(vec![region]), run).is_err());
        settings.common.samples = 8;
        let samples = shot.render(3, &settings, &[], run).unwrap_err();
        assert_eq!(samples.to_string(), "setting /samples: script always renders with 16");
    });
}

#[test]
fn mistakes_in_the_file_are_named_with_their_place() {
    for (from, to, place, reason) in [
        ("{frame:03}", "{frmae}", "line 5, column 72", "unknown placeholder `{frmae}`"),
        ("GREETING = \"hello {frame}\"", "GREETING = \"{out\"", "line 27, column 12", "`{` without `}`"),
        ("scene = \"scene.txt\"\n", "", "shot.command.toml: missing", "missing field `scene`"),
        ("first = 3\n", "", "line 11", "missing field `first`"),
        ("step = 2", "stride = 2", "line 14", "unknown field `stride`"),
        ("\"samples\", \"size\"", "\"speed\"", "line 9", "unknown variant `speed`"),
        (r"'(\d+) %'", r"'(\d+ %'", "line 44, column 11", "unclosed group"),
        (r"'(\d+) %'", r"'\d+ %'", "progress.pattern", "one group"),
        ("\"{samples}\",", "", "can", "`{samples}`"),
        ("\"{out}\",", "", "arguments", "`{out}`"),
        ("[\"sh\", \"{folder}", "[\"{mode}\", \"{folder}", "line 5, column 14", "fixed text"),
        ("name = \"script\"", "name = ", "line 2", "invalid string"),
        ("minimum = 1", "minimum = 4", "defaults", "setting /own/depth"),
        ("[parameters.depth]", "[parameters.seed]", "parameters.seed", "placeholder already"),
        ("echo This is script", "echo This is nothing", "version_command", "no version"),
    ] {
        assert!(FILE.contains(from), "{from}");
        let error = World::error(&FILE.replace(from, to));
        assert!(error.contains("shot.command.toml"), "{error}");
        assert!(error.contains(place) && error.contains(reason) && !error.contains('\n'), "{to}: {error}");
    }
    let at = FILE.find("arguments").unwrap();
    let end = FILE.find("scene = ").unwrap();
    let line = format!("{}arguments = \"sh script.sh\"\n{}", &FILE[..at], &FILE[end..]);
    let error = World::error(&line);
    assert!(error.contains("line 5, column 13") && error.contains("a list with the program"), "{error}");
}

#[test]
fn programs_and_scenes_that_are_not_there_are_named() {
    let error = World::error(&FILE.replace("[\"sh\", \"{folder}", "[\"no-such-renderer\", \"{folder}"));
    assert!(
        error.starts_with("no script on this machine") && error.contains("`no-such-renderer` in PATH"),
        "{error}"
    );
    let error = World::error(&FILE.replace("[\"sh\", \"{folder}", "[\"./bin/render\", \"{folder}"));
    assert!(error.contains("bin/render is no file"), "{error}");
    let world = World::new(FILE);
    std::fs::remove_file(world.folder.path().join("scene.txt")).unwrap();
    let cancelled = AtomicBool::new(false);
    let run = Run::silent(&cancelled, world.folder.path(), Limits::default());
    let error = open_command(&world.file()).unwrap().open(&world.file(), &run).err().unwrap();
    assert!(matches!(&error, RendererError::MissingFile(path) if path.ends_with("/scene.txt")), "{error}");
}

#[test]
fn a_job_of_other_farms_is_a_renderer_with_the_same_arguments() {
    let world = World::new(FILE_OF_JOB);
    world.ask(|shot, run| {
        let Description { frames, settings, .. } = shot.description();
        assert_eq!((frames.first, frames.last, frames.step), (3, 9, 2), "as the template says");
        let rendered = shot.render(5, settings, &[], run).unwrap();
        let said = std::fs::read_to_string(&rendered.files[0]).unwrap();
        let scene = world.folder.path().join("scene.txt");
        let expected = format!("5\n{}\n16\n5\n{{braces}}\nhello a shot\n", scene.display());
        assert!(said.starts_with(&expected), "{said}");
        let fewer = shot.measure(3, settings, &Part::Samples { offset: 0, count: 4 }, run).unwrap();
        assert!(fewer.cost.cpu_nanos > 0);
    });
    assert!(world.left().iter().all(|name| name.ends_with(".txt")), "{:?}", world.left());
}

#[test]
fn frames_that_the_file_does_not_have_are_refused() {
    let world = World::new(FILE);
    world.ask(|shot, run| {
        let settings = shot.description().settings.clone();
        let whole = Part::Samples { offset: 0, count: 16 };
        for frame in [1, 4, 11, -1, i32::MIN] {
            for error in [
                shot.preview(&[3, frame], &settings, run).err().unwrap(),
                shot.measure(frame, &settings, &whole, run).err().unwrap(),
                shot.render(frame, &settings, &[], run).err().unwrap(),
            ] {
                let said =
                    format!("frame {frame} is outside of the shot, which has frames 3 to 9 in steps of 2");
                assert_eq!(error.to_string(), said);
                assert!(error.is_permanent());
            }
        }
        assert!(shot.preview(&[3, 5, 7, 9], &settings, run).is_ok());
    });
    let every = World::new(&FILE.replace("first = 3\nlast = 9\nstep = 2", "first = 1\nlast = 24"));
    every.ask(|shot, run| {
        let error = shot.preview(&[30], &shot.description().settings, run).unwrap_err().to_string();
        assert_eq!(error, "frame 30 is outside of the shot, which has frames 1 to 24");
    });
    // A farm replaces the frames that a template has by itself.
    World::new(FILE_OF_JOB).ask(|shot, run| {
        assert!(shot.preview(&[30], &shot.description().settings, run).is_ok());
    });
}

#[test]
fn another_scene_that_a_job_names_has_frames_of_its_own() {
    let world = World::new(FILE);
    let other = world.folder.path().join("other.txt");
    std::fs::write(&other, "another scene").unwrap();
    let cancelled = AtomicBool::new(false);
    let run = Run::silent(&cancelled, world.folder.path(), Limits::default());
    let renderer = open_command(&world.file()).unwrap();
    let has_frame_30 = |scene: &Path| {
        let shot = renderer.open(scene, &run).unwrap();
        shot.preview(&[30], &shot.description().settings, &run).is_ok()
    };
    assert!(has_frame_30(&other));
    assert!(!has_frame_30(&world.folder.path().join("scene.txt")));
}

#[test]
fn a_chunk_is_a_range_of_one_frame_and_a_set_path_is_from_the_files_folder_on() {
    let world = World::new(
        &FILE_OF_JOB.replace("[openjd.parameters]", "[openjd.parameters]\nScript = \"script.sh\""),
    );
    let job = JOB.replace("type: INT, range: \"{{Param.Frames}}\"", "type: \"CHUNK[INT]\", range: \"-2-4\"");
    let job = job
        .replace("default: script.sh", "default: \"\"")
        .replace("jobEnvironments", "extensions: [TASK_CHUNKING]\njobEnvironments");
    world.write_job(&job);
    world.ask(|shot, run| {
        let Description { frames, settings, .. } = shot.description();
        assert_eq!((frames.first, frames.last), (-2, 4));
        let rendered = shot.render(3, settings, &[], run).unwrap();
        assert!(std::fs::read_to_string(&rendered.files[0]).unwrap().starts_with("3-3\n"));
    });
}

#[test]
fn what_only_a_farm_can_do_is_refused_by_name() {
    let with = |from: &str, to: &str, file: &str| {
        let world = World::new(file);
        assert!(JOB.contains(from), "{from}");
        world.write_job(&JOB.replacen(from, to, 1));
        open_command(&world.file()).unwrap_err().to_string()
    };
    for (from, to, reason) in [
        ("jobtemplate-2023-09", "jobtemplate-2030-01", "jobtemplate-2023-09 is known"),
        ("type: INT, range", "type: STRING, range", "frames are INT"),
        ("variables: {GREETING", "script: {}, variables: {GREETING", "environment Greeting has actions"),
        ("{{Task.Param.Frame}}", "{{Task.Param.Part}}", "{{Task.Param.Part}} is not known"),
        ("type: INT, default: 5", "type: INT", "parameter Depth has no default"),
        ("filename: run.sh", "filename: ../run.sh", "not the name of a file"),
        (
            "    parameterSpace:",
            "    dependencies: [{dependsOn: Check}]\n    parameterSpace:",
            "depends on Check",
        ),
        ("jobEnvironments:", "extensions: [EXPR]\njobEnvironments:", "needs the extension EXPR"),
        ("timeout: 2", "timeout: \"{{Param.Name}}\"", "is not a number of seconds"),
        ("range: \"{{Param.Frames}}\"", "range: [1, 5, 6]", "no range such as 1-24"),
        ("steps:", "steps: 7 #", "invalid type"),
    ] {
        let error = with(from, to, FILE_OF_JOB);
        assert!(error.contains(reason), "{error}");
    }
    let unknown = FILE_OF_JOB.replace("Scene = ", "Scenery = ");
    assert!(with("steps:", "steps:", &unknown).contains("no parameter Scenery"));
    let other = FILE_OF_JOB.replace("template =", "step = \"Check\"\ntemplate =");
    assert!(with("steps:", "steps:", &other).contains("step Check has 0 task parameters"));
    let free = FILE_OF_JOB.replace("[openjd.parameters]", "[openjd.parameters]\nDepth = \"{mode}\"")
        + "\n[parameters.mode]\ntype = \"string\"\ndefault = \"good\"\n";
    let error = with("steps:", "steps:", &free);
    assert!(error.contains("the embedded file Run contains `{mode}`, any text of a job"), "{error}");
    let chosen = free + "choices = [\"good\", \"better\"]\n";
    assert!(open_command(&World::new(&chosen).file()).is_ok());
    let missing = FILE_OF_JOB.replace("shot.job.yaml", "none.yaml");
    assert!(with("steps:", "steps:", &missing).contains("none.yaml"));
    let placeholder = FILE_OF_JOB.replace("{samples}", "{sample}");
    assert!(with("steps:", "steps:", &placeholder).contains("unknown placeholder `{sample}`"));
}
