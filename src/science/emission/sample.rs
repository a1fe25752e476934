//! A whole sample: what a tail is cut from.

use super::error::EmissionError;
use super::tails::{DecibelLevels, Tail};

/// Positive values, exact or in whole steps of decibels.
#[derive(Clone, Debug, PartialEq)]
pub enum Sample {
    /// Rising values, any unit.
    Exact(Vec<f64>),
    /// Rounded decibels.
    Rounded(DecibelLevels),
}

impl Sample {
    /// A sample of `values` in any order.
    ///
    /// # Errors
    /// A value that is not finite and above 0, under the name `column`.
    pub fn exact(mut values: Vec<f64>, column: &'static str) -> Result<Self, EmissionError> {
        if let Some(row) = values.iter().position(|x| !(x.is_finite() && *x > 0.0)) {
            let accepted = "a finite number above 0";
            return Err(EmissionError::Value { column, row: row + 1, value: values[row], accepted });
        }
        values.sort_unstable_by(f64::total_cmp);
        Ok(Self::Exact(values))
    }

    /// Events.
    #[must_use]
    pub fn len(&self) -> usize {
        match self {
            Self::Exact(values) => values.len(),
            Self::Rounded(levels) => levels.levels.len(),
        }
    }

    /// Whether there are no events.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The events from `xmin` (the smallest, where it is not given) to `xmax`.
    ///
    /// # Errors
    /// As [`Tail::exact`].
    pub fn tail(&self, xmin: Option<f64>, xmax: Option<f64>) -> Result<Tail, EmissionError> {
        match self {
            Self::Exact(values) => {
                let smallest = values.first().copied().unwrap_or(1.0);
                Tail::exact(values, xmin.unwrap_or(smallest), xmax)
            }
            Self::Rounded(levels) => Tail::rounded(levels, xmin, xmax),
        }
    }
}
