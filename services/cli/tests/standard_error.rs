//! Standard error may be a file on a full disk, or a pipe that nobody reads any more.

use std::fs::OpenOptions;
use std::process::{Command, Stdio};

/// The exit code of a command none of whose words can be written to standard error.
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
        assert!(!output.stderr.is_empty(), "{arguments:?} says nothing, so that the test tests nothing");
        output.status.code()
    };
    let folder = tempfile::tempdir().unwrap();
    let missing = folder.path().join("bundle");
    // What is logged on the way, and what is said at the end.
    for arguments in [
        &["token", "--data", folder.path().to_str().unwrap(), "--role", "viewer"][..],
        &["preview", missing.to_str().unwrap(), "--out", "x.png"],
    ] {
        assert_eq!(unheard(arguments), heard(arguments), "{arguments:?}");
    }
}
