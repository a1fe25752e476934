//! Every formula against values computed by hand on six written days.

use jiff::civil::{Date, date};
use serde::Deserialize;
use serde::de::value::{Error, StrDeserializer};

use crate::forecast::day::{Activity, DayRecord, Variable, season_of};
use crate::forecast::features::archive::REPORTED;
use crate::forecast::features::{FeatureSet, FeatureSetId, History, HistoryError};

/// Order of the columns of [`SIX`], which is that of [`Variable::ALL`].
const ORDER: [Variable; 10] = [
    Variable::AirTemperature,
    Variable::WindSpeed,
    Variable::WindDirection,
    Variable::CloudCover,
    Variable::NewSnowIndex,
    Variable::RainAt900m,
    Variable::SnowDrift,
    Variable::FootPenetration,
    Variable::SnowTemperature,
    Variable::InsolationIndex,
];

/// 1 to 6 January 2020: degC, m/s, deg, %, index, rain, drift, cm, degC, index.
const SIX: [([f64; 10], Activity); 6] = [
    ([-5.0, 10.0, 350.0, 90.0, 4.0, 0.0, 1.0, 20.0, -4.0, 3.0], Activity::None),
    ([-3.0, 20.0, 45.0, 100.0, 8.0, 0.0, 1.0, 40.0, -3.0, 3.0], Activity::Observed),
    ([1.0, 5.0, 135.0, 80.0, 0.0, 1.0, 0.0, 30.0, 0.0, 3.0], Activity::Presumed),
    ([2.0, 2.0, 180.0, 81.0, 2.0, 1.0, 1.0, 35.0, 0.0, 3.0], Activity::None),
    ([-1.0, 4.0, 225.0, 10.0, 0.0, 0.0, 1.0, 30.0, -2.0, 4.0], Activity::Observed),
    ([0.5, 6.0, 270.0, 50.0, 6.0, 1.0, 1.0, 45.0, -1.0, 4.0], Activity::None),
];

const BASE: Date = date(2020, 1, 6);

fn six() -> Vec<DayRecord> {
    let record = |(i, (values, activity)): (usize, &([f64; 10], Activity))| {
        let mut day = DayRecord::empty(date(2020, 1, i as i8 + 1));
        for (variable, &x) in ORDER.iter().zip(values) {
            day.values[variable.index()] = Some(x);
        }
        day.activity = *activity;
        day
    };
    SIX.iter().enumerate().map(record).collect()
}

fn set(day: &mut DayRecord, variable: Variable, x: f64) {
    day.values[variable.index()] = Some(x);
}

/// The feature called `name` of the expert set of a station that reports `reported`.
fn feature(days: &[DayRecord], reported: &[Variable], base: Date, name: &str) -> f64 {
    let expert = FeatureSet::new(FeatureSetId::Expert, reported);
    let column = expert.names().iter().position(|&n| n == name).unwrap_or_else(|| panic!("no feature {name}"));
    expert.compute(&History::new(days).unwrap(), base)[column]
}

fn expect(days: &[DayRecord], base: Date, name: &str, expected: f64) {
    let x = feature(days, &REPORTED, base, name);
    assert!((x - expected).abs() < 1e-12 || (x.is_nan() && expected.is_nan()), "{name}: {x}, by hand {expected}");
}

