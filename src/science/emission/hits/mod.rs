//! From waveforms to hits: threshold crossings, two time constants, features.
//!
//! A crossing of the threshold opens a hit. It ends with the last crossing before a time T1 (hit definition time) without any;
//! crossings within T2 (hit lock-out time) after T1 has run out are ignored, as secondary echoes are; peaks count within the peak
//! definition time of the first crossing only (ASTM E1316, EN 1330-9).

mod features;
pub mod picker;
mod sensitivity;
#[cfg(test)]
mod tests;

use serde::{Deserialize, Serialize};

pub use features::{Features, features};
pub use sensitivity::{SensitivityOptions, SensitivityPoint, sensitivity};

use super::error::{EmissionError, positive};

/// A stretch of waveform of one channel.
#[derive(Clone, Copy, Debug)]
pub struct Waveform<'a> {
    /// Samples, V.
    pub samples: &'a [f64],
    /// Samples a second, Hz.
    pub rate_hz: f64,
    /// Time of the first sample, s.
    pub start_s: f64,
}

/// How hits are told apart.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct HitOptions {
    /// Threshold of the absolute value, V.
    pub threshold_v: f64,
    /// Hit definition time T1, s.
    pub hit_definition_s: f64,
    /// Hit lock-out time T2, s.
    pub hit_lockout_s: f64,
    /// Peak definition time, s; none searches the whole hit for its peak.
    #[serde(default)]
    pub peak_definition_s: Option<f64>,
}

/// A hit with its features.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Hit {
    /// Sample of the first crossing.
    pub first: usize,
    /// Sample of the last crossing.
    pub last: usize,
    /// Whether the waveform ended before T1 had run out: the hit may be longer.
    pub cut: bool,
    /// Time of the first crossing, s.
    pub time_s: f64,
    /// Features.
    pub features: Features,
}

impl HitOptions {
    /// Whether the options can be used at `rate_hz`.
    ///
    /// # Errors
    /// [`EmissionError::Option`].
    pub fn check(&self, rate_hz: f64) -> Result<(), EmissionError> {
        positive("rate_hz", rate_hz)?;
        positive("threshold_v", self.threshold_v)?;
        positive("hit_definition_s", self.hit_definition_s)?;
        if !(self.hit_lockout_s.is_finite() && self.hit_lockout_s >= 0.0) {
            return Err(EmissionError::option("hit_lockout_s", self.hit_lockout_s, "a finite number of at least 0"));
        }
        self.peak_definition_s.map(|value| positive("peak_definition_s", value)).transpose()?;
        if self.hit_definition_s * rate_hz < 1.0 {
            let accepted = format!("at least one sample, {} s", 1.0 / rate_hz);
            return Err(EmissionError::option("hit_definition_s", self.hit_definition_s, accepted));
        }
        Ok(())
    }
}

/// The hits of a waveform, in the order of time. A gap of crossings of up to T1 belongs to the hit.
///
/// # Errors
/// Options or a rate out of range, a sample that is not finite.
pub fn hits(waveform: &Waveform<'_>, options: &HitOptions) -> Result<Vec<Hit>, EmissionError> {
    options.check(waveform.rate_hz)?;
    if let Some(row) = waveform.samples.iter().position(|sample| !sample.is_finite()) {
        let value = waveform.samples[row];
        return Err(EmissionError::Value { column: "waveform", row: row + 1, value, accepted: "a finite number" });
    }
    let spans = spans(waveform.samples, waveform.rate_hz, options);
    let hit = |span: Span| Hit {
        first: span.first,
        last: span.last,
        cut: span.cut,
        time_s: waveform.start_s + span.first as f64 / waveform.rate_hz,
        features: features(&waveform.samples[span.first..=span.last], waveform.rate_hz, options),
    };
    Ok(spans.into_iter().map(hit).collect())
}

/// First and last crossing of a hit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Span {
    first: usize,
    last: usize,
    cut: bool,
}

fn spans(samples: &[f64], rate_hz: f64, options: &HitOptions) -> Vec<Span> {
    // a gap of exactly T1 still belongs to the hit; the slack takes up what rounding makes of a whole number of samples
    let definition = (options.hit_definition_s * rate_hz + 1e-9).floor() as usize;
    let lockout = (options.hit_lockout_s * rate_hz + 1e-9).floor() as usize;
    let mut spans: Vec<Span> = Vec::new();
    let mut open: Option<Span> = None;
    for (i, _) in samples.iter().enumerate().filter(|(_, sample)| sample.abs() >= options.threshold_v) {
        match &mut open {
            Some(span) if i - span.last <= definition => span.last = i,
            Some(span) => {
                let free = span.last + definition + lockout;
                if i > free {
                    spans.push(*span);
                    open = Some(Span { first: i, last: i, cut: false });
                }
            }
            None => open = Some(Span { first: i, last: i, cut: false }),
        }
    }
    if let Some(mut span) = open {
        span.cut = samples.len() - 1 - span.last < definition;
        spans.push(span);
    }
    spans
}
