//! Which rungs of a ladder are worth taking.

/// What a rung costs and how far it is from what is wanted; both in any unit, the same for all rungs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// What it costs.
    pub cost: f64,
    /// Its error.
    pub error: f64,
}

/// A rung of the front, and the way to the next one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// Index of the rung.
    pub rung: usize,
    /// Index of the next better one on the front; none for the best.
    pub next: Option<usize>,
}

/// [`front`] of rungs given by cost and error, some of which are not known and so never on it: pairs of a rung's index and that of the
/// next better one.
pub fn front_of_known(points: &[Option<(f64, f64)>]) -> Vec<(usize, Option<usize>)> {
    let far = Point { cost: f64::INFINITY, error: f64::INFINITY };
    let points: Vec<Point> =
        points.iter().map(|point| point.map_or(far, |(cost, error)| Point { cost, error })).collect();
    front(&points).into_iter().map(|step| (step.rung, step.next)).collect()
}

/// The Pareto front by rising cost: rungs that no other beats in one of cost and error without losing in the other. Of rungs that
/// are alike in both the first is taken, and none whose numbers are not finite.
pub fn front(points: &[Point]) -> Vec<Step> {
    let mut order: Vec<usize> =
        (0..points.len()).filter(|&i| points[i].cost.is_finite() && points[i].error.is_finite()).collect();
    order.sort_by(|&a, &b| {
        let (one, other) = (&points[a], &points[b]);
        one.cost.total_cmp(&other.cost).then(one.error.total_cmp(&other.error)).then(a.cmp(&b))
    });
    let mut rungs: Vec<usize> = Vec::new();
    for rung in order {
        if rungs.last().is_none_or(|&best| points[rung].error < points[best].error) {
            rungs.push(rung);
        }
    }
    let next = rungs.iter().skip(1).copied().map(Some).chain([None]);
    rungs.iter().copied().zip(next).map(|(rung, next)| Step { rung, next }).collect()
}
