//! Features of a hit.

use serde::{Deserialize, Serialize};

use super::HitOptions;

/// Features of a hit (EN 1330-9).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Features {
    /// Largest absolute value within the peak definition time, V.
    pub amplitude_v: f64,
    /// From the first to the last crossing, us.
    pub duration_us: f64,
    /// From the first crossing to the peak, us.
    pub rise_time_us: f64,
    /// Crossings of the positive threshold from below.
    pub counts: u32,
    /// Integral of the squared voltage from the first to the last crossing, eu = 1e-14 V2s.
    pub energy_eu: f64,
    /// Counts over duration, kHz; missing for a hit of one sample.
    pub average_frequency_khz: Option<f64>,
    /// RA value: rise time over amplitude, us/V.
    pub ra_us_per_v: f64,
}

/// Features of `samples` (V), from the first to the last crossing of a hit, at `rate_hz`.
#[must_use]
pub fn features(samples: &[f64], rate_hz: f64, options: &HitOptions) -> Features {
    let microseconds = |samples: usize| samples as f64 / rate_hz * 1e6;
    let searched = options
        .peak_definition_s
        .map_or(samples.len(), |time| ((time * rate_hz + 1e-9).floor() as usize).saturating_add(1).min(samples.len()));
    let mut peak = 0;
    for (i, sample) in samples[..searched].iter().enumerate() {
        if sample.abs() > samples[peak].abs() {
            peak = i;
        }
    }
    // the sample before the first one was below the threshold
    let mut counts = 0;
    let mut above = false;
    for sample in samples {
        let now = *sample >= options.threshold_v;
        counts += u32::from(now && !above);
        above = now;
    }
    let amplitude_v = samples.get(peak).map_or(0.0, |sample| sample.abs());
    let duration_us = microseconds(samples.len().saturating_sub(1));
    let rise_time_us = microseconds(peak);
    Features {
        amplitude_v,
        duration_us,
        rise_time_us,
        counts,
        energy_eu: samples.iter().map(|sample| sample * sample).sum::<f64>() / rate_hz / 1e-14,
        average_frequency_khz: (duration_us > 0.0).then(|| f64::from(counts) / duration_us * 1e3),
        ra_us_per_v: rise_time_us / amplitude_v,
    }
}
