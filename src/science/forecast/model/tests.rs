use std::sync::LazyLock;
use std::sync::atomic::{AtomicUsize, Ordering};

use jiff::ToSpan;
use jiff::civil::{Date, date};

use super::*;
use crate::forecast::day::{Activity, Label, Variable, season_of};
use crate::forecast::evaluation::Verdict;
use crate::forecast::features::FeatureSetId;
use crate::forecast::selection::select;
use crate::forecast::svm::{Grid, GridError, KernelFamily};
use crate::forecast::synthetic::{REPORTED, synthetic_station};
use crate::forecast::transfer;
use crate::forecast::verification::{Scores, ThresholdRule};
use crate::progress::{Progress, Unobserved};

const SEASONS: usize = 6;

fn options() -> TrainingOptions {
    TrainingOptions {
        label: Label::Observed,
        lead: 0,
        feature_set: FeatureSetId::Expert,
        features: FeatureChoice::All,
        kernel: KernelFamily::Gaussian,
        reported: REPORTED.to_vec(),
        seed: 7,
        grid: Grid { c: vec![0.3, 3.0], gamma: vec![0.003, 0.02] },
        threshold: ThresholdRule::Peirce,
    }
}

fn station() -> Vec<DayRecord> {
    synthetic_station(3, 2000, SEASONS)
}

/// Lead 0 and lead 1 on the same station.
static TRAINED: LazyLock<[Trained; 2]> = LazyLock::new(|| {
    [0, 1].map(|lead| train(&station(), &TrainingOptions { lead, ..options() }, &Unobserved).unwrap())
});

fn model(lead: usize) -> &'static TrainedModel {
    &TRAINED[lead].model
}

/// A day in the middle of the last season whose base days are complete enough for a forecast.
const DAY: Date = date(2006, 2, 10);

fn refused(days: &[DayRecord], options: &TrainingOptions) -> TrainingError {
    let refused = check(days, options).unwrap_err();
    assert_eq!(train(days, options, &Unobserved).unwrap_err(), refused, "check and train agree");
    refused
}

#[test]
fn what_cannot_be_trained_is_refused_with_what_would_be_accepted() {
    let days = station();
    let lead = refused(&days, &TrainingOptions { lead: 2, ..options() });
    assert_eq!(lead.to_string(), "a lead of 2 days is not offered: 0 (the same day) or 1 (the next day) is accepted");
    let reported = vec![Variable::CumulativeSnowIndex];
    assert_eq!(refused(&days, &TrainingOptions { reported, ..options() }), TrainingError::NoVariable);
    for ratio in [0.0, 1.0, f64::NAN] {
        let threshold = ThresholdRule::CostLoss { ratio };
        assert!(matches!(refused_ratio(&days, threshold), TrainingError::CostLoss { .. }));
    }
    let grid = Grid { c: vec![1.0], gamma: vec![] };
    assert_eq!(refused(&days, &TrainingOptions { grid, ..options() }), TrainingError::Grid(GridError::EmptyGrid));
    let grid = Grid { c: vec![-1.0], gamma: vec![0.1] };
    assert!(matches!(refused(&days, &TrainingOptions { grid, ..options() }), TrainingError::Grid(_)));

    let two: Vec<DayRecord> = synthetic_station(3, 2000, 2);
    assert_eq!(refused(&two, &options()), TrainingError::TooFewSeasons { found: 2, needed: 3 });
    assert_eq!(refused(&[], &options()), TrainingError::TooFewSeasons { found: 0, needed: 3 });

    let mut quiet = station();
    quiet.iter_mut().filter(|day| season_of(day.date) > 2001).for_each(|day| day.activity = Activity::None);
    let one_class = TrainingError::OneClass { event_seasons: 2, quiet_seasons: SEASONS, needed: 3 };
    assert_eq!(refused(&quiet, &options()), one_class);

    let mut disordered = station();
    disordered.swap(4, 5);
    assert!(matches!(refused(&disordered, &options()), TrainingError::Unordered(_)));
}

fn refused_ratio(days: &[DayRecord], threshold: ThresholdRule) -> TrainingError {
    // NaN is not equal to itself, so the two errors cannot be compared
    check(days, &TrainingOptions { threshold, ..options() }).unwrap_err()
}

