//! Loading against unloading.

use serde::{Deserialize, Serialize};

use super::distribution::{Fit, fit_sample};
use super::requests::{DistributionOptions, PhaseOptions};
use super::{Part, durations};
use crate::emission::catalogue::{Catalogue, Column, Phase};
use crate::emission::correlation::{CorrelationOptions, correlation_integral};
use crate::emission::duration::DurationScaling;
use crate::emission::error::EmissionError;
use crate::emission::numerics::{Z95, mean, standard_deviation};
use crate::emission::sample::Sample;
use crate::emission::sets::{AndersonDarling, CommonExponent, anderson_darling, common_exponent};
use crate::emission::tails::{Model, Parameter};
use crate::emission::waiting::{WaitingTimes, waiting_times};
use crate::progress::Progress;

/// One phase of a test.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct PhaseSummary {
    /// Phase.
    pub phase: Phase,
    /// Events.
    pub events: usize,
    /// Fit of the amplitudes.
    pub fit: Fit,
    /// Its parameters.
    pub parameters: Vec<Parameter>,
    /// Durations; missing without their column or with too few events.
    pub duration: Option<DurationScaling>,
    /// Correlation dimension and its standard error; missing without positions or with too few events.
    pub dimension: Option<[f64; 2]>,
    /// Waiting times of all events; missing without times or with too few events.
    pub waiting: Option<WaitingTimes>,
}

/// Unloading less loading.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Difference {
    /// What differs: alpha, damping_per_s, mean_duration_us (of the same amplitudes) or dimension.
    pub quantity: String,
    /// Lower edge of the amplitudes that a mean duration is of, V.
    pub from_v: Option<f64>,
    /// Difference.
    pub difference: f64,
    /// Its standard error.
    pub se: f64,
    /// 95 % interval; where it does not hold 0, the phases differ.
    pub ci95: [f64; 2],
}

/// What a comparison of loading and unloading finds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct PhaseComparison {
    /// Loading.
    pub loading: PhaseSummary,
    /// Unloading.
    pub unloading: PhaseSummary,
    /// Unloading less loading.
    pub differences: Vec<Difference>,
    /// Whether the amplitudes of both have one distribution.
    pub amplitudes: AndersonDarling,
    /// Whether both have one exponent, for a power law with a cut-off from the larger xmin on; missing where that cannot be fitted.
    pub common_exponent: Option<CommonExponent>,
}

pub(super) fn compare(
    catalogue: &Catalogue,
    options: &PhaseOptions,
    seed: u64,
    progress: &dyn Progress,
) -> Result<PhaseComparison, EmissionError> {
    const KIND: &str = "phase_comparison";
    let phase = catalogue.require(Column::Phase, KIND)?;
    let parts = [catalogue.filtered(|row| phase[row] == 0.0), catalogue.filtered(|row| phase[row] == 1.0)];
    let part = |index| Part { whole: progress, index, parts: 2 };
    let loading = summary(&parts[0], Phase::Loading, options, seed, &part(0))?;
    let unloading = summary(&parts[1], Phase::Unloading, options, seed, &part(1))?;
    let amplitudes = [sorted(&parts[0])?, sorted(&parts[1])?];
    let xmin = loading.fit.xmin.max(unloading.fit.xmin);
    Ok(PhaseComparison {
        differences: differences(&parts, &loading, &unloading),
        amplitudes: anderson_darling(&[&amplitudes[0], &amplitudes[1]])?,
        common_exponent: common(&parts, &options.fit, xmin),
        loading,
        unloading,
    })
}

fn sorted(catalogue: &Catalogue) -> Result<Vec<f64>, EmissionError> {
    let mut amplitudes = catalogue.amplitudes_v("phase_comparison")?;
    amplitudes.sort_by(f64::total_cmp);
    Ok(amplitudes)
}

fn sample(catalogue: &Catalogue, options: &DistributionOptions) -> Result<Sample, EmissionError> {
    catalogue.amplitude_sample(options.db_step, options.rounding, "phase_comparison")
}

fn common(parts: &[Catalogue; 2], options: &DistributionOptions, xmin: f64) -> Option<CommonExponent> {
    let tail = |part: &Catalogue| sample(part, options).ok()?.tail(Some(xmin), options.xmax).ok();
    common_exponent(&[tail(&parts[0])?, tail(&parts[1])?], Model::CutoffPowerLaw).ok()
}

