//! What a model would say if a day were otherwise, and how its answer follows one variable.

use jiff::civil::Date;
use serde::{Deserialize, Serialize};

use super::forecast::{ForecastError, TrainedModel};
use crate::forecast::day::{Activity, DayRecord, Variable};

/// What is different on one day.
#[derive(Clone, Debug, PartialEq)]
pub struct Change {
    /// The day; one that is not recorded is made.
    pub date: Date,
    /// Variables with their new value in their unit, `None` for missing; the others stay.
    pub values: Vec<(Variable, Option<f64>)>,
    /// Avalanche activity; `None` leaves it. That of the base day is never read.
    pub activity: Option<Activity>,
}

/// The answer of a model at one value of a variable.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct ResponsePoint {
    /// The value, in the unit of the variable.
    pub value: f64,
    /// Probability of an avalanche day.
    pub probability: f64,
    /// Decision value of the machine.
    pub decision_value: f64,
    /// True where a feature leaves its range in training: the machine extrapolates.
    pub extrapolates: bool,
}

/// The days with the changes made, in order of date.
#[must_use]
pub fn changed(history: &[DayRecord], changes: &[Change]) -> Vec<DayRecord> {
    let mut days = history.to_vec();
    for change in changes {
        let at = days.binary_search_by_key(&change.date, |day| day.date).unwrap_or_else(|at| {
            days.insert(at, DayRecord::empty(change.date));
            at
        });
        for &(variable, value) in &change.values {
            days[at].values[variable.index()] = value;
        }
        if let Some(activity) = change.activity {
            days[at].activity = activity;
        }
    }
    days
}

impl TrainedModel {
    /// The forecast of `date` at each of `values` of `variable` on the base day, all else as in `history`.
    ///
    /// # Errors
    /// As [`TrainedModel::forecast`].
    pub fn response(
        &self,
        history: &[DayRecord],
        date: Date,
        variable: Variable,
        values: &[f64],
    ) -> Result<Vec<ResponsePoint>, ForecastError> {
        let base = self.base_date(date)?;
        let change = |value| Change { date: base, values: vec![(variable, value)], activity: None };
        let mut days = changed(history, &[change(None)]);
        let at = days.partition_point(|day| day.date < base);
        let point = |&value: &f64| {
            days[at].values[variable.index()] = Some(value);
            let forecast = self.forecast(&days, date)?;
            Ok(ResponsePoint {
                value,
                probability: forecast.probability,
                decision_value: forecast.decision_value,
                extrapolates: !forecast.inputs.out_of_range.is_empty(),
            })
        };
        values.iter().map(point).collect()
    }

    /// The values of `variable` on the base day that training knew, smallest and largest; `None` where no feature is its value.
    #[must_use]
    pub fn training_range(&self, variable: Variable) -> Option<(f64, f64)> {
        let name = format!("{}_t", variable.name());
        let column = self.features.iter().position(|feature| *feature == name)?;
        self.preparation.columns().get(column)?.range
    }
}
