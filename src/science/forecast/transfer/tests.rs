use super::*;
use crate::forecast::day::{Label, season_of};
use crate::forecast::features::{FeatureSet, FeatureSetId, archive};
use crate::forecast::model::{FeatureChoice, TrainingOptions, train};
use crate::forecast::svm::{Grid, KernelFamily};
use crate::forecast::synthetic::{REPORTED, synthetic_station};
use crate::forecast::verification::ThresholdRule;
use crate::progress::Unobserved;

fn options(reported: &[Variable]) -> TrainingOptions {
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

fn target<'a>(days: &'a [DayRecord], reported: &'a [Variable]) -> Target<'a> {
    Target { days, reported, trained_on: &[] }
}

fn near(value: Option<f64>, expected: f64, tolerance: f64, what: &str) {
    let value = value.unwrap();
    assert!((value - expected).abs() <= tolerance, "{what}: {value}, expected {expected}");
}

/// The archive of Lochaber as two stations: trained on 1993/94 to 1999/2000, scored on 2000/01 to 2006/07.
///
/// Expected by scikit-learn 1.9.1 on the feature matrix of `Samples` (which `features/tests` hold against a separate
/// implementation): `SimpleImputer(strategy="median")`, `StandardScaler()`, `SVC(C=1, gamma=0.01, class_weight="balanced",
/// tol=1e-6)` on the early seasons; `_sigmoid_calibration` on decision values of five groups of seasons (dealt in turn), each
/// by the machine of the others; the threshold of the largest TPR - FPR of these probabilities, half-way to the next one.
/// Then `roc_auc_score`, `brier_score_loss` and the table of the late days, and climatology by NumPy: the rate within 10 days
/// of season in the other late seasons.
#[test]
fn the_early_model_scores_on_the_late_seasons_as_in_scikit_learn() {
    let Some(days) = archive::lochaber() else { return };
    let (early, late): (Vec<DayRecord>, Vec<DayRecord>) = days.iter().partition(|day| season_of(day.date) < 2000);
    let model = train(&early, &options(&archive::REPORTED), &Unobserved).unwrap().model;
    let transfer = evaluate(&model, target(&late, &archive::REPORTED), 1, &Unobserved).unwrap();
    assert_eq!((transfer.days, transfer.events, transfer.seasons.len()), (752, 108, 7));
    let scores = transfer.scores.svm.unwrap();
    near(Some(transfer.threshold), 0.191_953_307, 1e-5, "threshold");
    let table = scores.contingency;
    assert_eq!((table.a, table.b, table.c, table.d), (82, 149, 26, 495));
    near(scores.auc, 0.828_315_505, 1e-4, "AUC");
    near(scores.brier, 0.105_907_230, 1e-5, "Brier");
    near(scores.brier_skill, 0.172_521_135, 1e-4, "Brier skill");
    near(scores.pss, 0.527_892_800, 1e-8, "PSS");
    near(scores.hss, 0.358_148_972, 1e-8, "HSS");
    near(transfer.scores.climatology.unwrap().brier, 0.127_987_837, 1e-8, "Brier of climatology");
    near(transfer.scores.climatology.unwrap().auc, 0.373_813_837, 1e-8, "AUC of climatology");
    let by_season =
        [0.791_744_841, 0.796_164_384, 0.946_363_636, 0.840_878_530, 0.781_690_141, 0.765_669_516, 0.805_218_447];
    for (season, expected) in transfer.per_season.iter().zip(by_season) {
        near(season.scores.svm.unwrap().auc, expected, 1e-3, &format!("AUC of {}", season.season));
    }
    let first = &transfer.per_season[0];
    assert_eq!((first.season, first.days, first.events), (2000, 95, 13));
    near(transfer.drift.base_rate_z, -5.793_151_298, 1e-8, "base rate, standard deviations");
    // the share of late days beyond the early range, by NumPy
    let air = transfer.drift.inputs.iter().find(|input| input.feature == "air_temperature_t").unwrap();
    near(Some(air.out_of_range), 0.0133, 5e-5, "air temperature out of range");
    assert!(transfer.not_reported.is_empty());
    assert!(transfer.bootstrap.unwrap().models.svm.auc.unwrap().lower > 0.7);

    // the same day by the way of a forecast
    let day = late.iter().rev().find(|day| model.label.of(day.activity).is_some()).unwrap().date;
    let forecast = model.forecast(&late, day).unwrap();
    let set = FeatureSet::new(FeatureSetId::Expert, &archive::REPORTED);
    let samples = Samples::collect(&History::new(&late).unwrap(), &set, Label::Observed, 0);
    let row = samples.date.iter().position(|&date| date == day).unwrap();
    assert_eq!(speak(&model, &samples)[row].probability.to_bits(), forecast.probability.to_bits());
}

#[test]
fn what_the_target_does_not_report_is_imputed_and_said() {
    let model = train(&synthetic_station(1, 2000, 4), &options(&REPORTED), &Unobserved).unwrap().model;
    let mut days = synthetic_station(2, 2004, 4);
    let whole = evaluate(&model, target(&days, &REPORTED), 1, &Unobserved).unwrap();
    assert!(whole.not_reported.is_empty());
    let gone = [Variable::FootPenetration, Variable::SnowDrift];
    for day in &mut days {
        gone.iter().for_each(|variable| day.values[variable.index()] = None);
    }
    let reported: Vec<Variable> = REPORTED.into_iter().filter(|variable| !gone.contains(variable)).collect();
    let poorer = evaluate(&model, target(&days, &reported), 1, &Unobserved).unwrap();
    assert_eq!(poorer.not_reported, ["snow_drift", "foot_penetration"]);
    let foot = poorer.drift.inputs.iter().find(|input| input.feature == "foot_penetration_t").unwrap();
    assert_eq!(foot.imputed, 1.0);
    for words in ["foot_penetration is not reported at the target", "foot_penetration_t was imputed on 100 %"] {
        assert!(poorer.drift.warnings.iter().any(|warning| warning.contains(words)), "{:?}", poorer.drift.warnings);
    }
    assert_eq!(poorer.days, whole.days);
    assert_ne!(poorer.scores.svm, whole.scores.svm);
    // what does not read weather does not notice
    assert_eq!(poorer.scores.climatology, whole.scores.climatology);
    assert_eq!(poorer.scores.persistence, whole.scores.persistence);
}

#[test]
fn seasons_of_the_training_are_no_test() {
    let days = synthetic_station(1, 2000, 5);
    let model = train(&days[..days.len() * 4 / 5], &options(&REPORTED), &Unobserved).unwrap().model;
    let own = Target { trained_on: &model.training.seasons, ..target(&days, &REPORTED) };
    let transfer = evaluate(&model, own, 1, &Unobserved).unwrap();
    assert_eq!(
        (transfer.seasons.as_slice(), transfer.left_out.as_slice()),
        (&[2004][..], &[2000, 2001, 2002, 2003][..])
    );
    // one season has no climatology of its own, no models and nothing to draw from
    let scores = transfer.scores;
    assert!(scores.svm.is_some_and(|svm| svm.auc.is_some() && svm.brier.is_some() && svm.brier_skill.is_none()));
    assert!(scores.climatology.is_none() && scores.knn30.is_none() && transfer.bootstrap.is_none());
    let all = Target { trained_on: &[2000, 2001, 2002, 2003, 2004], ..own };
    assert_eq!(evaluate(&model, all, 1, &Unobserved).unwrap_err(), TransferError::NoDay);
    assert_eq!(check(&model, all), Err(TransferError::NoDay));
    assert_eq!(check(&model, own), Ok(transfer.days));
}

#[test]
fn two_seasons_have_intervals_and_no_models_of_their_own() {
    let model = train(&synthetic_station(1, 2000, 4), &options(&REPORTED), &Unobserved).unwrap().model;
    let transfer = evaluate(&model, target(&synthetic_station(2, 2010, 2), &REPORTED), 1, &Unobserved).unwrap();
    let bootstrap = transfer.bootstrap.unwrap();
    assert!(bootstrap.models.svm.auc.is_some() && bootstrap.models.svm.brier_skill.is_none());
    assert!(bootstrap.models.climatology.auc.is_none() && bootstrap.svm_minus_knn30_auc.is_none());
}
