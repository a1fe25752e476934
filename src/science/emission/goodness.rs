//! Goodness of fit by a semi-parametric bootstrap (Clauset, Shalizi & Newman 2009, SIAM Rev. 51, sec. 4.1).
//!
//! A replicate draws each of the n values from the fitted tail with the probability n_tail/n, else from the values below xmin,
//! is fitted like the data (xmin chosen anew where it was chosen), and its distance compared with that of the data. Where xmin
//! was given, only the tail is drawn. One random stream a replicate: the result does not depend on the number of threads.

use std::sync::atomic::{AtomicUsize, Ordering};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::error::EmissionError;
use super::sample::Sample;
use super::tails::distribution::{Distribution, Draw};
use super::tails::{DecibelLevels, Fitted, KsConvention, LN_RATIO_PER_DB, Model, Tail, fit_distribution, ks_distance};
use super::xmin::{Candidates, any_below};
use crate::progress::Progress;

/// What is tested.
#[derive(Clone, Copy, Debug)]
pub struct Question<'a> {
    /// The sample.
    pub sample: &'a Sample,
    /// The fit to a tail of it.
    pub fitted: &'a Fitted,
    /// Whether xmin was chosen by the distance (true) or given.
    pub xmin_chosen: bool,
    /// The upper bound that was given.
    pub xmax: Option<f64>,
    /// How distances are taken.
    pub convention: KsConvention,
}

/// The answer.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Goodness {
    /// Share of the replicates whose distance is at least that of the data. Below 0.1 the model is rejected.
    pub p_value: f64,
    /// Replicates.
    pub replicates: usize,
}

/// Tests `question.fitted` with `replicates` data sets.
///
/// # Errors
/// No replicates, a tail that does not belong to the sample, or [`EmissionError::Cancelled`].
pub fn p_value(
    question: &Question<'_>,
    replicates: usize,
    seed: u64,
    progress: &dyn Progress,
) -> Result<Goodness, EmissionError> {
    if replicates == 0 {
        return Err(EmissionError::option("replicates", replicates, "a whole number of at least 1"));
    }
    let tail = question.sample.tail(Some(question.fitted.xmin), question.xmax)?;
    let limit = question.fitted.ks_distance(&tail, question.convention);
    let plan = Plan::new(question, &tail);
    let done = AtomicUsize::new(0);
    let as_far = |replicate: usize| {
        if progress.cancelled() {
            return Err(EmissionError::Cancelled);
        }
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(replicate as u64);
        let closer = plan.is_closer(limit, &mut rng);
        let count = done.fetch_add(1, Ordering::Relaxed) + 1;
        if count.is_multiple_of(64) {
            progress.report(count as f64 / replicates as f64, "goodness of fit");
        }
        Ok(usize::from(!closer))
    };
    let far = (0..replicates).into_par_iter().map(as_far).try_reduce(|| 0, |a, b| Ok(a + b))?;
    Ok(Goodness { p_value: far as f64 / replicates as f64, replicates })
}

