//! A place where somebody observes weather and snow every day.

use firn_science::forecast::day::Variable;
use jiff::{Timestamp, tz::TimeZone};
use serde::{Deserialize, Deserializer, Serialize, de::Error};
use utoipa::{
    PartialSchema, ToSchema,
    openapi::{
        RefOr,
        schema::{ArrayBuilder, ObjectBuilder, Schema, Type},
    },
};

use super::{
    ids::StationId,
    retrain::Retrain,
    units::{Altitude, Latitude, Longitude},
};

/// What the owner of a station says of it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct StationBody {
    /// Name for humans, 1 to 200 characters.
    pub name: StationName,
    /// Latitude, degrees north (WGS 84).
    #[serde(default)]
    pub latitude: Option<Latitude>,
    /// Longitude, degrees east (WGS 84).
    #[serde(default)]
    pub longitude: Option<Longitude>,
    /// Altitude above sea level, m.
    #[serde(default)]
    pub altitude_m: Option<Altitude>,
    /// IANA time zone that makes the station's local days, such as `Europe/London`.
    #[serde(default)]
    pub timezone: Option<ZoneName>,
    /// Id of its region among the European avalanche warning services (EAWS), for bulletins; null: the name of the station stands
    /// there.
    #[serde(default)]
    pub eaws_region: Option<EawsRegion>,
    /// The variables that the station reports; null: whatever its observations contain.
    #[serde(default, deserialize_with = "distinct")]
    #[schema(schema_with = variables_schema)]
    pub variables: Option<Vec<Variable>>,
    /// When its models are retrained by themselves, as a proposal; null: on request only.
    #[serde(default)]
    pub retrain: Option<Retrain>,
}

/// A station as the store keeps it.
#[derive(Clone, Debug, PartialEq)]
pub struct Station {
    /// Its name in every address.
    pub id: StationId,
    /// What its owner says of it.
    pub body: StationBody,
    /// True for a station whose data were made by a generator and not observed.
    pub synthetic: bool,
    /// Counts the changes, from 1.
    pub revision: u32,
    /// When it was made.
    pub created: Timestamp,
    /// When it last changed.
    pub updated: Timestamp,
}

impl Station {
    /// The zone of the station's local days; UTC where the owner named none.
    #[must_use]
    pub fn zone(&self) -> TimeZone {
        self.body.timezone.as_ref().map_or(TimeZone::UTC, ZoneName::zone)
    }
}

