//! A catalogue of hits or events in memory: canonical columns, metadata, quality flags.

mod metadata;
mod quality;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::error::EmissionError;
use super::sample::Sample;
use super::tails::{DecibelLevels, Rounding};

pub use metadata::{Metadata, Phase, Sensor, StressProtocol};
pub(super) use quality::too_few;
pub use quality::{FEW_EVENTS, FlagKind, QualityFlag, decibel_step, quality};

/// A canonical column.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum Column {
    /// Arrival time, s, not falling.
    TimeS,
    /// Peak amplitude as recorded, after the preamplifier, V.
    AmplitudeV,
    /// Peak amplitude in dB_AE, re 1 uV at the sensor.
    AmplitudeDb,
    /// Duration, us.
    DurationUs,
    /// Rise time, us.
    RiseTimeUs,
    /// Threshold crossings.
    Counts,
    /// Energy, eu = 1e-14 V2s.
    EnergyEu,
    /// Number of the channel.
    Channel,
    /// Detection threshold, dB_AE.
    ThresholdDb,
    /// Position, m; NaN where the event was not located.
    XM,
    /// Position, m; NaN where the event was not located.
    YM,
    /// Position, m; NaN where the event was not located.
    ZM,
    /// Strain at the time of the event, 1.
    Strain,
    /// Stress at the time of the event, MPa.
    StressMpa,
    /// 0 while loading, 1 while unloading.
    Phase,
    /// Standard error of a coordinate, m; NaN where the event was not located.
    XSeM,
    /// Standard error of a coordinate, m; NaN where the event was not located.
    YSeM,
    /// Standard error of a coordinate, m; NaN where the event was not located.
    ZSeM,
    /// Covariance of two coordinates, m2; NaN where the event was not located.
    XyCovM2,
    /// Covariance of two coordinates, m2; NaN where the event was not located.
    XzCovM2,
    /// Covariance of two coordinates, m2; NaN where the event was not located.
    YzCovM2,
    /// Root mean square of the residuals of the arrival times, us; NaN where the event was not located.
    ResidualUs,
    /// Channels that an event was recorded by.
    Channels,
}

