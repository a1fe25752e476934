//! The archive of Lochaber 1993/94-2006/07 against scores that were computed on it with scikit-learn, and which this code was
//! not tuned to. They were made with lags by row (1,545 days) and 59 features; here lags are by calendar (1,542) and the
//! features are those of the `expert` set, hence the tolerance of 0.02.

use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::forecast::day::{DayRecord, Label};
use crate::forecast::features::{FeatureSet, FeatureSetId, History, archive};
use crate::forecast::model::train;
use crate::forecast::svm::{Grid, KernelFamily};
use crate::forecast::verification::ThresholdRule;
use crate::progress::Unobserved;

fn options(label: Label, lead: u8) -> TrainingOptions {
    TrainingOptions {
        label,
        lead,
        feature_set: FeatureSetId::Expert,
        kernel: KernelFamily::Gaussian,
        reported: archive::REPORTED.to_vec(),
        seed: 1,
        grid: Grid::default(),
        threshold: ThresholdRule::Peirce,
    }
}

fn samples(days: &[DayRecord], label: Label, lead: u8) -> Samples {
    let set = FeatureSet::new(FeatureSetId::Expert, &archive::REPORTED);
    Samples::collect(&History::new(days).unwrap(), &set, label, lead)
}

/// Leave one season out without the forward chain and the final model.
fn leave_one_season_out(days: &[DayRecord], label: Label, lead: u8) -> PerModel<Scores> {
    let samples = samples(days, label, lead);
    let mut plan = Plan::new(&samples);
    plan.chained.clear();
    let shares = Shares::new(&Unobserved, plan.work());
    evaluate(&samples, &plan, &options(label, lead), &shares).unwrap().scores
}

fn near(value: Option<f64>, expected: f64, name: &str) {
    let value = value.unwrap();
    println!("{name}: {value:.4} (expected {expected})");
    assert!((value - expected).abs() <= 0.02, "{name}: {value}, expected {expected}");
}

#[test]
fn days_are_those_of_the_archive() {
    let Some(days) = archive::lochaber() else { return };
    let observed = samples(&days, Label::Observed, 0);
    assert_eq!((observed.len(), observed.event.iter().filter(|&&e| e).count()), (1542, 292));
    assert_eq!(observed.seasons, (1993..=2006).collect::<Vec<i16>>());
    // counted with pandas on the decoded file
    assert_eq!(samples(&days, Label::Observed, 1).len(), 1527);
    assert_eq!(samples(&days, Label::Presumed, 0).event.iter().filter(|&&e| e).count(), 613);
}

#[test]
fn every_model_scores_as_in_the_reproduction() {
    let Some(days) = archive::lochaber() else { return };
    let trained = train(&days, &options(Label::Observed, 0), &Unobserved).unwrap();
    let evaluation = &trained.evaluation;
    let scores = &evaluation.scores;
    let auc =
        PerModel { svm: 0.819, climatology: 0.454, persistence: 0.522, knn10: 0.750, knn30: 0.813, logistic: 0.817 };
    for ((name, scores), (_, &expected)) in scores.named().into_iter().zip(auc.named()) {
        near(scores.auc, expected, &format!("{name} AUC"));
    }
    let skill = PerModel { svm: 0.22, climatology: 0.0, persistence: 0.05, knn10: 0.13, knn30: 0.21, logistic: 0.22 };
    for ((name, scores), (_, &expected)) in scores.named().into_iter().zip(skill.named()) {
        near(scores.brier_skill, expected, &format!("{name} Brier skill"));
    }
    assert!(scores.svm.auc.unwrap() >= 0.81 && scores.svm.brier_skill.unwrap() >= 0.20);
    near(scores.svm.pss, 0.50, "SVM PSS");
    near(scores.svm.hss, 0.36, "SVM HSS");
    near(scores.svm.pod, 0.78, "SVM POD");
    near(scores.svm.far, 0.61, "SVM FAR");

    // no real difference from the neighbours, as the paper says
    let difference = evaluation.bootstrap.svm_minus_knn30_auc.unwrap();
    assert!(difference.lower < 0.0 && difference.upper > 0.0, "{difference:?}");
    let interval = evaluation.bootstrap.models.svm.auc.unwrap();
    assert!(interval.lower < scores.svm.auc.unwrap() && scores.svm.auc.unwrap() < interval.upper);

    assert_eq!((evaluation.days, evaluation.events, evaluation.seasons), (1542, 292, 14));
    assert_eq!(evaluation.per_season.len(), 14);
    assert_eq!(evaluation.per_season.iter().map(|s| s.days).sum::<usize>(), 1542);
    assert_eq!(evaluation.reliability.iter().map(|b| b.count).sum::<u64>(), 1542);
    let chained = evaluation.forward_chaining.as_ref().unwrap();
    assert_eq!(chained.seasons, (1998..=2006).collect::<Vec<i16>>());
    // no reference for this one; a model without skill would be at 0.5
    assert!(chained.scores.svm.auc.unwrap() > 0.75 && chained.scores.svm.brier_skill.unwrap() > 0.1);
}

#[test]
fn presumed_days_score_as_in_the_reproduction() {
    let Some(days) = archive::lochaber() else { return };
    let scores = leave_one_season_out(&days, Label::Presumed, 0);
    near(scores.svm.auc, 0.904, "SVM AUC, presumed");
    near(scores.svm.pss, 0.64, "SVM PSS, presumed");
}

#[test]
fn the_next_day_scores_as_in_the_reproduction() {
    let Some(days) = archive::lochaber() else { return };
    let scores = leave_one_season_out(&days, Label::Observed, 1);
    near(scores.svm.auc, 0.753, "SVM AUC, lead 1");
    near(scores.knn30.auc, 0.764, "kNN-30 AUC, lead 1");
}

/// The activity moves to other days in the records themselves, and with it the features of past activity: if anything of the
/// label of a day reached its features, or of a held-out season its training, the scores would show it.
#[test]
fn shuffled_labels_cannot_be_forecast() {
    let Some(mut days) = archive::lochaber() else { return };
    let mut activity: Vec<_> = days.iter().map(|day| day.activity).collect();
    activity.shuffle(&mut ChaCha8Rng::seed_from_u64(20));
    for (day, activity) in days.iter_mut().zip(activity) {
        day.activity = activity;
    }
    let auc = leave_one_season_out(&days, Label::Observed, 0).svm.auc.unwrap();
    println!("SVM AUC on shuffled labels: {auc:.4}");
    assert!((0.45..=0.55).contains(&auc), "{auc}");
}
