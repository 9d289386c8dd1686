//! Real programs in bubblewrap: what they can write, read and reach, and that limits and measurements hold as
//! they do outside.

use forelight_renderer::door::{Ending, Limits, RendererError, Run};
use forelight_renderer::process::{Exchange, Finished, Program, Sandbox, Session, run};
use forelight_test_needs::not_run;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

struct Outside {
    sandbox: Sandbox,
    cancelled: AtomicBool,
    home: tempfile::TempDir,
    secret: tempfile::NamedTempFile,
}

impl Outside {
    /// `None` without bubblewrap, or where it cannot work.
    fn new() -> Option<Self> {
        // It is named by a relative path, as a token file may be.
        let secret = tempfile::Builder::new().tempfile_in("").unwrap();
        std::fs::write(secret.path(), "a token").unwrap();
        let relative = secret.path().file_name().unwrap();
        match Sandbox::new(vec![relative.into()]) {
            Ok(sandbox) => {
                let home = tempfile::tempdir().unwrap();
                Some(Self { sandbox, cancelled: AtomicBool::new(false), home, secret })
            }
            Err(error) if !has_namespaces() => {
                // Within many containers. The worker refuses `--sandbox` there.
                assert!(error.to_string().contains("no bubblewrap on this machine: "), "{error}");
                None
            }
            Err(error) => {
                not_run(error);
                None
            }
        }
    }