#[test]
fn each_formula_agrees_with_hand_computation() {
    let days = six();
    let by_hand = [
        ("air_temperature_t", 0.5),
        ("air_temperature_t1", -1.0),
        ("air_temperature_t2", 2.0),
        ("wind_direction_t1", 225.0),
        ("rain_at_900m_t2", 1.0),
        ("new_snow_index_season_sum", 20.0), // 4 + 8 + 0 + 2 + 0 + 6
        ("new_snow_index_sum3", 8.0),        // 6 + 0 + 2
        ("new_snow_index_sum5", 16.0),       // 6 + 0 + 2 + 0 + 8
        ("new_snow_index_decayed5", 7.0),    // 6 + 0/2 + 2/4 + 0/8 + 8/16
        ("snow_indicator_t", 1.0),
        ("days_since_snow", 0.0),
        ("foot_penetration_change1", 15.0),
        ("foot_penetration_change2", 10.0),
        ("air_temperature_change1", 1.5),
        ("air_temperature_change2", -1.5),
        ("snow_temperature_change1", 1.0),
        ("snow_temperature_change2", -1.0),
        ("air_temperature_mean3", 0.5), // (0.5 - 1 + 2) / 3
        ("air_temperature_max3", 2.0),
        ("air_temperature_crossing", 1.0),
        ("degree_days_sum3", 2.5),                   // 0.5 + 0 + 2
        ("snow_temperature_gradient_t", -1.5),       // -1 - 0.5
        ("snow_temperature_gradient_change1", -0.5), // -1.5 - (-2 + 1)
        ("wind_transport_t", 216.0),
        ("wind_transport_sum3", 288.0), // 216 + 64 + 8
        ("wind_u_t", 6.0),              // from the west: eastwards
        ("wind_v_t", 0.0),
        ("wind_sector_north_t", 0.0),
        ("wind_sector_east_t", 0.0),
        ("wind_sector_south_t", 0.0),
        ("wind_sector_west_t", 1.0),
        ("wind_sector_south_to_southeast_t", 0.0),
        ("rain_on_snow_sum3", 2.0), // on the 4th and the 6th
        ("high_cloud_t", 0.0),
        ("activity_t1", 1.0),
        ("activity_t2", 0.0),
        ("activity_sum5", 2.5), // 1 + 0 + 0.5 + 1 + 0
        // 189 days after 1 July, by Python's math.sin and math.cos of 2 pi 189 / 365.25
        ("day_of_season_sine", -0.109_445_768_648_915_56),
        ("day_of_season_cosine", -0.993_992_768_446_958),
    ];
    for (name, expected) in by_hand {
        expect(&days, BASE, name, expected);
    }
    // the other side of each threshold
    expect(&days, date(2020, 1, 3), "wind_transport_t", 0.0); // no drift
    expect(&days, date(2020, 1, 3), "high_cloud_t", 0.0); // 80 % is not above 80 %
    expect(&days, date(2020, 1, 4), "high_cloud_t", 1.0);
    expect(&days, date(2020, 1, 4), "air_temperature_crossing", 0.0); // 1 to 2 degC
    expect(&days, date(2020, 1, 5), "snow_indicator_t", 0.0);
    expect(&days, date(2020, 1, 5), "days_since_snow", 1.0);
    expect(&days, date(2020, 1, 2), "air_temperature_max3", f64::NAN);
    // 20 m/s from the north-east blow to the south-west
    expect(&days, date(2020, 1, 2), "wind_u_t", -20.0 * 0.5_f64.sqrt());
    expect(&days, date(2020, 1, 2), "wind_v_t", -20.0 * 0.5_f64.sqrt());
}

#[test]
fn sectors_meet_without_overlap() {
    let cases = [
        (0.0, "north", false),
        (44.9, "north", false),
        (45.0, "east", false),
        (134.9, "east", false),
        (135.0, "south", true),
        (180.0, "south", true),
        (180.1, "south", false),
        (224.9, "south", false),
        (225.0, "west", false),
        (314.9, "west", false),
        (315.0, "north", false),
        (360.0, "north", false),
    ];
    for (direction, sector, south_to_southeast) in cases {
        let mut days = six();
        set(&mut days[5], Variable::WindDirection, direction);
        for name in ["north", "east", "south", "west"] {
            let expected = f64::from(u8::from(name == sector));
            expect(&days, BASE, &format!("wind_sector_{name}_t"), expected);
        }
        expect(&days, BASE, "wind_sector_south_to_southeast_t", f64::from(u8::from(south_to_southeast)));
    }
}

#[test]
fn a_sum_with_a_missing_day_is_missing_but_for_the_season_sum() {
    let mut days = six();
    days[3].values = DayRecord::empty(days[3].date).values;
    for name in [
        "new_snow_index_sum3",
        "new_snow_index_sum5",
        "new_snow_index_decayed5",
        "degree_days_sum3",
        "wind_transport_sum3",
        "rain_on_snow_sum3",
        "air_temperature_mean3",
        "air_temperature_max3",
        "air_temperature_change2",
        "air_temperature_t2",
    ] {
        expect(&days, BASE, name, f64::NAN);
    }
    expect(&days, BASE, "new_snow_index_season_sum", 18.0); // 20 without the 2 of the 4th
    expect(&days, BASE, "air_temperature_change1", 1.5);
    expect(&days, date(2020, 1, 5), "days_since_snow", f64::NAN); // it may have snowed on the 4th

    // a day that is not in the list is the same as a day on which nothing is known
    let known = |days: &[DayRecord]| {
        let expert = FeatureSet::new(FeatureSetId::Expert, &REPORTED);
        let row = expert.compute(&History::new(days).unwrap(), BASE);
        row.iter().map(|x| x.to_bits()).collect::<Vec<_>>()
    };
    days[3].activity = Activity::Unknown;
    let mut gap = days.clone();
    gap.remove(3);
    assert_eq!(known(&days), known(&gap));
    // so is the base itself, which has a season sum all the same
    gap.truncate(4);
    expect(&gap, BASE, "air_temperature_t", f64::NAN);
    expect(&gap, BASE, "new_snow_index_season_sum", 12.0);
}

