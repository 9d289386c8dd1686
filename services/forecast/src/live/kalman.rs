//! State-space model of the residuals: transition from frame to frame, update by a finished one (Kalman
//! filter).

/// Variances of the parts of the residuals.
pub(super) struct Model {
    /// √3 over the length of the process.
    pub decay: f64,
    /// Variance of the common factor.
    pub common: f64,
    /// Variance of the factor of each set of lights.
    pub lights: f64,
    /// Variance of the process.
    pub smooth: f64,
    /// Variance of the average frame's nugget.
    pub nugget: f64,
    /// Variance of the logarithm of the job's cost before any observation, according to the quote.
    pub of_job: f64,
}

/// How well a model explains the observations.
pub(super) struct Evidence {
    /// Sum of squared innovations over their variances.
    pub surprise: f64,
    /// Sum of the logarithms of these variances.
    pub log_variances: f64,
}

/// Number of sets of lights that are distinguished. All further sets count as the last one.
pub(super) const SETS: usize = 4;

/// Indices of the state: common factor, process, slope, factors of lights, sum over the remaining pieces.
pub(super) const COMMON: usize = 0;
pub(super) const SMOOTH: usize = 1;
pub(super) const SLOPE: usize = 2;
pub(super) const LIGHTS: usize = 3;
pub(super) const SUM: usize = LIGHTS + SETS;
/// Number of components without the sum; `ALL` includes it.
pub(super) const COMPONENTS: usize = SUM;
const ALL: usize = SUM + 1;

/// Movement of process and slope: the matrix, and the covariance of the process noise.
pub(super) struct Transition {
    pub matrix: [[f64; 2]; 2],
    noise: [[f64; 2]; 2],
}

impl Model {
    /// Transition over a step Δ of the clock: exp(F Δ) = e^(−λΔ) [1 + λΔ, Δ; −λ²Δ, 1 − λΔ], with the noise P∞
    /// − A P∞ Aᵀ and P∞ = σ² diag(1, λ²). The slope is in units of λ.
    pub fn transition(&self, step: f64) -> Transition {
        let x = self.decay * step;
        let fall = libm::exp(-x);
        let matrix = [[fall * (1.0 + x), fall * x], [-fall * x, fall * (1.0 - x)]];
        let kept = |i: usize, j: usize| matrix[i][0] * matrix[j][0] + matrix[i][1] * matrix[j][1];
        let cross = -kept(0, 1) * self.smooth;
        let own = |i| (self.smooth * (1.0 - kept(i, i))).max(0.0);
        Transition { matrix, noise: [[own(0), cross], [cross, own(1)]] }
    }
}

/// The effect of an observation on the state.
pub(super) struct Update {
    pub innovation: f64,
    pub variance: f64,
    pub gain: [f64; COMPONENTS],
}

/// Mean and covariance of the state, given the observations so far.
pub(super) struct State {
    mean: [f64; ALL],
    pub variance: [[f64; ALL]; ALL],
}

impl State {
    /// The state before the first frame.
    pub fn new(model: &Model) -> Self {
        let mut variance = [[0.0; ALL]; ALL];
        variance[COMMON][COMMON] = model.common;
        variance[SMOOTH][SMOOTH] = model.smooth;
        variance[SLOPE][SLOPE] = model.smooth;
        (LIGHTS..SUM).for_each(|set| variance[set][set] = model.lights);
        Self { mean: [0.0; ALL], variance }
    }

    /// Moves on by a step of the clock.
    pub fn advance(&mut self, model: &Model, step: f64) {
        if step <= 0.0 {
            return;
        }
        let Transition { matrix, noise } = model.transition(step);
        let turned = |level: f64, slope: f64| matrix.map(|row| row[0] * level + row[1] * slope);
        [self.mean[SMOOTH], self.mean[SLOPE]] = turned(self.mean[SMOOTH], self.mean[SLOPE]);
        for row in &mut self.variance {
            [row[SMOOTH], row[SLOPE]] = turned(row[SMOOTH], row[SLOPE]);
        }
        for column in 0..ALL {
            let [level, slope] = turned(self.variance[SMOOTH][column], self.variance[SLOPE][column]);
            self.variance[SMOOTH][column] = level;
            self.variance[SLOPE][column] = slope;
        }
        for (i, row) in noise.iter().enumerate() {
            for (j, noise) in row.iter().enumerate() {
                self.variance[SMOOTH + i][SMOOTH + j] += noise;
            }
        }
    }

    /// Expected c + l + g of a frame with these lights.
    pub fn expected(&self, lights: usize) -> f64 {
        self.mean[COMMON] + self.mean[SMOOTH] + self.mean[LIGHTS + lights]
    }

    /// Covariance of c + l + g with all components but the sum.
    pub fn signal(&self, lights: usize) -> [f64; COMPONENTS] {
        let all = self.covariance(lights);
        std::array::from_fn(|i| all[i])
    }

    fn covariance(&self, lights: usize) -> [f64; ALL] {
        self.variance.map(|row| row[COMMON] + row[SMOOTH] + row[LIGHTS + lights])
    }

    /// Observes that c + l + g of a frame with these lights is `residual`, with the error variance `noise`.
    pub fn update(&mut self, lights: usize, residual: f64, noise: f64) -> Update {
        let signal = self.covariance(lights);
        let variance = signal[COMMON] + signal[SMOOTH] + signal[LIGHTS + lights] + noise;
        let innovation = residual - self.expected(lights);
        for (mean, signal) in self.mean.iter_mut().zip(&signal) {
            *mean += signal / variance * innovation;
        }
        for (row, of_row) in self.variance.iter_mut().zip(&signal) {
            for (entry, of_column) in row.iter_mut().zip(&signal) {
                *entry -= of_row * of_column / variance;
            }
        }
        Update { innovation, variance, gain: std::array::from_fn(|i| signal[i] / variance) }
    }

    /// Adds c + l + g of a frame with these lights, times `weight`, to the sum.
    pub fn accumulate(&mut self, lights: usize, weight: f64) {
        self.mean[SUM] += weight * self.expected(lights);
        let row = self.covariance(lights).map(|covariance| weight * covariance);
        for (entry, more) in self.variance[SUM].iter_mut().zip(row) {
            *entry += more;
        }
        for row in &mut self.variance {
            row[SUM] += weight * (row[COMMON] + row[SMOOTH] + row[LIGHTS + lights]);
        }
    }
}
