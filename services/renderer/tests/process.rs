//! Real programs, held to limits: none of them outlives its run.

use forelight_protocol::{JobId, TaskSpec, VideoSpec};
use forelight_renderer::door::{Ending, Limits, Pause, RendererError, Run};
use forelight_renderer::process::{Finished, Line, Program, Session, end_orphans, run};
use forelight_renderer::{Assignment, Control, ExecuteError, with_run};
use parking_lot::Mutex;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// The outside of a run, with what it logged.
struct Outside {
    cancelled: AtomicBool,
    log: Mutex<Vec<String>>,
    folder: tempfile::TempDir,
}

impl Outside {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        Self { cancelled: AtomicBool::new(false), log: Mutex::default(), folder }
    }

    fn with<T>(&self, limits: Limits, question: impl FnOnce(&Run<'_>) -> T) -> T {
        let log = |line: &str| {
            let mut lines = self.log.lock();
            if lines.len() < 1000 {
                lines.push(line.to_owned());
            }
        };
        let scratch = self.folder.path();
        question(&Run { log: &log, ..Run::silent(&self.cancelled, scratch, limits) })
    }

    fn shell(&self, script: &str, limits: Limits) -> Result<Finished, RendererError> {
        let program = Program::new("/bin/sh", self.folder.path()).arg("-c").arg(script);
        self.with(limits, |outside| run(&program, &[], outside, &mut |_: &Line| {}))
    }

    /// The numbers that a script wrote into a file of its folder.
    fn pids(&self, file: &str) -> Vec<u32> {
        let text = std::fs::read_to_string(self.folder.path().join(file)).unwrap_or_default();
        text.split_whitespace().map(|pid| pid.parse().unwrap()).collect()
    }
}

fn quick(grace_millis: u64) -> Limits {
    Limits { grace: Duration::from_millis(grace_millis), ..Limits::default() }
}

/// Whether the process runs: a zombie does not. Waits a little for one that was just killed.
fn lives(pid: u32) -> bool {
    let runs = || {
        let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).unwrap_or_default();
        stat.rsplit_once(')').is_some_and(|(_, rest)| !rest.trim_start().starts_with(['Z', 'X']))
    };
    (0..50).all(|_| {
        std::thread::sleep(Duration::from_millis(10));
        runs()
    })
}

fn is_child_of_ours(pid: u32) -> bool {
    let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).unwrap_or_default();
    let own = std::process::id().to_string();
    stat.rsplit_once(')').and_then(|(_, rest)| rest.split_whitespace().nth(1)) == Some(own.as_str())
}

#[test]
fn lines_come_as_they_are_printed_and_the_last_needs_no_end() {
    let outside = Outside::new();
    let finished = outside.shell("echo one; echo two >&2; printf three", Limits::default()).unwrap();
    let mut lines = outside.log.lock().clone();
    lines.sort();
    assert_eq!(lines, ["one", "three", "two"]);
    assert_eq!(finished.last_lines.len(), 3);
}

#[test]
fn the_environment_is_what_was_named_and_input_is_empty() {
    let outside = Outside::new();
    outside.shell("cat; env | cut -d= -f1 | sort | tr '\\n' ' '", Limits::default()).unwrap();
    let line = outside.log.lock()[0].clone();
    let names: Vec<&str> =
        line.split_whitespace().filter(|name| !["PWD", "OLDPWD", "SHLVL", "_"].contains(name)).collect();
    assert_eq!(names, ["FORELIGHT_PROCESS", "HOME", "LANG", "PATH", "TMPDIR"]);
}

#[test]
fn a_failure_has_its_code_or_signal_and_the_last_lines() {
    let outside = Outside::new();
    let error = outside.shell("echo broken; exit 7", Limits::default()).unwrap_err();
    assert!(
        matches!(&error, RendererError::Ended { ending: Ending::Code(7), last_lines, .. } if last_lines == &["broken"])
    );
    assert_eq!(error.to_string(), "sh ended with exit code 7; its last lines: broken");
    let crashed = outside.shell("kill -SEGV $$", Limits::default()).unwrap_err();
    assert!(matches!(crashed, RendererError::Ended { ending: Ending::Signal(11), .. }), "{crashed}");
    let absent = Program::new("/nowhere/renderer", outside.folder.path());
    let error = outside.with(Limits::default(), |o| run(&absent, &[], o, &mut |_| {})).unwrap_err();
    assert!(error.to_string().starts_with("/nowhere/renderer: "), "{error}");
}

