use super::measured::{Measured, Outcome};
use crate::report::Report;
use forelight_protocol::CacheMode;
use forelight_terminal::quantities::{count, seconds};
use forelight_terminal::table::{Align, Table};

/// All shots, each with its forecast and current practice.
pub fn of(shots: &[Measured]) -> Report {
    let head = [
        ("shot", Align::Left),
        ("said by", Align::Left),
        ("|error| of all", Align::Right),
        ("of a frame", Align::Right),
        ("takes", Align::Right),
        ("not reused", Align::Right),
        ("error / f-m-l", Align::Right),
    ];
    let mut table = Table::new(&head);
    for shot in shots {
        let ratio = shot.against_first_middle_last().map_or("-".into(), |ratio| format!("{ratio:.2}"));
        table.row(row(&shot.bundle, "the forecast", &shot.forecast, Some(&shot.forecast)).chain([ratio]));
        for other in &shot.practices {
            table.row(row("", other.practice.title(), &other.outcome, None));
        }
    }
    let mut text = String::from("\n");
    for shot in shots {
        text += &line(shot);
    }
    text += "Errors are of work; of a frame: all frames' errors over all frames' work. f-m-l: the mean of the first, the middle and the last frame.\n";
    Report::default().table(table).text(text)
}

fn row<'a>(
    shot: &'a str,
    name: &'a str,
    outcome: &Outcome,
    for_good: Option<&Outcome>,
) -> impl Iterator<Item = String> + use<> {
    let share = |fraction: f64| format!("{:.2} %", fraction * 100.0);
    [
        shot.to_owned(),
        name.to_owned(),
        share(outcome.total_error),
        share(outcome.wape),
        share(outcome.spent),
        for_good.map_or(String::new(), |outcome| share(outcome.spent_for_good)),
    ]
    .into_iter()
}

fn line(shot: &Measured) -> String {
    let Measured { bundle, width, height, spp, ambient_bounces, samples, .. } = shot;
    let cache = if shot.cache == CacheMode::On { ", cached" } else { "" };
    let profiled: Vec<String> = shot
        .quotes
        .first()
        .map(|quote| quote.profiled.iter().map(u32::to_string).collect())
        .unwrap_or_default();
    let (error, within) = shot.quotes.first().map_or((0.0, [0.0; 2]), |quote| {
        (quote.frame_error_cpu_seconds, [quote.frames_within_p80, quote.frames_within_p95])
    });
    format!(
        "{bundle}: {} frames of {width} x {height}, {spp} samples, {ambient_bounces} bounces{cache}: {} of work, {}; {} quotes of {samples} pixels in frames {}; \
         {:.0} % of frames at or below P80, {:.0} % P95; CPU time of a frame off by {:.1} %\n",
        shot.frames.len(),
        count(shot.actual_work),
        seconds(shot.actual_cpu_seconds),
        shot.quotes.len(),
        profiled.join(" "),
        within[0] * 100.0,
        within[1] * 100.0,
        error * 100.0,
    )
}