#[test]
fn the_summary_is_that_of_the_training() {
    let summary = check(&station(), &options()).unwrap();
    let Trained { model, evaluation } = &TRAINED[0];
    assert_eq!((summary.days, summary.events, summary.seasons), (model.training.days, model.training.events, SEASONS));
    assert_eq!((summary.days, summary.base_rate), (evaluation.days, evaluation.base_rate));
    assert_eq!((summary.first, summary.last), (evaluation.first, evaluation.last));
    assert_eq!(model.training.seasons, (2000..2006).collect::<Vec<i16>>());
}

/// The synthetic avalanches follow from its weather and snowpack, so a model that learns must beat the ones that cannot see them.
#[test]
fn the_machine_learns_what_weather_tells() {
    for trained in TRAINED.iter() {
        let scores = &trained.evaluation.scores;
        let auc = scores.map(|s| s.auc.unwrap());
        assert!(auc.svm > auc.climatology + 0.1 && auc.svm > auc.persistence + 0.05, "{auc:?}");
        assert!(scores.svm.brier_skill.unwrap() > 0.05 && scores.svm.pss.unwrap() > 0.2);
        assert_eq!(scores.climatology.brier_skill, Some(0.0));
        let chained = trained.evaluation.forward_chaining.as_ref().unwrap();
        assert_eq!((chained.seasons.as_slice(), chained.first_training_seasons), (&[2003, 2004, 2005][..], 3));
    }
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        // Debug shows every bit of a number that is not NaN
        pool.install(|| format!("{:?}", train(&station(), &options(), &Unobserved).unwrap()))
    };
    let one = on(1);
    assert!(!one.contains("NaN"));
    assert!(one == on(2) && one == on(5));
}

/// What is learnt for a held-out season must not change with anything that happens in that season.
#[test]
fn a_held_out_season_teaches_nothing() {
    const HELD_OUT: usize = 2;
    let mut days = station();
    for day in days.iter_mut().filter(|day| season_of(day.date) == 2002) {
        day.activity = if day.activity == Activity::None { Activity::Observed } else { Activity::None };
        day.values.iter_mut().flatten().for_each(|value| *value = 3.0 * *value - 5.0);
    }
    let changed = train(&days, &options(), &Unobserved).unwrap().evaluation;
    let learnt = |evaluation: &Evaluation, season: usize| {
        let season = &evaluation.per_season[season];
        (season.c, season.gamma, season.threshold)
    };
    let original = &TRAINED[0].evaluation;
    assert_eq!(learnt(&changed, HELD_OUT), learnt(original, HELD_OUT));
    assert_ne!(changed.per_season[HELD_OUT].scores, original.per_season[HELD_OUT].scores);
    assert_ne!(learnt(&changed, 0), learnt(original, 0), "the change does teach the other splits");
}

/// Cancels after some reports, and counts those that still come.
struct Impatient {
    patience: usize,
    reports: AtomicUsize,
}

impl Progress for Impatient {
    fn report(&self, _fraction: f64, _phase: &str) {
        self.reports.fetch_add(1, Ordering::SeqCst);
    }

    fn cancelled(&self) -> bool {
        self.reports.load(Ordering::SeqCst) >= self.patience
    }
}

#[test]
fn a_cancelled_run_ends_with_the_next_fit() {
    for patience in [0, 1, 40] {
        let progress = Impatient { patience, reports: AtomicUsize::new(0) };
        assert_eq!(train(&station(), &options(), &progress), Err(TrainingError::Cancelled));
        // a fit that was under way on another thread may still report
        let late = progress.reports.into_inner() - patience;
        assert!(late <= rayon::current_num_threads(), "{late} reports after the cancellation");
    }
}

/// Checks that fractions rise to 1.
#[derive(Default)]
struct Rising(std::sync::Mutex<Vec<f64>>);

impl Progress for Rising {
    fn report(&self, fraction: f64, _phase: &str) {
        self.0.lock().unwrap().push(fraction);
    }

    fn cancelled(&self) -> bool {
        false
    }
}

#[test]
fn progress_rises_to_one() {
    let progress = Rising::default();
    train(&station(), &options(), &progress).unwrap();
    let fractions = progress.0.into_inner().unwrap();
    assert!(fractions.is_sorted() && fractions[0] > 0.0, "{fractions:?}");
    assert!((fractions.last().unwrap() - 1.0).abs() < 1e-9);
}

