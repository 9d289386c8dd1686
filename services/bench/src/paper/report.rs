//! Writes the report in Markdown, and its summary for a terminal.

use super::figures::{Shown, map_file, mapped, positions_file};
use super::printed;
use super::study::{LevelStudy, Study};
use super::trial::{Columns, Outcome, Score};
use crate::report::Report;
use crate::statistics::relative_error;
use forelight_forecast::Strategy;
use forelight_terminal::quantities::{count, percent, seconds};
use forelight_terminal::table::{Align, Table};
use std::fmt::Write;

const COLUMNS: usize = 3;

/// The whole report. Each study comes with the folder of its pictures.
pub fn markdown(studies: &[(String, Study)]) -> String {
    let mut text = String::from(INTRODUCTION);
    text += "\n## In short\n\nRoot mean square error of a frame's work over the seeds, in percent. \
             *Best blind* is the best of the six strategies that know no preview. With a cache all but ours are as in the paper: \
             they cannot know the records. The *noise floor* is what would be left with all known but the noise between neighbouring \
             pixels of one surface, and the best possible allocation.\n\n";
    text += &short(studies.iter().map(|(_, study)| study)).markdown();
    for (folder, study) in studies {
        scene(&mut text, folder, study);
    }
    text
}

/// The short table for a terminal.
pub fn summary(studies: &[Study]) -> Report {
    Report::default().table(short(studies.iter()))
}

const INTRODUCTION: &str = "\
# The paper's experiment

Gillibrand, Longhurst, Debattista and Chalmers, *Cost Prediction for Global Illumination using a Fast Rasterised Scene Preview* \
(AFRIGRAPH 2006), compare seven ways to forecast the cost of a frame from a few profiled pixels, with one run each. Here are all of \
them on our scenes, beside ours, with many seeds.

* Every frame was rendered once at each ambient level, with one camera ray a pixel and the cost of every pixel; forecasts take these \
costs as what profiling measures. Work is a deterministic count of operations; CPU time is what this machine made of it, a pixel's the \
median of several renders.
* With seed 0, grid, Halton and Hammersley are the paper's points; other seeds move them, and around at the border, by a \
random vector.
* *Snapshot, the paper's* has a pixel for every object and material and the rest by size, which the paper leaves open; its \
estimate is the paper's. *Snapshot, ours* joins small strata, spreads its pixels along a curve, and places the second half by what the \
first cost. *Snapshot, systematic* is the other one of ours: all in one pass, every so many-th pixel along materials and objects.
* With a cache the paper's strategies profile into an empty cache: a profiled pixel gathers its hemisphere for itself, as without a cache (with \
two bounces its rays read a second level that is taken to be there, which is in their favour). Ours plans the cache first: it knows the number of records, gathers some, and its pixels only read. What the paper never did is \
the table after: its strategies with planned records.
";

fn short<'a>(studies: impl Iterator<Item = &'a Study>) -> Table {
    let mut table = Table::new(&[
        ("scene", Align::Left),
        ("ambient", Align::Left),
        ("best blind", Align::Left),
        ("its RMSE", Align::Right),
        ("Snapshot, the paper's", Align::Right),
        ("systematic", Align::Right),
        ("Snapshot, ours", Align::Right),
        ("ours / best blind", Align::Right),
        ("noise floor", Align::Right),
        ("ours, mean |error|", Align::Right),
        ("of CPU time", Align::Right),
    ]);
    for study in studies {
        for level in &study.levels {
            let of = |strategy| level.outcomes.iter().find(|outcome| outcome.strategy == strategy);
            let blind = level.outcomes.iter().filter(|outcome| outcome.strategy.is_blind());
            let best = blind.min_by(|a, b| error(a).root_mean_square.total_cmp(&error(b).root_mean_square));
            let by_preview = (of(Strategy::PaperSnapshot), of(Strategy::Systematic), of(Strategy::Snapshot));
            let (Some(best), (Some(paper), Some(systematic), Some(ours))) = (best, by_preview) else {
                continue;
            };
            let root = |outcome: &Outcome| share(error(outcome).root_mean_square);
            let ratio = error(ours).root_mean_square / error(best).root_mean_square;
            table.row([
                study.bundle.clone(),
                level.level.title().into(),
                best.strategy.title().into(),
                root(best),
                root(paper),
                root(systematic),
                root(ours),
                if ratio.is_finite() { format!("{ratio:.2}") } else { "-".into() },
                if level.level.is_cached() { "-".into() } else { share(level.noise_floor) },
                share(error(ours).mean_absolute),
                share(ours.error.cpu_seconds.mean_absolute),
            ]);
        }
    }
    table
}

