//! The twelve analyses as one list of requests: what a service or a command hands in, and what it gets back.

pub mod compare;
mod distribution;
mod phases;
mod requests;
mod source_model;
#[cfg(test)]
mod tests;

use serde::{Deserialize, Serialize};
use thiserror::Error;

pub use distribution::{CurvePoint, DistributionResult, EnergyConsistency, Fit, density, fit_sample};
pub use phases::{Difference, PhaseComparison, PhaseSummary};
pub use requests::{
    ActivityOptions, CalibrationOptions, DistributionOptions, MapOptions, ModelChoice, PhaseOptions, ValidationOptions,
    WaitingOptions,
};

use super::activity::{Abscissa, Activity, activity};
use super::aftershocks::{AftershockOptions, Aftershocks, aftershocks};
use super::calibration::{Calibration, calibrate};
use super::catalogue::{Catalogue, Column};
use super::correlation::{CorrelationIntegral, CorrelationOptions, correlation_integral};
use super::duration::{DurationOptions, DurationScaling, duration_scaling};
use super::error::EmissionError;
use super::maps::{BValues, MapPoint, RangeMap, b_values, corral_deluca, exponent_map};
use super::sample::Sample;
use super::source::{SourceInversion, SourceOptions};
use super::tails::Rounding;
use super::validation::{Validation, validate};
use super::waiting::{WaitingTimes, waiting_times};
use crate::progress::Progress;

/// One analysis to run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Request {
    /// Distribution of the peak amplitudes.
    AmplitudeDistribution(DistributionOptions),
    /// Distribution of the energies.
    EnergyDistribution(DistributionOptions),
    /// Mean duration against amplitude.
    DurationScaling(DurationOptions),
    /// Spatial clustering.
    CorrelationIntegral(CorrelationOptions),
    /// Waiting times at several thresholds.
    WaitingTimes(WaitingOptions),
    /// Rates after main shocks.
    Aftershocks(AftershockOptions),
    /// Activity against strain, stress or time.
    Activity(ActivityOptions),
    /// The exponent as a function of the bounds, and b-values.
    ExponentMap(MapOptions),
    /// Bias and coverage of the estimator at the fitted truth.
    MonteCarloValidation(ValidationOptions),
    /// Swept area and strain behind the amplitudes.
    SourceModel(SourceOptions),
    /// Evaluation of pencil-lead breaks.
    Calibration(CalibrationOptions),
    /// Loading against unloading.
    PhaseComparison(PhaseOptions),
}

impl Request {
    /// The name of the analysis.
    #[must_use]
    pub const fn kind(&self) -> &'static str {
        match self {
            Self::AmplitudeDistribution(_) => "amplitude_distribution",
            Self::EnergyDistribution(_) => "energy_distribution",
            Self::DurationScaling(_) => "duration_scaling",
            Self::CorrelationIntegral(_) => "correlation_integral",
            Self::WaitingTimes(_) => "waiting_times",
            Self::Aftershocks(_) => "aftershocks",
            Self::Activity(_) => "activity",
            Self::ExponentMap(_) => "exponent_map",
            Self::MonteCarloValidation(_) => "monte_carlo_validation",
            Self::SourceModel(_) => "source_model",
            Self::Calibration(_) => "calibration",
            Self::PhaseComparison(_) => "phase_comparison",
        }
    }
}

/// The waiting times of an analysis.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct WaitingResult {
    /// A line a threshold with enough events.
    pub thresholds: Vec<WaitingTimes>,
}

/// The exponent as a function of the bounds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct MapResult {
    /// alpha against xmin.
    pub map: Vec<MapPoint>,
    /// Bounded fits to all ranges; missing where no replicates were asked for.
    pub ranges: Option<RangeMap>,
    /// b-values of M = log10(A / 1 V); missing with too few complete events.
    pub b_values: Option<BValues>,
}

