use std::collections::BTreeSet;
use std::sync::Mutex;

use jiff::civil::{Date, date};
use proptest::prelude::*;

use super::folds::inner_folds;
use super::*;
use crate::forecast::day::{Activity, DayRecord, Label, Variable};
use crate::forecast::features::{FeatureSet, FeatureSetId, History};

fn record(date: Date, activity: Activity) -> DayRecord {
    let mut day = DayRecord::empty(date);
    day.values[Variable::AirTemperature.index()] = Some(-3.0);
    day.activity = activity;
    day
}

fn samples(days: &[DayRecord], lead: u8) -> Samples {
    let set = FeatureSet::new(FeatureSetId::Raw30, &[Variable::AirTemperature]);
    Samples::collect(&History::new(days).unwrap(), &set, Label::Observed, lead)
}

/// Days 1 to 12 of January 2000: the 6th has no weather, the 9th is not recorded, the 3rd has unknown activity.
fn january() -> Vec<DayRecord> {
    let day = |d: i8| {
        let activity = match d {
            3 => Activity::Unknown,
            4 => Activity::Observed,
            5 => Activity::Presumed,
            _ => Activity::None,
        };
        record(date(2000, 1, d), activity)
    };
    let mut days: Vec<DayRecord> = (1..=12).filter(|&d| d != 9).map(day).collect();
    days[5].values = DayRecord::empty(days[5].date).values;
    days
}

#[test]
fn scorable_days_follow_the_calendar() {
    let days = january();
    let now = samples(&days, 0);
    let dates: Vec<i8> = now.date.iter().map(|d| d.day()).collect();
    // 3: unknown; 6 to 8 read the 6th; 10 and 11 read the 9th
    assert_eq!(dates, [4, 5, 12]);
    assert_eq!(now.event, [true, false, false]);
    assert_eq!(now.yesterday, [None, Some(true), Some(false)], "the activity of the 3rd is unknown");
    assert_eq!((now.seasons.as_slice(), now.season.as_slice()), (&[1999][..], &[0, 0, 0][..]));
    assert_eq!(now.day_of_season, [187, 188, 195]);

    let next: Vec<i8> = samples(&days, 1).date.iter().map(|d| d.day()).collect();
    // the weather of the target day does not matter: the 6th has none
    assert_eq!(next, [4, 5, 6]);
}

#[test]
fn no_sample_reads_across_the_edge_of_a_season() {
    let days: Vec<DayRecord> = (28..=30)
        .map(|d| date(2000, 6, d))
        .chain((1..=4).map(|d| date(2000, 7, d)))
        .map(|d| record(d, Activity::None))
        .collect();
    let dates = |lead| samples(&days, lead).date;
    assert_eq!(dates(0), [date(2000, 6, 30), date(2000, 7, 3), date(2000, 7, 4)]);
    assert_eq!(dates(1), [date(2000, 7, 4)]);
    assert_eq!(samples(&days, 0).seasons, [1999, 2000]);
}

#[test]
fn splits_never_share_a_season_and_chains_look_back() {
    let days: Vec<DayRecord> = (1990..1999)
        .flat_map(|year| {
            (1..=9).map(move |d| record(date(year, 2, d), if d % 4 == 0 { Activity::Observed } else { Activity::None }))
        })
        .collect();
    let samples = samples(&days, 0);
    let plan = Plan::new(&samples);
    let seasons = |rows: &[usize]| rows.iter().map(|&i| samples.season[i]).collect::<BTreeSet<_>>();
    assert_eq!(plan.held_out.len(), 9);
    for (season, split) in plan.held_out.iter().enumerate() {
        assert_eq!(seasons(&split.test), BTreeSet::from([season]));
        assert_eq!(seasons(&split.training), (0..9).filter(|&s| s != season).collect());
    }
    assert_eq!(plan.chained.iter().map(|split| split.season).collect::<Vec<_>>(), [5, 6, 7, 8]);
    for split in &plan.chained {
        assert_eq!(seasons(&split.test), BTreeSet::from([split.season]));
        assert_eq!(seasons(&split.training), (0..split.season).collect());
    }
}

proptest! {
    /// Every inner fold is made of whole seasons, and what is left without it has both classes.
    #[test]
    fn inner_folds_are_whole_seasons(events in prop::collection::vec(0_usize..=4, 2..20)) {
        // each season has four days, so many of them events
        let season: Vec<usize> = (0..events.len()).flat_map(|s| [s; 4]).collect();
        let event: Vec<bool> = events.iter().flat_map(|&n| (0..4).map(move |d| d < n)).collect();
        let fold = inner_folds(&season, &event);
        for (i, j) in (0..fold.len()).flat_map(|i| (0..i).map(move |j| (i, j))) {
            prop_assert!(season[i] != season[j] || fold[i] == fold[j]);
        }
        let names: BTreeSet<usize> = fold.iter().copied().collect();
        prop_assert_eq!(names.len(), events.len().min(folds::INNER_FOLDS));
        // two seasons with both classes are enough for any fold to be left out
        if events.iter().filter(|&&n| n > 0 && n < 4).count() >= 2 {
            for held_out in names {
                let left: BTreeSet<bool> = (0..fold.len()).filter(|&i| fold[i] != held_out).map(|i| event[i]).collect();
                prop_assert_eq!(left.len(), 2);
            }
        }
    }
}

#[test]
fn seasons_are_dealt_in_turn() {
    let season: Vec<usize> = (0..7).flat_map(|s| [s, s]).collect();
    let event: Vec<bool> = (0..14).map(|i| i % 2 == 0).collect();
    assert_eq!(inner_folds(&season, &event), [0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 0, 0, 1, 1]);
}

/// Keeps what it is told.
#[derive(Default)]
struct Told(Mutex<Vec<(f64, String)>>);

impl Progress for Told {
    fn report(&self, fraction: f64, phase: &str) {
        self.0.lock().unwrap().push((fraction, phase.to_owned()));
    }

    fn cancelled(&self) -> bool {
        false
    }
}

#[test]
fn shares_add_up_and_never_fall() {
    let told = Told::default();
    let shares = Shares::new(&told, vec![1.0, 3.0]);
    shares.part(1, "large".to_owned()).report(0.5, "step");
    shares.part(0, "small".to_owned()).report(1.0, "step");
    shares.part(1, "large".to_owned()).report(0.25, "again");
    shares.part(1, "large".to_owned()).report(7.0, "end");
    let told = told.0.into_inner().unwrap();
    assert_eq!(told.iter().map(|(f, _)| *f).collect::<Vec<_>>(), [0.375, 0.625, 0.625, 1.0]);
    assert_eq!(told[0].1, "large: step");
}
