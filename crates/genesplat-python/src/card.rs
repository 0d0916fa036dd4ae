//! Graphics devices for pictures with derivatives: opened once a thread, since that takes a while.

use std::cell::RefCell;

use genesplat::core::BackendError;
use genesplat::gpu::GpuBackend;
use genesplat::run::device::DeviceChoice;

thread_local! {
    static OPEN: RefCell<Vec<(DeviceChoice, GpuBackend)>> = const { RefCell::new(Vec::new()) };
}

/// Does `work` on a device. One that has failed may be lost, and is opened anew next time.
pub(crate) fn on_card<T>(
    choice: DeviceChoice,
    work: impl FnOnce(&mut GpuBackend) -> Result<T, BackendError>,
) -> anyhow::Result<T> {
    let open = OPEN.with_borrow_mut(|open| {
        let at = open.iter().position(|(of, _)| *of == choice)?;
        Some(open.swap_remove(at).1)
    });
    let mut gpu = open.map_or_else(|| choice.open_graphics(), Ok)?;
    let done = work(&mut gpu)?;
    OPEN.with_borrow_mut(|open| open.push((choice, gpu)));
    Ok(done)
}
