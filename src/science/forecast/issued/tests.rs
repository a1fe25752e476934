use jiff::ToSpan;
use jiff::civil::date;

use super::*;
use crate::forecast::day::Activity;

fn recorded(date: Date, event: bool) -> DayRecord {
    DayRecord { activity: if event { Activity::Observed } else { Activity::None }, ..DayRecord::empty(date) }
}

fn said(probability: f64) -> Said {
    Said { probability, warned: probability >= 0.5 }
}

fn issued(date: Date, event: bool, probability: f64) -> IssuedDay {
    IssuedDay {
        date,
        event,
        model: said(probability),
        forecaster: None,
        training_base_rate: 0.25,
        imputed: vec![],
        out_of_range: vec![],
    }
}

/// Ten days of January: events on the 3rd, 4th, 8th and 10th, and probabilities that miss the 8th and cry wolf on the 6th.
fn ten_days() -> (Vec<IssuedDay>, Vec<DayRecord>) {
    let events = [3, 4, 8, 10];
    let probability = [0.1, 0.2, 0.9, 0.7, 0.3, 0.8, 0.1, 0.4, 0.2, 0.6];
    let day = |d: usize| date(2010, 1, 1).checked_add((d as i64).days()).unwrap();
    let is_event = |d: usize| events.contains(&(d + 1));
    let before = (0..200).map(|d| date(2009, 1, 1).checked_add((d as i64).days()).unwrap());
    let mut history: Vec<DayRecord> = before.map(|date| recorded(date, date.day() == 15)).collect();
    history.extend((0..10).map(|d| recorded(day(d), is_event(d))));
    ((0..10).map(|d| issued(day(d), is_event(d), probability[d])).collect(), history)
}

#[test]
fn the_table_of_the_model_is_counted_by_hand() {
    let (days, history) = ten_days();
    let found = verify(&days, &history, Label::Observed, Some(0.3), 1);
    assert_eq!((found.days, found.events, found.seasons.as_slice()), (10, 4, &[2009][..]));
    let table = found.model.scores.contingency;
    assert_eq!((table.a, table.b, table.c, table.d), (3, 1, 1, 5));
    assert!((found.model.scores.pss.unwrap() - (3.0 / 4.0 - 1.0 / 6.0)).abs() < 1e-15);
    assert!((found.model.scores.expected_cost.unwrap() - (0.3 * 4.0 + 1.0) / 10.0).abs() < 1e-15);
    assert_eq!((found.model.intervals, found.forecaster.is_none()), (None, true), "one season has no bootstrap");
    let parts = found.brier_decomposition.unwrap();
    let brier =
        parts.reliability - parts.resolution + parts.uncertainty + parts.within_variance - parts.within_covariance;
    assert!((brier - found.model.scores.brier.unwrap()).abs() < 1e-12);
}

#[test]
fn persistence_and_climatology_know_the_days_before_alone() {
    let (days, history) = ten_days();
    let found = verify(&days, &history, Label::Observed, None, 1);
    // an event on the 3rd, 4th and 8th warns of the 4th, 5th and 9th
    let table = found.persistence.scores.contingency;
    assert_eq!((table.a, table.b, table.c, table.d), (1, 2, 3, 4));
    // what happens on the day itself and later changes nothing that was said of it
    let mut later = history.clone();
    later.iter_mut().filter(|day| day.date >= days[5].date).for_each(|day| day.activity = Activity::Observed);
    let until = |history: &[DayRecord], i: usize| {
        let free = Free::until(history, Label::Observed, days[i].date);
        (free.climatology, free.persistence)
    };
    assert_eq!(until(&history, 5), until(&later, 5));
    assert_ne!(until(&history, 7), until(&later, 7));
    // seven of 200 days of 2009 were events (the 15th of seven months); the last day of the year is not recorded
    let free = Free::until(&history, Label::Observed, days[0].date);
    assert!(!free.persistence.warned && (free.persistence.probability - 7.0 / 200.0).abs() < 1e-12);
    // seven of the 192 quiet days whose next day is recorded were followed by an event, and the first of January is quiet
    let free = Free::until(&history, Label::Observed, days[1].date);
    assert!((free.persistence.probability - 7.0 / 192.0).abs() < 1e-12);
}

