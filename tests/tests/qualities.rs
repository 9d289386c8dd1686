//! A user picks a quality by its quoted cost, and gets it at that cost.

use forelight_protocol::{AccuracyDoc, AccuracyRung, FrameRow, LadderKind};
use forelight_tests::bundles::shipped;
use forelight_tests::processes::{Service, run, run_well};
use forelight_tests::waiting::eventually;
use serde_json::Value;
use std::time::Duration;

const PATIENCE: Duration = Duration::from_secs(240);

#[tokio::test(flavor = "multi_thread")]
async fn other_qualities_cost_what_the_quote_of_a_job_says_of_them() {
    let flags = ["--workers", "2", "--threads", "1", "--preview", "cpu"];
    let service = Service::start("farm", &flags).await;
    let (scene, data) = (shipped("kitchen").display().to_string(), service.data().display().to_string());
    let farm = ["--server", service.address(), "--data", &data];
    let shot = ["submit", &scene, "--frames", "0,20,40", "--width", "48"];
    let light = ["--ambient-bounces", "1", "--ambient-divisions", "8"];
    let submit = |more: &[&str]| run_well(&[&shot[..], &light, &farm, more].concat());

    let id = submit(&["--spp", "2", "--samples", "128", "--ladders"]).trim().to_owned();
    let ask = [&["accuracy", "--job", &id, "--json"][..], &farm].concat();
    eventually("the ladders of the job", PATIENCE, async || run(&ask).status.success().then_some(())).await;
    let document: AccuracyDoc = serde_json::from_str(&run_well(&ask)).expect("the ladders");
    assert!(document.missing.is_empty(), "{:?}", document.missing);
    let rung = |kind, spp| -> &AccuracyRung {
        let found = document.rungs.iter().find(|rung| rung.ladder == kind && rung.settings.spp == spp);
        found.unwrap_or_else(|| panic!("no {kind:?} of {spp}"))
    };
    let qualities = [
        (rung(LadderKind::Path, 4), &["--spp", "4", "--integrator", "path"][..]),
        (rung(LadderKind::CachedSamples, 4), &["--spp", "4", "--cache", "on", "--cache-sharing", "private"]),
        (rung(LadderKind::Ambient, 4), &["--spp", "4"]),
    ];
    for (quoted, settings) in qualities {
        let printed = submit(&[settings, &["--follow", "--json"]].concat());
        let printed: Value = serde_json::from_str(&printed).expect("JSON is printed and nothing else");
        let frames: Vec<FrameRow> = serde_json::from_value(printed["frames"].clone()).expect("frames");
        let work =
            frames.iter().map(|row| row.actual.as_ref().expect("what it took").work).sum::<u64>() as f64;
        let off = quoted.work.mean / work - 1.0;
        println!("{} of {}: {off:+.3}", quoted.ladder.name(), quoted.settings.spp);
        // 128 pixels of one frame represent three frames.
        assert!(off.abs() < 0.05, "{}: {work} for {:?}", quoted.ladder.name(), quoted.work);
    }
    let table = run_well(&[&["accuracy", "--job", &id][..], &farm].concat());
    assert!(table.contains("3 frames") && table.contains("integrator path"), "{table}");
}
