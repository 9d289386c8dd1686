use super::{Demand, Programme, Solution, Way};
use crate::looks::Looks;

#[test]
fn a_transport_problem_with_a_known_answer_and_prices() {
    // Two jobs of 4 and 3 hours; machine one costs 1 an hour and has 5 hours, machine two costs 3 and has
    // 9.
    let ways: Vec<Way> = [1.0, 3.0]
        .iter()
        .zip([0..1, 1..2])
        .map(|(&cost, rows)| Way { cost, served: 1.0, narrow: rows.clone(), rows })
        .collect();
    let demand = |needed: f64| Demand { needed, penalty: 100.0, ways: ways.clone() };
    let programme = Programme { capacities: vec![5.0, 9.0], demands: vec![demand(4.0), demand(3.0)] };
    let found = programme.solve(&Looks::default()).wide;
    let cost: f64 = found.given.iter().map(|&(_, way, _, time)| time * ways[way].cost).sum();
    assert!((cost - 11.0).abs() < 1e-9, "5 hours at 1, 2 at 3: {cost}");
    assert!((found.worths[0] - 2.0).abs() < 1e-9 && found.worths[1].abs() < 1e-9, "{:?}", found.worths);
    assert_eq!(found.unserved, [0.0, 0.0]);
}

#[test]
fn what_does_not_fit_is_left_at_its_own_cost() {
    let ways = vec![Way { cost: 2.0, served: 0.5, rows: 0..1, narrow: 0..1 }];
    let demands = vec![Demand { needed: 4.0, penalty: 50.0, ways }];
    let found = Programme { capacities: vec![1.0], demands }.solve(&Looks::default()).wide;
    assert!((found.unserved[0] - 3.5).abs() < 1e-9);
    assert!((found.worths[0] - (25.0 - 2.0)).abs() < 1e-6);
}

#[test]
fn prices_of_random_programmes_prove_that_their_solutions_are_optimal() {
    use crate::chance::{between, uniform};
    let mut cases = [0; 2];
    for seed in 0..200 {
        let draw = |n: &[u64]| 0.1 + 3.0 * uniform(seed, n);
        let (classes, slots) = (between(seed, &[0], 1, 5) as usize, between(seed, &[1], 1, 6) as usize);
        let capacities: Vec<f64> = (0..(classes * slots) as u64).map(|row| 4.0 * draw(&[2, row])).collect();
        let demands: Vec<Demand> = (0..between(seed, &[3], 1, 40) as u64)
            .map(|job| {
                let between = |n: u64, low: usize, high: usize| {
                    between(seed, &[n, job], low as i64, high as i64) as usize
                };
                let first = between(4, 0, slots - 1);
                let last = between(5, first, slots - 1);
                let narrow = between(9, first, last);
                let until = between(10, narrow, last);
                let way = |class: usize| Way {
                    cost: draw(&[6, class as u64]),
                    served: draw(&[7, class as u64, job % 3]),
                    rows: class * slots + first..class * slots + last + 1,
                    narrow: class * slots + narrow..class * slots + until + 1,
                };
                Demand { needed: draw(&[8, job]), penalty: 200.0, ways: (0..classes).map(way).collect() }
            })
            .collect();
        let programme = Programme { capacities, demands };
        let found = programme.solve(&Looks::default());
        println!("seed {seed}");
        let wide = proven(&programme, &found.wide);
        let narrow = cost(&programme, &found.narrow);
        let mut narrow_alone = programme.clone();
        let ways = narrow_alone.demands.iter_mut().flat_map(|demand| &mut demand.ways);
        ways.for_each(|way| way.rows = way.narrow.clone());
        let alone = narrow_alone.solve(&Looks::default()).wide;
        let serves_all = (0..narrow_alone.demands.len()).all(|demand| !narrow_alone.misses(&alone, demand));
        let alone = proven(&narrow_alone, &alone);
        let (least, most) = if serves_all { (alone, alone) } else { (wide, alone) };
        let tolerance = 1e-6 * (1.0 + alone);
        assert!(least - tolerance <= narrow && narrow <= most + tolerance, "{least} {narrow} {most}");
        cases[usize::from(serves_all)] += 1;
    }
    assert!(cases.iter().all(|&count| count > 20), "{cases:?}");
}

/// The cost of a solution. Its prices must prove that none costs less.
fn proven(programme: &Programme, found: &Solution) -> f64 {
    let cost = cost(programme, found);
    let reserved: f64 =
        programme.capacities.iter().zip(&found.worths).map(|(time, worth)| time * worth).sum();
    let served = programme.demands.iter().map(|demand| {
        let ways = demand
            .ways
            .iter()
            .flat_map(|way| way.rows.clone().map(|row| (way.cost + found.worths[row]) / way.served));
        demand.needed * ways.fold(demand.penalty, f64::min)
    });
    let dual = served.sum::<f64>() - reserved;
    assert!((cost - dual).abs() < 1e-6 * (1.0 + cost), "costs {cost}, proven {dual}");
    cost
}

/// The cost of a solution, which must be possible.
fn cost(programme: &Programme, found: &Solution) -> f64 {
    let (mut used, mut served) = (vec![0.0; programme.capacities.len()], found.unserved.clone());
    let mut cost = 0.0;
    for &(demand, way, row, time) in &found.given {
        let of = &programme.demands[demand].ways[way];
        assert!(of.rows.contains(&row) && time > 0.0);
        used[row] += time;
        served[demand] += time * of.served;
        cost += time * of.cost;
    }
    for ((used, &capacity), worth) in used.iter().zip(&programme.capacities).zip(&found.worths) {
        assert!(*used <= capacity + 1e-6 && *worth >= -1e-6, "{used} of {capacity}, {worth}");
    }
    for ((served, demand), unserved) in served.iter().zip(&programme.demands).zip(&found.unserved) {
        assert!((served - demand.needed).abs() < 1e-6, "{served} of {}", demand.needed);
        cost += unserved * demand.penalty;
    }
    cost
}
