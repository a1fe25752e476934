//! Verification of forecasts that were issued: the model, the forecaster and the models that cost nothing, side by side, and signs
//! that the model and the world drift apart.

use std::collections::BTreeMap;

use jiff::civil::Date;
use serde::{Deserialize, Serialize};

use super::baselines::{Climatology, Persistence};
use super::day::{DayRecord, Label, day_of_season, season_of};
use super::evaluation::{Intervals, LEVEL, RELIABILITY_BINS, REPLICATES};
use super::verification::bootstrap::{Interval, SeasonDraws, interval, replicate};
use super::verification::brier::{Decomposition, decomposition};
use super::verification::reliability::{ReliabilityBin, bins};
use super::verification::roc::{RocPoint, curve};
use super::verification::{Contingency, Outcome, Scores};

/// A forecast that was issued, and what is known of its day now.
#[derive(Clone, Debug, PartialEq)]
pub struct IssuedDay {
    /// The day that was forecast.
    pub date: Date,
    /// Whether it was an avalanche day.
    pub event: bool,
    /// Probability that the model gave, and whether it reached the threshold in force.
    pub model: Said,
    /// What the forecaster said, if anything.
    pub forecaster: Option<Said>,
    /// Base rate of the training of the model that spoke.
    pub training_base_rate: f64,
    /// Features that were imputed.
    pub imputed: Vec<String>,
    /// Features outside of their range in training.
    pub out_of_range: Vec<String>,
}

/// A probability and a yes or no.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Said {
    /// Probability of an avalanche day, 0 to 1.
    pub probability: f64,
    /// Whether one was forecast.
    pub warned: bool,
}

/// How issued forecasts did.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Verification {
    /// Days that were forecast and whose avalanche activity is known.
    pub days: usize,
    /// Avalanche days among them.
    pub events: usize,
    /// Seasons among them, by the year in which they begin.
    pub seasons: Vec<i16>,
    /// The model.
    pub model: Side,
    /// The forecaster, on the days with a call of their own; null without any. A call without a probability counts as 0 or 1.
    pub forecaster: Option<Side>,
    /// The model on the days with a call of the forecaster: compare these two. Null without any.
    pub model_on_called_days: Option<Side>,
    /// How often an avalanche day followed one, and a quiet day, until then; warns after an avalanche day.
    pub persistence: Side,
    /// Base rate of the time of year until then; warns where that is above the base rate of all days.
    pub climatology: Side,
    /// Reliability of the model.
    pub reliability: Vec<ReliabilityBin>,
    /// Parts of the Brier score of the model over those bins.
    pub brier_decomposition: Option<Decomposition>,
    /// ROC curve of the model.
    pub roc: Vec<RocPoint>,
    /// Economic value against the cost/loss ratio.
    pub cost_loss: Vec<CostLossPoint>,
    /// Signs that the model no longer fits.
    pub drift: Drift,
}

/// How one of them did.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Side {
    /// Days.
    pub days: usize,
    /// Avalanche days among them.
    pub events: usize,
    /// The scores; the reference of the Brier skill is the climatology until then.
    pub scores: Scores,
    /// Intervals of the bootstrap over seasons, 95 %; null with one season.
    pub intervals: Option<Intervals>,
}

/// Relative economic value to a user of that cost/loss ratio: 1 for perfect forecasts, 0 for the better of always and never
/// protecting, below 0 for worse (Richardson 2000, Q. J. R. Meteorol. Soc. 126, 649-667, eq. 8). The user protects where
/// the probability is at least the ratio.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct CostLossPoint {
    /// Cost of protecting over the loss that it saves.
    pub ratio: f64,
    /// Value of the model.
    pub model: Option<f64>,
    /// Value of the forecaster's calls on their days.
    pub forecaster: Option<f64>,
    /// Value of persistence.
    pub persistence: Option<f64>,
    /// Value of climatology.
    pub climatology: Option<f64>,
}

/// Signs that the model and the world drift apart. The tests take days as independent, which days of one winter are not: a
/// warning is a reason to look, not a proof.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Drift {
    /// Observed share of avalanche days.
    pub base_rate: Option<f64>,
    /// Share in the training of the models that spoke.
    pub training_base_rate: Option<f64>,
    /// Deviation of the observed number from that share, in standard deviations.
    pub base_rate_z: Option<f64>,
    /// Mean probability of the model.
    pub mean_probability: Option<f64>,
    /// Calibration: the statistic of Spiegelhalter (1986, Stat. Med. 5, 421-433), standard normal for a calibrated model.
    pub calibration_z: Option<f64>,
    /// Features that left their range in training or had to be imputed, and on what share of the days.
    pub inputs: Vec<InputDrift>,
    /// What is worth a look, in words; empty where nothing is.
    pub warnings: Vec<String>,
}

/// How often a feature was not what the model was trained on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct InputDrift {
    /// Name of the feature.
    pub feature: String,
    /// Share of the days on which it was outside of its range in training.
    pub out_of_range: f64,
    /// Share of the days on which it was imputed.
    pub imputed: f64,
}

