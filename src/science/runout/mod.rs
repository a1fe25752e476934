//! Run-out simulation of snow avalanches: a 2-D material point method with cohesive Cam clay (Li, Sovilla, Jiang & Gaume
//! 2020, The Cryosphere 14, 3381-3398; Gaume et al. 2018, Nature Communications 9, 3047).
//!
//! `x` points down the track and is 0 where the arc meets the run-out flat, `z` points up; every extensive quantity is a
//! metre of width.

pub mod release;
pub mod snapshot;
pub mod terrain;

#[cfg(test)]
mod terrain_tests;
