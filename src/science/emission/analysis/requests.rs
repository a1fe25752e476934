//! The options of the analyses, and what can be refused before they run.

use serde::{Deserialize, Serialize};

use super::{Request, phases, source_model};
use crate::emission::activity::Abscissa;
use crate::emission::calibration::{LeadBreak, calibrate};
use crate::emission::catalogue::{Catalogue, Column};
use crate::emission::correlation;
use crate::emission::duration::DurationOptions;
use crate::emission::error::{EmissionError, positive};
use crate::emission::tails::{KsConvention, Model, Rounding};
use crate::emission::waiting;

/// Which model to fit.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum ModelChoice {
    /// All models; the result says which one was chosen and why.
    #[default]
    Auto,
    /// See [`Model::PowerLaw`].
    PowerLaw,
    /// See [`Model::BoundedPowerLaw`].
    BoundedPowerLaw,
    /// See [`Model::CutoffPowerLaw`].
    CutoffPowerLaw,
    /// See [`Model::Exponential`].
    Exponential,
    /// See [`Model::Lognormal`].
    Lognormal,
    /// See [`Model::StretchedExponential`].
    StretchedExponential,
}

impl ModelChoice {
    /// The model, if one was named.
    #[must_use]
    pub const fn model(self) -> Option<Model> {
        match self {
            Self::Auto => None,
            Self::PowerLaw => Some(Model::PowerLaw),
            Self::BoundedPowerLaw => Some(Model::BoundedPowerLaw),
            Self::CutoffPowerLaw => Some(Model::CutoffPowerLaw),
            Self::Exponential => Some(Model::Exponential),
            Self::Lognormal => Some(Model::Lognormal),
            Self::StretchedExponential => Some(Model::StretchedExponential),
        }
    }
}

/// How a distribution is fitted.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(default, deny_unknown_fields)]
pub struct DistributionOptions {
    /// Model.
    pub model: ModelChoice,
    /// Lower bound, V or eu; none chooses it by the smallest distance: among all values for the power law, else among 40.
    pub xmin: Option<f64>,
    /// Upper bound, V or eu; all models are then conditional on it.
    pub xmax: Option<f64>,
    /// How distances are taken.
    pub ks: KsConvention,
    /// Replicates of the goodness of fit, at most 100,000; 0 leaves it out; none takes 2,500 for the power law, else 250.
    pub replicates: Option<usize>,
    /// Step of recorded decibels, dB; none finds it out.
    pub db_step: Option<f64>,
    /// How recorded decibels were rounded.
    pub rounding: Rounding,
}

/// Waiting times.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(default, deny_unknown_fields)]
pub struct WaitingOptions {
    /// Smallest amplitudes, V; empty takes the quantiles 0, 0.5, 0.75 and 0.9.
    pub thresholds_v: Vec<f64>,
}

/// Activity.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(default, deny_unknown_fields)]
pub struct ActivityOptions {
    /// Abscissa; none takes the first of strain, stress and time that is there.
    pub against: Option<Abscissa>,
    /// Where the test begins; none takes 0.
    pub start: Option<f64>,
    /// Bins.
    pub bins: usize,
}

impl Default for ActivityOptions {
    fn default() -> Self {
        Self { against: None, start: None, bins: 50 }
    }
}

/// Exponent maps.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(default, deny_unknown_fields)]
pub struct MapOptions {
    /// Model of alpha(xmin): power_law, bounded_power_law or cutoff_power_law.
    pub model: Model,
    /// Lower bounds.
    pub points: usize,
    /// Bounds of the map of ranges, up to 200.
    pub range_points: usize,
    /// Replicates a range, at most 10,000; 0 leaves the map of ranges out.
    pub replicates: usize,
    /// Smallest complete magnitude log10(A / 1 V); none takes the fullest bin.
    pub completeness: Option<f64>,
    /// Step of recorded decibels, dB; none finds it out.
    pub db_step: Option<f64>,
    /// How recorded decibels were rounded.
    pub rounding: Rounding,
}

