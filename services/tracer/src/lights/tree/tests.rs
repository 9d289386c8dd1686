use super::*;
use crate::random::hash;

/// Evenly spread numbers in [0, 1), the same in every run.
struct Numbers(u64);

impl Numbers {
    fn next(&mut self) -> f32 {
        self.0 += 1;
        (hash(self.0) >> 40) as f32 / (1u32 << 24) as f32
    }

    fn within(&mut self, low: f32, high: f32) -> f32 {
        low + (high - low) * self.next()
    }

    fn direction(&mut self) -> Vec3 {
        loop {
            let v = Vec3::new(self.within(-1.0, 1.0), self.within(-1.0, 1.0), self.within(-1.0, 1.0));
            if (0.01..1.0).contains(&v.length_squared()) {
                return v.normalize();
            }
        }
    }
}

/// A light, with the data to compute its actual contribution.
struct Lamp {
    bounds: Bounds,
    centre: Vec3,
    /// Normal of a flat light and whether it emits from both sides, or axis and cosine of a cone.
    shape: Shape,
    intensity: f64,
}

enum Shape {
    Flat(Vec3, bool),
    Cone(Vec3, f32),
}

impl Lamp {
    fn flat(centre: Vec3, normal: Vec3, edge: f32, both_sides: bool, intensity: f64) -> Self {
        let u = normal.any_orthonormal_vector() * edge;
        let v = normal.cross(u);
        let corners = [centre + u, centre - 0.5 * u + 0.8 * v, centre - 0.5 * u - 0.8 * v];
        let bounds = Bounds::flat(
            crate::bounds::Bounds::of(corners),
            normal,
            1.2 * edge * edge,
            both_sides,
            intensity,
        );
        Self { bounds, centre, shape: Shape::Flat(normal, both_sides), intensity }
    }

    fn cone(centre: Vec3, axis: Vec3, cos: f32, intensity: f64) -> Self {
        let bounds = Bounds::point(centre, Some((axis, cos)), intensity);
        Self { bounds, centre, shape: Shape::Cone(axis, cos), intensity }
    }

    /// Irradiance from its centre.
    fn brings(&self, receiver: &Receiver) -> f64 {
        let to = self.centre - receiver.position;
        let direction = to.normalize();
        let emitted = match self.shape {
            Shape::Flat(normal, true) => normal.dot(direction).abs(),
            Shape::Flat(normal, false) => -normal.dot(direction),
            Shape::Cone(axis, cos) => f32::from(-axis.dot(direction) >= cos),
        };
        let received = receiver.normal.map_or(1.0, |n| n.dot(direction));
        self.intensity * f64::from(emitted.max(0.0) * received.max(0.0) / to.length_squared())
    }
}

/// Lights of all kinds at random positions, with very different intensities.
fn disorder(numbers: &mut Numbers, count: usize) -> Vec<Lamp> {
    let one = |i: usize| {
        let centre =
            Vec3::new(numbers.within(-5.0, 5.0), numbers.within(-1.0, 1.0), numbers.within(-5.0, 5.0));
        let (axis, intensity) = (numbers.direction(), 10f64.powf(numbers.within(-3.0, 3.0).into()));
        match i % 4 {
            0 => Lamp::flat(centre, axis, numbers.within(0.01, 1.0), false, intensity),
            1 => Lamp::flat(centre, axis, 0.1, true, intensity),
            2 => Lamp::cone(centre, axis, numbers.within(-1.0, 0.99), intensity),
            // Several lights at the same position.
            _ => Lamp::cone(Vec3::ONE, axis, 0.9, intensity),
        }
    };
    (0..count).map(one).collect()
}

fn tree(lamps: &[Lamp]) -> LightTree {
    LightTree::new(&lamps.iter().map(|l| l.bounds).collect::<Vec<_>>())
}

fn choose(tree: &LightTree, receiver: &Receiver, u: f64, visited: &mut u64) -> Option<Choice> {
    let mut choice = Choice::by(u);
    tree.choose(receiver, std::slice::from_mut(&mut choice), visited);
    (choice.probability > 0.0).then_some(choice)
}

#[test]
fn choices_made_together_are_those_made_one_by_one() {
    let mut numbers = Numbers(9);
    let lamps = disorder(&mut numbers, 40);
    let tree = tree(&lamps);
    for receiver in receivers(&mut numbers, 50) {
        let mut together: Vec<Choice> =
            (0..7).map(|i| Choice::by((f64::from(i) + f64::from(numbers.within(0.0, 1.0))) / 7.0)).collect();
        let alone: Vec<_> = together.iter().map(|c| choose(&tree, &receiver, c.number, &mut 0)).collect();
        let (mut visited, mut one_by_one) = (0, 0);
        together.iter().for_each(|c| {
            choose(&tree, &receiver, c.number, &mut one_by_one);
        });
        tree.choose(&receiver, &mut together, &mut visited);
        for (together, alone) in together.iter().zip(alone) {
            let made = |c: &Choice| (c.light, c.probability, c.number);
            assert_eq!((together.probability > 0.0).then(|| made(together)), alone.as_ref().map(made));
        }
        assert!(visited < one_by_one, "{visited} nodes together, {one_by_one} one by one");
    }
}

