//! Interpolates the cost of a given error from measured settings.

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rung {
    pub error: f64,
    /// Cost in any unit.
    pub cost: f64,
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Cost {
    Is(f64),
    /// An upper bound: the cheapest rung is better than asked for.
    AtMost(f64),
    /// No rung is good enough.
    Unknown,
}

/// Cost of an error, interpolated between the rungs that no other beats in both error and cost. The
/// interpolation is linear in the logarithms, because the error of random sampling is a power of its cost.
pub fn cost_at(rungs: impl Iterator<Item = Rung>, error: f64) -> Cost {
    let mut sorted: Vec<Rung> = rungs.filter(|rung| rung.error > 0.0 && rung.cost > 0.0).collect();
    sorted.sort_by(|a, b| a.cost.total_cmp(&b.cost).then(a.error.total_cmp(&b.error)));
    let mut front: Vec<Rung> = Vec::new();
    for rung in sorted {
        if front.last().is_none_or(|best| rung.error < best.error) {
            front.push(rung);
        }
    }
    let Some(first) = front.first() else { return Cost::Unknown };
    if error >= first.error {
        return if error == first.error { Cost::Is(first.cost) } else { Cost::AtMost(first.cost) };
    }
    let between = front.windows(2).find(|pair| pair[1].error <= error);
    between.map_or(Cost::Unknown, |pair| {
        let share = (error / pair[0].error).ln() / (pair[1].error / pair[0].error).ln();
        Cost::Is(pair[0].cost * (pair[1].cost / pair[0].cost).powf(share))
    })
}

impl Cost {
    /// `other` over this cost. A lower bound if this is an upper one.
    pub fn ratio(self, other: f64) -> Option<f64> {
        match self {
            Self::Is(cost) | Self::AtMost(cost) => Some(other / cost),
            Self::Unknown => None,
        }
    }

    /// True if ratios to it are lower bounds.
    pub fn is_bound(self) -> bool {
        matches!(self, Self::AtMost(_))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(rungs: &[(f64, f64)], error: f64) -> Cost {
        cost_at(rungs.iter().map(|&(error, cost)| Rung { error, cost }), error)
    }

    #[test]
    fn between_two_rungs_the_cost_is_a_power_of_the_error() {
        // Half the error costs four times as much.
        let rungs = [(0.1, 1.0), (0.025, 16.0)];
        let Cost::Is(cost) = at(&rungs, 0.05) else { panic!() };
        assert!((cost - 4.0).abs() < 1e-12, "{cost}");
        assert_eq!(at(&rungs, 0.1), Cost::Is(1.0));
    }

    #[test]
    fn a_rung_that_another_beats_twice_does_not_count() {
        let rungs = [(0.1, 1.0), (0.2, 3.0), (0.09, 9.0), (0.025, 16.0), (0.03, 500.0)];
        let Cost::Is(cost) = at(&rungs, 0.025) else { panic!() };
        assert_eq!(cost, 16.0);
        assert_eq!(at(&rungs, 0.02), Cost::Unknown);
    }

    #[test]
    fn beyond_the_worst_rung_its_cost_is_a_bound_and_so_is_a_ratio_to_it() {
        let cost = at(&[(0.1, 2.0), (0.05, 8.0)], 0.4);
        assert_eq!(cost, Cost::AtMost(2.0));
        assert_eq!((cost.ratio(10.0), cost.is_bound()), (Some(5.0), true));
        assert_eq!(at(&[], 0.4), Cost::Unknown);
        assert_eq!(Cost::Unknown.ratio(1.0), None);
    }
}
