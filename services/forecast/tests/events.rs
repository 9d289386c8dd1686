//! Shots with events: cuts, brief appearances, moving things and lights. Each forecast from five frames is
//! compared with the mean of the first, middle and last frame.

mod common;

use std::collections::BTreeSet;

use common::{Stream, cost_of, profile_of};
use forelight_forecast::{
    Calibration, FIRST_FRAMES, FrameDesign, FramePopulation, MOST_FRAMES, Observation, ProfiledFrame,
    ShotForecast, Stratum, choose_frames, choose_more_frames, forecast_shot,
};

/// Edge of the image, pixels.
const SIDE: u32 = 32;

/// A shot whose objects each have, in every frame, a share of the picture and a cost.
struct Shot {
    strata: Vec<Stratum>,
    frames: Vec<FramePopulation>,
    /// Works by frame and pixel, objects one after the other.
    works: Vec<Vec<f64>>,
}

impl Shot {
    /// `look(object, frame)`: the object's relative part of the picture, and the mean work of its pixels.
    fn new(objects: u32, frames: i64, seed: u64, look: impl Fn(u32, i64) -> (f64, f64)) -> Self {
        let pixels = SIDE * SIDE;
        let mut noise = Stream::new(seed);
        let strata = (0..objects)
            .map(|i| Stratum { object: i, material: i % 7, prior_cost: 1.0, apart: false })
            .collect();
        let mut all = Vec::new();
        let mut works = Vec::new();
        for number in 0..frames {
            let looks: Vec<(f64, f64)> = (0..objects).map(|h| look(h, number)).collect();
            let whole: f64 = looks.iter().map(|(part, _)| part).sum();
            let (mut counts, mut reached, mut taken) = (Vec::new(), 0.0, 0);
            for (part, _) in &looks {
                reached += part / whole * f64::from(pixels);
                let until = (reached.round() as u32).min(pixels);
                counts.push(until - taken);
                taken = until;
            }
            *counts.last_mut().expect("objects") += pixels - taken;
            let pixel_works =
                counts.iter().zip(&looks).flat_map(|(&count, &(_, mean))| vec![mean; count as usize]);
            works.push(pixel_works.map(|mean| mean * (0.33 * noise.normal() - 0.054).exp()).collect());
            all.push(FramePopulation { number, counts, lights: 0, shining: 0, triangles: 0 });
        }
        Shot { strata, frames: all, works }
    }

    /// The same shot with the knowledge of which lights shine in each frame.
    fn lit_by(mut self, lights: impl Fn(i64) -> u32) -> Shot {
        self.frames.iter_mut().for_each(|frame| frame.lights = lights(frame.number));
        self
    }

    fn truth(&self) -> Vec<f64> {
        self.works.iter().map(|works| works.iter().map(|work| cost_of(*work).work as f64).sum()).collect()
    }

    fn observe(&self, t: usize, samples: u32, seed: u64) -> Vec<Observation> {
        let counts = &self.frames[t].counts;
        let ids: Vec<u32> = counts.iter().zip(0..).flat_map(|(&count, h)| vec![h; count as usize]).collect();
        let design =
            FrameDesign::new(&self.strata, &ids, SIDE, samples, seed, t as i64).expect("a good image");
        let observe = |picks: Vec<forelight_forecast::Pick>| -> Vec<Observation> {
            let one = |p: &forelight_forecast::Pick| Observation {
                stratum: p.stratum,
                cost: cost_of(self.works[t][p.pixel as usize]),
            };
            picks.iter().map(one).collect()
        };
        let mut observations = observe(design.first_phase());
        observations.extend(observe(design.second_phase(&observations).expect("its own observations")));
        observations
    }

    /// The frames' forecasts from five of them.
    fn forecast(&self, seed: u64) -> (Vec<usize>, Vec<f64>) {
        let chosen = choose_frames(&self.strata, &self.frames, FIRST_FRAMES).expect("good frames");
        let found = self.forecast_from(&chosen, seed);
        (chosen, found.frames.iter().map(|frame| frame.total.work.mean).collect())
    }

    fn forecast_from(&self, chosen: &[usize], seed: u64) -> ShotForecast {
        let observed: Vec<Vec<Observation>> = chosen.iter().map(|&t| self.observe(t, 256, seed)).collect();
        let profiled: Vec<ProfiledFrame<'_>> = chosen
            .iter()
            .zip(&observed)
            .map(|(&frame, observations)| profile_of(frame, observations))
            .collect();
        forecast_shot(&self.strata, &self.frames, &profiled, Calibration::NONE).expect("a forecast")
    }

