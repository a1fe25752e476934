//! `POST /v1/stations/{station}/observations`: one day or many, as JSON, NDJSON, CSV or a service's export.

use std::collections::HashMap;

use axum::{
    Json,
    extract::State,
    http::HeaderMap,
    response::{IntoResponse, Response},
};
use jiff::civil;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use utoipa::{IntoParams, ToSchema};

use super::{
    AppState,
    auth::Caller,
    extract::{Body, Date, MediaType, Path, Query, json_fault, media_type},
    observations::contradictions,
    problem::ApiResult,
    stations::StationPath,
};
use crate::{
    clock,
    domain::{
        observation::DatedObservation,
        problem::{Code, FieldError, Problem},
        schema,
        station::{Station, ZoneName},
    },
    formats::{
        Flag, FormatError, Import, ImportedRow, MAX_ROWS,
        json::{self, JsonDays},
        mapped_csv::{self, CheckedMapping, Mapping},
        ndjson, observations_csv, sais, smet,
    },
    store::{
        observations::{Author, DayWrite},
        stations::Written,
    },
};

/// How the body is to be read.
#[derive(Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub struct ImportQuery {
    /// `sais`: the body is an export of the Scottish Avalanche Information Service (`Content-Type: text/csv`).
    #[serde(default)]
    #[param(inline)]
    format: Option<Format>,
    /// Store the good rows although others are refused; without it an import stores all rows or none.
    #[serde(default)]
    #[param(value_type = Option<bool>, default = false)]
    partial: Option<bool>,
    /// For `Content-Type: text/csv`: what the columns of the file are, as JSON. `date` names the column of the day and
    /// `date_format` how it is written (`YYYY-MM-DD`, `DD/MM/YYYY`, `MM/DD/YYYY`, `DD.MM.YYYY` or `YYYYMMDD`); `columns` has for each
    /// other column the `variable` and its `unit` in the file; `missing` lists texts that stand for missing.
    #[serde(default)]
    #[param(value_type = Option<String>, max_length = 4000,
        example = r#"{"date": "Day", "columns": {"TA": {"variable": "air_temperature", "unit": "K"}}}"#)]
    mapping: Option<String>,
    /// For `format=sais`: the area to read from a file that has several.
    #[serde(default)]
    #[param(value_type = Option<String>, example = "Lochaber", max_length = 100)]
    area: Option<Area>,
}

/// The area of an export that has several, at most 100 characters.
#[derive(Deserialize)]
#[serde(try_from = "String")]
struct Area(String);

impl TryFrom<String> for Area {
    type Error = &'static str;

    fn try_from(name: String) -> Result<Self, Self::Error> {
        if name.chars().count() <= 100 { Ok(Self(name)) } else { Err("must be at most 100 characters") }
    }
}

/// The export of a service.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum Format {
    /// The export of the Scottish Avalanche Information Service.
    Sais,
}

/// What became of an import, with a line a row.
#[derive(Debug, Serialize, ToSchema)]
pub struct ImportReport {
    /// How the body was read: json, ndjson, csv, smet or sais.
    format: &'static str,
    /// Rows that were read.
    rows: usize,
    /// Rows that were stored.
    accepted: usize,
    /// Rows that were not.
    refused: usize,
    /// Days that are new.
    created: usize,
    /// Days that changed.
    updated: usize,
    /// Days that said what was known already.
    unchanged: usize,
    /// Accepted rows of which at least one field was flagged.
    flagged: usize,
    /// Columns that hold nothing: missing on every row, or an optional column that is 0 on every row.
    not_reported: Vec<String>,
    /// Columns that are not read.
    ignored_columns: Vec<String>,
    /// What was assumed to read the file.
    notes: Vec<String>,
    /// A line a row, in the order of the body.
    report: Vec<RowReport>,
}

/// What became of a row.
#[derive(Debug, Serialize, ToSchema)]
pub struct RowReport {
    /// Where it begins: the line of the file, from 1; of a JSON array the position of the day, from 1.
    line: u64,
    /// The day; null where it could not be read.
    date: Option<Date>,
    /// `accepted` or `refused`.
    status: RowStatus,
    /// What an accepted row did.
    outcome: Option<RowOutcome>,
    /// What was noticed in an accepted row.
    flags: Vec<Flag>,
    /// Why a row was refused.
    errors: Vec<FieldError>,
}

