//! The track record as a picture.

use forelight_forecast::share_interval;
use forelight_plots::{Area, Drawn, PlotError, svg};
use forelight_protocol::{Coverage, QuantileHits, TrackRecord};
use forelight_store::FinishedJob;
use plotters::prelude::*;

use super::chart::{CALIBRATED, FORMULAS, GREY, SIZE, legend};

/// Larger errors are drawn at the edge.
const LARGEST_ERROR: f64 = 1.0;
/// Smallest range of the error axis, so that good forecasts look good.
const LEAST_RANGE: f64 = 0.1;

/// The reliability diagram of all finished frames and jobs, and the errors of `jobs`, oldest first.
pub(crate) fn track_record(record: &TrackRecord, jobs: &[FinishedJob]) -> Result<String, PlotError> {
    svg(SIZE, |area| {
        let (left, right) = area.split_horizontally(SIZE.1 as i32);
        reliability(&left, record)?;
        errors(&right, jobs)
    })
}

#[derive(Default)]
struct Hits {
    count: u64,
    hits: [u64; 3],
}

impl Hits {
    fn add(&mut self, coverage: &Coverage, of: fn(&Coverage) -> QuantileHits) {
        let QuantileHits { p50, p80, p95 } = of(coverage);
        self.count += coverage.count;
        self.hits.iter_mut().zip([p50, p80, p95]).for_each(|(sum, hits)| *sum += hits);
    }
}

fn reliability(area: &Area<'_>, record: &TrackRecord) -> Drawn {
    let mut chart = ChartBuilder::on(area)
        .caption("Promised and kept", ("sans-serif", 17))
        .margin(12)
        .x_label_area_size(40)
        .y_label_area_size(48)
        .build_cartesian_2d(0.4..1.0, 0.0..1.02)?;
    let percent = |share: &f64| format!("{:.0} %", share * 100.0);
    chart
        .configure_mesh()
        .max_light_lines(0)
        .bold_line_style(GREY)
        .x_desc("truths promised at or below the quantile")
        .y_desc("truths that were")
        .x_label_formatter(&percent)
        .y_label_formatter(&percent)
        .draw()?;
    chart.draw_series([PathElement::new([(0.4, 0.4), (1.0, 1.0)], BLACK.mix(0.5))])?;
    for calibrated in [false, true] {
        let kinds = || record.kinds.iter().filter(|kind| kind.calibrated == calibrated);
        let mut series: [(&str, Hits); 4] =
            ["work of jobs", "CPU time of jobs", "work of frames", "CPU time of frames"]
                .map(|name| (name, Hits::default()));
        for kind in kinds() {
            let [job_work, job_cpu, frame_work, frame_cpu] = &mut series;
            job_work.1.add(&kind.jobs, |coverage| coverage.work_hits);
            job_cpu.1.add(&kind.jobs, |coverage| coverage.cpu_hits);
            frame_work.1.add(&kind.frames, |coverage| coverage.work_hits);
            frame_cpu.1.add(&kind.frames, |coverage| coverage.cpu_hits);
        }
        let colour = if calibrated { CALIBRATED } else { FORMULAS };
        for (place, (name, Hits { count, hits })) in
            series.iter().enumerate().filter(|(_, (_, h))| h.count > 0)
        {
            // Frames share their job's error, so an interval for frames would be too narrow.
            let of_jobs = place < 2;
            let thin = colour.mix(if of_jobs { 1.0 } else { 0.45 });
            let shares = [0.50, 0.80, 0.95].into_iter().zip(hits).map(|(promised, &hits)| {
                (promised + 0.006 * (place as f64 - 1.5), hits as f64 / *count as f64)
            });
            let shares: Vec<(f64, f64)> = shares.collect();
            let calibration = if calibrated { "calibrated" } else { "not calibrated" };
            let unit = if of_jobs { "jobs" } else { "frames" };
            let style = thin.stroke_width(if of_jobs { 2 } else { 1 });
            chart
                .draw_series([PathElement::new(shares.clone(), style)])?
                .label(format!("{name}, {calibration}: {count} {unit}"))
                .legend(move |(x, y)| PathElement::new([(x, y), (x + 20, y)], style));
            chart.draw_series(shares.iter().map(|&point| {
                Circle::new(point, if place.is_multiple_of(2) { 4 } else { 2 }, thin.filled())
            }))?;
            if of_jobs {
                chart.draw_series(shares.iter().map(|&(at, share)| {
                    let (low, high) = share_interval(share, *count as f64);
                    PathElement::new([(at, low), (at, high)], colour.mix(0.6))
                }))?;
            }
        }
    }
    if record.kinds.iter().any(|kind| kind.frames.count > 0) {
        legend(&mut chart, SeriesLabelPosition::LowerRight)?;
    }
    Ok(())
}

fn errors(area: &Area<'_>, jobs: &[FinishedJob]) -> Drawn {
    let clipped = |error: f64| error.clamp(-LARGEST_ERROR, LARGEST_ERROR);
    let all = jobs.iter().flat_map(|job| [job.work_error, job.cpu_error]).flatten().map(clipped);
    let range = all.fold(LEAST_RANGE, |range, error| range.max(1.1 * error.abs()));
    let period = match jobs {
        [first, .., last] => format!("finished jobs, from {} to {}", first.finished, last.finished),
        [only] => format!("finished jobs: one, at {}", only.finished),
        [] => "finished jobs: none".to_owned(),
    };
    let mut chart = ChartBuilder::on(area)
        .caption("Errors of jobs over time", ("sans-serif", 17))
        .margin(12)
        .x_label_area_size(40)
        .y_label_area_size(52)
        .build_cartesian_2d(0.0..jobs.len() as f64 + 1.0, -range..range)?;
    chart
        .configure_mesh()
        .max_light_lines(0)
        .bold_line_style(GREY)
        .x_desc(period)
        .y_desc("forecast over actual, less one")
        .x_label_formatter(&|job| format!("{job:.0}"))
        .y_label_formatter(&|error| format!("{:+.0} %", error * 100.0))
        .draw()?;
    chart.draw_series([PathElement::new([(0.0, 0.0), (jobs.len() as f64 + 1.0, 0.0)], BLACK.mix(0.5))])?;
    type Of = fn(&FinishedJob) -> Option<f64>;
    for (name, of, size) in
        [("CPU time", (|job| job.cpu_error) as Of, 2), ("work", (|job| job.work_error) as Of, 4)]
    {
        for calibrated in [false, true] {
            let colour = if calibrated { CALIBRATED } else { FORMULAS };
            let points: Vec<(f64, f64)> = jobs
                .iter()
                .zip(1..)
                .filter(|(job, _)| job.calibrated == calibrated)
                .filter_map(|(job, place)| Some((f64::from(place), clipped(of(job)?))))
                .collect();
            if points.is_empty() {
                continue;
            }
            let calibration = if calibrated { "calibrated" } else { "not calibrated" };
            chart
                .draw_series(
                    points.into_iter().map(|point| Circle::new(point, size, colour.mix(0.8).filled())),
                )?
                .label(format!("{name}, {calibration}"))
                .legend(move |(x, y)| Circle::new((x + 10, y), size, colour.mix(0.8).filled()));
        }
    }
    if !jobs.is_empty() {
        legend(&mut chart, SeriesLabelPosition::UpperRight)?;
    }
    Ok(())
}
