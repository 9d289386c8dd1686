//! Another program that traces the same rays, in turns with this one, so that both see the machine in the
//! same state.
//!
//! Its only argument is the path of an exported file. It communicates in lines:
//!
//! | request | answer |
//! | --- | --- |
//! | | its name, once, when it is ready |
//! | `trace K` | nanoseconds of CPU time on one thread for all rays of set K |
//! | `differ K` | number of rays of set K whose last result differs from the file |
//!
//! It exits at the end of its input.

use anyhow::{Context, Result, bail};
use forelight_terminal::failure::BadInput;
use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

pub struct Peer {
    program: PathBuf,
    process: Child,
    /// Closed before waiting for the exit.
    input: Option<ChildStdin>,
    output: BufReader<ChildStdout>,
}

impl Peer {
    /// Starts the program, waits until it is ready, and returns it with its name.
    pub fn start(program: &Path, file: &Path) -> Result<(Self, String)> {
        let mut process =
            Command::new(program).arg(file).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().map_err(
                |error| BadInput::new(format!("--peer {}: cannot start: {error}", program.display())),
            )?;
        let (input, output) = (process.stdin.take(), process.stdout.take());
        let output = BufReader::new(output.context("the peer has no output")?);
        let mut peer = Self { program: program.to_owned(), process, input, output };
        let name = peer.line()?;
        Ok((peer, name))
    }

    /// CPU seconds for the rays of a set.
    pub fn trace(&mut self, set: usize) -> Result<f64> {
        Ok(self.ask(&format!("trace {set}"))? as f64 * 1e-9)
    }

    /// Number of rays of a set with different results.
    pub fn differing(&mut self, set: usize) -> Result<usize> {
        Ok(self.ask(&format!("differ {set}"))? as usize)
    }

    pub fn finish(mut self) -> Result<()> {
        drop(self.input.take());
        let status = self.process.wait().context("cannot wait for the peer")?;
        if !status.success() {
            bail!("the peer {} failed: {status}", self.program.display());
        }
        Ok(())
    }

    fn ask(&mut self, question: &str) -> Result<u64> {
        let input = self.input.as_mut().context("the peer was told to end")?;
        writeln!(input, "{question}")
            .and_then(|()| input.flush())
            .with_context(|| format!("the peer {} closed its input", self.program.display()))?;
        let answer = self.line()?;
        answer.parse().ok().with_context(|| {
            format!("the peer {} answered `{question}` with `{answer}`, not a number", self.program.display())
        })
    }

    fn line(&mut self) -> Result<String> {
        let mut line = String::new();
        let read = self.output.read_line(&mut line);
        match read
            .with_context(|| format!("cannot read the output of the peer {}", self.program.display()))?
        {
            0 => bail!("the peer {} exited without an answer", self.program.display()),
            _ => Ok(line.trim_end().to_owned()),
        }
    }
}

impl Drop for Peer {
    fn drop(&mut self) {
        // After `finish` the process has ended and this does nothing.
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::PermissionsExt;

    fn script(text: &str) -> (tempfile::TempDir, PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("peer.sh");
        std::fs::write(&path, format!("#!/bin/sh\n{text}\n")).unwrap();
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o755)).unwrap();
        (folder, path)
    }

    #[test]
    fn a_peer_says_its_name_and_answers_by_numbers() {
        let (_folder, path) = script(
            "echo Tracer 1.0\nwhile read -r word set; do case $word in trace) echo 2000000000;; *) echo $set;; esac; done",
        );
        let (mut peer, name) = Peer::start(&path, Path::new("x.rays")).unwrap();
        assert_eq!(name, "Tracer 1.0");
        assert_eq!(peer.trace(0).unwrap(), 2.0);
        assert_eq!(peer.differing(3).unwrap(), 3);
        peer.finish().unwrap();
    }

    #[test]
    fn a_peer_that_fails_or_talks_nonsense_is_named() {
        let (_folder, path) = script("exit 3");
        assert!(Peer::start(&path, Path::new("x")).err().unwrap().to_string().contains("peer.sh"));
        let (_folder, path) = script("echo x; read -r line; echo what");
        let (mut peer, _) = Peer::start(&path, Path::new("x")).unwrap();
        let message = peer.trace(0).unwrap_err().to_string();
        assert!(message.contains("peer.sh") && message.contains("what"), "{message}");
        let missing = Peer::start(Path::new("/there/is/none"), Path::new("x")).err().unwrap();
        assert!(missing.is::<BadInput>());
    }
}
