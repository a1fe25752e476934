//! What a model is worth: every model on seasons that it has not seen.
//!
//! * **Leave one season out**: each season is forecast by models fitted to all the others.
//! * **Forward chaining**, the final number: each season is forecast by models fitted to the seasons before it.
//!
//! In either, all that is learnt is learnt from the training seasons alone: medians and scales, C and gamma, Platt's sigmoid,
//! the ridge penalty, base rates, and each model's threshold, which is chosen on out-of-fold probabilities of inner
//! [season folds](folds). Scores pool the held-out days of all seasons, each day judged by the threshold of its own split.
//!
//! Of a region whose stations feed one model, every station and day is a row to learn from; what is scored is the region's
//! day, with the mean of what its stations give it, for every model alike. All stations of a season stand on the same side
//! of every split: what one of them saw would tell the label of the others.
//!
//! Splits run side by side and are put together in order of season: the result has the same bits at any number of threads.

use jiff::civil::Date;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

mod comparison;
pub mod folds;
mod forecasters;
mod per_model;
mod resume;
mod samples;
mod share;

use super::model::{TrainingError, TrainingOptions};
use super::verification::bootstrap::{Interval, Replicates, SeasonDraws, interval, replicate};
use super::verification::brier::{Decomposition, decomposition};
use super::verification::reliability::{ReliabilityBin, bins};
use super::verification::roc::{RocPoint, curve};
use super::verification::{Outcome, Scores};
use crate::progress::Progress;
pub(crate) use comparison::work_of_both;
pub use comparison::{Comparison, Differences, SeasonComparison, Verdict};
pub(crate) use folds::inner_folds;
use folds::{seasons_before_chaining, seasons_of_each_class};
pub(crate) use forecasters::{Part, Probabilities};
pub use per_model::PerModel;
pub(crate) use resume::Done;
pub(crate) use samples::{Samples, before, by_day, first_of, is_recorded, variables_read};
pub(crate) use share::{Share, Shares};

/// Bins of the reliability diagram.
pub const RELIABILITY_BINS: usize = 10;
/// Replicates of the bootstrap over seasons.
pub const REPLICATES: usize = 1000;
/// Share of the replicates that an interval holds.
pub const LEVEL: f64 = 0.95;

/// How a model and the ones it is compared with do on seasons they were not fitted to.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Evaluation {
    /// Scored days; of a region each day once, however many of its stations were recorded.
    pub days: usize,
    /// Avalanche days among them.
    pub events: usize,
    /// Number of seasons.
    pub seasons: usize,
    /// Share of avalanche days.
    pub base_rate: f64,
    /// First scored day.
    pub first: Date,
    /// Last scored day.
    pub last: Date,
    /// Leave one season out, all days together. The reference of the Brier skill is the climatology of the same splits.
    pub scores: PerModel<Scores>,
    /// Leave one season out, season by season.
    pub per_season: Vec<SeasonScores>,
    /// Reliability of the SVM, leave one season out: [`RELIABILITY_BINS`] bins of equal width.
    pub reliability: Vec<ReliabilityBin>,
    /// Parts of the Brier score of the SVM over those bins.
    pub brier_decomposition: Option<Decomposition>,
    /// ROC curve of the SVM, leave one season out.
    pub roc: Vec<RocPoint>,
    /// Each season forecast by the seasons before it; `None` where there are too few seasons.
    pub forward_chaining: Option<ForwardChaining>,
    /// Uncertainty of the leave-one-season-out scores.
    pub bootstrap: Bootstrap,
}

/// Scores of one held-out season.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct SeasonScores {
    /// Year in which the season begins.
    pub season: i16,
    /// Scored days.
    pub days: usize,
    /// Avalanche days among them.
    pub events: usize,
    /// Scores of each model.
    pub scores: PerModel<Scores>,
    /// Cost of the SVM that was chosen on the other seasons.
    pub c: f64,
    /// Inverse squared width that was chosen on them; `None` for a linear kernel.
    pub gamma: Option<f64>,
    /// Threshold of each model that was chosen on them, 0 to 1.
    pub threshold: PerModel<f64>,
}

