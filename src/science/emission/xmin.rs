//! Where the tail begins: minimum Kolmogorov-Smirnov distance (Clauset, Shalizi & Newman 2009, SIAM Rev. 51, 661-703, sec. 3.3).
//!
//! [`scan`] is exact for the power law: every unique value but the largest is a candidate, and a tail never begins inside a tie.
//! Suffix sums of ln x give the exponent of a candidate at once. Its distance is abandoned as soon as it exceeds the best: first
//! at the value where the last candidate was found wanting, then by branch and bound, as both distributions are monotone. That
//! changes no bit of the answer.

use serde::{Deserialize, Serialize};

use super::error::EmissionError;
use super::sample::Sample;
use super::tails::{KsConvention, Model, Tail, fit_distribution, ks_distance};

/// The beginning of the tail.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct TailStart {
    /// Smallest value of the tail, in the unit of the sample.
    pub xmin: f64,
    /// Exponent of the power law from there.
    pub alpha: f64,
    /// Distance of the two distributions.
    pub ks_distance: f64,
    /// Values of at least xmin.
    pub n_tail: usize,
}

/// The power-law tail with the smallest distance, of `sorted` (rising, finite, positive). Of equal distances the longer tail wins.
///
/// # Errors
/// Fewer than three values, or one unique value only.
pub fn scan(sorted: &[f64], convention: KsConvention) -> Result<TailStart, EmissionError> {
    if sorted.len() < 3 {
        return Err(EmissionError::TooFewEvents { what: "a scan of xmin", found: sorted.len(), needed: 3 });
    }
    let logs: Vec<f64> = sorted.iter().map(|x| x.ln()).collect();
    let best = Candidates::new(&logs, convention).best();
    let best = best.ok_or(EmissionError::Degenerate { what: "the sample" })?;
    Ok(TailStart {
        xmin: sorted[best.start],
        alpha: best.b + 1.0,
        ks_distance: best.distance,
        n_tail: sorted.len() - best.start,
    })
}

/// The candidate with the smallest distance.
#[derive(Clone, Copy, Debug)]
pub(super) struct Best {
    /// Where its tail begins.
    pub(super) start: usize,
    /// Exponent less 1.
    pub(super) b: f64,
    pub(super) distance: f64,
}

/// Candidates that are looked at first, so that a good one is known early.
const FIRST_LOOK: usize = 64;

/// All tails of a rising sequence of logarithms.
pub(super) struct Candidates<'a> {
    logs: &'a [f64],
    /// `sum of logs[i..]`.
    suffix: Vec<f64>,
    two_sided: bool,
}

impl<'a> Candidates<'a> {
    pub(super) fn new(logs: &'a [f64], convention: KsConvention) -> Self {
        let mut suffix = vec![0.0; logs.len() + 1];
        for i in (0..logs.len()).rev() {
            suffix[i] = suffix[i + 1] + logs[i];
        }
        Self { logs, suffix, two_sided: convention == KsConvention::TwoSided }
    }

    /// The smallest distance of all.
    pub(super) fn best(&self) -> Option<Best> {
        let mut search = Search { candidates: self, best: None, limit: f64::INFINITY, witness: 0, stack: Vec::new() };
        for start in self.first_look() {
            search.look_at(start);
        }
        for start in 0..self.logs.len() {
            search.look_at(start);
        }
        search.best
    }

    /// Whether some candidate's distance is below `limit`; those near `likely` are looked at first.
    pub(super) fn any_below(&self, limit: f64, likely: usize) -> bool {
        let mut search = Search { candidates: self, best: None, limit, witness: 0, stack: Vec::new() };
        let likely = std::iter::once(likely.min(self.logs.len().saturating_sub(1)));
        likely.chain(self.first_look()).chain(0..self.logs.len()).any(|start| {
            search.look_at(start);
            search.best.is_some_and(|best| best.distance < limit)
        })
    }

    fn first_look(&self) -> impl Iterator<Item = usize> {
        let n = self.logs.len();
        (0..FIRST_LOOK.min(n)).map(move |k| k * n / FIRST_LOOK.min(n))
    }
}

/// A search under way.
struct Search<'a> {
    candidates: &'a Candidates<'a>,
    best: Option<Best>,
    /// A candidate with a larger distance is of no interest.
    limit: f64,
    /// Where, counted from the beginning of the sequence, the last candidate was abandoned.
    witness: usize,
    stack: Vec<Span>,
}

/// Two positions of a tail with the fitted distribution there, between which the distance is still unknown.
#[derive(Clone, Copy)]
struct Span {
    from: usize,
    to: usize,
    f_from: f64,
    f_to: f64,
}

