//! What a running computation and its worker share: the worker's side of [`Progress`].

use std::{
    collections::VecDeque,
    sync::{
        Arc, Condvar, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant},
};

use firn_science::progress::Progress;
use tokio::sync::Notify;

use super::spacing::Spacing;
use crate::domain::job::{Report, Spent};

/// Pieces that may be on their way at once; a computation that is faster waits.
const MOST_PIECES: usize = 4;

/// How long a computation waits for room before it looks again whether it is still wanted.
const LOOK: Duration = Duration::from_millis(100);

/// Something that nobody has stored yet.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Unstored {
    /// A piece of an output.
    Piece(Arc<Vec<u8>>),
    /// A state to go on from.
    State(Arc<Vec<u8>>),
}

/// The handle of one attempt.
pub struct Control {
    begun: Instant,
    stop: AtomicBool,
    pausing: AtomicBool,
    stepped: AtomicBool,
    resumed: Option<Vec<u8>>,
    state: Mutex<State>,
    unstored: Notify,
    room: Condvar,
}

#[derive(Default)]
struct State {
    report: Report,
    // of this attempt: where it began, so that a resumed one does not look fast
    first_fraction: Option<f64>,
    spacing: Spacing,
    states: u32,
    saving: Duration,
    storing: Duration,
    // kept until it is stored: what is on its way may not arrive
    unsaved: Option<Arc<Vec<u8>>>,
    // in the order in which they came
    pieces: VecDeque<Arc<Vec<u8>>>,
}

impl Control {
    /// The handle of an attempt that goes on from `resumed`.
    #[must_use]
    pub fn new(resumed: Option<Vec<u8>>) -> Self {
        Self {
            begun: Instant::now(),
            stop: AtomicBool::new(false),
            pausing: AtomicBool::new(false),
            stepped: AtomicBool::new(false),
            resumed,
            state: Mutex::default(),
            unstored: Notify::new(),
            room: Condvar::new(),
        }
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

    /// Whether the computation has given a sign of life since this was asked last.
    #[must_use]
    pub fn has_stepped(&self) -> bool {
        self.stepped.swap(false, Ordering::Relaxed)
    }

    /// A state that nobody has stored yet.
    #[must_use]
    pub fn unsaved(&self) -> Option<Arc<Vec<u8>>> {
        self.state().unsaved.clone()
    }

    /// The oldest piece that nobody has stored yet.
    #[must_use]
    pub fn piece(&self) -> Option<Arc<Vec<u8>>> {
        self.state().pieces.front().cloned()
    }

    /// Waits for something that nobody has stored yet; a state may name any piece, and so comes after them.
    pub async fn next_unstored(&self) -> Unstored {
        loop {
            if let Some(piece) = self.piece() {
                return Unstored::Piece(piece);
            }
            if let Some(bytes) = self.unsaved() {
                return Unstored::State(bytes);
            }
            self.unstored.notified().await;
        }
    }

    /// Notes that the oldest piece is stored.
    pub fn kept(&self, piece: &Arc<Vec<u8>>) {
        let mut state = self.state();
        if state.pieces.front().is_some_and(|oldest| Arc::ptr_eq(oldest, piece)) {
            state.pieces.pop_front();
        }
        self.room.notify_all();
    }

    /// Notes that a state is stored, which took `storing`.
    pub fn stored(&self, bytes: &Arc<Vec<u8>>, storing: Duration) {
        let mut state = self.state();
        state.states += 1;
        state.storing += storing;
        if state.unsaved.as_ref().is_some_and(|newest| Arc::ptr_eq(newest, bytes)) {
            state.unsaved = None;
            state.spacing.stored(storing);
        }
    }

    /// What the attempt was spent on until now.
    #[must_use]
    pub fn spent(&self) -> Spent {
        let ms = |time: Duration| u64::try_from(time.as_millis()).unwrap_or(u64::MAX);
        let state = self.state();
        Spent {
            compute_ms: ms(self.begun.elapsed()),
            states: state.states,
            saving_ms: ms(state.saving),
            storing_ms: ms(state.storing),
        }
    }

    fn step(&self) {
        // read first: engines ask from all their threads at once, and a line of memory that nobody writes is shared
        if !self.stepped.load(Ordering::Relaxed) {
            self.stepped.store(true, Ordering::Relaxed);
        }
    }
}

impl Progress for Control {
    fn report(&self, fraction: f64, phase: &str) {
        self.step();
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
            let eta = self.begun.elapsed().as_secs_f64() * (1.0 - fraction) / gained;
            state.report.eta_seconds = Some((eta * 10.0).round() / 10.0);
        }
        if state.report.phase != phase {
            phase.clone_into(&mut state.report.phase);
        }
    }

