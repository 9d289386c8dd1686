//! A render that keeps to a time limit.
//!
//! Forecasts of work are right to a few per cent. The time per unit of work is less stable, so the render
//! watches its clock. The first pass gives every pixel one sample. Each later pass spends a share of the time
//! left where it lowers the error most ([`crate::adaptive::tiles`]), at the rate of the pass before. Tiles
//! that are not reached in time keep their samples. A pass visits tiles in scattered order.
//!
//! The clock decides only how many samples the pixels get.

use crate::adaptive::allocation::{AllotError, Allotment, Made};
use crate::adaptive::tiles::Tiles;
use crate::answers::{Progress, Step};
use crate::error::RenderError;
use crate::frame::OwnFrame;
use crate::render::seconds;
use forelight_protocol::{BudgetClock, Confidence, WithinStats};
use forelight_scene::Frame;
use forelight_tracer::{Image, Passes, SampleCounts, process_cpu_nanos};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Instant;

/// Share of the time left for the second and third pass, before the time per unit of work is well known.
const CAREFUL: [f64; 2] = [0.25, 0.5];
/// Share of the time left for each later pass.
const BOLD: f64 = 0.9;
/// Least share of the whole time that is worth another pass.
const WORTHWHILE: f64 = 0.01;
/// Share of the whole time reserved for the pixels under way at its end and for assembling the image.
const MARGIN: f64 = 0.015;
/// Reserve for writing, as a multiple of its measured time.
const WRITING: f64 = 1.5;
/// Share of the first pass that must be done before it can be abandoned as late.
const SEEN: f64 = 0.1;
/// The least image may take this many times the given time rather than be discarded.
const LATE: f64 = 1.03;
/// A refusal names this many times the time that was found, since run times vary.
const ENOUGH: f64 = 1.1;
/// Records to gather per level, to estimate the time of all.
const RECORDS: usize = 16;

/// A running clock.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Stopwatch {
    /// Wall time since an instant.
    Wall(Instant),
    /// CPU time of all threads of this process, since it had used this many nanoseconds.
    Cpu(u64),
}

impl Stopwatch {
    /// Seconds since the start.
    pub fn elapsed(&self) -> f64 {
        match self {
            Self::Wall(start) => start.elapsed().as_secs_f64(),
            Self::Cpu(start) => seconds(process_cpu_nanos().saturating_sub(*start)),
        }
    }

    /// The kind of clock.
    pub fn kind(&self) -> BudgetClock {
        match self {
            Self::Wall(_) => BudgetClock::Wall,
            Self::Cpu(_) => BudgetClock::Cpu,
        }
    }

    /// Time on this clock for CPU seconds that all threads of the current pool share.
    fn of_cpu(&self, cpu_seconds: f64) -> f64 {
        match self {
            Self::Wall(_) => cpu_seconds / rayon::current_num_threads() as f64,
            Self::Cpu(_) => cpu_seconds,
        }
    }
}

/// A time that a render must not exceed.
#[derive(Clone, Copy)]
pub struct Budget<'a> {
    /// From the clock's start until the image is written.
    pub seconds: f64,
    /// The time that it has already measured counts too.
    pub clock: Stopwatch,
    /// Writes an image as the finished one will be written. The measured time is reserved for that.
    pub rehearse: &'a (dyn Fn(&Image, &Frame) + Sync),
}

impl Budget<'_> {
    fn too_little(&self, least: f64) -> AllotError {
        AllotError::TooLittle { given: self.seconds, least: least * ENOUGH }
    }
}

/// Plans the frame's irradiance cache and estimates from a few of its records whether filling it fits.
///
/// # Errors
/// If it does not fit.
pub(crate) fn fits_the_cache(ready: &OwnFrame<'_>, budget: &Budget<'_>, seed: u64) -> Result<(), AllotError> {
    let records = ready.sample_records(RECORDS, seed);
    let of_level = |(level, count): (usize, u32)| {
        let costs = records.iter().filter(|record| record.level as usize == level);
        let (number, nanos) = costs.fold((0u64, 0), |(n, sum), record| (n + 1, sum + record.cost.cpu_nanos));
        f64::from(count) * seconds(nanos) / number.max(1) as f64
    };
    let fill: f64 = ready.cache_records().into_iter().enumerate().map(of_level).sum();
    let (given, filled) = (budget.seconds, budget.clock.elapsed() + budget.clock.of_cpu(fill));
    if fill > 0.0 && filled > given { Err(AllotError::TooLittleForCache { given, filled }) } else { Ok(()) }
}

