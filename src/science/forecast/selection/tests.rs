use std::sync::Mutex;

use super::*;
use crate::forecast::features::archive;
use crate::forecast::svm::Grid;
use crate::forecast::synthetic::{REPORTED, synthetic_station};
use crate::forecast::verification::ThresholdRule;
use crate::progress::Unobserved;

fn options() -> TrainingOptions {
    TrainingOptions {
        label: Label::Observed,
        lead: 0,
        feature_set: FeatureSetId::Raw30,
        features: FeatureChoice::All,
        kernel: KernelFamily::Gaussian,
        reported: REPORTED.to_vec(),
        seed: 1,
        grid: Grid { c: vec![0.3, 3.0], gamma: vec![0.01, 0.03] },
        threshold: ThresholdRule::Peirce,
    }
}

fn days() -> Vec<DayRecord> {
    synthetic_station(5, 2000, 6)
}

fn point(features: usize, auc: f64, error: f64) -> SizeScore {
    SizeScore { features, auc, standard_deviation: None, standard_error: Some(error), by_group: vec![] }
}

#[test]
fn the_smallest_number_within_one_standard_error_is_proposed() {
    // the best is 0.80 at three features with an error of 0.02: 0.78 is enough
    let curve = [point(1, 0.70, 0.1), point(2, 0.785, 0.0), point(3, 0.80, 0.02), point(4, 0.80, 0.01)];
    assert_eq!(choose(&curve), (3, 2));
    let sharp = [point(1, 0.70, 0.1), point(2, 0.785, 0.0), point(3, 0.80, 0.01)];
    assert_eq!(choose(&sharp), (3, 3));
    assert_eq!(choose(&curve[..1]), (1, 1));
}

#[test]
fn mean_and_spread_are_over_the_groups_that_can_be_scored() {
    let run = |auc: Option<f64>| Run { order: vec![0], auc: vec![auc], c: 1.0, gamma: 1.0 };
    let runs = [run(Some(0.7)), run(None), run(Some(0.8)), run(Some(0.9))];
    let found = score(&runs, 1, 1).unwrap();
    // deviations -0.1, 0, 0.1: variance 0.02 / 2
    assert!((found.auc - 0.8).abs() < 1e-15 && (found.standard_deviation.unwrap() - 0.1).abs() < 1e-15);
    assert!((found.standard_error.unwrap() - 0.1 / 3.0_f64.sqrt()).abs() < 1e-15);
    assert_eq!(found.by_group, [Some(0.7), None, Some(0.8), Some(0.9)]);
    assert_eq!(score(&runs[..1], 1, 1).unwrap().standard_error, None);
    assert!(score(&runs[1..2], 1, 1).is_none());
}

#[test]
fn the_curve_has_every_size_and_the_ranking_every_feature() {
    let found = select(&days(), &options(), &Unobserved).unwrap();
    assert_eq!((found.groups.len(), found.seasons), (5, 6));
    assert_eq!(found.groups[0].seasons, [2000, 2005], "seasons are dealt in turn");
    let sizes: Vec<usize> = found.curve.iter().map(|score| score.features).collect();
    assert_eq!(sizes, (1..=30).collect::<Vec<_>>());
    let mut names = found.set(usize::MAX);
    assert_eq!(names.len(), 30);
    assert_eq!(found.set(3), names[..3]);
    names.sort();
    names.dedup();
    assert_eq!(names.len(), 30);
    let best = &found.curve[found.best - 1];
    assert!(found.curve.iter().all(|score| score.auc <= best.auc) && found.proposed <= found.best);
    assert!(found.ranking.iter().map(|ranked| ranked.groups).sum::<usize>() == 5 * found.proposed);
    let json = serde_json::to_string(&found).unwrap();
    assert_eq!(serde_json::from_str::<FeatureSelection>(&json).unwrap(), found);
}