    fn run<T>(&self, limits: Limits, question: impl FnOnce(&Run<'_>) -> T) -> T {
        let silent = Run::silent(&self.cancelled, self.sandbox.folder(), limits);
        question(&Run { sandbox: Some(&self.sandbox), ..silent })
    }

    fn program(&self, script: &str) -> Program {
        Program::new("/bin/sh", self.home.path()).arg("-c").arg(script)
    }

    fn shell(&self, script: &str, limits: Limits) -> Result<Finished, RendererError> {
        self.run(limits, |outside| run(&self.program(script), &[], outside, &mut |_| {}))
    }

    fn said(&self, script: &str) -> String {
        self.shell(script, Limits::default()).unwrap().last_lines.join("\n")
    }
}

/// Whether the system lets processes make namespaces.
fn has_namespaces() -> bool {
    std::process::Command::new("unshare")
        .args(["--user", "--pid", "--fork", "true"])
        .status()
        .unwrap()
        .success()
}

#[test]
fn a_program_writes_its_home_and_the_folder_of_tasks_and_nothing_else() {
    let Some(outside) = Outside::new() else { return };
    let beside = tempfile::tempdir().unwrap();
    let task = tempfile::tempdir_in(outside.sandbox.folder()).unwrap();
    let write =
        |folder: &Path| outside.shell(&format!("echo x >{}/file", folder.display()), Limits::default());
    write(outside.home.path()).unwrap();
    write(task.path()).unwrap();
    assert!(task.path().join("file").is_file() && outside.home.path().join("file").is_file());
    assert!(matches!(write(beside.path()), Err(RendererError::Ended { .. })));
    assert!(!beside.path().join("file").exists());
    assert_eq!(outside.said("echo $HOME $TMPDIR; pwd"), {
        let home = outside.home.path().display();
        format!("{home} {home}\n{home}")
    });
}

#[test]
fn a_program_sees_no_secret_no_other_process_and_no_network_unless_it_needs_one() {
    let Some(outside) = Outside::new() else { return };
    let secret = outside.secret.path().canonicalize().unwrap().display().to_string();
    let read = outside.said(&format!("cat {secret} 2>&1; echo"));
    assert!(!read.contains("a token"), "{read}");
    // The shell itself.
    assert_eq!(outside.said("echo /proc/[0-9]*"), "/proc/1");
    let own = std::process::id();
    assert_eq!(outside.said(&format!("kill -0 {own} 2>/dev/null && echo seen; echo")), "");
    let devices = "cut -d: -f1 /proc/net/dev | tail -n +3 | tr -d ' ' | sort | tr '\\n' ' '";
    assert_eq!(outside.said(devices), "lo ");
    let all = std::fs::read_to_string("/proc/net/dev").unwrap().lines().count();
    let program = outside.program("wc -l </proc/net/dev").connected();
    let run = |outside: &Run<'_>| run(&program, &[], outside, &mut |_| {});
    assert_eq!(outside.run(Limits::default(), run).unwrap().last_lines, [all.to_string()]);
}

#[test]
fn exit_codes_signals_and_limits_are_those_of_the_program() {
    let Some(outside) = Outside::new() else { return };
    let ending = |script: &str| match outside.shell(script, Limits::default()) {
        Err(RendererError::Ended { ending, .. }) => ending,
        other => panic!("{other:?}"),
    };
    assert_eq!(ending("exit 7"), Ending::Code(7));
    assert_eq!(ending("sh -c 'kill -SEGV $$'"), Ending::Signal(11));
    let limits = Limits { time: Some(Duration::from_secs(2)), ..Limits::default() };
    let asked = "trap 'echo asked >asked; exit 0' TERM; while :; do sleep 0.05; done";
    assert!(matches!(outside.shell(asked, limits), Err(RendererError::TimeLimit(_))));
    assert!(outside.home.path().join("asked").is_file(), "it was asked before it was ended");
    let limits = Limits { memory_bytes: Some(100 << 20), ..Limits::default() };
    assert!(matches!(outside.shell("tail /dev/zero", limits), Err(RendererError::OutOfMemory(_))));
    let limits = Limits {
        time: Some(Duration::from_millis(300)),
        grace: Duration::from_millis(100),
        ..Limits::default()
    };
    let began = Instant::now();
    assert!(matches!(outside.shell("trap '' TERM; sleep 60", limits), Err(RendererError::TimeLimit(_))));
    assert!(began.elapsed() < Duration::from_secs(50));
}

#[test]
fn cpu_time_and_memory_are_those_of_the_program() {
    let Some(outside) = Outside::new() else { return };
    let usage =
        outside.shell("i=0; while [ $i -lt 300000 ]; do i=$((i+1)); done", Limits::default()).unwrap().usage;
    assert!(usage.cpu_nanos > 20_000_000, "{usage:?}");
    let usage = outside.shell("head -c 60000000 /dev/zero | tail", Limits::default()).unwrap().usage;
    assert!(usage.peak_memory_bytes > 50 << 20, "{usage:?}");
    outside.run(Limits::default(), |run| {
        let program = outside.program("while read line; do echo $line; done");
        let mut exchange = Exchange::start(&program, &[], run).unwrap();
        exchange.ask(b"hello\n", run, &mut |answer| Ok(answer.ends_with(b"\n"))).unwrap();
        let first = exchange.cpu_nanos().expect("the system says it");
        for _ in 0..200 {
            exchange.ask(b"hello\n", run, &mut |answer| Ok(answer.ends_with(b"\n"))).unwrap();
        }
        assert!(exchange.cpu_nanos().unwrap() > first);
        exchange.finish(run).unwrap();
    });
}

#[test]
fn nothing_outlives_a_cancelled_run() {
    let Some(outside) = Outside::new() else { return };
    let mark = format!("{}", 61_000 + std::process::id() % 1000);
    let program = outside.program(&format!("setsid sleep {mark} & echo started; sleep {mark}"));
    outside.run(Limits { grace: Duration::from_millis(50), ..Limits::default() }, |run| {
        let mut session = Session::start(&program, &[], run).unwrap();
        let since = Instant::now();
        assert_eq!(session.next(since, run).unwrap().unwrap().text, "started");
        outside.cancelled.store(true, Ordering::Relaxed);
        assert!(matches!(session.next(since, run), Err(RendererError::Cancelled)));
    });
    let sleeps = std::process::Command::new("pgrep").args(["-f", &format!("sleep {mark}")]).output().unwrap();
    assert_eq!(String::from_utf8_lossy(&sleeps.stdout), "");
}

#[test]
fn a_program_that_does_not_exist_is_named() {
    let Some(outside) = Outside::new() else { return };
    let absent = Program::new("/nowhere/renderer", outside.home.path());
    let error =
        outside.run(Limits::default(), |outside| run(&absent, &[], outside, &mut |_| {})).unwrap_err();
    assert!(error.to_string().contains("/nowhere/renderer"), "{error}");
}
