//! The only place that reads the time of day, so that everything else can be run again with the same answer.

use jiff::{Timestamp, Zoned, civil::Date, tz::TimeZone};

/// The present instant, to the millisecond that every record keeps.
#[must_use]
pub fn now() -> Timestamp {
    let now = Timestamp::now();
    Timestamp::from_millisecond(now.as_millisecond()).unwrap_or(now)
}

/// Today's civil date in `zone`.
#[must_use]
pub fn today(zone: &TimeZone) -> Date {
    Zoned::new(now(), zone.clone()).date()
}
