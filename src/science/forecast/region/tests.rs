use jiff::civil::date;
use proptest::prelude::*;

use super::*;
use crate::forecast::features::{FeatureSetId, archive};
use crate::forecast::model::{FeatureChoice, Trained, TrainingOptions, train, train_pooled};
use crate::forecast::svm::{Grid, KernelFamily};
use crate::forecast::synthetic::{REPORTED, synthetic_station};
use crate::forecast::verification::ThresholdRule;
use crate::progress::Unobserved;

use Activity::{None as Quiet0, Observed, Presumed, Unknown};

const STRICT: RegionRule = RegionRule { stations: 1, quiet: Quiet::EveryStation };
const LENIENT: RegionRule = RegionRule { stations: 1, quiet: Quiet::AnyStation };
const TWO: RegionRule = RegionRule { stations: 2, quiet: Quiet::EveryStation };

#[test]
fn a_day_of_a_region_is_what_its_stations_say() {
    // activity of the stations; of the region for the label observed, for the label presumed: by the definition, by hand
    let table: [(RegionRule, &[Activity], Activity, Activity); 14] = [
        (STRICT, &[Observed, Quiet0], Observed, Observed),
        (STRICT, &[Observed, Unknown], Observed, Observed),
        (STRICT, &[Presumed, Quiet0], Presumed, Presumed),
        (STRICT, &[Quiet0, Quiet0], Quiet0, Quiet0),
        // nobody looked at the second station: there may have been one
        (STRICT, &[Quiet0, Unknown], Unknown, Unknown),
        (LENIENT, &[Quiet0, Unknown], Quiet0, Quiet0),
        (LENIENT, &[Unknown, Unknown], Unknown, Unknown),
        // judged likely at one and unknown at the other: likely for sure, whether one was seen is unknown
        (STRICT, &[Presumed, Unknown], Unknown, Presumed),
        (LENIENT, &[Presumed, Unknown], Presumed, Presumed),
        (TWO, &[Observed, Quiet0, Quiet0], Quiet0, Quiet0),
        (TWO, &[Observed, Unknown, Quiet0], Unknown, Unknown),
        (TWO, &[Observed, Presumed, Quiet0], Presumed, Presumed),
        (TWO, &[Observed, Observed, Unknown], Observed, Observed),
        (STRICT, &[], Quiet0, Quiet0),
    ];
    for (rule, stations, observed, presumed) in table {
        assert_eq!(rule.activity(Label::Observed, stations), observed, "{rule:?} {stations:?}");
        assert_eq!(rule.activity(Label::Presumed, stations), presumed, "{rule:?} {stations:?}");
    }
}

proptest! {
    #[test]
    fn the_activity_of_a_region_has_the_label_of_the_region(
        activity in prop::collection::vec(prop_oneof![Just(Observed), Just(Presumed), Just(Quiet0), Just(Unknown)], 0..6),
        stations in 1_usize..4,
        quiet in prop_oneof![Just(Quiet::EveryStation), Just(Quiet::AnyStation)],
    ) {
        let rule = RegionRule { stations, quiet };
        for label in [Label::Observed, Label::Presumed] {
            prop_assert_eq!(label.of(rule.activity(label, &activity)), rule.label(label, &activity));
        }
        // strict: whatever the silent stations had seen, the answer would be the same
        if quiet == Quiet::EveryStation && let Some(known) = rule.label(Label::Observed, &activity) {
            for silent in [Observed, Quiet0] {
                let told: Vec<Activity> =
                    activity.iter().map(|&a| if a == Unknown { silent } else { a }).collect();
                prop_assert_eq!(rule.label(Label::Observed, &told), Some(known));
            }
        }
    }
}

#[test]
fn every_station_has_all_dates_and_its_own_weather() {
    let day = |d: i8, temperature: f64, activity: Activity| {
        let mut day = DayRecord::empty(date(2020, 1, d));
        day.values[0] = Some(temperature);
        day.activity = activity;
        day
    };
    let a = [day(1, -1.0, Quiet0), day(2, -2.0, Observed)];
    let b = [day(2, -20.0, Quiet0), day(3, -30.0, Quiet0)];
    let days = regional(&[&a, &b], LENIENT, Label::Observed);
    let told = |days: &[DayRecord]| days.iter().map(|d| (d.date.day(), d.values[0], d.activity)).collect::<Vec<_>>();
    assert_eq!(told(&days[0]), [(1, Some(-1.0), Quiet0), (2, Some(-2.0), Observed), (3, None, Quiet0)]);
    assert_eq!(told(&days[1]), [(1, None, Quiet0), (2, Some(-20.0), Observed), (3, Some(-30.0), Quiet0)]);
}

