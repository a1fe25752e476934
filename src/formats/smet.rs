//! SMET, the text format of MeteoIO for weather stations (specification version 1.1 and 1.2, "SMET ASCII"): one row a day.
//!
//! A header of `key = value` lines names the `fields`, how each is brought to SI (`raw * units_multiplier + units_offset`) and
//! the number that stands for missing (`nodata`); then come rows of numbers between white space. What [`write()`] writes, [`read`]
//! reads back as the same values.
//!
//! | field | in SI | here |
//! |---|---|---|
//! | `TA`, `TSS` | K | air temperature, snow temperature, degC |
//! | `VW`, `DW` | m/s, deg | wind speed and direction |
//! | `HS`, `HN` | m | snow height, new snow of 24 h, cm |
//! | `PSUM` | mm (kg/m2) | precipitation of 24 h |
//! | our names in capitals | our units | what has no field of its own: indices, cloud cover, foot penetration, yes and no as 1 and 0 |
//!
//! `ISWR` is a radiation in W/m2 and no insolation index of 2 to 20: it is not read. Avalanches have no field in SMET: an import
//! leaves those that are known.

use std::collections::HashMap;
use std::fmt::Write as _;

use jiff::civil::{Date, DateTime};

use super::text::decode;
use super::{Flag, FlagCode, FormatError, Import, ImportedDay, ImportedRow, MAX_ROWS, RowError, RowErrorCode};
use crate::domain::station::Station;
use crate::science::forecast::day::{VARIABLES, Variable};

/// The number that stands for missing where a file does not say, and in what is written.
const NODATA: f64 = -999.0;

/// A field of SMET and how its SI value becomes ours: `(si - zero) / unit`.
struct Field {
    name: &'static str,
    variable: Variable,
    /// Our 0 in SI.
    zero: f64,
    /// Our unit in SI.
    unit: f64,
}

const FIELDS: [Field; 7] = [
    Field { name: "TA", variable: Variable::AirTemperature, zero: 273.15, unit: 1.0 },
    Field { name: "VW", variable: Variable::WindSpeed, zero: 0.0, unit: 1.0 },
    Field { name: "DW", variable: Variable::WindDirection, zero: 0.0, unit: 1.0 },
    Field { name: "HS", variable: Variable::SnowHeight, zero: 0.0, unit: 0.01 },
    Field { name: "HN", variable: Variable::NewSnow24h, zero: 0.0, unit: 0.01 },
    Field { name: "PSUM", variable: Variable::Precipitation24h, zero: 0.0, unit: 1.0 },
    Field { name: "TSS", variable: Variable::SnowTemperature, zero: 273.15, unit: 1.0 },
];

/// The field of a variable: its name, our 0 and our unit in SI.
fn field_of(variable: Variable) -> (String, f64, f64) {
    let known = FIELDS.iter().find(|field| field.variable == variable);
    known.map_or_else(
        || (variable.name().to_ascii_uppercase(), 0.0, 1.0),
        |field| (field.name.to_owned(), field.zero, field.unit),
    )
}

/// What one column of the data is.
enum Column {
    Timestamp,
    Value { variable: Variable, offset: f64, multiplier: f64 },
    Ignored,
}

/// The header of a file.
struct Header {
    columns: Vec<Column>,
    nodata: f64,
    ignored: Vec<String>,
}

/// Reads days. The day of a row is the calendar day of its timestamp as it is written, in the zone of the file.
///
/// A value outside of its range or that is no number becomes missing with a flag. A row is refused where its timestamp cannot
/// be read, where an earlier row has the same day, or where it has not as many numbers as there are fields.
///
/// # Errors
/// [`FormatError`] for a file that is empty, not text or not SMET in ASCII, whose header has no `timestamp` or a field twice, or
/// that has more than [`MAX_ROWS`] rows.
pub fn read(bytes: &[u8]) -> Result<Import, FormatError> {
    let text = decode(bytes)?;
    let mut lines = (1..).zip(text.lines());
    let header = read_header(&mut lines)?;
    let mut seen = HashMap::new();
    let mut import = Import {
        ignored_columns: header.ignored.clone(),
        notes: vec!["the day of a row is the calendar day of its timestamp as it is written".to_owned()],
        ..Import::default()
    };
    for (line, text) in lines {
        let text = uncommented(text);
        if text.is_empty() {
            continue;
        }
        if import.rows.len() == MAX_ROWS {
            return Err(FormatError::TooManyRows { line });
        }
        let (date, outcome) = read_row(&header, line, text, &mut seen);
        import.rows.push(ImportedRow { line, date, outcome });
    }
    let days = || import.rows.iter().filter_map(|row| row.outcome.as_ref().ok());
    for column in &header.columns {
        if let Column::Value { variable, .. } = column
            && days().all(|day| day.values[variable.index()].is_none())
        {
            import.not_reported.push(variable.name().to_owned());
        }
    }
    Ok(import)
}

