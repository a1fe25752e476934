use jiff::civil::date;
use proptest::prelude::*;
use serde_json::json;

use super::*;
use crate::domain::units::bounds;

fn station() -> Station {
    Station {
        id: "weissfluhjoch".parse().unwrap(),
        body: serde_json::from_value(json!({"name": "Weissfluhjoch; SLF", "latitude": 46.8296, "longitude": 9.8093,
            "altitude_m": 2540}))
        .unwrap(),
        synthetic: false,
        revision: 1,
        created: jiff::Timestamp::UNIX_EPOCH,
        updated: jiff::Timestamp::UNIX_EPOCH,
    }
}

/// A file in degrees Celsius and centimetres, which its header brings to SI as the specification says (raw * multiplier + offset),
/// with a row of missing values.
const FILE: &str = "SMET 1.1 ASCII
[HEADER]
station_id       = Test2
station_name     = TEST2
latitude         = 46.5
longitude        = 9.8
altitude         = 1500
nodata           = -999
tz               = 1
units_offset     = 0 0 273.15 0 0 0
units_multiplier = 1 1 1 0.01 0.01 1
fields           = timestamp DW TA HS RH VW
[DATA]
2010-06-22T12:00:00 90 2.5 150 58 500
2010-06-23T12:00:00 -999 -999 -999 -999 4.5   # nothing but wind
";

fn rows(text: &str) -> Vec<ImportedRow> {
    read(text.as_bytes()).unwrap().rows
}

fn value(row: &ImportedRow, variable: Variable) -> Option<f64> {
    row.outcome.as_ref().unwrap().values[variable.index()]
}

#[test]
fn offsets_and_multipliers_are_honoured() {
    let import = read(FILE.as_bytes()).unwrap();
    let row = &import.rows[0];
    assert_eq!((row.date, row.line), (Some(date(2010, 6, 22)), 14));
    // 2.5 + 273.15 K, 150 * 0.01 m
    assert_eq!(value(row, Variable::AirTemperature), Some(2.5));
    assert_eq!(value(row, Variable::SnowHeight), Some(150.0));
    assert_eq!(value(row, Variable::WindDirection), Some(90.0));
    // 500 m/s cannot be
    assert_eq!(value(row, Variable::WindSpeed), None);
    let flags = &row.outcome.as_ref().unwrap().flags;
    assert_eq!((flags[0].code, flags[0].value.as_str()), (FlagCode::OutOfRange, "500"));
    assert_eq!(value(&import.rows[1], Variable::WindSpeed), Some(4.5));
    assert_eq!(import.rows[1].outcome.as_ref().unwrap().values.iter().flatten().count(), 1);
    assert_eq!((import.ignored_columns, import.not_reported), (vec!["RH".to_owned()], vec![]));
}

#[test]
fn without_units_a_file_is_in_si() {
    let text = "SMET 1.2 ASCII\n[HEADER]\nfields = timestamp TA TSS HS HN PSUM ISWR\n[DATA]\n\
                2010-01-02 271.15 -999 1.5 0.205 12.5 300\n";
    let import = read(text.as_bytes()).unwrap();
    let row = &import.rows[0];
    assert_eq!(value(row, Variable::AirTemperature), Some(-2.0));
    assert_eq!((value(row, Variable::SnowHeight), value(row, Variable::NewSnow24h)), (Some(150.0), Some(20.5)));
    assert_eq!(value(row, Variable::Precipitation24h), Some(12.5));
    // a radiation is no insolation index
    assert_eq!((value(row, Variable::InsolationIndex), import.ignored_columns), (None, vec!["ISWR".to_owned()]));
    assert_eq!(import.not_reported, ["snow_temperature"]);
}

