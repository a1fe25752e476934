//! The distribution of amplitudes or energies: density, fit, comparison, goodness of fit.

use serde::{Deserialize, Serialize};

use super::requests::DistributionOptions;
use crate::emission::catalogue::{Catalogue, Column, FlagKind, QualityFlag, quality};
use crate::emission::comparison::{Choice, Comparison, LikelihoodRatio, ModelSummary};
use crate::emission::error::EmissionError;
use crate::emission::goodness::{Question, p_value};
use crate::emission::numerics::{line, log_spaced};
use crate::emission::sample::Sample;
use crate::emission::tails::{Fitted, KsConvention, Model, Parameter, Tail, fit};
use crate::emission::waiting::{DensityPoint, log_density};
use crate::emission::xmin::{scan, select};
use crate::progress::Progress;

/// A fitted distribution.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Fit {
    /// Model: the one asked for, or the one that was chosen.
    pub model: Model,
    /// Exponent; missing for models without one.
    pub alpha: Option<f64>,
    /// Its standard error.
    pub alpha_se: Option<f64>,
    /// 95 % interval of the exponent.
    pub ci95: Option<[f64; 2]>,
    /// Exponential cut-off, in the unit of the quantity; missing where the model has none or the data show none.
    pub cutoff: Option<f64>,
    /// Lower bound, in the unit of the quantity.
    pub xmin: f64,
    /// Upper bound: given, or estimated by the bounded power law.
    pub xmax: Option<f64>,
    /// Events in the fit.
    pub n_tail: usize,
    /// Distance of the empirical from the fitted distribution.
    pub ks_distance: f64,
    /// How it was taken.
    pub ks_convention: KsConvention,
    /// Share of replicates that are at least as far from their fit; below 0.1 the model is rejected. Missing without replicates.
    pub p_value: Option<f64>,
    /// Replicates.
    pub replicates: usize,
    /// Log likelihood.
    pub loglik: f64,
    /// Akaike's information criterion.
    pub aic: f64,
    /// Schwarz's (Bayesian) information criterion.
    pub bic: f64,
}

/// A point of a curve.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct CurvePoint {
    /// Value, in the unit of the quantity.
    pub x: f64,
    /// Probability density of the whole sample, in the inverse unit; missing where only the CCDF is known.
    pub density: Option<f64>,
    /// Share of the whole sample that is at least x.
    pub ccdf: f64,
}

/// Whether the exponents of energy and amplitude agree: epsilon = (tau + x - 1)/x where E ~ A^x.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct EnergyConsistency {
    /// Exponent x of E ~ A^x, by least squares in logarithms.
    pub energy_exponent: f64,
    /// Its standard error.
    pub energy_exponent_se: f64,
    /// Exponent tau of as many of the largest amplitudes, with the same model.
    pub tau: f64,
    /// The exponent of energy that follows.
    pub predicted: f64,
    /// The exponent of energy that was fitted.
    pub fitted: f64,
}

/// What an analysis of a distribution found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct DistributionResult {
    /// The fit.
    pub fit: Fit,
    /// Likelihood ratios of all pairs of models on the same tail.
    pub comparison: Vec<LikelihoodRatio>,
    /// Parameters of the fit with errors and intervals.
    pub parameters: Vec<Parameter>,
    /// All models on the same tail.
    pub models: Vec<ModelSummary>,
    /// The model that the data speak for, and why; it is the fitted one where the model was left open.
    pub choice: Option<Choice>,
    /// Log-binned density of the whole sample.
    pub density: Vec<DensityPoint>,
    /// Empirical CCDF at up to 200 values.
    pub ccdf: Vec<CurvePoint>,
    /// The fit at 100 values of its range, scaled to the whole sample.
    pub curve: Vec<CurvePoint>,
    /// What the reader must know.
    pub flags: Vec<QualityFlag>,
    /// Only for energies of a catalogue with amplitudes.
    pub energy_consistency: Option<EnergyConsistency>,
}

pub(super) fn amplitudes(
    catalogue: &Catalogue,
    options: &DistributionOptions,
    seed: u64,
    progress: &dyn Progress,
) -> Result<DistributionResult, EmissionError> {
    let sample = catalogue.amplitude_sample(options.db_step, options.rounding, "amplitude_distribution")?;
    let mut result = fit_sample(&sample, options, seed, progress)?;
    result.flags.splice(0..0, quality(catalogue).into_iter().filter(|flag| flag.kind != FlagKind::TooFewEvents));
    Ok(result)
}