/// Whether a row was stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum RowStatus {
    /// It is good. It was stored unless the whole import was refused.
    Accepted,
    /// It is not.
    Refused,
}

/// What a stored row did.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum RowOutcome {
    /// The day is new.
    Created,
    /// The day changed.
    Updated,
    /// The day was known already.
    Unchanged,
    /// The row was joined with another row of the same day, which has the outcome.
    Merged,
}

/// One row, whatever it came as.
struct Row {
    line: u64,
    date: Option<civil::Date>,
    outcome: Result<(DayWrite, Vec<Flag>), Vec<FieldError>>,
}

/// All rows of a body.
#[derive(Default)]
struct Rows {
    format: &'static str,
    // a single JSON day, which is refused like that of a PUT
    one: bool,
    rows: Vec<Row>,
    merged: Vec<(u64, civil::Date)>,
    not_reported: Vec<String>,
    ignored_columns: Vec<String>,
    notes: Vec<String>,
}

/// Records one day or many; a day that is known is replaced (by a file only in the columns that the file has values of), and
/// sending the same again changes nothing. All rows are
/// stored or none, unless `partial=true`.
///
/// JSON (one day or an array of days) and NDJSON are refused where a value is impossible. A file (CSV, SMET or the export of a
/// service) is read as it is: an impossible field becomes missing and is flagged, and only an unreadable date or
/// structure refuses a row.
#[utoipa::path(post, path = "/v1/stations/{station}/observations", operation_id = "import_observations", tag = "observations",
    params(StationPath, ImportQuery),
    request_body(content(
        (DayOrDays = "application/json", example = json!([{"date": "2007-02-14", "air_temperature": -3.5, "avalanche_activity": "none"}])),
        (String = "application/x-ndjson", example = "{\"date\": \"2007-02-14\", \"air_temperature\": -3.5}\n"),
        (String = "text/csv", example = "date,air_temperature,avalanche_activity\n2007-02-14,-3.5,none\n"),
        (String = "text/x-smet", example = "SMET 1.1 ASCII\n[HEADER]\nstation_id = a\nfields = timestamp TA HS\n[DATA]\n2007-02-14T09:00 269.65 1.2\n"))),
    responses((status = 200, description = "What became of every row.", body = ImportReport)))]
pub async fn import_observations(
    State(state): State<AppState>,
    Path(path): Path<StationPath>,
    Query(query): Query<ImportQuery>,
    caller: Caller,
    headers: HeaderMap,
    Body(bytes): Body,
) -> ApiResult<Response> {
    let media = media_type(&headers, &[MediaType::Json, MediaType::Ndjson, MediaType::Csv, MediaType::Smet])?;
    if query.format.is_some() && media != MediaType::Csv {
        return Err(Problem::new(Code::UnsupportedMediaType, "format=sais needs Content-Type: text/csv").into());
    }
    let mapping = query.mapping.as_deref().map(read_mapping).transpose()?;
    if mapping.is_some() && (query.format.is_some() || media != MediaType::Csv) {
        let detail = "must be left out unless the body is CSV without a format";
        return Err(Problem::field(Code::InvalidMapping, "/mapping", "contradiction", detail).into());
    }
    let station = state.station(&path.station).await?;
    let zone = station.body.timezone.clone();
    let today = clock::today(&station.zone());
    // megabytes are read on a thread of their own: the server goes on answering meanwhile
    let read = tokio::task::spawn_blocking(move || match (media, query.format) {
        (MediaType::Json, _) => from_json(&bytes, today),
        (MediaType::Ndjson, _) => from_ndjson(&bytes, today),
        (MediaType::Smet, _) => from_file("smet", smet::read(&bytes), today),
        (MediaType::Csv, None) => match mapping {
            Some(mapping) => from_file("csv", mapped_csv::read(&bytes, &mapping), today),
            None => from_file("csv", observations_csv::read(&bytes), today),
        },
        (MediaType::Csv, Some(Format::Sais)) => {
            from_sais(&bytes, zone.as_ref(), query.area.as_ref().map(|area| area.0.as_str()), today)
        }
    });
    let rows = read.await.map_err(Problem::internal)??;
    store(&state, &station, rows, query.partial.unwrap_or(false), caller).await
}

/// Characters of a mapping: as part of an address it must stay below what servers and proxies take.
const LONGEST_MAPPING: usize = 4000;

