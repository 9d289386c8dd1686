//! The commands, one file each.

mod accept;
mod accuracy;
mod allot;
mod ask;
mod audit;
mod backup;
mod budget;
mod cache;
mod cache_error;
mod calibrate;
mod cancel;
mod change;
mod dashboard;
mod events;
mod explain;
mod export;
mod farm;
mod forecast;
mod foreign;
mod inspect_bundle;
mod jobs;
mod leave_out;
mod log;
mod node;
mod numbered;
mod pause;
mod plan;
mod plans;
mod preview;
mod project;
mod quota;
mod render;
mod renderers;
mod retention;
mod retry;
mod scrub;
mod serve;
mod sign_in;
mod simulate;
mod slurm;
mod status;
mod submit;
mod token;
mod video;
mod webhook;
mod worker;

use anyhow::Result;
use clap::{ArgAction, Parser, Subcommand};
use forelight_terminal::interrupt::Interrupt;

/// Forecasts what frames cost before they are rendered.
///
/// forelight previews every frame of a shot and traces a few pixels of some frames. From these it forecasts
/// the cost of all frames, with quantiles. The forecasts let it book a render farm against deadlines and
/// budgets.
#[derive(Debug, Parser)]
#[command(name = "forelight", version, propagate_version = true, max_term_width = 100)]
#[command(after_help = "\
Examples:
  forelight forecast kitchen/ --frames 0-47            what the shot will cost, on this machine
  forelight render kitchen/ --frame 12 --out 12.exr    one frame, with its true cost
  forelight farm --data farm-data --workers 2          a farm on this machine
  forelight submit kitchen/ --deadline 2h --data farm-data --out images/

Exit codes: 0 done; 1 it failed: a network, a disk, the service, a job; 2 the command cannot work as written: wrong \
input or path, or a request that the service refused; 3 a budget is threatened (`forelight budget`); 130 stopped by \
the user.")]
pub struct Cli {
    #[command(subcommand)]
    command: Command,
    /// Log more to standard error: -v for events, -vv for details. RUST_LOG chooses by module
    #[arg(short, long, global = true, action = ArgAction::Count)]
    verbose: u8,
}

#[derive(Debug, Subcommand)]
enum Command {
    Farm(farm::Args),
    Serve(serve::Args),
    Worker(worker::Args),
    Submit(submit::Args),
    Accept(accept::Args),
    Change(change::Args),
    Status(status::Args),
    Jobs(jobs::Args),
    Pause(pause::Args),
    Resume(pause::ResumeArgs),
    Cancel(cancel::Args),
    Retry(retry::Args),
    Video(video::Args),
    LeaveOut(leave_out::Args),
    Dashboard(dashboard::Args),
    Render(render::Args),
    Renderers(renderers::Args),
    Preview(preview::Args),
    Cache(cache::Args),
    Calibrate(calibrate::Args),
    Forecast(forecast::Args),
    Accuracy(accuracy::Args),
    Export(export::Args),
    Plan(plan::Args),
    Ask(ask::Args),
    Plans(plans::Args),
    #[command(visible_alias = "share")]
    Project(project::Args),
    Quota(quota::Args),
    Simulate(simulate::Args),
    Budget(Box<budget::Args>),
    Token(token::Args),
    #[command(visible_alias = "nodes")]
    Node(Box<node::Args>),
    Audit(audit::Args),
    #[command(visible_alias = "webhooks")]
    Webhook(webhook::Args),
    Log(log::Args),
    Events(events::Args),
    Retention(retention::Args),
    Prune(retention::PruneArgs),
    Delete(retention::DeleteArgs),
    Backup(backup::Args),
    Scrub(scrub::Args),
    Bench(forelight_bench::Args),
    #[command(hide = true)]
    InspectBundle(inspect_bundle::Args),
}