    fn more(&self, found: &ShotForecast, spent: f64) -> Vec<usize> {
        let spent = (spent * found.total.work.mean) as u64;
        choose_more_frames(&self.strata, &self.frames, found, spent).expect("good frames")
    }
}

/// Mean errors over many shots: of all work, of frames, and of the mean of first, middle and last frame.
struct Errors {
    total: f64,
    frame: f64,
    practice: f64,
}

fn errors(shots: u64, shot: impl Fn(u64, &mut Stream) -> Shot) -> Errors {
    let mut sums = Errors { total: 0.0, frame: 0.0, practice: 0.0 };
    for seed in 0..shots {
        let shot = shot(seed, &mut Stream::new(seed + 1000));
        let truth = shot.truth();
        let (_, said) = shot.forecast(seed);
        let all: f64 = truth.iter().sum();
        let last = truth.len() - 1;
        let practice = (truth[0] + truth[last / 2] + truth[last]) / 3.0 * truth.len() as f64;
        sums.total += (said.iter().sum::<f64>() / all - 1.0).abs();
        sums.frame += said.iter().zip(&truth).map(|(said, is)| (said - is).abs()).sum::<f64>() / all;
        sums.practice += (practice / all - 1.0).abs();
    }
    let mean = |sum: f64| sum / shots as f64;
    let found = Errors { total: mean(sums.total), frame: mean(sums.frame), practice: mean(sums.practice) };
    println!("total {:.4}, frame {:.4}, first-middle-last {:.4}", found.total, found.frame, found.practice);
    found
}

impl Errors {
    fn hold(&self) {
        assert!(self.total <= 0.03 && self.frame <= 0.06, "{} {}", self.total, self.frame);
        assert!(self.total <= self.practice / 3.0, "{} against {}", self.total, self.practice);
    }
}

/// A size and a cost for each object that follow no pattern.
fn objects(stream: &mut Stream, count: usize) -> Vec<(f64, f64)> {
    (0..count).map(|i| (1.0 / (1.0 + i as f64), 1000.0 * stream.normal().exp())).collect()
}

#[test]
fn behind_a_cut_the_same_objects_may_be_of_other_sizes_and_cost_something_else() {
    errors(24, |seed, stream| {
        let cut = 4 + (stream.uniform() * 40.0) as i64;
        let (before, after) = (objects(stream, 12), objects(stream, 12));
        Shot::new(12, 48, seed, move |h, t| {
            let h = h as usize;
            // The largest become the smallest.
            if t < cut { before[h] } else { (before[11 - h].0, after[h].1) }
        })
    })
    .hold();
}

#[test]
fn an_object_that_appears_for_three_frames_is_paid_for() {
    errors(24, |seed, stream| {
        let at = 3 + (stream.uniform() * 40.0) as i64;
        let all = objects(stream, 12);
        Shot::new(13, 48, seed, move |h, t| match all.get(h as usize) {
            Some(&look) => look,
            None if (at..at + 3).contains(&t) => (1.5, 40_000.0),
            None => (0.0, 1.0),
        })
    })
    .hold();
}

#[test]
fn objects_may_grow_and_shrink_as_they_come_and_go() {
    errors(24, |seed, stream| {
        let all = objects(stream, 12);
        let phases: Vec<f64> = (0..12).map(|_| stream.uniform() * 6.0).collect();
        Shot::new(12, 48, seed, move |h, t| {
            let (part, work) = all[h as usize];
            let swing = (phases[h as usize] + t as f64 / 9.0).sin();
            (part * (1.5 * swing).exp(), work * (1.0 + 0.2 * swing))
        })
    })
    .hold();
}

#[test]
fn a_light_that_moves_changes_what_the_preview_does_not_show() {
    errors(24, |seed, stream| {
        let all = objects(stream, 12);
        let start = stream.uniform() * 6.0;
        Shot::new(12, 48, seed, move |h, t| {
            let (part, work) = all[h as usize];
            (part, work * (1.5 + (start + t as f64 / 12.0 + f64::from(h)).sin()))
        })
    })
    .hold();
}

#[test]
fn where_a_light_is_switched_on_is_known() {
    errors(24, |seed, stream| {
        let all = objects(stream, 12);
        let on = 4 + (stream.uniform() * 40.0) as i64;
        let look = move |h: u32, t| {
            let (part, work) = all[h as usize];
            (part, if t < on { work } else { 1.5 * work })
        };
        Shot::new(12, 48, seed, look).lit_by(|t| u32::from(t >= on))
    })
    .hold();
}

