//! A run by many processes that `mpirun` has started: all do the same, and rank 0 alone writes and speaks.

use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use std::{env, process, thread};

use anyhow::{Result, bail};
use genesplat_cluster::{ClusterBackend, Group};
use genesplat_core::{Alone, BackendError, Device, RowOwners};
use genesplat_io::Scene;

use crate::corrected::Corrected;
use crate::digest::{PARTS, digests};
use crate::numbers::memory as of_memory;
use crate::output;
use crate::settings::Settings;
use crate::{failure, memory};

/// What is said to who ends a run under `mpirun`.
pub const STOPPING: &str =
    "stopping, as mpirun asks for it: results so far are being saved if all of its processes are there";

/// Starters of processes that do not work together, and where each says how many there are.
const OTHER_STARTERS: [(&str, &str); 2] =
    [("srun", "SLURM_STEP_NUM_TASKS"), ("an mpiexec that is not Open MPI's", "PMI_SIZE")];

/// How many processes Open MPI has started, and how many of them on this machine.
const WORLD_SIZE: &str = "OMPI_COMM_WORLD_SIZE";
const LOCAL_SIZE: &str = "OMPI_COMM_WORLD_LOCAL_SIZE";
/// The number of this process among those of this machine.
const LOCAL_RANK: &str = "OMPI_COMM_WORLD_LOCAL_RANK";

/// 32-bit words of a digest.
const DIGEST_WORDS: usize = 8;

/// The processes of a run.
pub struct Cluster {
    group: Group,
    asked: Arc<AtomicBool>,
    stop: Arc<AtomicBool>,
    /// Nothing is left to be done.
    done: Arc<AtomicBool>,
}

/// How long Open MPI waits before it ends who does not stop, seconds.
const PATIENCE: &str = "OMPI_MCA_odls_base_sigkill_timeout";
/// How long before that a process ends by itself; a busy machine takes its time to say so.
const MARGIN: Duration = Duration::from_millis(800);
const PAUSE: Duration = Duration::from_millis(50);

/// The number that Open MPI has left in the environment, or 1.
fn started(variable: &str) -> usize {
    env::var(variable).ok().and_then(|count| count.parse().ok()).unwrap_or(1)
}

/// Whether this process is one of several that `mpirun` has started.
pub fn is_member() -> bool {
    started(WORLD_SIZE) > 1
}

/// The only process that `mpirun` has started stops by the signal by which many do.
pub fn stop_as_ranks_do(stop: &Arc<AtomicBool>) -> Result<()> {
    #[cfg(unix)]
    if env::var_os(WORLD_SIZE).is_some() {
        signal_hook::flag::register(signal_hook::consts::SIGUSR1, stop.clone())?;
    }
    Ok(())
}

/// Tells who has started several processes by another program that each is a run of its own.
pub fn notice_other_starters() {
    let several = |&(_, variable): &(&str, &str)| started(variable) > 1;
    if let Some((starter, variable)) = OTHER_STARTERS.into_iter().find(several) {
        output::tell(&format!(
            "notice: {starter} has started {} processes, each of which is a run of its own; to have one run by all of them, start \
             them by Open MPI's mpirun",
            started(variable)
        ));
    }
}

impl Cluster {
    /// Joins the others for a run in `folder`; `told` is set when mpirun, or somebody else, tells this
    /// process to end. `end` ends it with a sentence where it is about to be ended without one.
    pub fn join(told: &Arc<AtomicBool>, folder: &Path, end: fn(&str)) -> Result<Self> {
        let (asked, stop) = <(Arc<AtomicBool>, Arc<AtomicBool>)>::default();
        #[cfg(unix)]
        signal_hook::flag::register(signal_hook::consts::SIGUSR1, asked.clone())?;
        let group = connect(asked.clone(), stop.clone())?;
        let root = group.broadcast(vec![process::id()])?[0];
        let done = Arc::default();
        end_in_time([told, &asked, &done].map(Arc::clone), (group.rank(), root), folder.to_owned(), end)?;
        Ok(Self { group, asked, stop, done })
    }

    /// Fails where a rank has loaded other things than rank 0: each would train its rows of another run.
    pub fn check_alike(&self, settings: &Settings, scene: &Scene, corrected: &Corrected) -> Result<()> {
        let bytes = digests(settings, scene, corrected).map(|digest| digest.bytes());
        let words = bytes.as_flattened().as_chunks().0.iter().map(|word| u32::from_le_bytes(*word)).collect();
        let parts = self.group.gather(Ok(words))?;
        let of = |rank: usize, part: usize| &parts[rank][DIGEST_WORDS * part..][..DIGEST_WORDS];
        let different = |rank: usize| (0..PARTS.len()).find(|&part| of(rank, part) != of(0, part));
        match (1..parts.len()).find_map(|rank| Some((rank, different(rank)?))) {
            Some((rank, part)) => bail!(
                "rank {rank} has {} than rank 0; give all ranks the same program, settings and copies of the scene",
                PARTS[part]
            ),
            None => Ok(()),
        }
    }

    /// Whether this process writes and speaks.
    pub fn is_root(&self) -> bool {
        self.group.is_root()
    }