impl Cli {
    /// The log level: the number of `-v`, and one more for long-running commands.
    pub fn verbosity(&self) -> u8 {
        let service = matches!(self.command, Command::Farm(_) | Command::Serve(_) | Command::Worker(_));
        self.verbose + u8::from(service)
    }
    pub async fn run(self) -> Result<()> {
        let interrupt = Interrupt::listen()?;
        match self.command {
            Command::Farm(args) => farm::run(args, interrupt).await,
            Command::Serve(args) => serve::run(args, interrupt).await,
            Command::Worker(args) => worker::run(args, interrupt).await,
            Command::Submit(args) => submit::run(args, interrupt).await,
            Command::Status(args) => status::run(args, interrupt).await,
            Command::Jobs(args) => jobs::run(args).await,
            Command::Accept(args) => accept::run(args).await,
            Command::Change(args) => change::run(args).await,
            Command::Pause(args) => pause::pause(args).await,
            Command::Resume(args) => pause::resume(args).await,
            Command::Cancel(args) => cancel::run(args).await,
            Command::Retry(args) => retry::run(args).await,
            Command::Video(args) => video::run(args, interrupt).await,
            Command::LeaveOut(args) => leave_out::run(args).await,
            Command::Dashboard(args) => dashboard::run(args).await,
            Command::Token(args) => token::run(args).await,
            Command::Node(args) => node::run(*args).await,
            Command::Ask(args) => ask::run(args).await,
            Command::Plans(args) => plans::run(args).await,
            Command::Project(args) => project::run(args).await,
            Command::Quota(args) => quota::run(args).await,
            Command::Audit(args) => audit::run(args).await,
            Command::Webhook(args) => webhook::run(args).await,
            Command::Log(args) => log::run(args).await,
            Command::Events(args) => events::run(args, interrupt).await,
            Command::Retention(args) => retention::run(args).await,
            Command::Prune(args) => retention::prune(args).await,
            Command::Delete(args) => retention::delete(args).await,
            Command::Backup(args) => backup::run(args).await,
            Command::Scrub(args) => scrub::run(args, interrupt).await,
            Command::Budget(args) => budget::run(*args).await,
            Command::Render(args) => render::run(args, interrupt).await,
            // Tracing light would block the runtime, so it has a thread of its own.
            Command::Renderers(args) => blocking(move || renderers::run(&args)).await,
            Command::Preview(args) => blocking(move || preview::run(&args)).await,
            Command::Cache(args) => blocking(move || cache::run(&args, &interrupt)).await,
            Command::Calibrate(args) => blocking(move || calibrate::run(&args)).await,
            Command::Forecast(args) => blocking(move || forecast::run(&args, &interrupt)).await,
            Command::Accuracy(args) => accuracy::run(args, interrupt).await,
            Command::Export(args) => blocking(move || export::run(&args, &interrupt)).await,
            Command::Plan(args) => blocking(move || plan::run(&args)).await,
            Command::Simulate(args) => blocking(move || simulate::run(&args, &interrupt)).await,
            Command::InspectBundle(args) => blocking(move || inspect_bundle::run(&args)).await,
            Command::Bench(args) => blocking(move || forelight_bench::run(&args, &interrupt)).await,
        }
    }
}

async fn blocking<T: Send + 'static>(work: impl FnOnce() -> Result<T> + Send + 'static) -> Result<T> {
    match tokio::task::spawn_blocking(work).await {
        Ok(done) => done,
        Err(error) => match error.try_into_panic() {
            Ok(panic) => std::panic::resume_unwind(panic),
            Err(error) => Err(error.into()),
        },
    }
}

#[cfg(test)]
mod tests {
    use super::Cli;
    use crate::arguments::read_from;
    use clap::CommandFactory;
    use std::ffi::OsString;

    fn parse(line: &str) -> Result<Cli, clap::Error> {
        let words = shlex::split(line).expect("every quote is closed");
        read_from(words.into_iter().map(OsString::from)).map(|(cli, _)| cli)
    }

    #[test]
    fn the_command_line_is_consistent() {
        Cli::command().debug_assert();
    }

