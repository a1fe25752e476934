//! Regions: several stations that feed one model.
//!
//! The event is the region's: a day on which avalanches were recorded at a stated number of its stations, one as a rule
//! (Pozdnoukhov, Purves & Kanevski 2008: a day with at least one recorded avalanche in the region). [`regional`] gives the
//! days of each station that activity; trained together
//! ([`train_pooled`](super::model::train_pooled)) every station and day is a row, and the probability of the region is the
//! [`mean`] of what the model says of its stations.

use jiff::civil::Date;
use serde::{Deserialize, Serialize};

use super::day::{Activity, DayRecord, Label};

/// What a region is when not every station has a word on a day.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Quiet {
    /// A day is quiet where it would be whatever the stations that are silent had seen; else it is unknown.
    #[default]
    EveryStation,
    /// A day is quiet where one station says so and too few say otherwise: what nobody recorded counts as none.
    AnyStation,
}

/// What an avalanche day of a region is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RegionRule {
    /// Stations with an avalanche that make an avalanche day of the region, 1 or more.
    pub stations: usize,
    /// What makes a quiet one.
    pub quiet: Quiet,
}

impl Default for RegionRule {
    fn default() -> Self {
        Self { stations: 1, quiet: Quiet::default() }
    }
}

impl RegionRule {
    /// Whether a day is an avalanche day of the region; `None` where that is unknown. `activity` has one entry a station.
    #[must_use]
    pub fn label(self, label: Label, activity: &[Activity]) -> Option<bool> {
        let of = |wanted: Option<bool>| activity.iter().filter(|&&a| label.of(a) == wanted).count();
        let (events, silent, quiet) = (of(Some(true)), of(None), of(Some(false)));
        if events >= self.stations {
            Some(true)
        } else if events + silent < self.stations || (self.quiet == Quiet::AnyStation && quiet > 0) {
            Some(false)
        } else {
            None
        }
    }

    /// The activity of the region on a day, whose [`Label::of`] is [`RegionRule::label`]: observed or presumed where enough
    /// stations are, none where the day is quiet, else unknown.
    #[must_use]
    pub fn activity(self, label: Label, activity: &[Activity]) -> Activity {
        let is = |label| self.label(label, activity);
        match (label, is(Label::Observed), is(Label::Presumed)) {
            (_, Some(true), _) => Activity::Observed,
            (Label::Observed, None, _) | (Label::Presumed, _, None) => Activity::Unknown,
            (Label::Observed, Some(false), Some(true)) | (Label::Presumed, _, Some(true)) => Activity::Presumed,
            (Label::Observed, Some(false), _) | (Label::Presumed, _, Some(false)) => Activity::None,
        }
    }
}

/// The days of each of `stations` (rising dates) with the activity of the region, for models of `label`: what happened in the
/// region is known at every station, also on days on which that one recorded nothing.
///
/// Every station gets the dates of all of them. A date of which a station has no record is one without values.
#[must_use]
pub fn regional(stations: &[&[DayRecord]], rule: RegionRule, label: Label) -> Vec<Vec<DayRecord>> {
    let mut dates: Vec<Date> = stations.iter().flat_map(|days| days.iter().map(|day| day.date)).collect();
    dates.sort_unstable();
    dates.dedup();
    let of = |days: &[DayRecord], date: Date| days.binary_search_by_key(&date, |day| day.date).ok().map(|at| days[at]);
    let activity = |&date: &Date| {
        let each: Vec<Activity> =
            stations.iter().map(|days| of(days, date).map_or(Activity::Unknown, |day| day.activity)).collect();
        rule.activity(label, &each)
    };
    let activity: Vec<Activity> = dates.iter().map(activity).collect();
    let day = |days: &[DayRecord], date: Date, activity: Activity| DayRecord {
        activity,
        ..of(days, date).unwrap_or_else(|| DayRecord::empty(date))
    };
    let every = |days: &&[DayRecord]| dates.iter().zip(&activity).map(|(&date, &a)| day(days, date, a)).collect();
    stations.iter().map(every).collect()
}

/// The probability of a region of which the model gave `probabilities`, one a station: their mean, `NaN` without any. That of
/// one station keeps its bits.
#[must_use]
pub fn mean(probabilities: &[f64]) -> f64 {
    probabilities.iter().sum::<f64>() / probabilities.len() as f64
}

#[cfg(test)]
mod tests;