/// What happened in the seasons that are held out changes their score and nothing that is learnt.
#[test]
fn nothing_is_learnt_from_the_seasons_that_are_scored() {
    let days = days();
    let prepared = prepare(&[&days], &options()).unwrap();
    let mut samples = prepared.samples;
    let group = inner_folds(&samples.season, &samples.event);
    let before = eliminate(&samples, &group, Some(1), &options(), &Unobserved).unwrap();
    for i in (0..samples.len()).filter(|&i| group[i] == 1) {
        samples.event[i] = i % 3 == 0;
        samples.features.row_mut(i).iter_mut().for_each(|x| *x = 3.0 - *x);
    }
    let after = eliminate(&samples, &group, Some(1), &options(), &Unobserved).unwrap();
    assert_eq!((after.order, after.c, after.gamma), (before.order, before.c, before.gamma));
    assert_ne!(after.auc, before.auc);
}

#[test]
fn same_bits_at_any_number_of_threads() {
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| select(&days(), &options(), &Unobserved).unwrap())
    };
    assert_eq!(run(1), run(3));
}

/// Saves at every chance and cancels after a number of saves.
struct Interrupted {
    saved: Mutex<(usize, Option<Vec<u8>>)>,
    most: usize,
    resumed: Option<Vec<u8>>,
}

impl Progress for Interrupted {
    fn report(&self, _: f64, _: &str) {}

    fn cancelled(&self) -> bool {
        self.saved.lock().unwrap().0 >= self.most
    }

    fn checkpoint(&self, state: &dyn Fn() -> Vec<u8>) {
        let mut saved = self.saved.lock().unwrap();
        if saved.0 < self.most {
            *saved = (saved.0 + 1, Some(state()));
        }
    }

    fn resumed(&self) -> Option<&[u8]> {
        self.resumed.as_deref()
    }
}

#[test]
fn an_interrupted_run_goes_on_with_the_same_bits() {
    let whole = select(&days(), &options(), &Unobserved).unwrap();
    let first = Interrupted { saved: Mutex::default(), most: 2, resumed: None };
    assert_eq!(select(&days(), &options(), &first).unwrap_err(), TrainingError::Cancelled);
    let state = first.saved.into_inner().unwrap().1;
    let second = Interrupted { saved: Mutex::default(), most: usize::MAX, resumed: state };
    assert_eq!(select(&days(), &options(), &second).unwrap(), whole);
    // five groups and all seasons, of which two were done
    assert!(second.saved.into_inner().unwrap().0 <= 4, "what was saved was computed again");
}

#[test]
fn what_cannot_be_eliminated_is_refused() {
    let days = days();
    for wrong in [
        TrainingOptions { kernel: KernelFamily::Linear, ..options() },
        TrainingOptions { features: FeatureChoice::Eliminated { count: 3 }, ..options() },
    ] {
        assert_eq!(select(&days, &wrong, &Unobserved).unwrap_err(), TrainingError::EliminationKernel);
    }
    assert!(matches!(select(&days[..200], &options(), &Unobserved), Err(TrainingError::TooFewSeasons { .. })));
}

/// On the archive the curve is flat over most of its length, and few features are within one standard error of the best.
#[test]
fn on_the_archive_fewer_features_do_as_well() {
    let Some(days) = archive::lochaber() else { return };
    let options = TrainingOptions {
        feature_set: FeatureSetId::Expert,
        reported: archive::REPORTED.to_vec(),
        grid: Grid::default(),
        ..options()
    };
    let found = select(&days, &options, &Unobserved).unwrap();
    let at = |size: usize| found.curve[size - 1].auc;
    for size in [1, 2, 5, 10, 20, 30, 44, 64] {
        println!("{size:2} features: AUC {:.4}", at(size));
    }
    println!("best {}, proposed {}: {:?}", found.best, found.proposed, found.set(found.proposed));
    assert_eq!((found.curve.len(), found.days, found.events), (64, 1542, 292));
    assert!(found.curve[found.best - 1].auc > 0.80 && found.proposed < 44);
}
