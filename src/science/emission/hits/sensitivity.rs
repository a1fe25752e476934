//! How the exponent drifts with the threshold and the time constants.

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::{HitOptions, Waveform, hits};
use crate::emission::error::EmissionError;
use crate::emission::tails::{Model, Tail, fit};
use crate::progress::Progress;

/// What to scan: all combinations.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct SensitivityOptions {
    /// Thresholds, V.
    pub threshold_v: Vec<f64>,
    /// Hit definition times T1, s.
    pub hit_definition_s: Vec<f64>,
    /// Hit lock-out times T2, s.
    pub hit_lockout_s: Vec<f64>,
    /// Smallest amplitude of the fit, V; none takes each threshold.
    #[serde(default)]
    pub xmin: Option<f64>,
}

/// One combination.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct SensitivityPoint {
    /// Threshold, V.
    pub threshold_v: f64,
    /// T1, s.
    pub hit_definition_s: f64,
    /// T2, s.
    pub hit_lockout_s: f64,
    /// Hits.
    pub hits: usize,
    /// Mean duration, us; missing without hits.
    pub mean_duration_us: Option<f64>,
    /// Exponent of the power law of the amplitudes; missing with too few hits.
    pub alpha: Option<f64>,
    /// Its standard error.
    pub alpha_se: Option<f64>,
}

/// Largest number of combinations.
const MOST: usize = 10_000;

/// Extracts hits of all `waveforms` with every combination of thresholds and time constants, and fits their amplitudes.
///
/// # Errors
/// An empty list, more than 10,000 combinations, what [`hits`] refuses, or [`EmissionError::Cancelled`].
pub fn sensitivity(
    waveforms: &[Waveform<'_>],
    options: &SensitivityOptions,
    progress: &dyn Progress,
) -> Result<Vec<SensitivityPoint>, EmissionError> {
    let mut combinations = Vec::new();
    for &threshold_v in &options.threshold_v {
        for &hit_definition_s in &options.hit_definition_s {
            for &hit_lockout_s in &options.hit_lockout_s {
                combinations.push(HitOptions { threshold_v, hit_definition_s, hit_lockout_s, peak_definition_s: None });
            }
        }
    }
    if combinations.is_empty() || combinations.len() > MOST {
        let accepted = format!("1 to {MOST} combinations of threshold_v, hit_definition_s and hit_lockout_s");
        return Err(EmissionError::option("combinations", combinations.len(), accepted));
    }
    let one = |(number, hit_options): (usize, &HitOptions)| {
        if progress.cancelled() {
            return Err(EmissionError::Cancelled);
        }
        progress.report(number as f64 / combinations.len() as f64, "sensitivity scan");
        let mut found = Vec::new();
        for waveform in waveforms {
            found.extend(hits(waveform, hit_options)?);
        }
        let mut amplitudes: Vec<f64> = found.iter().map(|hit| hit.features.amplitude_v).collect();
        amplitudes.sort_by(f64::total_cmp);
        let tail = Tail::exact(&amplitudes, options.xmin.unwrap_or(hit_options.threshold_v), None);
        let fitted = tail.and_then(|tail| fit(&tail, Model::PowerLaw)).ok();
        let alpha = fitted.as_ref().and_then(|fitted| fitted.parameter("alpha"));
        let durations: f64 = found.iter().map(|hit| hit.features.duration_us).sum();
        Ok(SensitivityPoint {
            threshold_v: hit_options.threshold_v,
            hit_definition_s: hit_options.hit_definition_s,
            hit_lockout_s: hit_options.hit_lockout_s,
            hits: found.len(),
            mean_duration_us: (!found.is_empty()).then(|| durations / found.len() as f64),
            alpha: alpha.map(|alpha| alpha.value),
            alpha_se: alpha.and_then(|alpha| alpha.se),
        })
    };
    combinations.par_iter().enumerate().map(one).collect()
}