/// Scores of forward chaining.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct ForwardChaining {
    /// Seasons that were forecast, by the year in which they begin.
    pub seasons: Vec<i16>,
    /// Seasons before the first of them.
    pub first_training_seasons: usize,
    /// Scored days.
    pub days: usize,
    /// Avalanche days among them.
    pub events: usize,
    /// Share of avalanche days.
    pub base_rate: f64,
    /// Scores of each model, all days together.
    pub scores: PerModel<Scores>,
}

/// Percentile intervals of the bootstrap over seasons.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Bootstrap {
    /// Number of replicates.
    pub replicates: usize,
    /// Share of the replicates that an interval holds.
    pub level: f64,
    /// Seed of the draws.
    pub seed: u64,
    /// Intervals of each model; climatology's Brier skill is 0 by definition.
    pub models: PerModel<Intervals>,
    /// AUC of the SVM minus that of kNN-30 on the same draws; an interval that holds 0 says that there is no real difference.
    pub svm_minus_knn30_auc: Option<Difference>,
}

/// Intervals of the scores of one model; `None` where a score is undefined in every replicate.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Intervals {
    /// Of the area under the ROC curve.
    pub auc: Option<Interval>,
    /// Of the Peirce skill score.
    pub pss: Option<Interval>,
    /// Of the Brier skill.
    pub brier_skill: Option<Interval>,
}

/// A difference of two scores and its interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Difference {
    /// Difference on all seasons.
    pub estimate: f64,
    /// Lower bound of the interval.
    pub lower: f64,
    /// Upper bound of the interval.
    pub upper: f64,
}

/// A season to forecast and the rows to do it with.
pub(crate) struct Split {
    season: usize,
    training: Vec<usize>,
    test: Vec<usize>,
}

/// The splits of an evaluation.
pub(crate) struct Plan {
    held_out: Vec<Split>,
    chained: Vec<Split>,
}

/// A season that was forecast.
#[derive(Clone, Serialize, Deserialize)]
struct Judged {
    season: usize,
    outcomes: PerModel<Vec<Outcome>>,
    threshold: PerModel<f64>,
    c: f64,
    gamma: Option<f64>,
}

impl Plan {
    pub(crate) fn new(samples: &Samples) -> Self {
        let seasons = samples.seasons.len();
        let split = |season: usize, learn: &dyn Fn(usize) -> bool| Split {
            season,
            training: samples.rows_of(learn),
            test: samples.rows_of(|s| s == season),
        };
        let held_out = (0..seasons).map(|season| split(season, &|s| s != season)).collect();
        let chained = (seasons_before_chaining(seasons)..seasons)
            .map(|season| split(season, &|s| s < season))
            .filter(|split| {
                let rows = split.training.iter().map(|&i| (samples.season[i], samples.event[i]));
                let (events, others) = seasons_of_each_class(rows);
                // inner folds need both classes in training
                events >= 2 && others >= 2
            })
            .collect();
        Self { held_out, chained }
    }

    /// Relative work of each split, in the order of the parts of [`evaluate`]: Gram matrices make it quadratic.
    pub(crate) fn work(&self) -> Vec<f64> {
        self.splits().map(|split| (split.training.len() as f64).powi(2)).collect()
    }

    fn splits(&self) -> impl Iterator<Item = &Split> {
        self.held_out.iter().chain(&self.chained)
    }
}

/// Runs every split of `plan`; split `i` reports to part `i` of `shares`. What is done is saved as it is done, and an
/// attempt that goes on from there has the same bits.
pub(crate) fn evaluate(
    samples: &Samples,
    plan: &Plan,
    options: &TrainingOptions,
    shares: &Shares<'_>,
) -> Result<Evaluation, TrainingError> {
    let (held_out, chained) = judge_all(samples, plan, options, shares)?;
    Ok(report(samples, &held_out, &chained, options))
}

