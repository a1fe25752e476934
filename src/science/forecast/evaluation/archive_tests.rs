//! The archive of Lochaber 1993/94-2006/07 against scores that were computed on it with scikit-learn, and which this code was
//! not tuned to. They were made with lags by row (1,545 days) and 59 features; here lags are by calendar (1,542) and the
//! features are those of the `expert` set, hence the tolerance of 0.02.

use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::forecast::day::{DayRecord, Label};
use crate::forecast::features::{FeatureSet, FeatureSetId, History, archive};
use crate::forecast::model::{FeatureChoice, train};
use crate::forecast::svm::{Grid, KernelFamily};
use crate::forecast::verification::ThresholdRule;
use crate::progress::Unobserved;

fn options(label: Label, lead: u8) -> TrainingOptions {
    TrainingOptions {
        label,
        lead,
        feature_set: FeatureSetId::Expert,
        features: FeatureChoice::All,
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
fn leave_one_season_out(days: &[DayRecord], options: &TrainingOptions) -> Evaluation {
    let samples = samples(days, options.label, options.lead);
    let mut plan = Plan::new(&samples);
    plan.chained.clear();
    let shares = Shares::new(&Unobserved, plan.work());
    evaluate(&samples, &plan, options, &shares).unwrap()
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
    let scores = leave_one_season_out(&days, &options(Label::Presumed, 0)).scores;
    near(scores.svm.auc, 0.904, "SVM AUC, presumed");
    near(scores.svm.pss, 0.64, "SVM PSS, presumed");
}

#[test]
fn the_next_day_scores_as_in_the_reproduction() {
    let Some(days) = archive::lochaber() else { return };
    let scores = leave_one_season_out(&days, &options(Label::Observed, 1)).scores;
    near(scores.svm.auc, 0.753, "SVM AUC, lead 1");
    near(scores.knn30.auc, 0.764, "kNN-30 AUC, lead 1");
}

/// The scores of one model.
type Pick = fn(&PerModel<Scores>) -> Scores;

/// Share of the pairs of an event and another day of the same season that a model ranks rightly.
fn auc_within_seasons(evaluation: &Evaluation, of: Pick) -> f64 {
    let (won, pairs) = evaluation.per_season.iter().fold((0.0, 0.0), |(won, pairs), season| {
        let here = (season.events * (season.days - season.events)) as f64;
        (won + here * of(&season.scores).auc.unwrap_or(0.0), pairs + here)
    });
    won / pairs
}

/// The activity moves to other days in the records themselves, and with it the features of past activity: if anything of the
/// label of a day reached its features, or of a held-out season its training, the scores would show it.
///
/// Judged within seasons: a season of many events is forecast by seasons that had fewer, so that without skill the AUC of all
/// days together falls below 0.5 (persistence is at 0.44 here). And over several shuffles: the AUC of one, with m events and n
/// other days, scatters by sqrt((m + n + 1) / (12 m n)) = 0.019 (Mann-Whitney).
#[test]
fn shuffled_labels_cannot_be_forecast() {
    const SHUFFLES: u64 = 6;
    let Some(days) = archive::lochaber() else { return };
    let grid = Grid { c: vec![0.3, 3.0], gamma: vec![0.003, 0.01] };
    let options = TrainingOptions { grid, ..options(Label::Observed, 0) };
    let evaluate = |seed| {
        let mut activity: Vec<_> = days.iter().map(|day| day.activity).collect();
        activity.shuffle(&mut ChaCha8Rng::seed_from_u64(seed));
        let shuffled: Vec<DayRecord> =
            days.iter().zip(activity).map(|(day, activity)| DayRecord { activity, ..*day }).collect();
        leave_one_season_out(&shuffled, &options)
    };
    let all: Vec<Evaluation> = (0..SHUFFLES).map(evaluate).collect();
    let mean = |of: &dyn Fn(&Evaluation) -> f64| all.iter().map(of).sum::<f64>() / SHUFFLES as f64;
    let models: [(&str, Pick); 3] = [("SVM", |m| m.svm), ("kNN-30", |m| m.knn30), ("logistic", |m| m.logistic)];
    for (name, of) in models {
        let within = mean(&|e| auc_within_seasons(e, of));
        let pooled = mean(&|e| of(&e.scores).auc.unwrap());
        println!("{name} AUC on shuffled labels: within seasons {within:.4}, pooled {pooled:.4}");
        assert!((0.46..=0.54).contains(&within), "{name}: {within}");
        assert!((0.45..=0.55).contains(&pooled), "{name}: {pooled}");
    }
}
