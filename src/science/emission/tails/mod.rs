//! Heavy-tailed distributions of amplitudes and energies: models, maximum likelihood, distances.
//!
//! Every model lives on xmin <= x (<= xmax). With `u = ln(x / xmin)`, n events in the fit:
//!
//! | model | density of x | estimator |
//! |---|---|---|
//! | power law | `x^-alpha` | alpha = 1 + n / sum u, standard error (alpha - 1)/sqrt n (Clauset, Shalizi & Newman 2009, SIAM Rev. 51, eq. 3.1) |
//! | bounded power law | `x^-alpha`, x <= xmax | the likelihood of Deluca & Corral (2013, Acta Geophys. 61, eqs 5-8), any alpha |
//! | power law with exponential cut-off | `x^-alpha exp(-x / cutoff)` | Newton's method in two parameters, observed information, profile likelihood of the cut-off |
//! | exponential | `exp(-rate x)` | rate = 1 / (mean - xmin) |
//! | lognormal | `1/x exp(-(ln x - log_mean)^2 / (2 log_sd^2))` | Newton's method in two parameters |
//! | stretched exponential | `x^(stretching - 1) exp(-(rate x)^stretching)` | the rate is known for a stretching, which is searched |
//!
//! **Rounded decibels** are bins of equal width in u: all models are then fitted to the probabilities of the bins. For the power
//! law that is alpha = 1 + ln(1 + h / mean u)/h with u at the lower edges. The continuous estimators are biased on such data.

pub mod data;
pub mod discrete;
pub(super) mod distribution;
mod fit;
#[cfg(test)]
mod tests;
mod tilted;

use serde::{Deserialize, Serialize};

pub use data::{DecibelLevels, LN_RATIO_PER_DB, Rounding, Tail};
pub(super) use fit::distribution as fit_distribution;
pub use fit::fit;

use super::numerics::Z95;
use distribution::{Cumulative, Distribution};

/// A model of the tail of a distribution.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum Model {
    /// `x^-alpha` without an end.
    PowerLaw,
    /// `x^-alpha` up to xmax.
    BoundedPowerLaw,
    /// `x^-alpha exp(-x / cutoff)`.
    CutoffPowerLaw,
    /// `exp(-rate x)`.
    Exponential,
    /// Normal in ln x.
    Lognormal,
    /// `x^(stretching - 1) exp(-(rate x)^stretching)`.
    StretchedExponential,
}

impl Model {
    /// All models.
    pub const ALL: [Self; 6] = [
        Self::PowerLaw,
        Self::BoundedPowerLaw,
        Self::CutoffPowerLaw,
        Self::Exponential,
        Self::Lognormal,
        Self::StretchedExponential,
    ];

    /// The name that requests and results use.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::PowerLaw => "power_law",
            Self::BoundedPowerLaw => "bounded_power_law",
            Self::CutoffPowerLaw => "cutoff_power_law",
            Self::Exponential => "exponential",
            Self::Lognormal => "lognormal",
            Self::StretchedExponential => "stretched_exponential",
        }
    }
}

/// How the distance of the empirical distribution from the fitted one is taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum KsConvention {
    /// `max |F(x_j) - j/n|`, j = 0, ..., n - 1: what Clauset, Shalizi & Newman computed, and what reproduces their tables.
    #[default]
    Csn,
    /// The Kolmogorov-Smirnov statistic: the distance on both sides of each step, `max(|F - j/n|, |F - (j+1)/n|)`.
    TwoSided,
}

/// A fitted parameter.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Parameter {
    /// alpha (the exponent), cutoff and xmax (unit of the sample), rate (1 / unit of the sample), log_mean and log_sd (of the
    /// natural logarithm of the value in the unit of the sample), stretching.
    pub name: String,
    /// Estimate.
    pub value: f64,
    /// Standard error from the observed information; missing where the estimate lies on a bound.
    pub se: Option<f64>,
    /// Lower end of the 95 % interval: of the profile likelihood for the cut-off, else 1.96 standard errors.
    pub lower95: Option<f64>,
    /// Upper end of the 95 % interval; missing where it is unbounded.
    pub upper95: Option<f64>,
}