impl Column {
    /// The name that files and problems use.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::TimeS => "time_s",
            Self::AmplitudeV => "amplitude_v",
            Self::AmplitudeDb => "amplitude_db",
            Self::DurationUs => "duration_us",
            Self::RiseTimeUs => "rise_time_us",
            Self::Counts => "counts",
            Self::EnergyEu => "energy_eu",
            Self::Channel => "channel",
            Self::ThresholdDb => "threshold_db",
            Self::XM => "x_m",
            Self::YM => "y_m",
            Self::ZM => "z_m",
            Self::Strain => "strain",
            Self::StressMpa => "stress_mpa",
            Self::Phase => "phase",
            Self::XSeM => "x_se_m",
            Self::YSeM => "y_se_m",
            Self::ZSeM => "z_se_m",
            Self::XyCovM2 => "xy_cov_m2",
            Self::XzCovM2 => "xz_cov_m2",
            Self::YzCovM2 => "yz_cov_m2",
            Self::ResidualUs => "residual_us",
            Self::Channels => "channels",
        }
    }

    /// All columns.
    pub const ALL: [Self; 23] = [
        Self::TimeS,
        Self::AmplitudeV,
        Self::AmplitudeDb,
        Self::DurationUs,
        Self::RiseTimeUs,
        Self::Counts,
        Self::EnergyEu,
        Self::Channel,
        Self::ThresholdDb,
        Self::XM,
        Self::YM,
        Self::ZM,
        Self::Strain,
        Self::StressMpa,
        Self::Phase,
        Self::XSeM,
        Self::YSeM,
        Self::ZSeM,
        Self::XyCovM2,
        Self::XzCovM2,
        Self::YzCovM2,
        Self::ResidualUs,
        Self::Channels,
    ];

    /// The unit of its values; `1` is a pure number.
    #[must_use]
    pub const fn unit(self) -> &'static str {
        match self {
            Self::TimeS => "s",
            Self::AmplitudeV => "V",
            Self::AmplitudeDb | Self::ThresholdDb => "dB_AE",
            Self::DurationUs | Self::RiseTimeUs | Self::ResidualUs => "us",
            Self::EnergyEu => "eu",
            Self::XM | Self::YM | Self::ZM | Self::XSeM | Self::YSeM | Self::ZSeM => "m",
            Self::XyCovM2 | Self::XzCovM2 | Self::YzCovM2 => "m2",
            Self::StressMpa => "MPa",
            Self::Counts | Self::Channel | Self::Channels | Self::Strain | Self::Phase => "1",
        }
    }

    /// The column of that [`Column::name`].
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|column| column.name() == name)
    }

    /// Whether a value may be missing (NaN): what is said of the place of an event that was not located.
    #[must_use]
    pub const fn may_be_missing(self) -> bool {
        matches!(
            self,
            Self::XM
                | Self::YM
                | Self::ZM
                | Self::XSeM
                | Self::YSeM
                | Self::ZSeM
                | Self::XyCovM2
                | Self::XzCovM2
                | Self::YzCovM2
                | Self::ResidualUs
        )
    }

    /// Whether it says where an event was.
    #[must_use]
    pub const fn is_of_place(self) -> bool {
        self.may_be_missing() || matches!(self, Self::Channels)
    }

    /// What is accepted in the column, in words and as a rule.
    #[must_use]
    pub fn accepts(self) -> (&'static str, fn(f64) -> bool) {
        match self {
            Self::AmplitudeV => ("a finite number above 0", |x| x.is_finite() && x > 0.0),
            Self::XM | Self::YM | Self::ZM | Self::XyCovM2 | Self::XzCovM2 | Self::YzCovM2 => {
                ("a finite number, or none", |x| !x.is_infinite())
            }
            Self::XSeM | Self::YSeM | Self::ZSeM | Self::ResidualUs => {
                ("a finite number of at least 0, or none", |x| x.is_nan() || (x.is_finite() && x >= 0.0))
            }
            Self::DurationUs | Self::RiseTimeUs | Self::Counts | Self::EnergyEu | Self::Channel | Self::Channels => {
                ("a finite number of at least 0", |x| x.is_finite() && x >= 0.0)
            }
            Self::Phase => ("0 (loading) or 1 (unloading)", |x| x == 0.0 || x == 1.0),
            _ => ("a finite number", f64::is_finite),
        }
    }
}

/// Hits or events, a row each.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Catalogue {
    rows: usize,
    columns: BTreeMap<Column, Vec<f64>>,
    /// What is known about the test.
    pub metadata: Metadata,
}

impl Catalogue {
    /// A catalogue of `columns`, all of one length.
    ///
    /// # Errors
    /// Columns of unequal length, a value that its column does not accept (with column and row), or times that fall.
    pub fn new(columns: BTreeMap<Column, Vec<f64>>, metadata: Metadata) -> Result<Self, EmissionError> {
        let rows = columns.values().next().map_or(0, Vec::len);
        for (column, values) in &columns {
            if values.len() != rows {
                return Err(EmissionError::Length { column: column.name(), found: values.len(), expected: rows });
            }
            let (accepted, accepts) = column.accepts();
            if let Some(row) = values.iter().position(|&x| !accepts(x)) {
                return Err(EmissionError::Value { column: column.name(), row: row + 1, value: values[row], accepted });
            }
        }
        if let Some(times) = columns.get(&Column::TimeS)
            && let Some(row) = times.windows(2).position(|pair| pair[1] < pair[0])
        {
            let (column, accepted) = (Column::TimeS.name(), "a time not before the row above");
            return Err(EmissionError::Value { column, row: row + 2, value: times[row + 1], accepted });
        }
        metadata.check()?;
        Ok(Self { rows, columns, metadata })
    }

    /// Rows.
    #[must_use]
    pub fn len(&self) -> usize {
        self.rows
    }