impl Search<'_> {
    fn look_at(&mut self, start: usize) {
        let logs = self.candidates.logs;
        let is_tie = start > 0 && logs[start - 1] == logs[start];
        let is_largest = logs[logs.len() - 1] == logs[start];
        if is_tie || is_largest {
            return;
        }
        let tail = &logs[start..];
        let n = tail.len() as f64;
        let b = n / (self.candidates.suffix[start] - n * tail[0]);
        if !(b.is_finite() && b > 0.0) {
            return;
        }
        if let Some(distance) = self.distance(tail, start, b) {
            let better = self
                .best
                .is_none_or(|best| distance < best.distance || (distance == best.distance && start < best.start));
            if better {
                self.best = Some(Best { start, b, distance });
                self.limit = self.limit.min(distance);
            }
        }
    }

    /// The distance of `tail` from a power law; `None` where it exceeds the limit.
    fn distance(&mut self, tail: &[f64], start: usize, b: f64) -> Option<f64> {
        let n = tail.len();
        let per_value = 1.0 / n as f64;
        let step = if self.candidates.two_sided { per_value } else { 0.0 };
        let distribution = |j: usize| 1.0 - (-b * (tail[j] - tail[0])).exp();
        let deviation = |j: usize, f: f64| {
            let excess = f - j as f64 * per_value;
            excess.max(step - excess).max(-excess)
        };
        if self.witness > start {
            let j = self.witness - start;
            if deviation(j, distribution(j)) > self.limit {
                return None;
            }
        }
        let mut largest = step;
        self.stack.clear();
        let (mut previous, mut f_previous) = (0, 0.0);
        let points = 32.min(n - 1);
        for k in 1..=points {
            let j = k * (n - 1) / points;
            let f = distribution(j);
            largest = largest.max(deviation(j, f));
            if largest > self.limit {
                self.witness = start + j;
                return None;
            }
            self.stack.push(Span { from: previous, to: j, f_from: f_previous, f_to: f });
            (previous, f_previous) = (j, f);
        }
        while let Some(span) = self.stack.pop() {
            if span.to <= span.from + 1 {
                continue;
            }
            // inside, F lies between its ends, and so does the rank
            let above = span.f_to - (span.from + 1) as f64 * per_value;
            let below = (span.to - 1) as f64 * per_value + step - span.f_from;
            if above.max(below) <= largest {
                continue;
            }
            let j = usize::midpoint(span.from, span.to);
            let f = distribution(j);
            largest = largest.max(deviation(j, f));
            if largest > self.limit {
                self.witness = start + j;
                return None;
            }
            self.stack.push(Span { to: j, f_to: f, ..span });
            self.stack.push(Span { from: j, f_from: f, ..span });
        }
        Some(largest)
    }
}

/// Candidates of [`select`].
const GRID: usize = 40;
/// Shortest tail of [`select`].
const SHORTEST: usize = 50;

/// The tail of any `model` with the smallest distance, of up to 40 candidates in equal ratios of their number of events, from the
/// whole sample down to 50 events: fits of two parameters are too slow to try every value.
///
/// # Errors
/// No candidate that the model could be fitted to.
pub fn select(
    sample: &Sample,
    model: Model,
    xmax: Option<f64>,
    convention: KsConvention,
) -> Result<Tail, EmissionError> {
    let mut best: Option<(f64, Tail)> = None;
    let mut refusal = EmissionError::TooFewEvents { what: "a choice of xmin", found: sample.len(), needed: 3 };
    for xmin in grid(sample) {
        let limit = best.as_ref().map_or(f64::INFINITY, |best| best.0);
        match distance_from(sample, model, xmin, xmax, convention, limit) {
            Ok((distance, tail)) if distance < limit => best = Some((distance, tail)),
            Ok(_) => {}
            Err(error) => refusal = error,
        }
    }
    best.map(|best| best.1).ok_or(refusal)
}

/// Whether some candidate of [`select`] has a distance below `limit`.
pub(super) fn any_below(
    sample: &Sample,
    model: Model,
    xmax: Option<f64>,
    convention: KsConvention,
    limit: f64,
) -> bool {
    grid(sample).into_iter().any(|xmin| {
        distance_from(sample, model, xmin, xmax, convention, limit).is_ok_and(|(distance, _)| distance < limit)
    })
}

fn distance_from(
    sample: &Sample,
    model: Model,
    xmin: f64,
    xmax: Option<f64>,
    convention: KsConvention,
    limit: f64,
) -> Result<(f64, Tail), EmissionError> {
    let tail = sample.tail(Some(xmin), xmax)?;
    let distribution = fit_distribution(&tail, model)?;
    Ok((ks_distance(&distribution.cumulative(), &tail, convention, limit), tail))
}

fn grid(sample: &Sample) -> Vec<f64> {
    let n = sample.len();
    let shortest = SHORTEST.min(n.div_ceil(2)).max(3) as f64;
    let value = |i: usize| match sample {
        Sample::Exact(values) => values[i],
        Sample::Rounded(levels) => levels.lower_edge(levels.levels[i]),
    };
    let ratio = (shortest / n as f64).ln() / (GRID - 1) as f64;
    let ranks = (0..GRID).map(|k| n.saturating_sub((n as f64 * (ratio * k as f64).exp()).round() as usize));
    let mut candidates: Vec<f64> = ranks.filter(|&rank| rank < n).map(value).collect();
    candidates.dedup();
    candidates
}

#[cfg(test)]
pub(super) mod tests;
