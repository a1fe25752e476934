//! The words of the trade: quantities with their bounds, and what a station reports of a day.

pub mod observation;
pub mod units;