    /// Whether there is no row.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.rows == 0
    }

    /// The values of `column`, if it is there.
    #[must_use]
    pub fn column(&self, column: Column) -> Option<&[f64]> {
        self.columns.get(&column).map(Vec::as_slice)
    }

    /// The columns alone.
    #[must_use]
    pub fn into_columns(self) -> BTreeMap<Column, Vec<f64>> {
        self.columns
    }

    /// The columns that are there.
    pub fn columns(&self) -> impl Iterator<Item = (Column, &[f64])> {
        self.columns.iter().map(|(&column, values)| (column, values.as_slice()))
    }

    /// The values of `column`.
    ///
    /// # Errors
    /// [`EmissionError::MissingColumn`] in the name of `needed_by`.
    pub fn require(&self, column: Column, needed_by: &'static str) -> Result<&[f64], EmissionError> {
        self.column(column).ok_or(EmissionError::MissingColumn { column: column.name(), needed_by })
    }

    /// Amplitude of 0 dB_AE after the preamplifier, V.
    #[must_use]
    pub fn volts_at_0_db(&self) -> f64 {
        1e-6 * 10f64.powf(self.metadata.preamp_gain_db.unwrap_or(0.0) / 20.0)
    }

    /// Peak amplitudes in V after the preamplifier, of `amplitude_v` or else of `amplitude_db` and the gain.
    ///
    /// # Errors
    /// Neither column is there.
    pub fn amplitudes_v(&self, needed_by: &'static str) -> Result<Vec<f64>, EmissionError> {
        if let Some(volts) = self.column(Column::AmplitudeV) {
            return Ok(volts.to_vec());
        }
        let missing = EmissionError::MissingColumn { column: "amplitude_v or amplitude_db", needed_by };
        let decibels = self.column(Column::AmplitudeDb).ok_or(missing)?;
        let unit = self.volts_at_0_db();
        Ok(decibels.iter().map(|db| unit * 10f64.powf(db / 20.0)).collect())
    }

    /// Peak amplitudes in V as the estimators want them: in bins where only whole steps of decibels were recorded.
    ///
    /// `db_step` says the step (dB) where it is known; else it is found out from the values.
    ///
    /// # Errors
    /// Neither column of amplitudes is there, or the step is not positive.
    pub fn amplitude_sample(
        &self,
        db_step: Option<f64>,
        rounding: Rounding,
        needed_by: &'static str,
    ) -> Result<Sample, EmissionError> {
        let decibels = match (self.column(Column::AmplitudeV), self.column(Column::AmplitudeDb)) {
            (None, Some(decibels)) => decibels,
            _ => return Sample::exact(self.amplitudes_v(needed_by)?, Column::AmplitudeV.name()),
        };
        match db_step.or_else(|| decibel_step(decibels)) {
            Some(step) => Ok(Sample::Rounded(DecibelLevels::new(decibels, step, self.volts_at_0_db(), rounding)?)),
            None => Sample::exact(self.amplitudes_v(needed_by)?, Column::AmplitudeDb.name()),
        }
    }

    /// Located events as `[x, y, z]`, m, with their rows.
    ///
    /// # Errors
    /// A column of coordinates is not there.
    pub fn positions(&self, needed_by: &'static str) -> Result<(Vec<[f64; 3]>, Vec<usize>), EmissionError> {
        let x = self.require(Column::XM, needed_by)?;
        let y = self.require(Column::YM, needed_by)?;
        let z = self.require(Column::ZM, needed_by)?;
        let rows: Vec<usize> = (0..self.rows).filter(|&i| [x[i], y[i], z[i]].iter().all(|c| c.is_finite())).collect();
        Ok((rows.iter().map(|&i| [x[i], y[i], z[i]]).collect(), rows))
    }

    /// The rows for which `keep` says so, with the same metadata.
    #[must_use]
    pub fn filtered(&self, keep: impl Fn(usize) -> bool) -> Self {
        let rows: Vec<usize> = (0..self.rows).filter(|&row| keep(row)).collect();
        let pick = |values: &Vec<f64>| rows.iter().map(|&row| values[row]).collect();
        let columns = self.columns.iter().map(|(&column, values)| (column, pick(values))).collect();
        Self { rows: rows.len(), columns, metadata: self.metadata.clone() }
    }
}