#[test]
fn known_messages_of_a_failure_are_understood() {
    let outside = Outside::new();
    let error =
        |text: &str| outside.shell(&format!("echo '{text}' >&2; exit 1"), Limits::default()).unwrap_err();
    assert!(matches!(error("wood.png: No such file or directory"), RendererError::MissingFile(_)));
    assert!(matches!(error("terminate: std::bad_alloc"), RendererError::OutOfMemory(_)));
    assert!(matches!(error("CUDA error: out of memory"), RendererError::Gpu(_)));
    assert!(matches!(error("License error: none left"), RendererError::Licence(_)));
    // What a killed program said before is not why it ended. That memory ran out may be.
    let killed = |text: &str| outside.shell(&format!("echo '{text}' >&2; kill -KILL $$"), Limits::default());
    let error = killed("libasound.so: No such file or directory").unwrap_err();
    assert!(matches!(error, RendererError::Ended { ending: Ending::Signal(9), .. }), "{error}");
    assert!(matches!(killed("std::bad_alloc"), Err(RendererError::OutOfMemory(_))));
}

/// Pauses a program once it has written its number into a file, for longer than it may run.
struct Interruption<'a> {
    outside: &'a Outside,
    had_stopped: AtomicBool,
    is_over: AtomicBool,
}

impl Interruption<'_> {
    const LONG: Duration = Duration::from_millis(2500);

    /// The state of the process, as proc_pid_stat(5) names it. `None` before it has written its number.
    fn state(&self) -> Option<char> {
        let stat =
            std::fs::read_to_string(format!("/proc/{}/stat", self.outside.pids("pid").first()?)).ok()?;
        stat.rsplit_once(") ")?.1.chars().next()
    }
}

impl Pause for Interruption<'_> {
    fn is_wanted(&self) -> bool {
        !self.is_over.load(Ordering::Relaxed) && self.state().is_some()
    }

    fn wait(&self) {
        let since = Instant::now();
        while since.elapsed() < Self::LONG {
            self.had_stopped.fetch_or(self.state() == Some('T'), Ordering::Relaxed);
            std::thread::sleep(Duration::from_millis(10));
        }
        self.is_over.store(true, Ordering::Relaxed);
        std::fs::write(self.outside.folder.path().join("go"), "").unwrap();
    }
}

#[test]
fn a_paused_program_stands_still_and_the_pause_does_not_count() {
    let outside = Outside::new();
    let not = || AtomicBool::new(false);
    let interruption = Interruption { outside: &outside, had_stopped: not(), is_over: not() };
    // Nothing is started while it waits: a shell that is stopped before its child has begun is not in state T itself.
    let script = "echo $$ >new; mv new pid; until [ -e go ]; do :; done; echo done";
    let program = Program::new("/bin/sh", outside.folder.path()).arg("-c").arg(script);
    let limits = Limits { time: Some(Interruption::LONG - Duration::from_millis(500)), ..Limits::default() };
    let finished = outside.with(limits, |silent| {
        run(&program, &[], &Run { pause: Some(&interruption), ..*silent }, &mut |_| {})
    });
    assert_eq!(finished.unwrap().last_lines, ["done"]);
    assert!(interruption.had_stopped.into_inner(), "the system did not stop it");
}

#[test]
fn a_program_that_prints_all_the_time_is_stopped_too() {
    let outside = Outside::new();
    let (job_id, pictures) = (JobId::new(), Vec::new());
    let video = VideoSpec { job_id, pictures, frames_per_second: "24".parse().unwrap() };
    let task = Assignment::new(TaskSpec::Video(video), "".into());
    let script = "echo $$ >new; mv new pid; until [ -e go ]; do echo 1; done";
    let program = Program::new("/bin/sh", outside.folder.path()).arg("-c").arg(script);
    let control = Control::default();
    std::thread::scope(|scope| {
        let running = scope.spawn(|| {
            with_run(&task, &control, None, |outside| {
                let finished = run(&program, &[], outside, &mut |_| (outside.progress)(0.5));
                finished.map_err(|error| ExecuteError::Transient(error.to_string()))
            })
        });
        let until = |what: &dyn Fn() -> bool| {
            (0..1000).any(|_| {
                std::thread::sleep(Duration::from_millis(10));
                what()
            })
        };
        let stat = |pid: u32| std::fs::read_to_string(format!("/proc/{pid}/stat")).unwrap_or_default();
        let has_begun = until(&|| !outside.pids("pid").is_empty());
        control.pause(true);
        let had_stopped =
            has_begun && until(&|| control.stands_still() && stat(outside.pids("pid")[0]).contains(") T "));
        // The program ends before anything is asserted, because this scope waits for it.
        std::fs::write(outside.folder.path().join("go"), "").unwrap();
        control.pause(false);
        running.join().unwrap().unwrap();
        assert!(had_stopped, "the system did not stop it");
    });
}

