//! What a frame, and a shot, will cost, from a handful of traced pixels and a preview of everything.
//!
//! The preview says which (object, material) pair every pixel of every frame shows: the *strata*, with their
//! exact pixel counts N_h. A few pixels are traced and their cost measured. This crate says which pixels, and
//! what follows from them. It is pure: no I/O, no clock, and the only chance in it comes from a seed that is
//! passed in. It knows nothing of light.
//!
//! # The story
//!
//! **Groups** (`strata`). Strata that are too small to deserve samples are joined, by material, until every
//! group can have two. The joined pixels are sampled together, each with the same chance, so that small
//! objects cause no bias (collapsed strata: Cochran, *Sampling Techniques*, 3rd edition 1977, section 5A.12).
//!
//! **How many** ([`allocate`]). The variance of a stratified total is Σ N_h² (1 − n_h/N_h) S_h² / n_h. For a
//! fixed number of samples it is least at n_h ∝ N_h S_h (Neyman 1934); in whole numbers, give each next
//! sample to the greatest N_h S_h / √(n_h (n_h + 1)) (Wright 2012).
//!
//! **Which** ([`FrameDesign`]). Pixels of a group lie along a Hilbert curve, and picks are the Kronecker
//! sequence (u + i φ) mod 1 along it: evenly spread, every pixel equally likely, extensible. Two phases: half
//! of the samples by expected cost, then the rest by what the first ones cost.
//!
//! **One frame** ([`estimate`]). Ŷ = Σ N_g ȳ_g, its variance as above with s_g² for S_g², degrees of freedom
//! after Satterthwaite (1946), and quantiles Ŷ exp(t_p σ) with σ² = ln(1 + v / Ŷ²), a log-t interval. The
//! variance holds a tail allowance: the square of the influence of the most influential pixel. Groups with
//! one sample or none borrow from relatives, λ = τ² / (τ² + σ² / n), and are counted.
//!
//! **A shot** ([`choose_frames`], [`forecast_shot`]). A few frames are profiled, so chosen that what matters
//! is near in time to a frame that shows it (k-median). Others get ŷ_t = Σ N_h,t ĉ_h(t) with unit costs
//! carried over time. All frames rest on the same samples, so their errors are added before they are squared;
//! what drifts between profiled frames is a random walk pinned at each of them, in a time that runs faster where the
//! picture changes faster (`clock`), so that nothing is carried over a cut. Where that leaves the shot unsure and little would be
//! spent, more frames are profiled ([`choose_more_frames`]). The error that a job's frames
//! have in common is [`ShotForecast::job_sigma`].
//!
//! **While it is rendered** ([`live`]). Finished frames are the truth, and say of the others by how much the quote is off: a Gaussian
//! process over the shot's clock, with a factor in common and a nugget, in time linear in the number of frames.
//!
//! **What is not made of pixels** ([`RecordStrata`]). With an irradiance cache most of a frame's cost is in its records, whose
//! number is known from planning them. The records of a level are a stratum that stands apart ([`Stratum::apart`]).
//!
//! **How good** ([`accuracy`]). The same few pixels say how far the image will be from its converged self at any number of camera
//! samples; [`accuracy::front`] says which qualities are worth their cost.
//!
//! **Against what** ([`Strategy`]). The seven strategies that the paper compares stand behind the same door, so that any of them
//! can make a quote; six of them know no preview. How they differ in error is measured by `forelight bench paper`.
//!
//! # How sure
//!
//! The number of samples of a group depends a little on the costs seen first, which biases the pooled mean:
//! strata whose first picks came out cheap get fewer further picks to correct them. Allocating the second
//! phase by each group's own spread (half its own, half that of its material) made this −2 to −3 % on
//! lognormal costs, and −10 % with heavy tails. So it goes by the spread of the material, shrunk towards the
//! overall one as long as few picks speak for it: −0.6 ± 0.2 % on smooth pictures with shadow edges and
//! lognormal noise, −0.4 ± 0.2 % on noise alone, −5 % with tails. The tests hold it there. (A design without
//! such a bias has to give each phase a fixed weight, and is no more accurate than one that never looks at
//! costs.)
//!
//! On such pictures of 57 objects, 256 samples give a mean absolute error of 2 to 3 %, and P80 and P95 hold
//! in 80 and 96 % of cases. Where 1 to 5 % of some materials' pixels cost 10 to 40 times as much, the error
//! is 9 %, and P95 holds in seven or eight cases of ten: no formula can know what no sample met. Such pixels
//! should be strata of their own (glass, mirrors: the preview knows them), with a prior cost that draws
//! samples.
//!
//! While no past job says how well intervals hold, [`Calibration::NONE`] stretches them by 1.3 and the
//! forecast says that it is not calibrated. Once [`LEAST_JOBS`] jobs of the same kind are finished, [`Experience`] says where the
//! quantiles belong, and [`ShotForecast::corrected`] puts them there: these hold whatever is wrong with the formulas. What a single pixel
//! may cost, the profiled ones of its own frame say ([`PixelCosts`]).
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
//!         .map(|p| Observation { stratum: p.stratum, cost: Cost { work: work(p.stratum), ..Cost::default() } })
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
mod choose;
mod clock;
mod conformal;
mod cost;
mod curve;
mod drift;
mod error;
mod estimate;
mod expansion;
mod frames;
mod interval;
mod known;
mod live;
mod moments;
mod nearest;
mod pixel_costs;
mod random;
mod rates;
mod records;
mod shot;
mod strata;
mod strategies;
mod stratum_sum;
mod student;

pub use allocate::{Cell, allocate};
pub use binomial::share_interval;
pub use choose::{FrameDesign, Pick};
pub use conformal::{Correction, Corrections, Experience, LEAST_JOBS, Measure, Past, residual};
pub use cost::{Cost, Costs, Observation, Quantity, RAY_KINDS};
pub use error::ForecastError;
pub use estimate::{FrameEstimate, StratumEstimate, estimate};
pub use expansion::Expansion;
pub use frames::{FIRST_FRAMES, FramePopulation, MOST_FRAMES, choose_frames, choose_more_frames};
pub use interval::Calibration;
pub use known::with_times;
pub use live::{Band, Known, Live, LiveFrame, live, shot_times};
pub use pixel_costs::{PixelCosts, PixelQuantiles};
pub use rates::{Timed, class_rates, learned_factor, log_ratio_millionths};
pub use records::RecordStrata;
pub use shot::{FrameForecast, ProfiledFrame, ShotForecast, forecast_shot};
pub use strata::Stratum;
pub use strategies::{Design, Strategy, predicted_map};
pub use stratum_sum::StratumSum;
pub use student::student_two_sided;
