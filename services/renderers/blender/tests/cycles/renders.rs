//! What renders cost, and that shares of them make one image.

use super::*;

#[test]
#[ignore = "tests/peers/blender.sh makes its files"]
fn merged_shares_are_the_image_of_one_render() {
    for name in names() {
        ask(&name, |shot, run| {
            let mut settings = shot.description().settings.clone();
            settings.common.samples = 16;
            if !CYCLES.capabilities().contains(&Capability::TakeOverSamples) {
                let measured =
                    shot.measure(3, &settings, &Part::Samples { offset: 1, count: 4 }, run).unwrap();
                let whole = shot.render(3, &settings, &[], run).unwrap();
                assert_eq!(measured.artefact, None);
                assert!(measured.cost.cpu_nanos < whole.cost.cpu_nanos / 2);
                return;
            }
            assert!(shot.capabilities(&settings).contains(&Capability::TakeOverSamples));
            let part = |offset, count| Part::Samples { offset, count };
            let measured: Vec<_> = [part(0, 1), part(1, 4)]
                .iter()
                .map(|p| shot.measure(3, &settings, p, run).unwrap())
                .collect();
            let artefacts: Vec<_> = measured.iter().filter_map(|m| m.artefact.clone()).collect();
            let merged = shot.render(3, &settings, &artefacts, run).unwrap();
            let merged_file = run.scratch.join("merged.exr");
            std::fs::rename(&merged.files[0], &merged_file).unwrap();
            let whole = shot.render(3, &settings, &[], run).unwrap();
            let (ours, theirs) = (channels(&merged_file), channels(&whole.files[0]));
            assert!(ours.keys().eq(theirs.keys()));
            let mut worst = 0.0f64;
            for (channel, theirs) in theirs.iter().filter(|(c, _)| !c.contains("Render Time")) {
                let mean = theirs.iter().map(|&v| f64::from(v.abs())).sum::<f64>() / theirs.len() as f64;
                let differences = ours[channel].iter().zip(theirs).map(|(&a, &b)| f64::from((a - b).abs()));
                let largest = differences.fold(0.0, f64::max);
                worst = worst.max(largest / mean.max(1e-12));
                assert!(largest <= 1e-5 * mean, "{name}, {channel}: {largest} of a mean of {mean}");
            }
            println!("{name}: largest difference {worst:.1e} of the mean");
            let (strata, blocks) = (!merged.strata.is_empty(), merged.blocks.is_some());
            assert_eq!((strata, blocks), (locates_costs(), locates_costs()));
            let gap = shot.render(3, &settings, &artefacts[1..], run).unwrap_err();
            assert!(matches!(gap, RendererError::Artefact { .. }), "{gap}");
            let other = shot.render(4, &settings, &artefacts, run).unwrap_err();
            assert!(other.to_string().contains("frame 3, not 4"), "{other}");
            let mut adaptive = settings;
            adaptive.own.insert("adaptive_sampling".to_owned(), true.into());
            assert!(!shot.capabilities(&adaptive).contains(&Capability::TakeOverSamples));
            assert_eq!(shot.measure(3, &adaptive, &part(0, 1), run).unwrap().artefact, None);
        });
    }
}

#[test]
#[ignore = "tests/peers/blender.sh makes its files"]
fn a_share_of_the_samples_says_what_is_fixed_and_where_time_goes() {
    for name in names() {
        ask(&name, |shot, run| {
            let settings = shot.description().settings.clone();
            let first = Part::Samples { offset: 0, count: 1 };
            let measured = shot.measure(0, &settings, &first, run).unwrap();
            let fixed: u64 = measured.fixed.values().sum();
            assert!(fixed > 0 && fixed < measured.cost.cpu_nanos, "{measured:?}");
            println!("{name}: fixed CPU ns: {:?}", measured.fixed);
            let size = (settings.common.width, settings.common.height);
            assert_eq!(measured.ids.as_ref().unwrap().dimensions(), size);
            for part in ["prepare", "scene", "tree", "pixels", "write"] {
                assert!(
                    measured.fixed.get(part).is_some_and(|&nanos| nanos > 0),
                    "{part}: {:?}",
                    measured.fixed
                );
            }
            let pixels: u64 = measured.strata.iter().map(|stratum| stratum.count.pixels).sum();
            assert_eq!(pixels, if locates_costs() { settings.pixels() } else { 0 });
            assert_eq!(measured.strata.len() > 3, locates_costs());
        });
    }
}