/// What one analysis found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Outcome {
    /// See [`DistributionResult`].
    AmplitudeDistribution(DistributionResult),
    /// See [`DistributionResult`].
    EnergyDistribution(DistributionResult),
    /// See [`DurationScaling`].
    DurationScaling(DurationScaling),
    /// See [`CorrelationIntegral`].
    CorrelationIntegral(CorrelationIntegral),
    /// See [`WaitingResult`].
    WaitingTimes(WaitingResult),
    /// See [`Aftershocks`].
    Aftershocks(Aftershocks),
    /// See [`Activity`].
    Activity(Activity),
    /// See [`MapResult`].
    ExponentMap(MapResult),
    /// See [`Validation`].
    MonteCarloValidation(Validation),
    /// See [`SourceInversion`].
    SourceModel(SourceInversion),
    /// See [`Calibration`].
    Calibration(Calibration),
    /// See [`PhaseComparison`].
    PhaseComparison(Box<PhaseComparison>),
}

/// An analysis that was refused.
#[derive(Clone, Debug, PartialEq, Error)]
#[error("analysis {index} ({kind}): {error}")]
pub struct AnalysisError {
    /// Position of the request, from 0.
    pub index: usize,
    /// Name of the analysis.
    pub kind: &'static str,
    /// Why.
    #[source]
    pub error: EmissionError,
}

/// Whether `requests` can be run on `catalogue`, as far as that is known without running them: options, columns, metadata and numbers
/// of events.
///
/// # Errors
/// The first request that would be refused.
pub fn check(catalogue: &Catalogue, requests: &[Request]) -> Result<(), AnalysisError> {
    for (index, request) in requests.iter().enumerate() {
        let kind = request.kind();
        requests::check(catalogue, request).map_err(|error| AnalysisError { index, kind, error })?;
    }
    Ok(())
}

/// Runs `requests` in their order; the same `seed` gives the same bits at any number of threads.
///
/// # Errors
/// The first request that is refused, or a cancellation under the request that was running.
pub fn run(
    catalogue: &Catalogue,
    requests: &[Request],
    seed: u64,
    progress: &dyn Progress,
) -> Result<Vec<Outcome>, AnalysisError> {
    check(catalogue, requests)?;
    let one = |(index, request): (usize, &Request)| {
        let part = Part { whole: progress, index, parts: requests.len() };
        part.report(0.0, request.kind());
        let kind = request.kind();
        let refused = |error| AnalysisError { index, kind, error };
        if progress.cancelled() {
            return Err(refused(EmissionError::Cancelled));
        }
        analyse(catalogue, request, seed, &part).map_err(refused)
    };
    requests.iter().enumerate().map(one).collect()
}

/// One of several equal parts of a computation.
struct Part<'a> {
    whole: &'a dyn Progress,
    index: usize,
    parts: usize,
}

impl Progress for Part<'_> {
    fn report(&self, fraction: f64, phase: &str) {
        self.whole.report((self.index as f64 + fraction) / self.parts as f64, phase);
    }

    fn cancelled(&self) -> bool {
        self.whole.cancelled()
    }
}

