//! The words of the service: what a station, an observation, a job and a problem are. No I/O.

pub mod avalanche;
pub mod dataset;
pub mod date;
pub mod ids;
pub mod job;
pub mod observation;
pub mod problem;
pub mod region;
pub mod retrain;
pub mod schema;
pub mod station;
pub mod units;
