//! The days that a model can be trained and scored on.

use std::ops::Range;

use jiff::ToSpan;
use jiff::civil::Date;

use crate::forecast::day::{DayRecord, Label, Variable, day_of_season, season_of};
use crate::forecast::features::{FeatureSet, History};
use crate::forecast::matrix::Matrix;
use crate::forecast::region;

/// Scorable days in order of date, one row each: the label of the target day is known, and the base day and the two
/// calendar days before it are recorded in the same season. Of several stations there is a row for each that can be
/// scored on a day; they stand next to each other and have the same label, which is that of the region.
///
/// A day counts as recorded where it has a value of a variable that a feature is computed from.
#[derive(Clone, Debug)]
pub(crate) struct Samples {
    /// Target days.
    pub(crate) date: Vec<Date>,
    /// Position of the station among those that were pooled; 0 where there is one.
    pub(crate) station: Vec<usize>,
    /// Whether the target day is an avalanche day.
    pub(crate) event: Vec<bool>,
    /// Label of the calendar day before the target day, the newest that is known when a forecast for it is issued.
    pub(crate) yesterday: Vec<Option<bool>>,
    /// Days since 1 July of the target day.
    pub(crate) day_of_season: Vec<i16>,
    /// Features of the base day, as computed: NaN is missing.
    pub(crate) features: Matrix,
    /// Reported variables of the base day: NaN is missing.
    pub(crate) variables: Matrix,
    /// Position in [`Self::seasons`] of the season of the target day.
    pub(crate) season: Vec<usize>,
    /// Years in which the seasons begin, rising.
    pub(crate) seasons: Vec<i16>,
}

impl Samples {
    pub(crate) fn collect(history: &History<'_>, set: &FeatureSet, label: Label, lead: u8) -> Self {
        let read = variables_read(set);
        let scorable: Vec<(Date, Date, bool)> = history
            .days()
            .iter()
            .filter_map(|day| Some((day.date, base_day(history, &read, day.date, lead)?, label.of(day.activity)?)))
            .collect();
        let date: Vec<Date> = scorable.iter().map(|&(date, ..)| date).collect();
        let base: Vec<Date> = scorable.iter().map(|&(_, base, _)| base).collect();

        let season_year: Vec<i16> = date.iter().map(|&d| season_of(d)).collect();
        let mut seasons = season_year.clone();
        seasons.dedup();
        let position = |year: &i16| seasons.partition_point(|s| s < year);

        let yesterday = |&d: &Date| label.of(history.day(before(d, 1)?)?.activity);
        Self {
            event: scorable.iter().map(|&(.., event)| event).collect(),
            yesterday: date.iter().map(yesterday).collect(),
            day_of_season: date.iter().map(|&d| day_of_season(d)).collect(),
            features: set.matrix(history, &base),
            variables: base_day_variables(history, set, &base),
            season: season_year.iter().map(position).collect(),
            seasons,
            station: vec![0; date.len()],
            date,
        }
    }

    /// The rows of several stations in order of date, those of a day in the order of the stations.
    pub(crate) fn pool(mut stations: Vec<Self>) -> Self {
        if stations.len() == 1
            && let Some(only) = stations.pop()
        {
            return only;
        }
        let mut order: Vec<(Date, usize, usize)> = stations
            .iter()
            .enumerate()
            .flat_map(|(s, samples)| samples.date.iter().enumerate().map(move |(i, &date)| (date, s, i)))
            .collect();
        order.sort_unstable();
        let mut seasons: Vec<i16> = order.iter().map(|&(date, ..)| season_of(date)).collect();
        let season = seasons.clone();
        seasons.dedup();
        let stack = |matrix: fn(&Self) -> &Matrix| {
            let cols = stations.first().map_or(0, |first| matrix(first).cols());
            let data = order.iter().flat_map(|&(_, s, i)| matrix(&stations[s]).row(i).iter().copied()).collect();
            // every station has the columns of the same set
            Matrix::from_rows(order.len(), cols, data).unwrap_or_else(|| Matrix::filled(0, cols, f64::NAN))
        };
        Self {
            date: order.iter().map(|&(date, ..)| date).collect(),
            station: order.iter().map(|&(_, s, _)| s).collect(),
            event: order.iter().map(|&(_, s, i)| stations[s].event[i]).collect(),
            yesterday: order.iter().map(|&(_, s, i)| stations[s].yesterday[i]).collect(),
            day_of_season: order.iter().map(|&(_, s, i)| stations[s].day_of_season[i]).collect(),
            features: stack(|samples| &samples.features),
            variables: stack(|samples| &samples.variables),
            season: season.iter().map(|year| seasons.partition_point(|s| s < year)).collect(),
            seasons,
        }
    }

