//! Avalanche-day forecasting with support vector machines, after Pozdnoukhov, Purves & Kanevski (2008).
//!
//! Data flow: [`day`] records of one station -> [`features`] -> standardised samples ([`preparation`]) -> machine ([`svm`]) ->
//! probability. [`model`] runs it: it trains, forecasts and finds similar days. [`evaluation`] judges the same recipe, and the
//! models beside it ([`baselines`], [`neighbours`], [`logistic`]), on held-out seasons with the scores of [`verification`];
//! [`region`] says what the days of several stations come to; [`selection`] asks how many features it takes; [`issued`] judges what was said in service, [`transfer`] what a
//! model says at another place.

pub mod baselines;
pub mod day;
pub mod evaluation;
pub mod features;
pub mod issued;
pub mod logistic;
pub mod matrix;
pub mod model;
pub mod neighbours;
pub mod preparation;
#[cfg(test)]
mod problems;
pub mod region;
pub mod selection;
pub mod svm;
pub mod synthetic;
pub mod transfer;
pub mod verification;
