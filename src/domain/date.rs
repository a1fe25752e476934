//! Calendar days as callers write them.

use std::str::FromStr;

use jiff::civil;
use serde::{Deserialize, Deserializer, Serialize};
use utoipa::{
    PartialSchema, ToSchema,
    openapi::{
        KnownFormat, RefOr, SchemaFormat,
        schema::{ObjectBuilder, Schema, Type},
    },
};

/// A calendar day in the one form that is accepted: `YYYY-MM-DD`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Date(pub civil::Date);

impl FromStr for Date {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let refuse = || format!("must be an existing day written YYYY-MM-DD, not {text:?}");
        let bytes = text.as_bytes();
        let form = bytes.len() == 10
            && bytes.iter().enumerate().all(|(i, b)| if i == 4 || i == 7 { *b == b'-' } else { b.is_ascii_digit() });
        if !form {
            return Err(refuse());
        }
        text.parse().map(Self).map_err(|_| refuse())
    }
}

impl TryFrom<String> for Date {
    type Error = String;

    fn try_from(text: String) -> Result<Self, Self::Error> {
        text.parse()
    }
}

impl From<Date> for String {
    fn from(date: Date) -> Self {
        date.0.to_string()
    }
}

impl PartialSchema for Date {
    fn schema() -> RefOr<Schema> {
        ObjectBuilder::new()
            .schema_type(Type::String)
            .format(Some(SchemaFormat::KnownFormat(KnownFormat::Date)))
            .description(Some("A calendar day, YYYY-MM-DD; for a station its local day."))
            .examples([serde_json::json!("2007-02-14")])
            .into()
    }
}

impl ToSchema for Date {}

/// Reads a civil date in that one form, for `#[serde(deserialize_with)]`.
///
/// # Errors
/// Any other form, and a day that no calendar has.
pub fn strict<'de, D: Deserializer<'de>>(deserializer: D) -> Result<civil::Date, D::Error> {
    Date::deserialize(deserializer).map(|date| date.0)
}

/// The same where the day may be left out or null.
///
/// # Errors
/// As [`strict`].
pub fn strict_option<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<civil::Date>, D::Error> {
    Ok(Option::<Date>::deserialize(deserializer)?.map(|date| date.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_one_form_of_a_date_is_a_date() {
        assert!("2007-02-14".parse::<Date>().is_ok());
        for bad in ["20070214", "2007-2-14", "2007-02-30", "2007-02-14T00:00", "-007-02-14", "", "2007-W07-3"] {
            assert!(bad.parse::<Date>().is_err(), "{bad}");
        }
    }
}
