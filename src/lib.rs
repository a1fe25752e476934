//! firn: avalanche forecasting and simulation service.

pub mod domain;
pub mod formats;

pub use firn_science as science;
