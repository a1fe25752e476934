//! A JSON body of one day or an array of days, of which no more are kept than an import may have.

use std::fmt;

use serde::{
    Deserialize, Deserializer,
    de::{IgnoredAny, MapAccess, SeqAccess, Visitor, value::MapAccessDeserializer},
};
use serde_json::Value;

use super::MAX_ROWS;

/// What a JSON body holds; what each day says is for the reader of the JSON type.
#[derive(Clone, Debug, PartialEq)]
pub enum JsonDays {
    /// One object.
    One(Value),
    /// An array.
    Many(Vec<Value>),
    /// An array of more than [`MAX_ROWS`].
    TooMany,
}

/// Reads `bytes`.
///
/// # Errors
/// Where they are not JSON, or neither an object nor an array.
pub fn days(bytes: &[u8]) -> Result<JsonDays, serde_json::Error> {
    serde_json::from_slice(bytes)
}

impl<'de> Deserialize<'de> for JsonDays {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(Days)
    }
}

struct Days;

impl<'de> Visitor<'de> for Days {
    type Value = JsonDays;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a day or an array of days")
    }

    fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<JsonDays, A::Error> {
        Value::deserialize(MapAccessDeserializer::new(map)).map(JsonDays::One)
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut days: A) -> Result<JsonDays, A::Error> {
        let mut kept = Vec::new();
        while let Some(day) = days.next_element()? {
            if kept.len() == MAX_ROWS {
                // the rest is read, so that bad JSON is still called bad, but not kept
                while days.next_element::<IgnoredAny>()?.is_some() {}
                return Ok(JsonDays::TooMany);
            }
            kept.push(day);
        }
        Ok(JsonDays::Many(kept))
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn one_day_many_days_and_too_many_are_told_apart() {
        assert_eq!(days(b"{\"a\": [1]}").unwrap(), JsonDays::One(json!({"a": [1]})));
        assert_eq!(days(b"[{}, 7]").unwrap(), JsonDays::Many(vec![json!({}), json!(7)]));
        let full = format!("[{}0]", "0,".repeat(MAX_ROWS - 1));
        assert!(matches!(days(full.as_bytes()).unwrap(), JsonDays::Many(kept) if kept.len() == MAX_ROWS));
        let over = format!("[{}0]", "0,".repeat(MAX_ROWS));
        assert_eq!(days(over.as_bytes()).unwrap(), JsonDays::TooMany);
        assert!(days(b"7").is_err());
        assert!(days(format!("[{}", "0,".repeat(MAX_ROWS + 5)).as_bytes()).is_err());
    }
}
