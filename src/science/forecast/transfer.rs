//! Transfer: a model that was trained at one place, scored at another.
//!
//! The model stays as it is: its medians take the place of what the other place does not report, and its threshold is in
//! force. Beside it stand the models of the target itself, each season forecast by the others: what a place of so many seasons
//! could do on its own, and the climatology that fixes the zero of the Brier skill.

use jiff::civil::Date;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::day::{DayRecord, Variable};
use super::evaluation::folds::{SEASONS_NEEDED, seasons_of_each_class};
use super::evaluation::{
    Bootstrap, Part, PerModel, Probabilities, RELIABILITY_BINS, Samples, Shares, bootstrap, outcomes, variables_read,
};
use super::features::{History, HistoryError};
use super::issued::{Drift, IssuedDay, Said};
use super::model::{ForecastError, TrainedModel, TrainingError};
use super::verification::brier::{Decomposition, decomposition};
use super::verification::reliability::{ReliabilityBin, bins};
use super::verification::roc::{RocPoint, curve};
use super::verification::{Outcome, Scores};
use crate::progress::Progress;

/// How a model does at a place that it was not trained at.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Transfer {
    /// Scored days of the target.
    pub days: usize,
    /// Avalanche days among them.
    pub events: usize,
    /// Years in which the scored seasons begin.
    pub seasons: Vec<i16>,
    /// Share of avalanche days.
    pub base_rate: f64,
    /// First scored day.
    pub first: Date,
    /// Last scored day.
    pub last: Date,
    /// Seasons of the target that the model was trained on: they are not scored.
    pub left_out: Vec<i16>,
    /// From this probability on the model warns: its own threshold, chosen where it was trained.
    pub threshold: f64,
    /// `svm`: the model. The others are models of the target, each season forecast by the other ones; null where the target
    /// has fewer than three seasons with both kinds of days. Zero of the Brier skill is the climatology of the target.
    pub scores: PerModel<Option<Scores>>,
    /// The same season by season.
    pub per_season: Vec<TransferSeason>,
    /// Reliability of the model.
    pub reliability: Vec<ReliabilityBin>,
    /// Parts of its Brier score over those bins.
    pub brier_decomposition: Option<Decomposition>,
    /// Its ROC curve.
    pub roc: Vec<RocPoint>,
    /// Uncertainty of the scores; null with one season. `svm_minus_knn30_auc` compares the model with neighbours at the target.
    pub bootstrap: Option<Bootstrap>,
    /// Variables that the model reads and the target does not report: they are imputed on every day.
    pub not_reported: Vec<String>,
    /// How the target differs from where the model was trained: base rate, calibration, inputs; with warnings in words.
    pub drift: Drift,
}

/// Scores of one season of the target.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct TransferSeason {
    /// Year in which the season begins.
    pub season: i16,
    /// Scored days.
    pub days: usize,
    /// Avalanche days among them.
    pub events: usize,
    /// Scores, as those of all seasons.
    pub scores: PerModel<Option<Scores>>,
}

/// Why a model could not be scored.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum TransferError {
    /// The days are not in order.
    #[error("{0}; days must be in rising order of date, each once")]
    Unordered(#[from] HistoryError),
    /// The model cannot forecast any more.
    #[error(transparent)]
    Model(ForecastError),
    /// Nothing to score.
    #[error(
        "no day can be scored: its avalanche activity must be known, the base day and the two days before it recorded with a \
         variable that the model reads, and the season none that the model was trained on there"
    )]
    NoDay,
    /// A model of the target could not be fitted.
    #[error("models of the target: {0}")]
    Target(TrainingError),
    /// The caller no longer wants it.
    #[error("cancelled")]
    Cancelled,
}

impl From<TrainingError> for TransferError {
    fn from(error: TrainingError) -> Self {
        if error == TrainingError::Cancelled { Self::Cancelled } else { Self::Target(error) }
    }
}