#[test]
fn a_forecast_reads_nothing_after_its_base_day() {
    for lead in [0, 1] {
        let days = station();
        let forecast = model(lead).forecast(&days, DAY).unwrap();
        let base = DAY.checked_sub((lead as i64).days()).unwrap();
        assert_eq!((forecast.base_date, forecast.date, usize::from(forecast.lead)), (base, DAY, lead));
        let past: Vec<DayRecord> = days.iter().copied().filter(|day| day.date <= base).collect();
        assert_eq!(model(lead).forecast(&past, DAY).unwrap(), forecast);
        // no avalanche of the base day or later
        for activity in [Activity::Observed, Activity::None, Activity::Unknown] {
            let mut other = days.clone();
            other.iter_mut().filter(|day| day.date >= base).for_each(|day| day.activity = activity);
            assert_eq!(model(lead).forecast(&other, DAY).unwrap(), forecast);
        }
    }
}

#[test]
fn a_forecast_states_its_threshold() {
    let (days, model) = (station(), model(0));
    let last_season = days.iter().filter(|day| season_of(day.date) == 2005);
    let mut seen = [false; 2];
    for day in last_season {
        let forecast = model.forecast(&days, day.date).unwrap();
        assert!((0.0..=1.0).contains(&forecast.probability));
        assert_eq!(forecast.probability, model.platt.probability(forecast.decision_value));
        let reached = forecast.probability >= model.threshold;
        assert_eq!(forecast.category == Category::AvalancheDay, reached);
        seen[usize::from(reached)] = true;
    }
    assert_eq!(seen, [true; 2]);
}

#[test]
fn similar_days_add_up_to_the_decision_value() {
    let (days, model) = (station(), model(0));
    let forecast = model.forecast(&days, DAY).unwrap();
    let all = model.similar_days(&days, DAY, usize::MAX).unwrap();
    let sum: f64 = all.iter().map(|day| day.contribution).sum();
    assert!((sum - model.machine.rho - forecast.decision_value).abs() < 1e-9);
    assert!(all.is_sorted_by(|a, b| a.kernel >= b.kernel));
    assert!(all.iter().all(|day| (day.contribution > 0.0) == day.label && day.kernel > 0.0 && day.kernel <= 1.0));
    let few = model.similar_days(&days, DAY, 5).unwrap();
    assert_eq!(few, all[..5]);
    for day in few {
        let record = days.iter().find(|record| record.date == day.date).unwrap();
        assert_eq!(Label::Observed.of(record.activity), Some(day.label));
    }
    // a day of the training that became a support vector is most like itself
    let itself = model.support[model.support.len() / 2].date;
    let nearest = model.similar_days(&days, itself, 1).unwrap()[0];
    assert_eq!((nearest.date, nearest.kernel), (itself, 1.0));
}

#[test]
fn an_explanation_adds_up_and_says_what_was_made_up() {
    let (mut days, model) = (station(), model(0));
    let today = days.iter().position(|day| day.date == DAY).unwrap();
    days[today].values[Variable::WindSpeed.index()] = None;
    days[today].values[Variable::AirTemperature.index()] = Some(30.0);
    let forecast = model.forecast(&days, DAY).unwrap();
    let found = model.explain(&days, DAY).unwrap();
    assert_eq!(found.contributions.len(), model.features.len());
    assert!(found.contributions.is_sorted_by(|a, b| a.contribution.abs() >= b.contribution.abs()));
    let sum: f64 = found.contributions.iter().map(|part| part.contribution).sum();
    assert_eq!(found.decision_value, forecast.decision_value);
    assert!((found.base + sum - forecast.decision_value).abs() < 1e-11);
    let names = |list: Vec<&String>| list.into_iter().cloned().collect::<Vec<String>>();
    assert_eq!(names(found.imputed.iter().map(|entry| &entry.feature).collect()), forecast.inputs.imputed);
    assert_eq!(names(found.out_of_range.iter().map(|entry| &entry.feature).collect()), forecast.inputs.out_of_range);
    let wind = found.imputed.iter().find(|entry| entry.feature == "wind_speed_t").unwrap();
    // the median of the training days, from the days themselves
    let mut speeds: Vec<f64> = Vec::new();
    for day in &days {
        let scorable = model.forecast(&days, day.date).is_ok() && day.date != DAY;
        speeds.extend(day.value(Variable::WindSpeed).filter(|_| scorable));
    }
    speeds.sort_by(f64::total_cmp);
    let median = speeds[speeds.len() / 2];
    assert!((wind.used - median).abs() < 1.0, "{} {median}", wind.used);
    assert_eq!((wind.unit.as_str(), wind.inputs.as_slice()), ("m/s", &["wind_speed".to_owned()][..]));
    let air = found.out_of_range.iter().find(|entry| entry.feature == "air_temperature_t").unwrap();
    assert!(air.value == 30.0 && air.most.unwrap() < 30.0 && air.least < air.most);
    let part = found.contributions.iter().find(|part| part.feature == "wind_speed_t").unwrap();
    assert_eq!(part.value, None);
}

