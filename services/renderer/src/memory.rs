//! Memory of this process, as Linux reports it.

/// Peak resident memory of this process in bytes (`VmHWM` on Linux), 0 if unknown.
pub fn peak_rss_bytes() -> u64 {
    status_bytes("VmHWM:")
}

/// Resident memory of this process in bytes (`VmRSS` on Linux), 0 if unknown.
pub fn resident_bytes() -> u64 {
    status_bytes("VmRSS:")
}

fn status_bytes(name: &str) -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix(name));
    let kibibytes = line.and_then(|rest| rest.split_whitespace().next()?.parse::<u64>().ok());
    kibibytes.unwrap_or(0).saturating_mul(1024)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn this_process_has_a_peak_of_memory() {
        // Linux counts each thread's last pages late, in the two numbers not alike.
        const LATE: u64 = 4 << 20;
        let (resident, peak) = (resident_bytes(), peak_rss_bytes());
        assert!(resident > 1 << 16 && resident <= peak + LATE, "{resident}, {peak}");
    }
}
