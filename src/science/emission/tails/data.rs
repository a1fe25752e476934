//! What the estimators read: the tail of a sample above xmin, exact or in bins of equal ratio.

use serde::{Deserialize, Serialize};

use crate::emission::error::{EmissionError, positive};

/// Natural logarithm of the ratio of two amplitudes that differ by 1 dB: ln(10)/20.
pub const LN_RATIO_PER_DB: f64 = std::f64::consts::LN_10 / 20.0;

/// How recorded decibels relate to the amplitude.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum Rounding {
    /// To the nearest step: a record stands for half a step to each side.
    #[default]
    Nearest,
    /// Down: a record is the lower edge of its bin.
    Down,
}

/// Events at or above xmin, as `u = ln(x / xmin)`.
///
/// With a bin `width` every `u` is the lower edge of a bin, a whole multiple of the width.
#[derive(Clone, Debug, PartialEq)]
pub struct Tail {
    /// Lower bound, in the unit of the sample.
    pub(in crate::emission) xmin: f64,
    /// Upper bound, in the unit of the sample: all distributions are conditional on x <= xmax.
    pub(in crate::emission) xmax: Option<f64>,
    /// Largest value, in the unit of the sample; the upper edge of its bin.
    pub(in crate::emission) largest: f64,
    /// Rising.
    pub(in crate::emission) u: Vec<f64>,
    /// Width of the bins in u.
    pub(in crate::emission) width: Option<f64>,
}

impl Tail {
    /// The values of `sorted` (rising, positive) from `xmin` to `xmax`.
    ///
    /// # Errors
    /// Bounds that are no bounds, fewer than two values between them, or values that all agree.
    pub fn exact(sorted: &[f64], xmin: f64, xmax: Option<f64>) -> Result<Self, EmissionError> {
        check_bounds(xmin, xmax)?;
        let from = sorted.partition_point(|&x| x < xmin);
        let to = xmax.map_or(sorted.len(), |xmax| sorted.partition_point(|&x| x <= xmax));
        let values = sorted.get(from..to).unwrap_or_default();
        let largest = values.last().copied().unwrap_or(xmin);
        let u = values.iter().map(|x| (x / xmin).ln()).collect();
        Self { xmin, xmax, largest, u, width: None }.checked()
    }

    /// Amplitudes recorded in steps of `step_db` decibels, as levels (rising, dB re any reference amplitude `unit`).
    ///
    /// `xmin` is rounded up and `xmax` down to an edge of a bin, so that only whole bins are used.
    ///
    /// # Errors
    /// As [`Tail::exact`], or a step that is not positive.
    pub fn rounded(levels: &DecibelLevels, xmin: Option<f64>, xmax: Option<f64>) -> Result<Self, EmissionError> {
        positive("db_step", levels.step_db)?;
        let edge = |level: i64| levels.lower_edge(level);
        let first = levels.levels.first().copied().unwrap_or(0);
        let from = match xmin {
            Some(xmin) => levels.first_bin_above(positive("xmin", xmin)?),
            None => first,
        };
        let end = xmax.map(|xmax| levels.last_bin_below(xmax));
        let xmin = edge(from);
        let xmax = end.map(|end| edge(end + 1));
        check_bounds(xmin, xmax)?;
        let width = levels.step_db * LN_RATIO_PER_DB;
        let inside = levels.levels.iter().filter(|&&level| level >= from && end.is_none_or(|end| level <= end));
        let u: Vec<f64> = inside.map(|&level| (level - from) as f64 * width).collect();
        let largest = xmin * (u.last().copied().unwrap_or_default() + width).exp();
        Self { xmin, xmax, largest, u, width: Some(width) }.checked()
    }

    fn checked(self) -> Result<Self, EmissionError> {
        const NEEDED: usize = 3;
        if self.u.len() < NEEDED {
            return Err(EmissionError::TooFewEvents { what: "a fit of the tail", found: self.u.len(), needed: NEEDED });
        }
        if self.u.first() == self.u.last() {
            return Err(EmissionError::Degenerate { what: "the tail" });
        }
        // far beyond what any recorder spans, exp(u) overflows and fits take minutes
        const WIDEST: f64 = 80.0 * std::f64::consts::LN_10;
        let span = self.u.last().copied().unwrap_or_default().max(self.xmax.map_or(0.0, |_| self.upper()));
        if span > WIDEST {
            let decades = span / std::f64::consts::LN_10;
            return Err(EmissionError::option(
                "span of the tail",
                format!("{decades:.0} decades"),
                "at most 80 decades",
            ));
        }
        Ok(self)
    }

