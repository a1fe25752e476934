//! Background jobs: accepted into the store, run in order on a pool of their own, ended exactly once.

pub mod processes;
mod runner;

pub use runner::{Context, Failure, Jobs, Limits};
