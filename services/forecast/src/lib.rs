//! Forecasts the cost of a frame, and of a shot, from a few traced pixels and a preview of all pixels.
//!
//! The preview shows which (object, material) pair every pixel of every frame belongs to. These pairs are the
//! *strata*, with exactly known pixel counts N_h. A few pixels are traced, and their cost is measured. This
//! crate chooses the pixels, and estimates all other costs from them. It is pure: no I/O, no clock, and
//! random numbers only from a seed that the caller passes in. It does not know how light is traced.
//!
//! # The method
//!
//! **Groups** (`strata`). Strata that are too small to be sampled are joined by material, until every group
//! can have two samples. The joined pixels are sampled together with equal probability, so small objects
//! cause no bias (collapsed strata: Cochran, *Sampling Techniques*, 3rd edition 1977, section 5A.12).
//!
//! **How many samples** ([`allocate()`]). The variance of a stratified total is Σ N_h² (1 − n_h/N_h) S_h² /
//! n_h. For a fixed number of samples it is least for n_h ∝ N_h S_h (Neyman 1934). In whole numbers, each
//! further sample goes to the stratum with the greatest N_h S_h / √(n_h (n_h + 1)) (Wright 2012).
//!
//! **Which pixels** ([`FrameDesign`]). The pixels of a group are ordered along a Hilbert curve. The picks are
//! the Kronecker sequence (u + i φ) mod 1 along it: evenly spread, every pixel equally likely, and
//! extensible. There are two phases. The first spends half of the samples by expected cost, the second the
//! rest by measured spread.
//!
//! **One frame** ([`estimate()`]). The total is Ŷ = Σ N_g ȳ_g. Its variance v is as above, with s_g² for
//! S_g², and with degrees of freedom after Satterthwaite (1946). Quantiles are Ŷ exp(t_p σ) with σ² = ln(1 +
//! v / Ŷ²), a log-t interval. The variance includes a tail allowance: the squared influence of the most
//! influential pixel. Groups with fewer than two samples borrow from related groups, with the weight λ = τ² /
//! (τ² + σ² / n) for their own mean. Such groups are counted.
//!
//! **A shot** ([`choose_frames`], [`forecast_shot`]). A few frames are profiled. They are chosen so that
//! every important stratum is near in time to a profiled frame that shows it (k-median). Other frames have
//! the estimate ŷ_t = Σ N_h,t ĉ_h(t), with unit costs carried over time. All frames depend on the same
//! samples, so their errors are added before they are squared. The drift of unit costs between profiled
//! frames is a random walk that is pinned at each of them. Its time (`shot_clock`) runs faster where the
//! picture changes faster, so that nothing is carried across a cut. If the forecast of the shot is uncertain
//! and profiling is cheap, more frames are profiled ([`choose_more_frames`]). The error that the frames of a
//! job share is [`ShotForecast::job_sigma`].
//!
//! **While a job is rendered** ([`live()`]). Finished frames have known costs, and tell how far the quote of
//! the others is off. The model is a Gaussian process over the shot's clock, with a common factor and a
//! nugget. It takes time linear in the number of frames.
//!
//! **Cache records** ([`RecordStrata`]). With an irradiance cache, most of the cost of a frame is in the
//! records. Their number is known from planning the cache. The records of each level are a stratum that
//! stands apart from the pixels ([`Stratum::apart`]).
//!
//! **Image error** ([`accuracy`]). The same few pixels tell how far the image will be from the converged
//! image, at any number of camera samples. [`accuracy::front`] finds the qualities that are worth their cost.
//!
//! **Strategies** ([`Strategy`]). The seven strategies that the paper compares have the same interface, so
//! any of them can make a quote. Six of them do not use the preview. `forelight bench paper` measures how
//! their errors differ.
//!
//! # Bias and coverage
//!
//! The number of samples of a group depends slightly on the costs seen first, and this biases the pooled
//! mean. If the first picks of a group happened to be cheap, it gets fewer further picks to correct them. So
//! the second phase does not use the spread of the group itself. It uses the spread of the material, shrunk
//! towards the overall spread while the material has few picks. The tests hold the bias at these values:
//!
//! | costs | second phase by the group's own spread | as implemented |
//! | --- | --- | --- |
//! | smooth pictures with shadow edges and lognormal noise | −2 to −3 % | −0.6 ± 0.2 % |
//! | lognormal noise only | −2 to −3 % | −0.4 ± 0.2 % |
//! | heavy tails | −10 % | −5 % |
//!
//! The first of these columns used half the group's own spread and half that of its material. A design
//! without such a bias must give each phase a fixed weight. It is no more accurate than a design that ignores
//! costs.
//!
//! Measured with 256 samples on pictures of 57 objects:
//!
//! | costs | mean absolute error | coverage of P80 | coverage of P95 |
//! | --- | --- | --- | --- |
//! | smooth, as above | 2 to 3 % | 80 % | 96 % |
//! | 1 to 5 % of some materials' pixels cost 10 to 40 times as much | 9 % | | 70 to 80 % |
//!
//! No formula can account for costs that no sample has met. Such pixels should be strata of their own, with a
//! prior cost that attracts samples. The preview can tell, for example, glass and mirrors.
//!
//! Without past jobs, [`Calibration::NONE`] widens intervals by the factor 1.3, and the forecast is marked as
//! not calibrated. Once [`LEAST_JOBS`] jobs of the same kind are finished, [`Experience`] gives the
//! calibrated quantiles, and [`ShotForecast::corrected`] applies them. These hold even if the formulas are
//! wrong. The cost of a single pixel has quantiles too, from the profiled pixels of its frame
//! ([`PixelCosts`]).
//!
//! # Use
//! ```
//! use forelight_forecast::{Calibration, Cost, FrameDesign, Observation, Pick, Stratum, estimate};
//!
//! // A wall and a vase on it, as the preview shows them, in rows of 16 pixels.
//! let strata = [
//!     Stratum { object: 0, material: 0, prior_cost: 1.0, apart: false },
//!     Stratum { object: 1, material: 1, prior_cost: 4.0, apart: false },
//! ];
//! let ids: Vec<u32> = (0..256).map(|pixel| u32::from((100..140).contains(&pixel))).collect();
//! let trace = |picks: &[Pick]| -> Vec<Observation> {
//!     let work = |stratum| if stratum == 1 { 900 } else { 100 };
//!     picks
//!         .iter()
//!         .map(|p| {
//!             let cost = Cost { work: work(p.stratum), ..Cost::default() };
//!             Observation { stratum: p.stratum, cost }
//!         })
//!         .collect()
//! };
//!
//! let design = FrameDesign::new(&strata, &ids, 16, 24, 7, 0)?;
//! let mut observations = trace(&design.first_phase());
//! observations.extend(trace(&design.second_phase(&observations)?));
//! let forecast = estimate(&strata, design.counts(), &observations, Calibration::NONE)?;
//! assert_eq!(forecast.total.work.mean, 216.0 * 100.0 + 40.0 * 900.0);
//! # Ok::<(), forelight_forecast::ForecastError>(())
//! ```