#[test]
fn a_cancelled_program_ends_with_its_children_even_if_they_ignore_the_request() {
    let outside = Outside::new();
    let script = "trap '' TERM; echo $$ >>pids; (sleep 60 & echo $! >>pids; wait) & \
                  setsid sh -c 'echo $$ >>pids; sleep 61' & \
                  until [ $(wc -l <pids) -ge 3 ]; do sleep 0.02; done; echo ready; while :; do sleep 1; done";
    let begun = Instant::now();
    let error = std::thread::scope(|scope| {
        let running = scope.spawn(|| outside.shell(script, quick(200)).unwrap_err());
        while !outside.log.lock().iter().any(|line| line == "ready") {
            std::thread::sleep(Duration::from_millis(5));
        }
        outside.cancelled.store(true, Ordering::Relaxed);
        running.join().unwrap()
    });
    assert!(matches!(error, RendererError::Cancelled), "{error}");
    assert!(begun.elapsed() < Duration::from_secs(50));
    let pids = outside.pids("pids");
    assert_eq!(pids.len(), 3);
    for pid in pids {
        assert!(!lives(pid), "process {pid} was left behind");
        assert!(!is_child_of_ours(pid), "process {pid} was not reaped");
    }
}

#[test]
fn a_program_that_heeds_the_request_to_end_has_time_to_clean_up() {
    let outside = Outside::new();
    let limits = Limits { time: Some(Duration::from_secs(2)), ..quick(10_000) };
    let script = "trap 'echo clean >end; exit 0' TERM; touch begun; while :; do sleep 0.05; done";
    let error = outside.shell(script, limits).unwrap_err();
    assert!(matches!(error, RendererError::TimeLimit(_)), "{error}");
    assert_eq!(std::fs::read_to_string(outside.folder.path().join("end")).unwrap(), "clean\n");
}

#[test]
fn a_program_that_closes_its_output_is_still_held_to_its_time() {
    let outside = Outside::new();
    let limits = Limits { time: Some(Duration::from_millis(300)), ..quick(100) };
    let error = outside.shell("exec >/dev/null 2>&1; sleep 60", limits).unwrap_err();
    assert!(matches!(error, RendererError::TimeLimit(_)), "{error}");
}

#[test]
fn memory_of_all_processes_together_is_limited() {
    let outside = Outside::new();
    let limits = Limits { memory_bytes: Some(100 << 20), ..quick(100) };
    for script in ["tail /dev/zero & wait", "setsid tail /dev/zero & wait"] {
        let error = outside.shell(script, limits).unwrap_err();
        assert!(matches!(error, RendererError::OutOfMemory(_)), "{script}: {error}");
    }
    let program = Program::new("/bin/sh", outside.folder.path()).arg("-c").arg("tail /dev/zero");
    let error = outside.with(limits, |o| run(&program, &[], o, &mut |_| {})).unwrap_err();
    assert!(matches!(error, RendererError::OutOfMemory(_)), "{error}");
}

#[test]
fn what_programs_of_a_killed_process_left_is_ended_and_nothing_else() {
    let outside = Outside::new();
    // No process has the largest number. This one lives.
    let script = format!(
        "FORELIGHT_PROCESS={}-1 sleep 1000 & echo $! >pids; FORELIGHT_PROCESS={}-1 sleep 1000 & echo $! >>pids",
        i32::MAX,
        std::process::id()
    );
    let mut shell = std::process::Command::new("/bin/sh");
    assert!(shell.arg("-c").arg(script).current_dir(outside.folder.path()).status().unwrap().success());
    let pids = outside.pids("pids");
    // They begin as copies of the shell, which has no mark.
    let is_ended = || {
        std::thread::sleep(Duration::from_millis(10));
        end_orphans() > 0
    };
    assert!((0..1000).any(|_| is_ended()));
    while lives(pids[0]) {
        std::thread::sleep(Duration::from_millis(10));
    }
    assert!(lives(pids[1]));
    std::process::Command::new("kill").arg(pids[1].to_string()).status().unwrap();
}