fn read_mapping(text: &str) -> Result<CheckedMapping, Problem> {
    let fault =
        |pointer: String, code: &str, detail: String| Problem::field(Code::InvalidMapping, pointer, code, detail);
    if text.chars().count() > LONGEST_MAPPING {
        let detail = format!("must be at most {LONGEST_MAPPING} characters");
        return Err(fault("/mapping".to_owned(), "too_long", detail));
    }
    let mut reader = serde_json::Deserializer::from_str(text);
    let mapping: Mapping = serde_path_to_error::deserialize(&mut reader).map_err(|error| {
        let path = error.path().to_string().replace('.', "/");
        let pointer = if path == "/" || path.is_empty() { "/mapping".to_owned() } else { format!("/mapping/{path}") };
        fault(pointer, "invalid_mapping", error.inner().to_string())
    })?;
    mapping.check().map_err(|faults| {
        let detail = faults.first().map_or_else(String::new, |first| format!("{}: {}", first.pointer, first.detail));
        Problem::new(Code::InvalidMapping, detail).with_errors(faults)
    })
}

/// One day or an array of days.
#[derive(ToSchema)]
#[schema(as = DayOrDays)]
#[serde(untagged)]
#[expect(dead_code, clippy::large_enum_variant, reason = "stands in the contract; the bodies are read row by row")]
pub enum DayOrDays {
    /// One day.
    One(DatedObservation),
    /// Many days.
    Many(Vec<DatedObservation>),
}

fn from_json(bytes: &[u8], today: civil::Date) -> Result<Rows, Problem> {
    let (one, rows) = match json::days(bytes) {
        Ok(JsonDays::One(day)) => (true, vec![json_row(1, &day, "", today)]),
        Ok(JsonDays::Many(days)) => {
            let rows = (1..).zip(&days).zip(0_usize..);
            (false, rows.map(|((line, day), at)| json_row(line, day, &format!("/{at}"), today)).collect())
        }
        Ok(JsonDays::TooMany) => return Err(too_many_rows()),
        Err(error) if error.is_data() => {
            let fault = FieldError::new("", "wrong_type", "must be a day or an array of days");
            return Err(
                Problem::new(Code::InvalidBody, "the body must be a day or an array of days").with_errors(vec![fault])
            );
        }
        Err(error) => return Err(Problem::new(Code::InvalidJson, format!("not JSON: {error}"))),
    };
    let rows = without_repeats(rows, |row| format!("/{}", row.line.saturating_sub(1)));
    Ok(Rows { format: "json", one, rows, ..Rows::default() })
}

fn json_row(line: u64, value: &Value, prefix: &str, today: civil::Date) -> Row {
    let date = value.get("date").and_then(Value::as_str).and_then(|text| text.parse::<Date>().ok()).map(|date| date.0);
    Row { line, date, outcome: schema::read(value, prefix).and_then(|day| checked(day, prefix, today)) }
}

fn checked(day: DatedObservation, prefix: &str, today: civil::Date) -> Result<(DayWrite, Vec<Flag>), Vec<FieldError>> {
    let (date, day) = day.split();
    let mut faults = contradictions(&day.contradictions(), prefix);
    let kind = day.is_forecast(date, today);
    if let Err(fault) = kind {
        faults.push(FieldError::new(format!("{prefix}/forecast"), "contradiction", fault.to_string()));
    }
    match kind {
        Ok(forecast) if faults.is_empty() => {
            Ok((DayWrite { date, values: Some(day.values()), forecast, avalanche: day.avalanche() }, Vec::new()))
        }
        _ => Err(faults),
    }
}

fn too_many_rows() -> Problem {
    Problem::new(Code::PayloadTooLarge, format!("an import takes {MAX_ROWS} rows at most; send several"))
}