#[test]
fn what_is_known_may_decide_a_quantity() {
    let mut days = six();
    days[5].values[Variable::WindSpeed.index()] = None;
    expect(&days, BASE, "wind_transport_t", f64::NAN);
    set(&mut days[5], Variable::SnowDrift, 0.0);
    expect(&days, BASE, "wind_transport_t", 0.0);
    set(&mut days[5], Variable::WindSpeed, 0.0);
    days[5].values[Variable::WindDirection.index()] = None;
    expect(&days, BASE, "wind_u_t", 0.0);
    expect(&days, BASE, "wind_sector_west_t", f64::NAN);
    days[5].values[Variable::RainAt900m.index()] = None;
    expect(&days, BASE, "rain_on_snow_sum3", f64::NAN);
    set(&mut days[5], Variable::AirTemperature, -0.1);
    expect(&days, BASE, "rain_on_snow_sum3", 1.0);
}

#[test]
fn unknown_activity_is_missing_and_never_none() {
    let mut days = six();
    days[4].activity = Activity::Unknown;
    expect(&days, BASE, "activity_t1", f64::NAN);
    expect(&days, BASE, "activity_t2", 0.0);
    expect(&days, BASE, "activity_sum5", f64::NAN);
}

#[test]
fn days_since_snow_stops_at_ten() {
    let days: Vec<_> = (1..=14)
        .map(|d| {
            let mut day = DayRecord::empty(date(2020, 1, d));
            set(&mut day, Variable::NewSnowIndex, if d == 2 { 4.0 } else { 0.0 });
            day
        })
        .collect();
    for (d, expected) in [(1, f64::NAN), (2, 0.0), (11, 9.0), (12, 10.0), (13, 10.0)] {
        expect(&days, date(2020, 1, d), "days_since_snow", expected);
    }
}

#[test]
fn nothing_crosses_the_edge_of_a_season() {
    let mut days = six();
    for (day, at) in days.iter_mut().zip(28..) {
        day.date = if at <= 30 { date(2020, 6, at) } else { date(2020, 7, at - 30) };
    }
    assert_eq!(season_of(days[2].date) + 1, season_of(days[3].date));
    let first = days[3].date;
    expect(&days, first, "new_snow_index_season_sum", 2.0);
    expect(&days, first, "day_of_season_sine", 0.0);
    for name in ["air_temperature_t1", "activity_t1", "new_snow_index_sum3", "air_temperature_crossing"] {
        expect(&days, first, name, f64::NAN);
    }
    expect(&days, days[5].date, "new_snow_index_sum3", 8.0);
    expect(&days, days[5].date, "new_snow_index_sum5", f64::NAN);
    // snow fell on the second day before, which belongs to another season
    set(&mut days[3], Variable::NewSnowIndex, 0.0);
    expect(&days, days[4].date, "days_since_snow", f64::NAN);
}

#[test]
fn other_stations_get_the_same_quantities_from_what_they_report() {
    use Variable::{
        AirTemperature, CumulativeSnowIndex, NewSnow24h, Precipitation24h, RainAt900m, SnowHeight, WindSpeed,
    };
    let mut days = six();
    for (day, (depth, water)) in
        days.iter_mut().zip([(0.0, 0.0), (5.0, 4.0), (7.0, 8.0), (0.0, 2.0), (3.0, 1.0), (10.0, 0.0)])
    {
        set(day, NewSnow24h, depth);
        set(day, Precipitation24h, water);
        set(day, SnowHeight, 100.0 + depth);
        set(day, CumulativeSnowIndex, 200.0 + depth);
    }
    let base = date(2020, 1, 5);
    let expect = |reported: &[Variable], name: &str, expected: f64| {
        let x = feature(&days, reported, base, name);
        assert!((x - expected).abs() < 1e-12, "{name} of {reported:?}: {x}, by hand {expected}");
    };
    expect(&[NewSnow24h, Precipitation24h, AirTemperature], "new_snow_24h_sum3", 10.0); // 3 + 0 + 7
    expect(&[NewSnow24h], "new_snow_24h_decayed5", 3.0 + 7.0 / 4.0 + 5.0 / 8.0);
    expect(&[NewSnow24h], "days_since_snow", 0.0);
    // precipitation of 1, 2 and 8 mm at -1, 2 and 1 degC: only the first is snow, the other two are rain
    expect(&[Precipitation24h, AirTemperature], "snowfall_sum3", 1.0);
    expect(&[Precipitation24h, AirTemperature], "snowfall_season_sum", 5.0);
    expect(&[Precipitation24h, AirTemperature], "snow_indicator_t", 1.0);
    expect(&[Precipitation24h, AirTemperature], "rain_on_snow_sum3", 2.0);
    expect(&[Precipitation24h], "precipitation_24h_sum3", 11.0);
    expect(&[RainAt900m], "rain_on_snow_sum3", 2.0);
    expect(&[SnowHeight], "snow_height_change2", -4.0);
    expect(&[WindSpeed], "wind_transport_sum3", 64.0 + 8.0 + 125.0); // no drift reported: the potential transport
    expect(&[CumulativeSnowIndex], "cumulative_snow_index_t", 203.0);
}

