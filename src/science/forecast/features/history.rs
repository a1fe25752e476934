//! The days of one station, found by calendar date and never across the edge of a season.

use jiff::civil::Date;
use thiserror::Error;

use crate::forecast::day::{DayRecord, season_of};

/// The oldest lag, in days, that a feature other than a season sum may read.
pub(super) const REACH: usize = 10;

/// Why a list of days is no history.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum HistoryError {
    /// A date is repeated, or earlier than the one before it.
    #[error("day {index} ({date}) does not come after the day before it in the list ({previous})")]
    Order {
        /// Position of the offending day.
        index: usize,
        /// Its date.
        date: Date,
        /// Date of the day that precedes it in the list.
        previous: Date,
    },
}

/// An index over the days of one station: O(1) look-up by calendar date, seasons known.
///
/// Memory: 4 bytes for every calendar day from the first to the last (jiff knows fewer than 7.4 million of them).
#[derive(Clone, Debug)]
pub struct History<'a> {
    days: &'a [DayRecord],
    /// For each calendar day since the first: how many recorded days are dated up to and including it.
    dated_until: Vec<u32>,
    /// For each recorded day: position of the first recorded day of its season.
    opening: Vec<u32>,
}

impl<'a> History<'a> {
    /// Indexes `days`, which are in strictly rising order of date; gaps are allowed.
    ///
    /// # Errors
    /// [`HistoryError::Order`] at the first date that is repeated or goes back.
    pub fn new(days: &'a [DayRecord]) -> Result<Self, HistoryError> {
        let mut dated_until = Vec::new();
        let mut opening: Vec<u32> = Vec::with_capacity(days.len());
        for (i, day) in days.iter().enumerate() {
            let position = i as u32; // unique dates: far below 2^32
            let Some(previous) = i.checked_sub(1).map(|p| days[p].date) else {
                dated_until.push(1);
                opening.push(0);
                continue;
            };
            if day.date <= previous {
                return Err(HistoryError::Order { index: i, date: day.date, previous });
            }
            let slot = days_between(days[0].date, day.date).unsigned_abs() as usize;
            dated_until.resize(slot, position);
            dated_until.push(position + 1);
            opening.push(if season_of(previous) == season_of(day.date) { opening[i - 1] } else { position });
        }
        Ok(Self { days, dated_until, opening })
    }

    /// All days, in order of date.
    #[must_use]
    pub fn days(&self) -> &'a [DayRecord] {
        self.days
    }

    /// The record of `date`, `None` where that calendar day is not recorded.
    #[must_use]
    pub fn day(&self, date: Date) -> Option<&'a DayRecord> {
        self.days[..self.count_until(date)].last().filter(|day| day.date == date)
    }

    /// The recorded days of the season of `base` up to and including `base`, in order of date.
    #[must_use]
    pub fn season_until(&self, base: Date) -> &'a [DayRecord] {
        let end = self.count_until(base);
        match end.checked_sub(1) {
            Some(last) if season_of(self.days[last].date) == season_of(base) => {
                &self.days[self.opening[last] as usize..end]
            }
            _ => &[],
        }
    }

    /// Number of recorded days dated `date` or earlier.
    fn count_until(&self, date: Date) -> usize {
        let Some(first) = self.days.first() else { return 0 };
        match usize::try_from(days_between(first.date, date)) {
            Ok(slot) => self.dated_until.get(slot).map_or(self.days.len(), |&n| n as usize),
            Err(_) => 0,
        }
    }
}

/// What the features of one base date may read: its season, up to that date.
pub(super) struct Window<'a> {
    pub(super) base: Date,
    /// Recorded days of the season up to the base, in order of date.
    pub(super) season: &'a [DayRecord],
    /// The record `lag` calendar days before the base, `None` where missing or in another season.
    lags: [Option<&'a DayRecord>; REACH + 1],
}

impl<'a> Window<'a> {
    pub(super) fn new(history: &History<'a>, base: Date) -> Self {
        let season = history.season_until(base);
        let mut lags = [None; REACH + 1];
        for day in season.iter().rev() {
            let lag = usize::try_from(days_between(day.date, base)).ok();
            let Some(slot) = lag.and_then(|lag| lags.get_mut(lag)) else { break };
            *slot = Some(day);
        }
        Self { base, season, lags }
    }

    /// The record `lag` calendar days before the base; `None` also beyond [`REACH`].
    pub(super) fn lag(&self, lag: usize) -> Option<&'a DayRecord> {
        self.lags.get(lag).copied().flatten()
    }
}

/// Calendar days from `from` to `to`, negative where `to` is earlier.
fn days_between(from: Date, to: Date) -> i64 {
    to.duration_since(from).as_secs() / 86_400
}