pub(super) fn energies(
    catalogue: &Catalogue,
    options: &DistributionOptions,
    seed: u64,
    progress: &dyn Progress,
) -> Result<DistributionResult, EmissionError> {
    const KIND: &str = "energy_distribution";
    let energies = catalogue.require(Column::EnergyEu, KIND)?;
    // an energy of 0 is one below the resolution of the recorder
    let positive: Vec<f64> = energies.iter().copied().filter(|&energy| energy > 0.0).collect();
    let sample = Sample::exact(positive, Column::EnergyEu.name())?;
    let mut result = fit_sample(&sample, options, seed, progress)?;
    result.energy_consistency = consistency(catalogue, energies, &result.fit);
    Ok(result)
}

/// See [`EnergyConsistency`]; `None` where the model has no exponent or the amplitudes are not known.
fn consistency(catalogue: &Catalogue, energies: &[f64], fitted: &Fit) -> Option<EnergyConsistency> {
    let epsilon = fitted.alpha?;
    let amplitudes = catalogue.amplitudes_v("energy_distribution").ok()?;
    let both = || amplitudes.iter().zip(energies).filter(|pair| *pair.1 > 0.0);
    let log_a: Vec<f64> = both().map(|pair| pair.0.ln()).collect();
    let log_e: Vec<f64> = both().map(|pair| pair.1.ln()).collect();
    let law = line(&log_a, &log_e, &vec![1.0; log_a.len()])?;
    let sample = Sample::exact(amplitudes, Column::AmplitudeV.name()).ok()?;
    let Sample::Exact(sorted) = &sample else { return None };
    let xmin = *sorted.get(sorted.len().checked_sub(fitted.n_tail)?)?;
    let tau = fit(&sample.tail(Some(xmin), None).ok()?, fitted.model).ok()?.parameter("alpha")?.value;
    Some(EnergyConsistency {
        energy_exponent: law.slope,
        energy_exponent_se: law.slope_se,
        tau,
        predicted: (tau + law.slope - 1.0) / law.slope,
        fitted: epsilon,
    })
}

/// A tail with its model.
pub(super) struct Chosen {
    pub(super) tail: Tail,
    pub(super) fitted: Fitted,
    pub(super) comparison: Comparison,
}

/// Chooses xmin where it is not given, and the model where it is left open.
///
/// xmin is chosen for the model that was asked for: exactly for the power law. Where the model is open it is chosen for the power
/// law with a cut-off, which contains the power law: the tail of a pure power law would begin amid a cut-off.
pub(super) fn choose(sample: &Sample, options: &DistributionOptions) -> Result<Chosen, EmissionError> {
    let wanted = options.model.model();
    let tail = match (options.xmin, wanted, sample) {
        (Some(xmin), _, _) => sample.tail(Some(xmin), options.xmax)?,
        (None, Some(Model::PowerLaw), Sample::Exact(values)) => {
            sample.tail(Some(scan(values, options.ks)?.xmin), options.xmax)?
        }
        (None, wanted, _) => select(sample, wanted.unwrap_or(Model::CutoffPowerLaw), options.xmax, options.ks)?,
    };
    let comparison = Comparison::new(&tail)?;
    let model = match wanted {
        Some(model) => model,
        None => comparison.choice().ok_or(EmissionError::NotConverged { what: "any model" })?.model,
    };
    let fitted = match comparison.fits().iter().find(|fit| fit.model == model) {
        Some(fitted) => fitted.clone(),
        None => fit(&tail, model)?,
    };
    Ok(Chosen { tail, fitted, comparison })
}