/// What is scored where.
#[derive(Clone, Copy, Debug)]
pub struct Target<'a> {
    /// Days of the target (rising dates, gaps allowed).
    pub days: &'a [DayRecord],
    /// Variables that it reports.
    pub reported: &'a [Variable],
    /// Seasons that the model was trained on there, by the year in which they begin: no test of it.
    pub trained_on: &'a [i16],
}

/// The days of a target that `model` can be scored on, without computing anything: their number.
///
/// # Errors
/// What [`evaluate`] says before it starts.
pub fn check(model: &TrainedModel, target: Target<'_>) -> Result<usize, TransferError> {
    collect(model, target).map(|samples| samples.len())
}

fn collect(model: &TrainedModel, target: Target<'_>) -> Result<Samples, TransferError> {
    let set = model.feature_set().map_err(TransferError::Model)?;
    let days: Vec<DayRecord> = target
        .days
        .iter()
        .filter(|day| !target.trained_on.contains(&super::day::season_of(day.date)))
        .copied()
        .collect();
    let samples = Samples::collect(&History::new(&days)?, &set, model.label, model.lead);
    if samples.len() == 0 { Err(TransferError::NoDay) } else { Ok(samples) }
}

/// Scores `model` on every day of the target that can be scored. `seed` is that of the bootstrap over seasons.
///
/// # Errors
/// [`TransferError`].
pub fn evaluate(
    model: &TrainedModel,
    target: Target<'_>,
    seed: u64,
    progress: &dyn Progress,
) -> Result<Transfer, TransferError> {
    let samples = collect(model, target)?;
    let spoken = speak(model, &samples);
    let (with_events, with_others) =
        seasons_of_each_class(samples.season.iter().copied().zip(samples.event.iter().copied()));
    let has_own_models = with_events.min(with_others) >= SEASONS_NEEDED;
    let seasons = samples.seasons.len();
    let shares = Shares::new(progress, vec![1.0; seasons]);
    let mut judged = Vec::with_capacity(seasons);
    for season in 0..seasons {
        let share = shares.part(season, format!("season {} of the target", samples.seasons[season]));
        if share.cancelled() {
            return Err(TransferError::Cancelled);
        }
        let test = samples.rows_of(|s| s == season);
        let said: Vec<f64> = test.iter().map(|&i| spoken[i].probability).collect();
        judged.push(if has_own_models {
            beside_own_models(model, &samples, season, &test, said, &share)?
        } else {
            alone(model, &samples, &test, &said)
        });
        share.report(1.0, "done");
    }
    Ok(report(model, target, &samples, spoken, &judged, seed))
}

/// What the model says of a day.
struct Spoken {
    probability: f64,
    imputed: Vec<String>,
    out_of_range: Vec<String>,
}

fn speak(model: &TrainedModel, samples: &Samples) -> Vec<Spoken> {
    let columns = model.preparation.columns();
    let names = |index: Vec<usize>| index.into_iter().filter_map(|j| model.features.get(j)).cloned().collect();
    let say = |i: usize| {
        let row = model.preparation.transform_row(samples.features.row(i));
        Spoken {
            probability: model.platt.probability(model.machine.decision_value(&row.values)),
            imputed: names(row.imputed.into_iter().filter(|&j| columns[j].used).collect()),
            out_of_range: names(row.out_of_range),
        }
    };
    (0..samples.len()).map(say).collect()
}

fn events(samples: &Samples, rows: &[usize]) -> Vec<bool> {
    rows.iter().map(|&i| samples.event[i]).collect()
}

/// The model without models of the target beside it; there is no climatology either, so the Brier skill is undefined.
fn alone(model: &TrainedModel, samples: &Samples, test: &[usize], said: &[f64]) -> PerModel<Vec<Outcome>> {
    let unknown = vec![f64::NAN; test.len()];
    PerModel { svm: outcomes(said, model.threshold, &events(samples, test), &unknown), ..PerModel::default() }
}