#[test]
fn a_what_if_is_the_forecast_of_the_changed_day() {
    let (days, model) = (station(), model(0));
    let change = |value| Change { date: DAY, values: vec![(Variable::AirTemperature, value)], activity: None };
    let mut by_hand = days.clone();
    let today = by_hand.iter().position(|day| day.date == DAY).unwrap();
    let curve = model.response(&days, DAY, Variable::AirTemperature, &[-8.0, 0.5, 60.0]).unwrap();
    for point in &curve {
        by_hand[today].values[Variable::AirTemperature.index()] = Some(point.value);
        let expected = model.forecast(&by_hand, DAY).unwrap();
        let found = model.forecast(&changed(&days, &[change(Some(point.value))]), DAY).unwrap();
        assert_eq!((found.probability, point.probability), (expected.probability, expected.probability));
        assert_eq!(point.decision_value, expected.decision_value);
    }
    assert!(curve[2].extrapolates && curve[0].probability != curve[1].probability);
    assert!(changed(&days, &[change(None)])[today].value(Variable::AirTemperature).is_none());
    // a day that nobody observed is made, in its place
    let new = Change { date: date(2006, 5, 1), values: vec![(Variable::CloudCover, Some(3.0))], activity: None };
    let more = changed(&days, &[new, Change { activity: Some(Activity::Presumed), ..change(Some(1.0)) }]);
    assert!(more.is_sorted_by_key(|day| day.date) && more.len() == days.len() + 1);
    assert_eq!(more[today].activity, Activity::Presumed);
    let (least, most) = model.training_range(Variable::AirTemperature).unwrap();
    assert!(least < -5.0 && most > 0.0 && most < 60.0);
    assert_eq!(model.training_range(Variable::SnowHeight), None);
}

#[test]
fn features_can_be_named_or_eliminated() {
    let days = station();
    let names = ["snow_drift_t", "air_temperature_t", "foot_penetration_t1"].map(str::to_owned).to_vec();
    let named = TrainingOptions { features: FeatureChoice::Named(names.clone()), ..options() };
    let model = train(&days, &named, &Unobserved).unwrap().model;
    assert_eq!(model.features, ["air_temperature_t", "snow_drift_t", "foot_penetration_t1"], "in the order of the set");
    assert!(model.machine.support.iter().all(|row| row.len() == 3));
    assert_eq!(model.explain(&days, DAY).unwrap().contributions.len(), 3);
    let stored: TrainedModel = serde_json::from_str(&serde_json::to_string(&model).unwrap()).unwrap();
    assert_eq!(stored.forecast(&days, DAY), model.forecast(&days, DAY));

    let options = TrainingOptions { features: FeatureChoice::Eliminated { count: 5 }, ..options() };
    let chosen = train(&days, &options, &Unobserved).unwrap();
    let selection = select(&days, &TrainingOptions { features: FeatureChoice::All, ..options }, &Unobserved).unwrap();
    let mut expected = selection.set(5);
    expected.sort();
    let mut features = chosen.model.features.clone();
    features.sort();
    assert_eq!(features, expected, "the final model keeps what the elimination on all seasons keeps");
    assert_eq!(chosen.model.preparation.columns().len(), 5);
    assert!(chosen.evaluation.scores.svm.auc.unwrap() > 0.6);
    assert_ne!(chosen.evaluation.scores.svm, TRAINED[0].evaluation.scores.svm);
    assert_eq!(chosen.evaluation.scores.knn30, TRAINED[0].evaluation.scores.knn30, "the others read what they read");
}

#[test]
fn a_choice_of_features_that_cannot_be_is_refused() {
    let days = station();
    let with = |features| refused(&days, &TrainingOptions { features, ..options() });
    let name = |name: &str| name.to_owned();
    assert!(
        with(FeatureChoice::Named(vec![name("snow_depth_t")])).to_string().contains("`snow_depth_t` is no feature")
    );
    assert!(matches!(
        with(FeatureChoice::Named(vec![name("snow_drift_t"), name("snow_drift_t")])),
        TrainingError::Feature(_)
    ));
    assert!(matches!(with(FeatureChoice::Named(vec![])), TrainingError::FeatureCount { count: 0, .. }));
    for count in [0, 65] {
        let error = with(FeatureChoice::Eliminated { count });
        assert_eq!(error, TrainingError::FeatureCount { count, features: 64 });
    }
    let linear =
        TrainingOptions { kernel: KernelFamily::Linear, features: FeatureChoice::Eliminated { count: 5 }, ..options() };
    assert_eq!(refused(&days, &linear), TrainingError::EliminationKernel);
}

