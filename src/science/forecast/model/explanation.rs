//! Why a model says what it says of a day: the decision value feature by feature, and what was imputed or extrapolated.

use jiff::civil::Date;
use serde::{Deserialize, Serialize};

use super::forecast::{ForecastError, Input, TrainedModel};
use crate::forecast::day::DayRecord;

/// How the decision value is taken apart.
pub const METHOD: &str = "integrated gradients along the straight way from the training mean of every feature to the day, in closed form: \
     base and contributions add up to the decision value exactly";

/// The decision value of a day, taken apart.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Explanation {
    /// How contributions are computed.
    pub method: String,
    /// Decision value of the machine, above 0 on the side of avalanche days of the class-weighted machine.
    pub decision_value: f64,
    /// Decision value of a day with every feature at its training mean.
    pub base: f64,
    /// What each feature adds to the base, the strongest first.
    pub contributions: Vec<FeatureContribution>,
    /// Features that could not be computed, and what took their place.
    pub imputed: Vec<Imputed>,
    /// Features outside of their range in training, where the machine extrapolates.
    pub out_of_range: Vec<OutOfRange>,
}

/// What a feature adds to a decision value.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct FeatureContribution {
    /// Name of the feature.
    pub feature: String,
    /// Its unit; `1` for an index, `bool` for 0 or 1.
    pub unit: String,
    /// Its value in that unit; null where it was missing and took its training median.
    pub value: Option<f64>,
    /// The value that was used, in standard deviations from the training mean.
    pub standardised: f64,
    /// What it adds to the decision value: above 0 where the feature speaks for an avalanche day.
    pub contribution: f64,
}

/// A feature that could not be computed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Imputed {
    /// Name of the feature.
    pub feature: String,
    /// Its unit.
    pub unit: String,
    /// The training median, which took its place.
    pub used: f64,
    /// The variables that it is computed from; it lacks one of them on one of the days that it reads.
    pub inputs: Vec<String>,
}

/// A feature outside of its range in training.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct OutOfRange {
    /// Name of the feature.
    pub feature: String,
    /// Its unit.
    pub unit: String,
    /// Its value.
    pub value: f64,
    /// Smallest value in training; null where it was never known.
    pub least: Option<f64>,
    /// Largest value in training; null where it was never known.
    pub most: Option<f64>,
}

impl TrainedModel {
    /// Takes the decision value of `date` apart; see [`TrainedModel::forecast`] for `history`.
    ///
    /// # Errors
    /// As [`TrainedModel::forecast`].
    pub fn explain(&self, history: &[DayRecord], date: Date) -> Result<Explanation, ForecastError> {
        let Input { raw, row, set, .. } = self.input(history, date)?;
        let attribution = self.machine.attribution(&row.values);
        let unit = |j: usize| set.features[j].unit.to_owned();
        let columns = self.preparation.columns();
        let contribution = |(j, &contribution): (usize, &f64)| FeatureContribution {
            feature: self.features[j].clone(),
            unit: unit(j),
            value: Some(raw[j]).filter(|value| value.is_finite()),
            standardised: row.values[j],
            contribution,
        };
        let mut contributions: Vec<FeatureContribution> =
            attribution.contributions.iter().enumerate().map(contribution).collect();
        contributions.sort_by(|a, b| b.contribution.abs().total_cmp(&a.contribution.abs()));
        let imputed = row.imputed.iter().filter(|&&j| columns[j].used).map(|&j| Imputed {
            feature: self.features[j].clone(),
            unit: unit(j),
            used: columns[j].median,
            inputs: set.features[j].inputs.iter().map(|variable| variable.name().to_owned()).collect(),
        });
        let out_of_range = row.out_of_range.iter().map(|&j| OutOfRange {
            feature: self.features[j].clone(),
            unit: unit(j),
            value: raw[j],
            least: columns[j].range.map(|(least, _)| least),
            most: columns[j].range.map(|(_, most)| most),
        });
        Ok(Explanation {
            method: METHOD.to_owned(),
            decision_value: self.machine.decision_value(&row.values),
            base: attribution.base,
            imputed: imputed.collect(),
            out_of_range: out_of_range.collect(),
            contributions,
        })
    }
}
