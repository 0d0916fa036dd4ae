//! How much memory the process has used.

use std::fs;

use genesplat_io::input;

/// From now on the peak is that of what comes, where the system can do that: a process may make several runs.
pub(crate) fn forget_peak() {
    // Nothing depends on it but a figure.
    let _ = fs::write("/proc/self/clear_refs", "5");
}

/// The most memory that this process has held at once, bytes: Linux's `VmHWM`; `None` where the system does
/// not tell.
pub fn peak_bytes() -> Option<u64> {
    high_water_mark(&input::read_text("/proc/self/status".as_ref()).ok()?)
}

fn high_water_mark(status: &str) -> Option<u64> {
    let value = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kibibytes: u64 = value.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(1024 * kibibytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[cfg(target_os = "linux")]
    #[test]
    fn a_peak_can_be_forgotten() {
        if !std::path::Path::new("/proc/self/clear_refs").exists() {
            eprintln!("skipped: this kernel forgets no peaks");
            return;
        }
        drop(std::hint::black_box(vec![1u8; 300 << 20]));
        let before = peak_bytes().unwrap();
        assert!(before > 300 << 20);
        forget_peak();
        assert!(peak_bytes().unwrap() < before - (200 << 20));
    }

    #[test]
    fn the_high_water_mark_is_read_in_bytes() {
        assert_eq!(high_water_mark("Name:\tgenesplat\nVmHWM:\t    2048 kB\nVmRSS:\t 1 kB\n"), Some(2 << 20));
        assert_eq!(high_water_mark("Name:\tgenesplat\n"), None);
    }
}
