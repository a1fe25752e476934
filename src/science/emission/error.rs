//! What an analysis refuses, and why.

use thiserror::Error;

/// Why there is no result. Every variant names the column, option or quantity that is at fault.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum EmissionError {
    /// Fewer events than the computation can say anything about.
    #[error("{what}: {found} event(s), at least {needed} are needed")]
    TooFewEvents {
        /// What they are needed for.
        what: &'static str,
        /// Events that are usable.
        found: usize,
        /// Events needed.
        needed: usize,
    },
    /// A column that the analysis reads is not in the catalogue.
    #[error("column {column} is missing: {needed_by} needs it")]
    MissingColumn {
        /// Canonical name of the column.
        column: &'static str,
        /// Analysis that reads it.
        needed_by: &'static str,
    },
    /// Metadata that the analysis reads was not given.
    #[error("{item} is not known: {needed_by} needs it")]
    MissingMetadata {
        /// What is not known.
        item: &'static str,
        /// Analysis that reads it.
        needed_by: &'static str,
    },
    /// An option outside of what is accepted.
    #[error("{option} is {value}: {accepted} is accepted")]
    Option {
        /// Name of the option.
        option: &'static str,
        /// What was given.
        value: String,
        /// What is accepted.
        accepted: String,
    },
    /// A value of a column that cannot be.
    #[error("{column}, row {row}: {value} is refused, {accepted} is accepted")]
    Value {
        /// Canonical name of the column.
        column: &'static str,
        /// Row, counted from 1.
        row: usize,
        /// The value.
        value: f64,
        /// What is accepted.
        accepted: &'static str,
    },
    /// Columns of unequal length.
    #[error("column {column} has {found} rows, {expected} are expected")]
    Length {
        /// Canonical name of the column.
        column: &'static str,
        /// Its rows.
        found: usize,
        /// Rows of the catalogue.
        expected: usize,
    },
    /// Values that all agree where a spread is needed.
    #[error("{what}: all values are equal")]
    Degenerate {
        /// What has no spread.
        what: &'static str,
    },
    /// A likelihood or a least-squares problem without a maximum that could be found.
    #[error("{what}: no optimum was found")]
    NotConverged {
        /// What was fitted.
        what: &'static str,
    },
    /// The source is too close to the sensor for the far-field model.
    #[error(
        "the distance of {distance_m} m is below 3 times the length of the source, {length_m} m: the far-field model does not hold"
    )]
    NearField {
        /// Distance of source and sensor, m.
        distance_m: f64,
        /// Length of the moving dislocations, m.
        length_m: f64,
    },
    /// The caller no longer wants the result.
    #[error("cancelled")]
    Cancelled,
}

impl EmissionError {
    /// An [`EmissionError::Option`].
    pub(super) fn option(option: &'static str, value: impl ToString, accepted: impl ToString) -> Self {
        Self::Option { option, value: value.to_string(), accepted: accepted.to_string() }
    }
}

/// `value`, if it is finite and above 0.
///
/// # Errors
/// [`EmissionError::Option`] under the name `option`.
pub(super) fn positive(option: &'static str, value: f64) -> Result<f64, EmissionError> {
    if value.is_finite() && value > 0.0 {
        Ok(value)
    } else {
        Err(EmissionError::option(option, value, "a finite number above 0"))
    }
}
