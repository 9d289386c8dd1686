//! Linear programmes: minimise c·x subject to A x ≤ b or A x = b, x ≥ 0, with b ≥ 0.
//!
//! The revised primal simplex method with an explicit inverse. It stays small because the planner's
//! programmes are special: every column has two or three entries, and a first basis is given, so there is no
//! first phase. Each equation has a column of its own for unserved work, each inequality has its slack.
//!
//! General solvers in pure Rust give no prices (microlp) or no vertex (clarabel); the planner needs both. An
//! inexact solution makes a bound weaker, never wrong: [`crate::proof`] rounds the prices to integers and
//! computes the bound from those.

#[derive(Clone, Debug)]
pub(crate) struct Column {
    pub cost: f64,
    pub entries: Vec<(u32, f64)>,
}

/// A linear programme. Row i starts with `basis[i]`, a column whose only entry is a 1 in this row.
#[derive(Clone, Debug, Default)]
pub(crate) struct Programme {
    pub right: Vec<f64>,
    pub columns: Vec<Column>,
    pub basis: Vec<usize>,
}

#[derive(Clone, Debug)]
pub(crate) struct Solution {
    pub x: Vec<f64>,
    /// Price of each row: how much the minimum rises if its right side grows by one.
    pub prices: Vec<f64>,
    /// No column could improve it any more.
    #[cfg(test)]
    pub optimal: bool,
}

/// A column enters the basis only if its reduced cost is below minus this.
const TOLERANCE: f64 = 1e-9;
/// Smaller pivots would amplify rounding errors.
const LEAST_PIVOT: f64 = 1e-9;
/// Columns examined before the best of them enters. If none of them helps, the search goes on.
const BLOCK: usize = 4096;

impl Programme {
    /// Adds a row, with the column that starts in its basis.
    pub fn row(&mut self, right: f64, own_cost: f64) -> u32 {
        let row = self.right.len() as u32;
        self.right.push(right);
        self.basis.push(self.columns.len());
        self.columns.push(Column { cost: own_cost, entries: vec![(row, 1.0)] });
        row
    }

    /// Solves the programme in at most `most_steps` steps.
    pub fn solve(&self, most_steps: usize) -> Solution {
        let mut state = State::new(self);
        let mut steps = 0;
        while steps < most_steps
            && let Some(entering) = state.entering()
            && state.step(entering)
        {
            steps += 1;
        }
        #[cfg(test)]
        let optimal = state.entering().is_none();
        let mut x = vec![0.0; self.columns.len()];
        let values = state.values_without_perturbation();
        for (&column, value) in state.basis.iter().zip(values) {
            x[column] = value.max(0.0);
        }
        Solution {
            x,
            prices: state.prices,
            #[cfg(test)]
            optimal,
        }
    }
}

struct State<'a> {
    programme: &'a Programme,
    basis: Vec<usize>,
    is_basic: Vec<bool>,
    /// The inverse basis by columns.
    inverse: Vec<Vec<f64>>,
    /// Values of the basic columns, for the perturbed right side.
    values: Vec<f64>,
    prices: Vec<f64>,
    cursor: usize,
}

impl<'a> State<'a> {
    fn new(programme: &'a Programme) -> Self {
        let rows = programme.right.len();
        let mut is_basic = vec![false; programme.columns.len()];
        programme.basis.iter().for_each(|&column| is_basic[column] = true);
        let inverse = (0..rows)
            .map(|k| {
                let mut column = vec![0.0; rows];
                column[k] = 1.0;
                column
            })
            .collect();
        // A different small perturbation of each right side breaks ties, so that the method cannot cycle.
        let speck = |row: usize, value: f64| {
            (1.0 + value) * 1e-9 * (1.0 + (row as f64 * 0.618_033_988_749_894_9).fract())
        };
        Self {
            values: programme
                .right
                .iter()
                .enumerate()
                .map(|(row, &value)| value + speck(row, value))
                .collect(),
            prices: programme.basis.iter().map(|&column| programme.columns[column].cost).collect(),
            basis: programme.basis.clone(),
            is_basic,
            inverse,
            programme,
            cursor: 0,
        }
    }

    fn reduced_cost(&self, column: &Column) -> f64 {
        column
            .entries
            .iter()
            .fold(column.cost, |rest, &(row, value)| rest - self.prices[row as usize] * value)
    }

