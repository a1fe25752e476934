//! The export of Lochaber, winters 1993/94 to 2006/07, against the same days decoded by an independent script.
//!
//! The files are not part of the project: they are looked for in `FIRN_SHARED_DATA` or `../shared/data`, and the tests
//! say that they are skipped where they are absent.

use std::collections::HashMap;
use std::path::PathBuf;

use firn::domain::avalanche::{AvalancheTrigger, AvalancheType};
use firn::formats::{FlagCode, Import, ImportedDay, observations_csv, sais};
use firn::science::forecast::day::{Activity, Variable};

type Decoded = HashMap<String, HashMap<String, String>>;

fn shared(name: &str) -> Option<Vec<u8>> {
    let beside = || PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../shared/data");
    let folder = std::env::var_os("FIRN_SHARED_DATA").map_or_else(beside, PathBuf::from);
    let path = folder.join(name);
    let found = std::fs::read(&path).ok();
    if found.is_none() {
        println!("skipped: {} is absent", path.display());
    }
    found
}

fn lochaber() -> Option<(Import, Decoded)> {
    let export = shared("sais_lochaber_1993-2007.csv")?;
    let decoded = shared("sais_lochaber_1993-2007_decoded.csv")?;
    let import = sais::read(&export, sais::DEFAULT_ZONE, None).unwrap();
    let days = csv::Reader::from_reader(decoded.as_slice()).into_deserialize::<HashMap<String, String>>();
    Some((import, days.map(|day| day.unwrap()).map(|day| (day["date"].clone(), day)).collect()))
}

/// The number in a column of the decoded file, `None` where it is blank.
fn number(day: &HashMap<String, String>, column: &str) -> Option<f64> {
    Some(day[column].as_str()).filter(|field| !field.is_empty()).map(|field| field.parse().unwrap())
}

fn days(import: &Import) -> impl Iterator<Item = (String, &ImportedDay)> {
    import.rows.iter().map(|row| (row.date.unwrap().to_string(), row.outcome.as_ref().unwrap()))
}

#[test]
fn every_day_equals_the_decoded_file_value_by_value() {
    let Some((import, decoded)) = lochaber() else { return };
    assert_eq!((import.rows.len(), decoded.len()), (1582, 1582));
    for (date, day) in days(&import) {
        let truth = &decoded[&date];
        let expected = |variable| match variable {
            Variable::AirTemperature => number(truth, "air_temp_c"),
            Variable::WindSpeed => number(truth, "wind_speed_mph").map(|mph| mph * 0.44704),
            Variable::WindDirection => number(truth, "wind_dir_deg"),
            Variable::CloudCover => number(truth, "cloud_pct"),
            Variable::NewSnowIndex => number(truth, "snow_index"),
            Variable::RainAt900m => number(truth, "rain_900"),
            Variable::SnowDrift => number(truth, "drift"),
            Variable::FootPenetration => number(truth, "foot_pen_cm"),
            Variable::SnowTemperature => number(truth, "snow_temp_c"),
            Variable::InsolationIndex => number(truth, "insolation"),
            Variable::CumulativeSnowIndex => number(truth, "no_settle"),
            Variable::SnowHeight | Variable::NewSnow24h | Variable::Precipitation24h => None,
        };
        for variable in Variable::ALL {
            assert_eq!(day.values[variable.index()], expected(variable), "{date} {}", variable.name());
        }
    }
}

#[test]
fn every_avalanche_equals_the_decoded_file() {
    let Some((import, decoded)) = lochaber() else { return };
    let mut counted = 0;
    for (date, day) in days(&import) {
        let truth = &decoded[&date];
        let record = day.avalanche.unwrap();
        let activity = match (truth["aval_observed"].as_str(), truth["aval_presumed"].as_str()) {
            ("1", "1") => Activity::Observed,
            ("0", "1") => Activity::Presumed,
            ("0", "0") => Activity::None,
            ("", "") => Activity::Unknown,
            other => panic!("{date}: {other:?}"),
        };
        assert_eq!(record.activity, activity, "{date}");
        let count = record.count.map(|count| count.get());
        assert_eq!(count.map(f64::from), number(truth, "n_avalanches"), "{date}");
        counted += count.unwrap_or(0);
        let trigger = match record.trigger {
            None => "",
            Some(AvalancheTrigger::NaturalAndTriggered) => "natural+triggered",
            Some(trigger) => trigger.name(),
        };
        assert_eq!(
            (record.r#type.map_or("", AvalancheType::name), trigger),
            (truth["aval_type"].as_str(), truth["aval_trigger"].as_str()),
            "{date}"
        );
    }
    let of = |wanted| days(&import).filter(|(_, day)| day.avalanche.unwrap().activity == wanted).count();
    assert_eq!((of(Activity::Observed), of(Activity::Presumed), of(Activity::Unknown)), (294, 619 - 294, 10));
    assert_eq!(counted, 577);
}

#[test]
fn the_only_flag_is_the_insolation_of_one_day() {
    let Some((import, _)) = lochaber() else { return };
    let flags: Vec<_> = days(&import)
        .flat_map(|(date, day)| day.flags.iter().map(move |flag| (date.clone(), flag)))
        .map(|(date, flag)| (date, flag.field.clone(), flag.code, flag.value.clone()))
        .collect();
    assert_eq!(
        flags,
        [("2006-04-16".to_owned(), "insolation_index".to_owned(), FlagCode::OutOfRange, "24".to_owned())]
    );
    assert!(import.merged.is_empty());
    let lines: Vec<_> = import.rows.iter().map(|row| row.line).collect();
    assert_eq!(lines, (2..=1583).collect::<Vec<u64>>());
}

#[test]
fn what_was_not_reported_or_not_read_is_named() {
    let Some((import, _)) = lochaber() else { return };
    assert_eq!(
        import.not_reported,
        [
            "Total Snow Depth",
            "Summit Air Temp",
            "Summit Wind Dir",
            "Summit Wind Speed",
            "Alt",
            "Aspect",
            "Incline",
            "Ski Pen",
            "Max Temp Grad",
            "Max Hardness Grad",
            "Crystals",
            "Wetness",
            "Precip Code"
        ]
    );
    for private in ["Obs", "Location", "Grid", "Comments", "AV Cat"] {
        assert!(import.ignored_columns.iter().any(|name| name == private), "{private}");
    }
    // the days of the decoded file from 2000-01-04 to 2000-06-30 that have a snow temperature
    assert_eq!(import.notes, ["Snow Temp of Lochaber was read as tenths of a degree on 90 rows"]);
}

#[test]
fn the_archive_survives_our_own_csv() {
    let Some((import, _)) = lochaber() else { return };
    let dated =
        import.rows.iter().map(|row| row.outcome.as_ref().unwrap().observation().unwrap().on(row.date.unwrap()));
    let again = observations_csv::read(observations_csv::write(dated).as_bytes()).unwrap();
    let plain = |import: &Import| -> Vec<_> {
        import.rows.iter().map(|row| row.outcome.as_ref().unwrap()).map(|day| (day.values, day.avalanche)).collect()
    };
    assert_eq!(plain(&again), plain(&import));
}
