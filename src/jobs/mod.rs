//! Background jobs that nobody loses.
//!
//! The row of a job is its state ([`crate::domain::job`], [`crate::store::jobs`]). An [`engine`] only carries tickets that
//! say which job waits; a [`worker`] takes a ticket, claims the job over a [`link`], computes on its own pool and
//! delivers; the [`desk`] accepts, answers the links and stores; the [`caretaker`] issues lost tickets again and retires
//! what is old.

pub mod artifacts;
pub mod caretaker;
pub mod control;
pub mod desk;
pub mod engine;
pub mod intake;
pub mod link;
pub mod nats_link;
pub mod processes;
pub mod retraining;
pub mod spacing;
pub mod worker;

pub use desk::{Desk, Rules, Submission, Submitted};