#[test]
fn the_sets_of_the_scottish_service_have_these_names() {
    let raw = FeatureSet::new(FeatureSetId::Raw30, &REPORTED);
    let lags = |v: &Variable| ["t", "t1", "t2"].map(|lag| format!("{}_{lag}", v.name()));
    let expected: Vec<_> = ORDER.iter().flat_map(lags).collect();
    assert_eq!(raw.names(), expected);
    assert_eq!(raw.len(), 30);

    let expert = FeatureSet::new(FeatureSetId::Expert, &REPORTED);
    assert_eq!(expert.names()[..30], raw.names());
    let derived = "new_snow_index_season_sum new_snow_index_sum3 new_snow_index_sum5 new_snow_index_decayed5 \
        snow_indicator_t days_since_snow foot_penetration_change1 foot_penetration_change2 \
        air_temperature_change1 air_temperature_change2 snow_temperature_change1 snow_temperature_change2 \
        air_temperature_mean3 air_temperature_max3 air_temperature_crossing degree_days_sum3 \
        snow_temperature_gradient_t snow_temperature_gradient_change1 wind_transport_t wind_transport_sum3 \
        wind_u_t wind_v_t wind_sector_north_t wind_sector_east_t wind_sector_south_t wind_sector_west_t \
        wind_sector_south_to_southeast_t rain_on_snow_sum3 high_cloud_t \
        activity_t1 activity_t2 activity_sum5 day_of_season_sine day_of_season_cosine";
    assert_eq!(expert.names()[30..], derived.split_whitespace().collect::<Vec<_>>());
    assert_eq!(expert.len(), 64);
}

#[test]
fn each_feature_says_what_it_is() {
    let expert = FeatureSet::new(FeatureSetId::Expert, &REPORTED);
    let find = |name: &str| expert.features.iter().find(|f| f.name == name).unwrap();
    let transport = find("wind_transport_sum3");
    assert_eq!((transport.unit, transport.lag_days), ("m3/s3", 0));
    assert_eq!(transport.formula, "sum over k = 0..2 of wind_speed(t-k)^3 snow_drift(t-k)");
    assert_eq!(transport.inputs, [Variable::WindSpeed, Variable::SnowDrift]);
    assert_eq!(find("air_temperature_t2").lag_days, 2);
    assert_eq!(find("degree_days_sum3").unit, "degC d");
    for past in ["activity_t1", "activity_t2", "activity_sum5"] {
        assert!(find(past).lag_days >= 1 && find(past).inputs.is_empty(), "{past}");
    }
}

#[test]
fn identifiers_are_read_back_from_their_names() {
    for id in FeatureSetId::ALL {
        assert_eq!(id.to_string().parse(), Ok(id));
        assert_eq!(FeatureSetId::deserialize(StrDeserializer::<Error>::new(id.name())), Ok(id));
    }
    assert_eq!(FeatureSetId::Raw30.to_string(), "raw-30");
    assert!("raw".parse::<FeatureSetId>().is_err());
}

#[test]
fn a_history_is_in_strictly_rising_order() {
    let mut days = six();
    days.swap(2, 3);
    let error = HistoryError::Order { index: 3, date: date(2020, 1, 3), previous: date(2020, 1, 4) };
    assert_eq!(History::new(&days).unwrap_err(), error);
    days[2].date = days[1].date;
    assert!(matches!(History::new(&days), Err(HistoryError::Order { index: 2, .. })));
}

#[test]
fn a_history_finds_days_by_date() {
    let mut days = six();
    days.remove(2);
    let history = History::new(&days).unwrap();
    for d in 1..=6 {
        let found = history.day(date(2020, 1, d)).map(|day| day.date);
        assert_eq!(found, (d != 3).then_some(date(2020, 1, d)));
    }
    for outside in [Date::MIN, date(2019, 12, 31), date(2020, 1, 7), Date::MAX] {
        assert!(history.day(outside).is_none());
    }
    assert_eq!(history.season_until(date(2020, 1, 3)).len(), 2);
    assert_eq!(history.season_until(date(2020, 6, 30)).len(), 5);
    assert_eq!(history.season_until(date(2020, 7, 1)).len(), 0);
    assert!(History::new(&[]).unwrap().season_until(BASE).is_empty());
}
