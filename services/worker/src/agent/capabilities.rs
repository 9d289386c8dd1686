//! What this machine has.

use crate::own::Ambient;
use forelight_preview::PreviewError;
use forelight_protocol::Capabilities;
use std::fs;

/// Most characters of a name on the wire.
const LONGEST_NAME: usize = 200;

/// Finds out what this machine has. Opens the graphics device, if previews are to be made with one.
pub fn capabilities(renderer: &Ambient) -> Result<Capabilities, PreviewError> {
    let adapter = renderer.adapter()?;
    Ok(Capabilities {
        memory_bytes: memory_bytes(&fs::read_to_string("/proc/meminfo").unwrap_or_default()),
        processor: processor(&fs::read_to_string("/proc/cpuinfo").unwrap_or_default()),
        gpu: adapter.as_ref().is_some_and(|adapter| adapter.is_hardware),
        vulkan_adapter: adapter.and_then(|adapter| name(&adapter.name)),
        calibration: None,
    })
}

/// `MemTotal` of Linux.
fn memory_bytes(meminfo: &str) -> Option<u64> {
    let line = meminfo.lines().find_map(|line| line.strip_prefix("MemTotal:"))?;
    let kibibytes: u64 = line.split_whitespace().next()?.parse().ok()?;
    kibibytes.checked_mul(1024)
}

/// `model name` of Linux on x86; other machines say other things, or nothing.
fn processor(cpuinfo: &str) -> Option<String> {
    let line = cpuinfo.lines().find(|line| line.starts_with("model name"))?;
    name(line.split_once(':')?.1)
}

/// A name as the wire takes it: one line of 1 to 200 characters.
fn name(text: &str) -> Option<String> {
    let line = text.split_whitespace().collect::<Vec<_>>().join(" ");
    let short: String = line.chars().filter(|c| !c.is_control()).take(LONGEST_NAME).collect();
    (!short.is_empty()).then_some(short)
}

#[cfg(test)]
mod tests {
    use super::*;
    use forelight_preview::Choice;

    #[test]
    fn what_linux_says_is_read_and_what_it_does_not_say_is_absent() {
        assert_eq!(memory_bytes("MemFree: 1 kB\nMemTotal:       16384 kB\n"), Some(16 << 20));
        assert_eq!(processor("processor\t: 0\nmodel name\t: A  Processor\n"), Some("A Processor".into()));
        for nonsense in ["", "MemTotal:", "MemTotal: many kB", "model name\t:  "] {
            assert_eq!((memory_bytes(nonsense), processor(nonsense)), (None, None), "{nonsense}");
        }
    }

    #[test]
    fn a_machine_that_previews_on_its_processor_has_no_adapter() {
        let found = capabilities(&Ambient::new(Choice::Cpu)).unwrap();
        assert_eq!((found.vulkan_adapter, found.gpu), (None, false));
        assert!(found.memory_bytes.is_some_and(|bytes| bytes > 1 << 20));
    }
}
