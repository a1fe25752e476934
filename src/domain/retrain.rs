//! When a place is retrained.

use std::{fmt, str::FromStr};

use jiff::civil::Date;
use serde::{Deserialize, Serialize};
use utoipa::{
    PartialSchema, ToSchema,
    openapi::{
        RefOr,
        schema::{ObjectBuilder, Schema, Type},
    },
};

/// When the models of a station or region are retrained by themselves. That makes a proposal, and changes nothing else.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Retrain {
    /// The day of the year, MM-DD in the time zone of the station, on which each active model that is older is retrained.
    pub yearly: DayOfYear,
}

/// A day that every year has: MM-DD, and not 02-29.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct DayOfYear {
    month: i8,
    day: i8,
}

/// What a [`DayOfYear`] is.
const RULE: &str = "must be MM-DD, a day that every year has, such as 07-01";

/// A year without a 29 February: what it has, every year has.
const COMMON_YEAR: i16 = 2001;

impl DayOfYear {
    /// The last such day that is not after `today`.
    #[must_use]
    pub fn last_until(self, today: Date) -> Option<Date> {
        let this_year = Date::new(today.year(), self.month, self.day).ok()?;
        if this_year <= today { Some(this_year) } else { Date::new(today.year() - 1, self.month, self.day).ok() }
    }
}

impl TryFrom<String> for DayOfYear {
    type Error = &'static str;

    fn try_from(text: String) -> Result<Self, Self::Error> {
        text.parse()
    }
}

impl FromStr for DayOfYear {
    type Err = &'static str;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let two = |part: &str| -> Option<i8> {
            (part.len() == 2 && part.bytes().all(|b| b.is_ascii_digit())).then(|| part.parse().ok()).flatten()
        };
        let read = text.split_once('-').and_then(|(month, day)| Some((two(month)?, two(day)?)));
        let (month, day) = read.ok_or(RULE)?;
        Date::new(COMMON_YEAR, month, day).map_err(|_| RULE)?;
        Ok(Self { month, day })
    }
}

impl From<DayOfYear> for String {
    fn from(day: DayOfYear) -> Self {
        day.to_string()
    }
}

impl fmt::Display for DayOfYear {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:02}-{:02}", self.month, self.day)
    }
}

impl PartialSchema for DayOfYear {
    fn schema() -> RefOr<Schema> {
        ObjectBuilder::new()
            .schema_type(Type::String)
            .pattern(Some("^((0[13578]|1[02])-(0[1-9]|[12][0-9]|3[01])|(0[469]|11)-(0[1-9]|[12][0-9]|30)|02-(0[1-9]|1[0-9]|2[0-8]))$"))
            .description(Some("A day that every year has, MM-DD."))
            .examples([serde_json::json!("07-01")])
            .into()
    }
}

impl ToSchema for DayOfYear {}

#[cfg(test)]
mod tests {
    use jiff::civil::date;

    use super::*;

    #[test]
    fn the_last_such_day_is_this_years_or_last_years() {
        let july: DayOfYear = "07-01".parse().unwrap();
        assert_eq!(july.last_until(date(2026, 7, 1)), Some(date(2026, 7, 1)));
        assert_eq!(july.last_until(date(2026, 6, 30)), Some(date(2025, 7, 1)));
        assert_eq!(july.last_until(date(2026, 12, 31)), Some(date(2026, 7, 1)));
        assert_eq!(july.to_string(), "07-01");
    }

    #[test]
    fn only_days_that_every_year_has_are_taken() {
        for bad in ["02-29", "02-30", "13-01", "00-01", "04-31", "7-1", "07-1", "+7-01", "07-01-02", "0701", ""] {
            assert!(bad.parse::<DayOfYear>().is_err(), "{bad}");
        }
        for good in ["02-28", "12-31", "01-01", "04-30"] {
            assert!(good.parse::<DayOfYear>().is_ok(), "{good}");
        }
    }
}
