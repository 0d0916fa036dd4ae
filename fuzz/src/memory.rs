//! An allocator that ends the program where a reader takes more memory than any small file is worth.
//!
//! libFuzzer's own limit needs a sanitizer's runtime, which stable Rust does not link; its limit of resident
//! memory sees only what is touched.

use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicUsize, Ordering};

/// What is believed of a compressed file of a few kilobytes (256 MiB, `genesplat_io::format`), twice, and the
/// corpus.
const BYTES_MAX: usize = 768 << 20;

static HELD: AtomicUsize = AtomicUsize::new(0);

pub(crate) struct Bounded;

impl Bounded {
    fn take(bytes: usize) {
        if HELD.fetch_add(bytes, Ordering::Relaxed).saturating_add(bytes) > BYTES_MAX {
            // Once: the message may itself take memory.
            HELD.store(0, Ordering::Relaxed);
            eprintln!("a reader asks for {bytes} bytes, and more than {BYTES_MAX} in all");
            std::process::abort();
        }
    }
}

// Every call is handed on as it is; a program has no other way to see what is taken.
unsafe impl GlobalAlloc for Bounded {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        Self::take(layout.size());
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        Self::take(layout.size());
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn realloc(&self, block: *mut u8, layout: Layout, bytes: usize) -> *mut u8 {
        Self::take(bytes);
        HELD.fetch_sub(layout.size(), Ordering::Relaxed);
        unsafe { System.realloc(block, layout, bytes) }
    }

    unsafe fn dealloc(&self, block: *mut u8, layout: Layout) {
        HELD.fetch_sub(layout.size(), Ordering::Relaxed);
        unsafe { System.dealloc(block, layout) }
    }
}
