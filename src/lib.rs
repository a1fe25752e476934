//! firn: avalanche forecasting and simulation service.

pub use firn_science as science;
