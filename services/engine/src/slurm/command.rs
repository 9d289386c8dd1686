//! What is said to Slurm's programs: words only, nothing is run here.
//!
//! Times are written without a zone, as Slurm wants them; the programs are run with `TZ=UTC`, so they mean UTC.

use std::path::{Path, PathBuf};

use forelight_protocol::{Money, TaskId, TaskKind, Timestamp};
use forelight_store::NewArray;
use uuid::Uuid;

/// What marks our arrays, before their id.
const MARK: &str = "forelight:";

/// The longest part of a job's name that Slurm is told.
const LONGEST_NAME: usize = 60;

/// How every array of this farm is submitted.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Submitting {
    /// Partition, if not the default one.
    pub partition: Option<String>,
    /// Account, if not the user's default.
    pub account: Option<String>,
    /// The `forelight` that nodes run.
    pub program: PathBuf,
    /// Where nodes reach the service.
    pub server: String,
    /// File on the nodes that holds a worker's token.
    pub token_file: PathBuf,
    /// Folder on the nodes for fetched bundles, if not the default one.
    pub bundles: Option<PathBuf>,
    /// Who makes previews: `auto`, `gpu` or `cpu`.
    pub preview: &'static str,
    /// What an hour of a node costs.
    pub price_per_hour: Money,
    /// Folder for what processes say, the same on all nodes.
    pub logs: PathBuf,
}

/// The comment of an array.
pub fn mark(array: Uuid) -> String {
    format!("{MARK}{array}")
}

/// The arguments of `sbatch`. The script comes by standard input.
pub fn sbatch(
    submitting: &Submitting,
    array: Uuid,
    new: &NewArray,
    name: &str,
    kind: TaskKind,
    exclude: &[String],
) -> Vec<String> {
    let last = new.tasks.len().saturating_sub(1);
    let safe = |c: char| if c.is_ascii_alphanumeric() || "._-".contains(c) { c } else { '_' };
    let name: String = name.chars().take(LONGEST_NAME).map(safe).collect();
    let mut arguments = vec![
        "--parsable".to_owned(),
        format!("--array=0-{last}"),
        format!("--comment={}", mark(array)),
        format!("--job-name=forelight-{kind}-{name}"),
        // A frame has a node to itself: that is what the plan has booked.
        "--nodes=1".to_owned(),
        "--ntasks=1".to_owned(),
        "--exclusive".to_owned(),
        // All of its memory too.
        "--mem=0".to_owned(),
        "--requeue".to_owned(),
        format!("--time={}", new.limit_minutes),
        "--chdir=/".to_owned(),
        "--input=/dev/null".to_owned(),
        format!("--output={}/%A_%a.log", submitting.logs.display()),
        // What a process said before Slurm started it again is worth reading.
        "--open-mode=append".to_owned(),
    ];
    let mut option = |name: &str, value: Option<String>| {
        arguments.extend(value.map(|value| format!("--{name}={value}")));
    };
    option("partition", submitting.partition.clone());
    option("account", submitting.account.clone());
    option("begin", new.begin.map(time));
    option("deadline", new.deadline.map(time));
    option("reservation", new.reservation.as_ref().map(|(name, _)| name.clone()));
    option("exclude", (!exclude.is_empty()).then(|| exclude.join(",")));
    arguments
}

/// The script of an array: each element becomes the process of its task.
pub fn script(submitting: &Submitting, tasks: &[TaskId]) -> String {
    let mut words = vec![quoted_path(&submitting.program), "worker".to_owned()];
    words.extend(["--server".to_owned(), quoted(&submitting.server)]);
    words.extend(["--token-file".to_owned(), quoted_path(&submitting.token_file)]);
    words.extend(["--preview".to_owned(), submitting.preview.to_owned()]);
    words.extend(["--price".to_owned(), decimal(submitting.price_per_hour.micro_units())]);
    if let Some(bundles) = &submitting.bundles {
        words.extend(["--bundles".to_owned(), quoted_path(bundles)]);
    }
    let list: Vec<String> = tasks.iter().map(TaskId::to_string).collect();
    format!(
        "#!/bin/sh\n\
         # One task each, by place in the array. The process leases exactly its task, does it, reports, and ends; if another\n\
         # process has it, or it is over, it ends at once.\n\
         set -- {}\n\
         shift \"${{SLURM_ARRAY_TASK_ID:?}}\"\n\
         exec {} --task \"$1\" --name \"${{SLURMD_NODENAME:-$(hostname -s)}}\" --threads \"${{SLURM_CPUS_ON_NODE:-1}}\"\n",
        list.join(" "),
        words.join(" "),
    )
}