fn beside_own_models(
    model: &TrainedModel,
    samples: &Samples,
    season: usize,
    test: &[usize],
    said: Vec<f64>,
    progress: &dyn Progress,
) -> Result<PerModel<Vec<Outcome>>, TransferError> {
    let training = samples.rows_of(|s| s != season);
    let part = Part::new(samples, &training);
    let of_model = Probabilities { out_of_fold: Vec::new(), test: said };
    let probabilities = part.probabilities(of_model, test, progress)?;
    let mut threshold = PerModel { svm: model.threshold, ..PerModel::default() };
    for (place, p) in [
        (&mut threshold.climatology, &probabilities.climatology),
        (&mut threshold.persistence, &probabilities.persistence),
        (&mut threshold.knn10, &probabilities.knn10),
        (&mut threshold.knn30, &probabilities.knn30),
        (&mut threshold.logistic, &probabilities.logistic),
    ] {
        *place = model.threshold_rule.choose(&p.out_of_fold, part.event()).ok_or(TrainingError::NoThreshold)?;
    }
    let (event, reference) = (events(samples, test), &probabilities.climatology.test);
    Ok(probabilities.zip_with(&threshold, |p, &threshold| outcomes(&p.test, threshold, &event, reference)))
}

fn report(
    model: &TrainedModel,
    target: Target<'_>,
    samples: &Samples,
    spoken: Vec<Spoken>,
    judged: &[PerModel<Vec<Outcome>>],
    seed: u64,
) -> Transfer {
    let cost_loss = model.threshold_rule.cost_loss();
    let scores = |of: &PerModel<Vec<Outcome>>| of.map(|o| (!o.is_empty()).then(|| Scores::of(o, cost_loss)));
    let mut pooled = PerModel::<Vec<Outcome>>::default();
    judged.iter().for_each(|season| pooled.append(season.clone()));
    let probability: Vec<f64> = spoken.iter().map(|day| day.probability).collect();
    let reliability = bins(&probability, &samples.event, RELIABILITY_BINS);
    let count = |events: &[bool]| events.iter().filter(|&&event| event).count();
    let season = |(at, of): (usize, &PerModel<Vec<Outcome>>)| TransferSeason {
        season: samples.seasons[at],
        days: of.svm.len(),
        events: of.svm.iter().filter(|outcome| outcome.event).count(),
        scores: scores(of),
    };
    let read = model.feature_set().map(|set| variables_read(&set)).unwrap_or_default();
    let not_reported: Vec<&Variable> = read.iter().filter(|variable| !target.reported.contains(variable)).collect();
    let (days, events) = (samples.len(), count(&samples.event));
    let issued: Vec<IssuedDay> = spoken
        .into_iter()
        .enumerate()
        .map(|(i, day)| IssuedDay {
            date: samples.date[i],
            event: samples.event[i],
            model: Said { probability: day.probability, warned: day.probability >= model.threshold },
            forecaster: None,
            training_base_rate: model.base_rate,
            imputed: day.imputed,
            out_of_range: day.out_of_range,
        })
        .collect();
    let mut drift = Drift::of(&issued);
    drift.warnings.extend(not_reported.iter().map(|variable| {
        format!("inputs: {} is not reported at the target; the training median stands in for it", variable.name())
    }));
    Transfer {
        days,
        events,
        base_rate: events as f64 / days as f64,
        first: samples.date.first().copied().unwrap_or_default(),
        last: samples.date.last().copied().unwrap_or_default(),
        left_out: left_out(target),
        threshold: model.threshold,
        scores: scores(&pooled),
        per_season: judged.iter().enumerate().map(season).collect(),
        brier_decomposition: decomposition(&probability, &samples.event, &reliability),
        reliability,
        roc: curve(&probability, &samples.event),
        bootstrap: (judged.len() > 1).then(|| bootstrap(samples.seasons.len(), &samples.season, &pooled, seed)),
        not_reported: not_reported.into_iter().map(|variable| variable.name().to_owned()).collect(),
        drift,
        seasons: samples.seasons.clone(),
    }
}

/// The seasons of the target that the model was trained on.
fn left_out(target: Target<'_>) -> Vec<i16> {
    let mut seasons: Vec<i16> = target.days.iter().map(|day| super::day::season_of(day.date)).collect();
    seasons.dedup();
    seasons.retain(|season| target.trained_on.contains(season));
    seasons
}

#[cfg(test)]
mod tests;
