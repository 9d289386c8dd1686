//! `forelight accuracy` and `--cache-error` as a user runs them.

use forelight_protocol::{AccuracyDoc, LadderKind};
use std::process::{Command, Output};

const KITCHEN: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../deploy/scenes/kitchen");

fn accuracy(flags: &str) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_forelight"));
    command.args(["accuracy", KITCHEN, "--preview", "cpu", "--width", "16", "--samples", "16"]);
    command.args(["--spp", "2", "--ambient-bounces", "1", "--ambient-divisions", "4"]).args(flags.split(' '));
    command.output().unwrap()
}

#[test]
fn json_is_the_document_and_the_plot_is_well_formed_and_names_what_it_shows() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("accuracy.svg");
    let output = accuracy(&format!("--json --measure --reference-spp 4 --out {}", path.display()));
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let document: AccuracyDoc = serde_json::from_slice(&output.stdout).unwrap();
    for kind in LadderKind::ALL {
        assert!(document.rungs.iter().any(|rung| rung.ladder == kind), "{kind:?}");
    }
    assert!(document.rungs.iter().all(|rung| rung.measured.is_some() && rung.error.is_some()));
    assert_eq!(document.rungs.iter().filter(|rung| rung.asked_for).count(), 3, "on three ladders");
    assert!(document.rungs.iter().any(|rung| rung.worth_taking));
    for rung in document.rungs.iter().filter_map(|rung| rung.next) {
        assert!(rung.times_error < 1.0 && rung.more_cpu_seconds > 0.0);
    }

    let svg = std::fs::read_to_string(path).unwrap();
    let tree = roxmltree::Document::parse(&svg).unwrap();
    assert_eq!(tree.root_element().tag_name().name(), "svg");
    let texts: Vec<&str> = tree.descendants().filter_map(|node| node.text()).map(str::trim).collect();
    for wanted in ["ambient, by camera samples", "path, by camera samples", "measured", "256 spp"] {
        assert!(texts.contains(&wanted), "{wanted} is not among {texts:?}");
    }
    assert!(texts.iter().any(|text| text.contains("kitchen, frame 0, 16 x 9")), "{texts:?}");
    assert!(!svg.contains("NaN") && !svg.contains("inf"));
}

#[test]
fn the_table_has_every_ladder_and_says_what_the_next_step_costs() {
    let output = accuracy("--frame 1");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8(output.stdout).unwrap();
    for wanted in ["integrator ambient", "integrator path", "error 0.15", "256 rays", "32 x 18", "x the time"]
    {
        assert!(text.contains(wanted), "{wanted} is not in {text}");
    }
}

#[test]
fn wrong_input_is_named_and_nothing_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("accuracy.svg");
    let output = accuracy(&format!("--frame 4000 --out {}", path.display()));
    assert_eq!(output.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&output.stderr).contains("frame 4000"));
    assert!(!path.exists());
}

#[test]
fn a_bundle_or_a_job_is_named_and_not_both() {
    let run = |arguments: &[&str]| {
        let output =
            Command::new(env!("CARGO_BIN_EXE_forelight")).arg("accuracy").args(arguments).output().unwrap();
        assert_eq!(output.status.code(), Some(2));
        String::from_utf8(output.stderr).unwrap()
    };
    let job = "0197a8a5-0000-7000-8000-000000000000";
    assert!(run(&[]).contains("name a bundle, or a job by --job"));
    for other in [&[KITCHEN][..], &["--spp", "4"], &["--frame", "0"], &["--measure"], &["--threads", "1"]] {
        let error = run(&[&["--job", job][..], other].concat());
        assert!(error.contains("cannot be used with"), "{error}");
    }
}

#[test]
fn a_cache_for_an_error_comes_with_its_flags_and_one_that_cannot_be_is_wrong_input() {
    let run = |command: &str, flags: &str| {
        let mut program = Command::new(env!("CARGO_BIN_EXE_forelight"));
        program.args(command.split(' ')).args([KITCHEN, "--preview", "cpu", "--width", "32", "--spp", "1"]);
        let output = program.args(flags.split(' ')).output().unwrap();
        (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
    };
    let render = |flags: &str| run("render", flags);
    let (code, text) = render("--ambient-bounces 1 --cache-error 20");
    assert_eq!(code, Some(0), "{text}");
    let chosen = "--cache on --cache-accuracy 1 --cache-rays 48; forecast error";
    assert!(text.contains(chosen), "{text}");
    let folder = tempfile::tempdir().unwrap();
    let [planned, full] = ["planned", "full"].map(|name| folder.path().join(name).display().to_string());
    let (code, text) =
        run("cache plan", &format!("--frames 0 --ambient-bounces 1 --cache-error 20 --out {planned}"));
    assert!(code == Some(0) && text.contains(chosen), "{text}");
    let later = "--ambient-bounces 1 --cache-accuracy 1 --cache-rays 48 --cache-file";
    let (code, text) = run("cache fill", &format!("{later} {planned} --out {full}"));
    assert_eq!(code, Some(0), "the later steps take what was chosen: {text}");
    let (code, text) = render(&format!("{later} {full}"));
    assert_eq!(code, Some(0), "{text}");
    for (flags, reason) in [
        ("--ambient-bounces 1 --cache-error 0.001", "the best cache here is forecast to leave"),
        ("--ambient-bounces 0 --cache-error 1", "without ambient bounces"),
        ("--integrator path --cache-error 1", "does not use an irradiance cache"),
        ("--cache-rays 48 --cache-error 1", "cannot be used with"),
    ] {
        let (code, text) = render(flags);
        assert_eq!(code, Some(2), "{flags}: {text}");
        assert!(text.contains(reason), "{flags}: {text}");
    }
}