impl Parameter {
    fn normal(name: &str, value: f64, se: f64) -> Self {
        let reach = Z95 * se;
        Self { name: name.to_owned(), value, se: Some(se), lower95: Some(value - reach), upper95: Some(value + reach) }
    }

    fn bare(name: &str, value: f64) -> Self {
        Self { name: name.to_owned(), value, se: None, lower95: None, upper95: None }
    }
}

/// A model with its maximum-likelihood parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct Fitted {
    /// Model.
    pub model: Model,
    /// Lower bound, in the unit of the sample.
    pub xmin: f64,
    /// Upper bound, in the unit of the sample: given, or estimated by the bounded power law.
    pub xmax: Option<f64>,
    /// Events in the fit.
    pub n_tail: usize,
    /// Parameters.
    pub parameters: Vec<Parameter>,
    /// Log likelihood: of densities in the unit of the sample, or of probabilities of bins where the data are rounded.
    pub loglik: f64,
    pub(super) distribution: Distribution,
}

impl Fitted {
    /// The parameter called `name`.
    #[must_use]
    pub fn parameter(&self, name: &str) -> Option<&Parameter> {
        self.parameters.iter().find(|parameter| parameter.name == name)
    }

    /// Number of free parameters that the information criteria count; that of the model also where one lies on its bound.
    #[must_use]
    pub fn free_parameters(&self) -> usize {
        match self.model {
            Model::PowerLaw | Model::Exponential => 1,
            Model::BoundedPowerLaw => 1 + usize::from(self.parameter("xmax").is_some()),
            Model::CutoffPowerLaw | Model::Lognormal | Model::StretchedExponential => 2,
        }
    }

    /// Akaike's information criterion.
    #[must_use]
    pub fn aic(&self) -> f64 {
        2.0 * self.free_parameters() as f64 - 2.0 * self.loglik
    }

    /// Schwarz's (Bayesian) information criterion.
    #[must_use]
    pub fn bic(&self) -> f64 {
        self.free_parameters() as f64 * (self.n_tail as f64).ln() - 2.0 * self.loglik
    }

    /// Probability density at `x`, in the inverse unit of the sample, given x >= xmin; 0 outside of the bounds.
    #[must_use]
    pub fn density(&self, x: f64) -> f64 {
        let u = (x / self.xmin).ln();
        if u >= 0.0 && u <= self.distribution.upper { self.distribution.log_density(u).exp() / x } else { 0.0 }
    }

    /// Probabilities that a value of the tail exceeds each of `x`.
    #[must_use]
    pub fn survival(&self, x: &[f64]) -> Vec<f64> {
        let cumulative = self.distribution.cumulative();
        x.iter().map(|x| 1.0 - cumulative.at((x / self.xmin).ln().max(0.0))).collect()
    }

    /// Distance of the empirical distribution of `tail` from this one.
    #[must_use]
    pub fn ks_distance(&self, tail: &Tail, convention: KsConvention) -> f64 {
        ks_distance(&self.distribution.cumulative(), tail, convention, f64::INFINITY)
    }
}

/// The distance, or some value above `limit` as soon as it is known to exceed that.
///
/// In bins it is taken at their edges, where both conventions are the same.
pub(super) fn ks_distance(cumulative: &Cumulative, tail: &Tail, convention: KsConvention, limit: f64) -> f64 {
    let n = tail.len() as f64;
    let mut distance = 0.0_f64;
    if let Some(width) = tail.width {
        let mut below = 0.0;
        for (u, count) in tail.groups() {
            distance = distance.max((cumulative.at(u) - below / n).abs());
            below += count;
            distance = distance.max((cumulative.at(u + width) - below / n).abs());
        }
        return distance;
    }
    let step = if convention == KsConvention::TwoSided { 1.0 / n } else { 0.0 };
    // strided, so that a bad fit is known for one after few values
    const STRIDE: usize = 16;
    for start in 0..STRIDE {
        for (j, &u) in tail.u.iter().enumerate().skip(start).step_by(STRIDE) {
            let excess = cumulative.at(u) - j as f64 / n;
            distance = distance.max(excess.max(step - excess)).max(-excess);
        }
        if distance > limit {
            break;
        }
    }
    distance
}
