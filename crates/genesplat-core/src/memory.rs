//! Whether memory can be had, asked before it is taken.
//!
//! A `Vec` that finds no memory ends the process, and in stable Rust nothing can keep it from that. So
//! whoever is about to take much asks first, and fails with a sentence. It costs a few microseconds: the
//! system maps pages that nobody touches, and takes them back.
//!
//! A system that promises more than it has (Linux, unless told otherwise) refuses only what goes beyond a
//! limit of the process or beyond all reason.

use std::hint::black_box;

use crate::backend::BackendError;

/// For all that is small, and taken without asking.
const SPARE_BYTES: usize = 32 << 20;

/// Fails where `bytes` more cannot be had now, with some to spare; says that they were for `purpose`.
pub fn ensure_memory(bytes: usize, purpose: &str) -> Result<(), BackendError> {
    let mut probe: Vec<u8> = Vec::new();
    let there = bytes.checked_add(SPARE_BYTES).is_some_and(|all| probe.try_reserve_exact(all).is_ok());
    // Or the compiler would see that nothing is done with it.
    black_box(&probe);
    if there {
        Ok(())
    } else {
        Err(BackendError::HostOutOfMemory { wanted: bytes as u64, purpose: purpose.into() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_no_machine_has_is_refused_with_a_sentence() {
        ensure_memory(0, "nothing").unwrap();
        for bytes in [1 << 60, usize::MAX] {
            let sentence = ensure_memory(bytes, "a test").unwrap_err().to_string();
            assert!(sentence.contains(&bytes.to_string()) && sentence.contains("for a test"), "{sentence}");
        }
    }
}
