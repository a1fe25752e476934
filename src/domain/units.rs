//! Physical quantities that cannot hold an impossible value.
//!
//! One macro writes the range of a quantity, its error text, its serde form and its OpenAPI schema from one line, so
//! that what the documentation promises is what the service accepts. Ranges are what an observer anywhere could have
//! measured; outside them lies a typing error, a sentinel or a broken sensor.

use std::fmt;

use serde::de::{self, Deserializer, Visitor};
use serde::{Deserialize, Serialize, Serializer};
use utoipa::openapi::RefOr;
use utoipa::openapi::schema::{KnownFormat, ObjectBuilder, Schema, SchemaFormat, Type};
use utoipa::{PartialSchema, ToSchema};

use crate::science::forecast::day::Variable;

/// A number that no observer could have measured, or that is not a number.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("{quantity} must be {bounds}, got {}", Shown(*.value))]
pub struct OutOfRange {
    /// What was to be told, for instance `air temperature`.
    pub quantity: &'static str,
    /// What would have been accepted.
    pub bounds: Bounds,
    /// What was given, in [`Bounds::unit`].
    pub value: f64,
}

/// The values that are accepted for a quantity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// Smallest value accepted, in `unit`.
    pub min: f64,
    /// Largest value accepted, in `unit`.
    pub max: f64,
    /// Only multiples of this are accepted, in `unit`; `None` for a continuous quantity.
    pub step: Option<f64>,
    /// Unit of the values: `degC`, `m/s`, `deg`, `%`, `cm`, `mm`, `m`, `bool` (0 or 1) or `1` (a pure number).
    pub unit: &'static str,
}

impl Bounds {
    /// Whether `value`, in the unit of the bounds, is accepted; never for a value that is not finite.
    #[must_use]
    pub fn contain(&self, value: f64) -> bool {
        let stepped = self.step.is_none_or(|step| (value / step).fract() == 0.0);
        (self.min..=self.max).contains(&value) && stepped
    }
}

impl fmt::Display for Bounds {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.step {
            Some(1.0) => write!(f, "a whole number ")?,
            Some(step) => write!(f, "a multiple of {step} ")?,
            None => {}
        }
        write!(f, "between {} and {}", self.min, self.max)?;
        if matches!(self.unit, "1" | "bool") { Ok(()) } else { write!(f, " {}", self.unit) }
    }
}

/// A number as people write it, and huge ones in a few digits.
struct Shown(f64);

impl fmt::Display for Shown {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.0.is_finite() && self.0.abs() >= 1e9 { write!(f, "{:e}", self.0) } else { write!(f, "{}", self.0) }
    }
}

/// Reads any JSON number, so that 4 and 4.0 are both a temperature, and names the quantity where it finds another type.
struct NumberVisitor {
    quantity: &'static str,
    bounds: Bounds,
}

impl Visitor<'_> for NumberVisitor {
    type Value = f64;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "a number: {} {}", self.quantity, self.bounds)
    }

    fn visit_f64<E: de::Error>(self, value: f64) -> Result<f64, E> {
        Ok(value)
    }

    #[expect(clippy::cast_precision_loss, reason = "a number that large is out of every range")]
    fn visit_i64<E: de::Error>(self, value: i64) -> Result<f64, E> {
        Ok(value as f64)
    }

    #[expect(clippy::cast_precision_loss, reason = "a number that large is out of every range")]
    fn visit_u64<E: de::Error>(self, value: u64) -> Result<f64, E> {
        Ok(value as f64)
    }
}

/// The schema of a bounded number, from the same bounds that its reader checks.
fn number_schema(kind: Type, quantity: &str, about: &str, bounds: Bounds) -> RefOr<Schema> {
    let unit = match bounds.unit {
        "1" => String::new(),
        unit => format!(", in {unit}"),
    };
    let format = if kind == Type::Integer { KnownFormat::Int32 } else { KnownFormat::Double };
    let mut initial = quantity.chars();
    let title: String = initial.next().into_iter().flat_map(char::to_uppercase).chain(initial).collect();
    ObjectBuilder::new()
        .schema_type(kind)
        .format(Some(SchemaFormat::KnownFormat(format)))
        .minimum(Some(bounds.min))
        .maximum(Some(bounds.max))
        .multiple_of(bounds.step.filter(|step| *step != 1.0))
        .description(Some(format!("{title}{unit}{about}.")))
        .into()
}

