//! Parses the output of Slurm's programs.
//!
//! `squeue --json` differs between versions. Since 23.02 numbers are objects of `set`, `infinite` and
//! `number`; since 23.11 states are lists. All forms are read, and unknown fields are ignored.

use std::ops::RangeInclusive;

use serde::Deserialize;
use serde::de::IgnoredAny;

/// A Slurm job: one element that has started, or all elements of an array that still wait.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct SlurmJob {
    pub array: u32,
    /// Elements of the array that this entry covers. Empty if the job is not an array.
    pub elements: Vec<RangeInclusive<u32>>,
    /// Slurm's state, such as `RUNNING`. Several are joined by `+`.
    pub state: String,
    /// Why the elements wait.
    pub reason: String,
    pub ending: Ending,
    pub comment: String,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Ending {
    pub code: u32,
    /// The signal that ended it, or 0.
    pub signal: u32,
}

/// Stage of an element.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Stage {
    Pending,
    /// Waits until a person releases it: Slurm failed to start it and holds it.
    Stuck,
    /// Running, starting or ending.
    Running,
    Ended,
}

/// States that never change again.
const FINAL: [&str; 12] = [
    "BOOT_FAIL",
    "CANCELLED",
    "COMPLETED",
    "DEADLINE",
    "FAILED",
    "LAUNCH_FAILED",
    "NODE_FAIL",
    "OUT_OF_MEMORY",
    "PREEMPTED",
    "RECONFIG_FAIL",
    "REVOKED",
    "TIMEOUT",
];

impl SlurmJob {
    pub fn stage(&self) -> Stage {
        let mut words = self.state.split('+');
        if words.clone().all(|word| FINAL.contains(&word)) {
            Stage::Ended
        } else if words.any(|word| matches!(word, "PENDING" | "REQUEUED" | "REQUEUE_HOLD" | "SPECIAL_EXIT")) {
            let reason = self.reason.to_ascii_lowercase().replace('_', " ");
            let stuck = ["launch failed", "jobholdmaxrequeue", "env retrieval failed"]
                .iter()
                .any(|why| reason.contains(why));
            if stuck { Stage::Stuck } else { Stage::Pending }
        } else {
            Stage::Running
        }
    }

    /// True if this entry covers the element.
    pub fn is_about(&self, position: u32) -> bool {
        self.elements.iter().any(|range| range.contains(&position))
    }

    /// Slurm's final state, with the exit code or signal of a failure.
    pub fn outcome(&self) -> String {
        match (self.state.as_str(), self.ending) {
            (state @ "FAILED", Ending { signal: 0, code }) => format!("{state} with exit code {code}"),
            (state @ "FAILED", Ending { signal, .. }) => format!("{state} by signal {signal}"),
            (state, _) => state.to_owned(),
        }
    }
}

/// A node as `sinfo` reports it.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct SlurmNode {
    pub name: String,
    pub cpus: u32,
    pub up: bool,
}

/// Output of a Slurm program that could not be parsed.
#[derive(Debug, thiserror::Error)]
#[error("cannot read the output of {program}: {reason}")]
pub struct AnswerError {
    program: &'static str,
    reason: String,
}

impl AnswerError {
    fn new(program: &'static str, reason: impl ToString) -> Self {
        Self { program, reason: reason.to_string() }
    }
}

#[derive(Deserialize)]
struct Queue {
    jobs: Vec<QueueJob>,
}

#[derive(Deserialize)]
struct QueueJob {
    job_id: Number,
    #[serde(default)]
    array_job_id: Number,
    #[serde(default)]
    array_task_id: Number,
    #[serde(default)]
    array_task_string: Option<String>,
    job_state: Words,
    #[serde(default)]
    state_reason: Option<String>,
    #[serde(default)]
    state_description: Option<String>,
    #[serde(default)]
    exit_code: ExitCode,
    #[serde(default)]
    comment: Option<String>,
}

#[derive(Deserialize, Default, Clone, Copy)]
#[serde(from = "NumberForm")]
struct Number(Option<u64>);

