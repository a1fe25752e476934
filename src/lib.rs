//! firn: avalanche forecasting and simulation service.
//!
//! `src/README.md` is the map: what lives where, which way the arrows point, and what must never happen.

pub mod clock;
pub mod domain;
pub mod store;

pub use firn_science as science;