fn receivers(numbers: &mut Numbers, count: usize) -> Vec<Receiver> {
    let one = |i: usize| Receiver {
        position: Vec3::new(numbers.within(-6.0, 6.0), numbers.within(-2.0, 2.0), numbers.within(-6.0, 6.0)),
        normal: (!i.is_multiple_of(3)).then(|| numbers.direction()),
    };
    (0..count).map(one).collect()
}

#[test]
fn probabilities_are_those_of_the_choices_and_sum_to_one() {
    const STEPS: u32 = 20_000;
    let mut numbers = Numbers(0);
    for count in [1, 2, 3, 7, 60] {
        let lamps = disorder(&mut numbers, count);
        let tree = tree(&lamps);
        for receiver in receivers(&mut numbers, 12) {
            let (mut chosen, mut nothing) = (vec![0u32; count], 0u32);
            for i in 0..STEPS {
                let u = (f64::from(i) + 0.5) / f64::from(STEPS);
                match choose(&tree, &receiver, u, &mut 0) {
                    Some(Choice { light, probability, number }) => {
                        assert!((0.0..1.0).contains(&number));
                        chosen[light] += 1;
                        let again = tree.probability(&receiver, light, &mut 0);
                        assert!((probability / again - 1.0).abs() < 1e-12, "{probability} and {again}");
                    }
                    None => nothing += 1,
                }
            }
            let mut sum = f64::from(nothing) / f64::from(STEPS);
            for (light, &times) in chosen.iter().enumerate() {
                let probability = tree.probability(&receiver, light, &mut 0);
                // An interval of this length contains this many steps, give or take one.
                let expected = probability * f64::from(STEPS);
                assert!((f64::from(times) - expected).abs() <= 1.01, "{times} times instead of {expected}");
                sum += probability;
            }
            assert!((sum - 1.0).abs() < 2.0 * count as f64 / f64::from(STEPS), "{sum}");
        }
    }
}

#[test]
fn without_bounds_that_rule_lights_out_probabilities_sum_to_one_to_the_last_digits() {
    let mut numbers = Numbers(1);
    for count in [1, 5, 1000] {
        let all_round = |l: Lamp| Lamp::cone(l.centre, Vec3::Z, -1.0, l.intensity);
        let tree = tree(&disorder(&mut numbers, count).into_iter().map(all_round).collect::<Vec<_>>());
        for receiver in receivers(&mut numbers, 20) {
            let receiver = Receiver { normal: None, ..receiver };
            let sum: f64 = (0..count).map(|i| tree.probability(&receiver, i, &mut 0)).sum();
            assert!((sum - 1.0).abs() < 1e-12, "{count} lights: {sum}");
        }
    }
}

#[test]
fn whatever_may_bring_light_may_be_chosen() {
    let mut numbers = Numbers(2);
    let (mut bringing, mut ruled_out) = (0, 0);
    for count in [1, 30, 500] {
        let lamps = disorder(&mut numbers, count);
        let tree = tree(&lamps);
        for receiver in receivers(&mut numbers, 200) {
            for (i, lamp) in lamps.iter().enumerate() {
                let (brings, probability) = (lamp.brings(&receiver), tree.probability(&receiver, i, &mut 0));
                assert!(brings == 0.0 || probability > 0.0, "light {i} of {count} brings {brings}");
                bringing += u32::from(brings > 0.0);
                ruled_out += u32::from(probability == 0.0);
            }
        }
    }
    assert!(bringing > 10_000 && ruled_out > 1000, "{bringing} bring light, {ruled_out} are ruled out");
}

#[test]
fn any_visits_every_light_that_bounds_do_not_rule_out() {
    let mut numbers = Numbers(3);
    for count in [0, 1, 2, 100] {
        let lamps = disorder(&mut numbers, count);
        let tree = tree(&lamps);
        for (wanted, lamp) in lamps.iter().enumerate() {
            assert!(tree.any(|_| true, |i| i == wanted), "{wanted} of {count}");
            let centre = lamp.bounds.centre();
            let holds = |b: &Bounds| b.low.cmple(centre).all() && b.high.cmpge(centre).all();
            assert!(tree.any(holds, |i| i == wanted), "{wanted} of {count} by its bounds");
        }
        let seen = std::cell::RefCell::new(vec![0; count]);
        let visit = |i: usize| {
            seen.borrow_mut()[i] += 1;
            false
        };
        assert!(!tree.any(|_| true, visit));
        assert!(seen.borrow().iter().all(|&times| times == 1), "{:?}", seen.borrow());
        assert!(!tree.any(|_| false, |_| true));
    }
}

