//! Background jobs that nobody loses: both engines under one contract, killed processes, and the whole job API.
//!
//! `rig` puts a desk, an engine and workers together in this process; `processes` are built `firn` processes and NATS
//! servers, for what only a process can show. Tests that need `nats-server` say that they are skipped where it is absent;
//! `FIRN_NATS_SERVER` names another one than that of the system.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]
#![allow(clippy::print_stdout, reason = "a skipped test says so")]

mod chaos;
mod contract;
mod events;
mod families;
mod idempotency;
mod large_outputs;
mod life;
mod lost_workers;
mod metrics;
mod processes;
mod retention;
mod reuse;
mod rig;
#[cfg(feature = "s3")]
mod s3;
mod shutdown;
#[path = "../api/support/mod.rs"]
#[allow(dead_code, unused_imports, reason = "shared with the tests of the API, which use more of it")]
mod support;
mod versions;
