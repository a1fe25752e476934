//! What no history and no set of variables may break.

use jiff::civil::{Date, date};
use proptest::prelude::*;

use crate::forecast::day::{Activity, DayRecord, VARIABLES, Variable, season_of};
use crate::forecast::features::{FeatureSet, FeatureSetId, History};

fn activity() -> impl Strategy<Value = Activity> {
    prop::sample::select(vec![Activity::Observed, Activity::Presumed, Activity::None, Activity::Unknown])
}

/// Values of one day: any number, most of them of an ordinary size, about one in five missing.
fn values() -> impl Strategy<Value = [Option<f64>; VARIABLES]> {
    let number = prop_oneof![8 => -50.0..400.0, 2 => Just(0.0), 1 => any::<f64>()];
    prop::array::uniform(prop::option::weighted(0.8, number))
}

/// Up to 24 days around the season edge of 1 July 2020, with gaps of up to three days.
fn days() -> impl Strategy<Value = Vec<DayRecord>> {
    prop::collection::vec((1_i32..4, values(), activity()), 1..25).prop_map(|list| {
        let mut day = date(2020, 6, 12);
        let next = |(gap, values, activity)| {
            day = day.saturating_add(jiff::Span::new().days(gap));
            DayRecord { date: day, values, activity }
        };
        list.into_iter().map(next).collect()
    })
}

fn subset() -> impl Strategy<Value = Vec<Variable>> {
    prop::sample::subsequence(Variable::ALL.to_vec(), 0..=VARIABLES)
}

fn expert(days: &[DayRecord], reported: &[Variable], base: Date) -> Vec<u64> {
    let row = FeatureSet::new(FeatureSetId::Expert, reported).compute(&History::new(days).unwrap(), base);
    row.into_iter().map(f64::to_bits).collect()
}

proptest! {
    #[test]
    fn later_days_and_the_activity_of_the_day_itself_change_nothing(
        days in days(), other in days(), same_day in activity(), at in any::<prop::sample::Index>(),
    ) {
        let at = at.index(days.len());
        let base = days[at].date;
        let before = expert(&days, &Variable::ALL, base);
        let mut changed: Vec<_> = days[..=at].to_vec();
        changed[at].activity = same_day;
        changed.extend(other.iter().filter(|day| day.date > base));
        prop_assert_eq!(before, expert(&changed, &Variable::ALL, base));
    }

    #[test]
    fn days_before_the_season_change_nothing(days in days(), at in any::<prop::sample::Index>()) {
        let base = days[at.index(days.len())].date;
        let season: Vec<_> = days.iter().copied().filter(|day| season_of(day.date) == season_of(base)).collect();
        prop_assert_eq!(expert(&days, &Variable::ALL, base), expert(&season, &Variable::ALL, base));
    }

    #[test]
    fn every_set_of_variables_gives_unique_names_and_reads_only_those(
        days in days(), reported in subset(), at in any::<prop::sample::Index>(),
    ) {
        let base = days[at.index(days.len())].date;
        for id in FeatureSetId::ALL {
            let set = FeatureSet::new(id, &reported);
            let mut names = set.names();
            names.sort_unstable();
            names.dedup();
            prop_assert_eq!(names.len(), set.len());
            prop_assert_eq!(set.features.iter().all(|f| f.inputs.iter().all(|v| reported.contains(v))), true);
            prop_assert_eq!(set.features.iter().all(|f| f.lag_days <= 2), true);
            let mut reversed = reported.clone();
            reversed.reverse();
            prop_assert_eq!(&set, &FeatureSet::new(id, &reversed));
            prop_assert_eq!(set.is_empty(), set.compute(&History::new(&days).unwrap(), base).is_empty());
        }
        // what a station does not report is not read
        let mut bare = days.clone();
        for day in &mut bare {
            for variable in Variable::ALL.into_iter().filter(|v| !reported.contains(v)) {
                day.values[variable.index()] = None;
            }
        }
        prop_assert_eq!(expert(&days, &reported, base), expert(&bare, &reported, base));
    }
}
