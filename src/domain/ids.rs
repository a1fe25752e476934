//! Names of things: stations are named by their owner, everything else by us.

use std::{fmt, str::FromStr};

use serde::{Deserialize, Serialize};
use utoipa::{
    PartialSchema, ToSchema,
    openapi::{
        RefOr,
        schema::{ObjectBuilder, Schema, Type},
    },
};
use uuid::Uuid;

/// The name of a station in every address: 1 to 64 letters, digits, `_` or `-`, beginning with a letter or digit.
#[derive(Clone, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct StationId(String);

/// A string that is no [`StationId`].
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("must be 1 to 64 letters, digits, _ or -, beginning with a letter or digit")]
pub struct StationIdError;

impl StationId {
    /// The regular expression that the contract publishes.
    pub const PATTERN: &'static str = "^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$";

    /// The name as text.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl TryFrom<String> for StationId {
    type Error = StationIdError;

    fn try_from(name: String) -> Result<Self, Self::Error> {
        let good = |b: u8| b.is_ascii_alphanumeric() || b == b'_' || b == b'-';
        let begins = name.as_bytes().first().is_some_and(u8::is_ascii_alphanumeric);
        if begins && name.len() <= 64 && name.bytes().all(good) { Ok(Self(name)) } else { Err(StationIdError) }
    }
}

impl FromStr for StationId {
    type Err = StationIdError;

    fn from_str(name: &str) -> Result<Self, Self::Err> {
        Self::try_from(name.to_owned())
    }
}

impl From<StationId> for String {
    fn from(id: StationId) -> Self {
        id.0
    }
}

impl fmt::Display for StationId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl PartialSchema for StationId {
    fn schema() -> RefOr<Schema> {
        ObjectBuilder::new()
            .schema_type(Type::String)
            .pattern(Some(Self::PATTERN))
            .description(Some("Name of a station: 1 to 64 letters, digits, _ or -."))
            .examples([serde_json::json!("lochaber")])
            .into()
    }
}

impl ToSchema for StationId {}

/// A new time-ordered identifier (UUID version 7) for a job, a model or a request.
#[must_use]
pub fn new_id() -> Uuid {
    Uuid::now_v7()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn station_names_are_what_the_pattern_says() {
        for good in ["lochaber", "Lochaber", "7", "a_b-c", &"x".repeat(64)] {
            assert!(good.parse::<StationId>().is_ok(), "{good}");
        }
        for bad in ["", "_a", "-a", "a b", "a/b", "..", "é", &"x".repeat(65)] {
            assert!(bad.parse::<StationId>().is_err(), "{bad}");
        }
    }
}
