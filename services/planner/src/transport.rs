//! Linear programmes that give the time of nodes to jobs: each demand is served in one or more rows of
//! limited capacity, or left unserved at a penalty, at the least cost.
//!
//! Minimise Σ c x + Σ penalty · u subject to Σ served · x + u = needed for each demand, Σ x ≤ capacity for
//! each row, x ≥ 0, u ≥ 0.
//!
//! The revised primal simplex method with generalised upper bounds (Dantzig and Van Slyke 1967). Every
//! variable belongs to one demand and one row, so each demand has a *key* variable in the basis, and its
//! equation needs no row in the inverse. The inverse has as many rows as there are capacities, however many
//! demands there are.
//!
//! General solvers in pure Rust give no prices (microlp) or no vertex (clarabel); the planner needs both. An
//! inexact solution makes a bound weaker, never wrong: [`crate::proof`] rounds the prices to integers and
//! computes the bound from those.

use std::ops::Range;

use crate::looks::Looks;

/// A linear programme.
#[derive(Clone, Debug, Default)]
pub(crate) struct Programme {
    pub capacities: Vec<f64>,
    pub demands: Vec<Demand>,
}

#[derive(Clone, Debug)]
pub(crate) struct Demand {
    pub needed: f64,
    /// Cost of a unit that is left unserved.
    pub penalty: f64,
    pub ways: Vec<Way>,
}

/// A way to serve a demand: in any of some rows that are alike.
#[derive(Clone, Debug)]
pub(crate) struct Way {
    pub cost: f64,
    /// Units served by a unit of capacity.
    pub served: f64,
    pub rows: Range<usize>,
    /// Those of `rows` that the narrow solution may use. If they cannot serve the demand, it may use all.
    pub narrow: Range<usize>,
}

/// Solutions of a programme.
#[derive(Clone, Debug)]
pub(crate) struct Solutions {
    /// With the narrow rows of each way.
    pub narrow: Solution,
    /// With all rows.
    pub wide: Solution,
}

#[derive(Clone, Debug)]
pub(crate) struct Solution {
    /// Demand, way, row, and the capacity that it gets.
    pub given: Vec<(usize, usize, usize, f64)>,
    /// What is left unserved, by demand.
    pub unserved: Vec<f64>,
    /// How much the minimum falls if a row's capacity grows by one.
    pub worths: Vec<f64>,
}

/// A variable enters the basis only if its reduced cost is below minus this.
const TOLERANCE: f64 = 1e-9;
/// Smaller pivots would amplify rounding errors.
const LEAST_PIVOT: f64 = 1e-9;
/// Variables examined before the best of them enters. If none of them helps, the search goes on.
const BLOCK: usize = 4096;

/// The use of a row by a demand, a demand's unserved part without a row, or a row's slack without a demand.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Variable {
    demand: Option<usize>,
    way: usize,
    row: Option<usize>,
    cost: f64,
    served: f64,
}

impl Programme {
    /// Solves the programme with the narrow rows, and from there with all rows.
    pub fn solve(&self, looks: &Looks) -> Solutions {
        let mut basis = Basis::new(self, looks);
        basis.optimise();
        let mut narrow = basis.solution();
        let missed: Vec<bool> = (0..self.demands.len()).map(|demand| self.misses(&narrow, demand)).collect();
        if missed.contains(&true) {
            basis.is_wide = missed;
            basis.optimise();
            narrow = basis.solution();
        }
        basis.is_wide = vec![true; self.demands.len()];
        basis.optimise();
        Solutions { narrow, wide: basis.solution() }
    }

    /// Whether a solution leaves some of a demand unserved.
    pub fn misses(&self, solution: &Solution, demand: usize) -> bool {
        solution.unserved[demand] > 1e-6 * self.demands[demand].needed
    }
}

struct Basis<'a> {
    programme: &'a Programme,
    /// By demand: its key variable and value.
    keys: Vec<(Variable, f64)>,
    /// The other variables, and their values. As many as there are rows.
    others: Vec<(Variable, f64)>,
    /// By demand: where its variables are in `others`.
    places: Vec<Vec<usize>>,
    /// By row: whether its slack is in the basis.
    has_slack: Vec<bool>,
    /// The inverse of the others' columns, less what their keys contribute, by rows.
    inverse: Vec<Vec<f64>>,
    prices: Vec<f64>,
    /// The demand at which the next search for an entering variable begins. Slacks come after the last.
    cursor: usize,
    /// By demand: whether all rows of its ways may enter, and not only the narrow ones.
    is_wide: Vec<bool>,
    looks: &'a Looks,
}