#[derive(Deserialize)]
#[serde(untagged)]
enum NumberForm {
    Plain(u64),
    Object { set: bool, number: u64 },
    Other(IgnoredAny),
}

impl From<NumberForm> for Number {
    fn from(form: NumberForm) -> Self {
        match form {
            NumberForm::Plain(number) | NumberForm::Object { set: true, number } => Self(Some(number)),
            NumberForm::Object { .. } | NumberForm::Other(_) => Self(None),
        }
    }
}

impl Number {
    fn id(self) -> Option<u32> {
        u32::try_from(self.0?).ok()
    }
}

#[derive(Deserialize)]
#[serde(untagged)]
enum Words {
    One(String),
    Several(Vec<String>),
}

/// A packed wait status (signal in the low byte, exit code above), or its separate parts.
#[derive(Deserialize, Default)]
#[serde(untagged)]
enum ExitCode {
    Packed(u32),
    Apart {
        #[serde(default)]
        return_code: Number,
        #[serde(default)]
        signal: Signal,
    },
    #[default]
    Absent,
}

#[derive(Deserialize, Default)]
struct Signal {
    #[serde(default, alias = "signal_id")]
    id: Number,
}

impl ExitCode {
    fn ending(&self) -> Ending {
        match self {
            Self::Packed(status) => Ending { code: status >> 8 & 0xff, signal: status & 0x7f },
            Self::Apart { return_code, signal } => {
                Ending { code: return_code.id().unwrap_or(0), signal: signal.id.id().unwrap_or(0) }
            }
            Self::Absent => Ending::default(),
        }
    }
}

/// Parses the jobs from `squeue --json`.
pub fn jobs(output: &[u8]) -> Result<Vec<SlurmJob>, AnswerError> {
    let queue: Queue = serde_json::from_slice(output).map_err(|error| AnswerError::new("squeue", error))?;
    queue
        .jobs
        .into_iter()
        .map(|job| {
            let own = job.job_id.id().ok_or_else(|| AnswerError::new("squeue", "a job has no number"))?;
            // Slurm reports 0 for jobs that are not arrays.
            let array = job.array_job_id.id().filter(|&array| array != 0);
            let elements = match (array, job.array_task_id.id(), &job.array_task_string) {
                (Some(_), Some(element), _) => vec![element..=element],
                (Some(_), None, Some(text)) => {
                    ranges(text).map_err(|reason| AnswerError::new("squeue", reason))?
                }
                _ => Vec::new(),
            };
            let described = job.state_description.filter(|text| !text.is_empty());
            Ok(SlurmJob {
                array: array.unwrap_or(own),
                elements,
                state: match job.job_state {
                    Words::One(word) => word,
                    Words::Several(words) => words.join("+"),
                },
                reason: described.or(job.state_reason).unwrap_or_default(),
                ending: job.exit_code.ending(),
                comment: job.comment.unwrap_or_default(),
            })
        })
        .collect()
}

/// Elements of an expression such as `0,2-5,7-9:2%4`.
fn ranges(text: &str) -> Result<Vec<RangeInclusive<u32>>, String> {
    let wrong = || format!("`{text}` is not a list of array elements");
    let list = text.split('%').next().unwrap_or_default();
    let mut found = Vec::new();
    for part in list.split(',').filter(|part| !part.is_empty()) {
        let (range, step) = match part.split_once(':') {
            Some((range, step)) => (range, step.parse::<usize>().map_err(|_| wrong())?),
            None => (part, 1),
        };
        let (first, last) = range.split_once('-').unwrap_or((range, range));
        let (first, last): (u32, u32) =
            (first.parse().map_err(|_| wrong())?, last.parse().map_err(|_| wrong())?);
        if step == 1 {
            found.push(first..=last);
        } else {
            found.extend((first..=last).step_by(step.max(1)).map(|element| element..=element));
        }
    }
    Ok(found)
}