fn uncommented(line: &str) -> &str {
    line.split(['#', ';']).next().unwrap_or_default().trim()
}

fn read_header<'t>(lines: &mut impl Iterator<Item = (u64, &'t str)>) -> Result<Header, FormatError> {
    let fault = |line: u64, detail: String| FormatError::Header { line, detail };
    let (line, first) = lines.find(|(_, text)| !text.trim().is_empty()).ok_or(FormatError::Empty)?;
    let words: Vec<&str> = first.split_whitespace().collect();
    if !matches!(words.as_slice(), ["SMET", _, "ASCII"]) {
        return Err(fault(line, "the first line must be `SMET 1.1 ASCII`, or another version in ASCII".to_owned()));
    }
    let mut keys: HashMap<String, (u64, String)> = HashMap::new();
    let mut last = line;
    for (line, text) in lines.by_ref() {
        last = line;
        let text = uncommented(text);
        if text.eq_ignore_ascii_case("[DATA]") {
            return columns_of(&keys, line);
        }
        if text.is_empty() || text.eq_ignore_ascii_case("[HEADER]") {
            continue;
        }
        let Some((key, value)) = text.split_once('=') else {
            return Err(fault(line, "a line of the header must be `key = value`".to_owned()));
        };
        if keys.insert(key.trim().to_ascii_lowercase(), (line, value.trim().to_owned())).is_some() {
            return Err(fault(line, format!("`{}` occurs twice in the header", key.trim())));
        }
    }
    Err(fault(last, "the line `[DATA]` after the header is missing".to_owned()))
}

fn columns_of(keys: &HashMap<String, (u64, String)>, end: u64) -> Result<Header, FormatError> {
    let fault = |line: u64, detail: String| FormatError::Header { line, detail };
    let (at, fields) = keys.get("fields").ok_or_else(|| fault(end, "the header has no `fields`".to_owned()))?;
    let names: Vec<&str> = fields.split_whitespace().collect();
    let offsets = numbers(keys, "units_offset", names.len(), 0.0)?;
    let multipliers = numbers(keys, "units_multiplier", names.len(), 1.0)?;
    let nodata = match keys.get("nodata") {
        Some((line, text)) => {
            text.parse::<f64>().map_err(|_| fault(*line, format!("nodata must be a number, not {text:?}")))?
        }
        None => NODATA,
    };
    let mut ignored = Vec::new();
    let mut columns: Vec<Column> = Vec::with_capacity(names.len());
    for (position, name) in names.iter().enumerate() {
        if names[..position].iter().any(|earlier| earlier.eq_ignore_ascii_case(name)) {
            return Err(fault(*at, format!("the field `{name}` occurs twice")));
        }
        let variable = Variable::ALL.into_iter().find(|&variable| field_of(variable).0.eq_ignore_ascii_case(name));
        columns.push(match variable {
            _ if name.eq_ignore_ascii_case("timestamp") => Column::Timestamp,
            Some(variable) => Column::Value { variable, offset: offsets[position], multiplier: multipliers[position] },
            None => {
                ignored.push((*name).to_owned());
                Column::Ignored
            }
        });
    }
    if !columns.iter().any(|column| matches!(column, Column::Timestamp)) {
        return Err(fault(*at, "the fields must have a `timestamp`".to_owned()));
    }
    Ok(Header { columns, nodata, ignored })
}

/// One number a field; `default` where the header does not say.
fn numbers(
    keys: &HashMap<String, (u64, String)>,
    key: &str,
    fields: usize,
    default: f64,
) -> Result<Vec<f64>, FormatError> {
    let Some((line, text)) = keys.get(key) else { return Ok(vec![default; fields]) };
    let read: Option<Vec<f64>> =
        text.split_whitespace().map(|word| word.parse().ok().filter(|number: &f64| number.is_finite())).collect();
    read.filter(|numbers| numbers.len() == fields).ok_or_else(|| FormatError::Header {
        line: *line,
        detail: format!("{key} must have one number for each of the {fields} fields"),
    })
}

