//! What columns are called in files, and the units that their names carry.

use serde::{Deserialize, Serialize};

use crate::science::emission::catalogue::Column;

/// The unit of a column of amplitudes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String")]
pub enum AmplitudeUnit {
    /// Volts behind the preamplifier.
    #[serde(rename = "v")]
    Volt,
    /// Millivolts behind the preamplifier.
    #[serde(rename = "mv")]
    Millivolt,
    /// Microvolts behind the preamplifier.
    #[serde(rename = "uv")]
    Microvolt,
    /// Decibels, re 1 uV at the sensor.
    #[serde(rename = "db_ae")]
    DecibelAe,
}

/// A unit that nobody knows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("must be one of {}", AmplitudeUnit::LIST)]
pub struct UnknownUnit;

impl AmplitudeUnit {
    /// The accepted names, in words.
    pub const LIST: &'static str = "v, mv, uv or db_ae";

    /// The name that requests and descriptions use.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Volt => "v",
            Self::Millivolt => "mv",
            Self::Microvolt => "uv",
            Self::DecibelAe => "db_ae",
        }
    }

    /// The column that holds it, and the factor that makes its unit.
    #[must_use]
    pub const fn column(self) -> (Column, f64) {
        match self {
            Self::Volt => (Column::AmplitudeV, 1.0),
            Self::Millivolt => (Column::AmplitudeV, 1e-3),
            Self::Microvolt => (Column::AmplitudeV, 1e-6),
            Self::DecibelAe => (Column::AmplitudeDb, 1.0),
        }
    }
}

impl std::str::FromStr for AmplitudeUnit {
    type Err = UnknownUnit;

    /// Reads a unit as people write it: `V`, `mV`, `µV`, `dB`, `dB_AE`.
    fn from_str(text: &str) -> Result<Self, Self::Err> {
        match folded(text).as_str() {
            "v" => Ok(Self::Volt),
            "mv" => Ok(Self::Millivolt),
            "uv" => Ok(Self::Microvolt),
            "db" | "dbae" | "db_ae" => Ok(Self::DecibelAe),
            _ => Err(UnknownUnit),
        }
    }
}

impl TryFrom<String> for AmplitudeUnit {
    type Error = UnknownUnit;

    fn try_from(text: String) -> Result<Self, Self::Error> {
        text.parse()
    }
}

/// What a column of a file holds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Meaning {
    /// Amplitudes, in the unit that the name says if it says one.
    Amplitude(Option<AmplitudeUnit>),
    /// Values of a canonical column, once they are multiplied.
    Values(Column, f64),
}

/// A canonical column, its names in files, its units with their factors; the first unit is that of a bare name.
struct Concept(Column, &'static [&'static str], &'static [(&'static str, f64)]);