pub mod accuracy;
mod allocate;
mod binomial;
mod conformal;
mod cost;
mod drift;
mod error;
mod estimate;
mod expansion;
mod frame_choice;
mod frame_design;
mod hilbert;
mod interval;
mod known_costs;
mod live;
mod moments;
mod nearest;
mod pixel_costs;
mod population;
mod random;
mod rates;
mod record_strata;
mod shot;
mod shot_clock;
mod strata;
mod strategies;
mod stratum_sum;
mod student;

pub use allocate::{Cell, allocate};
pub use binomial::share_interval;
pub use conformal::{Correction, Corrections, Experience, LEAST_JOBS, Measure, Past, residual};
pub use cost::{Cost, Costs, Observation, Quantity, RAY_KINDS};
pub use error::ForecastError;
pub use estimate::{FrameEstimate, StratumEstimate, estimate};
pub use expansion::Expansion;
pub use frame_choice::{FIRST_FRAMES, MOST_FRAMES, choose_frames, choose_more_frames};
pub use frame_design::{FrameDesign, Pick};
pub use interval::Calibration;
pub use known_costs::with_times;
pub use live::{Band, Known, Live, LiveFrame, live, shot_times};
pub use nearest::nearest;
pub use pixel_costs::{PixelCosts, PixelQuantiles};
pub use population::FramePopulation;
pub use rates::{Timed, class_rates, learned_factor, log_ratio_millionths};
pub use record_strata::RecordStrata;
pub use shot::{FrameForecast, ProfiledFrame, ShotForecast, forecast_shot};
pub use strata::Stratum;
pub use strategies::{Classes, Design, Strategy};
pub use stratum_sum::StratumSum;
pub use student::student_two_sided;