/// What leaves the basis.
#[derive(Clone, Copy)]
enum Leaving {
    Key(usize),
    Other(usize),
}

impl<'a> Basis<'a> {
    /// Everything is unserved.
    fn new(programme: &'a Programme, looks: &'a Looks) -> Self {
        let rows = programme.capacities.len();
        // A different small perturbation of each right side breaks ties, so that the method cannot cycle.
        let speck = |index: usize, value: f64| {
            value + (1.0 + value) * 1e-9 * (1.0 + (index as f64 * 0.618_033_988_749_894_9).fract())
        };
        let key = |(index, demand): (usize, &Demand)| {
            let unserved =
                Variable { demand: Some(index), way: 0, row: None, cost: demand.penalty, served: 1.0 };
            (unserved, speck(index, demand.needed))
        };
        let slack = |(row, &capacity): (usize, &f64)| {
            (Variable { demand: None, way: 0, row: Some(row), cost: 0.0, served: 0.0 }, speck(row, capacity))
        };
        let identity = |row: usize| (0..rows).map(|at| if at == row { 1.0 } else { 0.0 }).collect();
        Basis {
            keys: programme.demands.iter().enumerate().map(key).collect(),
            others: programme.capacities.iter().enumerate().map(slack).collect(),
            places: vec![Vec::new(); programme.demands.len()],
            has_slack: vec![true; rows],
            inverse: (0..rows).map(identity).collect(),
            prices: vec![0.0; rows],
            cursor: 0,
            is_wide: vec![false; programme.demands.len()],
            looks,
            programme,
        }
    }

    /// Goes on to the optimum. Typically the steps are three times the demands and rows. Many more would mean
    /// that the method cycles, so they are limited.
    fn optimise(&mut self) {
        let most_steps = 40 * (self.programme.capacities.len() + self.programme.demands.len()) + 1000;
        for _ in 0..most_steps {
            if !self.entering().is_some_and(|(entering, reduced)| self.step(entering, reduced)) {
                break;
            }
        }
    }

    fn price(&self, row: Option<usize>) -> f64 {
        row.map_or(0.0, |row| self.prices[row])
    }

    /// What a unit served is worth to a demand.
    fn worth(&self, demand: usize) -> f64 {
        let (key, _) = self.keys[demand];
        (key.cost - self.price(key.row)) / key.served
    }

    fn is_basic(&self, variable: &Variable) -> bool {
        match variable.demand {
            None => variable.row.is_some_and(|row| self.has_slack[row]),
            Some(demand) => {
                let same = |other: &Variable| (other.way, other.row) == (variable.way, variable.row);
                same(&self.keys[demand].0)
                    || self.places[demand].iter().any(|&place| same(&self.others[place].0))
            }
        }
    }

    /// The variable with the least reduced cost in the next block that has a negative one.
    fn entering(&mut self) -> Option<(Variable, f64)> {
        let demands = self.programme.demands.len();
        let mut best: Option<(Variable, f64)> = None;
        let mut seen = 0;
        for _ in 0..=demands {
            let demand = self.cursor;
            self.cursor = if demand == demands { 0 } else { demand + 1 };
            seen += self.cheapest_of(demand, &mut best);
            if seen >= BLOCK && best.is_some() {
                break;
            }
        }
        self.looks.add(seen);
        best
    }