/// Variance over squared sum of the one-sample estimate of Σ `brought`, choosing light i with `p(i)`.
fn relative_variance(brought: &[f64], p: impl Fn(usize) -> f64) -> f64 {
    let sum: f64 = brought.iter().sum();
    let squares = brought.iter().enumerate().filter(|(_, b)| **b > 0.0).map(|(i, b)| b * b / p(i));
    squares.sum::<f64>() / (sum * sum) - 1.0
}

#[test]
fn ten_thousand_lights_in_a_hundred_rooms_are_found_far_better_than_by_chance_or_power() {
    // Ceiling lamps in rooms of 4 m. The walls block their light, which the tree does not know.
    const ROOMS: i32 = 10;
    const LAMPS: usize = 100;
    let mut numbers = Numbers(4);
    let mut lamps = Vec::new();
    let mut room_of = Vec::new();
    for room in 0..ROOMS * ROOMS {
        let corner = 4.0 * Vec3::new((room % ROOMS) as f32, 0.0, (room / ROOMS) as f32);
        for _ in 0..LAMPS {
            let place = Vec3::new(numbers.within(0.1, 3.9), 2.9, numbers.within(0.1, 3.9));
            let intensity = 10f64.powf(numbers.within(-1.0, 1.0).into());
            lamps.push(Lamp::flat(corner + place, Vec3::NEG_Y, 0.02, false, intensity));
            room_of.push(room);
        }
    }
    let (tree, count) = (tree(&lamps), lamps.len() as f64);
    let power: f64 = lamps.iter().map(|l| l.intensity).sum();
    let (mut by_tree, mut by_chance, mut by_power) = (0.0, 0.0, 0.0);
    const POINTS: i32 = 50;
    for i in 0..POINTS {
        let room = i * 7 % (ROOMS * ROOMS);
        let corner = 4.0 * Vec3::new((room % ROOMS) as f32, 0.0, (room / ROOMS) as f32);
        let place = Vec3::new(numbers.within(0.0, 4.0), numbers.within(0.0, 1.5), numbers.within(0.0, 4.0));
        let receiver = Receiver { position: corner + place, normal: Some(Vec3::Y) };
        let brought: Vec<f64> = (0..lamps.len())
            .map(|l| if room_of[l] == room { lamps[l].brings(&receiver) } else { 0.0 })
            .collect();
        by_tree += relative_variance(&brought, |l| tree.probability(&receiver, l, &mut 0));
        by_chance += relative_variance(&brought, |_| 1.0 / count);
        by_power += relative_variance(&brought, |l| lamps[l].intensity / power);
    }
    let mut visited = 0;
    let receiver = Receiver { position: Vec3::new(2.0, 0.0, 2.0), normal: Some(Vec3::Y) };
    choose(&tree, &receiver, 0.3, &mut visited);
    let points = f64::from(POINTS);
    println!(
        "relative variance of one choice among {count}: tree {:.2}, power {:.0}, even {:.0}; {visited} nodes",
        by_tree / points,
        by_power / points,
        by_chance / points
    );
    assert!(by_tree < by_power / 30.0 && by_tree < by_chance / 100.0, "{by_tree} {by_power} {by_chance}");
    assert!(visited < 80, "{visited} nodes on one way down");
}

#[test]
fn lights_in_one_place_or_at_extreme_scales_make_a_tree() {
    for scale in [1e-6f32, 1.0, 1e6] {
        for brightness in [1e-30f64, 1.0, 1e30] {
            let lamps: Vec<Lamp> = (0..1000)
                .map(|i| {
                    // Distances grow geometrically, so equidistant planes do not halve the set.
                    let place = scale * 1.02f32.powi(i) * Vec3::X * if i % 7 == 0 { 0.0 } else { 1.0 };
                    Lamp::cone(place, Vec3::Z, -1.0, brightness * f64::from(1 + i % 3))
                })
                .collect();
            let tree = tree(&lamps);
            for position in [Vec3::ZERO, scale * Vec3::Y, scale * Vec3::splat(1e3)] {
                let receiver = Receiver { position, normal: None };
                let sum: f64 = (0..1000).map(|i| tree.probability(&receiver, i, &mut 0)).sum();
                assert!((sum - 1.0).abs() < 1e-9, "scale {scale}, brightness {brightness}: {sum}");
            }
        }
    }
}
