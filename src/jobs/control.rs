//! What a running computation and its worker share: the worker's side of [`Progress`].

use std::{
    sync::{
        Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant},
};

use firn_science::progress::Progress;

use crate::domain::job::Report;

/// A state is saved at least this long after the one before, ...
const CHECKPOINT_EVERY: Duration = Duration::from_secs(5);
/// ... and so rarely that saving takes at most this share of the time.
const MOST_TIME_ON_CHECKPOINTS: f64 = 0.02;

/// The handle of one attempt.
pub struct Control {
    stop: AtomicBool,
    pausing: AtomicBool,
    resumed: Option<Vec<u8>>,
    state: Mutex<State>,
}

struct State {
    report: Report,
    begun: Instant,
    // of this attempt: where it began, so that a resumed one does not look fast
    first_fraction: Option<f64>,
    last_checkpoint: Instant,
    checkpoint_cost: Duration,
    unsaved: Option<Vec<u8>>,
}

impl Control {
    /// The handle of an attempt that goes on from `resumed`.
    #[must_use]
    pub fn new(resumed: Option<Vec<u8>>) -> Self {
        let now = Instant::now();
        let state = State {
            report: Report::default(),
            begun: now,
            first_fraction: None,
            last_checkpoint: now,
            checkpoint_cost: Duration::ZERO,
            unsaved: None,
        };
        Self { stop: AtomicBool::new(false), pausing: AtomicBool::new(false), resumed, state: Mutex::new(state) }
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Asks the computation to end without a result.
    pub fn cancel(&self) {
        self.stop.store(true, Ordering::Relaxed);
    }

    /// Asks the computation to save its state at the next chance and then to end; it is cancelled at once where it has
    /// no state to save.
    pub fn pause(&self) {
        self.pausing.store(true, Ordering::Relaxed);
    }

    /// Whether it was asked to pause.
    #[must_use]
    pub fn is_pausing(&self) -> bool {
        self.pausing.load(Ordering::Relaxed)
    }

    /// How far it is.
    #[must_use]
    pub fn report(&self) -> Report {
        self.state().report.clone()
    }

    /// A state that nobody has stored yet.
    #[must_use]
    pub fn take_unsaved(&self) -> Option<Vec<u8>> {
        self.state().unsaved.take()
    }
}

impl Progress for Control {
    fn report(&self, fraction: f64, phase: &str) {
        if !fraction.is_finite() {
            return;
        }
        let mut state = self.state();
        let fraction = fraction.clamp(0.0, 1.0);
        let first = *state.first_fraction.get_or_insert(fraction);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "from 0 to 99")]
        let percent = (fraction * 100.0).min(99.0) as u8;
        state.report.percent = state.report.percent.max(percent);
        let gained = fraction - first;
        if gained > 1e-6 {
            let eta = state.begun.elapsed().as_secs_f64() * (1.0 - fraction) / gained;
            state.report.eta_seconds = Some((eta * 10.0).round() / 10.0);
        }
        if state.report.phase != phase {
            phase.clone_into(&mut state.report.phase);
        }
    }

    fn rate(&self, per_second: f64, unit: &str) {
        let mut state = self.state();
        state.report.rate = Some(per_second);
        state.report.rate_unit = Some(unit.to_owned());
    }

    fn work(&self, done: f64, unit: &str) {
        let seconds = self.state().begun.elapsed().as_secs_f64();
        if seconds > 0.0 {
            self.rate(done / seconds, unit);
        }
    }

    fn cancelled(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    fn checkpoint(&self, save: &dyn Fn() -> Vec<u8>) {
        let pausing = self.is_pausing();
        {
            let state = self.state();
            let rest = CHECKPOINT_EVERY.max(state.checkpoint_cost.div_f64(MOST_TIME_ON_CHECKPOINTS));
            if !pausing && state.last_checkpoint.elapsed() < rest {
                return;
            }
        }
        // not under the lock: the heart beats while a large state is written
        let begun = Instant::now();
        let bytes = save();
        let mut state = self.state();
        state.checkpoint_cost = begun.elapsed();
        state.last_checkpoint = Instant::now();
        state.unsaved = Some(bytes);
        if pausing {
            self.cancel();
        }
    }

    fn resumed(&self) -> Option<&[u8]> {
        self.resumed.as_deref()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn progress_never_falls_and_stays_below_the_end() {
        let control = Control::new(None);
        Progress::report(&control, 0.5, "a");
        Progress::report(&control, 0.2, "b");
        assert_eq!(control.report().percent, 50);
        Progress::report(&control, f64::NAN, "b");
        assert_eq!(control.report().percent, 50);
        Progress::report(&control, 7.0, "b");
        assert_eq!(control.report().percent, 99);
    }

    #[test]
    fn a_state_is_saved_when_it_is_time_and_when_pausing() {
        let control = Control::new(None);
        control.checkpoint(&|| panic!("it is too early to save"));
        control.pause();
        assert!(!control.cancelled());
        control.checkpoint(&|| vec![1, 2]);
        assert_eq!(control.take_unsaved(), Some(vec![1, 2]));
        assert!(control.cancelled());
    }
}