    /// Compares a demand's variables, or all slacks, with the best so far. Returns their number.
    fn cheapest_of(&self, demand: usize, best: &mut Option<(Variable, f64)>) -> usize {
        let mut seen = 0;
        let mut consider = |variable: Variable, reduced: f64| {
            let is_better = best.is_none_or(|(_, least)| reduced < least);
            if reduced < -TOLERANCE * (1.0 + variable.cost.abs()) && is_better && !self.is_basic(&variable) {
                *best = Some((variable, reduced));
            }
        };
        let Some(asked) = self.programme.demands.get(demand) else {
            for (row, price) in self.prices.iter().enumerate() {
                consider(Variable { demand: None, way: 0, row: Some(row), cost: 0.0, served: 0.0 }, -price);
            }
            return self.prices.len();
        };
        let worth = self.worth(demand);
        for (way, &Way { cost, served, ref rows, ref narrow }) in asked.ways.iter().enumerate() {
            let rows = if self.is_wide[demand] { rows } else { narrow };
            let own = cost - worth * served;
            for (row, price) in rows.clone().zip(&self.prices[rows.clone()]) {
                consider(Variable { demand: Some(demand), way, row: Some(row), cost, served }, own - price);
            }
            seen += rows.len();
        }
        consider(
            Variable { demand: Some(demand), way: 0, row: None, cost: asked.penalty, served: 1.0 },
            asked.penalty - worth,
        );
        seen + 1
    }

    /// Takes a variable into the basis. Returns false if nothing bounds it, or no pivot is safe.
    fn step(&mut self, entering: Variable, reduced: f64) -> bool {
        let rates = self.rates(&entering);
        let of_keys = self.rates_of_keys(&entering, &rates);
        let Some((leaving, length)) = self.leaving(&rates, &of_keys) else { return false };
        for ((_, value), rate) in self.others.iter_mut().zip(&rates) {
            *value -= length * rate;
        }
        for &(demand, rate) in &of_keys {
            self.keys[demand].1 -= length * rate;
        }
        match leaving {
            Leaving::Other(place) => self.pivot(place, &rates, (entering, length), reduced),
            Leaving::Key(demand) => match self.places[demand].first() {
                // Without other variables of its demand, only one of them can push a key out.
                None => self.keys[demand] = (entering, length),
                Some(&place) => {
                    self.swap_key(demand, place);
                    let mut rates = rates;
                    let key = of_keys.iter().find(|&&(of, _)| of == demand);
                    rates[place] = key.map_or(0.0, |&(_, rate)| rate);
                    self.pivot(place, &rates, (entering, length), reduced);
                }
            },
        }
        true
    }

    /// How fast the values of the others fall as the entering variable grows.
    fn rates(&self, entering: &Variable) -> Vec<f64> {
        self.looks.add(self.inverse.len());
        let key = entering.demand.map(|demand| self.keys[demand].0);
        let through_key = key.and_then(|key| Some((key.row?, entering.served / key.served)));
        let rate = |inverse: &Vec<f64>| {
            let own = entering.row.map_or(0.0, |row| inverse[row]);
            own - through_key.map_or(0.0, |(row, factor)| factor * inverse[row])
        };
        self.inverse.iter().map(rate).collect()
    }

    /// How fast the values of keys fall, for the demands whose key changes.
    fn rates_of_keys(&self, entering: &Variable, rates: &[f64]) -> Vec<(usize, f64)> {
        let mut served: Vec<(usize, f64)> = Vec::new();
        served.extend(entering.demand.map(|demand| (demand, entering.served)));
        for (&(variable, _), &rate) in self.others.iter().zip(rates) {
            if let Some(demand) = variable.demand.filter(|_| rate != 0.0) {
                served.push((demand, -variable.served * rate));
            }
        }
        served.sort_by_key(|&(demand, _)| demand);
        let sum = |of_demand: &[(usize, f64)]| {
            let demand = of_demand[0].0;
            let served: f64 = of_demand.iter().map(|(_, served)| served).sum();
            (demand, served / self.keys[demand].0.served)
        };
        served.chunk_by(|a, b| a.0 == b.0).map(sum).collect()
    }

    /// The variable that falls to zero first, and how far the entering one can grow until then. Ties go to
    /// the fastest.
    fn leaving(&self, rates: &[f64], of_keys: &[(usize, f64)]) -> Option<(Leaving, f64)> {
        let others = self.others.iter().zip(rates).enumerate();
        let others = others.map(|(place, (&(_, value), &rate))| (Leaving::Other(place), value, rate));
        let keys = of_keys.iter().map(|&(demand, rate)| (Leaving::Key(demand), self.keys[demand].1, rate));
        let mut first: Option<(Leaving, f64, f64)> = None;
        for (leaving, value, rate) in others.chain(keys).filter(|&(_, _, rate)| rate > LEAST_PIVOT) {
            let length = value.max(0.0) / rate;
            let is_better = first.is_none_or(|(_, least, fastest)| {
                length < least - 1e-12 || (length <= least + 1e-12 && rate > fastest)
            });
            if is_better {
                first = Some((leaving, length, rate));
            }
        }
        first.map(|(leaving, length, _)| (leaving, length))
    }

