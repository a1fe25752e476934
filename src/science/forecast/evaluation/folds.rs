//! Folds of whole seasons: days of one winter never stand on both sides of a split.

/// Groups of seasons in the inner cross-validation; fewer where there are fewer seasons.
pub const INNER_FOLDS: usize = 5;

/// Seasons that a model and its evaluation need, with an event in each, and with a day without in each: one is held out, and
/// the inner folds of the others still have both classes in training.
pub const SEASONS_NEEDED: usize = 3;

/// Training seasons before the first season that forward chaining forecasts: 5, or 3 where that leaves fewer than 3 to forecast.
#[must_use]
pub const fn seasons_before_chaining(seasons: usize) -> usize {
    if seasons >= 8 { 5 } else { 3 }
}

/// The inner fold of each training row: seasons are dealt in turn to [`INNER_FOLDS`] groups, so that each group holds early and
/// late winters alike.
///
/// `season` and `event` belong to the training rows. Seasons with both classes are dealt first, so that no group holds all the
/// events, or all the days without, of the training seasons.
pub(crate) fn inner_folds(season: &[usize], event: &[bool]) -> Vec<usize> {
    let seasons = season.iter().max().map_or(0, |&last| last + 1);
    let mut classes = vec![(false, false); seasons];
    for (&s, &event) in season.iter().zip(event) {
        if event { classes[s].0 = true } else { classes[s].1 = true }
    }
    let mut dealt = Vec::new();
    for kind in [(true, true), (true, false), (false, true)] {
        dealt.extend((0..seasons).filter(|&s| classes[s] == kind));
    }
    let groups = dealt.len().clamp(1, INNER_FOLDS);
    let mut fold = vec![0; seasons];
    for (turn, &s) in dealt.iter().enumerate() {
        fold[s] = turn % groups;
    }
    season.iter().map(|&s| fold[s]).collect()
}

/// Number of seasons that hold an event, and number that hold a day without one.
pub(crate) fn seasons_of_each_class(rows: impl IntoIterator<Item = (usize, bool)>) -> (usize, usize) {
    let (mut events, mut others) = (std::collections::BTreeSet::new(), std::collections::BTreeSet::new());
    for (season, event) in rows {
        if event {
            events.insert(season)
        } else {
            others.insert(season)
        };
    }
    (events.len(), others.len())
}
