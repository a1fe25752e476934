//! The service as its callers meet it: a real server on a port of its own, asked over HTTP.
//!
//! Every test is a story about one caller. `support` starts servers and reads answers; the processes of `binary` are
//! the built `firn`, for what only a process can show: exit codes, signals, a killed server.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]
#![allow(clippy::print_stdout, reason = "a skipped test says so")]

mod archive;
mod auth;
mod avalanches;
mod bulletins;
mod emission;
mod forecasts;
mod imports;
mod interrupted;
mod issued;
mod jobs;
mod observations;
mod overview;
mod problems;
mod processes;
mod proposals;
mod regions;
mod registry;
mod runout;
mod selection;
mod startup;
mod stations;
mod support;
mod training;
mod transfers;
mod weather;
mod what_if;
