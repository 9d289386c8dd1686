//! Forecasts the cost of a frame, and of a shot, from a few traced pixels and a preview of all pixels.
//!
//! The preview shows which (object, material) pair every pixel of every frame belongs to. These pairs are the
//! *strata*, with exactly known pixel counts N_h. This crate chooses a few pixels to trace, and estimates all
//! other costs from theirs. It is pure: no I/O, no clock, random numbers only from the caller's seed.
//!
//! # The method
//!
//! **Groups** (`strata`). Strata that are too small to be sampled are joined by material and sampled together
//! with equal probability, so small objects cause no bias (collapsed strata: Cochran, *Sampling Techniques*,
//! 3rd edition 1977, section 5A.12).
//!
//! **How many samples** ([`allocate()`]). The variance of a stratified total is Σ N_h² (1 − n_h/N_h) S_h² /
//! n_h, least for n_h ∝ N_h S_h (Neyman 1934). In whole numbers, each further sample goes to the stratum with
//! the greatest N_h S_h / √(n_h (n_h + 1)) (Wright 2012).
//!
//! **Which pixels** ([`FrameDesign`]). The picks of a group are the Kronecker sequence (u + i φ) mod 1 along
//! a Hilbert curve: evenly spread, every pixel equally likely, extensible. There are two phases: half of the
//! samples by expected cost, the rest by measured spread.
//!
//! **One frame** ([`estimate()`]). The total is Ŷ = Σ N_g ȳ_g. Its variance v is as above, with s_g² for
//! S_g², degrees of freedom after Satterthwaite (1946), and the squared influence of the most influential
//! pixel. Quantiles are Ŷ exp(t_p σ) with σ² = ln(1 + v / Ŷ²), a log-t interval. Groups with fewer than two
//! samples borrow from related groups, with the weight λ = τ² / (τ² + σ² / n) for their own mean.
//!
//! **A shot** ([`choose_frames`], [`forecast_shot`]). A few frames are profiled, so that every important
//! stratum is near in time to one that shows it (k-median). Other frames have ŷ_t = Σ N_h,t ĉ_h(t), with unit
//! costs carried over time. Errors that frames share are added before they are squared. The drift of unit
//! costs is a random walk that is pinned at each profiled frame. Its time (`shot_clock`) runs faster where
//! the picture changes faster. More frames are profiled if the forecast is uncertain and profiling is cheap
//! ([`choose_more_frames`]). The error that all frames share is [`ShotForecast::job_sigma`].
//!
//! **A shot from few samples** ([`forecast_sampled_shot`]). A renderer that cannot measure pixels is asked
//! for a few frames at few samples. The cost of a frame is a line in its samples, and the lines are carried
//! over time.
//!
//! **While a job is rendered** ([`live()`]). Finished frames correct the quote of the others: a Gaussian
//! process over the shot's clock, with a common factor and a nugget, in linear time.
//!
//! **Cache records** ([`RecordStrata`]). Their number is known from planning the cache. The records of each
//! level are a stratum that stands apart from the pixels ([`Stratum::apart`]).
//!
//! **Parts of a frame** ([`parts_of_equal_cost`]). Few camera samples along a space-filling curve tell where a
//! frame's parts of equal cost end ([`PixelCurve`], [`probes`]).
//!
//! **Image error** ([`accuracy`]). The same pixels tell how far the image will be from the converged image,
//! at any number of camera samples. [`accuracy::front`] finds the qualities that are worth their cost.
//!
//! **Strategies** ([`Strategy`]). The seven strategies of the paper have the same interface. Six of them do
//! not use the preview. `forelight bench paper` measures how their errors differ.
//!
//! # Bias and coverage
//!
//! The number of samples of a group depends slightly on the costs seen first, which biases the pooled mean.
//! So the second phase uses the spread of the material, not that of the group. The tests hold the bias at
//! these values:
//!
//! | costs | half by the group's own spread | as implemented |
//! | --- | --- | --- |
//! | smooth pictures with shadow edges and lognormal noise | −2 to −3 % | −0.6 ± 0.2 % |
//! | lognormal noise only | −2 to −3 % | −0.4 ± 0.2 % |
//! | heavy tails | −10 % | −5 % |
//!
//! Measured with 256 samples on pictures of 57 objects:
//!
//! | costs | mean absolute error | coverage of P80 | coverage of P95 |
//! | --- | --- | --- | --- |
//! | smooth, as above | 2 to 3 % | 80 % | 96 % |
//! | 1 to 5 % of some materials' pixels cost 10 to 40 times as much | 9 % | | 70 to 80 % |
//!
//! No formula can account for costs that no sample has met. Such pixels should be strata of their own, with a
//! prior cost that attracts samples.
//!
//! Without past jobs, [`Calibration::NONE`] widens intervals by the factor 1.3. Once [`LEAST_JOBS`] jobs of
//! the same kind are finished, [`Experience`] gives calibrated quantiles, which hold even if the formulas are
//! wrong, and [`ShotForecast::corrected`] applies them. [`PixelCosts`] has quantiles of single pixels.
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
mod parts;
mod pixel_costs;
mod population;
mod random;
mod rates;
mod record_strata;
mod sample_line;
mod sampled_shot;
mod shot;
mod shot_clock;
mod size_power;
mod strata;
mod strategies;
mod stratum_sum;
mod student;
mod under_way;

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
pub use parts::{PixelCurve, Probe, Stretch, parts_of_equal_cost, probes, probing_samples};
pub use pixel_costs::{PixelCosts, PixelQuantiles};
pub use population::FramePopulation;
pub use rates::{Timed, class_rates, learned_factor, log_ratio_millionths};
pub use record_strata::RecordStrata;
pub use sample_line::SampleCost;
pub use sampled_shot::{SampledFrame, SampledFrameForecast, SampledShotForecast, forecast_sampled_shot};
pub use shot::{FrameForecast, ProfiledFrame, ShotForecast, forecast_shot};
pub use size_power::{size_power, straightened};
pub use strata::Stratum;
pub use strategies::{Classes, Design, Strategy};
pub use stratum_sum::StratumSum;
pub use student::student_two_sided;
pub use under_way::UnderWay;