/// Deviations from here on are worth a warning, in standard deviations.
const NOTABLE_Z: f64 = 2.0;
/// Share of days out of range from which on a feature is worth a warning.
const NOTABLE_OUT_OF_RANGE: f64 = 0.05;
/// Share of imputed days from which on a feature is worth a warning.
const NOTABLE_IMPUTED: f64 = 0.2;

/// Verifies `issued` (rising dates) against each other. `history` has the days of the station (rising dates): the models that
/// cost nothing know, for each forecast, the activity of the days before it. `seed` is that of the bootstrap.
#[must_use]
pub fn verify(
    issued: &[IssuedDay],
    history: &[DayRecord],
    label: Label,
    cost_loss: Option<f64>,
    seed: u64,
) -> Verification {
    let free: Vec<Free> = issued.iter().map(|day| Free::until(history, label, day.date)).collect();
    let outcomes = |said: &dyn Fn(usize) -> Option<Said>| -> Vec<(usize, Outcome)> {
        let days = issued.iter().zip(&free).enumerate();
        days.filter_map(|(i, (day, free))| {
            let said = said(i)?;
            let outcome = Outcome {
                probability: said.probability,
                warned: said.warned,
                event: day.event,
                reference: free.climatology.probability,
            };
            Some((i, outcome))
        })
        .collect()
    };
    let model = outcomes(&|i| Some(issued[i].model));
    let called = outcomes(&|i| issued[i].forecaster);
    let model_called = outcomes(&|i| issued[i].forecaster.map(|_| issued[i].model));
    let persistence = outcomes(&|i| Some(free[i].persistence));
    let climatology = outcomes(&|i| Some(free[i].climatology));
    let mut seasons: Vec<i16> = issued.iter().map(|day| season_of(day.date)).collect();
    seasons.dedup();
    let season = |i: usize| seasons.partition_point(|&s| s < season_of(issued[i].date));
    let side = |outcomes: &[(usize, Outcome)]| Side::of(outcomes, &season, seasons.len(), cost_loss, seed);
    let (probability, event): (Vec<f64>, Vec<bool>) =
        issued.iter().map(|day| (day.model.probability, day.event)).unzip();
    let reliability = bins(&probability, &event, RELIABILITY_BINS);
    Verification {
        days: issued.len(),
        events: event.iter().filter(|&&event| event).count(),
        model: side(&model),
        forecaster: (!called.is_empty()).then(|| side(&called)),
        model_on_called_days: (!called.is_empty()).then(|| side(&model_called)),
        persistence: side(&persistence),
        climatology: side(&climatology),
        brier_decomposition: decomposition(&probability, &event, &reliability),
        reliability,
        roc: curve(&probability, &event),
        cost_loss: (1..20)
            .map(|twentieths| {
                let ratio = f64::from(twentieths) / 20.0;
                CostLossPoint {
                    ratio,
                    model: economic_value(&model, ratio),
                    forecaster: economic_value(&called, ratio),
                    persistence: economic_value(&persistence, ratio),
                    climatology: economic_value(&climatology, ratio),
                }
            })
            .collect(),
        drift: Drift::of(issued),
        seasons,
    }
}

/// What the models that cost nothing say of a day.
struct Free {
    climatology: Said,
    persistence: Said,
}

impl Free {
    /// From the days before `date` alone.
    fn until(history: &[DayRecord], label: Label, date: Date) -> Self {
        let before = &history[..history.partition_point(|day| day.date < date)];
        let known = || before.iter().filter_map(|day| Some((day.date, label.of(day.activity)?)));
        let event: Vec<bool> = known().map(|(_, event)| event).collect();
        let day: Vec<i16> = known().map(|(date, _)| day_of_season(date)).collect();
        let of = |date: Date| {
            let at = before.binary_search_by_key(&date, |day| day.date).ok()?;
            label.of(before[at].activity)
        };
        let yesterday: Vec<Option<bool>> = known().map(|(date, _)| of(date.yesterday().ok()?)).collect();
        let (climatology, persistence) = (Climatology::fit(&day, &event), Persistence::fit(&yesterday, &event));
        let last = date.yesterday().ok().and_then(of);
        let probability = climatology.probability(day_of_season(date));
        Self {
            climatology: Said { probability, warned: probability > persistence.base_rate },
            persistence: Said { probability: persistence.probability(last), warned: last == Some(true) },
        }
    }
}

