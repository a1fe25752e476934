//! Avalanche-day forecasting with support vector machines, after Pozdnoukhov, Purves & Kanevski (2008).
//!
//! Data flow: [`day`] records of one station -> features -> standardised samples -> machine -> probability.

pub mod day;
pub mod matrix;
pub mod svm;