#[test]
#[ignore = "tests/peers/blender.sh makes its files"]
fn the_samples_at_which_pixels_stop_by_their_noise_are_known_from_few_of_them() {
    ask("counted", |shot, run| {
        let mut settings = shot.description().settings.clone();
        (settings.common.width, settings.common.height, settings.common.samples) = (128, 96, 256);
        settings.own.insert("adaptive_sampling".to_owned(), true.into());
        settings.own.insert("noise_threshold".to_owned(), 0.006.into());
        let measured = shot.measure(1, &settings, &Part::Samples { offset: 0, count: 1 }, run).unwrap();
        let stopping = measured.stopping.unwrap();
        let whole = shot.render(1, &settings, &[], run).unwrap();
        let image = channels(&whole.files[0]);
        let pass = |name: &str| image.iter().find_map(|(c, values)| c.contains(name).then_some(values));
        // Shares of the samples of the image. At this threshold, the first pixels stop after 80.
        let shares = pass("Debug Sample Count").unwrap();
        let first = shares.iter().copied().fold(f32::INFINITY, f32::min);
        let samples: Vec<f64> = shares.iter().map(|share| 80.0 * f64::from(share / first)).collect();
        let times: Vec<f64> = match pass("Render Time") {
            Some(times) => times.iter().copied().map(f64::from).collect(),
            None => samples.clone(),
        };
        let single: f64 = times.iter().zip(&samples).map(|(time, samples)| time / samples).sum();
        let truth = times.iter().sum::<f64>() / single;
        println!("{:.1} samples of a pixel, {truth:.1} in the image", stopping.samples);
        // Few pixels are noisy, in thin edges of shadows, so few of them are looked at. Times have noise, too.
        assert!((85.0..200.0).contains(&truth) && (stopping.samples / truth - 1.0).abs() < 0.25, "{truth}");
        assert!(stopping.cost.cpu_nanos > 0);
        // A later share does not look again.
        let later = shot.measure(1, &settings, &Part::Samples { offset: 1, count: 2 }, run).unwrap();
        assert_eq!(later.stopping, None);
    });
}

#[test]
#[ignore = "tests/peers/blender.sh makes its files"]
fn the_samples_of_all_view_layers_count() {
    ask("layers", |shot, run| {
        let mut settings = shot.description().settings.clone();
        (settings.common.width, settings.common.height) = (256, 256);
        settings.own.insert("adaptive_sampling".to_owned(), false.into());
        let samples = Part::Samples { offset: 0, count: 8 };
        let measured = shot.measure(0, &settings, &samples, run).unwrap();
        // Half of the samples would count as images, if one layer's time stood for both.
        let images = measured.fixed.get("images").copied().unwrap_or_default();
        assert!(images < measured.sample_nanos() / 3, "{measured:?}");
    });
}

#[test]
#[ignore = "tests/peers/blender.sh makes its files"]
fn measuring_writes_no_files_of_the_compositor() {
    ask("composited", |shot, run| {
        let written = || std::fs::read_dir(blends().join("written")).map_or(0, Iterator::count);
        let mut settings = shot.description().settings.clone();
        assert_eq!(settings.own["compositing"], true);
        (settings.common.width, settings.common.height, settings.common.samples) = (32, 32, 2);
        let region = Region { x: 0, y: 0, width: 8, height: 8 };
        for part in [Part::Samples { offset: 0, count: 1 }, Part::Regions(vec![region])] {
            shot.measure(0, &settings, &part, run).unwrap();
            assert_eq!(written(), 0, "{part:?}");
        }
        shot.render(0, &settings, &[], run).unwrap();
        assert_eq!(written(), 1, "a render writes what the file says");
    });
}

#[test]
#[ignore = "tests/peers/blender.sh makes its files"]
fn shadow_catchers_are_rendered_in_one_piece() {
    ask("catcher", |shot, run| {
        let mut settings = shot.description().settings.clone();
        settings.own.insert("adaptive_sampling".to_owned(), false.into());
        assert!(!shot.capabilities(&settings).contains(&Capability::TakeOverSamples));
        let part = Part::Samples { offset: 0, count: 1 };
        assert_eq!(shot.measure(0, &settings, &part, run).unwrap().artefact, None);
        settings.common.seed = u32::MAX;
        let error = shot.measure(0, &settings, &part, run).unwrap_err();
        assert!(matches!(&error, RendererError::Settings(error) if error.path == "/seed"), "{error}");
    });
}

#[test]
#[ignore = "tests/peers/blender.sh makes its files"]
fn a_cancelled_render_leaves_no_process_and_the_shot_goes_on() {
    let scratch = tempfile::tempdir().unwrap();
    let cancelled = AtomicBool::new(false);
    let name = names().remove(0);
    let shot = with(scratch.path(), &cancelled, &|_| {}, |run| {
        CYCLES.open(&blends().join(format!("{name}.blend")), run).unwrap()
    });
    assert_eq!(processes_of_ours(), 1);
    let mut settings = shot.description().settings.clone();
    settings.common.samples = 100_000;
    let stop = |_: f64| cancelled.store(true, Ordering::Relaxed);
    let error =
        with(scratch.path(), &cancelled, &stop, |run| shot.render(0, &settings, &[], run)).unwrap_err();
    assert!(matches!(error, RendererError::Cancelled), "{error}");
    assert_eq!(processes_of_ours(), 0);
    cancelled.store(false, Ordering::Relaxed);
    settings.common.samples = 1;
    with(scratch.path(), &cancelled, &|_| {}, |run| shot.render(0, &settings, &[], run)).unwrap();
    drop(shot);
    assert_eq!(processes_of_ours(), 0);
}
