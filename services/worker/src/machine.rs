//! What this machine offers to the farm.

use forelight_protocol::Capabilities;
use std::fs;

/// Finds out what this machine has, apart from what only a renderer knows.
pub fn machine() -> Capabilities {
    Capabilities {
        memory_bytes: memory_bytes(&fs::read_to_string("/proc/meminfo").unwrap_or_default()),
        processor: processor(&fs::read_to_string("/proc/cpuinfo").unwrap_or_default()),
        ..Capabilities::default()
    }
}

/// `MemTotal` from `/proc/meminfo` on Linux.
fn memory_bytes(meminfo: &str) -> Option<u64> {
    let line = meminfo.lines().find_map(|line| line.strip_prefix("MemTotal:"))?;
    let kibibytes: u64 = line.split_whitespace().next()?.parse().ok()?;
    kibibytes.checked_mul(1024)
}

/// `model name` from `/proc/cpuinfo`. Linux gives it on x86, other systems may not.
fn processor(cpuinfo: &str) -> Option<String> {
    let line = cpuinfo.lines().find(|line| line.starts_with("model name"))?;
    Capabilities::name(line.split_once(':')?.1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_linux_says_is_read_and_what_it_does_not_say_is_absent() {
        assert_eq!(memory_bytes("MemFree: 1 kB\nMemTotal:       16384 kB\n"), Some(16 << 20));
        assert_eq!(processor("processor\t: 0\nmodel name\t: A  Processor\n"), Some("A Processor".into()));
        for nonsense in ["", "MemTotal:", "MemTotal: many kB", "model name\t:  "] {
            assert_eq!((memory_bytes(nonsense), processor(nonsense)), (None, None), "{nonsense}");
        }
    }

    #[test]
    fn this_machine_has_memory() {
        assert!(machine().memory_bytes.is_some_and(|bytes| bytes > 1 << 20));
    }
}