const TIMES: &[(&str, f64)] = &[("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("min", 60.0), ("h", 3600.0)];
const SHORT_TIMES: &[(&str, f64)] = &[("us", 1.0), ("ns", 1e-3), ("ms", 1e3), ("s", 1e6)];
const LENGTHS: &[(&str, f64)] = &[("m", 1.0), ("cm", 1e-2), ("mm", 1e-3)];
const AREAS: &[(&str, f64)] = &[("m2", 1.0), ("mm2", 1e-6)];
const NONE: &[(&str, f64)] = &[];

const CONCEPTS: [Concept; 21] = [
    Concept(Column::TimeS, &["time", "t", "arrival_time", "toa", "ssssssss.mmmuuun"], TIMES),
    Concept(Column::DurationUs, &["duration", "dur"], SHORT_TIMES),
    Concept(Column::RiseTimeUs, &["rise_time", "risetime", "rise", "riset"], SHORT_TIMES),
    Concept(Column::Counts, &["counts", "count", "coun", "cnts"], NONE),
    // absolute energies in aJ are eu where they were measured at 10 kOhm, as the recorders of both makers do
    Concept(
        Column::EnergyEu,
        &["energy", "eny", "abs_energy", "absolute_energy"],
        &[("eu", 1.0), ("aj", 1.0), ("v2s", 1e14)],
    ),
    Concept(Column::Channel, &["channel", "chan", "ch", "chid"], NONE),
    Concept(Column::ThresholdDb, &["threshold", "thr"], &[("db", 1.0), ("dbae", 1.0), ("db_ae", 1.0)]),
    Concept(Column::XM, &["x", "pos_x"], LENGTHS),
    Concept(Column::YM, &["y", "pos_y"], LENGTHS),
    Concept(Column::ZM, &["z", "pos_z"], LENGTHS),
    Concept(Column::Strain, &["strain"], &[("1", 1.0), ("%", 1e-2), ("percent", 1e-2)]),
    Concept(Column::StressMpa, &["stress"], &[("mpa", 1.0), ("kpa", 1e-3), ("pa", 1e-6)]),
    Concept(Column::Phase, &["phase"], NONE),
    Concept(Column::XSeM, &["x_se"], LENGTHS),
    Concept(Column::YSeM, &["y_se"], LENGTHS),
    Concept(Column::ZSeM, &["z_se"], LENGTHS),
    Concept(Column::XyCovM2, &["xy_cov"], AREAS),
    Concept(Column::XzCovM2, &["xz_cov"], AREAS),
    Concept(Column::YzCovM2, &["yz_cov"], AREAS),
    Concept(Column::ResidualUs, &["residual"], SHORT_TIMES),
    Concept(Column::Channels, &["channels"], NONE),
];

const AMPLITUDES: [&str; 6] = ["amplitude", "amp", "ampl", "peak_amplitude", "a0", "a"];

/// What a column called `header` holds: a canonical name, an alias, either with a unit behind `_` or in brackets.
pub(super) fn meaning(header: &str) -> Option<Meaning> {
    let (name, unit) = apart(header);
    let of = |known: &str| -> Option<Option<String>> {
        if name == known {
            return Some(unit.clone());
        }
        // a unit behind the name and another one in brackets would contradict each other
        let behind = name.strip_prefix(known)?.strip_prefix('_')?;
        unit.is_none().then(|| Some(behind.to_owned()))
    };
    for known in AMPLITUDES {
        match of(known) {
            Some(None) => return Some(Meaning::Amplitude(None)),
            Some(Some(unit)) => {
                if let Ok(unit) = unit.parse() {
                    return Some(Meaning::Amplitude(Some(unit)));
                }
            }
            None => {}
        }
    }
    for Concept(column, names, units) in &CONCEPTS {
        for known in *names {
            match of(known) {
                Some(None) => return Some(Meaning::Values(*column, units.first().map_or(1.0, |unit| unit.1))),
                Some(Some(unit)) => {
                    if let Some((_, factor)) = units.iter().find(|(name, _)| *name == unit) {
                        return Some(Meaning::Values(*column, *factor));
                    }
                }
                None => {}
            }
        }
    }
    None
}

/// Name and unit of a header such as `Rise Time [µs]`.
fn apart(header: &str) -> (String, Option<String>) {
    let folded = folded(header);
    let brackets = [('[', ']'), ('(', ')')].into_iter().find_map(|(open, close)| {
        let (name, rest) = folded.split_once(open)?;
        // brackets that end sooner stand in a line that was split at the wrong separator
        let unit = rest.strip_suffix(close).filter(|unit| !unit.contains(close))?;
        Some((name.trim_end_matches('_').to_owned(), unit.trim_matches('_').to_owned()))
    });
    brackets.map_or_else(|| (folded.clone(), None), |(name, unit)| (name, Some(unit)))
}

/// Small letters, `_` between words, `u` for micro.
fn folded(text: &str) -> String {
    let text = text.trim_matches(|c: char| c.is_whitespace() || matches!(c, '"' | '\'' | '\u{feff}'));
    let fold = |c: char| match c {
        'µ' | 'μ' => 'u',
        c if c.is_whitespace() || c == '-' => '_',
        c => c.to_ascii_lowercase(),
    };
    text.chars().map(fold).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_canonical_name_is_its_own_column() {
        for column in Column::ALL {
            let expected = match column {
                Column::AmplitudeV => Meaning::Amplitude(Some(AmplitudeUnit::Volt)),
                Column::AmplitudeDb => Meaning::Amplitude(Some(AmplitudeUnit::DecibelAe)),
                column => Meaning::Values(column, 1.0),
            };
            assert_eq!(meaning(column.name()), Some(expected), "{}", column.name());
        }
    }

    #[test]
    fn aliases_and_units_are_understood() {
        let values = |column, factor| Some(Meaning::Values(column, factor));
        assert_eq!(meaning("SSSSSSSS.mmmuuun"), values(Column::TimeS, 1.0));
        assert_eq!(meaning("Rise Time [µs]"), values(Column::RiseTimeUs, 1.0));
        assert_eq!(meaning("duration (ms)"), values(Column::DurationUs, 1e3));
        assert_eq!(meaning("ABS-ENERGY"), values(Column::EnergyEu, 1.0));
        assert_eq!(meaning("\"x_mm\""), values(Column::XM, 1e-3));
        assert_eq!(meaning("Strain [%]"), values(Column::Strain, 1e-2));
        assert_eq!(meaning("AMP"), Some(Meaning::Amplitude(None)));
        assert_eq!(meaning("Amplitude [dB_AE]"), Some(Meaning::Amplitude(Some(AmplitudeUnit::DecibelAe))));
        assert_eq!(meaning("amplitude_mV"), Some(Meaning::Amplitude(Some(AmplitudeUnit::Millivolt))));
    }

    #[test]
    fn what_is_not_known_is_not_guessed() {
        // the energy counts of Mistras are no V2s, and counts are no unit of an amplitude
        for header in ["ENER", "amplitude [counts]", "duration_weeks", "x_v [m]", "", "rms", "Time [s], Amp [V]"] {
            assert_eq!(meaning(header), None, "{header}");
        }
    }
}
