//! The ladders as text.

use super::{thousandths, value};
use forelight_protocol::words::counted;
use forelight_protocol::{
    AccuracyDoc, AccuracyRung, CacheMode, ImageError, Integrator, LadderKind, RenderSettings,
};
use forelight_terminal::quantities::{count, percent, seconds};
use forelight_terminal::table::{Align, Table};

/// A table for each ladder, and a summary of the profiles.
pub fn text(document: &AccuracyDoc) -> String {
    let frames = match document.frames {
        1 => String::new(),
        frames => format!(", {frames} frames"),
    };
    let mut text = format!("asked for: {}{frames}\n", described(&document.settings));
    for kind in LadderKind::ALL {
        let rungs: Vec<usize> =
            (0..document.rungs.len()).filter(|&rung| document.rungs[rung].ladder == kind).collect();
        if !rungs.is_empty() {
            text += &format!("\n{}\n{}", heading(kind, &document.settings), ladder(document, &rungs));
        }
    }
    for missing in &document.missing {
        text += &format!("\n{}: {}\n", words(missing.ladder), missing.reason);
    }
    let spent = &document.spent;
    text += &format!(
        "\n* worth taking: no other rung is both cheaper and better; `next` is the cost of the next better one.\n\
         {} pixels were profiled, with {} of CPU time: {:.1} % of the work of {} as asked for.\n\
         {}.\n",
        document.profiled.pixels,
        seconds(spent.cpu_seconds),
        spent.fraction_of_forecast * 100.0,
        if document.frames == 1 { "one frame" } else { "all frames" },
        if document.calibrated { "Intervals are calibrated" } else { "Intervals are not calibrated" },
    );
    text
}

fn ladder(document: &AccuracyDoc, rungs: &[usize]) -> String {
    let measured = rungs.iter().any(|&rung| document.rungs[rung].measured.is_some());
    let mut head = vec![
        ("", Align::Left),
        ("", Align::Left),
        ("work", Align::Right),
        ("CPU P50", Align::Right),
        ("P80", Align::Right),
        ("P95", Align::Right),
        ("error P50", Align::Right),
        ("5 % to 95 %", Align::Right),
    ];
    let denoised = rungs.iter().any(|&rung| document.rungs[rung].denoised_error.is_some());
    if denoised {
        head.extend([("denoised P50", Align::Right), ("5 % to 95 %", Align::Right)]);
    }
    if measured {
        head.extend([
            ("true work", Align::Right),
            ("true CPU", Align::Right),
            ("true error", Align::Right),
            ("off by", Align::Right),
        ]);
    }
    let denoising = rungs.iter().any(|&rung| truth_denoised(&document.rungs[rung]).is_some());
    if denoising {
        head.extend([
            ("of which denoising", Align::Right),
            ("true error denoised", Align::Right),
            ("off by", Align::Right),
        ]);
    }
    head.push(("next", Align::Left));
    let mut table = Table::new(&head);
    for &index in rungs {
        let rung = &document.rungs[index];
        let mut cells = vec![
            if rung.worth_taking { "*" } else { "" }.to_owned(),
            value(document, index) + if rung.asked_for { " (asked for)" } else { "" },
            count(rung.work.p50),
            seconds(rung.cpu_seconds.p50),
            seconds(rung.cpu_seconds.p80),
            seconds(rung.cpu_seconds.p95),
        ];
        cells.extend(forecast(rung.error));
        if denoised {
            cells.extend(forecast(rung.denoised_error));
        }
        if measured {
            cells.extend(truth(rung));
        }
        if denoising {
            cells.extend(truth_denoised(rung).unwrap_or_default());
        }
        cells.push(next(document, rung));
        table.row(cells);
    }
    table.render()
}

/// A forecast error with its interval.
fn forecast(error: Option<ImageError>) -> [String; 2] {
    match error {
        Some(error) => [share(error.p50), format!("{} to {}", share(error.p05), share(error.p95))],
        None => ["-".to_owned(), String::new()],
    }
}

fn truth(rung: &AccuracyRung) -> [String; 4] {
    let Some(measured) = rung.measured else { return Default::default() };
    [
        count(measured.work as f64),
        seconds(measured.delivered().0),
        error_or_bound(measured.error, measured.error_deviation),
        off_by(rung.error, measured.error, measured.error_deviation),
    ]
}

/// CPU time of removing the noise, the error that is left, and how far off its forecast was.
fn truth_denoised(rung: &AccuracyRung) -> Option<[String; 3]> {
    let denoised = rung.measured?.denoised?;
    Some([
        seconds(denoised.cpu_seconds),
        error_or_bound(denoised.error, denoised.error_deviation),
        off_by(rung.denoised_error, denoised.error, denoised.error_deviation),
    ])
}

/// How far a forecast is off, if the true error shows.
fn off_by(forecast: Option<ImageError>, truth: f64, deviation: f64) -> String {
    let off = forecast.filter(|_| truth > deviation).map(|error| error.p50 / truth - 1.0);
    off.map_or("-".into(), percent)
}

/// An error, or what it is below if the converged image has too few samples to show it.
fn error_or_bound(error: f64, deviation: f64) -> String {
    if error > deviation { share(error) } else { format!("< {}", share(deviation.max(error))) }
}

fn words(ladder: LadderKind) -> String {
    ladder.name().replace('_', " ")
}

/// The cost of the next better rung that is worth taking.
fn next(document: &AccuracyDoc, rung: &AccuracyRung) -> String {
    let Some(next) = rung.next else { return String::new() };
    let index = next.rung as usize;
    format!(
        "{:.1} x the time (+{}) for {:.2} x the error: {}, {}",
        next.times_cpu_seconds,
        seconds(next.more_cpu_seconds),
        next.times_error,
        words(document.rungs[index].ladder),
        value(document, index),
    )
}

fn heading(kind: LadderKind, asked: &RenderSettings) -> String {
    match kind {
        LadderKind::Ambient => {
            format!("camera samples, integrator ambient, gathers of {} rays", asked.ambient_divisions)
        }
        LadderKind::Path => "camera samples, integrator path".to_owned(),
        LadderKind::CachedSamples => {
            format!("camera samples, with an irradiance cache of {} rays a record", asked.cache_rays)
        }
        LadderKind::Cache => {
            format!("accuracy of the irradiance cache, {} spp, {} rays a record", asked.spp, asked.cache_rays)
        }
        LadderKind::Divisions => format!("rays of a gather, {} spp", asked.spp),
        LadderKind::Resolution => {
            "resolution: each image is compared with its own converged image".to_owned()
        }
    }
}

fn described(settings: &RenderSettings) -> String {
    let light = match (settings.integrator, settings.cache) {
        (Integrator::Path, _) => "path".to_owned(),
        (Integrator::Ambient, CacheMode::Off) => {
            format!("ambient, gathers of {} rays", settings.ambient_divisions)
        }
        (Integrator::Ambient, CacheMode::On) => {
            format!("ambient, a cache of error {}", thousandths(settings.cache_accuracy))
        }
    };
    format!(
        "{} x {}, {} spp, {light}, {}",
        settings.width,
        settings.height,
        settings.spp,
        counted(settings.ambient_bounces, "bounce")
    )
}

fn share(fraction: f64) -> String {
    format!("{:.2} %", fraction * 100.0)
}
