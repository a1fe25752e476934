//! A trained model: what it stores, what it says of a day, and why.

use jiff::civil::Date;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::forecast::day::{DayRecord, Label, Variable};
use crate::forecast::evaluation::{before, is_recorded, variables_read};
use crate::forecast::features::{FeatureSet, FeatureSetId, History, HistoryError};
use crate::forecast::preparation::{Preparation, PreparedRow};
use crate::forecast::svm::{Machine, Platt};
use crate::forecast::verification::ThresholdRule;

/// A model that forecasts; stored once, never changed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TrainedModel {
    /// Which days are avalanche days.
    pub label: Label,
    /// Days from the base day to the day that is forecast.
    pub lead: u8,
    /// Features that it reads.
    pub feature_set: FeatureSetId,
    /// Version of their formulas.
    pub feature_set_version: u32,
    /// Variables that the station reports.
    pub reported: Vec<Variable>,
    /// Names of the features, in the order of the columns.
    pub features: Vec<String>,
    /// Medians and scales of the features.
    pub preparation: Preparation,
    /// The fitted machine.
    pub machine: Machine,
    /// Target day and label of each support vector of [`Self::machine`], in their order.
    pub support: Vec<SupportDay>,
    /// From decision value to probability.
    pub platt: Platt,
    /// An avalanche day is forecast where the probability is at least this.
    pub threshold: f64,
    /// How it was chosen.
    pub threshold_rule: ThresholdRule,
    /// Chosen cost, before class weights.
    pub c: f64,
    /// Chosen inverse squared width; `None` for a linear kernel.
    pub gamma: Option<f64>,
    /// Mean AUC over the inner season folds at that choice; it is flattered by the choice: see the evaluation.
    pub cross_validated_auc: f64,
    /// The days it was fitted to.
    pub training: TrainingWindow,
    /// Share of avalanche days in training.
    pub base_rate: f64,
    /// Seed of the training run.
    pub seed: u64,
}

/// The days that a model was fitted to.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TrainingWindow {
    /// First day.
    pub first: Date,
    /// Last day.
    pub last: Date,
    /// Number of days; of several stations a day counts once.
    pub days: usize,
    /// Avalanche days among them.
    pub events: usize,
    /// Rows that it was fitted to: days of stations. 0 in a model of an earlier version, which had one station.
    #[serde(default)]
    pub station_days: usize,
    /// Years in which the seasons begin.
    pub seasons: Vec<i16>,
}

/// A training day that became a support vector.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SupportDay {
    /// The day whose label it is: the base day plus the lead.
    pub date: Date,
    /// Whether it was an avalanche day.
    pub label: bool,
    /// Position of its station among those that were pooled; 0 where there is one.
    #[serde(default)]
    pub station: usize,
}

/// What is forecast.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Category {
    /// The probability reached the threshold.
    AvalancheDay,
    /// It did not.
    NoAvalancheDay,
}

/// A forecast of one day.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Forecast {
    /// Probability of an avalanche day, 0 to 1.
    pub probability: f64,
    /// What is forecast at the threshold.
    pub category: Category,
    /// Threshold of the probability.
    pub threshold: f64,
    /// Decision value of the machine, above 0 on the side of avalanche days of the class-weighted machine.
    pub decision_value: f64,
    /// Days from the base day to the day that is forecast.
    pub lead: u8,
    /// The day that is forecast.
    pub date: Date,
    /// The newest day whose weather was read.
    pub base_date: Date,
    /// What the inputs lacked.
    pub inputs: InputQuality,
}

/// What the inputs of a forecast lacked.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct InputQuality {
    /// Variables that the features read and that are absent on the base day.
    pub missing: Vec<String>,
    /// Features that could not be computed and took their training median.
    pub imputed: Vec<String>,
    /// Features outside of their range in training: the machine extrapolates.
    pub out_of_range: Vec<String>,
    /// Variables of the day itself that were taken from a weather forecast and not observed.
    #[serde(default)]
    pub forecast_weather: Vec<String>,
}

/// A support vector and what it says.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct SimilarDay {
    /// The past day, as [`SupportDay::date`].
    pub date: Date,
    /// Whether it was an avalanche day.
    pub label: bool,
    /// Kernel value `k`: for a Gaussian kernel 1 for the same day, towards 0 for unlike ones.
    pub kernel: f64,
    /// `alpha y k`: what it adds to the decision value, above 0 where it speaks for an avalanche day.
    pub contribution: f64,
    /// Position of its station among those that the model was trained on; 0 where there is one.
    #[serde(skip)]
    pub station: usize,
}

/// Why there is no forecast.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum ForecastError {
    /// The days are not in order.
    #[error("{0}; days must be in rising order of date, each once")]
    Unordered(#[from] HistoryError),
    /// Nothing to forecast from.
    #[error("{date} has no observation of a variable that the model reads: one is needed for this forecast")]
    NoObservation {
        /// The base day.
        date: Date,
    },
    /// The date has no base day in the calendar.
    #[error("there is no day {lead} day(s) before {date}")]
    NoBaseDay {
        /// The day to forecast.
        date: Date,
        /// The lead of the model.
        lead: u8,
    },
    /// The formulas of the features have changed since the model was trained.
    #[error("the model reads version {stored} of its feature set, and this is version {current}: train it again")]
    FeatureSetChanged {
        /// Version of the model.
        stored: u32,
        /// Version that can be computed.
        current: u32,
    },
    /// Stored parts of the model that do not fit together.
    #[error("the stored model is damaged: its parts do not fit together")]
    Damaged,
}