fn from_ndjson(bytes: &[u8], today: civil::Date) -> Result<Rows, Problem> {
    if ndjson::lines(bytes).nth(MAX_ROWS).is_some() {
        return Err(too_many_rows());
    }
    let row = |line: ndjson::JsonLine<'_>| {
        let prefix = format!("/{}", line.line);
        let mut reader = serde_json::Deserializer::from_slice(line.json);
        let day: Result<DatedObservation, _> = serde_path_to_error::deserialize(&mut reader);
        match day {
            Ok(day) if reader.end().is_ok() => {
                let (date, _) = day.split();
                Row { line: line.line, date: Some(date), outcome: checked(day, &prefix, today) }
            }
            Ok(_) => {
                let fault = FieldError::new(prefix, "invalid_json", "must be one JSON object a line");
                Row { line: line.line, date: None, outcome: Err(vec![fault]) }
            }
            Err(error) => {
                let problem = json_fault::<DatedObservation>(line.json, &error, &prefix);
                let faults = if problem.errors.is_empty() {
                    vec![FieldError::new(prefix, "invalid_json", problem.detail)]
                } else {
                    problem.errors
                };
                let value: Option<Value> = serde_json::from_slice(line.json).ok();
                let date = value.as_ref().and_then(|value| value.get("date")?.as_str()?.parse::<Date>().ok());
                Row { line: line.line, date: date.map(|date| date.0), outcome: Err(faults) }
            }
        }
    };
    let rows = without_repeats(ndjson::lines(bytes).map(row).collect(), |row| format!("/{}", row.line));
    Ok(Rows { format: "ndjson", rows, ..Rows::default() })
}

/// Refuses a row that repeats the day of an accepted one: which of the two is meant cannot be told. `pointer` is where a
/// row stands in the body: the position in an array counts from 0, the line of a file from 1.
fn without_repeats(mut rows: Vec<Row>, pointer: impl Fn(&Row) -> String) -> Vec<Row> {
    let mut first: HashMap<civil::Date, u64> = HashMap::new();
    for row in &mut rows {
        let Ok((write, _)) = &row.outcome else { continue };
        let line = *first.entry(write.date).or_insert(row.line);
        if line != row.line {
            let detail = format!("{} is also row {line}: send a day once", write.date);
            row.outcome = Err(vec![FieldError::new(format!("{}/date", pointer(row)), "duplicate_day", detail)]);
        }
    }
    rows
}

fn from_sais(bytes: &[u8], zone: Option<&ZoneName>, area: Option<&str>, today: civil::Date) -> Result<Rows, Problem> {
    // the service writes local midnight as UTC, so its own zone is the default and not UTC
    let zone = zone.map_or(sais::DEFAULT_ZONE, ZoneName::as_str);
    from_file("sais", sais::read(bytes, zone, area), today)
}

fn from_file(format: &'static str, import: Result<Import, FormatError>, today: civil::Date) -> Result<Rows, Problem> {
    let mut import = import.map_err(|error| malformed(&error))?;
    let rows: Vec<Row> = import.rows.into_iter().map(|row| file_row(row, today)).collect();
    let to_come = rows.iter().filter(|row| row.outcome.as_ref().is_ok_and(|(day, _)| day.forecast)).count();
    if to_come > 0 {
        import.notes.push(format!("{to_come} day(s) are still to come: their weather is kept as a forecast"));
    }
    Ok(Rows {
        format,
        rows,
        merged: import.merged.iter().map(|row| (row.line, row.date)).collect(),
        not_reported: import.not_reported,
        ignored_columns: import.ignored_columns,
        notes: import.notes,
        one: false,
    })
}

fn file_row(row: ImportedRow, today: civil::Date) -> Row {
    let outcome = match (row.outcome, row.date) {
        (Ok(day), Some(date)) => {
            let (values, forecast) = (Some(day.values), date > today);
            Ok((DayWrite { date, values, forecast, avalanche: day.avalanche }, day.flags))
        }
        (Ok(_), None) => Err(vec![FieldError::new(format!("/{}/date", row.line), "unreadable_date", "has no date")]),
        (Err(error), _) => {
            let field = error.field.as_deref().map_or_else(String::new, |field| format!("/{field}"));
            let place =
                error.column.map_or_else(String::new, |column| format!(" (line {}, column {column})", error.line));
            let code = serde_json::to_value(error.code).ok();
            let code = code.as_ref().and_then(Value::as_str).unwrap_or("refused").to_owned();
            Err(vec![FieldError::new(format!("/{}{field}", row.line), code, format!("{}{place}", error.detail))])
        }
    };
    Row { line: row.line, date: row.date, outcome }
}

fn malformed(error: &FormatError) -> Problem {
    let problem = Problem::new(Code::MalformedFile, error.to_string());
    match error.place() {
        Some((line, column)) => {
            let column = column.map_or(Value::Null, Value::from);
            problem.with("line", Value::from(line)).with("column", column)
        }
        None => problem,
    }
}

