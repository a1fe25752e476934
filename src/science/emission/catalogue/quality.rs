//! Properties of a catalogue that make a bare exponent misleading.

use serde::{Deserialize, Serialize};

use super::{Catalogue, Column};

/// A kind of [`QualityFlag`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum FlagKind {
    /// Far more events at the lowest amplitude than just above it.
    FloorPileUp,
    /// Far more events at the largest amplitude than just below it.
    Saturation,
    /// Far more events at the longest duration than just below it.
    DurationCap,
    /// Events with the time of the one before.
    DuplicateTimes,
    /// Amplitudes in whole steps of decibels.
    DecibelResolution,
    /// Too few events for a fit.
    TooFewEvents,
}

/// Something that the reader of an exponent must know.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct QualityFlag {
    /// What it is.
    pub kind: FlagKind,
    /// Events concerned.
    pub events: usize,
    /// The amplitude (V or dB), duration (us) or step (dB) where it shows; missing for times and numbers.
    pub value: Option<f64>,
    /// The same in words.
    pub message: String,
}

/// Events in the tail below which exponents are not to be trusted (Clauset et al. 2009 find 100 for xmin, 50 for alpha).
pub const FEW_EVENTS: usize = 50;

/// How often a value at the end must occur, and by which factor more often than its neighbours, to be a pile-up.
const PILE: (usize, f64) = (5, 3.0);

/// All flags of a catalogue.
#[must_use]
pub fn quality(catalogue: &Catalogue) -> Vec<QualityFlag> {
    let mut flags = Vec::new();
    let amplitude = [Column::AmplitudeV, Column::AmplitudeDb].into_iter().find(|&c| catalogue.column(c).is_some());
    if let Some(values) = amplitude.and_then(|column| catalogue.column(column)) {
        let unit = if amplitude == Some(Column::AmplitudeV) { "V" } else { "dB" };
        let counts = Counts::of(values);
        if let Some((value, events)) = counts.pile(false) {
            let message =
                format!("{events} events at the lowest amplitude, {value} {unit}: they piled up at the floor");
            flags.push(QualityFlag { kind: FlagKind::FloorPileUp, events, value: Some(value), message });
        }
        if let Some((value, events)) = counts.pile(true) {
            let message = format!("{events} events at the largest amplitude, {value} {unit}: the recorder saturated");
            flags.push(QualityFlag { kind: FlagKind::Saturation, events, value: Some(value), message });
        }
    }
    if let Some(step) = catalogue.column(Column::AmplitudeDb).and_then(decibel_step) {
        let message = format!("amplitudes are whole multiples of {step} dB: fits are to bins");
        let events = catalogue.len();
        flags.push(QualityFlag { kind: FlagKind::DecibelResolution, events, value: Some(step), message });
    }
    if let Some((value, events)) = catalogue.column(Column::DurationUs).and_then(|d| Counts::of(d).pile(true)) {
        let message = format!("{events} events of the longest duration, {value} us: durations were cut off");
        flags.push(QualityFlag { kind: FlagKind::DurationCap, events, value: Some(value), message });
    }
    if let Some(times) = catalogue.column(Column::TimeS) {
        let events = times.windows(2).filter(|pair| pair[0] == pair[1]).count();
        if events > 0 {
            let message = format!("{events} events have the time of the event before");
            flags.push(QualityFlag { kind: FlagKind::DuplicateTimes, events, value: None, message });
        }
    }
    if catalogue.len() < FEW_EVENTS {
        flags.push(too_few(catalogue.len()));
    }
    flags
}

/// The flag of a tail with few events.
pub(in crate::emission) fn too_few(events: usize) -> QualityFlag {
    let message = format!("{events} events, fewer than {FEW_EVENTS}: exponents are not to be trusted");
    QualityFlag { kind: FlagKind::TooFewEvents, events, value: None, message }
}

/// Unique values with how often they occur.
struct Counts(Vec<(f64, usize)>);

impl Counts {
    fn of(values: &[f64]) -> Self {
        let mut sorted = values.to_vec();
        sorted.sort_unstable_by(f64::total_cmp);
        let mut counts: Vec<(f64, usize)> = Vec::new();
        for value in sorted {
            match counts.last_mut() {
                Some(last) if last.0 == value => last.1 += 1,
                _ => counts.push((value, 1)),
            }
        }
        Self(counts)
    }

    /// The value at an end and its count, if it occurs far more often than each of its three neighbours.
    fn pile(&self, at_the_top: bool) -> Option<(f64, usize)> {
        let mut values: Vec<(f64, usize)> = if at_the_top {
            self.0.iter().rev().take(4).copied().collect()
        } else {
            self.0.iter().take(4).copied().collect()
        };
        if values.len() < 4 {
            return None;
        }
        let (value, count) = values.remove(0);
        let neighbour = values.iter().map(|v| v.1).max().unwrap_or(0);
        (count >= PILE.0 && count as f64 > PILE.1 * neighbour as f64).then_some((value, count))
    }
}

/// The step (dB) of which all `decibels` are whole multiples, one of 0.05 to 3 dB. `None` where there is none,
/// or all values agree.
#[must_use]
pub fn decibel_step(decibels: &[f64]) -> Option<f64> {
    const STEPS: [f64; 9] = [3.0, 2.0, 1.5, 1.0, 0.5, 0.25, 0.2, 0.1, 0.05];
    let first = decibels.first()?;
    let differ = decibels.iter().any(|db| db != first);
    let is_step = |step: &f64| {
        decibels.iter().all(|db| {
            let position = db / step;
            (position - position.round()).abs() < 1e-6
        })
    };
    STEPS.into_iter().find(is_step).filter(|_| differ)
}
