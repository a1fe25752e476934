//! The numerical engines of firn, free of async, SQL, HTTP and clock: every function maps its arguments to its result.
//!
//! [`forecast`] computes avalanche-day forecasts with support vector machines, [`emission`] analyses acoustic emission.

pub mod emission;
pub mod forecast;
pub mod progress;