    /// Events.
    #[must_use]
    pub fn len(&self) -> usize {
        self.u.len()
    }

    /// Never: a tail without events is refused.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.u.is_empty()
    }

    /// Lower bound.
    #[must_use]
    pub fn xmin(&self) -> f64 {
        self.xmin
    }

    /// Upper bound of u, infinite where there is none.
    pub(in crate::emission) fn upper(&self) -> f64 {
        self.xmax.map_or(f64::INFINITY, |xmax| (xmax / self.xmin).ln())
    }

    /// Mean of `u`, of the lower edges where there are bins.
    pub(in crate::emission) fn mean_u(&self) -> f64 {
        self.u.iter().sum::<f64>() / self.u.len() as f64
    }

    /// Lower edge in u and number of events of each bin that holds any.
    pub(in crate::emission) fn groups(&self) -> Vec<(f64, f64)> {
        let mut groups: Vec<(f64, f64)> = Vec::new();
        for &u in &self.u {
            match groups.last_mut() {
                Some(last) if last.0 == u => last.1 += 1.0,
                _ => groups.push((u, 1.0)),
            }
        }
        groups
    }
}

/// Amplitudes in whole steps of decibels.
#[derive(Clone, Debug, PartialEq)]
pub struct DecibelLevels {
    /// Size of a step, dB.
    pub step_db: f64,
    /// Amplitude at level 0, in the unit that results are wanted in.
    pub unit: f64,
    /// How a level relates to the amplitude.
    pub rounding: Rounding,
    /// Amplitude in steps above `unit`, rising.
    pub levels: Vec<i64>,
}

impl DecibelLevels {
    /// Levels of `amplitude_db` (any order), which are rounded to the nearest multiple of `step_db`; `unit` is the amplitude
    /// at 0 dB.
    ///
    /// # Errors
    /// A step or unit that is not positive.
    pub fn new(amplitude_db: &[f64], step_db: f64, unit: f64, rounding: Rounding) -> Result<Self, EmissionError> {
        positive("db_step", step_db)?;
        positive("reference amplitude", unit)?;
        let mut levels: Vec<i64> = amplitude_db.iter().map(|db| (db / step_db).round() as i64).collect();
        levels.sort_unstable();
        Ok(Self { step_db, unit, rounding, levels })
    }

    /// Amplitude at the lower edge of the bin of `level`.
    pub(in crate::emission) fn lower_edge(&self, level: i64) -> f64 {
        let half = if self.rounding == Rounding::Nearest { 0.5 } else { 0.0 };
        self.unit * ((level as f64 - half) * self.step_db * LN_RATIO_PER_DB).exp()
    }

    /// Position of `amplitude` in steps above the lower edge of level 0.
    fn position(&self, amplitude: f64) -> f64 {
        let half = if self.rounding == Rounding::Nearest { 0.5 } else { 0.0 };
        (amplitude / self.unit).ln() / (self.step_db * LN_RATIO_PER_DB) + half
    }

    fn first_bin_above(&self, amplitude: f64) -> i64 {
        (self.position(amplitude) - EDGE_SLACK).ceil() as i64
    }

    fn last_bin_below(&self, amplitude: f64) -> i64 {
        (self.position(amplitude) + EDGE_SLACK).floor() as i64 - 1
    }
}

/// An amplitude this close to an edge, in steps, is meant to be the edge.
const EDGE_SLACK: f64 = 1e-6;

fn check_bounds(xmin: f64, xmax: Option<f64>) -> Result<(), EmissionError> {
    positive("xmin", xmin)?;
    match xmax {
        Some(xmax) if !(xmax.is_finite() && xmax > xmin) => {
            Err(EmissionError::option("xmax", xmax, format!("a finite number above xmin ({xmin})")))
        }
        _ => Ok(()),
    }
}