/// Whether both phases have enough events.
pub(super) fn check(catalogue: &Catalogue) -> Result<(), EmissionError> {
    let phase = catalogue.require(Column::Phase, "phase_comparison")?;
    let unloading = phase.iter().filter(|&&phase| phase == 1.0).count();
    enough(phase.len() - unloading, Phase::Loading).and_then(|()| enough(unloading, Phase::Unloading))
}

fn enough(found: usize, phase: Phase) -> Result<(), EmissionError> {
    const NEEDED: usize = 20;
    let what = if phase == Phase::Loading { "events while loading" } else { "events while unloading" };
    if found < NEEDED { Err(EmissionError::TooFewEvents { what, found, needed: NEEDED }) } else { Ok(()) }
}

fn summary(
    catalogue: &Catalogue,
    phase: Phase,
    options: &PhaseOptions,
    seed: u64,
    progress: &dyn Progress,
) -> Result<PhaseSummary, EmissionError> {
    enough(catalogue.len(), phase)?;
    let result = fit_sample(&sample(catalogue, &options.fit)?, &options.fit, seed, progress)?;
    let dimension = catalogue.positions("phase_comparison").ok().and_then(|(positions, _)| {
        let error = catalogue.metadata.location_error_m;
        correlation_integral(&positions, error, None, &CorrelationOptions::default(), progress).ok()
    });
    let waiting = catalogue.column(Column::TimeS).and_then(|times| {
        let amplitudes = catalogue.amplitudes_v("phase_comparison").ok()?;
        waiting_times(times, &amplitudes, &[0.0], progress).ok()?.into_iter().next()
    });
    if progress.cancelled() {
        return Err(EmissionError::Cancelled);
    }
    Ok(PhaseSummary {
        phase,
        events: catalogue.len(),
        fit: result.fit,
        parameters: result.parameters,
        duration: durations(catalogue, &options.duration, seed, progress).ok(),
        dimension: dimension.map(|found| [found.dimension, found.dimension_se]),
        waiting,
    })
}

fn difference(quantity: &str, from_v: Option<f64>, loading: (f64, f64), unloading: (f64, f64)) -> Difference {
    let (difference, se) = (unloading.0 - loading.0, loading.1.hypot(unloading.1));
    let ci95 = [difference - Z95 * se, difference + Z95 * se];
    Difference { quantity: quantity.to_owned(), from_v, difference, se, ci95 }
}

fn differences(parts: &[Catalogue; 2], loading: &PhaseSummary, unloading: &PhaseSummary) -> Vec<Difference> {
    let mut found = Vec::new();
    let alpha = |phase: &PhaseSummary| phase.fit.alpha.zip(phase.fit.alpha_se);
    if let (Some(a), Some(b)) = (alpha(loading), alpha(unloading)) {
        found.push(difference("alpha", None, a, b));
    }
    if let (Some(a), Some(b)) = (&loading.duration, &unloading.duration) {
        let of = |scaling: &DurationScaling| (scaling.damping_per_s, scaling.damping_se_per_s);
        found.push(difference("damping_per_s", None, of(a), of(b)));
        for bin in &a.bins {
            let same = b.bins.iter().find(|other| (other.from_v / bin.from_v - 1.0).abs() < 1e-9);
            if let Some(other) = same {
                let means = [(bin.mean_us, bin.se_us), (other.mean_us, other.se_us)];
                found.push(difference("mean_duration_us", Some(bin.from_v), means[0], means[1]));
            }
        }
        found.extend(above_10_mv(parts));
    }
    if let (Some(a), Some(b)) = (loading.dimension, unloading.dimension) {
        found.push(difference("dimension", None, (a[0], a[1]), (b[0], b[1])));
    }
    found
}

/// Mean duration of all events above 10 mV, each divided by the logarithm of its amplitude over 10 mV plus 1, which takes the
/// different amplitudes of both phases out: the seed's finding is that unloading is longer there.
fn above_10_mv(parts: &[Catalogue; 2]) -> Option<Difference> {
    const FROM_V: f64 = 0.01;
    let of = |catalogue: &Catalogue| {
        let amplitudes = catalogue.amplitudes_v("phase_comparison").ok()?;
        let durations = catalogue.column(Column::DurationUs)?;
        let pairs = amplitudes.iter().zip(durations).filter(|pair| *pair.0 > FROM_V);
        let scaled: Vec<f64> = pairs.map(|(a, d)| d / (1.0 + (a / FROM_V).ln())).collect();
        (scaled.len() >= 20).then(|| (mean(&scaled), standard_deviation(&scaled) / (scaled.len() as f64).sqrt()))
    };
    Some(difference("scaled_duration_above_10_mv_us", Some(FROM_V), of(&parts[0])?, of(&parts[1])?))
}
