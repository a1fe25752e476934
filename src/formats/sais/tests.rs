//! Whole files: the traps of the export with the fields as they stand in the archive.

use jiff::civil::date;

use super::*;
use crate::domain::avalanche::{AvalancheTrigger, AvalancheType};
use crate::formats::FlagCode;
use crate::science::forecast::day::{Activity, Variable};

const HEADER: &str = "Date, Area, Obs, Grid, Alt, Aspect, Incline, Location, Air Temp, Wind Dir, Wind Speed, Cloud, \
                      Precip Code, Drift, Total Snow Depth, Foot Pen, Ski Pen, Rain at 900, Summit Air Temp, \
                      Summit Wind Dir, Summit Wind Speed, Observed aval. hazard, Forecast aval. hazard, \
                      Avalanche Code, Max Temp Grad, Max Hardness Grad, No Settle, Snow Index, Insolation, Crystals, \
                      Wetness, AV Cat, Snow Temp, Comments,";

/// A row with the given fields; every other optional column is 0, every other column blank.
fn row(fields: &[(&str, &str)]) -> String {
    let optional = [
        "Alt",
        "Aspect",
        "Incline",
        "Total Snow Depth",
        "Ski Pen",
        "Summit Air Temp",
        "Summit Wind Dir",
        "Summit Wind Speed",
        "Max Temp Grad",
        "Max Hardness Grad",
        "Crystals",
        "Wetness",
    ];
    let field = |name: &str| match fields.iter().find(|(given, _)| *given == name) {
        Some((_, value)) => *value,
        None if name == "Area" => "Lochaber",
        None if optional.contains(&name) => "0",
        None => "",
    };
    HEADER.split(',').map(|name| field(name.trim())).collect::<Vec<_>>().join(",")
}

fn file(rows: &[&[(&str, &str)]]) -> Vec<u8> {
    let lines: Vec<_> = rows.iter().map(|fields| row(fields)).collect();
    format!("{HEADER}\r\n{}\r\n", lines.join("\r\n")).into_bytes()
}

fn import(rows: &[&[(&str, &str)]]) -> Import {
    read(&file(rows), DEFAULT_ZONE, None).unwrap()
}

/// The only day of a file of one row.
fn only(fields: &[(&str, &str)]) -> ImportedDay {
    import(&[fields]).rows.remove(0).outcome.unwrap()
}

fn value(day: &ImportedDay, variable: Variable) -> Option<f64> {
    day.values[variable.index()]
}

fn codes(day: &ImportedDay) -> Vec<(&str, FlagCode)> {
    day.flags.iter().map(|flag| (flag.field.as_str(), flag.code)).collect()
}