async fn store(state: &AppState, station: &Station, rows: Rows, partial: bool, caller: Caller) -> ApiResult<Response> {
    let refused = rows.rows.iter().filter(|row| row.outcome.is_err()).count();
    if refused > 0 && !partial {
        return Err(refuse(rows, refused).into());
    }
    let writes: Vec<DayWrite> = rows.rows.iter().filter_map(|row| Some(row.outcome.as_ref().ok()?.0.clone())).collect();
    let author = Author { name: caller.name, at: clock::now(), source: rows.format };
    // in JSON a day is said whole, one by itself as by PUT; a file has columns, and those that it lacks say nothing
    let written = match (rows.format, writes.as_slice()) {
        ("json", [day]) if rows.one => vec![state.store.put_day(&station.id, day, &author, |_| true).await?.1],
        ("json" | "ndjson", days) => state.store.put_days(&station.id, days, &author).await?,
        (_, days) => state.store.merge_days(&station.id, days, &author).await?,
    };
    Ok(Json(report(rows, &written)).into_response())
}

/// The problem of an import that stores nothing: of one JSON day like that of a PUT, else with the report.
fn refuse(rows: Rows, refused: usize) -> Problem {
    // the report has all of them; the list of the problem shall stay readable
    const MOST_FAULTS: usize = 100;
    let faults = rows.rows.iter().filter_map(|row| row.outcome.as_ref().err()).flatten();
    let omitted = faults.clone().count().saturating_sub(MOST_FAULTS);
    let faults: Vec<FieldError> = faults.take(MOST_FAULTS).cloned().collect();
    let first = faults.first().map_or_else(String::new, |first| format!("{} {}", first.pointer, first.detail));
    if rows.one {
        return Problem::new(Code::InvalidBody, first).with_errors(faults);
    }
    let code = if rows.format == "json" { Code::InvalidBody } else { Code::ImportRefused };
    let detail =
        format!("{refused} of {} rows were refused and nothing was stored; the first: {first}", rows.rows.len());
    let report = serde_json::to_value(report(rows, &[]).report).unwrap_or_default();
    let problem = Problem::new(code, detail).with_errors(faults).with("report", report);
    if omitted > 0 { problem.with("errors_omitted", omitted.into()) } else { problem }
}

fn report(rows: Rows, written: &[Written]) -> ImportReport {
    let count = |which: Written| written.iter().filter(|written| **written == which).count();
    let mut outcomes = written.iter();
    let mut report: Vec<RowReport> = rows.rows.into_iter().map(|row| row_report(row, &mut outcomes)).collect();
    let merged = |&(line, date): &(u64, civil::Date)| RowReport {
        line,
        date: Some(Date(date)),
        status: RowStatus::Accepted,
        outcome: (!written.is_empty()).then_some(RowOutcome::Merged),
        flags: Vec::new(),
        errors: Vec::new(),
    };
    report.extend(rows.merged.iter().map(merged));
    report.sort_by_key(|row| row.line);
    let refused = report.iter().filter(|row| row.status == RowStatus::Refused).count();
    ImportReport {
        format: rows.format,
        rows: report.len(),
        accepted: report.len() - refused,
        refused,
        created: count(Written::Created),
        updated: count(Written::Updated),
        unchanged: count(Written::Unchanged),
        flagged: report.iter().filter(|row| !row.flags.is_empty()).count(),
        not_reported: rows.not_reported,
        ignored_columns: rows.ignored_columns,
        notes: rows.notes,
        report,
    }
}

fn row_report<'a>(row: Row, outcomes: &mut impl Iterator<Item = &'a Written>) -> RowReport {
    let (status, outcome, flags, errors) = match row.outcome {
        Ok((_, flags)) => (RowStatus::Accepted, outcomes.next().copied().map(RowOutcome::from), flags, Vec::new()),
        Err(errors) => (RowStatus::Refused, None, Vec::new(), errors),
    };
    RowReport { line: row.line, date: row.date.map(Date), status, outcome, flags, errors }
}

impl From<Written> for RowOutcome {
    fn from(written: Written) -> Self {
        match written {
            Written::Created => Self::Created,
            Written::Updated => Self::Updated,
            Written::Unchanged => Self::Unchanged,
        }
    }
}
