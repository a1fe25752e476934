//! What one station recorded on one day: the fourteen variables and the avalanche activity.

use jiff::civil::Date;
use serde::{Deserialize, Serialize};

/// A daily variable of weather or snowpack. Units are fixed: see [`Variable::unit`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Variable {
    /// Air temperature, degC.
    AirTemperature,
    /// Wind speed, m/s.
    WindSpeed,
    /// Direction the wind comes from, degrees clockwise from north.
    WindDirection,
    /// Cloud cover, %.
    CloudCover,
    /// Total snow height, cm.
    SnowHeight,
    /// New snow of 24 h, cm.
    #[serde(rename = "new_snow_24h")]
    NewSnow24h,
    /// Index of new snow, 0 (none) to 10 (heavy snow).
    NewSnowIndex,
    /// Precipitation of 24 h, mm of water.
    #[serde(rename = "precipitation_24h")]
    Precipitation24h,
    /// Rain at 900 m: 0 or 1.
    #[serde(rename = "rain_at_900m")]
    RainAt900m,
    /// Drifting snow: 0 or 1.
    SnowDrift,
    /// Foot penetration, cm.
    FootPenetration,
    /// Snow temperature, degC (never above 0).
    SnowTemperature,
    /// Insolation index, 2 to 20.
    InsolationIndex,
    /// Cumulative snow index of the season, as exported by the service that recorded it.
    CumulativeSnowIndex,
}

/// Number of variables.
pub const VARIABLES: usize = 14;

impl Variable {
    /// Every variable, in the order of [`DayRecord::values`].
    pub const ALL: [Self; VARIABLES] = [
        Self::AirTemperature,
        Self::WindSpeed,
        Self::WindDirection,
        Self::CloudCover,
        Self::SnowHeight,
        Self::NewSnow24h,
        Self::NewSnowIndex,
        Self::Precipitation24h,
        Self::RainAt900m,
        Self::SnowDrift,
        Self::FootPenetration,
        Self::SnowTemperature,
        Self::InsolationIndex,
        Self::CumulativeSnowIndex,
    ];

    /// The name in JSON, CSV and feature names.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::AirTemperature => "air_temperature",
            Self::WindSpeed => "wind_speed",
            Self::WindDirection => "wind_direction",
            Self::CloudCover => "cloud_cover",
            Self::SnowHeight => "snow_height",
            Self::NewSnow24h => "new_snow_24h",
            Self::NewSnowIndex => "new_snow_index",
            Self::Precipitation24h => "precipitation_24h",
            Self::RainAt900m => "rain_at_900m",
            Self::SnowDrift => "snow_drift",
            Self::FootPenetration => "foot_penetration",
            Self::SnowTemperature => "snow_temperature",
            Self::InsolationIndex => "insolation_index",
            Self::CumulativeSnowIndex => "cumulative_snow_index",
        }
    }

    /// The unit of the variable in JSON and everywhere inside; `1` for an index, `bool` for 0 or 1.
    #[must_use]
    pub const fn unit(self) -> &'static str {
        match self {
            Self::AirTemperature | Self::SnowTemperature => "degC",
            Self::WindSpeed => "m/s",
            Self::WindDirection => "deg",
            Self::CloudCover => "%",
            Self::SnowHeight | Self::NewSnow24h | Self::FootPenetration => "cm",
            Self::Precipitation24h => "mm",
            Self::RainAt900m | Self::SnowDrift => "bool",
            Self::NewSnowIndex | Self::InsolationIndex | Self::CumulativeSnowIndex => "1",
        }
    }

    /// True for a variable that is either 0 or 1.
    #[must_use]
    pub const fn is_boolean(self) -> bool {
        matches!(self, Self::RainAt900m | Self::SnowDrift)
    }

    /// The variable of that [`Variable::name`].
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|v| v.name() == name)
    }

    /// Position in [`DayRecord::values`].
    #[must_use]
    pub const fn index(self) -> usize {
        self as usize
    }
}

/// What is known of the avalanches of a day in the region of a station.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Activity {
    /// At least one avalanche was seen.
    Observed,
    /// None was seen but avalanches were judged likely.
    Presumed,
    /// None was seen and none was judged likely.
    None,
    /// Nobody could say. Never counted as [`Activity::None`].
    Unknown,
}

/// Which [`Activity`] counts as an avalanche day.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Label {
    /// A day with an observed avalanche.
    Observed,
    /// A day with an avalanche that was observed or judged likely.
    Presumed,
}

impl Label {
    /// Whether a day of that activity is an avalanche day; `None` where it is unknown.
    #[must_use]
    pub const fn of(self, activity: Activity) -> Option<bool> {
        match (self, activity) {
            (_, Activity::Unknown) => None,
            (_, Activity::Observed) | (Self::Presumed, Activity::Presumed) => Some(true),
            (_, Activity::None) | (Self::Observed, Activity::Presumed) => Some(false),
        }
    }
}

/// One calendar day of one station; a missing value is `None`, never 0.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct DayRecord {
    /// The station's local calendar day.
    pub date: Date,
    /// Values in the order of [`Variable::ALL`], in the units of [`Variable::unit`].
    pub values: [Option<f64>; VARIABLES],
    /// Avalanche activity of the day.
    pub activity: Activity,
}

impl DayRecord {
    /// A day of which nothing is known yet.
    #[must_use]
    pub const fn empty(date: Date) -> Self {
        Self { date, values: [None; VARIABLES], activity: Activity::Unknown }
    }

    /// The value of `variable`, `None` where it is missing.
    #[must_use]
    pub const fn value(&self, variable: Variable) -> Option<f64> {
        self.values[variable.index()]
    }
}

/// The year in which the season of `date` begins; a northern winter begins on 1 July, so 2007-03-01 belongs to 2006.
#[must_use]
pub fn season_of(date: Date) -> i16 {
    if date.month() >= 7 { date.year() } else { date.year() - 1 }
}

/// Days from 1 July, on which the season of `date` begins, to `date`: 0 to 365.
#[must_use]
pub fn day_of_season(date: Date) -> i16 {
    // 184 days from 1 July to 31 December; 1 July is day 182 of a common year
    if date.month() >= 7 {
        date.day_of_year() - if date.in_leap_year() { 183 } else { 182 }
    } else {
        date.day_of_year() + 183
    }
}

#[cfg(test)]
mod tests {
    use jiff::civil::date;

    use super::*;

    #[test]
    fn day_of_season_counts_from_1_july_in_common_and_leap_years() {
        for year in [1999, 2000, 2001, 2019, 2020, 2100] {
            let first = date(year, 7, 1);
            for (n, day) in first.series(jiff::Span::new().days(1)).take(365).enumerate() {
                assert_eq!((season_of(day), usize::try_from(day_of_season(day))), (year, Ok(n)), "{day}");
            }
        }
        assert_eq!(day_of_season(date(2020, 6, 30)), 365);
    }
}