/// The arguments of `scancel` for elements of an array.
pub fn scancel(array: u32, positions: &[u32]) -> Vec<String> {
    let mut arguments = vec!["--quiet".to_owned()];
    arguments.extend(positions.iter().map(|position| format!("{array}_{position}")));
    arguments
}

/// The arguments of `sinfo`.
pub fn sinfo() -> Vec<String> {
    ["--noheader", "--Node", "--format=%N|%c|%T|%P"].map(str::to_owned).into()
}

/// Nodes kept free for an array.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Reservation {
    /// Its name.
    pub name: String,
    /// The nodes, by name: asked for a number of them, Slurm quietly gives fewer.
    pub nodes: Vec<String>,
    /// From when.
    pub start: Timestamp,
    /// Until when.
    pub end: Timestamp,
}

/// The arguments of `scontrol` that make a reservation.
pub fn reserve(
    reservation: &Reservation,
    user: &str,
    partition: Option<&str>,
    now: Timestamp,
) -> Vec<String> {
    let Reservation { name, nodes, start, end } = reservation;
    let start = if *start <= now { "now".to_owned() } else { time(*start) };
    let mut arguments: Vec<String> = ["create", "reservation"].map(str::to_owned).into();
    arguments.push(format!("ReservationName={name}"));
    arguments.push(format!("StartTime={start}"));
    arguments.push(format!("EndTime={}", time(*end)));
    arguments.push(format!("Users={user}"));
    arguments.push(format!("Nodes={}", nodes.join(",")));
    // Its jobs may run elsewhere as well: a node never stands idle because a frame is booked on another.
    arguments.push("Flags=FLEX".to_owned());
    arguments.extend(partition.map(|partition| format!("PartitionName={partition}")));
    arguments
}

/// The arguments of `scontrol` that give up a reservation.
pub fn give_up(name: &str) -> Vec<String> {
    vec!["delete".to_owned(), format!("ReservationName={name}")]
}

/// The arguments of `scontrol` that let elements of an array run outside of its reservation.
pub fn leave_reservation(array: u32, positions: &[u32]) -> Vec<String> {
    let elements: Vec<String> = positions.iter().map(|position| format!("{array}_{position}")).collect();
    vec!["update".to_owned(), format!("JobId={}", elements.join(",")), "ReservationName=".to_owned()]
}

/// A time as Slurm wants it, in UTC and to the second, never later than it is.
fn time(at: Timestamp) -> String {
    // Before the fraction of the second there are always 19 characters.
    at.to_string().chars().take(19).collect()
}

/// An amount of money as the command line takes it.
fn decimal(micro_units: i64) -> String {
    format!("{}.{:06}", micro_units / 1_000_000, micro_units.rem_euclid(1_000_000))
}

fn quoted(text: &str) -> String {
    // What cannot be quoted holds a NUL, which no path and no address does.
    shlex::try_quote(text).map_or_else(|_| String::new(), |word| word.into_owned())
}

fn quoted_path(path: &Path) -> String {
    quoted(&path.to_string_lossy())
}

#[cfg(test)]
mod tests {
    use super::*;
    use forelight_protocol::JobId;

    fn submitting() -> Submitting {
        Submitting {
            partition: Some("render".to_owned()),
            account: None,
            program: "/opt/a b/forelight".into(),
            server: "http://farm:7878".to_owned(),
            token_file: "/srv/it's/worker.token".into(),
            bundles: None,
            preview: "auto",
            price_per_hour: Money(1_250_000),
            logs: "/srv/logs".into(),
        }
    }

    fn array(tasks: usize) -> NewArray {
        NewArray {
            job: JobId(Uuid::nil()),
            tasks: (0..tasks).map(|n| TaskId(Uuid::from_u128(n as u128))).collect(),
            limit_minutes: 7,
            begin: None,
            deadline: None,
            reservation: None,
        }
    }

    fn at(text: &str) -> Timestamp {
        text.parse().unwrap()
    }

