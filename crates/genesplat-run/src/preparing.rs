//! Whether something is prepared that a stranger's files bound: a scene is loaded, photos are copied, an
//! archive is unpacked. The first Ctrl-C or SIGTERM then ends the process at once, though training would save
//! what it has; who hears signals asks here.

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use crate::cluster;

/// How many [`Preparing`] there are.
static PREPARING: AtomicUsize = AtomicUsize::new(0);

/// While this is there, something is prepared.
pub struct Preparing(());

/// Begins to prepare.
pub fn begin() -> Preparing {
    PREPARING.fetch_add(1, Ordering::SeqCst);
    Preparing(())
}

/// The same, unless `stop` is set already.
pub fn begin_unless(stop: &AtomicBool) -> Option<Preparing> {
    let preparing = begin();
    (!stop.load(Ordering::Relaxed) || cluster::is_member()).then_some(preparing)
}

/// Whether something is prepared.
pub fn is_under_way() -> bool {
    PREPARING.load(Ordering::SeqCst) > 0
}

impl Drop for Preparing {
    fn drop(&mut self) {
        PREPARING.fetch_sub(1, Ordering::SeqCst);
    }
}
