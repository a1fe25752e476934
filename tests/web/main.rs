//! The pages that people read: what is served, and what a real browser makes of it.

#![expect(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "helpers of tests fail loudly and say what they skip"
)]

mod browser;
mod served;
mod service;
