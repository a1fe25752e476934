//! Our own CSV: a `date` column and any of the fields of an observation, under their names in JSON.
//!
//! Blank, `NA` and `null` are missing. A 0 is a 0, even on every row: the format has a way of saying that nothing is
//! reported. What [`write()`] writes, [`read`] reads back as the same days.

use std::collections::HashMap;

use jiff::civil::Date;

use super::csv_source::{Lines, Source, check_quotes};
use super::text::decode;
use super::{Flag, FlagCode, FormatError, Import, ImportedDay, ImportedRow, MAX_ROWS, RowError, RowErrorCode};
use crate::domain::avalanche::{
    AvalancheRecord, AvalancheTrigger, AvalancheType, Contradiction, activity_from_name, activity_name,
};
use crate::domain::observation::DatedObservation;
use crate::domain::units::{AvalancheCount, AvalancheSize, OutOfRange};
use crate::science::forecast::day::Variable;

/// The columns of avalanche activity, as in JSON.
const AVALANCHE: [&str; 5] =
    ["avalanche_activity", "avalanche_count", "avalanche_type", "avalanche_trigger", "avalanche_size"];

/// Every column that [`read`] accepts, in the order in which [`write()`] writes them.
pub fn columns() -> impl Iterator<Item = &'static str> {
    let variables = Variable::ALL.into_iter().map(Variable::name);
    std::iter::once("date").chain(variables).chain(AVALANCHE)
}

/// Reads days from CSV with a header of `date` and any of the other [`columns`], in any order.
///
/// A value outside of its range or that is no number becomes missing with a flag. A row is refused where its date is
/// not `YYYY-MM-DD`, where an earlier row has the same date, or where it has not as many fields as the header.
///
/// # Errors
/// [`FormatError`] for a file that is empty, not text, or not CSV, or that has a header without `date`, with an unknown
/// column or with one column twice, or that has more than [`MAX_ROWS`] rows.
pub fn read(bytes: &[u8]) -> Result<Import, FormatError> {
    let text = decode(bytes)?;
    check_quotes(&text)?;
    let mut reader = csv::ReaderBuilder::new().has_headers(false).flexible(true).from_reader(text.as_bytes());
    let mut lines = Lines::of(&text);
    let mut record = csv::StringRecord::new();
    let mut header: Option<Vec<&'static str>> = None;
    let mut seen = HashMap::new();
    let mut import = Import::default();
    // the text is UTF-8 in memory and rows may be ragged, so reading cannot fail
    while reader.read_record(&mut record).unwrap_or(false) {
        let start = record.position().map_or(0, csv::Position::byte);
        let source = lines.source_at(usize::try_from(start).unwrap_or(usize::MAX));
        if record.iter().all(|field| field.trim().is_empty()) {
            continue;
        }
        let Some(header) = &header else {
            header = Some(read_header(&record, source)?);
            continue;
        };
        if import.rows.len() == MAX_ROWS {
            return Err(FormatError::TooManyRows { line: source.line });
        }
        let (date, outcome) = match read_row(header, &record, source, &mut seen) {
            Ok((date, day)) => (Some(date), Ok(day)),
            Err((date, error)) => (date, Err(error)),
        };
        import.rows.push(ImportedRow { line: source.line, date, outcome });
    }
    let header = header.ok_or(FormatError::Empty)?;
    import.not_reported = not_reported(&header, &import.rows);
    Ok(import)
}