#[test]
fn the_forecaster_is_judged_on_the_days_of_a_call() {
    let (mut days, history) = ten_days();
    for (i, day) in days.iter_mut().enumerate().take(6) {
        day.forecaster = Some(Said { probability: f64::from(u8::from(i == 2 || i == 3)), warned: i == 2 || i == 3 });
    }
    let found = verify(&days, &history, Label::Observed, None, 1);
    let (forecaster, model) = (found.forecaster.unwrap(), found.model_on_called_days.unwrap());
    assert_eq!((forecaster.days, forecaster.events, model.days, model.events), (6, 2, 6, 2));
    assert_eq!((forecaster.scores.pss, forecaster.scores.brier), (Some(1.0), Some(0.0)));
    assert_eq!((model.scores.contingency.a, model.scores.contingency.b), (2, 1));
    let half = found.cost_loss.iter().find(|point| point.ratio == 0.5).unwrap();
    assert_eq!(half.forecaster, Some(1.0), "a perfect forecast has the value 1");
}

/// Richardson (2000), eq. 8: with hit rate H, false alarm rate F and base rate s below the ratio r,
/// V = H - F (1 - s) / s r / (1 - r) ... for r = s: V = H - F, the Peirce skill score.
#[test]
fn the_value_at_the_base_rate_is_the_peirce_score() {
    let (days, history) = ten_days();
    let found = verify(&days, &history, Label::Observed, None, 1);
    let at = found.cost_loss.iter().find(|point| (point.ratio - 0.4).abs() < 1e-12).unwrap();
    // at 0.4 the user protects on the 3rd, 4th, 6th, 8th and 10th: all four events, one false alarm of six
    assert!((at.model.unwrap() - (1.0 - 1.0 / 6.0)).abs() < 1e-12, "{at:?}");
    assert_eq!(found.cost_loss.len(), 19);
}

#[test]
fn drift_is_tested_and_told() {
    let (days, history) = ten_days();
    let drift = verify(&days, &history, Label::Observed, None, 1).drift;
    // (4 - 10 / 4) / sqrt(10 * 3 / 16)
    assert!((drift.base_rate_z.unwrap() - 1.5 / (30.0_f64 / 16.0).sqrt()).abs() < 1e-12);
    // Python, with p and o as above: sum((o-p)*(1-2*p)) / sqrt(sum((1-2*p)**2*p*(1-p)))
    assert!((drift.calibration_z.unwrap() - -0.30429030972509225).abs() < 1e-12, "{drift:?}");
    assert!(drift.warnings.is_empty(), "{:?}", drift.warnings);

    // all probabilities near 1 and half of the wind unknown
    let wrong: Vec<IssuedDay> = (0..100)
        .map(|d| {
            let mut day = issued(date(2010, 1, 1).checked_add((d as i64).days()).unwrap(), d % 2 == 0, 0.95);
            if d % 2 == 0 {
                day.imputed.push("wind_speed_t".to_owned());
            }
            if d % 10 == 0 {
                day.out_of_range.push("air_temperature_t".to_owned());
            }
            day
        })
        .collect();
    let drift = verify(&wrong, &history, Label::Observed, None, 1).drift;
    let about = |word: &str| drift.warnings.iter().any(|warning| warning.contains(word));
    assert!(about("base rate: 50 %") && about("calibration: mean probability 95 %"), "{:?}", drift.warnings);
    assert!(
        about("wind_speed_t was imputed on 50 %") && about("air_temperature_t was outside"),
        "{:?}",
        drift.warnings
    );
    assert_eq!(drift.inputs.len(), 2);
}

#[test]
fn two_seasons_have_a_bootstrap_and_no_day_has_no_score() {
    let (mut days, history) = ten_days();
    let second: Vec<IssuedDay> =
        days.iter().map(|day| IssuedDay { date: day.date.checked_add(1.year()).unwrap(), ..day.clone() }).collect();
    days.extend(second);
    let found = verify(&days, &history, Label::Observed, None, 1);
    assert_eq!(found.seasons, [2009, 2010]);
    let interval = found.model.intervals.unwrap().pss.unwrap();
    // both seasons are alike, so every replicate is the same
    assert!((interval.lower - interval.upper).abs() < 1e-12);
    assert_eq!(verify(&days, &history, Label::Observed, None, 1), found);
    let nothing = verify(&[], &[], Label::Observed, None, 1);
    assert_eq!((nothing.days, nothing.model.scores.pss, nothing.drift.base_rate), (0, None, None));
    assert!(serde_json::to_string(&nothing).is_ok());
}