#[test]
fn what_is_missing_or_unheard_of_is_said() {
    let mut days = station();
    let today = days.iter().position(|day| day.date == DAY).unwrap();
    days[today].values[Variable::WindSpeed.index()] = None;
    days[today].values[Variable::AirTemperature.index()] = Some(30.0);
    let inputs = model(0).forecast(&days, DAY).unwrap().inputs;
    assert!(inputs.missing.contains(&"wind_speed".to_owned()), "{inputs:?}");
    assert!(inputs.imputed.contains(&"wind_speed_t".to_owned()), "{inputs:?}");
    assert!(inputs.out_of_range.contains(&"air_temperature_t".to_owned()), "{inputs:?}");
    assert!(!inputs.imputed.contains(&"air_temperature_t".to_owned()));
}

#[test]
fn without_an_observation_there_is_no_forecast() {
    let days = station();
    let unrecorded = date(2006, 5, 1);
    assert_eq!(model(0).forecast(&days, unrecorded), Err(ForecastError::NoObservation { date: unrecorded }));
    let mut silent = days.clone();
    let today = silent.iter().position(|day| day.date == DAY).unwrap();
    silent[today] = DayRecord { activity: silent[today].activity, ..DayRecord::empty(DAY) };
    assert_eq!(model(0).forecast(&silent, DAY), Err(ForecastError::NoObservation { date: DAY }));
    let tomorrow = date(2006, 2, 11);
    assert_eq!(model(1).forecast(&silent, tomorrow), Err(ForecastError::NoObservation { date: DAY }));
    assert_eq!(model(1).forecast(&[], Date::MIN), Err(ForecastError::NoBaseDay { date: Date::MIN, lead: 1 }));
    let backwards: Vec<DayRecord> = days.into_iter().rev().collect();
    assert!(matches!(model(0).forecast(&backwards, DAY), Err(ForecastError::Unordered(_))));
}

#[test]
fn a_stored_model_says_the_same() {
    let json = serde_json::to_string(model(0)).unwrap();
    let stored: TrainedModel = serde_json::from_str(&json).unwrap();
    assert_eq!(&stored, model(0));
    assert_eq!(stored.forecast(&station(), DAY), model(0).forecast(&station(), DAY));

    let newer = TrainedModel { feature_set_version: 99, ..stored.clone() };
    let changed = ForecastError::FeatureSetChanged { stored: 99, current: FeatureSetId::Expert.version() };
    assert_eq!(newer.forecast(&station(), DAY), Err(changed));
    let mut damaged = stored;
    damaged.support.pop();
    assert_eq!(damaged.similar_days(&station(), DAY, 3), Err(ForecastError::Damaged));
}