/// Writes quantities: `Name: "quantity", min..=max, "unit"[, step s][, "about"]`, or `integer Name: ...` over `u32`.
macro_rules! bounded {
    () => {};
    (integer $name:ident: $quantity:literal, $min:literal..=$max:literal $(, $about:literal)?; $($rest:tt)*) => {
        bounded!(@type $name, u32, Type::Integer, $quantity, $min, $max, "1", Some(1.0), concat!($(", ", $about)?));

        impl $name {
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss,
                     reason = "the bounds have been checked: a whole number that fits")]
            const fn from_checked(value: f64) -> Self {
                Self(value as u32)
            }
        }

        bounded!($($rest)*);
    };
    (
        $name:ident: $quantity:literal, $min:literal..=$max:literal, $unit:literal
        $(, step $step:literal)? $(, $about:literal)?; $($rest:tt)*
    ) => {
        bounded!(@type $name, f64, Type::Number, $quantity, $min, $max, $unit,
                 bounded!(@step $($step)?), concat!($(", ", $about)?));

        impl $name {
            const fn from_checked(value: f64) -> Self {
                // -0.0 would be shown as "-0.0": adding 0 makes it 0
                Self(value + 0.0)
            }
        }

        bounded!($($rest)*);
    };
    (@step) => { None };
    (@step $step:literal) => { Some($step) };
    (
        @type $name:ident, $repr:ty, $kind:expr, $quantity:literal, $min:literal, $max:literal, $unit:literal,
        $step:expr, $about:expr
    ) => {
        #[doc = concat!("The ", $quantity, $about, ": ", stringify!($min), " to ", stringify!($max), ", unit `", $unit, "`.")]
        #[derive(Clone, Copy, Debug, PartialEq, PartialOrd)]
        pub struct $name($repr);

        impl $name {
            #[doc = concat!("Smallest ", $quantity, " accepted, unit `", $unit, "`.")]
            pub const MIN: f64 = $min;
            #[doc = concat!("Largest ", $quantity, " accepted, unit `", $unit, "`.")]
            pub const MAX: f64 = $max;
            #[doc = concat!("Unit of the ", $quantity, "; `1` is a pure number.")]
            pub const UNIT: &'static str = $unit;
            #[doc = concat!("What is accepted as ", $quantity, ".")]
            pub const BOUNDS: Bounds = Bounds { min: $min, max: $max, step: $step, unit: $unit };
            #[doc = "What the quantity is called in messages."]
            pub const QUANTITY: &'static str = $quantity;

            #[doc = concat!("The ", $quantity, ", unit `", $unit, "`.")]
            #[must_use]
            pub const fn get(self) -> $repr {
                self.0
            }
        }

        impl TryFrom<f64> for $name {
            type Error = OutOfRange;

            fn try_from(value: f64) -> Result<Self, OutOfRange> {
                if Self::BOUNDS.contain(value) {
                    Ok(Self::from_checked(value))
                } else {
                    Err(OutOfRange { quantity: $quantity, bounds: Self::BOUNDS, value })
                }
            }
        }

        impl FromValue for $name {
            fn from_value(value: f64) -> Result<Self, OutOfRange> {
                value.try_into()
            }
        }

        impl From<$name> for f64 {
            fn from(value: $name) -> Self {
                Self::from(value.0)
            }
        }

        impl Serialize for $name {
            fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
                self.0.serialize(serializer)
            }
        }

        impl<'de> Deserialize<'de> for $name {
            fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
                let visitor = NumberVisitor { quantity: $quantity, bounds: Self::BOUNDS };
                deserializer.deserialize_f64(visitor)?.try_into().map_err(de::Error::custom)
            }
        }

        impl PartialSchema for $name {
            fn schema() -> RefOr<Schema> {
                number_schema($kind, $quantity, $about, Self::BOUNDS)
            }
        }

        impl ToSchema for $name {}
    };
}

bounded! {
    AirTemperature: "air temperature", -60.0..=40.0, "degC";
    WindSpeed: "wind speed", 0.0..=100.0, "m/s";
    WindDirection: "wind direction", 0.0..=360.0, "deg", "where the wind comes from, clockwise from north";
    CloudCover: "cloud cover", 0.0..=100.0, "%";
    SnowHeight: "snow height", 0.0..=1500.0, "cm", "the whole snowpack above the ground";
    NewSnow24h: "new snow of 24 h", 0.0..=300.0, "cm";
    NewSnowIndex: "new-snow index", 0.0..=10.0, "1", "0 is no new snow and 10 heavy snow";
    Precipitation24h: "precipitation of 24 h", 0.0..=500.0, "mm", "as water";
    FootPenetration: "foot penetration", 0.0..=200.0, "cm";
    SnowTemperature: "snow temperature", -60.0..=0.0, "degC", "never above the melting point";
    InsolationIndex: "insolation index", 2.0..=20.0, "1";
    CumulativeSnowIndex: "cumulative snow index", 0.0..=5000.0, "1",
        "the running sum of the new-snow index over the season";
    AvalancheSize: "avalanche size", 1.0..=5.0, "1", step 0.5, "on the European scale from 1 (small) to 5 (extreme)";
    integer AvalancheCount: "number of avalanches", 0.0..=1000.0, "seen on the day";
    Latitude: "latitude", -90.0..=90.0, "deg", "north is positive, WGS 84";
    Longitude: "longitude", -180.0..=180.0, "deg", "east is positive, WGS 84";
    Altitude: "altitude", -500.0..=9000.0, "m", "above sea level";
}

/// A field of a day from the number that the engines keep of it.
pub(super) trait FromValue: Sized {
    /// The quantity of that `value`, in its own unit.
    fn from_value(value: f64) -> Result<Self, OutOfRange>;
}