#[test]
fn a_row_of_the_archive_becomes_a_day_in_our_units() {
    let day = only(&[
        ("Date", "21/12/1993 00:00"),
        ("Air Temp", "-6"),
        ("Wind Dir", "250.00"),
        ("Wind Speed", "23"),
        ("Cloud", "90"),
        ("Drift", "1"),
        ("Foot Pen", "40"),
        ("Rain at 900", "0"),
        ("Avalanche Code", "4013"),
        ("No Settle", "8"),
        ("Snow Index", "8"),
        ("Insolation", "2"),
        ("Snow Temp", "4.8"),
    ]);
    let expected = [
        Some(-6.0),
        Some(23.0 * 0.44704),
        Some(250.0),
        Some(90.0),
        None,
        None,
        Some(8.0),
        None,
        Some(0.0),
        Some(1.0),
        Some(40.0),
        Some(-4.8),
        Some(2.0),
        Some(8.0),
    ];
    assert_eq!(day.values, expected);
    let record = day.avalanche.unwrap();
    assert_eq!((record.activity, record.count.map(|count| count.get())), (Activity::Observed, Some(4)));
    assert_eq!(record.r#type, Some(AvalancheType::Dry));
    assert_eq!(record.trigger, Some(AvalancheTrigger::NaturalAndTriggered));
    assert_eq!(day.flags, []);
}

#[test]
fn zeros_of_ordinary_columns_are_values_even_in_one_row() {
    let fields = [
        ("Date", "05/01/2004"),
        ("Rain at 900", "0"),
        ("Drift", "0"),
        ("Cloud", "0"),
        ("Snow Index", "0"),
        ("Foot Pen", "0"),
        ("Wind Speed", "0"),
        ("Wind Dir", "0"),
    ];
    let found = import(&[&fields]);
    let day = found.rows[0].outcome.as_ref().unwrap();
    for variable in [
        Variable::RainAt900m,
        Variable::SnowDrift,
        Variable::CloudCover,
        Variable::NewSnowIndex,
        Variable::FootPenetration,
        Variable::WindSpeed,
        Variable::WindDirection,
    ] {
        assert_eq!(value(day, variable), Some(0.0), "{}", variable.name());
    }
    assert_eq!(value(day, Variable::SnowHeight), None);
    for column in ["Total Snow Depth", "Alt", "Summit Wind Speed", "Summit Wind Dir", "Air Temp", "Precip Code"] {
        assert!(found.not_reported.iter().any(|name| name == column), "{column}");
    }
    for column in ["Cloud", "Rain at 900", "Drift", "Snow Index"] {
        assert!(!found.not_reported.iter().any(|name| name == column), "{column}");
    }
}

#[test]
fn snow_depth_is_read_where_any_row_has_one() {
    let found = import(&[
        &[("Date", "05/01/2004"), ("Total Snow Depth", "120")],
        &[("Date", "06/01/2004"), ("Total Snow Depth", "0")],
    ]);
    let heights: Vec<_> =
        found.rows.iter().map(|row| value(row.outcome.as_ref().unwrap(), Variable::SnowHeight)).collect();
    assert_eq!(heights, [Some(120.0), Some(0.0)]);
    assert!(!found.not_reported.contains(&"Total Snow Depth".to_owned()));
}

#[test]
fn impossible_values_become_missing_with_a_flag() {
    let day = only(&[
        ("Date", "16/04/2006"),
        ("Insolation", "24"),
        ("Cloud", "110"),
        ("Drift", "2"),
        ("Foot Pen", "-5"),
        ("Air Temp", "99"),
        ("Wind Speed", "JS left early"),
    ]);
    let mut found = codes(&day);
    found.sort_by_key(|(field, _)| *field);
    let out = FlagCode::OutOfRange;
    assert_eq!(
        found,
        [
            ("air_temperature", out),
            ("cloud_cover", out),
            ("foot_penetration", out),
            ("insolation_index", out),
            ("snow_drift", out),
            ("wind_speed", FlagCode::Unreadable)
        ]
    );
    assert_eq!(day.values, [None; 14]);
    let insolation = day.flags.iter().find(|flag| flag.field == "insolation_index").unwrap();
    assert_eq!(
        (insolation.value.as_str(), insolation.detail.as_str()),
        ("24", "must be between 2 and 20; kept as missing")
    );
    assert!(day.flags.iter().all(|flag| !flag.value.contains("JS") && !flag.detail.contains("JS")));
}

#[test]
fn sentinels_are_missing_without_a_flag_and_minus_one_is_a_temperature() {
    let day = only(&[
        ("Date", "05/01/2004"),
        ("Air Temp", "-1"),
        ("Snow Temp", "-1"),
        ("Cloud", "-1"),
        ("Wind Speed", "-9999"),
        ("Foot Pen", "-1"),
        ("Avalanche Code", "-9999"),
    ]);
    assert_eq!(value(&day, Variable::AirTemperature), Some(-1.0));
    assert_eq!(value(&day, Variable::SnowTemperature), Some(-1.0));
    assert_eq!(day.values.iter().flatten().count(), 2);
    assert_eq!(day.avalanche.unwrap().activity, Activity::Unknown);
    assert_eq!(day.flags, []);
}

#[test]
fn without_an_avalanche_column_nothing_is_said_of_avalanches() {
    let found = read(b"Date,Area,Cloud\n2004-01-05,Lochaber,90\n", DEFAULT_ZONE, None).unwrap();
    assert_eq!(found.rows[0].outcome.as_ref().unwrap().avalanche, None);
    let day = only(&[("Date", "05/01/2004"), ("Avalanche Code", "5555")]);
    assert_eq!(codes(&day), [("avalanche_activity", FlagCode::UnknownCode)]);
    assert_eq!(day.avalanche.unwrap().activity, Activity::Unknown);
}

#[test]
fn precipitation_codes_take_the_place_of_the_snow_index() {
    let index = |date, index, code| {
        let day = only(&[("Date", date), ("Snow Index", index), ("Precip Code", code)]);
        (value(&day, Variable::NewSnowIndex), day.flags.first().map(|flag| flag.code))
    };
    assert_eq!(index("05/01/2008", "0", "8 - Snow"), (Some(8.0), None));
    assert_eq!(index("05/01/2008", "", "0 - None"), (Some(0.0), None));
    assert_eq!(index("05/01/2008", "0", ""), (None, Some(FlagCode::NotReported)));
    assert_eq!(index("05/01/2008", "6", ""), (Some(6.0), None));
    assert_eq!(index("05/01/2008", "6", "8 - Snow"), (Some(8.0), Some(FlagCode::ColumnsDisagree)));
    assert_eq!(index("05/01/2008", "0", "Snow"), (None, Some(FlagCode::Unreadable)));
    assert_eq!(index("05/01/2008", "0", "12 - Blizzard"), (None, Some(FlagCode::OutOfRange)));
    assert_eq!(index("05/01/2007", "0", ""), (Some(0.0), None));
    assert_eq!(index("05/01/2007", "6", "0 - None"), (Some(6.0), None));
}

#[test]
fn the_wind_stays_that_of_the_summit() {
    let before = only(&[("Date", "05/01/2007"), ("Wind Speed", "20"), ("Wind Dir", "90"), ("Summit Wind Speed", "50")]);
    assert_eq!(value(&before, Variable::WindSpeed), Some(20.0 * 0.44704));
    let found = import(&[
        &[
            ("Date", "05/01/2008"),
            ("Wind Speed", "20"),
            ("Wind Dir", "90"),
            ("Summit Wind Speed", "50"),
            ("Summit Wind Dir", "270"),
        ],
        &[("Date", "06/01/2008"), ("Wind Speed", "20"), ("Wind Dir", "90")],
        &[("Date", "07/01/2008"), ("Wind Speed", "20"), ("Wind Dir", "90"), ("Summit Air Temp", "-4")],
    ]);
    let winds: Vec<_> = found
        .rows
        .iter()
        .map(|row| {
            let day = row.outcome.as_ref().unwrap();
            (value(day, Variable::WindSpeed), value(day, Variable::WindDirection), codes(day))
        })
        .collect();
    assert_eq!(winds[0], (Some(50.0 * 0.44704), Some(270.0), vec![]));
    assert_eq!(winds[1], (Some(20.0 * 0.44704), Some(90.0), vec![("wind_speed", FlagCode::OtherSite)]));
    assert_eq!(winds[2], (Some(0.0), Some(0.0), vec![]));
    let pit = import(&[&[("Date", "05/01/2008"), ("Wind Speed", "20"), ("Wind Dir", "90")]]);
    assert_eq!(value(pit.rows[0].outcome.as_ref().unwrap(), Variable::WindSpeed), Some(20.0 * 0.44704));
    assert!(pit.notes[0].contains("pit site"), "{:?}", pit.notes);
}

#[test]
fn tenths_of_other_areas_are_read_and_told() {
    let found = import(&[&[("Date", "05/01/2004"), ("Area", "Glencoe"), ("Air Temp", "-35"), ("Snow Temp", "48")]]);
    let day = found.rows[0].outcome.as_ref().unwrap();
    assert_eq!(value(day, Variable::AirTemperature), Some(-3.5));
    assert_eq!(value(day, Variable::SnowTemperature), Some(-4.8));
    assert_eq!(
        found.notes,
        [
            "Air Temp of Glencoe was read as tenths of a degree on 1 rows",
            "Snow Temp of Glencoe was read as tenths of a degree on 1 rows"
        ]
    );
    let nowhere = read(b"Date,Air Temp\n2004-01-05,-35\n", DEFAULT_ZONE, None).unwrap();
    assert_eq!(codes(nowhere.rows[0].outcome.as_ref().unwrap()), [("air_temperature", FlagCode::UnknownUnit)]);
    let named = read(b"Date,Air Temp\n2004-01-05,-35\n", DEFAULT_ZONE, Some("glencoe")).unwrap();
    assert_eq!(value(named.rows[0].outcome.as_ref().unwrap(), Variable::AirTemperature), Some(-3.5));
}

#[test]
fn rows_of_other_areas_are_refused_and_told_which_is_accepted() {
    let bytes = file(&[
        &[("Date", "05/01/2004")],
        &[("Date", "05/01/2004"), ("Area", "Glencoe")],
        &[("Date", "06/01/2004"), ("Area", "")],
        &[("Date", "07/01/2004"), ("Area", " lochaber ")],
    ]);
    let refused = |area| -> Vec<_> {
        let found = read(&bytes, DEFAULT_ZONE, area).unwrap();
        found.rows.into_iter().filter_map(|row| row.outcome.err()).map(|error| (error.line, error.code)).collect()
    };
    assert_eq!(refused(None), [(3, RowErrorCode::OtherArea)]);
    assert_eq!(refused(Some("GLENCOE")), [(2, RowErrorCode::OtherArea), (5, RowErrorCode::OtherArea)]);
    let found = read(&bytes, DEFAULT_ZONE, None).unwrap();
    let error = found.rows[1].outcome.as_ref().unwrap_err();
    assert_eq!((error.column, error.detail.contains("rows of Lochaber are accepted")), (Some(12), true));
}

#[test]
fn the_later_profile_of_a_day_gives_the_values_and_the_stronger_activity_stays() {
    let found = import(&[
        &[("Date", "05-Jan-2004 14:00"), ("Cloud", "50"), ("Avalanche Code", "4400")],
        &[("Date", "05-Jan-2004 09:30"), ("Cloud", "90"), ("Foot Pen", "10"), ("Avalanche Code", "2011")],
        &[("Date", "06/01/2004"), ("Cloud", "1"), ("Avalanche Code", "0")],
        &[("Date", "06/01/2004"), ("Cloud", "2"), ("Avalanche Code", "7777")],
        &[("Date", "06/01/2004"), ("Cloud", "3"), ("Avalanche Code", "")],
    ]);
    let days: Vec<_> = found
        .rows
        .iter()
        .map(|row| {
            let day = row.outcome.as_ref().unwrap();
            (row.line, row.date.unwrap(), value(day, Variable::CloudCover), day.avalanche.unwrap().activity)
        })
        .collect();
    assert_eq!(
        days,
        [(2, date(2004, 1, 5), Some(50.0), Activity::Observed), (6, date(2004, 1, 6), Some(3.0), Activity::None)]
    );
    let first = found.rows[0].outcome.as_ref().unwrap();
    assert_eq!(value(first, Variable::FootPenetration), None);
    assert_eq!(first.avalanche.unwrap().count.unwrap().get(), 2);
    assert_eq!((first.flags[0].code, first.flags[0].value.as_str()), (FlagCode::DuplicateDay, "line 3"));
    let merged: Vec<_> = found.merged.iter().map(|row| (row.line, row.into_line)).collect();
    assert_eq!(merged, [(3, 2), (4, 6), (5, 6)]);
}

#[test]
fn comments_of_every_kind_neither_shift_columns_nor_show() {
    let comments = [
        "wind slab on NE, deep \"stuff\"",
        "\"first line\r\nsecond, line\"",
        "\"never closed, deep \"stuff",
        "it's \"quoted\", twice\", and \"again",
        "Considerable -",
        "Gr\u{e8}s, caf\u{e9}",
    ];
    for comment in comments {
        let hazard = ("Observed aval. hazard", "Considerable -");
        let bytes = file(&[
            &[
                ("Date", "05/01/2004"),
                ("Grid", "=\"192744\""),
                ("Snow Temp", "4"),
                hazard,
                ("Obs", "XYZ"),
                ("Comments", comment),
            ],
            &[("Date", "06/01/2004"), ("Snow Temp", "5")],
        ]);
        let found = read(&bytes, DEFAULT_ZONE, None).unwrap();
        let temperatures: Vec<_> =
            found.rows.iter().map(|row| value(row.outcome.as_ref().unwrap(), Variable::SnowTemperature)).collect();
        assert_eq!(temperatures, [Some(-4.0), Some(-5.0)], "{comment}");
        let everything = format!("{found:?}");
        for private in ["XYZ", "192744", "stuff", "second", "quoted", "caf\u{e9}"] {
            assert!(!everything.contains(private), "{private}");
        }
    }
}

#[test]
fn a_windows_file_with_a_mark_or_with_latin_letters_is_read() {
    let mut marked = b"\xef\xbb\xbf".to_vec();
    marked.extend(file(&[&[("Date", "05/01/2004"), ("Cloud", "90")]]));
    assert_eq!(read(&marked, DEFAULT_ZONE, None).unwrap().rows[0].date, Some(date(2004, 1, 5)));
    let latin = b"Date,Area,Cloud,Comments\r\n05/01/2004,Loch\xe0ber,90,caf\xe9 \x96 cold\r\n";
    let found = read(latin, DEFAULT_ZONE, Some("Loch\u{e0}ber")).unwrap();
    assert!(found.rows[0].outcome.is_ok());
}

#[test]
fn unreadable_dates_and_broken_rows_are_refused_with_their_place() {
    let body = "Date,Area,Cloud,Comments\n31/02/2004,Lochaber,90,\n05/01/2004,Loch\n06/01/2004,Lochaber,80,x";
    let found = read(body.as_bytes(), DEFAULT_ZONE, None).unwrap();
    let errors: Vec<_> = found.rows.iter().filter_map(|row| row.outcome.as_ref().err()).collect();
    assert_eq!((errors[0].line, errors[0].column, errors[0].code), (2, Some(1), RowErrorCode::UnreadableDate));
    assert!(errors[0].detail.contains("15/04/2007 23:00"));
    assert_eq!((errors[1].line, errors[1].column, errors[1].code), (3, Some(16), RowErrorCode::RaggedRow));
    assert!(found.rows[2].outcome.is_ok());
    let surplus = read(b"Date,Cloud\n2004-01-05,90,7\n", DEFAULT_ZONE, None).unwrap();
    let error = surplus.rows[0].outcome.as_ref().unwrap_err();
    assert_eq!((error.line, error.column, error.code), (2, Some(15), RowErrorCode::RaggedRow));
}

#[test]
fn what_is_no_export_is_refused_as_a_whole() {
    assert_eq!(read(b" \n", DEFAULT_ZONE, None), Err(FormatError::Empty));
    assert!(matches!(read(b"a,b\n1,2\n", DEFAULT_ZONE, None), Err(FormatError::MissingColumn { line: 1, .. })));
    assert!(matches!(read(b"Date\n", "Europe/Lochaber", None), Err(FormatError::UnknownZone { .. })));
    assert!(matches!(read(b"PK\x03\x04", DEFAULT_ZONE, None), Err(FormatError::NotText { .. })));
    let many = format!("Date,Area\n{}", "2004-01-05,L\n".repeat(MAX_ROWS + 1));
    assert_eq!(read(many.as_bytes(), DEFAULT_ZONE, None), Err(FormatError::TooManyRows { line: MAX_ROWS as u64 + 2 }));
    assert_eq!(read(b"Date,Area\n", DEFAULT_ZONE, None).unwrap().rows, []);
}