    /// Set for all ranks at the same point of their work once one was asked to stop.
    pub fn stop(&self) -> &AtomicBool {
        &self.stop
    }

    /// What asks this rank, and so all, to stop.
    pub fn asked(&self) -> &AtomicBool {
        &self.asked
    }

    /// The backend that this process trains with.
    pub fn backend(&self) -> Box<dyn Device> {
        Box::new(ClusterBackend::new(self.group.clone()))
    }

    /// The rows of a checkpoint of so many that this rank goes on with.
    pub fn share(&self, rows: usize) -> Range<usize> {
        self.group.share(rows)
    }

    /// Whether all ranks know of an error.
    pub fn has_failed(&self) -> bool {
        self.group.has_failed()
    }

    /// What the ranks have sent each other in a run of so many seconds.
    pub fn summary(&self, seconds: f64) -> Result<String> {
        let traffic = self.group.traffic();
        let own = [traffic.step_bytes, (1e6 * traffic.seconds) as u64, memory::peak_bytes().unwrap_or(0)];
        let words = own.iter().flat_map(|value| [*value as u32, (value >> 32) as u32]).collect();
        let parts = self.group.gather(Ok(words))?;
        let of = |place: usize| {
            parts.iter().map(move |part| u64::from(part[2 * place]) | u64::from(part[2 * place + 1]) << 32)
        };
        let (sent, microseconds) = (of(0).sum::<u64>(), of(1).sum::<u64>());
        let share = 1e-4 * microseconds as f64 / (seconds * self.group.count() as f64);
        Ok(format!(
            "{} ranks: {:.2} MB a step between them, {share:.0} % of the time in exchanges (waiting included), at most {} a rank",
            self.group.count(),
            1e-6 * sent as f64 / traffic.steps.max(1) as f64,
            of_memory(of(2).max().unwrap_or(0)),
        ))
    }

    /// Waits for the others.
    pub fn finish(&self) {
        self.done.store(true, Ordering::Relaxed);
        self.group.finish();
    }
}

/// Who owns the rows of a run.
pub(crate) fn owners(cluster: Option<&Cluster>) -> &dyn RowOwners {
    cluster.map_or(&Alone, |cluster| &cluster.group)
}

/// What one process has done, where all of a run have done it; where one has failed all do.
pub fn agree<T>(cluster: Option<&Cluster>, done: Result<T>) -> Result<T> {
    let Some(cluster) = cluster else { return done };
    let own = done.as_ref().map(drop).map_err(|error| BackendError::Unsupported(error.to_string()));
    let agreed = cluster.group.agree(own);
    let done = done?;
    agreed?;
    Ok(done)
}

/// When a rank has ended, mpirun tells the others to end, who wait for it for ever. Asks them to stop, and
/// has rank 0 end with a sentence before mpirun ends all without. `root` is the process of rank 0: where it
/// ran beside rank 1 and is gone, rank 1 does that. The others wait for mpirun, which ends all at once when
/// the first of them does: before anything is said.
fn end_in_time(
    [told, asked, done]: [Arc<AtomicBool>; 3],
    (rank, root): (usize, u32),
    folder: PathBuf,
    end: fn(&str),
) -> Result<()> {
    let patience = Duration::from_secs(started(PATIENCE) as u64).saturating_sub(MARGIN);
    let is_beside_root = rank == 1 && started(LOCAL_RANK) == 1;
    let replaces_root = move || is_beside_root && !Path::new("/proc").join(root.to_string()).exists();
    let watch = move || {
        while !told.load(Ordering::Relaxed) {
            thread::sleep(PAUSE);
        }
        asked.store(true, Ordering::Relaxed);
        thread::sleep(patience);
        let speaks = rank == 0 || replaces_root();
        if done.load(Ordering::Relaxed) || !speaks {
            return;
        }
        end(&format!(
            "mpirun has ended the run, since one of its processes has ended, or since saving takes longer than it waits; {}",
            failure::left_by_ranks(&folder)
        ));
    };
    thread::Builder::new().name("patience".into()).spawn(watch)?;
    Ok(())
}

#[cfg(feature = "mpi")]
fn connect(asked: Arc<AtomicBool>, stop: Arc<AtomicBool>) -> Result<Group> {
    let ranks = genesplat_cluster::mpi::Mpi::initialise()
        .ok_or_else(|| anyhow::anyhow!("MPI cannot be begun twice"))?;
    Ok(Group::new(ranks, asked, stop))
}

#[cfg(not(feature = "mpi"))]
fn connect(_: Arc<AtomicBool>, _: Arc<AtomicBool>) -> Result<Group> {
    anyhow::bail!(
        "mpirun has started {} processes, and this genesplat is built without MPI; build it with --features mpi, or start it \
         without mpirun",
        started(WORLD_SIZE)
    )
}

/// Threads of a rank: the cores of the machine are shared by its ranks.
pub fn threads() -> u16 {
    let cores = thread::available_parallelism().map_or(1, usize::from);
    (cores / started(LOCAL_SIZE)).clamp(1, u16::MAX.into()) as u16
}
