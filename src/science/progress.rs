//! How a long computation talks to whoever runs it.

/// Handle of a running computation: it reports how far it is and asks whether to go on.
///
/// Engines call it at steps of well under a second, so that a dismissed job ends at once.
pub trait Progress: Sync {
    /// Says that `fraction` (0 to 1) of the work is done and what is being done now.
    fn report(&self, fraction: f64, phase: &str);

    /// True once the caller no longer wants the result: return as soon as possible.
    fn cancelled(&self) -> bool;
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
