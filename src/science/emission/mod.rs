//! Acoustic emission (AE) of dislocation avalanches: what catalogues of hits and events say.
//!
//! Terms follow ASTM E1316 and EN 1330-9: a *hit* is the burst at one sensor, an *event* is one source.
//!
//! Data flow: waveforms -> [`hits`] -> events and positions ([`location`]) -> [`catalogue`] with its quality flags -> [`analysis`], which
//! runs the twelve analyses as a list of requests. [`synthetic`] makes catalogues with known truth.
//!
//! The distributions: [`tails`] (models and maximum likelihood) on a [`sample`], [`xmin`] (where the tail begins), [`goodness`],
//! [`comparison`] (which model), [`validation`] (bias and coverage), [`maps`] (how the exponent depends on the range). In time:
//! [`waiting`], [`aftershocks`], [`activity`]. In space: [`correlation`]. Of single events: [`duration`], [`source`],
//! [`calibration`]. Several data sets: [`sets`], run by [`analysis::compare`].

pub mod activity;
pub mod aftershocks;
pub mod analysis;
pub mod calibration;
pub mod catalogue;
pub mod comparison;
pub mod correlation;
pub mod duration;
pub mod error;
pub mod goodness;
pub mod hits;
pub mod location;
pub mod maps;
mod numerics;
mod pairs;
pub mod sample;
#[cfg(test)]
mod samples;
pub mod sets;
pub mod source;
pub mod special;
pub mod synthetic;
pub mod tails;
pub mod validation;
pub mod waiting;
pub mod xmin;

pub use error::EmissionError;

/// Fails unless `a` and `b` differ by at most `tolerance`.
#[cfg(test)]
#[track_caller]
fn close(a: f64, b: f64, tolerance: f64) {
    assert!((a - b).abs() <= tolerance, "{a} and {b} differ by {:e}, allowed {tolerance:e}", (a - b).abs());
}