fn read_row(
    header: &Header,
    line: u64,
    text: &str,
    seen: &mut HashMap<Date, u64>,
) -> (Option<Date>, Result<ImportedDay, RowError>) {
    let words: Vec<&str> = text.split_whitespace().collect();
    let refuse = |field: Option<&str>, code, detail| RowError {
        line,
        column: None,
        field: field.map(str::to_owned),
        code,
        detail,
    };
    if words.len() != header.columns.len() {
        let detail = format!("{} numbers where there are {} fields", words.len(), header.columns.len());
        return (None, Err(refuse(None, RowErrorCode::RaggedRow, detail)));
    }
    let mut day = ImportedDay::default();
    let mut date = None;
    for (column, word) in header.columns.iter().zip(words) {
        match column {
            Column::Timestamp => date = read_date(word),
            Column::Ignored => {}
            Column::Value { variable, offset, multiplier } => match word.parse::<f64>() {
                Ok(raw) if raw == header.nodata || raw.is_nan() => {}
                Ok(raw) => {
                    let value = in_our_unit(*variable, raw, *offset, *multiplier);
                    day.set_checked(*variable, value, word.chars().take(40).collect());
                }
                Err(_) => {
                    let detail = "must be a number; kept as missing".to_owned();
                    let value = word.chars().take(40).collect();
                    day.flags.push(Flag { field: variable.name().into(), code: FlagCode::Unreadable, value, detail });
                }
            },
        }
    }
    let Some(date) = date else {
        let detail = "the timestamp must be written in ISO 8601, like 2007-03-01T09:00".to_owned();
        return (None, Err(refuse(Some("date"), RowErrorCode::UnreadableDate, detail)));
    };
    if let Some(earlier) = seen.get(&date) {
        let detail = format!("line {earlier} already reports {date}: one row a day is read");
        return (Some(date), Err(refuse(Some("date"), RowErrorCode::DuplicateDay, detail)));
    }
    seen.insert(date, line);
    (Some(date), Ok(day))
}

/// The value in our unit of a raw number, which is `raw * multiplier + offset` in SI.
fn in_our_unit(variable: Variable, raw: f64, offset: f64, multiplier: f64) -> f64 {
    let (_, zero, unit) = field_of(variable);
    if (offset, multiplier) == (zero, unit) {
        return raw;
    }
    let value = (raw * multiplier + offset - zero) / unit;
    // 271.15 K are -2 degC and not -1.999999999999943
    let short = (value * 1e6).round() / 1e6;
    if (value - short).abs() < 1e-9 { short } else { value }
}

/// The calendar day of a timestamp, whatever zone it is written in.
fn read_date(text: &str) -> Option<Date> {
    let day = text.get(..10)?;
    let rest = text.get(10..)?;
    let is_time = rest.is_empty() || (rest.starts_with('T') && text.trim_end_matches('Z').parse::<DateTime>().is_ok());
    is_time.then(|| day.parse().ok()).flatten()
}

/// Writes days as SMET 1.1 with every variable that one of them has; `days` in the order of their dates, each with the values in
/// the order of [`Variable::ALL`].
#[must_use]
pub fn write(station: &Station, days: &[(Date, [Option<f64>; VARIABLES])]) -> String {
    let variables: Vec<Variable> = Variable::ALL
        .into_iter()
        .filter(|variable| days.iter().any(|(_, values)| values[variable.index()].is_some()))
        .collect();
    let mut text = String::from("SMET 1.1 ASCII\n[HEADER]\n");
    // writing to a String cannot fail
    let _ = writeln!(text, "station_id = {}", station.id);
    // a comment sign in a name would cut it off
    let _ = writeln!(text, "station_name = {}", station.body.name.as_str().replace(['#', ';'], " "));
    let place = [
        ("latitude", station.body.latitude.map(f64::from)),
        ("longitude", station.body.longitude.map(f64::from)),
        ("altitude", station.body.altitude_m.map(f64::from)),
    ];
    for (key, value) in place {
        let _ = writeln!(text, "{key} = {}", value.unwrap_or(NODATA));
    }
    let _ = writeln!(text, "nodata = {NODATA}");
    if station.synthetic {
        text.push_str("comment = made by a generator, never observed\n");
    }
    let mut row = |key: &str, first: &str, of: &dyn Fn(Variable) -> String| {
        let words: Vec<String> = std::iter::once(first.to_owned()).chain(variables.iter().map(|&v| of(v))).collect();
        let _ = writeln!(text, "{key} = {}", words.join(" "));
    };
    row("units_offset", "0", &|variable| field_of(variable).1.to_string());
    row("units_multiplier", "1", &|variable| field_of(variable).2.to_string());
    row("fields", "timestamp", &|variable| field_of(variable).0);
    text.push_str("[DATA]\n");
    for (date, values) in days {
        let _ = write!(text, "{date}T12:00");
        for variable in &variables {
            // our own unit: the header says how it becomes SI, and nothing is rounded on the way
            let _ = write!(text, " {}", values[variable.index()].unwrap_or(NODATA));
        }
        text.push('\n');
    }
    text
}

#[cfg(test)]
#[path = "smet_tests.rs"]
mod tests;
