//! The public export of the Scottish avalanche service: one row a snow profile, one or more profiles a day.
//!
//! | column | becomes |
//! |---|---|
//! | Date | local day: a time is UTC and is shown in the zone, a date without a time stands as it is |
//! | Area | rows of one area are read; a blank is the area of the rest |
//! | Air Temp, Snow Temp | degC by the table of areas and winters in `regimes` |
//! | Wind Speed, Wind Dir | summit wind until the winter of 2006/07, mph to m/s; afterwards they hold the wind at the pit site, so that the Summit Wind columns are read in their place wherever these were filled in |
//! | Cloud, Drift, Foot Pen, Rain at 900, Insolation, No Settle | as they are |
//! | Total Snow Depth | snow height, unless it is 0 on every row |
//! | Snow Index | new-snow index; from the winter of 2007/08 the number of Precip Code, and a Snow Index of 0 is a filler |
//! | Avalanche Code | activity, count, type and trigger, see `codes::avalanche` |
//! | all others | not read; observers' initials, places and comments are never kept or repeated |
//!
//! Blank and -9999 are missing, -1 too where a quantity cannot be negative. A 0 of the ordinary columns is a value even
//! in a file of one row: rain, drift, cloud and new snow are often 0, and nothing would be gained by guessing. Only the
//! optional columns (Total Snow Depth, Alt, the Summit columns and the like), which the export fills with 0, count as
//! not reported where they are 0 or missing on every row.

mod codes;
mod columns;
mod dates;
mod days;
mod merge;
mod regimes;
mod rows;

use jiff::civil::DateTime;
use jiff::tz::TimeZone;

use self::columns::{Column, Columns};
use self::days::Reader;
use self::rows::{Row, Rows};
use super::text::{decode, place};
use super::{FormatError, Import, ImportedDay, ImportedRow, MAX_ROWS, RowError, RowErrorCode};

/// The zone of the service that writes the export.
pub const DEFAULT_ZONE: &str = "Europe/London";

/// Reads an export. `zone` is the IANA name of the zone of local days, [`DEFAULT_ZONE`] for the service's own; `area`
/// names the rows to read. Without it, rows of the first area in the file are read. Rows of other areas are refused.
///
/// Two rows of one day give one: the values of the later profile (of the later row at the same time), the stronger
/// activity, and a flag.
///
/// # Errors
/// [`FormatError`] for a file that is empty or not text, for a header without a Date or with a column twice, for
/// more than [`MAX_ROWS`] rows, and for an unknown zone.
pub fn read(bytes: &[u8], zone: &str, area: Option<&str>) -> Result<Import, FormatError> {
    let zone = TimeZone::get(zone).map_err(|_| FormatError::UnknownZone { zone: zone.chars().take(40).collect() })?;
    let text = decode(bytes)?;
    let mut rows = Rows::of(&text);
    let header = rows.header().ok_or(FormatError::Empty)?;
    let columns = Columns::read(header.text, &header.fields, header.line)?;
    let mut profiles = Vec::new();
    while let Some(row) = rows.next(&columns) {
        if profiles.len() == MAX_ROWS {
            return Err(FormatError::TooManyRows { line: row.line });
        }
        profiles.push(Profile::read(row, &columns, &zone));
    }
    let named = area.map(str::trim).filter(|area| !area.is_empty());
    let first = || profiles.iter().filter(|profile| profile.defect.is_none()).find_map(|profile| profile.area);
    let area = named.or_else(first).map(str::to_owned);
    let profiles = profiles.into_iter().map(|profile| profile.of_area(area.as_deref(), &columns)).collect();
    Ok(assemble(&columns, profiles, area.as_deref()))
}

/// Reads the days of the profiles that stand and brings all rows together.
fn assemble(columns: &Columns, profiles: Vec<Profile<'_>>, area: Option<&str>) -> Import {
    let standing = || profiles.iter().filter(|profile| profile.defect.is_none());
    let mut reader = Reader::new(columns, area, standing());
    let not_reported = reader.not_reported(standing());
    let mut read = Vec::with_capacity(profiles.len());
    for profile in profiles {
        let date = profile.local.map(DateTime::date);
        let outcome = match (profile.defect, date) {
            (None, Some(date)) => Ok(reader.day(&profile.row, date)),
            (defect, _) => Err(defect.unwrap_or_else(|| unreadable_date(&profile.row, columns))),
        };
        read.push((profile.local, ImportedRow { line: profile.row.line, date, outcome }));
    }
    let notes = reader.notes();
    let (rows, merged) = merge::by_day(read);
    let ignored_columns = columns.ignored().map(str::to_owned).collect();
    Import { rows, merged, not_reported, ignored_columns, notes }
}

/// A row with its date and area, or what refuses it.
struct Profile<'a> {
    row: Row<'a>,
    local: Option<DateTime>,
    area: Option<&'a str>,
    defect: Option<RowError>,
}

impl<'a> Profile<'a> {
    fn read(row: Row<'a>, columns: &Columns, zone: &TimeZone) -> Self {
        let local = dates::read(columns.text(&row.fields, Column::Date), zone);
        let area = Some(codes::unwrapped(columns.text(&row.fields, Column::Area))).filter(|area| !area.is_empty());
        let defect = match local {
            None => Some(unreadable_date(&row, columns)),
            Some(_) => ragged(&row, columns),
        };
        Self { row, local, area, defect }
    }

    /// The same profile, refused where it belongs to another area than `accepted`.
    fn of_area(mut self, accepted: Option<&str>, columns: &Columns) -> Self {
        let (Some(area), Some(accepted)) = (self.area, accepted) else { return self };
        if self.defect.is_none() && !area.eq_ignore_ascii_case(accepted) {
            let at = columns.field(&self.row.fields, Column::Area).map_or(0, |field| field.at);
            let detail = format!("the row belongs to another area: rows of {accepted} are accepted in this import");
            self.defect = Some(refusal(&self.row, at, Some("area"), RowErrorCode::OtherArea, detail));
        }
        self
    }
}

fn unreadable_date(row: &Row<'_>, columns: &Columns) -> RowError {
    let at = columns.field(&row.fields, Column::Date).map_or(row.text.len(), |field| field.at);
    refusal(row, at, Some("date"), RowErrorCode::UnreadableDate, dates::ACCEPTED.to_owned())
}

fn ragged(row: &Row<'_>, columns: &Columns) -> Option<RowError> {
    let count = row.fields.len();
    let (at, detail) = if count < columns.fewest {
        (row.text.len(), format!("the row ends after {count} fields: the header asks for {}", columns.fewest))
    } else {
        let surplus = columns.surplus(&row.fields)?;
        (surplus.at, "the row has more fields than the header".to_owned())
    };
    Some(refusal(row, at, None, RowErrorCode::RaggedRow, detail))
}

fn refusal(row: &Row<'_>, at: usize, field: Option<&str>, code: RowErrorCode, detail: String) -> RowError {
    let (line, column) = place(row.text, at, row.line);
    RowError { line, column: Some(column), field: field.map(str::to_owned), code, detail }
}

#[cfg(test)]
mod tests;