    #[test]
    fn the_examples_of_every_help_text_can_be_typed() {
        let mut seen = 0;
        let mut commands: Vec<clap::Command> = vec![Cli::command()];
        while let Some(command) = commands.pop() {
            commands.extend(command.get_subcommands().cloned());
            let help = command.get_after_help().map(ToString::to_string).unwrap_or_default();
            let help = help.replace("\\\n", " ");
            for line in help.lines().map(str::trim).filter(|line| line.starts_with("forelight ")) {
                // Three spaces precede an explanation.
                let typed = line.split("   ").next().unwrap_or(line);
                let typed = typed.split(" > ").next().unwrap_or(typed);
                parse(typed).unwrap_or_else(|error| panic!("{typed}: {error}"));
                seen += 1;
            }
        }
        assert!(seen >= 12, "only {seen} examples");
    }

    #[test]
    fn wrong_values_name_the_flag() {
        for (line, flag) in [
            ("forelight submit b --per-frame", "--within"),
            ("forelight submit b --error 0", "--error"),
            ("forelight submit b --error 2 --within 3h", "--error"),
            ("forelight submit b --frames 3-1", "--frames"),
            ("forelight submit b --deadline soon", "--deadline"),
            ("forelight submit b --budget -3", "--budget"),
            ("forelight render b --width 0", "--width"),
            ("forelight render b --threads 0", "--threads"),
            ("forelight render b --cache maybe", "--cache"),
            ("forelight render b --cache on --cache-accuracy 0.005", "--cache-accuracy"),
            ("forelight render b --cache on --cache-accuracy fine", "--cache-accuracy"),
            ("forelight forecast b --integrator photons", "--integrator"),
            ("forelight preview b --preview tpu", "--preview"),
            ("forelight cache fill b --cache-file c --part 5/4 --out d", "--part"),
            ("forelight forecast b --samples 0", "--samples"),
            ("forelight export b --format yaml", "--format"),
            ("forelight export b --timeout soon", "--timeout"),
            ("forelight token --role boss", "--role"),
            ("forelight token --one-time --role worker", "--role"),
            ("forelight worker --join-token-file j", "--token-file"),
            ("forelight worker --task-memory little", "--task-memory"),
            ("forelight backup --data d", "--to"),
            ("forelight status kitchen --interval 0s", "--interval"),
            ("forelight jobs --state sleeping", "--state"),
            ("forelight leave-out kitchen", "--reason"),
            ("forelight accept j --confidence p99", "--confidence"),
            ("forelight accept j --deadline -2h", "--deadline"),
            ("forelight change j", "--deadline"),
            ("forelight change j --budget -5", "--budget"),
            ("forelight change j --budget 5 --no-budget", "--no-budget"),
            ("forelight retry j --frames 3-", "--frames"),
            ("forelight jobs --most 0", "--most"),
            ("forelight simulate --nodes 3", "--nodes"),
            ("forelight simulate --svg x.txt", "--svg"),
            ("forelight plan farm.json --svg x.txt", "--svg"),
            ("forelight plan farm.json --job j --curve x.txt", "--curve"),
            ("forelight ask j --curve x.txt", "--curve"),
            ("forelight accuracy b --out x.txt", "--out"),
            ("forelight node rack-7 --maintenance soon", "--maintenance"),
            ("forelight log kitchen --frame x", "--frame"),
            ("forelight simulate --confidence 90", "--confidence"),
            ("forelight simulate --pool 0", "--pool"),
            ("forelight simulate --bias -1", "--bias"),
            ("forelight budget --date tomorrow", "--date"),
            ("forelight budget --days 0", "--days"),
            ("forelight budget set film 10 --stop 0", "--stop"),
            ("forelight farm --lease-ttl 0s", "--lease-ttl"),
            ("forelight farm --artifacts s3://UPPER", "--artifacts"),
            ("forelight farm --executor pbs", "--executor"),
            ("forelight serve --slurm-poll 0s", "--slurm-poll"),
            ("forelight worker --task 12", "--task"),
        ] {
            let error = parse(line).expect_err(line);
            assert_eq!(error.exit_code(), 2, "{line}");
            assert!(error.to_string().contains(flag), "{line}: {error}");
        }
    }
}
