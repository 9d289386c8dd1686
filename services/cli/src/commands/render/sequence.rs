//! `forelight render --frames`: several frames, one after the other. The scene is read once.

use super::{Args, Files, Opened, format_of, once};
use crate::commands::numbered::numbered;
use anyhow::{Context, Result};
use forelight_protocol::words::{counted, is_or_are};
use forelight_protocol::{FrameSet, RenderStats};
use forelight_renderer_own::render_frame;
use forelight_terminal::atomic_file;
use forelight_terminal::failure::Interrupted;
use forelight_terminal::foreign::refuse_because;
use forelight_terminal::interrupt::Interrupt;
use forelight_terminal::json_file;
use forelight_terminal::output::{self, Bars};
use forelight_terminal::quantities::{count, seconds};
use forelight_terminal::table::{Align, Table};
use std::path::PathBuf;

/// The files of one frame.
struct Paths {
    out: Option<PathBuf>,
    cost_map: Option<PathBuf>,
    stats: Option<PathBuf>,
}

impl Paths {
    fn of(args: &Args, frame: u32) -> Result<Self> {
        let of = |flag: &str, path: &Option<PathBuf>| {
            path.as_deref().map(|path| numbered(flag, path, frame.into())).transpose()
        };
        Ok(Self {
            out: of("--out", &args.out)?,
            cost_map: of("--cost-map", &args.cost_map)?,
            stats: of("--stats", &args.stats)?,
        })
    }
}

/// Renders the frames on this machine. Frames that are finished stay if a later one fails or is interrupted.
pub fn render(args: &Args, frames: &FrameSet, interrupt: &Interrupt) -> Result<()> {
    let others = [
        ("--profile", args.profile.is_some()),
        ("--within, --within-money, --error and --samples-from", args.allot.is_given()),
    ];
    refuse_because(&others, "only a single frame can have this", "render with --frame N")?;
    args.out.as_deref().map(format_of).transpose()?;
    let bars = Bars::new(args.json);
    let mut opened = Opened::new(args, &bars)?;
    let middle = opened.local.middle_frame(Some(frames))?;
    let paths = frames.iter().map(|frame| Paths::of(args, frame)).collect::<Result<Vec<Paths>>>()?;
    atomic_file::check(
        paths.iter().flat_map(|paths| [&paths.out, &paths.cost_map, &paths.stats]).map(Option::as_deref),
    )?;
    opened.choose_cache(args, middle, &bars, interrupt)?;
    let bar = bars.bar("frames", frames.count());
    let mut finished = Vec::new();
    for (frame, paths) in frames.iter().zip(&paths) {
        let (shot, settings) = (&opened.local.shot, &opened.settings);
        let rendered = opened.trace(None, opened.cache.clone(), &bars, |given, progress| {
            Ok(render_frame(shot, frame, settings, given, progress, interrupt.flag())?)
        })?;
        let Some(mut rendered) = rendered else { break };
        rendered.stats.cache_choice = opened.choice;
        let files = Files::new(paths.out.as_deref(), paths.cost_map.as_deref())?;
        opened.local.pool.install(|| files.write(&rendered.image, &rendered.frame))?;
        json_file::write(paths.stats.as_deref(), &rendered.stats)?;
        if args.json {
            output::json_line(&rendered.stats)?;
        }
        finished.push(rendered.stats);
        bar.inc(1);
    }
    bar.finish_and_clear();
    if !args.json {
        output::print(&report(&finished))?;
    }
    if finished.len() as u64 == frames.count() {
        return Ok(());
    }
    let (done, all) = (finished.len(), counted(frames.count(), "frame"));
    Err(Interrupted).with_context(|| format!("{done} of {all} {} finished", is_or_are(frames.count())))
}

fn report(finished: &[RenderStats]) -> String {
    let mut table = Table::new(&[
        ("frame", Align::Right),
        ("work", Align::Right),
        ("CPU time", Align::Right),
        ("wall time", Align::Right),
    ]);
    let row = |frame: String, work: u64, cpu_seconds: f64, wall_seconds: f64| {
        [frame, count(work as f64), seconds(cpu_seconds), seconds(wall_seconds)]
    };
    for stats in finished {
        table.row(row(stats.frame.to_string(), stats.work, stats.cpu_seconds, stats.wall_seconds));
    }
    table.footer();
    let sum = |of: fn(&RenderStats) -> f64| finished.iter().map(of).sum();
    let work = finished.iter().map(|stats| stats.work).sum();
    table.row(row("all".into(), work, sum(|stats| stats.cpu_seconds), sum(|stats| stats.wall_seconds)));
    table.render() + &finished.first().map_or_else(String::new, once)
}