    fn rate(&self, per_second: f64, unit: &str) {
        self.step();
        let mut state = self.state();
        state.report.rate = Some(per_second);
        state.report.rate_unit = Some(unit.to_owned());
    }

    fn work(&self, done: f64, unit: &str) {
        let seconds = self.begun.elapsed().as_secs_f64();
        if seconds > 0.0 {
            self.rate(done / seconds, unit);
        }
    }

    fn cancelled(&self) -> bool {
        self.step();
        self.stop.load(Ordering::Relaxed)
    }

    fn checkpoint(&self, save: &dyn Fn() -> Vec<u8>) {
        self.step();
        let pausing = self.is_pausing();
        let taken = self.begun.elapsed();
        if !self.state().spacing.is_due(taken) && !pausing {
            return;
        }
        // not under the lock: the heart beats while a large state is written
        let bytes = save();
        let saving = self.begun.elapsed().saturating_sub(taken);
        let mut state = self.state();
        state.spacing.saved(taken, saving);
        state.saving += saving;
        state.unsaved = Some(Arc::new(bytes));
        self.unstored.notify_one();
        if pausing {
            self.cancel();
        }
    }

    fn keep(&self, piece: Vec<u8>) -> Result<(), Vec<u8>> {
        self.step();
        let mut state = self.state();
        while state.pieces.len() >= MOST_PIECES && !self.cancelled() {
            state = self.room.wait_timeout(state, LOOK).unwrap_or_else(PoisonError::into_inner).0;
        }
        state.pieces.push_back(Arc::new(piece));
        self.unstored.notify_one();
        Ok(())
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
        let unsaved = control.unsaved().unwrap();
        assert_eq!(*unsaved, [1, 2]);
        assert!(control.cancelled());
        assert_eq!(control.spent().states, 0);
        control.stored(&unsaved, Duration::from_millis(70));
        assert_eq!(control.unsaved(), None);
        assert_eq!((control.spent().states, control.spent().storing_ms), (1, 70));
    }

    #[test]
    fn a_state_that_came_meanwhile_is_not_forgotten() {
        let control = Control::new(None);
        control.pause();
        control.checkpoint(&|| vec![1]);
        let first = control.unsaved().unwrap();
        control.checkpoint(&|| vec![2]);
        control.stored(&first, Duration::ZERO);
        assert_eq!(control.unsaved().as_deref(), Some(&vec![2]));
    }

    #[test]
    fn pieces_are_stored_in_their_order_and_before_states() {
        let control = Control::new(None);
        for piece in 0..3 {
            control.keep(vec![piece]).unwrap();
        }
        control.pause();
        control.checkpoint(&|| vec![9]);
        let next = || tokio::runtime::Builder::new_current_thread().build().unwrap().block_on(control.next_unstored());
        for expected in 0..3 {
            let Unstored::Piece(piece) = next() else { panic!("a state came before a piece") };
            assert_eq!(*piece, [expected]);
            // what was not stored is given again
            assert_eq!(next(), Unstored::Piece(Arc::clone(&piece)));
            control.kept(&piece);
            control.kept(&piece);
        }
        assert_eq!(next(), Unstored::State(Arc::new(vec![9])));
    }

    #[test]
    fn a_computation_waits_for_its_pieces_until_there_is_room_or_it_is_stopped() {
        let control = Control::new(None);
        for piece in 0..MOST_PIECES {
            control.keep(vec![piece as u8]).unwrap();
        }
        let waits = |free: &dyn Fn()| {
            std::thread::scope(|scope| {
                let waiting = scope.spawn(|| control.keep(vec![9]).unwrap());
                std::thread::sleep(2 * LOOK);
                assert!(!waiting.is_finished() && control.has_stepped());
                free();
                waiting.join().unwrap();
            });
        };
        waits(&|| control.kept(&control.piece().unwrap()));
        waits(&|| control.cancel());
    }

    #[test]
    fn whatever_a_computation_says_is_a_step() {
        let control = Control::new(None);
        let says: [&dyn Fn(); 5] = [
            &|| Progress::report(&control, 0.1, "a"),
            &|| control.rate(1.0, "seasons"),
            &|| control.checkpoint(&Vec::new),
            &|| control.keep(vec![1]).unwrap(),
            &|| assert!(!control.cancelled()),
        ];
        for say in says {
            assert!(!control.has_stepped());
            say();
            assert!(control.has_stepped());
        }
    }
}
