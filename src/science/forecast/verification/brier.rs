//! The Brier score of probability forecasts, its skill and its parts.

use serde::{Deserialize, Serialize};

use super::ratio;
use super::reliability::ReliabilityBin;

/// Brier score: mean of `(p - o)^2` with `o` 1 where the event happened, else 0 (Brier 1950, Mon. Weather Rev. 78, 1-3).
///
/// 0 is perfect. `None` without a day, for NaN, or where the lengths differ.
#[must_use]
pub fn score(probability: &[f64], event: &[bool]) -> Option<f64> {
    if probability.len() != event.len() {
        return None;
    }
    let sum: f64 = probability.iter().zip(event).map(|(&p, &o)| squared_error(p, o)).sum();
    ratio(sum, event.len() as f64)
}

/// `(p - o)^2` of one day.
pub(super) fn squared_error(probability: f64, event: bool) -> f64 {
    let error = probability - f64::from(u8::from(event));
    error * error
}

/// Brier skill `1 - score / reference`: 1 perfect, 0 as good as the reference, below 0 worse.
///
/// `None` where a score is, or where the reference is perfect.
#[must_use]
pub fn skill(score: Option<f64>, reference: Option<f64>) -> Option<f64> {
    ratio(score?, reference?).map(|r| 1.0 - r)
}

/// The parts of a Brier score over bins of probability.
///
/// `brier = reliability - resolution + uncertainty + within_variance - within_covariance`: Murphy (1973, J. Appl. Meteorol. 12,
/// 595-600), with the two terms of Stephenson, Coelho & Jolliffe (2008, Weather Forecast. 23, 752-757) for probabilities that
/// differ within a bin.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Decomposition {
    /// Mean squared distance of forecast and observed frequency over the bins; 0 is best.
    pub reliability: f64,
    /// Mean squared distance of the bins' observed frequencies from the base rate; large is good.
    pub resolution: f64,
    /// `r (1 - r)` with the base rate `r`: what no forecast can change.
    pub uncertainty: f64,
    /// Mean squared distance of a probability from the mean of its bin.
    pub within_variance: f64,
    /// Twice the mean product of the distances of probability and outcome from their means in the bin.
    pub within_covariance: f64,
}

/// Decomposes the Brier score over `bins`, which were counted from the same `probability` and `event`.
///
/// `None` without a day or where the lengths differ.
#[must_use]
pub fn decomposition(probability: &[f64], event: &[bool], bins: &[ReliabilityBin]) -> Option<Decomposition> {
    if probability.len() != event.len() || event.is_empty() {
        return None;
    }
    let days = event.len() as f64;
    let base_rate = event.iter().filter(|&&o| o).count() as f64 / days;
    let mut parts = Decomposition {
        reliability: 0.0,
        resolution: 0.0,
        uncertainty: base_rate * (1.0 - base_rate),
        within_variance: 0.0,
        within_covariance: 0.0,
    };
    for bin in bins {
        let (Some(mean), Some(frequency)) = (bin.mean_probability, bin.observed_frequency) else { continue };
        parts.reliability += bin.count as f64 * (mean - frequency).powi(2) / days;
        parts.resolution += bin.count as f64 * (frequency - base_rate).powi(2) / days;
        for (&p, &o) in probability.iter().zip(event).filter(|&(&p, _)| bin.contains(p)) {
            parts.within_variance += (p - mean).powi(2) / days;
            parts.within_covariance += 2.0 * (p - mean) * (f64::from(u8::from(o)) - frequency) / days;
        }
    }
    Some(parts)
}