impl Default for MapOptions {
    fn default() -> Self {
        Self {
            model: Model::PowerLaw,
            points: 40,
            range_points: 12,
            replicates: 100,
            completeness: None,
            db_step: None,
            rounding: Rounding::Nearest,
        }
    }
}

/// Monte-Carlo validation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(default, deny_unknown_fields)]
pub struct ValidationOptions {
    /// The fit that is validated; its replicates are not used.
    pub fit: DistributionOptions,
    /// Synthetic catalogues, at most 100,000.
    pub replicates: usize,
}

impl Default for ValidationOptions {
    fn default() -> Self {
        Self { fit: DistributionOptions::default(), replicates: 500 }
    }
}

/// Calibration.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(default, deny_unknown_fields)]
pub struct CalibrationOptions {
    /// Arrivals of at least three breaks.
    pub breaks: Vec<LeadBreak>,
}

/// Loading against unloading.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(default, deny_unknown_fields)]
pub struct PhaseOptions {
    /// The fit of each phase.
    pub fit: DistributionOptions,
    /// The durations of each phase.
    pub duration: DurationOptions,
}

const MOST_REPLICATES: usize = 100_000;

pub(super) fn check(catalogue: &Catalogue, request: &Request) -> Result<(), EmissionError> {
    let kind = request.kind();
    let amplitude = || {
        let columns = [Column::AmplitudeV, Column::AmplitudeDb];
        let missing = EmissionError::MissingColumn { column: "amplitude_v or amplitude_db", needed_by: kind };
        if columns.iter().any(|&column| catalogue.column(column).is_some()) { Ok(()) } else { Err(missing) }
    };
    let events = |needed: usize| {
        let found = catalogue.len();
        if found < needed { Err(EmissionError::TooFewEvents { what: kind, found, needed }) } else { Ok(()) }
    };
    let column = |column: Column| catalogue.require(column, kind).map(|_| ());
    match request {
        Request::AmplitudeDistribution(options) => {
            amplitude().and_then(|()| events(3)).and_then(|()| fit(options))?;
            enough(&catalogue.amplitudes_v(kind)?, options, "amplitudes from xmin to xmax")
        }
        Request::EnergyDistribution(options) => {
            column(Column::EnergyEu).and_then(|()| events(3)).and_then(|()| fit(options))?;
            enough(catalogue.require(Column::EnergyEu, kind)?, options, "energies from xmin to xmax")
        }
        Request::DurationScaling(options) => amplitude()
            .and_then(|()| column(Column::DurationUs))
            .and_then(|()| options.check())
            .and_then(|()| events(20)),
        Request::CorrelationIntegral(options) => {
            let (positions, _) = catalogue.positions(kind)?;
            let (found, needed) = (positions.len(), 50);
            if found < needed {
                return Err(EmissionError::TooFewEvents { what: kind, found, needed });
            }
            correlation::check(&positions, catalogue.metadata.location_error_m, options)
        }
        Request::WaitingTimes(options) => {
            waiting::check(&options.thresholds_v)?;
            amplitude().and_then(|()| column(Column::TimeS)).and_then(|()| events(30))
        }
        Request::Aftershocks(options) => {
            options.check()?;
            amplitude().and_then(|()| column(Column::TimeS)).and_then(|()| events(50))
        }
        Request::Activity(options) => {
            within("bins", options.bins, 1, 10_000)?;
            amplitude().and_then(|()| abscissa(catalogue, options.against)).and_then(|_| events(20))
        }
        Request::ExponentMap(options) => {
            at_most("replicates", options.replicates, 10_000)?;
            within("range_points", options.range_points, 2, 200)?;
            within("points", options.points, 2, 1000)?;
            if !matches!(options.model, Model::PowerLaw | Model::BoundedPowerLaw | Model::CutoffPowerLaw) {
                let accepted = "power_law, bounded_power_law or cutoff_power_law";
                return Err(EmissionError::option("model", options.model.name(), accepted));
            }
            options.db_step.map(|step| positive("db_step", step)).transpose()?;
            amplitude().and_then(|()| events(20))
        }
        Request::MonteCarloValidation(options) => {
            within("replicates", options.replicates, 2, MOST_REPLICATES)?;
            amplitude().and_then(|()| events(3)).and_then(|()| fit(&options.fit))?;
            enough(&catalogue.amplitudes_v(kind)?, &options.fit, "amplitudes from xmin to xmax")
        }
        Request::SourceModel(options) => {
            amplitude().and_then(|()| events(1)).and_then(|()| source_model::check(catalogue, options))
        }
        Request::Calibration(options) => calibrate(&options.breaks).map(|_| ()),
        Request::PhaseComparison(options) => {
            amplitude().and_then(|()| column(Column::Phase))?;
            phases::check(catalogue)?;
            fit(&options.fit).and_then(|()| options.duration.check())
        }
    }
}