fn options(reported: &[crate::forecast::day::Variable]) -> TrainingOptions {
    TrainingOptions {
        label: Label::Observed,
        lead: 0,
        feature_set: FeatureSetId::Expert,
        features: FeatureChoice::All,
        kernel: KernelFamily::Gaussian,
        reported: reported.to_vec(),
        seed: 1,
        grid: Grid { c: vec![1.0], gamma: vec![0.01] },
        threshold: ThresholdRule::Peirce,
    }
}

/// The days in two parts, as a region of two stations that never recorded the same winter.
fn in_two(days: &[DayRecord], lead: u8, reported: &[crate::forecast::day::Variable]) -> (Trained, Trained) {
    let options = TrainingOptions { lead, ..options(reported) };
    let middle = date(days[days.len() / 2].date.year(), 7, 1);
    let (early, late): (Vec<DayRecord>, Vec<DayRecord>) = days.iter().partition(|day| day.date < middle);
    assert!(!early.is_empty() && !late.is_empty());
    let region = regional(&[&late, &early], LENIENT, Label::Observed);
    let parts: Vec<&[DayRecord]> = region.iter().map(Vec::as_slice).collect();
    let mut pooled = train_pooled(&parts, &options, &Unobserved).unwrap();
    for support in &mut pooled.model.support {
        assert_eq!(support.station, usize::from(support.date < middle));
        support.station = 0;
    }
    (pooled, train(days, &options, &Unobserved).unwrap())
}

/// What is one record cut in two is one record: bit for bit the model and evaluation of the whole, whose scores other
/// programs have confirmed (`evaluation/archive_tests.rs`).
#[test]
fn a_region_of_two_halves_is_the_whole() {
    let days = synthetic_station(11, 2000, 5);
    for lead in [0, 1] {
        let (pooled, whole) = in_two(&days, lead, &REPORTED);
        assert_eq!(pooled, whole);
    }
}

#[test]
fn the_archive_cut_in_two_is_the_archive() {
    let Some(days) = archive::lochaber() else { return };
    let (pooled, whole) = in_two(&days, 0, &archive::REPORTED);
    assert_eq!(pooled, whole);
    assert_eq!((pooled.evaluation.days, pooled.evaluation.events), (1542, 292));
}

/// The worst neighbours are two that are the same. If a station could be forecast from the other's row of the same day, the
/// nearest neighbours would know every answer; and what needs no weather must not notice that there are two.
#[test]
fn neighbours_do_not_tell_each_other_the_answer() {
    let days = synthetic_station(5, 2000, 5);
    let single = train(&days, &options(&REPORTED), &Unobserved).unwrap().evaluation;
    let twice = regional(&[&days, &days], STRICT, Label::Observed);
    assert_eq!(twice[0], days, "a station with itself is that station");
    let trained = train_pooled(&[&twice[0], &twice[1]], &options(&REPORTED), &Unobserved).unwrap();
    let double = trained.evaluation;
    assert_eq!((double.days, double.events, double.seasons), (single.days, single.events, single.seasons));
    assert_eq!(trained.model.training.station_days, 2 * single.days);
    assert_eq!(double.scores.climatology, single.scores.climatology);
    assert_eq!(double.scores.persistence, single.scores.persistence);
    assert_eq!(double.bootstrap.models.persistence, single.bootstrap.models.persistence);
    for ((name, twin), (_, alone)) in double.scores.named().into_iter().zip(single.scores.named()) {
        let (twin, alone) = (twin.auc.unwrap(), alone.auc.unwrap());
        assert!((twin - alone).abs() < 0.06, "{name}: {twin} of twins, {alone} alone");
    }
}

#[test]
fn the_same_bits_at_any_number_of_threads() {
    let days = [synthetic_station(1, 2000, 4), synthetic_station(2, 2000, 4)];
    let region = regional(&[&days[0], &days[1]], STRICT, Label::Presumed);
    let at = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let options = TrainingOptions { label: Label::Presumed, ..options(&REPORTED) };
        pool.install(|| train_pooled(&[&region[0], &region[1]], &options, &Unobserved).unwrap())
    };
    let one = at(1);
    assert!(one.evaluation.scores.svm.auc.unwrap() > 0.6);
    assert!(one.model.support.iter().any(|day| day.station == 1));
    assert_eq!(one, at(3));
}
