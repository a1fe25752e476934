//! The numerical engines of firn, free of async, SQL, HTTP and clock: every function maps its arguments to its result.
//!
//! [`forecast`] computes avalanche-day forecasts with support vector machines, [`runout`] simulates the run-out of snow
//! avalanches, [`emission`] analyses acoustic emission.

pub mod emission;
pub mod forecast;
pub mod progress;
pub mod runout;