/// Whether a tail whose bounds are given holds the three values that any fit needs.
fn enough(values: &[f64], options: &DistributionOptions, what: &'static str) -> Result<(), EmissionError> {
    let (low, high) = (options.xmin.unwrap_or(f64::MIN_POSITIVE), options.xmax.unwrap_or(f64::INFINITY));
    // rounded decibels stand for a bin around them: a bound is one of its edges
    let slack = 10f64.powf(options.db_step.unwrap_or(3.0) / 20.0);
    let (found, needed) = (values.iter().filter(|&&x| x >= low / slack && x <= high * slack).count(), 3);
    if found < needed { Err(EmissionError::TooFewEvents { what, found, needed }) } else { Ok(()) }
}

fn at_most(option: &'static str, value: usize, most: usize) -> Result<(), EmissionError> {
    if value <= most { Ok(()) } else { Err(EmissionError::option(option, value, format!("at most {most}"))) }
}

fn within(option: &'static str, value: usize, least: usize, most: usize) -> Result<(), EmissionError> {
    if (least..=most).contains(&value) {
        Ok(())
    } else {
        Err(EmissionError::option(option, value, format!("{least} to {most}")))
    }
}

/// Whether the options of a fit can be used.
pub(super) fn fit(options: &DistributionOptions) -> Result<(), EmissionError> {
    options.xmin.map(|xmin| positive("xmin", xmin)).transpose()?;
    options.xmax.map(|xmax| positive("xmax", xmax)).transpose()?;
    options.db_step.map(|step| positive("db_step", step)).transpose()?;
    if let (Some(xmin), Some(xmax)) = (options.xmin, options.xmax)
        && xmax <= xmin
    {
        return Err(EmissionError::option("xmax", xmax, format!("a number above xmin ({xmin})")));
    }
    if options.xmax.is_some() && options.model == ModelChoice::PowerLaw {
        let accepted = "bounded_power_law, or no xmax, as a power law has no upper bound";
        return Err(EmissionError::option("model", "power_law with xmax", accepted));
    }
    at_most("replicates", options.replicates.unwrap_or(0), MOST_REPLICATES)
}

/// The column of an abscissa that is there.
pub(super) fn abscissa(catalogue: &Catalogue, wanted: Option<Abscissa>) -> Result<(Column, Abscissa), EmissionError> {
    let all =
        [(Column::Strain, Abscissa::Strain), (Column::StressMpa, Abscissa::Stress), (Column::TimeS, Abscissa::Time)];
    let mut wanted_ones = all.into_iter().filter(|(_, abscissa)| wanted.is_none_or(|wanted| wanted == *abscissa));
    let first = wanted_ones.clone().map(|(column, _)| column.name()).next().unwrap_or("strain");
    let column = if wanted.is_some() { first } else { "strain, stress_mpa or time_s" };
    wanted_ones
        .find(|(column, _)| catalogue.column(*column).is_some())
        .ok_or(EmissionError::MissingColumn { column, needed_by: "activity" })
}
