//! Features: what a model reads of the days up to a base date `t`.
//!
//! * [`FeatureSetId::Raw30`]: each reported variable on `t`, `t-1`, `t-2`, except the cumulative snow index. The ten
//!   variables of the Scottish service give 30, hence the name; the direction of the wind enters in degrees.
//! * [`FeatureSetId::Expert`]: the raw set and what a forecaster derives from it: sums of new snow, warming, wind
//!   transport, rain on snow, past avalanches, day of season; 64 for those ten variables. A drift indicator is not
//!   added: `snow_drift_t` is one.
//!
//! Rules:
//! * Days are calendar days, and a day that is not recorded is missing. Missing is NaN.
//! * Nothing crosses the edge of a season ([`season_of`](super::day::season_of)); the days before it are missing.
//! * A sum, mean, maximum or change over days of which one is missing is missing. The season sum alone skips missing
//!   days. Days since snow is missing if a missing day comes before the snow.
//! * Avalanche activity is read on `t-1` to `t-5` and never on `t`. It is coded 1 observed, 0.5 presumed, 0 none, and
//!   unknown is missing: one column for both [`Label`](super::day::Label)s, as a day judged likely but unseen lies
//!   between the other two for either, and a stored row serves models of both.
//! * Where `new_snow_index` is not reported, `new_snow_24h` takes its place in the sums, else `precipitation_24h` at
//!   air temperatures up to 0 degC; above 0 degC that precipitation is the rain of a station without `rain_at_900m`.
//!
//! Features after Pozdnoukhov, Purves & Kanevski (2008, Ann. Glaciol. 49), who list the ten variables.

use std::fmt;
use std::str::FromStr;

use jiff::civil::Date;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::day::Variable;
use super::matrix::Matrix;

#[cfg(test)]
pub(crate) mod archive;
mod catalogue;
mod daily;
mod history;
#[cfg(test)]
mod tests;

use history::Window;
pub use history::{History, HistoryError};

/// Which list of features.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum FeatureSetId {
    /// The reported variables on `t`, `t-1`, `t-2`.
    #[serde(rename = "raw-30")]
    Raw30,
    /// The raw set and derived features.
    #[serde(rename = "expert")]
    Expert,
}

impl FeatureSetId {
    /// Every set.
    pub const ALL: [Self; 2] = [Self::Raw30, Self::Expert];

    /// The name in JSON and on the command line.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Raw30 => "raw-30",
            Self::Expert => "expert",
        }
    }

    /// Version of the list and of its formulas: it rises when either changes, and a model is bound to it.
    #[must_use]
    pub const fn version(self) -> u32 {
        match self {
            Self::Raw30 | Self::Expert => 1,
        }
    }
}

impl fmt::Display for FeatureSetId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// A name that no feature set has.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("no feature set is called `{0}`: there are `raw-30` and `expert`")]
pub struct UnknownFeatureSet(pub String);

/// A name that no feature of a set has, or that is there twice.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("`{name}` is no feature that the set {set} can compute from what the station reports, or it is named twice")]
pub struct UnknownFeature {
    /// The name.
    pub name: String,
    /// The set.
    pub set: FeatureSetId,
}

impl FromStr for FeatureSetId {
    type Err = UnknownFeatureSet;

    fn from_str(name: &str) -> Result<Self, Self::Err> {
        Self::ALL.into_iter().find(|id| id.name() == name).ok_or_else(|| UnknownFeatureSet(name.to_owned()))
    }
}

/// One column of the matrix that a model reads.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Feature {
    /// Stable snake_case name; `_t1` is the day before the base date.
    pub name: String,
    /// Unit; `1` for an index, `bool` for 0 or 1.
    pub unit: &'static str,
    /// How it is computed; `t` is the base date, `[...]` is 1 where it holds, else 0.
    pub formula: String,
    /// Lag in days of the newest day that it reads.
    pub lag_days: u8,
    /// The variables that it reads; empty for avalanche activity and day of season.
    pub inputs: Vec<Variable>,
    #[serde(skip)]
    kind: catalogue::Kind,
}

/// The features of one station.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FeatureSet {
    /// Which list.
    pub id: FeatureSetId,
    /// [`FeatureSetId::version`] of the list.
    pub version: u32,
    /// The variables that the station reports, in the order of [`Variable::ALL`]: with `id` they give the same set again.
    pub reported: Vec<Variable>,
    /// The features, in the order of the columns.
    pub features: Vec<Feature>,
}

impl FeatureSet {
    /// The features of `id` that can be computed from the variables in `reported`, whose order does not matter.
    ///
    /// No variable at all gives the raw set nothing and the expert set past activity and day of season.
    #[must_use]
    pub fn new(id: FeatureSetId, reported: &[Variable]) -> Self {
        let reported: Vec<_> = Variable::ALL.into_iter().filter(|v| reported.contains(v)).collect();
        let features = catalogue::features(id, &reported);
        Self { id, version: id.version(), reported, features }
    }

    /// The features of these names, in the order of the set, whatever that of `names`; the variables stay those of the station.
    ///
    /// # Errors
    /// [`UnknownFeature`]: a name that the set does not have, or one that is named twice.
    pub fn only(&self, names: &[String]) -> Result<Self, UnknownFeature> {
        for (at, name) in names.iter().enumerate() {
            if names[..at].contains(name) || !self.features.iter().any(|feature| feature.name == *name) {
                return Err(UnknownFeature { name: name.clone(), set: self.id });
            }
        }
        let features = self.features.iter().filter(|feature| names.contains(&feature.name)).cloned().collect();
        Ok(Self { features, reported: self.reported.clone(), ..*self })
    }

    /// Names in the order of the columns.
    #[must_use]
    pub fn names(&self) -> Vec<&str> {
        self.features.iter().map(|feature| feature.name.as_str()).collect()
    }

    /// Number of features, which is the number of columns.
    #[must_use]
    pub fn len(&self) -> usize {
        self.features.len()
    }

    /// True where the station reports nothing that the set could use.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.features.is_empty()
    }

    /// The features at `base`, in the units of [`Feature::unit`]; NaN is missing. `base` need not be a recorded day.
    #[must_use]
    pub fn compute(&self, history: &History<'_>, base: Date) -> Vec<f64> {
        let window = Window::new(history, base);
        self.features.iter().map(|feature| feature.kind.value(&window)).collect()
    }

    /// One row of [`FeatureSet::compute`] a base date: `bases.len()` x [`FeatureSet::len`].
    #[must_use]
    pub fn matrix(&self, history: &History<'_>, bases: &[Date]) -> Matrix {
        let mut matrix = Matrix::filled(bases.len(), self.len(), f64::NAN);
        for (i, &base) in bases.iter().enumerate() {
            let window = Window::new(history, base);
            for (entry, feature) in matrix.row_mut(i).iter_mut().zip(&self.features) {
                *entry = feature.kind.value(&window);
            }
        }
        matrix
    }
}
