//! firn: avalanche forecasting and simulation service.
//!
//! `src/README.md` is the map: what lives where, which way the arrows point, and what must never happen.

pub mod analyse;
pub mod api;
pub mod clock;
pub mod config;
pub mod demo;
pub mod domain;
pub mod formats;
pub mod jobs;
pub mod server;
pub mod shutdown;
pub mod store;
pub mod telemetry;
pub mod web;

pub use firn_science as science;