/// Fits, compares and tests `sample`.
///
/// # Errors
/// Options out of range, too few events, no fit, or [`EmissionError::Cancelled`].
pub fn fit_sample(
    sample: &Sample,
    options: &DistributionOptions,
    seed: u64,
    progress: &dyn Progress,
) -> Result<DistributionResult, EmissionError> {
    progress.report(0.0, "fit");
    let Chosen { tail, fitted, comparison } = choose(sample, options)?;
    let default = if fitted.model == Model::PowerLaw { 2500 } else { 250 };
    let replicates = options.replicates.unwrap_or(default);
    let question = Question {
        sample,
        fitted: &fitted,
        xmin_chosen: options.xmin.is_none(),
        xmax: options.xmax,
        convention: options.ks,
    };
    let goodness = (replicates > 0).then(|| p_value(&question, replicates, seed, progress)).transpose()?;
    let alpha = fitted.parameter("alpha");
    let fit = Fit {
        model: fitted.model,
        alpha: alpha.map(|alpha| alpha.value),
        alpha_se: alpha.and_then(|alpha| alpha.se),
        ci95: alpha.and_then(|alpha| Some([alpha.lower95?, alpha.upper95?])),
        cutoff: fitted.parameter("cutoff").map(|cutoff| cutoff.value),
        xmin: fitted.xmin,
        xmax: fitted.xmax,
        n_tail: fitted.n_tail,
        ks_distance: fitted.ks_distance(&tail, options.ks),
        ks_convention: options.ks,
        p_value: goodness.map(|goodness| goodness.p_value),
        replicates,
        loglik: fitted.loglik,
        aic: fitted.aic(),
        bic: fitted.bic(),
    };
    let few = fit.n_tail < crate::emission::catalogue::FEW_EVENTS;
    Ok(DistributionResult {
        comparison: comparison.table(),
        parameters: fitted.parameters.clone(),
        models: comparison.summaries(),
        choice: comparison.choice(),
        density: density(sample),
        ccdf: ccdf(sample),
        curve: curve(sample, &tail, &fitted),
        flags: if few { vec![crate::emission::catalogue::too_few(fit.n_tail)] } else { Vec::new() },
        energy_consistency: None,
        fit,
    })
}

/// The density of a sample in bins of equal ratio: five a decade, or whole levels of about 2 dB where decibels were rounded.
#[must_use]
pub fn density(sample: &Sample) -> Vec<DensityPoint> {
    let levels = match sample {
        Sample::Exact(values) => {
            let mut density = log_density(values, 5);
            // the floor cuts through the lowest bin: the part of it that is below can hold nothing
            if let (Some(lowest), Some(&smallest)) = (density.first_mut(), values.first())
                && (lowest.from..lowest.to).contains(&smallest)
            {
                let share = (lowest.to - lowest.from) / (lowest.to - smallest);
                *lowest = DensityPoint {
                    from: smallest,
                    density: lowest.density * share,
                    error: lowest.error * share,
                    ..*lowest
                };
            }
            return density;
        }
        Sample::Rounded(levels) => levels,
    };
    // whole levels a bin, about 2 dB
    let group = (2.0 / levels.step_db).round().max(1.0) as i64;
    let total = levels.levels.len() as f64;
    let point = |same: &[i64]| {
        let first = same[0].div_euclid(group) * group;
        let (from, to) = (levels.lower_edge(first), levels.lower_edge(first + group));
        let (events, scale) = (same.len() as f64, total * (to - from));
        DensityPoint { from, to, events: same.len(), density: events / scale, error: events.sqrt() / scale }
    };
    levels.levels.chunk_by(|a, b| a.div_euclid(group) == b.div_euclid(group)).map(point).collect()
}

fn ccdf(sample: &Sample) -> Vec<CurvePoint> {
    const POINTS: usize = 200;
    let n = sample.len();
    let value = |i: usize| match sample {
        Sample::Exact(values) => values[i],
        Sample::Rounded(levels) => levels.lower_edge(levels.levels[i]),
    };
    // ranks in equal ratios, so that the tail is resolved
    let mut points: Vec<CurvePoint> = log_spaced(n as f64, 1.0, POINTS.min(n))
        .into_iter()
        .map(|rank| {
            let mut i = n - (rank.round() as usize).clamp(1, n);
            while i > 0 && value(i - 1) == value(i) {
                i -= 1;
            }
            CurvePoint { x: value(i), density: None, ccdf: (n - i) as f64 / n as f64 }
        })
        .collect();
    points.dedup_by(|a, b| a.x == b.x);
    points
}

fn curve(sample: &Sample, tail: &Tail, fitted: &Fitted) -> Vec<CurvePoint> {
    const POINTS: usize = 100;
    let share = tail.len() as f64 / sample.len() as f64;
    // what is above an upper bound is not part of the fit, but of the sample
    let above = match (sample, tail.xmax) {
        (Sample::Exact(values), Some(xmax)) => (values.len() - values.partition_point(|&x| x <= xmax)) as f64,
        (Sample::Rounded(levels), Some(xmax)) => {
            levels.levels.iter().filter(|&&level| levels.lower_edge(level) >= xmax * (1.0 - 1e-9)).count() as f64
        }
        _ => 0.0,
    } / sample.len() as f64;
    let x = log_spaced(tail.xmin(), tail.largest.max(tail.xmin() * 1.001), POINTS);
    let survival = fitted.survival(&x);
    let point = |(&x, survival): (&f64, f64)| CurvePoint {
        x,
        density: Some(share * fitted.density(x)),
        ccdf: above + share * survival,
    };
    x.iter().zip(survival).map(point).collect()
}
