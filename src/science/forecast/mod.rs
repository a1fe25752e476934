//! Avalanche-day forecasting with support vector machines, after Pozdnoukhov, Purves & Kanevski (2008).
//!
//! Data flow: [`day`] records of one station -> features -> standardised samples -> machine -> probability.

pub mod baselines;
pub mod day;
pub mod evaluation;
pub mod features;
pub mod logistic;
pub mod matrix;
pub mod model;
pub mod neighbours;
pub mod preparation;
#[cfg(test)]
mod problems;
pub mod svm;
pub mod synthetic;
pub mod verification;