fn error(outcome: &Outcome) -> &Score {
    &outcome.error.work
}

fn share(fraction: f64) -> String {
    if fraction < 1.0 { format!("{:.1} %", fraction * 100.0) } else { format!("{:.0} %", fraction * 100.0) }
}

fn scene(text: &mut String, folder: &str, study: &Study) {
    let Study { bundle, frame, size, samples, seeds, gather_rays, strata_seen, .. } = study;
    let profiled = f64::from(*samples) / (f64::from(*size) * f64::from(*size));
    // Writing to a string cannot fail.
    let _ = write!(
        text,
        "\n## {bundle}\n\n{}Frame {frame}, {size} × {size} pixels, of which {samples} are profiled ({}); {strata_seen} visible pairs of \
         object and material; {seeds} seeds; {gather_rays} rays per gather.\n\n",
        study.renderer.as_ref().map_or_else(String::new, |renderer| format!("Rendered by {renderer}. ")),
        share(profiled)
    );
    pictures(
        text,
        folder,
        [
            ("the frame, one bounce", "image.png".into()),
            ("ID preview: red transparent, blue specular, green the rest", "preview.png".into()),
        ],
    );
    for level in &study.levels {
        tables(text, study, level);
    }
    let _ = write!(
        text,
        "\n### Error against profiled pixels\n\nThe thin grey line falls with the root of their number, as for random \
         pixels. Labels of ours are the CPU time of profiling. With a cache, every strategy has planned records, and gathers more of them with more pixels (96 for 256).\n\n![root mean square error of work against the number of profiled pixels]({folder}/samples.svg)\n\n\
         ### Where pixels are profiled\n\nWith seed 0, over the darkened preview.\n\n"
    );
    pictures(text, folder, Strategy::ALL.map(|strategy| (strategy.title(), positions_file(strategy))));
    for level in study.levels.iter().map(|level| level.level) {
        let _ = write!(text, "\n### Maps: {}\n\n", level.title());
        text.push_str(if level.is_cached() {
            "The truth shows each record of the first level at the pixel that shows it, and so does our prediction with planned records. "
        } else {
            "Blind predictions give each pixel the cost of the nearest profiled one; those by preview the mean of what the pixel shows. "
        });
        let _ = write!(
            text,
            "The scale is that of the truth: ![least to most]({folder}/key-cost.png) for work, ![least to most]({folder}/key-rays.png) for rays.\n\n"
        );
        for shown in Shown::ALL {
            let truth = [("truth", map_file(shown, level, None))].into_iter();
            let predicted = mapped(level).iter().map(|s| (s.title(), map_file(shown, level, Some(*s))));
            pictures(text, folder, truth.chain(predicted));
        }
    }
}

/// A table of pictures with their titles.
fn pictures<'a>(text: &mut String, folder: &str, all: impl IntoIterator<Item = (&'a str, String)>) {
    let all: Vec<(&str, String)> = all.into_iter().collect();
    for row in all.chunks(COLUMNS) {
        let cells = |cell: &dyn Fn(&(&str, String)) -> String| {
            let cells: Vec<String> = row.iter().map(cell).collect();
            format!("| {} |\n", cells.join(" | "))
        };
        text.push_str(&cells(&|(title, _)| (*title).to_owned()));
        text.push_str(&cells(&|_| "---".to_owned()));
        text.push_str(&cells(&|(title, file)| format!("![{title}]({folder}/{file})")));
        text.push('\n');
    }
}

