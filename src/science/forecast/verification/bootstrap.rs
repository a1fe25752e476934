//! Bootstrap over seasons: days of one winter resemble each other, so whole winters are drawn, with replacement.
//!
//! Percentile intervals (Efron & Tibshirani 1993, An Introduction to the Bootstrap, ch. 13). One set of draws serves every
//! model, so that a difference of two models is taken on the same winters.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::roc::Ranking;
use super::{Contingency, Outcome, brier};

/// How often each season is drawn, a list a replicate.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SeasonDraws {
    times: Vec<Vec<u64>>,
}

impl SeasonDraws {
    /// `replicates` times draws as many seasons as there are. The same `seed` gives the same draws.
    #[must_use]
    pub fn new(seasons: usize, replicates: usize, seed: u64) -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut draw = || {
            let mut times = vec![0; seasons];
            for _ in 0..seasons {
                times[random.random_range(0..seasons)] += 1;
            }
            times
        };
        Self { times: (0..replicates).map(|_| draw()).collect() }
    }
}

/// The scores of every replicate of one model, in the order of the draws; `None` where undefined.
#[derive(Clone, Debug, PartialEq)]
pub struct Replicates {
    /// Areas under the ROC curve.
    pub auc: Vec<Option<f64>>,
    /// Peirce skill scores.
    pub pss: Vec<Option<f64>>,
    /// Brier skill against the reference.
    pub brier_skill: Vec<Option<f64>>,
}

/// An interval that holds the stated share of the replicates.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Interval {
    /// Lower bound.
    pub lower: f64,
    /// Upper bound.
    pub upper: f64,
}

/// What one season adds to the sums of a replicate.
#[derive(Clone, Copy, Default)]
struct SeasonSums {
    table: Contingency,
    squared_error: f64,
    reference_error: f64,
}

/// Scores `outcomes` under each of `draws`; `season[i]` is the position of the season of day `i` among the seasons.
///
/// A day of a season beyond those drawn counts nowhere.
#[must_use]
pub fn replicate(outcomes: &[Outcome], season: &[usize], draws: &SeasonDraws) -> Replicates {
    let probability: Vec<f64> = outcomes.iter().map(|o| o.probability).collect();
    let event: Vec<bool> = outcomes.iter().map(|o| o.event).collect();
    let ranking = Ranking::new(&probability, &event);
    let sums = season_sums(outcomes, season);

    let mut replicates = Replicates { auc: Vec::new(), pss: Vec::new(), brier_skill: Vec::new() };
    for times in &draws.times {
        let weight = |i: usize| season.get(i).and_then(|&s| times.get(s)).copied().unwrap_or(0);
        let mut total = SeasonSums::default();
        for (sum, &n) in sums.iter().zip(times) {
            total.table = sum.table.added_to(total.table, n);
            total.squared_error += n as f64 * sum.squared_error;
            total.reference_error += n as f64 * sum.reference_error;
        }
        replicates.auc.push(ranking.as_ref().and_then(|r| r.auc(weight)));
        replicates.pss.push(total.table.pss());
        replicates.brier_skill.push(brier::skill(Some(total.squared_error), Some(total.reference_error)));
    }
    replicates
}

fn season_sums(outcomes: &[Outcome], season: &[usize]) -> Vec<SeasonSums> {
    let seasons = season.iter().max().map_or(0, |&last| last + 1);
    let mut sums = vec![SeasonSums::default(); seasons];
    for (outcome, &s) in outcomes.iter().zip(season) {
        let sum = &mut sums[s];
        sum.table = Contingency::of([(outcome.warned, outcome.event)]).added_to(sum.table, 1);
        sum.squared_error += brier::squared_error(outcome.probability, outcome.event);
        sum.reference_error += brier::squared_error(outcome.reference, outcome.event);
    }
    sums
}

/// The central interval that holds the share `level` (0 to 1) of the defined `values`; `None` where none is defined.
///
/// Quantiles interpolate linearly between order statistics (Hyndman & Fan 1996, type 7).
#[must_use]
pub fn interval(values: &[Option<f64>], level: f64) -> Option<Interval> {
    let mut sorted: Vec<f64> = values.iter().flatten().copied().filter(|v| v.is_finite()).collect();
    sorted.sort_by(f64::total_cmp);
    let quantile = |q: f64| {
        let position = q.clamp(0.0, 1.0) * (sorted.len().checked_sub(1)?) as f64;
        let below = position.floor();
        let (low, high) = (sorted.get(below as usize)?, sorted.get(position.ceil() as usize)?);
        Some(low + (position - below) * (high - low))
    };
    Some(Interval { lower: quantile((1.0 - level) / 2.0)?, upper: quantile((1.0 + level) / 2.0)? })
}