impl Side {
    fn of(
        outcomes: &[(usize, Outcome)],
        season: &dyn Fn(usize) -> usize,
        seasons: usize,
        cost_loss: Option<f64>,
        seed: u64,
    ) -> Self {
        let of_day: Vec<usize> = outcomes.iter().map(|&(i, _)| season(i)).collect();
        let outcomes: Vec<Outcome> = outcomes.iter().map(|&(_, outcome)| outcome).collect();
        let intervals = (seasons > 1).then(|| {
            let replicates = replicate(&outcomes, &of_day, &SeasonDraws::new(seasons, REPLICATES, seed));
            let of = |values: &[Option<f64>]| -> Option<Interval> { interval(values, LEVEL) };
            Intervals { auc: of(&replicates.auc), pss: of(&replicates.pss), brier_skill: of(&replicates.brier_skill) }
        });
        Self {
            days: outcomes.len(),
            events: outcomes.iter().filter(|outcome| outcome.event).count(),
            scores: Scores::of(&outcomes, cost_loss),
            intervals,
        }
    }
}

/// See [`CostLossPoint`]; `None` without a day, or where no forecast could have any value.
fn economic_value(outcomes: &[(usize, Outcome)], ratio: f64) -> Option<f64> {
    let table = Contingency::of(outcomes.iter().map(|(_, outcome)| (outcome.probability >= ratio, outcome.event)));
    let expense = table.expected_cost(ratio)?;
    let rate = (table.a + table.c) as f64 / outcomes.len() as f64;
    let (without, perfect) = (ratio.min(rate), rate * ratio);
    finite_ratio(without - expense, without - perfect)
}

impl Drift {
    /// Of days whose outcome is known.
    pub(crate) fn of(issued: &[IssuedDay]) -> Self {
        let days = issued.len() as f64;
        let mean = |value: &dyn Fn(&IssuedDay) -> f64| finite_ratio(issued.iter().map(value).sum::<f64>(), days);
        let sum = |value: &dyn Fn(&IssuedDay) -> f64| issued.iter().map(value).sum::<f64>();
        let happened = |day: &IssuedDay| f64::from(u8::from(day.event));
        let base_rate_z = finite_ratio(
            sum(&|day| happened(day) - day.training_base_rate),
            sum(&|day| day.training_base_rate * (1.0 - day.training_base_rate)).sqrt(),
        );
        let tilt = |day: &IssuedDay| 1.0 - 2.0 * day.model.probability;
        let calibration_z = finite_ratio(
            sum(&|day| (happened(day) - day.model.probability) * tilt(day)),
            sum(&|day| tilt(day).powi(2) * day.model.probability * (1.0 - day.model.probability)).sqrt(),
        );
        let mut drift = Self {
            base_rate: mean(&happened),
            training_base_rate: mean(&|day| day.training_base_rate),
            base_rate_z,
            mean_probability: mean(&|day| day.model.probability),
            calibration_z,
            inputs: input_drift(issued),
            warnings: Vec::new(),
        };
        drift.warn();
        drift
    }

    fn warn(&mut self) {
        let percent = |share: Option<f64>| format!("{:.0} %", 100.0 * share.unwrap_or(0.0));
        let notable = |z: Option<f64>| z.filter(|z| z.abs() >= NOTABLE_Z);
        if let Some(z) = notable(self.base_rate_z) {
            let (seen, trained) = (percent(self.base_rate), percent(self.training_base_rate));
            self.warnings.push(format!(
                "base rate: {seen} of the days were avalanche days, {trained} in training ({z:+.1} standard deviations)"
            ));
        }
        if let Some(z) = notable(self.calibration_z) {
            let (said, seen) = (percent(self.mean_probability), percent(self.base_rate));
            self.warnings.push(format!("calibration: mean probability {said}, observed {seen} (z = {z:+.1})"));
        }
        for input in &self.inputs {
            if input.out_of_range >= NOTABLE_OUT_OF_RANGE {
                let share = percent(Some(input.out_of_range));
                self.warnings.push(format!(
                    "inputs: {} was outside of its range in training on {share} of the days",
                    input.feature
                ));
            }
            if input.imputed >= NOTABLE_IMPUTED {
                let share = percent(Some(input.imputed));
                self.warnings.push(format!("inputs: {} was imputed on {share} of the days", input.feature));
            }
        }
    }
}

/// Features that were ever out of range or imputed, in the order of their names.
fn input_drift(issued: &[IssuedDay]) -> Vec<InputDrift> {
    let mut counts: BTreeMap<&str, (u32, u32)> = BTreeMap::new();
    for day in issued {
        day.out_of_range.iter().for_each(|name| counts.entry(name).or_default().0 += 1);
        day.imputed.iter().for_each(|name| counts.entry(name).or_default().1 += 1);
    }
    let share = |count: u32| f64::from(count) / issued.len() as f64;
    let drift = |(feature, (out, imputed)): (&str, (u32, u32))| InputDrift {
        feature: feature.to_owned(),
        out_of_range: share(out),
        imputed: share(imputed),
    };
    counts.into_iter().map(drift).collect()
}

/// `numerator / denominator`, `None` where that is no finite number.
fn finite_ratio(numerator: f64, denominator: f64) -> Option<f64> {
    Some(numerator / denominator).filter(|ratio| ratio.is_finite())
}

#[cfg(test)]
mod tests;
