//! Standard error may be a file on a full disk, or a pipe without a reader.

use std::fs::OpenOptions;
use std::process::{Command, Stdio};

/// The exit code of a command that cannot write to standard error.
fn unheard(arguments: &[&str]) -> Option<i32> {
    let full = OpenOptions::new().write(true).open("/dev/full").unwrap();
    let mut forelight = Command::new(env!("CARGO_BIN_EXE_forelight"));
    forelight
        .args(arguments)
        .env("RUST_LOG", "trace")
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(full);
    forelight.status().unwrap().code()
}

#[test]
fn what_nobody_can_read_stops_nothing() {
    let heard = |arguments: &[&str]| {
        let output =
            Command::new(env!("CARGO_BIN_EXE_forelight")).args(arguments).env("RUST_LOG", "trace").output();
        let output = output.unwrap();
        assert!(
            !output.stderr.is_empty(),
            "{arguments:?} writes nothing to standard error, so this test would prove nothing"
        );
        output.status.code()
    };
    let folder = tempfile::tempdir().unwrap();
    let missing = folder.path().join("bundle");
    // The first command writes logs, the second ends with an error.
    for arguments in [
        &["token", "--data", folder.path().to_str().unwrap(), "--role", "viewer"][..],
        &["preview", missing.to_str().unwrap(), "--out", "x.png"],
    ] {
        assert_eq!(unheard(arguments), heard(arguments), "{arguments:?}");
    }
}
