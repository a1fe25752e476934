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

macro_rules! name {
    ($(#[$doc:meta])* $name:ident, $error:ident, $words:literal, $example:literal) => {
        $(#[$doc])*
        #[derive(Clone, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
        #[serde(try_from = "String", into = "String")]
        pub struct $name(String);

        #[doc = concat!("A string that is no [`", stringify!($name), "`].")]
        #[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
        #[error("must be 1 to 64 letters, digits, _ or -, beginning with a letter or digit")]
        pub struct $error;

        impl $name {
            /// The regular expression that the contract publishes.
            pub const PATTERN: &'static str = "^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$";

            /// The name as text.
            #[must_use]
            pub fn as_str(&self) -> &str {
                &self.0
            }
        }

        impl TryFrom<String> for $name {
            type Error = $error;

            fn try_from(name: String) -> Result<Self, Self::Error> {
                let good = |b: u8| b.is_ascii_alphanumeric() || b == b'_' || b == b'-';
                let begins = name.as_bytes().first().is_some_and(u8::is_ascii_alphanumeric);
                if begins && name.len() <= 64 && name.bytes().all(good) { Ok(Self(name)) } else { Err($error) }
            }
        }

        impl FromStr for $name {
            type Err = $error;

            fn from_str(name: &str) -> Result<Self, Self::Err> {
                Self::try_from(name.to_owned())
            }
        }

        impl From<$name> for String {
            fn from(id: $name) -> Self {
                id.0
            }
        }

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str(&self.0)
            }
        }

        impl PartialSchema for $name {
            fn schema() -> RefOr<Schema> {
                ObjectBuilder::new()
                    .schema_type(Type::String)
                    .pattern(Some(Self::PATTERN))
                    .description(Some($words))
                    .examples([serde_json::json!($example)])
                    .into()
            }
        }

        impl ToSchema for $name {}
    };
}

name! {
    /// The name of a station in every address: 1 to 64 letters, digits, `_` or `-`, beginning with a letter or digit.
    StationId, StationIdError, "Name of a station: 1 to 64 letters, digits, _ or -.", "lochaber"
}

name! {
    /// The name of a region in every address: as that of a station.
    RegionId, RegionIdError, "Name of a region: 1 to 64 letters, digits, _ or -.", "highlands"
}

/// What a model is for: one station, or a region of several.
#[derive(Clone, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Place {
    /// A station.
    Station(StationId),
    /// A region.
    Region(RegionId),
}

impl Place {
    /// The station, where it is one.
    #[must_use]
    pub const fn station(&self) -> Option<&StationId> {
        match self {
            Self::Station(id) => Some(id),
            Self::Region(_) => None,
        }
    }

    /// The region, where it is one.
    #[must_use]
    pub const fn region(&self) -> Option<&RegionId> {
        match self {
            Self::Station(_) => None,
            Self::Region(id) => Some(id),
        }
    }

    /// Its address.
    #[must_use]
    pub fn path(&self) -> String {
        match self {
            Self::Station(id) => format!("/v1/stations/{id}"),
            Self::Region(id) => format!("/v1/regions/{id}"),
        }
    }
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Station(id) => write!(f, "station {id}"),
            Self::Region(id) => write!(f, "region {id}"),
        }
    }
}

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