/// Parses the job number from `sbatch --parsable`: `12` or `12;cluster`.
pub fn submitted(output: &[u8]) -> Result<u32, AnswerError> {
    let text = String::from_utf8_lossy(output);
    let number = text.lines().last().unwrap_or_default().split(';').next().unwrap_or_default().trim();
    number.parse().map_err(|_| AnswerError::new("sbatch", format!("`{}` is no job number", text.trim())))
}

/// Parses the nodes of a partition, or of the default one, from `sinfo --Node --format='%N|%c|%T|%P'`.
pub fn nodes(output: &[u8], partition: Option<&str>) -> Result<Vec<SlurmNode>, AnswerError> {
    let text = String::from_utf8_lossy(output);
    let mut nodes = Vec::new();
    for line in text.lines().filter(|line| !line.trim().is_empty()) {
        let fields: Vec<&str> = line.trim().split('|').collect();
        let [name, cpus, state, of] = fields[..] else {
            return Err(AnswerError::new("sinfo", format!("`{line}` does not describe a node")));
        };
        let cpus = cpus
            .trim_end_matches('+')
            .parse()
            .map_err(|_| AnswerError::new("sinfo", format!("bad CPUs `{cpus}` of {name}")))?;
        // The default partition ends with a star.
        if partition.map_or(!of.ends_with('*'), |partition| of.trim_end_matches('*') != partition) {
            continue;
        }
        // Suffixes: `*` does not answer, `$` and `@` mean maintenance or reboot. Nodes with `~` or `#` sleep
        // or wake up, and take jobs.
        let marked = state.ends_with(['*', '$', '@', '%', '!']);
        let bare = state.trim_end_matches(|c: char| !c.is_ascii_alphabetic());
        let up =
            !marked && matches!(bare, "idle" | "allocated" | "mixed" | "completing" | "reserved" | "planned");
        nodes.push(SlurmNode { name: name.to_owned(), cpus, up });
    }
    nodes.sort_by(|a, b| a.name.cmp(&b.name));
    nodes.dedup_by(|a, b| a.name == b.name);
    Ok(nodes)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `squeue --json` of Slurm 22.05: a running job, the rest of its array, a cancelled job and one that is
    /// not an array.
    const OLD: &str = include_str!("recorded/squeue-22.05.json");

    #[test]
    fn what_an_old_slurm_says_of_its_jobs_is_read() {
        let jobs = jobs(OLD.as_bytes()).unwrap();
        let about = |job: &SlurmJob| (job.array, job.elements.clone(), job.stage());
        assert_eq!(about(&jobs[0]), (19, vec![0..=0], Stage::Ended));
        assert_eq!(
            (jobs[0].outcome(), jobs[0].ending),
            ("CANCELLED".to_owned(), Ending { code: 3, signal: 0 })
        );
        assert_eq!(about(&jobs[1]), (19, vec![2..=2], Stage::Pending));
        assert_eq!(about(&jobs[2]), (19, vec![5..=5], Stage::Running));
        assert_eq!(about(&jobs[3]), (19, vec![13..=15], Stage::Pending));
        assert!(jobs[3].is_about(14) && !jobs[3].is_about(12));
        assert!(jobs[..4].iter().all(|job| job.comment == "forelight:u1"));
        assert_eq!((about(&jobs[4]), jobs[4].comment.as_str()), ((25, vec![], Stage::Ended), "dl"));
        assert_eq!(jobs[4].outcome(), "DEADLINE");
    }

    #[test]
    fn the_forms_of_newer_slurms_are_read_too() {
        let new = r#"{"jobs": [{"job_id": 12, "array_job_id": {"set": true, "infinite": false, "number": 12},
            "array_task_id": {"set": false, "infinite": false, "number": 0}, "array_task_string": "0-2,5%2",
            "job_state": ["PENDING"], "state_reason": "Resources", "exit_code": {"status": ["SUCCESS"],
            "return_code": {"set": true, "infinite": false, "number": 0}, "signal": {"id": {"set": false, "infinite": false, "number": 0}, "name": ""}},
            "comment": "forelight:a"},
            {"job_id": 13, "array_job_id": {"set": true, "infinite": false, "number": 12}, "array_task_id": {"set": true, "infinite": false, "number": 3},
            "array_task_string": "", "job_state": ["CANCELLED", "COMPLETING"], "exit_code": {"return_code": {"set": true, "number": 1}}, "comment": ""},
            {"job_id": 14, "array_job_id": {"set": true, "infinite": false, "number": 12}, "array_task_id": {"set": true, "infinite": false, "number": 4},
            "job_state": ["FAILED"], "exit_code": {"return_code": {"set": true, "number": 0}, "signal": {"id": {"set": true, "number": 9}}}}]}"#;
        let jobs = jobs(new.as_bytes()).unwrap();
        assert_eq!((jobs[0].elements.clone(), jobs[0].stage()), (vec![0..=2, 5..=5], Stage::Pending));
        // `CANCELLED` with `COMPLETING`: the process may still run.
        assert_eq!((jobs[1].elements.clone(), jobs[1].stage()), (vec![3..=3], Stage::Running));
        assert_eq!((jobs[2].stage(), jobs[2].outcome()), (Stage::Ended, "FAILED by signal 9".to_owned()));
    }

    #[test]
    fn what_slurm_could_not_start_and_holds_for_ever_is_told_from_what_waits() {
        let held = |reason: &str| SlurmJob {
            array: 1,
            elements: vec![0..=0],
            state: "PENDING".to_owned(),
            reason: reason.to_owned(),
            ending: Ending::default(),
            comment: String::new(),
        };
        assert_eq!(held("launch_failed_requeued_held").stage(), Stage::Stuck);
        assert_eq!(held("launch failed requeued held").stage(), Stage::Stuck);
        // A person holds it and will release it.
        assert_eq!(held("JobHeldUser").stage(), Stage::Pending);
        assert_eq!(SlurmJob { state: "SOMETHING_NEW".to_owned(), ..held("") }.stage(), Stage::Running);
    }

    #[test]
    fn elements_are_read_in_all_their_forms() {
        assert_eq!(ranges("0,2-4,7%3").unwrap(), [0..=0, 2..=4, 7..=7]);
        assert_eq!(ranges("1-5:2").unwrap(), [1..=1, 3..=3, 5..=5]);
        assert!(ranges("0-...").is_err());
    }

    #[test]
    fn a_submitted_array_has_a_number_and_anything_else_is_refused() {
        assert_eq!(submitted(b"12\n").unwrap(), 12);
        assert_eq!(submitted(b"sbatch: a word of the site\n13;north\n").unwrap(), 13);
        assert!(submitted(b"").unwrap_err().to_string().contains("no job number"));
    }

    #[test]
    fn nodes_are_up_if_they_take_jobs_now_or_when_they_are_woken() {
        let listed = b"a|2|idle|day*\na|2|idle|night\nb|16|allocated|day*\nc|4|down*|day*\nd|4|idle*|day*\ne|4|idle~|day*\n\
            f|8|drained|day*\ng|8|mixed|night\nh|4|maint|day*\ni|4|reserved|day*\n";
        let up = |partition: Option<&str>| {
            let nodes = nodes(listed, partition).unwrap();
            nodes.into_iter().filter(|node| node.up).map(|node| node.name).collect::<Vec<_>>().join(" ")
        };
        assert_eq!(up(None), "a b e i");
        assert_eq!(up(Some("day")), "a b e i");
        assert_eq!(up(Some("night")), "a g");
        let all = nodes(listed, None).unwrap();
        assert_eq!(all.len(), 8);
        assert_eq!(all[1], SlurmNode { name: "b".to_owned(), cpus: 16, up: true });
    }

    #[test]
    fn rubbish_is_an_error_of_one_line_that_names_the_program() {
        for text in ["", "slurm_load_jobs error", "{}", r#"{"jobs": [{}]}"#] {
            let error = jobs(text.as_bytes()).unwrap_err().to_string();
            assert!(
                error.starts_with("cannot read the output of squeue") && !error.contains('\n'),
                "{error}"
            );
        }
        assert!(nodes(b"a|b", None).unwrap_err().to_string().contains("`a|b` does not describe a node"));
    }
}