fn tables(text: &mut String, study: &Study, level: &LevelStudy) {
    let _ = write!(text, "\n### {}\n\n", capital(level.level.title()));
    if !level.records.is_empty() {
        let records: Vec<String> = level.records.iter().map(u32::to_string).collect();
        let _ = write!(text, "The cache has {} records. ", records.join(" + "));
    }
    let Columns { rays, work, cpu_seconds } = level.actual;
    let _ = write!(
        text,
        "The frame took {} rays, {} of work and {} of CPU time. As the paper prints it, one run:\n\n",
        count(rays),
        count(work),
        seconds(cpu_seconds)
    );
    text.push_str(&one_run(study, level).markdown());
    let _ = write!(
        text,
        "\nOver {} seeds: mean absolute error, standard deviation, bias; *σ* is the standard deviation that a strategy estimates, \
         over the observed one.\n\n",
        study.seeds
    );
    text.push_str(&many_seeds(&level.outcomes).markdown());
    if let Some(covered) = level.outcomes.iter().find_map(|outcome| outcome.covered) {
        let [p80, p95] = covered.map(|share| format!("{:.0} %", share * 100.0));
        let _ = write!(
            text,
            "\nWork stayed at or below our P80 in {p80} of the cases, and below our P95 in {p95}.\n"
        );
    }
    if !level.planned.is_empty() {
        text.push_str("\nThe same with planned records for every strategy:\n\n");
        text.push_str(&many_seeds(&level.planned).markdown());
    }
}

fn capital(title: &str) -> String {
    let mut letters = title.chars();
    letters.next().map_or(String::new(), |first| first.to_uppercase().chain(letters).collect())
}

/// One run with seed 0, in the form of tables 1 to 5 of the paper. In the paper's own renderer, the errors
/// that the paper prints are beside.
fn one_run(study: &Study, level: &LevelStudy) -> Table {
    let printed = study.renderer.as_ref().and_then(|_| printed::table(&study.bundle, level.level));
    let mut head = vec![("method", Align::Left)];
    for (predicted, actual) in [("rays pred", "act"), ("work pred", "act"), ("CPU pred", "act")] {
        head.extend([(predicted, Align::Right), (actual, Align::Right), ("%", Align::Right)]);
    }
    let titles = printed.map(|table| ["rays", "cost"].map(|what| format!("paper's table {table}: {what} %")));
    head.extend(titles.iter().flatten().map(|title| (title.as_str(), Align::Right)));
    let mut table = Table::new(&head);
    let off =
        |predicted: f64, actual: f64| format!("{:.0}", (relative_error(predicted, actual) * 100.0).abs());
    for outcome in &level.outcomes {
        let (found, actual) = (outcome.one_run, level.actual);
        let row = printed.and_then(|table| printed::row(table, outcome.strategy));
        let (rays, cost) = row.unzip();
        let percent = |value: Option<u32>| value.map_or("-".into(), |value| value.to_string());
        let beside = printed.map(|_| [percent(rays), percent(cost)]);
        let own = [
            outcome.strategy.title().into(),
            count(found.rays),
            count(actual.rays),
            off(found.rays, actual.rays),
            count(found.work),
            count(actual.work),
            off(found.work, actual.work),
            seconds(found.cpu_seconds),
            seconds(actual.cpu_seconds),
            off(found.cpu_seconds, actual.cpu_seconds),
        ];
        table.row(own.into_iter().chain(beside.into_iter().flatten()));
    }
    table
}

fn many_seeds(outcomes: &[Outcome]) -> Table {
    let mut head = vec![("method", Align::Left), ("pixels", Align::Right)];
    for mean in ["rays", "work", "CPU"] {
        head.extend([(mean, Align::Right), ("sd", Align::Right), ("bias", Align::Right)]);
    }
    head.push(("σ", Align::Right));
    let mut table = Table::new(&head);
    for outcome in outcomes {
        let Columns { rays, work, cpu_seconds } = outcome.error;
        let scores = [rays, work, cpu_seconds].into_iter().flat_map(|score: Score| {
            [share(score.mean_absolute), share(score.deviation), percent(score.bias)]
        });
        let ratio = outcome.estimated_over_seen.map_or("-".into(), |ratio| format!("{ratio:.2}"));
        let name = [outcome.strategy.title().into(), outcome.samples.to_string()];
        table.row(name.into_iter().chain(scores).chain([ratio]));
    }
    table
}