/// The same beside the recipe on `active_seasons` alone; `shares` has the parts of [`work_of_both`].
pub(crate) fn evaluate_against(
    samples: &Samples,
    plan: &Plan,
    active_seasons: &[i16],
    options: &TrainingOptions,
    shares: &Shares<'_>,
) -> Result<(Evaluation, Option<Comparison>), TrainingError> {
    let (held_out, chained) = judge_all(samples, plan, options, shares)?;
    let first = plan.splits().count();
    let comparison = comparison::compare(samples, &held_out, active_seasons, options, shares, first)?;
    Ok((report(samples, &held_out, &chained, options), comparison))
}

/// The held-out seasons and the chained ones.
fn judge_all(
    samples: &Samples,
    plan: &Plan,
    options: &TrainingOptions,
    shares: &Shares<'_>,
) -> Result<(Vec<Judged>, Vec<Judged>), TrainingError> {
    let splits: Vec<&Split> = plan.splits().collect();
    let done = Done::resume(samples, options, splits.len(), shares.whole());
    let judged: Vec<Result<Judged, TrainingError>> = splits
        .into_par_iter()
        .enumerate()
        .with_max_len(1)
        .map(|(i, split)| {
            let manner = if i < plan.held_out.len() { "held out" } else { "forecast from the seasons before" };
            let share = shares.part(i, format!("season {} {manner}", samples.seasons[split.season]));
            if let Some(judged) = done.get(i) {
                share.report(1.0, "done before");
                return Ok(judged);
            }
            let judged = judge(samples, split, options, &share)?;
            done.set(i, &judged, &share);
            Ok(judged)
        })
        .collect();
    let mut held_out = judged.into_iter().collect::<Result<Vec<_>, _>>()?;
    let chained = held_out.split_off(plan.held_out.len());
    Ok((held_out, chained))
}

/// Fits every model to the training rows of a split and forecasts its season.
fn judge(
    samples: &Samples,
    split: &Split,
    options: &TrainingOptions,
    progress: &Share<'_>,
) -> Result<Judged, TrainingError> {
    if progress.cancelled() {
        return Err(TrainingError::Cancelled);
    }
    let part = Part::new(samples, &split.training);
    let svm = part.svm(options, progress)?;
    let probabilities = part.probabilities(part.speak(&svm, &split.test), &split.test, progress)?;
    let (learnt, tested) = (samples.days_of(&split.training), samples.days_of(&split.test));
    let known = first_of(&learnt, part.event());
    let threshold = probabilities.try_map(|p| {
        options.threshold.choose(&by_day(&learnt, &p.out_of_fold), &known).ok_or(TrainingError::NoThreshold)
    })?;
    let probability = probabilities.map(|p| by_day(&tested, &p.test));
    let event: Vec<bool> = tested.iter().map(|day| samples.event[split.test[day.start]]).collect();
    Ok(Judged {
        season: split.season,
        outcomes: probability
            .zip_with(&threshold, |p, &threshold| outcomes(p, threshold, &event, &probability.climatology)),
        threshold,
        c: svm.best.c,
        gamma: svm.best.gamma,
    })
}

/// What was said of each day at a threshold, and what happened.
pub(crate) fn outcomes(probability: &[f64], threshold: f64, event: &[bool], reference: &[f64]) -> Vec<Outcome> {
    let days = probability.iter().zip(event).zip(reference);
    let outcome = |((&probability, &event), &reference): ((&f64, &bool), &f64)| Outcome {
        probability,
        warned: probability >= threshold,
        event,
        reference,
    };
    days.map(outcome).collect()
}

