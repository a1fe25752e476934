//! Reliability: how often the event happened where a probability was forecast.

use serde::{Deserialize, Serialize};

/// Days whose forecast probability lies in `[lower, upper)`; the last bin also holds its upper edge.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct ReliabilityBin {
    /// Lower edge, 0 to 1.
    pub lower: f64,
    /// Upper edge, 0 to 1.
    pub upper: f64,
    /// Mean forecast probability; `None` in an empty bin.
    pub mean_probability: Option<f64>,
    /// Share of the days with the event; `None` in an empty bin.
    pub observed_frequency: Option<f64>,
    /// Number of days.
    pub count: u64,
}

impl ReliabilityBin {
    /// Whether a day of that probability is counted here.
    #[must_use]
    pub fn contains(&self, probability: f64) -> bool {
        let below = probability < self.upper || (self.upper >= 1.0 && probability <= 1.0);
        self.lower <= probability && below
    }
}

/// Counts days in `bins` bins of equal width over 0 to 1, from the lowest. A probability outside 0 to 1 is not counted.
#[must_use]
pub fn bins(probability: &[f64], event: &[bool], bins: usize) -> Vec<ReliabilityBin> {
    let edge = |i: usize| i as f64 / bins as f64;
    (0..bins).map(|i| bin(probability, event, edge(i), edge(i + 1))).collect()
}

fn bin(probability: &[f64], event: &[bool], lower: f64, upper: f64) -> ReliabilityBin {
    let mut bin = ReliabilityBin { lower, upper, mean_probability: None, observed_frequency: None, count: 0 };
    let (mut sum, mut events, mut count) = (0.0, 0_u64, 0_u64);
    for (&p, &o) in probability.iter().zip(event).filter(|&(&p, _)| bin.contains(p)) {
        sum += p;
        events += u64::from(o);
        count += 1;
    }
    if count > 0 {
        bin.mean_probability = Some(sum / count as f64);
        bin.observed_frequency = Some(events as f64 / count as f64);
    }
    bin.count = count;
    bin
}
