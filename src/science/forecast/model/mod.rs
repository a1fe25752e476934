//! Train a model, forecast with it, and find the past days that speak for its forecast.

use rayon::join;
use serde::Serialize;

use super::day::DayRecord;
use super::evaluation::{
    Comparison, Evaluation, Part, Plan, Samples, Shares, by_day, evaluate, evaluate_against, first_of, work_of_both,
};
use crate::progress::Progress;

mod explanation;
mod forecast;
mod options;
mod what_if;

pub use explanation::{Explanation, FeatureContribution, Imputed, METHOD, OutOfRange};
pub use forecast::{
    Category, Forecast, ForecastError, InputQuality, SimilarDay, SupportDay, TrainedModel, TrainingWindow,
};
pub use options::{FeatureChoice, LONGEST_LEAD, TrainingError, TrainingOptions, TrainingSummary, check, check_pooled};
pub(crate) use options::{Prepared, prepare};
pub use what_if::{Change, ResponsePoint, changed};

/// A model and what it is worth.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Trained {
    /// The model, fitted to all seasons.
    pub model: TrainedModel,
    /// Scores on seasons held out, of the model's recipe and of the models beside it.
    pub evaluation: Evaluation,
}

/// Trains a model on all seasons of `days` (rising dates, gaps allowed) and evaluates the recipe season by season.
///
/// Uses the current rayon pool; the result has the same bits at any number of threads. A cancelled run ends within tenths of a
/// second.
///
/// # Errors
/// [`TrainingError`]: what [`check`] says; rarely a fit that fails; [`TrainingError::Cancelled`].
pub fn train(days: &[DayRecord], options: &TrainingOptions, progress: &dyn Progress) -> Result<Trained, TrainingError> {
    train_pooled(&[days], options, progress)
}

/// Trains one model on the days of several stations, each as [`train`] wants them: the days of a region with the activity of
/// that region, as [`regional`](super::region::regional) makes them.
///
/// # Errors
/// As [`train`].
pub fn train_pooled(
    stations: &[&[DayRecord]],
    options: &TrainingOptions,
    progress: &dyn Progress,
) -> Result<Trained, TrainingError> {
    let prepared = prepare(stations, options)?;
    let plan = Plan::new(&prepared.samples);
    let mut work = plan.work();
    let last = work.len();
    work.push((prepared.samples.len() as f64).powi(2));
    let shares = Shares::new(progress, work);
    let (model, evaluation) = join(
        || fit(&prepared, options, &shares.part(last, "final model".to_owned())),
        || evaluate(&prepared.samples, &plan, options, &shares),
    );
    Ok(Trained { model: model?, evaluation: evaluation? })
}

/// Trains as [`train_pooled`], and compares the recipe on all seasons with the same recipe on `active_seasons` alone, which an
/// earlier model was trained on: both forecast each season from the others of theirs.
///
/// # Errors
/// As [`train`].
pub fn retrain(
    stations: &[&[DayRecord]],
    options: &TrainingOptions,
    active_seasons: &[i16],
    progress: &dyn Progress,
) -> Result<(Trained, Option<Comparison>), TrainingError> {
    let prepared = prepare(stations, options)?;
    let samples = &prepared.samples;
    let plan = Plan::new(samples);
    let mut work = work_of_both(samples, &plan, active_seasons);
    let last = work.len();
    work.push((samples.len() as f64).powi(2));
    let shares = Shares::new(progress, work);
    let (model, judged) = join(
        || fit(&prepared, options, &shares.part(last, "final model".to_owned())),
        || evaluate_against(samples, &plan, active_seasons, options, &shares),
    );
    let (evaluation, comparison) = judged?;
    Ok((Trained { model: model?, evaluation }, comparison))
}

/// The recipe of a split, on all seasons.
fn fit(prepared: &Prepared, options: &TrainingOptions, progress: &dyn Progress) -> Result<TrainedModel, TrainingError> {
    let Prepared { set, samples, summary } = prepared;
    let rows = samples.rows_of(|_| true);
    let part = Part::new(samples, &rows);
    let svm = part.svm(options, progress)?;
    let days = samples.days_of(&rows);
    let (said, known) = (by_day(&days, &svm.out_of_fold), first_of(&days, part.event()));
    let threshold = options.threshold.choose(&said, &known).ok_or(TrainingError::NoThreshold)?;
    Ok(TrainedModel {
        label: options.label,
        lead: options.lead,
        feature_set: set.id,
        feature_set_version: set.version,
        reported: set.reported.clone(),
        features: svm.columns.iter().map(|&j| set.features[j].name.clone()).collect(),
        preparation: part.preparation.select(&svm.columns),
        support: support_days(samples, &svm.machine.support_index),
        machine: svm.machine,
        platt: svm.platt,
        threshold,
        threshold_rule: options.threshold,
        c: svm.best.c,
        gamma: svm.best.gamma,
        cross_validated_auc: svm.best.auc,
        training: TrainingWindow {
            first: summary.first,
            last: summary.last,
            days: summary.days,
            events: summary.events,
            station_days: summary.station_days,
            seasons: samples.seasons.clone(),
        },
        base_rate: summary.base_rate,
        seed: options.seed,
    })
}

fn support_days(samples: &Samples, rows: &[usize]) -> Vec<SupportDay> {
    let day = |&i: &usize| SupportDay { date: samples.date[i], label: samples.event[i], station: samples.station[i] };
    rows.iter().map(day).collect()
}

#[cfg(test)]
mod tests;