fn report(samples: &Samples, held_out: &[Judged], chained: &[Judged], options: &TrainingOptions) -> Evaluation {
    let cost_loss = options.threshold.cost_loss();
    let pooled = pool(held_out);
    let scores = pooled.map(|o| Scores::of(o, cost_loss));
    let probability: Vec<f64> = pooled.svm.iter().map(|o| o.probability).collect();
    let event: Vec<bool> = pooled.svm.iter().map(|o| o.event).collect();
    let season: Vec<usize> =
        held_out.iter().flat_map(|judged| vec![judged.season; judged.outcomes.svm.len()]).collect();
    let reliability = bins(&probability, &event, RELIABILITY_BINS);
    let (days, events) = (pooled.svm.len(), count_events(&pooled.svm));
    Evaluation {
        days,
        events,
        seasons: samples.seasons.len(),
        base_rate: events as f64 / days as f64,
        first: samples.date.first().copied().unwrap_or_default(),
        last: samples.date.last().copied().unwrap_or_default(),
        scores,
        per_season: held_out.iter().map(|judged| season_scores(samples, judged, cost_loss)).collect(),
        brier_decomposition: decomposition(&probability, &event, &reliability),
        reliability,
        roc: curve(&probability, &event),
        forward_chaining: forward_chaining(samples, chained, cost_loss),
        bootstrap: bootstrap(samples.seasons.len(), &season, &pooled, options.seed),
    }
}

/// The outcomes of all seasons, one after the other.
fn pool(judged: &[Judged]) -> PerModel<Vec<Outcome>> {
    let mut pooled = PerModel::default();
    for season in judged {
        pooled.append(season.outcomes.clone());
    }
    pooled
}

fn count_events(outcomes: &[Outcome]) -> usize {
    outcomes.iter().filter(|o| o.event).count()
}

fn season_scores(samples: &Samples, judged: &Judged, cost_loss: Option<f64>) -> SeasonScores {
    SeasonScores {
        season: samples.seasons[judged.season],
        days: judged.outcomes.svm.len(),
        events: count_events(&judged.outcomes.svm),
        scores: judged.outcomes.map(|o| Scores::of(o, cost_loss)),
        c: judged.c,
        gamma: judged.gamma,
        threshold: judged.threshold,
    }
}

fn forward_chaining(samples: &Samples, chained: &[Judged], cost_loss: Option<f64>) -> Option<ForwardChaining> {
    let first = chained.first()?;
    let pooled = pool(chained);
    let (days, events) = (pooled.svm.len(), count_events(&pooled.svm));
    Some(ForwardChaining {
        seasons: chained.iter().map(|judged| samples.seasons[judged.season]).collect(),
        first_training_seasons: first.season,
        days,
        events,
        base_rate: events as f64 / days as f64,
        scores: pooled.map(|o| Scores::of(o, cost_loss)),
    })
}

/// `season` is the position of the season of each outcome among the `seasons`.
pub(crate) fn bootstrap(seasons: usize, season: &[usize], pooled: &PerModel<Vec<Outcome>>, seed: u64) -> Bootstrap {
    let draws = SeasonDraws::new(seasons, REPLICATES, seed);
    let replicates = pooled.map(|outcomes| replicate(outcomes, season, &draws));
    let intervals = |r: &Replicates| Intervals {
        auc: interval(&r.auc, LEVEL),
        pss: interval(&r.pss, LEVEL),
        brier_skill: interval(&r.brier_skill, LEVEL),
    };
    Bootstrap {
        replicates: REPLICATES,
        level: LEVEL,
        seed,
        models: replicates.map(intervals),
        svm_minus_knn30_auc: difference(pooled, &replicates),
    }
}

fn difference(pooled: &PerModel<Vec<Outcome>>, replicates: &PerModel<Replicates>) -> Option<Difference> {
    let auc = |outcomes: &[Outcome]| Scores::of(outcomes, None).auc;
    let pairs = replicates.svm.auc.iter().zip(&replicates.knn30.auc);
    let differences: Vec<Option<f64>> = pairs.map(|(&svm, &knn)| Some(svm? - knn?)).collect();
    let Interval { lower, upper } = interval(&differences, LEVEL)?;
    Some(Difference { estimate: auc(&pooled.svm)? - auc(&pooled.knn30)?, lower, upper })
}

#[cfg(test)]
mod archive_tests;
#[cfg(test)]
mod tests;