/// Renders a frame, whose cache is filled, in the time that is left. `None` if `cancel` was set.
pub(crate) fn render_within(
    ready: &OwnFrame<'_>,
    allotment: &Allotment<'_>,
    budget: &Budget<'_>,
    confidence: Confidence,
    progress: &(dyn Fn(Progress) + Sync),
    cancel: &AtomicBool,
) -> Result<Option<Made>, AllotError> {
    let clock = &budget.clock;
    let first = allotment.least_work() * allotment.seconds_per_work * allotment.surety(confidence);
    let least = clock.elapsed() + clock.of_cpu(first);
    if least > budget.seconds {
        return Err(budget.too_little(least));
    }
    let mut run = Run::new(ready, budget, progress, cancel);
    let (width, height) = allotment.size();
    let projected =
        run.first_pass(&SampleCounts::new(vec![1; (width * height) as usize]).map_err(RenderError::from)?)?;
    if cancel.load(Ordering::Relaxed) {
        return Ok(None);
    }
    let Ok(mut counts) = run.passes.counts() else {
        return Err(budget.too_little(least.max(projected)));
    };
    run.keep_back_for_writing();
    let tiles = Tiles::new(allotment);
    let mut survey = tiles.survey(&run.passes)?;
    for share in CAREFUL.into_iter().chain(std::iter::repeat(BOLD)) {
        let left = run.end - clock.elapsed();
        if left < WORTHWHILE * budget.seconds || run.rate <= 0.0 {
            break;
        }
        let work = run.passes.totals().work as f64 + share * left / run.rate;
        let Some(wanted) = survey.samples_for_budget(work) else { break };
        let wanted = tiles.laid_out(&wanted)?.or_more(&counts);
        if wanted == counts {
            break;
        }
        run.pass(&wanted)?;
        if cancel.load(Ordering::Relaxed) {
            return Ok(None);
        }
        counts = run.passes.counts().map_err(RenderError::from)?;
        survey = tiles.survey(&run.passes)?;
    }
    let within = WithinStats {
        clock: clock.kind(),
        given_seconds: budget.seconds,
        spent_seconds: clock.elapsed(),
        passes: run.number,
        cost: None,
    };
    let finished = ready.finished(&run.passes);
    Ok(Some(Made { finished, samples: counts, survey, within: Some(within) }))
}

struct Run<'a> {
    ready: &'a OwnFrame<'a>,
    budget: &'a Budget<'a>,
    progress: &'a (dyn Fn(Progress) + Sync),
    cancel: &'a AtomicBool,
    passes: Passes,
    number: u32,
    /// When to stop tracing, on the clock.
    end: f64,
    /// Seconds of the clock per unit of work, in the last pass.
    rate: f64,
    /// When tracing began.
    began: f64,
}

impl<'a> Run<'a> {
    fn new(
        ready: &'a OwnFrame<'a>,
        budget: &'a Budget<'a>,
        progress: &'a (dyn Fn(Progress) + Sync),
        cancel: &'a AtomicBool,
    ) -> Self {
        Self {
            passes: ready.begin(),
            number: 0,
            end: budget.seconds * (1.0 - MARGIN),
            rate: 0.0,
            began: budget.clock.elapsed(),
            ready,
            budget,
            progress,
            cancel,
        }
    }

    /// Gives every pixel its first sample, without which there is no image. Gives up early if it would be too
    /// late; a slight delay is accepted. Returns when the pass ended, or would have.
    fn first_pass(&mut self, wanted: &SampleCounts) -> Result<f64, RenderError> {
        let (clock, began, parts) = (self.budget.clock, self.began, self.passes.parts() as f64);
        let (end, latest) = (self.end, LATE * self.budget.seconds);
        let done = AtomicUsize::new(0);
        let projected = || {
            let share = done.load(Ordering::Relaxed) as f64 / parts;
            let now = clock.elapsed();
            (share, if share > 0.0 { began + (now - began) / share } else { now })
        };
        // Once late, the pass never goes on: an image with holes is useless.
        let late = AtomicBool::new(false);
        let told = || {
            done.fetch_add(1, Ordering::Relaxed);
            // As more is done, the projection is surer and abandoning loses more.
            let (share, at) = projected();
            if share >= SEEN && at > end + (latest - end) * share {
                late.store(true, Ordering::Relaxed);
            }
        };
        let is_late = || late.load(Ordering::Relaxed) || clock.elapsed() > latest;
        self.pass_until(wanted, &is_late, &told)?;
        Ok(projected().1)
    }

    /// Brings the pixels to these numbers of samples, until the time is up.
    fn pass(&mut self, wanted: &SampleCounts) -> Result<(), RenderError> {
        let (clock, end) = (self.budget.clock, self.end);
        self.pass_until(wanted, &|| clock.elapsed() >= end, &|| ())
    }

    /// The same until `is_over`. `done` is called after every part.
    fn pass_until(
        &mut self,
        wanted: &SampleCounts,
        is_over: &(dyn Fn() -> bool + Sync),
        done: &(dyn Fn() + Sync),
    ) -> Result<(), RenderError> {
        let (clock, end, began) = (&self.budget.clock, self.end, self.began);
        let start = clock.elapsed();
        let pixels = wanted.as_slice().len() as u64;
        let shown = || {
            done();
            let share = (clock.elapsed() - began) / (end - began).max(f64::MIN_POSITIVE);
            let done = (pixels as f64 * share.clamp(0.0, 1.0)) as u64;
            (self.progress)(Progress { step: Step::Tracing, done, all: pixels });
        };
        let stop = || self.cancel.load(Ordering::Relaxed) || is_over();
        let took = self.ready.go_on(&mut self.passes, wanted, &stop, &shown)?;
        self.number += 1;
        self.rate = (clock.elapsed() - start) / (took.work as f64).max(1.0);
        Ok(())
    }

    fn keep_back_for_writing(&mut self) {
        let start = self.budget.clock.elapsed();
        if self.end - start < WORTHWHILE * self.budget.seconds {
            return;
        }
        (self.budget.rehearse)(&self.passes.image(), self.ready.frame());
        self.end -= WRITING * (self.budget.clock.elapsed() - start);
    }
}
