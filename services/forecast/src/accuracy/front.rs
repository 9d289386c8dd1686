//! The Pareto front of a ladder of qualities: which of them are worth their cost.

/// Cost and error of a rung of the ladder, each in a unit that all rungs share.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// Cost.
    pub cost: f64,
    /// Error.
    pub error: f64,
}

/// A rung on the front, and the next better one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// Index of the rung.
    pub rung: usize,
    /// Index of the next better rung on the front. `None` for the best one.
    pub next: Option<usize>,
}

/// [`front`] of rungs given as (cost, error), where known. Returns indices of a rung and the next better one.
pub fn front_of_known(points: &[Option<(f64, f64)>]) -> Vec<(usize, Option<usize>)> {
    let far = Point { cost: f64::INFINITY, error: f64::INFINITY };
    let points: Vec<Point> =
        points.iter().map(|point| point.map_or(far, |(cost, error)| Point { cost, error })).collect();
    front(&points).into_iter().map(|step| (step.rung, step.next)).collect()
}

/// An error that is not smaller by this share is no better: nobody sees it, and no estimate is that sure.
const SEEN: f64 = 0.01;

/// The Pareto front, by rising cost. Of rungs that are equally good, the cheapest is taken. Non-finite numbers are
/// left out.
pub fn front(points: &[Point]) -> Vec<Step> {
    let mut order: Vec<usize> =
        (0..points.len()).filter(|&i| points[i].cost.is_finite() && points[i].error.is_finite()).collect();
    order.sort_by(|&a, &b| {
        let (one, other) = (&points[a], &points[b]);
        one.cost.total_cmp(&other.cost).then(one.error.total_cmp(&other.error)).then(a.cmp(&b))
    });
    let mut rungs: Vec<usize> = Vec::new();
    for rung in order {
        if rungs.last().is_none_or(|&best| points[rung].error < (1.0 - SEEN) * points[best].error) {
            rungs.push(rung);
        }
    }
    let next = rungs.iter().skip(1).copied().map(Some).chain([None]);
    rungs.iter().copied().zip(next).map(|(rung, next)| Step { rung, next }).collect()
}