    /// Number of rows: scorable days of stations.
    pub(crate) fn len(&self) -> usize {
        self.date.len()
    }

    /// Rows of the seasons at the positions that `keep` accepts.
    pub(crate) fn rows_of(&self, keep: impl Fn(usize) -> bool) -> Vec<usize> {
        (0..self.len()).filter(|&i| keep(self.season[i])).collect()
    }

    /// The days of `rows`, which are rising: for each the positions in `rows` of the stations that can be scored on it.
    pub(crate) fn days_of(&self, rows: &[usize]) -> Vec<Range<usize>> {
        let mut days: Vec<Range<usize>> = Vec::new();
        for (at, &row) in rows.iter().enumerate() {
            match days.last_mut() {
                Some(day) if self.date[rows[day.start]] == self.date[row] => day.end = at + 1,
                _ => days.push(at..at + 1),
            }
        }
        days
    }
}

/// What several stations say of a day: the mean of their `values`, one a row. A single value keeps its bits.
pub(crate) fn by_day(days: &[Range<usize>], values: &[f64]) -> Vec<f64> {
    days.iter().map(|day| region::mean(&values[day.clone()])).collect()
}

/// The first of the `values` of each day, which all its rows share.
pub(crate) fn first_of<T: Copy>(days: &[Range<usize>], values: &[T]) -> Vec<T> {
    days.iter().map(|day| values[day.start]).collect()
}

/// The base day of a target day, `None` where it or one of the two days before it is not recorded in the same season.
fn base_day(history: &History<'_>, read: &[Variable], target: Date, lead: u8) -> Option<Date> {
    let base = before(target, i32::from(lead))?;
    let recorded = |lag| {
        let day = history.day(before(base, lag)?)?;
        (season_of(day.date) == season_of(target) && is_recorded(day, read)).then_some(())
    };
    (0..=2).try_for_each(recorded)?;
    Some(base)
}

/// `days` calendar days before `date`; `None` before the first date of the calendar.
pub(crate) fn before(date: Date, days: i32) -> Option<Date> {
    date.checked_sub(days.days()).ok()
}

/// Whether the day has a value of one of `variables`.
pub(crate) fn is_recorded(day: &DayRecord, variables: &[Variable]) -> bool {
    variables.iter().any(|&v| day.value(v).is_some())
}

/// The variables that the features of `set` are computed from.
pub(crate) fn variables_read(set: &FeatureSet) -> Vec<Variable> {
    set.reported.iter().copied().filter(|v| set.features.iter().any(|f| f.inputs.contains(v))).collect()
}

/// Days x reported variables; without the cumulative snow index, whose value says more of the date than of the day.
fn base_day_variables(history: &History<'_>, set: &FeatureSet, base: &[Date]) -> Matrix {
    let variables: Vec<Variable> =
        set.reported.iter().copied().filter(|&v| v != Variable::CumulativeSnowIndex).collect();
    let mut matrix = Matrix::filled(base.len(), variables.len(), f64::NAN);
    for (i, &date) in base.iter().enumerate() {
        let Some(day) = history.day(date) else { continue };
        for (entry, &variable) in matrix.row_mut(i).iter_mut().zip(&variables) {
            *entry = day.value(variable).unwrap_or(f64::NAN);
        }
    }
    matrix
}