#[test]
fn json_has_the_promised_names() {
    let evaluation = serde_json::to_value(&TRAINED[0].evaluation).unwrap();
    let keys = |value: &serde_json::Value| {
        // sorted, since other packages of a build may make serde_json keep the order of the fields
        let mut keys: Vec<_> = value.as_object().unwrap().keys().cloned().collect();
        keys.sort();
        keys.join(" ")
    };
    assert_eq!(keys(&evaluation["scores"]), "climatology knn10 knn30 logistic persistence svm");
    assert_eq!(
        keys(&evaluation["scores"]["svm"]),
        "auc bias brier brier_skill contingency csi expected_cost far hss pod pofd pss"
    );
    assert_eq!(keys(&evaluation["scores"]["svm"]["contingency"]), "a b c d");
    assert_eq!(keys(&evaluation["reliability"][0]), "count lower mean_probability observed_frequency upper");
    assert_eq!(serde_json::from_value::<Evaluation>(evaluation).unwrap(), TRAINED[0].evaluation);
    assert_eq!(serde_json::to_value(Category::NoAvalancheDay).unwrap(), "no_avalanche_day");
    let rule = ThresholdRule::CostLoss { ratio: 0.25 };
    assert_eq!(serde_json::to_string(&rule).unwrap(), r#"{"kind":"cost_loss","ratio":0.25}"#);
}

/// Constant, absent and enormous columns: a result or an error, never a panic and never NaN.
#[test]
fn absurd_values_are_survived() {
    let mut days = synthetic_station(5, 2000, 4);
    for (i, day) in days.iter_mut().enumerate() {
        day.values[Variable::AirTemperature.index()] = Some(if i % 7 == 0 { 1e300 } else { -1e300 });
        day.values[Variable::WindSpeed.index()] = Some(f64::MAX / (1 + i % 3) as f64);
        day.values[Variable::CloudCover.index()] = None;
        day.values[Variable::SnowTemperature.index()] = Some(f64::INFINITY);
        day.values[Variable::FootPenetration.index()] = Some(4.0);
    }
    let options = TrainingOptions { grid: Grid { c: vec![1e-9, 1e9], gamma: vec![1e-12, 1e12] }, ..options() };
    match train(&days, &options, &Unobserved) {
        Ok(trained) => assert!(!format!("{trained:?}").contains("NaN")),
        Err(error) => assert!(matches!(error, TrainingError::Grid(_) | TrainingError::Machine(_)), "{error}"),
    }
}

#[test]
fn a_cost_loss_ratio_is_the_threshold_of_every_model() {
    let options = TrainingOptions {
        threshold: ThresholdRule::CostLoss { ratio: 0.3 },
        kernel: KernelFamily::Linear,
        grid: Grid { c: vec![0.1], gamma: vec![] },
        feature_set: FeatureSetId::Raw30,
        ..options()
    };
    let Trained { model, evaluation } = train(&station(), &options, &Unobserved).unwrap();
    assert_eq!((model.threshold, model.gamma), (0.3, None));
    assert!(evaluation.per_season.iter().all(|s| s.threshold.named().iter().all(|(_, t)| **t == 0.3)));
    let table = evaluation.scores.svm.contingency;
    assert_eq!(evaluation.scores.svm.expected_cost, table.expected_cost(0.3));
    assert!(table.expected_cost(0.3).unwrap() < evaluation.base_rate, "cheaper than never to warn");
}

/// What a retraining compares is what the parts say of themselves: the candidate is its own evaluation; the active model on
/// its own seasons is its own evaluation, and on a season that it never saw it is that model at another place.
#[test]
fn a_retraining_compares_what_was_held_out_from_both() {
    let days = synthetic_station(21, 2000, 6);
    let early: Vec<DayRecord> = days.iter().filter(|day| season_of(day.date) < 2004).copied().collect();
    let options = options();
    let active = train(&early, &options, &Unobserved).unwrap();
    let (candidate, comparison) = retrain(&[&days], &options, &active.model.training.seasons, &Unobserved).unwrap();
    let comparison = comparison.unwrap();
    assert_eq!(candidate, train(&days, &options, &Unobserved).unwrap());
    assert_eq!((comparison.seasons.len(), comparison.new_seasons.as_slice()), (6, &[2004, 2005][..]));
    assert_eq!(comparison.candidate, candidate.evaluation.scores.svm);
    let target =
        transfer::Target { days: &days, reported: &options.reported, trained_on: &active.model.training.seasons };
    let elsewhere = transfer::evaluate(&active.model, target, 1, &Unobserved).unwrap();
    let own = active.evaluation.per_season.iter().map(|season| (season.season, season.scores.svm));
    let new = elsewhere.per_season.iter().map(|season| (season.season, season.scores.svm.unwrap()));
    for ((season, expected), compared) in own.chain(new).zip(&comparison.per_season) {
        assert_eq!(compared.season, season);
        // the climatology that both are measured against is that of all seasons
        let found = Scores { brier_skill: expected.brier_skill, ..compared.active };
        assert_eq!(found, expected, "{season}");
    }
    let auc = comparison.difference.auc.unwrap();
    assert_eq!(auc.estimate, comparison.candidate.auc.unwrap() - comparison.active.auc.unwrap());
    assert!(auc.lower <= auc.estimate && auc.estimate <= auc.upper);

    // the same seasons: nothing differs
    let (_, same) = retrain(&[&early], &options, &active.model.training.seasons, &Unobserved).unwrap();
    let same = same.unwrap();
    assert_eq!((same.candidate, same.new_seasons.len(), same.verdict), (same.active, 0, Verdict::NoDifference));
    assert_eq!(same.difference.pss.unwrap().upper, 0.0);
    // an active model of two seasons cannot be judged without one of them
    let (_, none) = retrain(&[&early], &options, &[2000, 2001], &Unobserved).unwrap();
    let known: Vec<i16> = none.unwrap().seasons;
    assert_eq!(known, [2002, 2003], "a season that the active model saw leaves it one alone");
}