impl FromValue for bool {
    fn from_value(value: f64) -> Result<Self, OutOfRange> {
        if BOOLEAN.contain(value) {
            Ok(value == 1.0)
        } else {
            Err(OutOfRange { quantity: "yes or no", bounds: BOOLEAN, value })
        }
    }
}

const BOOLEAN: Bounds = Bounds { min: 0.0, max: 1.0, step: Some(1.0), unit: "bool" };

/// What is accepted for a daily variable, in [`Variable::unit`]; 0 or 1 for the two that are yes or no.
#[must_use]
pub const fn bounds(variable: Variable) -> Bounds {
    match variable {
        Variable::AirTemperature => AirTemperature::BOUNDS,
        Variable::WindSpeed => WindSpeed::BOUNDS,
        Variable::WindDirection => WindDirection::BOUNDS,
        Variable::CloudCover => CloudCover::BOUNDS,
        Variable::SnowHeight => SnowHeight::BOUNDS,
        Variable::NewSnow24h => NewSnow24h::BOUNDS,
        Variable::NewSnowIndex => NewSnowIndex::BOUNDS,
        Variable::Precipitation24h => Precipitation24h::BOUNDS,
        Variable::RainAt900m | Variable::SnowDrift => BOOLEAN,
        Variable::FootPenetration => FootPenetration::BOUNDS,
        Variable::SnowTemperature => SnowTemperature::BOUNDS,
        Variable::InsolationIndex => InsolationIndex::BOUNDS,
        Variable::CumulativeSnowIndex => CumulativeSnowIndex::BOUNDS,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_impossible_value_is_refused_with_name_unit_range_and_value() {
        let error = AirTemperature::try_from(41.0).unwrap_err();
        assert_eq!(error.to_string(), "air temperature must be between -60 and 40 degC, got 41");
        let error = InsolationIndex::try_from(24.0).unwrap_err();
        assert_eq!(error.to_string(), "insolation index must be between 2 and 20, got 24");
        let error = AvalancheSize::try_from(2.25).unwrap_err();
        assert_eq!(error.to_string(), "avalanche size must be a multiple of 0.5 between 1 and 5, got 2.25");
        let error = AvalancheCount::try_from(1.5).unwrap_err();
        assert_eq!(error.to_string(), "number of avalanches must be a whole number between 0 and 1000, got 1.5");
        assert_eq!(
            SnowHeight::try_from(1e300).unwrap_err().to_string(),
            "snow height must be between 0 and 1500 cm, got 1e300"
        );
    }

    #[test]
    fn the_ends_of_a_range_belong_to_it_and_no_special_number_does() {
        assert_eq!(WindDirection::try_from(360.0).unwrap().get(), 360.0);
        assert_eq!(AvalancheCount::try_from(1000.0).unwrap().get(), 1000);
        assert_eq!(AvalancheSize::try_from(2.5).unwrap().get(), 2.5);
        for special in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            assert!(SnowTemperature::try_from(special).is_err(), "{special}");
            assert!(AvalancheCount::try_from(special).is_err(), "{special}");
        }
    }

    #[test]
    fn minus_zero_is_shown_as_zero() {
        let zero = SnowTemperature::try_from(-0.0).unwrap();
        assert_eq!(serde_json::to_string(&zero).unwrap(), "0.0");
    }

    #[test]
    fn json_numbers_with_and_without_a_point_are_read_and_checked() {
        assert_eq!(serde_json::from_str::<AirTemperature>("-3").unwrap().get(), -3.0);
        assert_eq!(serde_json::from_str::<AvalancheCount>("3.0").unwrap().get(), 3);
        assert_eq!(serde_json::to_string(&AvalancheCount::try_from(3.0).unwrap()).unwrap(), "3");
        let text = serde_json::from_str::<WindSpeed>("-1").unwrap_err().to_string();
        assert!(text.starts_with("wind speed must be between 0 and 100 m/s, got -1"), "{text}");
        let text = serde_json::from_str::<WindSpeed>("\"5\"").unwrap_err().to_string();
        assert!(text.contains("expected a number: wind speed between 0 and 100 m/s"), "{text}");
        assert!(serde_json::from_str::<WindSpeed>("1e999").is_err());
    }

    #[test]
    fn the_schema_promises_what_the_reader_checks() {
        let schema = serde_json::to_value(AirTemperature::schema()).unwrap();
        assert_eq!(
            schema,
            serde_json::json!({"type": "number", "format": "double", "minimum": -60, "maximum": 40,
                               "description": "Air temperature, in degC."})
        );
        let schema = serde_json::to_value(AvalancheSize::schema()).unwrap();
        assert_eq!(schema["multipleOf"], 0.5);
        let schema = serde_json::to_value(AvalancheCount::schema()).unwrap();
        assert_eq!(schema["type"], "integer");
    }

    #[test]
    fn bounds_carry_the_units_of_the_science() {
        for variable in Variable::ALL {
            assert_eq!(bounds(variable).unit, variable.unit(), "{}", variable.name());
        }
        assert!(!bounds(Variable::SnowDrift).contain(0.5));
    }
}
