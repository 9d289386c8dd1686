//! Sets the clock and fills the disk of a service from outside: see `shim.c`.

use forelight_test_needs::not_run;
use std::fs::File;
use std::os::unix::fs::FileExt as _;
use std::path::{Path, PathBuf};
use std::process::Command;

/// The library loaded into the service, and the file that controls it.
pub struct Shim {
    library: PathBuf,
    path: PathBuf,
    control: File,
}

impl Shim {
    /// Compiles it into this folder. Without a C compiler, reports that part of the test as not run and
    /// returns `None`.
    pub fn compile(folder: &Path) -> Option<Self> {
        let (library, path) = (folder.join("shim.so"), folder.join("shim.control"));
        let source = concat!(env!("CARGO_MANIFEST_DIR"), "/support/shim.c");
        let compiler = Command::new("cc")
            .args(["-shared", "-fPIC", "-O1", "-Wall", "-o"])
            .arg(&library)
            .arg(source)
            .status();
        if !compiler.is_ok_and(|status| status.success()) {
            not_run("no C compiler (cc): clocks are not set and disks are not full");
            return None;
        }
        let control =
            File::options().create(true).truncate(true).write(true).open(&path).expect("a file can be made");
        control.write_all_at(&[0; 16], 0).expect("a file can be written");
        Some(Self { library, path, control })
    }

    /// Environment variables to start a process with.
    pub fn environment(&self) -> [(&'static str, &Path); 2] {
        [("LD_PRELOAD", &self.library), ("FORELIGHT_SHIM", &self.path)]
    }

    /// Sets the clock this many seconds after the true time, or before it if negative.
    pub fn set_clock(&self, seconds: i64) {
        self.control.write_all_at(&seconds.to_ne_bytes(), 0).expect("a file can be written");
    }

    /// Fills the disk, or frees it again.
    pub fn fill_disk(&self, full: bool) {
        self.control.write_all_at(&i64::from(full).to_ne_bytes(), 8).expect("a file can be written");
    }
}
