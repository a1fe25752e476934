//! A data set of acoustic emission: hits or events of one test, with what is known about it.

use std::collections::BTreeMap;

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use utoipa::ToSchema;
use uuid::Uuid;

use super::station::StationName;
use crate::science::emission::{
    catalogue::{Catalogue, Column, Metadata, QualityFlag, quality},
    hits::{HitOptions, SensitivityPoint},
    location::events::{EventOptions, EventSummary},
};

/// The name of a data set: as that of a station.
pub type DatasetName = StationName;

/// What its owner says of a data set, and may change.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct DatasetBody {
    /// Name for humans, 1 to 200 characters.
    pub name: DatasetName,
    /// What is known about the test; what is left out is not known.
    #[serde(default)]
    pub metadata: Metadata,
}

/// What a data set was made from.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Source {
    /// The format of the file; `synthetic` for what a generator made.
    pub format: String,
    /// Bytes of the file.
    pub bytes: u64,
    /// SHA-256 (hex) of the file.
    pub sha256: String,
}

/// A column in a few numbers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ColumnStatistics {
    /// Canonical name of the column.
    pub column: Column,
    /// Unit of its values; `1` is a pure number.
    pub unit: String,
    /// Values that are there.
    pub values: usize,
    /// Values that are missing.
    pub missing: usize,
    /// Smallest value; null where all are missing.
    pub min: Option<f64>,
    /// A quarter of the values are at most this.
    pub lower_quartile: Option<f64>,
    /// Half of the values are at most this.
    pub median: Option<f64>,
    /// Three quarters of the values are at most this.
    pub upper_quartile: Option<f64>,
    /// Largest value.
    pub max: Option<f64>,
    /// Mean value.
    pub mean: Option<f64>,
}

/// What was seen when a data set was taken in; it never changes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Description {
    /// Hits or events.
    pub events: usize,
    /// The columns that are there.
    pub columns: Vec<ColumnStatistics>,
    /// What the reader of an exponent must know.
    pub quality: Vec<QualityFlag>,
    /// Columns of the file that were not read.
    pub ignored_columns: Vec<String>,
    /// What was done to read the file.
    pub notes: Vec<String>,
    /// What it was made from.
    pub source: Source,
    /// How its hits were found in waveforms; null where they came as hits.
    pub waveform: Option<WaveformOrigin>,
    /// How its events were located; null where they were not located here.
    #[serde(default)]
    pub location: Option<LocationOrigin>,
}

/// How the events of a data set were made of the hits of another one.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct LocationOrigin {
    /// The data set of the hits.
    pub parent: Uuid,
    /// The SHA-256 (hex) of its columns.
    pub parent_sha256: String,
    /// How hits were grouped and located.
    pub settings: EventOptions,
    /// What became of the hits.
    pub summary: EventSummary,
}

/// How hits were found in waveforms.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct WaveformOrigin {
    /// Stretches of waveform.
    pub waveforms: usize,
    /// Samples of all of them.
    pub samples: usize,
    /// Threshold and time constants.
    pub settings: HitOptions,
    /// How number, duration and exponent of the hits change with them: each of three thresholds, hit definition times and
    /// lock-out times with each.
    pub sensitivity: Vec<SensitivityPoint>,
}

/// A data set as the store keeps it; its columns lie apart.
#[derive(Clone, Debug, PartialEq)]
pub struct Dataset {
    /// Its id, a UUID version 7.
    pub id: Uuid,
    /// What its owner says of it.
    pub body: DatasetBody,
    /// What was seen when it was taken in.
    pub description: Description,
    /// What is true of it, where a generator made it.
    pub truth: Option<Value>,
    /// The job that made it.
    pub job: Option<Uuid>,
    /// SHA-256 (hex) of the file of its columns: where they lie.
    pub sha256: String,
    /// Bytes of the file of its columns.
    pub size: u64,
    /// Counts the changes, from 1.
    pub revision: u32,
    /// When it was made.
    pub created: Timestamp,
    /// By whom; none where no key was needed.
    pub created_by: Option<String>,
    /// When it last changed.
    pub updated: Timestamp,
}

impl Dataset {
    /// The unit of its amplitudes: `V` or `dB_AE`; none where it has no amplitudes.
    #[must_use]
    pub fn amplitude_unit(&self) -> Option<&'static str> {
        let columns = self.description.columns.iter().map(|statistics| statistics.column);
        columns.filter(|column| matches!(column, Column::AmplitudeV | Column::AmplitudeDb)).map(Column::unit).next()
    }
}

impl Description {
    /// What can be seen in a catalogue.
    #[must_use]
    pub fn of(catalogue: &Catalogue, ignored_columns: Vec<String>, notes: Vec<String>, source: Source) -> Self {
        Self {
            events: catalogue.len(),
            columns: catalogue.columns().map(|(column, values)| statistics(column, values)).collect(),
            quality: quality(catalogue),
            ignored_columns,
            notes,
            source,
            waveform: None,
            location: None,
        }
    }
}

fn statistics(column: Column, values: &[f64]) -> ColumnStatistics {
    let mut there: Vec<f64> = values.iter().copied().filter(|value| !value.is_nan()).collect();
    let mean = there.iter().sum::<f64>() / there.len() as f64;
    let mut at = |share: f64| -> Option<f64> {
        // the value with that share of the others below it
        let place = (share * there.len().saturating_sub(1) as f64).round() as usize;
        (place < there.len()).then(|| *there.select_nth_unstable_by(place, f64::total_cmp).1)
    };
    ColumnStatistics {
        column,
        unit: column.unit().to_owned(),
        min: at(0.0),
        lower_quartile: at(0.25),
        median: at(0.5),
        upper_quartile: at(0.75),
        max: at(1.0),
        mean: Some(mean).filter(|mean| mean.is_finite()),
        values: there.len(),
        missing: values.len() - there.len(),
    }
}

/// The columns of a data set.
pub type Columns = BTreeMap<Column, Vec<f64>>;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_column_is_told_in_a_few_numbers() {
        let told = statistics(Column::XM, &[5.0, f64::NAN, 1.0, 2.0, 4.0, 3.0]);
        assert_eq!((told.values, told.missing), (5, 1));
        let numbers = [told.min, told.lower_quartile, told.median, told.upper_quartile, told.max, told.mean];
        assert_eq!(numbers.map(Option::unwrap), [1.0, 2.0, 3.0, 4.0, 5.0, 3.0]);
        let none = statistics(Column::XM, &[f64::NAN]);
        assert_eq!((none.missing, none.median, none.mean), (1, None, None));
    }
}