#[test]
fn processes_that_a_program_leaves_behind_are_killed_and_counted() {
    let outside = Outside::new();
    let script = "sh -c 'echo $$ >>pids; while :; do :; done' & sh -c 'echo $$ >>pids; exec sleep 60' & \
                  setsid sh -c 'echo $$ >>pids; exec sleep 60' & sleep 1";
    let finished = outside.shell(script, Limits::default()).unwrap();
    for pid in outside.pids("pids") {
        assert!(!lives(pid), "process {pid} was left behind");
    }
    assert!(finished.usage.cpu_nanos > 50_000_000, "{:?}", finished.usage);
}

#[test]
fn time_of_children_that_were_waited_for_counts() {
    let outside = Outside::new();
    let script = "sh -c 'i=0; while [ $i -lt 300000 ]; do i=$((i+1)); done'";
    let finished = outside.shell(script, Limits::default()).unwrap();
    assert!(finished.usage.cpu_nanos > 50_000_000, "{:?}", finished.usage);
    assert!(finished.usage.peak_memory_bytes > 500_000);
}

#[test]
fn a_hundred_megabytes_of_output_pass_in_bounded_memory() {
    let outside = Outside::new();
    let program = Program::new("/bin/sh", outside.folder.path()).arg("-c").arg("head -c 100000000 /dev/zero");
    let (mut bytes, mut longest) = (0, 0);
    let mut count = |line: &Line| {
        // A zero byte is a character of its own.
        bytes += line.text.len();
        longest = longest.max(line.text.len());
    };
    outside.with(Limits::default(), |o| run(&program, &[], o, &mut count)).unwrap();
    assert_eq!((bytes, longest), (100_000_000, 8192));
}

#[test]
fn a_session_answers_lines_until_it_is_closed() {
    let outside = Outside::new();
    let script = "echo $$ >pid; while read line; do echo \"got $line\"; [ $line != die ] || kill -9 $$; done";
    let program = Program::new("/bin/sh", Path::new(outside.folder.path())).arg("-c").arg(script);
    outside.with(Limits::default(), |o| {
        let mut session = Session::start(&program, &[], o).unwrap();
        for word in ["one", "two"] {
            session.send(word).unwrap();
            let line = session.next(Instant::now(), o).unwrap().unwrap();
            assert_eq!(line.text, format!("got {word}"));
        }
        session.close();
        assert!(!lives(outside.pids("pid")[0]));

        let mut session = Session::start(&program, &[], o).unwrap();
        session.send("one").unwrap();
        session.next(Instant::now(), o).unwrap().unwrap();
        session.send("die").unwrap();
        while session.next(Instant::now(), o).unwrap().is_some() {}
        let RendererError::Ended { ending, last_lines, .. } = session.failure() else { panic!() };
        // Answers to earlier questions do not explain the end.
        assert_eq!((ending, last_lines), (Ending::Signal(9), vec!["got die".to_owned()]));

        let session = Session::start(&program, &[], o).unwrap();
        std::thread::sleep(Duration::from_millis(100));
        drop(session);
        assert!(!lives(outside.pids("pid")[0]));
    });
}

#[test]
fn a_session_whose_program_closes_its_output_and_goes_on_is_ended() {
    let outside = Outside::new();
    let script = "echo $$ >pid; echo last words; exec >/dev/null 2>&1 <&-; sleep 1000";
    let program = Program::new("/bin/sh", Path::new(outside.folder.path())).arg("-c").arg(script);
    outside.with(quick(100), |o| {
        let mut session = Session::start(&program, &[], o).unwrap();
        while session.next(Instant::now(), o).unwrap().is_some() {}
        let RendererError::Ended { ending, last_lines, .. } = session.failure() else { panic!() };
        assert_eq!((ending, last_lines), (Ending::Closed, vec!["last words".to_owned()]));
        assert!(!lives(outside.pids("pid")[0]));
    });
}
