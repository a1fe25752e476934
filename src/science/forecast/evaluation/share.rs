//! One progress for parts that run side by side.

use std::sync::{Mutex, PoisonError};

use crate::progress::Progress;

/// Splits a progress among parts of known weight.
pub(crate) struct Shares<'a> {
    whole: &'a dyn Progress,
    weight: Vec<f64>,
    done: Mutex<Vec<f64>>,
}

impl<'a> Shares<'a> {
    /// One part a weight; weights are relative and above 0.
    pub(crate) fn new(whole: &'a dyn Progress, weight: Vec<f64>) -> Self {
        let done = Mutex::new(vec![0.0; weight.len()]);
        Self { whole, weight, done }
    }

    /// The progress of all parts together.
    pub(crate) fn whole(&self) -> &dyn Progress {
        self.whole
    }

    /// The progress of part `index`.
    pub(crate) fn part(&self, index: usize, name: String) -> Share<'_> {
        Share { shares: self, index, name }
    }

    fn advance(&self, index: usize, fraction: f64, phase: &str) {
        // reported under the lock, so that the sum never falls from one report to the next
        let mut done = self.done.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(part) = done.get_mut(index) {
            *part = part.max(fraction.clamp(0.0, 1.0));
        }
        let sum: f64 = done.iter().zip(&self.weight).map(|(done, weight)| done * weight).sum();
        self.whole.report((sum / self.weight.iter().sum::<f64>()).min(1.0), phase);
    }
}

/// The progress of one part.
pub(crate) struct Share<'a> {
    shares: &'a Shares<'a>,
    index: usize,
    name: String,
}

impl Progress for Share<'_> {
    fn report(&self, fraction: f64, phase: &str) {
        self.shares.advance(self.index, fraction, &format!("{}: {phase}", self.name));
    }

    fn cancelled(&self) -> bool {
        self.shares.whole.cancelled()
    }

    fn checkpoint(&self, state: &dyn Fn() -> Vec<u8>) {
        self.shares.whole.checkpoint(state);
    }
}