fn analyse(
    catalogue: &Catalogue,
    request: &Request,
    seed: u64,
    progress: &dyn Progress,
) -> Result<Outcome, EmissionError> {
    let kind = request.kind();
    Ok(match request {
        Request::AmplitudeDistribution(options) => {
            Outcome::AmplitudeDistribution(distribution::amplitudes(catalogue, options, seed, progress)?)
        }
        Request::EnergyDistribution(options) => {
            Outcome::EnergyDistribution(distribution::energies(catalogue, options, seed, progress)?)
        }
        Request::DurationScaling(options) => Outcome::DurationScaling(durations(catalogue, options, seed, progress)?),
        Request::CorrelationIntegral(options) => {
            let (positions, _) = catalogue.positions(kind)?;
            let grain = catalogue.metadata.grain_size_mm.map(|size| size * 1e-3);
            let error = catalogue.metadata.location_error_m;
            let found = correlation_integral(&positions, error, grain, options, progress)?;
            Outcome::CorrelationIntegral(found)
        }
        Request::WaitingTimes(options) => {
            let times = catalogue.require(Column::TimeS, kind)?;
            let thresholds = waiting_times(times, &catalogue.amplitudes_v(kind)?, &options.thresholds_v, progress)?;
            Outcome::WaitingTimes(WaitingResult { thresholds })
        }
        Request::Aftershocks(options) => {
            let times = catalogue.require(Column::TimeS, kind)?;
            Outcome::Aftershocks(aftershocks(times, &catalogue.amplitudes_v(kind)?, options, progress)?)
        }
        Request::Activity(options) => {
            let (column, against) = requests::abscissa(catalogue, options.against)?;
            let start = options.start.or((against == Abscissa::Time).then(|| first_time(catalogue)).flatten());
            let position = catalogue.require(column, kind)?;
            let amplitudes = catalogue.amplitudes_v(kind)?;
            Outcome::Activity(activity(position, &amplitudes, against, start, options.bins)?)
        }
        Request::ExponentMap(options) => Outcome::ExponentMap(map(catalogue, options, seed, progress)?),
        Request::MonteCarloValidation(options) => {
            let fit = &options.fit;
            let sample = catalogue.amplitude_sample(fit.db_step, fit.rounding, kind)?;
            let chosen = distribution::choose(&sample, fit)?;
            Outcome::MonteCarloValidation(validate(&chosen.tail, &chosen.fitted, options.replicates, seed, progress)?)
        }
        Request::SourceModel(options) => Outcome::SourceModel(source_model::invert(catalogue, options, progress)?),
        Request::Calibration(options) => Outcome::Calibration(calibrate(&options.breaks)?),
        Request::PhaseComparison(options) => {
            Outcome::PhaseComparison(Box::new(phases::compare(catalogue, options, seed, progress)?))
        }
    })
}

/// Where a test that was not watched from time 0 begins: at its first event.
fn first_time(catalogue: &Catalogue) -> Option<f64> {
    catalogue.column(Column::TimeS)?.first().map(|first| first.min(0.0))
}

pub(super) fn durations(
    catalogue: &Catalogue,
    options: &DurationOptions,
    seed: u64,
    progress: &dyn Progress,
) -> Result<DurationScaling, EmissionError> {
    const KIND: &str = "duration_scaling";
    let durations = catalogue.require(Column::DurationUs, KIND)?;
    let options = DurationOptions { threshold_v: options.threshold_v.or(catalogue.metadata.threshold_v), ..*options };
    duration_scaling(&catalogue.amplitudes_v(KIND)?, durations, &options, seed, progress)
}

fn map(
    catalogue: &Catalogue,
    options: &MapOptions,
    seed: u64,
    progress: &dyn Progress,
) -> Result<MapResult, EmissionError> {
    let sample = catalogue.amplitude_sample(options.db_step, options.rounding, "exponent_map")?;
    let map = exponent_map(&sample, options.model, options.points)?;
    let ranges = (options.replicates > 0)
        .then(|| corral_deluca(&sample, options.range_points, options.replicates, seed, progress))
        .transpose()?;
    let bin = match &sample {
        Sample::Exact(_) => 0.0,
        // a bin whose record is its lower edge is moved by half a step to its centre
        Sample::Rounded(levels) => levels.step_db / 20.0,
    };
    let shift = if bin > 0.0 && options.rounding == Rounding::Down { bin / 2.0 } else { 0.0 };
    let magnitudes: Vec<f64> = catalogue.amplitudes_v("exponent_map")?.iter().map(|a| a.log10() + shift).collect();
    // whole bins only where the recorder's zero is one of their centres
    let zero = if bin > 0.0 { catalogue.volts_at_0_db().log10() + shift } else { 0.0 };
    let relative: Vec<f64> = magnitudes.iter().map(|m| m - zero).collect();
    let completeness = options.completeness.map(|m| m - zero);
    let b_values = b_values(&relative, bin, completeness).ok();
    let b_values = b_values.map(|b| BValues { completeness: b.completeness + zero, ..b });
    Ok(MapResult { map, ranges, b_values })
}