macro_rules! text {
    ($(#[$doc:meta])* $name:ident, $min:literal..=$max:literal, $pattern:literal, $check:expr, $rule:literal, $example:literal) => {
        $(#[$doc])*
        #[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
        #[serde(try_from = "String", into = "String")]
        pub struct $name(String);

        impl TryFrom<String> for $name {
            type Error = &'static str;

            fn try_from(text: String) -> Result<Self, Self::Error> {
                let length = text.chars().count();
                let check: fn(&str) -> bool = $check;
                if ($min..=$max).contains(&length) && check(&text) { Ok(Self(text)) } else { Err($rule) }
            }
        }

        impl From<$name> for String {
            fn from(text: $name) -> Self {
                text.0
            }
        }

        impl $name {
            /// The text itself.
            #[must_use]
            pub fn as_str(&self) -> &str {
                &self.0
            }
        }

        impl PartialSchema for $name {
            fn schema() -> RefOr<Schema> {
                ObjectBuilder::new()
                    .schema_type(Type::String)
                    .min_length(Some($min))
                    .max_length(Some($max))
                    .pattern(Some($pattern))
                    .description(Some($rule))
                    .examples([serde_json::json!($example)])
                    .into()
            }
        }

        impl ToSchema for $name {}
    };
}

text! {
    /// A name for humans.
    StationName, 1..=200, r"^[^\x00-\x1f\x7f-\x9f]*$", |text| !text.contains(char::is_control),
    "must be 1 to 200 characters without control characters", "Lochaber"
}

text! {
    /// The name of a time zone that the bundled IANA database has.
    ZoneName, 1..=64, "^[A-Za-z0-9_+/-]*$", |text| TimeZone::get(text).is_ok(),
    "must be a name of the IANA time zone database, such as Europe/London", "Europe/London"
}

text! {
    /// The id of a region of the European avalanche warning services.
    EawsRegion, 4..=32, "^[A-Z]{2}(-[A-Za-z0-9]+)+$", is_region,
    "must be the id of an EAWS region: a country and further parts of letters and digits, such as AT-07-08", "AT-07-08"
}

fn is_region(text: &str) -> bool {
    let mut parts = text.split('-');
    let country = parts.next().unwrap_or_default();
    let rest: Vec<&str> = parts.collect();
    let is_part = |part: &&str| !part.is_empty() && part.bytes().all(|letter| letter.is_ascii_alphanumeric());
    country.len() == 2
        && country.bytes().all(|letter| letter.is_ascii_uppercase())
        && !rest.is_empty()
        && rest.iter().all(is_part)
}

impl ZoneName {
    /// The zone of that name.
    #[must_use]
    pub fn zone(&self) -> TimeZone {
        // a ZoneName is made only from a name that the bundled database has
        TimeZone::get(&self.0).unwrap_or(TimeZone::UTC)
    }
}

/// Variables that are each named once, as the contract says.
fn distinct<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<Vec<Variable>>, D::Error> {
    let variables: Option<Vec<Variable>> = Option::deserialize(deserializer)?;
    for (at, variable) in variables.iter().flatten().enumerate() {
        if variables.iter().flatten().take(at).any(|earlier| earlier == variable) {
            return Err(D::Error::custom(format!("{} is named twice", variable.name())));
        }
    }
    Ok(variables)
}

fn variables_schema() -> Schema {
    let names = Variable::ALL.map(Variable::name);
    let item = ObjectBuilder::new().schema_type(Type::String).enum_values(Some(names));
    let list = ArrayBuilder::new()
        .items(item)
        .unique_items(true)
        .description(Some("The variables that the station reports; null: whatever its observations contain."));
    let list = list.build();
    let mut list = list;
    list.schema_type = utoipa::openapi::schema::SchemaType::Array(vec![Type::Array, Type::Null]);
    Schema::Array(list)
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn body(member: &str, value: &serde_json::Value) -> Result<StationBody, serde_json::Error> {
        let mut body = json!({"name": "x"});
        body[member] = value.clone();
        serde_json::from_value(body)
    }

    #[test]
    fn a_variable_is_named_once() {
        assert!(body("variables", &json!(["snow_drift", "wind_speed"])).is_ok());
        let error = body("variables", &json!(["snow_drift", "wind_speed", "snow_drift"])).unwrap_err().to_string();
        assert!(error.contains("snow_drift is named twice"), "{error}");
    }

    #[test]
    fn what_a_region_may_be_is_what_the_contract_says() {
        let schema = serde_json::to_value(EawsRegion::schema()).unwrap();
        let validator = jsonschema::validator_for(&schema).unwrap();
        for region in
            ["AT-07-08", "GB-SCT", "IT-32-TN-13", "AT", "at-07", "AT-", "AT--7", "AT-0 7", "A-07", "AT-Ö", "", "AT-7\n"]
        {
            let value = json!(region);
            assert_eq!(body("eaws_region", &value).is_ok(), validator.is_valid(&value), "{region:?}");
        }
    }

    #[test]
    fn what_a_name_may_hold_is_what_the_contract_says() {
        let schema = serde_json::to_value(StationName::schema()).unwrap();
        let validator = jsonschema::validator_for(&schema).unwrap();
        for name in ["Lochaber", "Öræfi", "", "a\nb", "\u{7f}", "\u{85}", "\u{a0}", &"x".repeat(200), &"x".repeat(201)]
        {
            let value = json!(name);
            assert_eq!(body("name", &value).is_ok(), validator.is_valid(&value), "{name:?}");
        }
    }
}