    /// The column with the least reduced cost in the next block that has a negative one.
    fn entering(&mut self) -> Option<usize> {
        let count = self.programme.columns.len();
        let mut best: Option<(f64, usize)> = None;
        for seen in 1..=count {
            let index = self.cursor;
            self.cursor = if index + 1 == count { 0 } else { index + 1 };
            if !self.is_basic[index] {
                let column = &self.programme.columns[index];
                let reduced = self.reduced_cost(column);
                let worth = TOLERANCE * (1.0 + column.cost.abs());
                if reduced < -worth && best.is_none_or(|(least, _)| reduced < least) {
                    best = Some((reduced, index));
                }
            }
            if seen % BLOCK == 0 && best.is_some() {
                break;
            }
        }
        best.map(|(_, index)| index)
    }

    /// Takes the column into the basis. Returns false if nothing bounds it, or no pivot is safe.
    fn step(&mut self, entering: usize) -> bool {
        let rows = self.basis.len();
        let column = &self.programme.columns[entering];
        let mut direction = vec![0.0; rows];
        for &(row, value) in &column.entries {
            for (sum, entry) in direction.iter_mut().zip(&self.inverse[row as usize]) {
                *sum += value * entry;
            }
        }
        let mut leaving: Option<(usize, f64)> = None;
        for (row, &slope) in direction.iter().enumerate() {
            if slope > LEAST_PIVOT {
                let ratio = self.values[row].max(0.0) / slope;
                let better = leaving.is_none_or(|(at, least)| {
                    ratio < least - 1e-12 || (ratio <= least + 1e-12 && slope > direction[at])
                });
                if better {
                    leaving = Some((row, ratio));
                }
            }
        }
        let Some((pivot_row, length)) = leaving else { return false };
        let pivot = direction[pivot_row];
        let reduced = self.reduced_cost(column);
        let touched: Vec<usize> =
            (0..rows).filter(|&row| direction[row] != 0.0 && row != pivot_row).collect();
        let is_dense = touched.len() * 8 > rows;
        for (k, inverse) in self.inverse.iter_mut().enumerate() {
            let at_pivot = inverse[pivot_row];
            if at_pivot == 0.0 {
                continue;
            }
            let factor = at_pivot / pivot;
            if is_dense {
                // A dense loop vectorises. It is faster than picking rows.
                for (entry, slope) in inverse.iter_mut().zip(&direction) {
                    *entry -= factor * slope;
                }
            } else {
                for &row in &touched {
                    inverse[row] -= factor * direction[row];
                }
            }
            inverse[pivot_row] = factor;
            self.prices[k] += reduced * factor;
        }
        for &row in &touched {
            self.values[row] -= length * direction[row];
        }
        self.values[pivot_row] = length;
        self.is_basic[self.basis[pivot_row]] = false;
        self.is_basic[entering] = true;
        self.basis[pivot_row] = entering;
        true
    }

    fn values_without_perturbation(&self) -> Vec<f64> {
        let mut values = vec![0.0; self.basis.len()];
        for (inverse, &right) in self.inverse.iter().zip(&self.programme.right) {
            for (value, entry) in values.iter_mut().zip(inverse) {
                *value += right * entry;
            }
        }
        values
    }
}

#[cfg(test)]
mod tests {
    use super::{Column, Programme};

    #[test]
    fn a_transport_problem_with_a_known_answer_and_prices() {
        // Two jobs of 4 and 3 hours; machine one costs 1 an hour and has 5 hours, machine two costs 3 and has
        // 9.
        let mut programme = Programme::default();
        let jobs = [programme.row(4.0, 100.0), programme.row(3.0, 100.0)];
        let machines = [programme.row(5.0, 0.0), programme.row(9.0, 0.0)];
        for &job in &jobs {
            for (&machine, cost) in machines.iter().zip([1.0, 3.0]) {
                programme.columns.push(Column { cost, entries: vec![(job, 1.0), (machine, 1.0)] });
            }
        }
        let found = programme.solve(100);
        assert!(found.optimal);
        let cost: f64 = found.x.iter().zip(&programme.columns).map(|(x, column)| x * column.cost).sum();
        assert!((cost - 11.0).abs() < 1e-9, "5 hours at 1, 2 at 3: {cost}");
        let expected = [3.0, 3.0, -2.0, 0.0];
        assert!(found.prices.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-9), "{:?}", found.prices);
    }

    #[test]
    fn what_does_not_fit_is_left_at_its_own_cost() {
        let mut programme = Programme::default();
        let job = programme.row(4.0, 50.0);
        let machine = programme.row(1.0, 0.0);
        programme.columns.push(Column { cost: 2.0, entries: vec![(job, 0.5), (machine, 1.0)] });
        let found = programme.solve(100);
        assert!((found.x[0] - 3.5).abs() < 1e-9);
        assert!((found.prices[1] - (2.0 - 25.0)).abs() < 1e-6);
    }
}