/// How replicates are made and judged.
enum Plan<'a> {
    /// Exact values, power law, xmin chosen among all values: everything in logarithms, and nothing is ever sorted.
    Scan { body: Vec<f64>, n_tail: usize, start: f64, b: f64, convention: KsConvention },
    /// A tail of given bounds.
    Fixed { tail: &'a Tail, model: Model, draw: Draw, convention: KsConvention },
    /// Any model, xmin chosen from a grid.
    Grid { question: Question<'a>, draw: Draw, below: usize, n_tail: usize },
}

impl<'a> Plan<'a> {
    fn new(question: &Question<'a>, tail: &'a Tail) -> Self {
        let fitted = question.fitted;
        let convention = question.convention;
        let distribution: &Distribution = &fitted.distribution;
        if !question.xmin_chosen {
            return Plan::Fixed { tail, model: fitted.model, draw: distribution.sampler(), convention };
        }
        let below = match question.sample {
            Sample::Exact(values) => values.partition_point(|&x| x < fitted.xmin),
            Sample::Rounded(levels) => {
                levels.levels.partition_point(|&level| levels.lower_edge(level) < fitted.xmin * (1.0 - 1e-9))
            }
        };
        match (question.sample, fitted.parameter("alpha")) {
            (Sample::Exact(values), Some(alpha)) if fitted.model == Model::PowerLaw => Plan::Scan {
                body: values[..below].iter().map(|x| x.ln()).collect(),
                n_tail: tail.len(),
                start: fitted.xmin.ln(),
                b: alpha.value - 1.0,
                convention,
            },
            _ => Plan::Grid { question: *question, draw: distribution.sampler(), below, n_tail: tail.len() },
        }
    }

    /// Whether the distance of one replicate is below `limit`.
    fn is_closer(&self, limit: f64, rng: &mut ChaCha8Rng) -> bool {
        match self {
            Plan::Scan { body, n_tail, start, b, convention } => {
                let (logs, tail_start) = replicate_logs(body, *n_tail, *start, *b, rng);
                Candidates::new(&logs, *convention).any_below(limit, tail_start)
            }
            Plan::Fixed { tail, model, draw, convention } => {
                let replicate = replicate_tail(tail, draw, rng);
                fit_distribution(&replicate, *model).is_ok_and(|distribution| {
                    ks_distance(&distribution.cumulative(), &replicate, *convention, limit) < limit
                })
            }
            Plan::Grid { question, draw, below, n_tail } => {
                let sample = replicate_sample(question, draw, *below, *n_tail, rng);
                any_below(&sample, question.fitted.model, question.xmax, question.convention, limit)
            }
        }
    }
}

/// Rising logarithms of a replicate, and where its tail begins.
fn replicate_logs(body: &[f64], n_tail: usize, start: f64, b: f64, rng: &mut ChaCha8Rng) -> (Vec<f64>, usize) {
    let n = body.len() + n_tail;
    // one draw a value: a number below body.len() is that value of the body, any other is the tail
    let mut times = vec![0_u32; body.len()];
    let mut in_tail = 0;
    for _ in 0..n {
        match times.get_mut(rng.random_range(0..n)) {
            Some(times) => *times += 1,
            None => in_tail += 1,
        }
    }
    let mut logs = Vec::with_capacity(n);
    for (&log, &times) in body.iter().zip(&times) {
        logs.extend(std::iter::repeat_n(log, times as usize));
    }
    let tail_start = logs.len();
    // gaps of sorted exponential variables are exponential with the rates b m, b (m - 1), ... (Renyi 1953)
    let mut log = start;
    for left in (1..=in_tail).rev() {
        log -= (1.0 - rng.random::<f64>()).ln() / (b * f64::from(left));
        logs.push(log);
    }
    (logs, tail_start)
}

/// A tail of the same length and bounds.
pub(super) fn replicate_tail(tail: &Tail, draw: &Draw, rng: &mut ChaCha8Rng) -> Tail {
    let value = |rng: &mut ChaCha8Rng| {
        let u = draw.draw(rng);
        tail.width.map_or(u, |width| (u / width).floor() * width)
    };
    let mut u: Vec<f64> = (0..tail.len()).map(|_| value(rng)).collect();
    u.sort_unstable_by(f64::total_cmp);
    let largest = tail.xmin * (u.last().copied().unwrap_or_default() + tail.width.unwrap_or_default()).exp();
    Tail { xmin: tail.xmin, xmax: tail.xmax, width: tail.width, largest, u }
}

/// A whole sample: the tail of the fit, and the values outside of it.
fn replicate_sample(question: &Question<'_>, draw: &Draw, below: usize, n_tail: usize, rng: &mut ChaCha8Rng) -> Sample {
    let xmin = question.fitted.xmin;
    match question.sample {
        Sample::Exact(values) => {
            let mut values: Vec<f64> = (0..below + n_tail)
                .map(|_| {
                    let at = rng.random_range(0..below + n_tail);
                    if at < below { values[at] } else { xmin * draw.draw(rng).exp() }
                })
                .collect();
            values.sort_unstable_by(f64::total_cmp);
            Sample::Exact(values)
        }
        Sample::Rounded(levels) => {
            let first = levels.levels[below.min(levels.levels.len() - 1)];
            let width = levels.step_db * LN_RATIO_PER_DB;
            let from = ((xmin / levels.lower_edge(first)).ln() / width).round() as i64 + first;
            let mut drawn: Vec<i64> = (0..below + n_tail)
                .map(|_| {
                    let at = rng.random_range(0..below + n_tail);
                    if at < below { levels.levels[at] } else { from + (draw.draw(rng) / width).floor() as i64 }
                })
                .collect();
            drawn.sort_unstable();
            Sample::Rounded(DecibelLevels { levels: drawn, ..levels.clone() })
        }
    }
}

#[cfg(test)]
mod tests;
