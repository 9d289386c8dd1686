//! Which objects and materials the pixels of a frame show.

use super::*;

#[test]
#[ignore = "tests/peers/blender.sh makes its files"]
fn previews_count_pixels_and_regions_have_costs() {
    for name in names() {
        ask(&name, |shot, run| {
            let settings = shot.description().settings.clone();
            let frames = [0, 1, shot.description().frames.last];
            let counted = shot.preview(&frames, &settings, run).unwrap();
            assert!(counted.iter().map(|c| c.frame).eq(frames));
            for frame in &counted {
                assert_eq!(frame.counts.iter().map(|c| c.pixels).sum::<u64>(), settings.pixels());
                let objects = shot.description().objects.as_ref().unwrap().len();
                assert!(frame.counts.iter().filter_map(|c| c.object).all(|o| (o as usize) < objects));
                assert!(frame.counts.len() > 3);
            }
            assert_ne!(counted[0].counts, counted[2].counts, "the camera moves");
            let costs: Vec<String> =
                counted.iter().map(|c| format!("{:.3}", seconds(c.cost.cpu_nanos))).collect();
            println!("{name}: {} strata, previews of {} CPU s", counted[0].counts.len(), costs.join(", "));

            let mut settings = settings;
            settings.common.samples = 4;
            let regions: Vec<Region> =
                (0..4).map(|i| Region { x: 48 * (i % 2), y: 48 * (i / 2), width: 48, height: 48 }).collect();
            let parts = Part::Regions(regions.clone());
            let measured = shot.measure(0, &settings, &parts, run).unwrap();
            assert!(measured.pieces.iter().map(|p| p.region).eq(regions.iter().copied()));
            for part in ["prepare", "scene", "tree", "write"] {
                assert!(measured.fixed.contains_key(part), "{part}: {:?}", measured.fixed);
            }
            let sum: u64 = measured.pieces.iter().map(|p| p.cpu_nanos).sum();
            let whole = shot.render(0, &settings, &[], run).unwrap();
            let sampled = whole.cost.cpu_nanos - whole.fixed.values().sum::<u64>();
            println!("{name}: four quarters cost {:.2} of the frame", sum as f64 / sampled as f64);
            settings.own.insert("denoise".to_owned(), true.into());
            let denoised = shot.measure(0, &settings, &parts, run).unwrap();
            println!("{name}: denoising takes {:.3} CPU s", seconds(denoised.fixed["finish"]));
            assert!(denoised.fixed["finish"] > 10_000_000, "{:?}", denoised.fixed);
            let outside = Part::Regions(vec![Region { x: 90, y: 0, width: 8, height: 8 }]);
            assert!(matches!(shot.measure(0, &settings, &outside, run), Err(RendererError::Unsupported(_))));
        });
    }
}

/// Objects, materials and pixels of a preview.
type Counts = Vec<(Option<u32>, Option<u32>, u64)>;

/// Previews of some frames, and how they were made.
fn previews(shot: &dyn Shot, frames: &[i32], run: &Run<'_>) -> Vec<(PreviewBackend, Counts)> {
    let of_frame = |frame: FrameCounts| {
        let count = |c: PixelCount| (c.object, c.material, c.pixels);
        (frame.backend, frame.counts.into_iter().map(count).collect())
    };
    shot.preview(frames, &shot.description().settings, run).unwrap().into_iter().map(of_frame).collect()
}

/// Pixels by which two previews differ.
fn differences(one: &Counts, other: &Counts) -> u64 {
    let of = |counts: &Counts| -> BTreeMap<(Option<u32>, Option<u32>), u64> {
        counts.iter().map(|&(object, material, pixels)| ((object, material), pixels)).collect()
    };
    let (one, other) = (of(one), of(other));
    let strata: BTreeSet<_> = one.keys().chain(other.keys()).collect();
    let pixels = |counts: &BTreeMap<_, u64>, stratum| counts.get(stratum).copied().unwrap_or(0);
    strata.into_iter().map(|stratum| pixels(&one, stratum).abs_diff(pixels(&other, stratum))).sum()
}

#[test]
#[ignore = "tests/peers/blender.sh makes its files"]
fn what_changes_from_frame_to_frame_is_drawn_as_cycles_renders_it() {
    let frames = [0, 1, 2, 3, 4, 5];
    for name in names().into_iter().chain(["changing".to_owned()]) {
        let series = ask(&name, |shot, run| {
            let series = previews(shot, &frames, run);
            for frame in frames.into_iter().rev() {
                // Cycles renders a single frame.
                let (backend, rendered) = previews(shot, &[frame], run).remove(0);
                assert_eq!(backend, PreviewBackend::Renderer);
                let off = differences(&series[frame as usize].1, &rendered);
                assert!(off <= shot.description().settings.pixels() / 100, "{name}, {frame}: {off} pixels");
            }
            series
        });
        assert!(series.iter().all(|(backend, _)| *backend != PreviewBackend::Renderer), "{name} is drawn");
        assert!(series.windows(2).all(|pair| pair[0] != pair[1]), "{name} moves");
    }
}

#[test]
#[ignore = "tests/peers/blender.sh makes its files"]
fn cycles_renders_the_preview_of_what_triangles_do_not_show() {
    let by_cycles = |name: &str| {
        ask(name, |shot, run| {
            let found = previews(shot, &[0, 1, 2], run);
            assert!(found.iter().all(|(backend, _)| *backend == PreviewBackend::Renderer), "{name}");
            shot.description().notes.join("; ")
        })
    };
    let note = by_cycles("leaf");
    assert!(note.contains("material Material is transparent"), "{note}");
    // Nothing in the file says so, but Cycles shows something else.
    assert_eq!(by_cycles("clipped"), "");
    // Only the evaluated scene tells.
    assert_eq!(by_cycles("points"), "");
}