#[test]
fn rows_at_fault_are_refused_with_their_line() {
    let head = "SMET 1.1 ASCII\n[HEADER]\nfields = timestamp TA\n[DATA]\n";
    let text =
        format!("{head}2010-01-02T06:00 270\n2010-01-02T18:00 271\n\n02.01.2010 270\n2010-01-03\n2010-01-04 cold\n");
    let found: Vec<_> =
        rows(&text).into_iter().map(|row| (row.line, row.outcome.map_err(|error| error.code))).collect();
    assert_eq!(found.iter().map(|(line, _)| *line).collect::<Vec<_>>(), [5, 6, 8, 9, 10]);
    let code = |at: usize| found[at].1.as_ref().unwrap_err();
    assert_eq!(
        (code(1), code(2), code(3)),
        (&RowErrorCode::DuplicateDay, &RowErrorCode::UnreadableDate, &RowErrorCode::RaggedRow)
    );
    assert_eq!(found[4].1.as_ref().unwrap().flags[0].code, FlagCode::Unreadable);
}

#[test]
fn headers_at_fault_say_what_is_accepted() {
    let said = |text: &str| read(text.as_bytes()).unwrap_err().to_string();
    assert_eq!(read(b" \n"), Err(FormatError::Empty));
    assert!(said("date,air_temperature\n").contains("`SMET 1.1 ASCII`"));
    assert!(said("SMET 1.1 BINARY\n[HEADER]\n").contains("ASCII"));
    let with = |lines: &str| said(&format!("SMET 1.1 ASCII\n[HEADER]\n{lines}\n[DATA]\n"));
    assert!(with("nodata = -999").contains("no `fields`"));
    assert!(with("fields = TA").contains("`timestamp`"));
    assert!(with("fields = timestamp TA ta").contains("`ta` occurs twice"));
    assert!(with("fields = timestamp TA\nunits_offset = 0").contains("one number for each of the 2 fields"));
    assert!(with("fields = timestamp TA\nunits_multiplier = 1 x").contains("units_multiplier"));
    assert!(with("fields = timestamp TA\nnodata = none").contains("nodata must be a number"));
    assert!(with("fields timestamp TA").contains("key = value"));
    assert!(said("SMET 1.1 ASCII\n[HEADER]\nfields = timestamp TA\n").contains("[DATA]"));
    let place =
        read(b"SMET 1.1 ASCII\n[HEADER]\nfields = timestamp TA\nfields = timestamp\n[DATA]\n").unwrap_err().place();
    assert_eq!(place, Some((4, None)));
}

/// Any possible value of a variable, the yes and no ones 0 or 1.
fn any_value(variable: Variable) -> BoxedStrategy<Option<f64>> {
    let bounds = bounds(variable);
    let value = match bounds.step {
        Some(step) => {
            let steps = ((bounds.max - bounds.min) / step) as u32;
            (0..=steps).prop_map(move |k| bounds.min + step * f64::from(k)).boxed()
        }
        None => (bounds.min..=bounds.max).boxed(),
    };
    prop_oneof![1 => Just(None), 3 => value.prop_map(Some)].boxed()
}

proptest! {
    /// What goes out comes in again, field by field.
    #[test]
    fn what_is_written_is_read_back(
        values in prop::collection::vec(Variable::ALL.map(any_value).to_vec(), 1..20),
    ) {
        let days: Vec<(Date, [Option<f64>; VARIABLES])> = values
            .iter()
            .zip(1..)
            .map(|(values, day)| (date(2010, 1, day), values.clone().try_into().unwrap()))
            .collect();
        let text = write(&station(), &days);
        let back = read(text.as_bytes()).unwrap();
        prop_assert_eq!(back.rows.len(), days.len());
        for ((date, values), row) in days.iter().zip(&back.rows) {
            prop_assert_eq!(row.date, Some(*date));
            let day = row.outcome.as_ref().unwrap();
            prop_assert!(day.flags.is_empty(), "{:?}", day.flags);
            for (found, expected) in day.values.iter().zip(values) {
                prop_assert_eq!(found, expected);
            }
        }
        prop_assert_eq!(write(&station(), &days), text);
    }

    #[test]
    fn no_text_makes_it_panic(text in "(SMET 1.1 ASCII\n)?(\\[HEADER\\]\n)?([a-z]{1,8} = .{0,20}\n){0,4}(fields = timestamp TA\n)?(\\[DATA\\]\n)?.{0,60}") {
        let _ = read(text.as_bytes());
    }
}