#[test]
fn lights_may_flicker() {
    // On and off in turns, or at random: one profiled frame of either kind says most of it.
    errors(24, |seed, stream| {
        let all = objects(stream, 12);
        let mut lit = |t: i64| if seed % 2 == 0 { t % 2 == 0 } else { stream.uniform() < 0.3 };
        let on: Vec<bool> = (0..48).map(&mut lit).collect();
        let look = |h: u32, t: i64| {
            let (part, work) = all[h as usize];
            (part, if on[t as usize] { 3.0 * work } else { work })
        };
        Shot::new(12, 48, seed, look).lit_by(|t| u32::from(on[t as usize]))
    })
    .hold();
}

#[test]
fn a_scene_in_other_light_is_not_overlooked_in_a_long_shot() {
    for at in [1, 777, 2500, 4880] {
        let scene = at..at + 120;
        let shot = Shot::new(3, 5000, 1, |_, _| (1.0, 1.0)).lit_by(|t| u32::from(scene.contains(&t)));
        let chosen = choose_frames(&shot.strata, &shot.frames, 5).expect("good frames");
        assert!(chosen.iter().any(|&t| scene.contains(&(t as i64))), "{at}: {chosen:?}");
    }
}

#[test]
fn in_a_shot_of_5000_frames_three_that_show_something_else_are_not_overlooked() {
    for at in [1, 777, 2500, 4990] {
        let mut shot = Shot::new(3, 5000, 1, |h, t| match h {
            2 => (if (at..at + 3).contains(&t) { 3.0 } else { 0.0 }, 1.0),
            _ => (1.0, 1.0),
        });
        // Expensive: at the price of the others, three frames of 5,000 would not deserve one of five
        // profiles.
        shot.strata[2].prior_cost = 200.0;
        let chosen = choose_frames(&shot.strata, &shot.frames, 5).expect("good frames");
        assert!(chosen.iter().any(|&t| (at..at + 3).contains(&(t as i64))), "{at}: {chosen:?}");
        assert!(
            chosen.windows(2).any(|pair| pair[1] - pair[0] > 500),
            "the rest is not forgotten: {chosen:?}"
        );
    }
}

#[test]
fn both_sides_of_a_cut_are_profiled_wherever_it_is() {
    for cut in [2, 5, 24, 43, 46] {
        let shot = Shot::new(4, 48, 1, |h, t| (f64::from(u8::from((h < 2) == (t < cut))), 1.0));
        let chosen = choose_frames(&shot.strata, &shot.frames, 3).expect("good frames");
        let before = chosen.iter().filter(|&&t| (t as i64) < cut).count();
        assert!((1..=2).contains(&before), "{cut}: {chosen:?}");
    }
}

#[test]
fn a_montage_that_five_frames_cannot_know_is_profiled_in_more_as_far_as_that_is_cheap() {
    // Eight scenes of six frames, each with objects of its own.
    let shot = Shot::new(16, 48, 1, |h, t| {
        let there = t / 6 == i64::from(h / 2);
        (if there { 1.0 + f64::from(h % 2) } else { 0.0 }, 1.0 + f64::from(h * h % 11))
    });
    let first = choose_frames(&shot.strata, &shot.frames, FIRST_FRAMES).expect("good frames");
    let found = shot.forecast_from(&first, 3);
    let more = shot.more(&found, 1e-4);
    assert_eq!(first.len() + more.len(), MOST_FRAMES);
    let all: BTreeSet<usize> = first.iter().chain(&more).copied().collect();
    let scenes: BTreeSet<usize> = all.iter().map(|t| t / 6).collect();
    assert_eq!((all.len(), scenes.len()), (MOST_FRAMES, 8), "{all:?}");
    let known = shot.forecast_from(&Vec::from_iter(all), 3);
    let truth: f64 = shot.truth().iter().sum();
    let error = |found: &ShotForecast| (found.total.work.mean / truth - 1.0).abs();
    assert!(
        error(&known) < 0.02 && error(&known) < error(&found) / 4.0,
        "{} {}",
        error(&known),
        error(&found)
    );
    println!("five frames: {:.3}, sixteen: {:.3}", error(&found), error(&known));
    assert!(known.total.work.p95 / known.total.work.p50 < 1.05, "{:?}", known.total.work);

    // Five took a part of the work; with so much for each, no more than a hundredth of it is spent.
    assert_eq!(shot.more(&found, 0.006).len(), 3);
    assert_eq!(shot.more(&found, 0.0099), []);
    assert_eq!(shot.more(&found, 0.5), []);
    // It is asked once, and not of what is sure.
    assert_eq!(shot.more(&known, 1e-4), []);
    let still = Shot::new(2, 48, 1, |_, _| (1.0, 1.0));
    let found = still.forecast_from(&[4, 14, 24, 34, 44], 3);
    assert_eq!(still.more(&found, 1e-4), []);
}