fn read_header(record: &csv::StringRecord, source: Source<'_>) -> Result<Vec<&'static str>, FormatError> {
    let mut header = Vec::with_capacity(record.len());
    for (position, given) in record.iter().enumerate() {
        let (line, column) = source.place_of(position);
        let Some(name) = columns().find(|name| *name == given.trim()) else {
            let accepted = columns().collect::<Vec<_>>().join(", ");
            return Err(FormatError::UnknownColumn { line, column, name: shortened(given), accepted });
        };
        if header.contains(&name) {
            return Err(FormatError::DuplicateColumn { line, column, name: name.to_owned() });
        }
        header.push(name);
    }
    if header.contains(&"date") {
        return Ok(header);
    }
    let expected = "`date` and any of the fields of an observation".to_owned();
    Err(FormatError::MissingColumn { line: source.line, column: "date", expected })
}

type Refused = (Option<Date>, RowError);

fn read_row(
    header: &[&'static str],
    record: &csv::StringRecord,
    source: Source<'_>,
    seen: &mut HashMap<Date, u64>,
) -> Result<(Date, ImportedDay), Refused> {
    let error = |position: usize, field: Option<&str>, code, detail| {
        let (line, column) = source.place_of(position);
        RowError { line, column: Some(column), field: field.map(str::to_owned), code, detail }
    };
    let given = header.iter().position(|name| *name == "date").unwrap_or(0);
    let date = record.get(given).and_then(|text| read_date(text.trim()));
    if record.len() != header.len() {
        let detail = format!("{} fields where the header has {}", record.len(), header.len());
        let position = header.len().min(record.len());
        return Err((date, error(position, None, RowErrorCode::RaggedRow, detail)));
    }
    let Some(date) = date else {
        let detail = "the date must be written YYYY-MM-DD, like 2007-03-01".to_owned();
        return Err((None, error(given, Some("date"), RowErrorCode::UnreadableDate, detail)));
    };
    if let Some(earlier) = seen.get(&date) {
        let detail = format!("line {earlier} already reports {date}: keep one of them");
        return Err((Some(date), error(given, Some("date"), RowErrorCode::DuplicateDay, detail)));
    }
    seen.insert(date, source.line);
    Ok((date, read_day(header, record)))
}

/// A calendar day written YYYY-MM-DD.
fn read_date(text: &str) -> Option<Date> {
    let shape = text.len() == 10
        && text.bytes().enumerate().all(|(at, byte)| match at {
            4 | 7 => byte == b'-',
            _ => byte.is_ascii_digit(),
        });
    if shape { text.parse().ok() } else { None }
}

fn read_day(header: &[&'static str], record: &csv::StringRecord) -> ImportedDay {
    let mut day = ImportedDay::default();
    let mut avalanche = [""; AVALANCHE.len()];
    for (&name, field) in header.iter().zip(record) {
        let field = field.trim();
        if is_missing(field) || name == "date" {
            continue;
        }
        if let Some(variable) = Variable::from_name(name) {
            match read_number(variable, field) {
                Some(value) => day.set_checked(variable, value, shortened(field)),
                None => {
                    unreadable(&mut day, name, field, if variable.is_boolean() { "true or false" } else { "a number" })
                }
            }
        } else if let Some(at) = AVALANCHE.iter().position(|known| *known == name) {
            avalanche[at] = field;
        }
    }
    read_avalanche(&mut day, avalanche);
    day
}

fn read_avalanche(day: &mut ImportedDay, fields: [&str; AVALANCHE.len()]) {
    let [activity, count, kind, trigger, size] = fields;
    let activity = word(day, AVALANCHE[0], activity, activity_from_name, "observed, presumed, none or unknown");
    let count = quantity::<AvalancheCount>(day, AVALANCHE[1], count);
    let kind = word(day, AVALANCHE[2], kind, AvalancheType::from_name, "dry, wet, mixed or unknown");
    let triggers = "natural, triggered, natural_and_triggered, cornice or unknown";
    let trigger = word(day, AVALANCHE[3], trigger, AvalancheTrigger::from_name, triggers);
    let size = quantity::<AvalancheSize>(day, AVALANCHE[4], size);
    match activity {
        Some(activity) => day.set_avalanche(AvalancheRecord { activity, count, r#type: kind, trigger, size }),
        None if count.is_some() || kind.is_some() || trigger.is_some() || size.is_some() => {
            day.flag_contradiction(Contradiction::DescribedWithoutActivity, String::new());
        }
        None => {}
    }
}

fn is_missing(field: &str) -> bool {
    field.is_empty() || field.eq_ignore_ascii_case("na") || field.eq_ignore_ascii_case("null")
}

fn read_number(variable: Variable, field: &str) -> Option<f64> {
    if variable.is_boolean() && field.eq_ignore_ascii_case("true") {
        return Some(1.0);
    }
    if variable.is_boolean() && field.eq_ignore_ascii_case("false") {
        return Some(0.0);
    }
    field.parse().ok().filter(|value: &f64| value.is_finite())
}

fn word<T>(
    day: &mut ImportedDay,
    name: &str,
    field: &str,
    read: impl Fn(&str) -> Option<T>,
    accepted: &str,
) -> Option<T> {
    let value = read(&field.to_ascii_lowercase());
    if value.is_none() && !field.is_empty() {
        unreadable(day, name, field, accepted);
    }
    value
}

fn quantity<T: TryFrom<f64, Error = OutOfRange>>(day: &mut ImportedDay, name: &str, field: &str) -> Option<T> {
    if field.is_empty() {
        return None;
    }
    let Some(value) = field.parse::<f64>().ok().filter(|value| value.is_finite()) else {
        unreadable(day, name, field, "a number");
        return None;
    };
    match T::try_from(value) {
        Ok(value) => Some(value),
        Err(error) => {
            let detail = format!("must be {}; kept as missing", error.bounds);
            day.flags.push(Flag { field: name.into(), code: FlagCode::OutOfRange, value: shortened(field), detail });
            None
        }
    }
}

fn unreadable(day: &mut ImportedDay, name: &str, field: &str, accepted: &str) {
    let detail = format!("must be {accepted}, or blank where it is missing; kept as missing");
    day.flags.push(Flag { field: name.into(), code: FlagCode::Unreadable, value: shortened(field), detail });
}

/// What was given, cut to what fits into a report.
fn shortened(given: &str) -> String {
    given.chars().take(40).collect()
}

/// Columns without a single value in the accepted rows.
fn not_reported(header: &[&'static str], rows: &[ImportedRow]) -> Vec<String> {
    let days = || rows.iter().filter_map(|row| row.outcome.as_ref().ok());
    let empty = |name: &str| match Variable::from_name(name) {
        Some(variable) => days().all(|day| day.values[variable.index()].is_none()),
        None => match name {
            "avalanche_activity" => days().all(|day| day.avalanche.is_none()),
            _ => false,
        },
    };
    if days().next().is_none() {
        return Vec::new();
    }
    header.iter().filter(|name| empty(name)).map(|name| (*name).to_owned()).collect()
}

/// Writes days as CSV with every one of the [`columns`], missing values blank, numbers in as many digits as they need.
#[must_use]
pub fn write(rows: impl IntoIterator<Item = DatedObservation>) -> String {
    let mut csv = columns().collect::<Vec<_>>().join(",");
    csv.push('\n');
    for (date, day) in rows.into_iter().map(DatedObservation::split) {
        csv.push_str(&date.to_string());
        for (variable, value) in Variable::ALL.into_iter().zip(day.values()) {
            let field = match value {
                Some(value) if variable.is_boolean() => (value == 1.0).to_string(),
                Some(value) => value.to_string(),
                None => String::new(),
            };
            csv.push(',');
            csv.push_str(&field);
        }
        let avalanche = [
            day.avalanche_activity.map(|activity| activity_name(activity).to_owned()),
            day.avalanche_count.map(|count| count.get().to_string()),
            day.avalanche_type.map(|kind| kind.name().to_owned()),
            day.avalanche_trigger.map(|trigger| trigger.name().to_owned()),
            day.avalanche_size.map(|size| size.get().to_string()),
        ];
        for field in avalanche {
            csv.push(',');
            csv.push_str(&field.unwrap_or_default());
        }
        csv.push('\n');
    }
    csv
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::domain::observation::Observation;
    use crate::science::forecast::day::Activity;

    fn rows(text: &str) -> Vec<ImportedRow> {
        read(text.as_bytes()).unwrap().rows
    }

    fn only(text: &str) -> ImportedDay {
        rows(text).remove(0).outcome.unwrap()
    }

    fn errors(text: &str) -> Vec<(u64, Option<u64>, RowErrorCode)> {
        let errors = rows(text).into_iter().filter_map(|row| row.outcome.err());
        errors.map(|error| (error.line, error.column, error.code)).collect()
    }

    #[test]
    fn columns_stand_in_any_order_and_blanks_are_missing() {
        let day = only(
            "wind_speed,date, snow_drift ,cloud_cover,rain_at_900m,snow_height,air_temperature\n\
                        4.5,2007-03-01,TRUE,NA,0,null,\n",
        );
        let expected = |variable: Variable| day.values[variable.index()];
        assert_eq!(expected(Variable::WindSpeed), Some(4.5));
        assert_eq!(expected(Variable::SnowDrift), Some(1.0));
        assert_eq!(expected(Variable::RainAt900m), Some(0.0));
        assert_eq!(day.values.iter().flatten().count(), 3);
        assert_eq!((day.avalanche, day.flags), (None, vec![]));
    }

    #[test]
    fn impossible_and_unreadable_fields_are_flagged_and_missing() {
        let day = only(
            "date,insolation_index,cloud_cover,snow_drift,avalanche_activity,avalanche_size\n\
                        2006-04-16,24,cloudy,2,maybe,2.25\n",
        );
        assert_eq!(day.values, [None; 14]);
        assert_eq!(day.avalanche, None);
        let found: Vec<_> =
            day.flags.iter().map(|flag| (flag.field.as_str(), flag.code, flag.value.as_str())).collect();
        assert_eq!(
            found,
            [
                ("insolation_index", FlagCode::OutOfRange, "24"),
                ("cloud_cover", FlagCode::Unreadable, "cloudy"),
                ("snow_drift", FlagCode::OutOfRange, "2"),
                ("avalanche_activity", FlagCode::Unreadable, "maybe"),
                ("avalanche_size", FlagCode::OutOfRange, "2.25"),
            ]
        );
        assert_eq!(day.flags[0].detail, "must be between 2 and 20; kept as missing");
    }

    #[test]
    fn contradictions_about_avalanches_are_dropped_with_a_flag() {
        let header = "date,avalanche_activity,avalanche_count,avalanche_type\n";
        let day = only(&format!("{header}2007-03-01,none,2,dry\n"));
        assert_eq!(day.avalanche, Some(AvalancheRecord::of(Activity::None)));
        let fields: Vec<_> =
            day.flags.iter().map(|flag| (flag.field.as_str(), flag.code, flag.value.as_str())).collect();
        let code = FlagCode::Contradiction;
        assert_eq!(fields, [("avalanche_count", code, "2"), ("avalanche_type", code, "dry")]);
        let day = only(&format!("{header}2007-03-01,,2,dry\n"));
        assert_eq!((day.avalanche, day.flags[0].field.as_str()), (None, "avalanche_activity"));
        let day = only(&format!("{header}2007-03-01,Observed,2,dry\n"));
        assert_eq!(day.avalanche.unwrap().count.unwrap().get(), 2);
    }

    #[test]
    fn rows_are_refused_with_line_and_column() {
        use RowErrorCode::{DuplicateDay, RaggedRow, UnreadableDate};
        let text = "date,cloud_cover\n\n01/03/2007,5\r\n2007-03-01,5\n2007-03-01,6\n2007-03-02\n2007-03-03,5,7\n\n,\n";
        let expected = [
            (3, Some(1), UnreadableDate),
            (5, Some(1), DuplicateDay),
            (6, Some(11), RaggedRow),
            (7, Some(14), RaggedRow),
        ];
        assert_eq!(errors(text), expected);
        assert_eq!(rows(text).len(), 5);
        assert_eq!(errors("cloud_cover,date\n\"5\",2007-3-1\n"), [(2, Some(5), UnreadableDate)]);
        assert_eq!(errors("date,cloud_cover\r2007-03-01,5\r\r2007-13-01,5"), [(4, Some(1), UnreadableDate)]);
    }

    #[test]
    fn a_line_break_in_a_quoted_field_keeps_the_count_of_lines() {
        let found = rows("date,cloud_cover\n2007-03-01,\"5\n\"\n2007-03-02,6\n");
        assert_eq!(found.iter().map(|row| row.line).collect::<Vec<_>>(), [2, 4]);
    }

    #[test]
    fn headers_are_checked_and_say_what_is_accepted() {
        let error = read(b"date,cloud\n").unwrap_err();
        assert_eq!(error.place(), Some((1, Some(6))));
        assert!(error.to_string().contains("unknown column `cloud`; accepted are date, air_temperature,"), "{error}");
        assert!(error.to_string().contains("avalanche_size"), "{error}");
        assert!(matches!(read(b"\ndate,date\n"), Err(FormatError::DuplicateColumn { line: 2, column: 6, .. })));
        assert!(matches!(read(b"cloud_cover\n"), Err(FormatError::MissingColumn { column: "date", .. })));
        assert!(matches!(read(b"date,\n"), Err(FormatError::UnknownColumn { column: 6, .. })));
        assert_eq!(read(b""), Err(FormatError::Empty));
        assert_eq!(read(b"date\n").unwrap().rows, []);
    }

    #[test]
    fn broken_quotes_are_malformed_csv_with_line_and_column() {
        let place = |text: &str| match read(text.as_bytes()) {
            Err(FormatError::Malformed { line, column, .. }) => Some((line, column)),
            _ => None,
        };
        assert_eq!(place("date,cloud_cover\n2007-03-01,\"5\n2007-03-02,6\n"), Some((2, 12)));
        assert_eq!(place("date,cloud_cover\n2007-03-01,\"5\"6\n"), Some((2, 15)));
        assert_eq!(place("date,cloud_cover\n2007-03-01,5\"\n"), Some((2, 13)));
        assert_eq!(place("date,cloud_cover\n\"2007-03-01\",\"5\"\n"), None);
    }

    #[test]
    fn files_of_too_many_rows_are_refused() {
        let text = format!("date\n{}", "x\n".repeat(MAX_ROWS));
        assert_eq!(rows(&text).len(), MAX_ROWS);
        let line = MAX_ROWS as u64 + 2;
        assert_eq!(read(format!("{text}x\n").as_bytes()), Err(FormatError::TooManyRows { line }));
    }

    #[test]
    fn zeros_stay_and_empty_columns_are_named() {
        let found =
            read(b"date,snow_height,cloud_cover,avalanche_activity\n2007-03-01,0,,\n2007-03-02,0,NA,\n").unwrap();
        assert_eq!(found.not_reported, ["cloud_cover", "avalanche_activity"]);
        let day = found.rows[1].outcome.as_ref().unwrap();
        assert_eq!(day.values[Variable::SnowHeight.index()], Some(0.0));
    }

    #[test]
    fn what_is_written_is_plain() {
        let mut day = Observation::from_values(&[None; 14], Some(&AvalancheRecord::of(Activity::None))).unwrap();
        day.snow_drift = Some(true);
        day.wind_speed = Some(10.28192_f64.try_into().unwrap());
        let csv = write([day.on(jiff::civil::date(2007, 3, 1))]);
        let lines: Vec<_> = csv.lines().collect();
        assert_eq!(lines[0], columns().collect::<Vec<_>>().join(","));
        assert_eq!(lines[1], "2007-03-01,,10.28192,,,,,,,,true,,,,,none,,,,");
    }
}