    /// A demand's key and one of its other variables change roles.
    fn swap_key(&mut self, demand: usize, place: usize) {
        let (key, other) = (self.keys[demand].0, self.others[place].0);
        let mut row = std::mem::take(&mut self.inverse[place]);
        for &also in self.places[demand].iter().filter(|&&also| also != place) {
            let factor = self.others[also].0.served / other.served;
            for (sum, entry) in row.iter_mut().zip(&self.inverse[also]) {
                *sum += factor * entry;
            }
        }
        row.iter_mut().for_each(|entry| *entry *= -other.served / key.served);
        self.inverse[place] = row;
        std::mem::swap(&mut self.keys[demand], &mut self.others[place]);
    }

    /// The entering variable takes the place of another.
    fn pivot(&mut self, place: usize, rates: &[f64], (entering, value): (Variable, f64), reduced: f64) {
        let mut row = std::mem::take(&mut self.inverse[place]);
        row.iter_mut().for_each(|entry| *entry /= rates[place]);
        for (price, entry) in self.prices.iter_mut().zip(&row) {
            *price += reduced * entry;
        }
        let filled: Vec<usize> = (0..row.len()).filter(|&at| row[at] != 0.0).collect();
        let is_dense = filled.len() * 8 > row.len();
        for (inverse, &rate) in self.inverse.iter_mut().zip(rates) {
            if rate == 0.0 || inverse.is_empty() {
                continue;
            }
            self.looks.add(filled.len());
            if is_dense {
                // A dense loop vectorises. It is faster than picking entries.
                inverse.iter_mut().zip(&row).for_each(|(entry, of_row)| *entry -= rate * of_row);
            } else {
                filled.iter().for_each(|&at| inverse[at] -= rate * row[at]);
            }
        }
        self.inverse[place] = row;
        let (left, _) = std::mem::replace(&mut self.others[place], (entering, value));
        match (left.demand, left.row) {
            (Some(demand), _) => self.places[demand].retain(|&other| other != place),
            (None, Some(row)) => self.has_slack[row] = false,
            (None, None) => {}
        }
        match (entering.demand, entering.row) {
            (Some(demand), _) => self.places[demand].push(place),
            (None, Some(row)) => self.has_slack[row] = true,
            (None, None) => {}
        }
    }

    /// The solution for the right sides without their perturbation.
    fn solution(&self) -> Solution {
        let mut right = self.programme.capacities.clone();
        for (&(key, _), demand) in self.keys.iter().zip(&self.programme.demands) {
            if let Some(row) = key.row {
                right[row] -= demand.needed / key.served;
            }
        }
        let mut values: Vec<(Variable, f64)> = Vec::new();
        let mut left: Vec<f64> = self.programme.demands.iter().map(|demand| demand.needed).collect();
        for (&(variable, _), inverse) in self.others.iter().zip(&self.inverse) {
            let value: f64 = inverse.iter().zip(&right).map(|(entry, right)| entry * right).sum();
            if let Some(demand) = variable.demand {
                left[demand] -= variable.served * value;
            }
            values.push((variable, value));
        }
        values.extend(self.keys.iter().zip(left).map(|(&(key, _), left)| (key, left / key.served)));
        let mut given = Vec::new();
        let mut unserved = vec![0.0; self.programme.demands.len()];
        for (variable, value) in values.into_iter().filter(|&(_, value)| value > 0.0) {
            match (variable.demand, variable.row) {
                (Some(demand), Some(row)) => given.push((demand, variable.way, row, value)),
                (Some(demand), None) => unserved[demand] = value,
                (None, _) => {}
            }
        }
        given.sort_by_key(|&(demand, way, row, _)| (demand, way, row));
        Solution { given, unserved, worths: self.prices.iter().map(|price| -price).collect() }
    }
}

#[cfg(test)]
mod tests;