    #[test]
    fn an_array_says_what_it_needs_and_no_more() {
        let id = Uuid::from_u128(1);
        let plain = sbatch(&submitting(), id, &array(12), "a \"shot\"; rm -rf /", TaskKind::Render, &[]);
        for word in [
            "--array=0-11",
            "--comment=forelight:00000000-0000-0000-0000-000000000001",
            "--job-name=forelight-render-a__shot___rm_-rf__",
            "--time=7",
            "--partition=render",
            "--output=/srv/logs/%A_%a.log",
        ] {
            assert!(plain.iter().any(|said| said == word), "{word}: {plain:?}");
        }
        for absent in ["--begin", "--deadline", "--reservation", "--exclude", "--account"] {
            assert!(!plain.iter().any(|said| said.starts_with(absent)), "{absent}: {plain:?}");
        }
        let planned = NewArray {
            begin: Some(at("2026-11-21T20:00:00.9Z")),
            deadline: Some(at("2026-11-22T06:30:00Z")),
            reservation: Some(("forelight_1".to_owned(), at("2026-11-22T06:30:00Z"))),
            ..array(1)
        };
        let planned =
            sbatch(&submitting(), id, &planned, "a", TaskKind::Render, &["n1".to_owned(), "n2".to_owned()]);
        for word in [
            "--array=0-0",
            "--begin=2026-11-21T20:00:00",
            "--deadline=2026-11-22T06:30:00",
            "--reservation=forelight_1",
            "--exclude=n1,n2",
        ] {
            assert!(planned.iter().any(|said| said == word), "{word}: {planned:?}");
        }
    }

    #[test]
    fn the_script_runs_the_task_of_its_place_whatever_is_in_the_paths() {
        let folder = tempfile::tempdir().unwrap();
        let program = folder.path().join("it's a $(program)");
        std::fs::write(&program, "#!/bin/sh\nprintf '%s\\n' \"$@\"\n").unwrap();
        std::fs::set_permissions(&program, std::os::unix::fs::PermissionsExt::from_mode(0o755)).unwrap();
        let script = script(&Submitting { program, ..submitting() }, &array(12).tasks);
        let ran = std::process::Command::new("sh")
            .args(["-c", &script])
            .envs([("SLURM_ARRAY_TASK_ID", "11"), ("SLURMD_NODENAME", "n4"), ("SLURM_CPUS_ON_NODE", "8")])
            .output()
            .unwrap();
        let said = String::from_utf8(ran.stdout).unwrap();
        let words: Vec<&str> = said.lines().collect();
        let expected = [
            "worker",
            "--server",
            "http://farm:7878",
            "--token-file",
            "/srv/it's/worker.token",
            "--preview",
            "auto",
            "--price",
            "1.250000",
            "--task",
            "00000000-0000-0000-0000-00000000000b",
            "--name",
            "n4",
            "--threads",
            "8",
        ];
        assert_eq!(words, expected, "{}", String::from_utf8_lossy(&ran.stderr));
    }

    #[test]
    fn a_reservation_names_its_nodes_and_begins_now_if_it_should_have_begun() {
        let reservation = Reservation {
            name: "forelight_1".to_owned(),
            nodes: vec!["a".to_owned(), "b".to_owned()],
            start: at("2026-11-21T20:00:00Z"),
            end: at("2026-11-21T21:00:00Z"),
        };
        let said = reserve(&reservation, "farm", None, at("2026-11-21T19:00:00Z")).join(" ");
        assert_eq!(
            said,
            "create reservation ReservationName=forelight_1 StartTime=2026-11-21T20:00:00 EndTime=2026-11-21T21:00:00 Users=farm Nodes=a,b Flags=FLEX"
        );
        let late = reserve(&reservation, "farm", Some("render"), at("2026-11-21T20:30:00Z")).join(" ");
        assert!(late.contains("StartTime=now ") && late.ends_with("PartitionName=render"), "{late}");
    }

    #[test]
    fn elements_are_named_one_by_one() {
        assert_eq!(scancel(12, &[0, 3]), ["--quiet", "12_0", "12_3"]);
        assert_eq!(leave_reservation(12, &[0, 3]), ["update", "JobId=12_0,12_3", "ReservationName="]);
    }
}
