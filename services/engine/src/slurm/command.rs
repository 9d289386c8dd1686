//! Builds the arguments for Slurm's programs. Nothing runs here.
//!
//! Slurm takes times without a zone. The programs run with `TZ=UTC`.

use std::path::{Path, PathBuf};

use forelight_protocol::{Money, TaskId, TaskKind, Timestamp};
use forelight_store::NewArray;
use uuid::Uuid;

/// Prefix of our arrays' comments; the id follows.
const MARK: &str = "forelight:";

/// Longest part of a job's name that Slurm gets, in characters.
const LONGEST_NAME: usize = 60;

/// How this farm's arrays are submitted.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Submitting {
    /// Partition. `None` for the default one.
    pub partition: Option<String>,
    /// Account. `None` for the user's default.
    pub account: Option<String>,
    /// Path of the `forelight` binary on the nodes.
    pub program: PathBuf,
    /// Address of the service, as nodes reach it.
    pub server: String,
    /// File on the nodes that holds a worker's token.
    pub token_file: PathBuf,
    /// Folder on the nodes for fetched bundles. `None` for the default one.
    pub bundles: Option<PathBuf>,
    /// Where previews are made: `auto`, `gpu` or `cpu`.
    pub preview: &'static str,
    /// Price of a node per hour.
    pub price_per_hour: Money,
    /// Further options of `forelight worker`.
    pub worker_options: Vec<String>,
    /// Folder for the logs of processes, the same path on all nodes.
    pub logs: PathBuf,
}

pub fn mark(array: Uuid) -> String {
    format!("{MARK}{array}")
}

/// Arguments of `sbatch`. The script goes to standard input.
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
        // A frame has a node to itself, as booked.
        "--nodes=1".to_owned(),
        "--ntasks=1".to_owned(),
        "--exclusive".to_owned(),
        // All of the node's memory.
        "--mem=0".to_owned(),
        "--requeue".to_owned(),
        format!("--time={}", new.limit_minutes),
        "--chdir=/".to_owned(),
        "--input=/dev/null".to_owned(),
        format!("--output={}/%A_%a.log", submitting.logs.display()),
        // Keep the log of a process that Slurm starts again.
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

/// Script of an array. Each element runs the worker for its task.
pub fn script(submitting: &Submitting, tasks: &[TaskId]) -> String {
    let mut words = vec![quoted_path(&submitting.program), "worker".to_owned()];
    words.extend(["--server".to_owned(), quoted(&submitting.server)]);
    words.extend(["--token-file".to_owned(), quoted_path(&submitting.token_file)]);
    words.extend(["--preview".to_owned(), submitting.preview.to_owned()]);
    words.extend(["--price".to_owned(), decimal(submitting.price_per_hour.micro_units())]);
    if let Some(bundles) = &submitting.bundles {
        words.extend(["--bundles".to_owned(), quoted_path(bundles)]);
    }
    words.extend(submitting.worker_options.iter().map(|option| quoted(option)));
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

/// Arguments of `scancel` for elements of an array.
pub fn scancel(array: u32, positions: &[u32]) -> Vec<String> {
    let mut arguments = vec!["--quiet".to_owned()];
    arguments.extend(positions.iter().map(|position| format!("{array}_{position}")));
    arguments
}

/// Arguments of `squeue` that list ended jobs and those of hidden partitions, too. Slurm 22.05 lists them without
/// being asked.
pub fn squeue() -> Vec<String> {
    ["--all", "--states=all", "--json"].map(str::to_owned).into()
}

pub fn sinfo() -> Vec<String> {
    ["--all", "--noheader", "--Node", "--format=%N|%c|%T|%P"].map(str::to_owned).into()
}

#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Reservation {
    pub name: String,
    /// Names of the nodes. Asked for a number of nodes instead, Slurm may silently give fewer.
    pub nodes: Vec<String>,
    pub start: Timestamp,
    pub end: Timestamp,
}

/// Arguments of `scontrol` that create a reservation.
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
    // Jobs of the reservation may also run on other nodes, so no free node idles.
    arguments.push("Flags=FLEX".to_owned());
    arguments.extend(partition.map(|partition| format!("PartitionName={partition}")));
    arguments
}

/// Arguments of `scontrol` that delete a reservation.
pub fn give_up(name: &str) -> Vec<String> {
    vec!["delete".to_owned(), format!("ReservationName={name}")]
}

/// Arguments of `scontrol` that take elements of an array out of its reservation.
pub fn leave_reservation(array: u32, positions: &[u32]) -> Vec<String> {
    let elements: Vec<String> = positions.iter().map(|position| format!("{array}_{position}")).collect();
    vec!["update".to_owned(), format!("JobId={}", elements.join(",")), "ReservationName=".to_owned()]
}

/// A time in Slurm's form, in UTC, rounded down to the second.
fn time(at: Timestamp) -> String {
    // 19 characters precede the fraction of the second.
    at.to_string().chars().take(19).collect()
}

/// An amount of money in the command line's form.
fn decimal(micro_units: i64) -> String {
    format!("{}.{:06}", micro_units / 1_000_000, micro_units.rem_euclid(1_000_000))
}

fn quoted(text: &str) -> String {
    // Quoting fails only for NUL, which no path or address contains.
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
            worker_options: vec!["--ca-file=/srv/it's/ca.pem".to_owned()],
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
            "--ca-file=/srv/it's/ca.pem",
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