/// A target day as the machine sees it.
pub(super) struct Input {
    base_date: Date,
    /// The features of the model.
    pub(super) set: FeatureSet,
    /// Their values in their units; NaN is missing.
    pub(super) raw: Vec<f64>,
    pub(super) row: PreparedRow,
    missing: Vec<String>,
}

impl TrainedModel {
    /// Forecasts `date` from `history` (rising dates, gaps allowed), of which no day after `date - lead` is read.
    ///
    /// Missing values take their training median, and the forecast says which.
    ///
    /// # Errors
    /// [`ForecastError`], above all [`ForecastError::NoObservation`].
    pub fn forecast(&self, history: &[DayRecord], date: Date) -> Result<Forecast, ForecastError> {
        let Input { base_date, row, missing, .. } = self.input(history, date)?;
        let decision_value = self.machine.decision_value(&row.values);
        let probability = self.platt.probability(decision_value);
        if !probability.is_finite() {
            return Err(ForecastError::Damaged);
        }
        let reached = probability >= self.threshold;
        Ok(Forecast {
            probability,
            category: if reached { Category::AvalancheDay } else { Category::NoAvalancheDay },
            threshold: self.threshold,
            decision_value,
            lead: self.lead,
            date,
            base_date,
            inputs: InputQuality {
                missing,
                imputed: self.names(row.imputed.into_iter().filter(|&j| self.preparation.columns()[j].used)),
                out_of_range: self.names(row.out_of_range.into_iter()),
                forecast_weather: Vec::new(),
            },
        })
    }

    /// The `count` training days that are most similar to `date` in the eyes of the machine, most similar first.
    ///
    /// Only support vectors are remembered: days far on the right side of the margin are not among them.
    ///
    /// # Errors
    /// As [`TrainedModel::forecast`].
    pub fn similar_days(
        &self,
        history: &[DayRecord],
        date: Date,
        count: usize,
    ) -> Result<Vec<SimilarDay>, ForecastError> {
        let input = self.input(history, date)?;
        let kernel = self.machine.kernel_values(&input.row.values);
        let support = self.support.iter().zip(&self.machine.coefficient).zip(kernel);
        let mut similar: Vec<SimilarDay> = support
            .map(|((day, coefficient), kernel)| SimilarDay {
                date: day.date,
                label: day.label,
                kernel,
                contribution: coefficient * kernel,
                station: day.station,
            })
            .collect();
        similar.sort_by(|a, b| b.kernel.total_cmp(&a.kernel).then(a.date.cmp(&b.date)).then(a.station.cmp(&b.station)));
        similar.truncate(count);
        Ok(similar)
    }

    /// The newest day that a forecast of `date` may read.
    ///
    /// # Errors
    /// [`ForecastError::NoBaseDay`].
    pub fn base_date(&self, date: Date) -> Result<Date, ForecastError> {
        before(date, i32::from(self.lead)).ok_or(ForecastError::NoBaseDay { date, lead: self.lead })
    }

    pub(super) fn input(&self, history: &[DayRecord], date: Date) -> Result<Input, ForecastError> {
        let history = History::new(history)?;
        let set = self.feature_set()?;
        let base_date = self.base_date(date)?;
        let read = variables_read(&set);
        let base = history
            .day(base_date)
            .filter(|day| is_recorded(day, &read))
            .ok_or(ForecastError::NoObservation { date: base_date })?;
        let absent = read.iter().filter(|&&v| base.value(v).is_none());
        let raw = set.compute(&history, base_date);
        Ok(Input {
            base_date,
            row: self.preparation.transform_row(&raw),
            raw,
            missing: absent.map(|v| v.name().to_owned()).collect(),
            set,
        })
    }

    /// The features as they are computed today, which must be those of the training.
    pub(crate) fn feature_set(&self) -> Result<FeatureSet, ForecastError> {
        let all = FeatureSet::new(self.feature_set, &self.reported);
        if all.version != self.feature_set_version {
            return Err(ForecastError::FeatureSetChanged { stored: self.feature_set_version, current: all.version });
        }
        let set = all.only(&self.features).map_err(|_| ForecastError::Damaged)?;
        let fits = set.names() == self.features
            && self.preparation.columns().len() == self.features.len()
            && self.machine.support.iter().all(|row| row.len() == self.features.len())
            && self.machine.support.len() == self.support.len()
            && self.machine.support.len() == self.machine.coefficient.len();
        if fits { Ok(set) } else { Err(ForecastError::Damaged) }
    }

    fn names(&self, columns: impl Iterator<Item = usize>) -> Vec<String> {
        columns.filter_map(|j| self.features.get(j)).cloned().collect()
    }
}
