//! Dates of the export: three spellings, with and without a time.

use jiff::civil::{Date, DateTime, Time};
use jiff::tz::TimeZone;

use super::codes::unwrapped;

const MONTHS: [&str; 12] = [
    "january",
    "february",
    "march",
    "april",
    "may",
    "june",
    "july",
    "august",
    "september",
    "october",
    "november",
    "december",
];

/// What a readable date looks like, for messages.
pub(super) const ACCEPTED: &str = "the date must be written like 15/04/2007 23:00, 2004-01-05 or 05-Jan-2004 09:30";

/// Local time of a profile. A time in the export is UTC (local midnight is written as 23:00 of the day before in
/// summer) and is shown in `zone`; a date without a time is that day as it stands.
pub(super) fn read(field: &str, zone: &TimeZone) -> Option<DateTime> {
    let (day, time) = split(field);
    let date = read_day(day)?;
    match time {
        None => Some(date.to_datetime(Time::midnight())),
        Some(time) => {
            let utc = date.to_datetime(read_time(time)?).to_zoned(TimeZone::UTC).ok()?;
            Some(utc.with_time_zone(zone.clone()).datetime())
        }
    }
}

/// Whether a field has the shape of a date, readable or not: the sign that a line is a new row.
pub(super) fn has_shape(field: &str) -> bool {
    let (day, _) = split(field);
    parts(day).is_some_and(|[first, middle, last]| {
        let digits =
            |part: &str, longest| (1..=longest).contains(&part.len()) && part.bytes().all(|b| b.is_ascii_digit());
        let month = digits(middle, 2) || (middle.len() >= 3 && middle.bytes().all(|b| b.is_ascii_alphabetic()));
        digits(first, 4) && month && digits(last, 4)
    })
}

/// The day and, behind a space or a T, the time.
fn split(field: &str) -> (&str, Option<&str>) {
    let field = unwrapped(field);
    let at = field.find(|c: char| c.is_ascii_whitespace()).or_else(|| {
        // the T of 2004-01-05T00:00 stands behind a digit and before one; that of 05-Oct-2004 does not
        let bytes = field.as_bytes();
        let digit = |at: usize| bytes.get(at).is_some_and(u8::is_ascii_digit);
        (1..bytes.len()).find(|&at| bytes[at] == b'T' && digit(at - 1) && digit(at + 1))
    });
    match at {
        Some(at) => (&field[..at], Some(field[at + 1..].trim())),
        None => (field, None),
    }
}

fn parts(day: &str) -> Option<[&str; 3]> {
    let separator = if day.contains('/') { '/' } else { '-' };
    let mut parts = day.split(separator);
    let found = [parts.next()?, parts.next()?, parts.next()?];
    parts.next().is_none().then_some(found)
}

/// A day written year first, or day first with the month as a number or a name; years have four digits.
fn read_day(day: &str) -> Option<Date> {
    let [first, month, last] = parts(day)?;
    let (year, day) = if first.len() == 4 { (first, last) } else { (last, first) };
    if year.len() != 4 || day.len() > 2 {
        return None;
    }
    let month = match whole::<i8>(month) {
        Some(number) => number,
        None => i8::try_from(named_month(month)? + 1).ok()?,
    };
    Date::new(whole(year)?, month, whole(day)?).ok()
}

fn named_month(name: &str) -> Option<usize> {
    let name = name.to_ascii_lowercase();
    if name.len() < 3 { None } else { MONTHS.iter().position(|month| month.starts_with(&name)) }
}

fn read_time(time: &str) -> Option<Time> {
    let mut parts = time.strip_suffix(['Z', 'z']).unwrap_or(time).split(':');
    let (hour, minute) = (whole(parts.next()?)?, whole(parts.next()?)?);
    let second = parts.next().map_or(Some(0), whole)?;
    if parts.next().is_some() { None } else { Time::new(hour, minute, second, 0).ok() }
}

/// A number of nothing but digits.
fn whole<T: std::str::FromStr>(text: &str) -> Option<T> {
    if text.bytes().all(|byte| byte.is_ascii_digit()) { text.parse().ok() } else { None }
}

#[cfg(test)]
mod tests {
    use super::*;
    use jiff::civil::date;

    fn day(field: &str) -> Option<Date> {
        read(field, &TimeZone::get("Europe/London").unwrap()).map(DateTime::date)
    }

    #[test]
    fn a_time_is_utc_and_2300_in_summer_is_the_next_day() {
        assert_eq!(day("15/04/2007 23:00"), Some(date(2007, 4, 16)));
        assert_eq!(day("21/12/1993 00:00"), Some(date(1993, 12, 21)));
        assert_eq!(day("26/03/2000 00:00"), Some(date(2000, 3, 26)));
        assert_eq!(day("26/03/2000 23:00"), Some(date(2000, 3, 27)));
        let denver = TimeZone::get("America/Denver").unwrap();
        assert_eq!(read("05/01/2004 07:00", &denver).unwrap(), date(2004, 1, 5).at(0, 0, 0, 0));
    }

    #[test]
    fn every_spelling_of_the_archive_is_read_day_first() {
        for field in
            ["2004-01-05", "05/01/2004", "05-Jan-2004 09:30", " 5/1/2004 ", "\"2004-01-05\"", "05-January-2004"]
        {
            assert_eq!(day(field), Some(date(2004, 1, 5)), "{field}");
        }
        for field in ["2004-01-05T09:30:00Z", "2004-01-05 09:30", "05-01-2004", "2004/01/05", "=\"05/01/2004\""] {
            assert_eq!(day(field), Some(date(2004, 1, 5)), "{field}");
        }
        assert_eq!(day("05-OCT-2004 09:30"), Some(date(2004, 10, 5)));
    }

    #[test]
    fn anything_else_is_refused() {
        let unreadable = [
            "",
            "-9999",
            "31/02/2004",
            "05/01/04",
            "13/13/2004",
            "05-Jan",
            "05/01/2004 25:00",
            "05/01/2004 x",
            "2004-01-05-06",
            "monday",
            "05/01/2004 23",
            "32-Jan-2004",
            "5-Ja-2004",
            "+5/01/2004",
        ];
        for field in unreadable {
            assert_eq!(day(field), None, "{field}");
        }
    }

    #[test]
    fn a_wrong_date_still_has_the_shape_of_one() {
        for field in ["31/02/2004", "05/01/04", "2004-01-05 25:00", "05-Jan-2004"] {
            assert!(has_shape(field), "{field}");
        }
        for field in ["wind slab on NE", "", "see 05/01/2004", "1-2", "a/b/c"] {
            assert!(!has_shape(field), "{field}");
        }
    }
}
