//! How a long computation talks to whoever runs it.

/// Handle of a running computation: it reports how far it is, saves its state, and asks whether to go on.
///
/// Engines call it at steps of well under a second, so that a dismissed job ends at once and an interrupted one loses
/// little.
pub trait Progress: Sync {
    /// Says that `fraction` (0 to 1) of the work is done and what is being done now.
    fn report(&self, fraction: f64, phase: &str);

    /// True once the caller no longer wants the result: return as soon as possible.
    fn cancelled(&self) -> bool;

    /// Says how fast the work goes: `per_second` of `unit` a second.
    fn rate(&self, per_second: f64, unit: &str) {
        let _ = (per_second, unit);
    }

    /// Says how much work this attempt has done so far, in `unit`: whoever runs it has a clock and knows how fast it goes.
    fn work(&self, done: f64, unit: &str) {
        let _ = (done, unit);
    }

    /// Offers to save the state; `state` is called only where it is time to, so that offering often costs nothing.
    ///
    /// What it returns is what [`Progress::resumed`] of a later attempt gives back.
    fn checkpoint(&self, state: &dyn Fn() -> Vec<u8>) {
        let _ = state;
    }

    /// Hands over a piece of a result that is too large to be held until the end. Pieces are stored in the order in which they
    /// come and before any state that is offered later, so that a state may name them. It waits while many are on their way.
    ///
    /// # Errors
    /// The piece itself where nobody stores pieces, as by default: the computation holds it.
    fn keep(&self, piece: Vec<u8>) -> Result<(), Vec<u8>> {
        Err(piece)
    }

    /// The state that an earlier attempt of the same work saved last, if there was one.
    fn resumed(&self) -> Option<&[u8]> {
        None
    }
}

/// A [`Progress`] that nobody listens to and nobody cancels.
#[derive(Clone, Copy, Debug, Default)]
pub struct Unobserved;

impl Progress for Unobserved {
    fn report(&self, _fraction: f64, _phase: &str) {}

    fn cancelled(&self) -> bool {
        false
    }
}
