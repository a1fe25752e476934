//! What must hold for any input.

use firn::domain::avalanche::{AvalancheRecord, AvalancheTrigger, AvalancheType};
use firn::domain::observation::{DatedObservation, Observation};
use firn::domain::units::{AvalancheCount, AvalancheSize, bounds};
use firn::formats::{Import, ndjson, observations_csv, sais};
use firn::science::forecast::day::{Activity, Variable};
use jiff::ToSpan;
use jiff::civil::{Date, date};
use proptest::prelude::*;

const HEADER: &str = "Date, Area, Air Temp, Snow Temp, Avalanche Code, Comments,";

/// Bytes that look like an export often enough to reach the depths of the reader.
fn near_export() -> impl Strategy<Value = Vec<u8>> {
    let piece = prop_oneof![
        Just(HEADER),
        Just("\n"),
        Just("\r\n"),
        Just("\r"),
        Just(","),
        Just("\""),
        Just("\"\""),
        Just("=\"192744\""),
        Just("05/01/2004"),
        Just("2004-01-05"),
        Just("05-Jan-2004 09:30"),
        Just("15/04/2007 23:00"),
        Just("31/02/9999"),
        Just("9999-12-31 23:00"),
        Just("-9999"),
        Just("-1"),
        Just("1e999"),
        Just("4013"),
        Just("8 - Snow"),
        Just(" "),
        Just("Lochaber"),
        Just("Considerable -"),
        Just("deep \"stuff\""),
        Just("\u{e8}"),
        Just("05/01/2004,L,1,2,0,x\n"),
    ];
    prop::collection::vec(piece, 0..60).prop_map(|pieces| format!("{HEADER}\n{}", pieces.concat()).into_bytes())
}

fn activity() -> impl Strategy<Value = Option<AvalancheRecord>> {
    let activity =
        prop::sample::select(vec![Activity::Observed, Activity::Presumed, Activity::None, Activity::Unknown]);
    let details = (
        prop::option::of(0_u32..=1000),
        prop::option::of(prop::sample::select(AvalancheType::ALL.to_vec())),
        prop::option::of(prop::sample::select(AvalancheTrigger::ALL.to_vec())),
        prop::option::of(2_u32..=10),
    );
    let record = (activity, details).prop_map(|(activity, (count, r#type, trigger, halves))| AvalancheRecord {
        activity,
        count: count.map(|count| AvalancheCount::try_from(f64::from(count)).unwrap()),
        r#type,
        trigger,
        size: halves.map(|halves| AvalancheSize::try_from(f64::from(halves) / 2.0).unwrap()),
    });
    prop::option::of(record.prop_filter("true records only", |record| record.contradictions().is_empty()))
}

/// A day within its bounds, with any number of digits.
fn observation() -> impl Strategy<Value = Observation> {
    let values: Vec<_> = Variable::ALL
        .into_iter()
        .map(|variable| {
            let range = bounds(variable);
            let number = if variable.is_boolean() {
                prop::sample::select(vec![0.0, 1.0]).boxed()
            } else {
                (range.min..=range.max).boxed()
            };
            prop::option::of(number)
        })
        .collect();
    (values, activity()).prop_map(|(values, record)| {
        let values: [Option<f64>; 14] = values.try_into().unwrap();
        Observation::from_values(&values, record.as_ref()).unwrap()
    })
}

fn dated(days: Vec<Observation>) -> Vec<DatedObservation> {
    let first: Date = date(2006, 11, 1);
    (0_i64..).zip(days).map(|(offset, day)| day.on(first.checked_add(offset.days()).unwrap())).collect()
}

fn lines_grow(import: &Import) {
    assert!(import.rows.windows(2).all(|pair| pair[0].line < pair[1].line));
    for row in &import.rows {
        match &row.outcome {
            Ok(day) => assert!(day.observation().is_ok() && row.date.is_some()),
            Err(error) => assert!(error.line >= row.line && error.column.is_none_or(|column| column >= 1)),
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn no_bytes_panic(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
        let _ = sais::read(&bytes, sais::DEFAULT_ZONE, None);
        let _ = observations_csv::read(&bytes);
        prop_assert!(ndjson::lines(&bytes).all(|line| !line.json.is_empty()));
    }

    #[test]
    fn what_resembles_an_export_is_read_in_order_and_in_bounds(bytes in near_export()) {
        if let Ok(import) = sais::read(&bytes, "America/Denver", None) {
            lines_grow(&import);
        }
    }

    #[test]
    fn what_resembles_our_csv_is_read_in_order_and_in_bounds(
        rows in prop::collection::vec("[0-9,\"\\r\\n.-]{0,12}|2007-03-0[1-9],(5|x|\"6\"|-1e400)?", 0..12)
    ) {
        if let Ok(import) = observations_csv::read(format!("date,cloud_cover\n{}", rows.join("\n")).as_bytes()) {
            lines_grow(&import);
        }
    }

    #[test]
    fn no_comment_loses_or_shifts_the_next_row(comment in "[a-z\", \u{e8}=\\r\\n-]{0,60}", windows in any::<bool>()) {
        let end = if windows { "\r\n" } else { "\n" };
        let first = format!("05/01/2004,Lochaber,-3,4,2011,{comment}");
        let rows = [HEADER, &first, "06/01/2004,Lochaber,-1,5,0,\"calm\",", "07/01/2004,Lochaber,1,6,4400,,"].join(end);
        let import = sais::read(rows.as_bytes(), sais::DEFAULT_ZONE, None).unwrap();
        // a comment with enough commas behind a line break may itself pass for a row, and is refused
        let accepted: Vec<_> = import.rows.iter().filter_map(|row| row.outcome.as_ref().ok().map(|day| (row.date, day))).collect();
        let temperatures: Vec<_> = accepted
            .iter()
            .map(|(date, day)| (date.unwrap().day(), day.values[Variable::AirTemperature.index()], day.avalanche.unwrap().activity))
            .collect();
        let expected =
            [(5, Some(-3.0), Activity::Observed), (6, Some(-1.0), Activity::None), (7, Some(1.0), Activity::Presumed)];
        prop_assert_eq!(temperatures, expected);
    }

    #[test]
    fn our_csv_reads_back_what_it_wrote(days in prop::collection::vec(observation(), 1..12)) {
        let written = dated(days);
        let import = observations_csv::read(observations_csv::write(written.iter().copied()).as_bytes()).unwrap();
        let read: Vec<_> = import
            .rows
            .iter()
            .map(|row| {
                let day = row.outcome.as_ref().unwrap();
                assert!(day.flags.is_empty(), "{:?}", day.flags);
                day.observation().unwrap().on(row.date.unwrap())
            })
            .collect();
        prop_assert_eq!(read, written);
    }

    #[test]
    fn json_reads_back_what_it_wrote(day in observation()) {
        let text = serde_json::to_string(&day).unwrap();
        prop_assert_eq!(serde_json::from_str::<Observation>(&text).unwrap(), day);
    }
}
