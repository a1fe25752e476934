//! What the desk has counted since it was opened: for whoever watches the service.

use std::sync::atomic::{AtomicU64, Ordering};

use crate::jobs::processes::Process;

/// What an attempt wishes to write.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Write {
    /// A sign of life.
    Beat,
    /// Lines of the log.
    Log,
    /// A state to go on from.
    Checkpoint,
    /// A piece of an output.
    Piece,
    /// That it gives the job back.
    Release,
    /// How it ended.
    Result,
}

impl Write {
    /// Every kind.
    pub const ALL: [Self; 6] = [Self::Beat, Self::Log, Self::Checkpoint, Self::Piece, Self::Release, Self::Result];

    /// Its name among the figures of the service.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Beat => "beat",
            Self::Log => "log",
            Self::Checkpoint => "checkpoint",
            Self::Piece => "piece",
            Self::Release => "release",
            Self::Result => "result",
        }
    }
}

/// Counts that only grow.
#[derive(Debug, Default)]
pub struct Tally {
    attempts: [AtomicU64; Process::ALL.len()],
    fenced: [AtomicU64; Write::ALL.len()],
    leases_lost: AtomicU64,
    dismissals: AtomicU64,
}

impl Tally {
    pub(super) fn attempt(&self, process: Process) {
        self.attempts[process as usize].fetch_add(1, Ordering::Relaxed);
    }

    pub(super) fn fenced(&self, write: Write) {
        self.fenced[write as usize].fetch_add(1, Ordering::Relaxed);
    }

    pub(super) fn lease_lost(&self) {
        self.leases_lost.fetch_add(1, Ordering::Relaxed);
    }

    pub(super) fn dismissed(&self, jobs: usize) {
        self.dismissals.fetch_add(jobs as u64, Ordering::Relaxed);
    }

    /// How often a job of that process was taken by a worker.
    #[must_use]
    pub fn attempts(&self, process: Process) -> u64 {
        self.attempts[process as usize].load(Ordering::Relaxed)
    }

    /// How many writes of that kind were refused, because the attempt counted no more: its lease had ended and another
    /// worker had taken the job, or the job had ended.
    #[must_use]
    pub fn fenced_writes(&self, write: Write) -> u64 {
        self.fenced[write as usize].load(Ordering::Relaxed)
    }

    /// How many attempts ended without a word, so that their job was taken again or failed.
    #[must_use]
    pub fn leases_lost(&self) -> u64 {
        self.leases_lost.load(Ordering::Relaxed)
    }

    /// How many jobs were dismissed, each child of a dismissed parent counted by itself.
    #[must_use]
    pub fn dismissals(&self) -> u64 {
        self.dismissals.load(Ordering::Relaxed)
    }
}
