//! Run-out simulation of snow avalanches: a 2-D material point method with cohesive Cam clay (Li, Sovilla, Jiang & Gaume
//! 2020, The Cryosphere 14, 3381-3398; Gaume et al. 2018, Nature Communications 9, 3047).
//!
//! `x` points down the track and is 0 where the arc meets the run-out flat, `z` points up; every extensive quantity is a
//! metre of width.
//!
//! [`Simulation`] is the whole: made of a [`Setup`], advanced with [`Simulation::step_until`], looked at as a
//! [`snapshot::Snapshot`]. [`run::run`] does all of it for a [`plan::Plan`] and observes it.

mod checkpoint;
mod dispatch;
mod engine;
mod error;
pub mod frames;
mod grid;
mod implicit;
mod lanes;
mod limit;
pub mod material;
pub mod observables;
mod observe;
mod particles;
pub mod plan;
pub mod regime;
pub mod release;
pub mod run;
pub mod scenario;
mod simulation;
pub mod snapshot;
mod sort;
mod stress;
pub mod terrain;
mod transfer;
mod vector;

pub use error::{Dump, ParticleState, RunoutError};
pub use simulation::{Advance, Contact, GRAVITY_M_S2, LIMITED_ABOVE, LIMITED_BEYOND, Precision, Setup, Simulation};

#[cfg(test)]
mod block_tests;
#[cfg(test)]
mod collapse_tests;
#[cfg(test)]
mod dispatch_tests;
#[cfg(test)]
mod dynamics_tests;
#[cfg(test)]
mod flow_tests;
#[cfg(test)]
mod material_tests;
#[cfg(test)]
mod plan_tests;
#[cfg(test)]
mod run_tests;
#[cfg(test)]
mod terrain_tests;
#[cfg(test)]
mod test_scenes;
