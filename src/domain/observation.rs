//! What a station reports of one day, as the API speaks it.
//!
//! `null` (or leaving a field out) says that a value is missing; it is never read as 0. An activity of `unknown` says
//! that nobody could tell; it is never read as `none`.

use jiff::civil::Date;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::avalanche::{ActivitySchema, AvalancheRecord, AvalancheTrigger, AvalancheType, Contradiction};
use super::units::{
    AirTemperature, AvalancheCount, AvalancheSize, CloudCover, CumulativeSnowIndex, FootPenetration, FromValue,
    InsolationIndex, NewSnow24h, NewSnowIndex, OutOfRange, Precipitation24h, SnowHeight, SnowTemperature,
    WindDirection, WindSpeed,
};
use crate::science::forecast::day::{Activity, DayRecord, VARIABLES, Variable};

pub use super::units::{Bounds, bounds};

/// Writes the JSON form of a day with and without its date from one list of fields; flattening one struct into the
/// other would lose both the refusal of unknown fields and the path of a bad one.
macro_rules! observation {
    ($($(#[$doc:meta])* $field:ident: $type:ty = $variable:ident,)+) => {
        observation!(@struct
            /// What a station reports of one day; a value that is null or left out is missing, never 0.
            Observation {} $($(#[$doc])* $field: $type = $variable,)+);
        observation!(@struct
            /// What a station reports of one day, with its date; a value that is null or left out is missing, never 0.
            DatedObservation {
                /// The station's local calendar day.
                #[serde(deserialize_with = "super::date::strict")]
                #[schema(value_type = String, format = Date)]
                pub date: Date,
            } $($(#[$doc])* $field: $type = $variable,)+);

        impl Observation {
            /// The values in the order of [`Variable::ALL`], in the units of [`Variable::unit`].
            #[must_use]
            pub fn values(&self) -> [Option<f64>; VARIABLES] {
                let mut values = [None; VARIABLES];
                $(values[Variable::$variable.index()] = self.$field.map(f64::from);)+
                values
            }

            /// The day with these `values`, in the order of [`Variable::ALL`] and the units of [`Variable::unit`].
            ///
            /// # Errors
            /// [`OutOfRange`] for the first value outside of [`bounds`].
            pub fn from_values(
                values: &[Option<f64>; VARIABLES],
                avalanche: Option<&AvalancheRecord>,
            ) -> Result<Self, OutOfRange> {
                Ok(Self {
                    $($field: values[Variable::$variable.index()].map(FromValue::from_value).transpose()?,)+
                    avalanche_activity: avalanche.map(|record| record.activity),
                    avalanche_count: avalanche.and_then(|record| record.count),
                    avalanche_type: avalanche.and_then(|record| record.r#type),
                    avalanche_trigger: avalanche.and_then(|record| record.trigger),
                    avalanche_size: avalanche.and_then(|record| record.size),
                    forecast: None,
                })
            }

            /// The same day with its date.
            #[must_use]
            pub const fn on(self, date: Date) -> DatedObservation {
                DatedObservation {
                    date,
                    $($field: self.$field,)+
                    avalanche_activity: self.avalanche_activity,
                    avalanche_count: self.avalanche_count,
                    avalanche_type: self.avalanche_type,
                    avalanche_trigger: self.avalanche_trigger,
                    avalanche_size: self.avalanche_size,
                    forecast: self.forecast,
                }
            }
        }

        impl DatedObservation {
            /// The date and the day without it.
            #[must_use]
            pub const fn split(self) -> (Date, Observation) {
                let day = Observation {
                    $($field: self.$field,)+
                    avalanche_activity: self.avalanche_activity,
                    avalanche_count: self.avalanche_count,
                    avalanche_type: self.avalanche_type,
                    avalanche_trigger: self.avalanche_trigger,
                    avalanche_size: self.avalanche_size,
                    forecast: self.forecast,
                };
                (self.date, day)
            }
        }
    };
    (
        @struct $(#[$about:meta])* $name:ident { $($date:tt)* }
        $($(#[$doc:meta])* $field:ident: $type:ty = $variable:ident,)+
    ) => {
        $(#[$about])*
        #[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
        #[serde(deny_unknown_fields)]
        pub struct $name {
            $($date)*
            $($(#[$doc])* pub $field: Option<$type>,)+
            /// Whether avalanches were seen, judged likely, ruled out, or nobody could say; null where nothing is
            /// reported of avalanches.
            #[schema(value_type = Option<ActivitySchema>)]
            pub avalanche_activity: Option<Activity>,
            /// Number of avalanches seen.
            pub avalanche_count: Option<AvalancheCount>,
            /// Wetness of the snow of the avalanches.
            pub avalanche_type: Option<AvalancheType>,
            /// What set the avalanches off.
            pub avalanche_trigger: Option<AvalancheTrigger>,
            /// Size of the largest avalanche on the European scale of 1 to 5, in steps of 0.5.
            pub avalanche_size: Option<AvalancheSize>,
            /// True for a weather forecast of the day, which is kept apart until the day is observed. Left out or null: weather
            /// of a day that is still to come is a forecast, any other was observed.
            pub forecast: Option<bool>,
        }
    };
}

observation! {
    /// Air temperature, degC.
    air_temperature: AirTemperature = AirTemperature,
    /// Wind speed, m/s.
    wind_speed: WindSpeed = WindSpeed,
    /// Direction the wind comes from, degrees clockwise from north.
    wind_direction: WindDirection = WindDirection,
    /// Cloud cover, %.
    cloud_cover: CloudCover = CloudCover,
    /// Height of the whole snowpack, cm.
    snow_height: SnowHeight = SnowHeight,
    /// New snow of the last 24 h, cm.
    new_snow_24h: NewSnow24h = NewSnow24h,
    /// Index of new snow, 0 (none) to 10 (heavy snow).
    new_snow_index: NewSnowIndex = NewSnowIndex,
    /// Precipitation of the last 24 h, mm of water.
    precipitation_24h: Precipitation24h = Precipitation24h,
    /// Whether rain fell at 900 m.
    rain_at_900m: bool = RainAt900m,
    /// Whether snow was drifting.
    snow_drift: bool = SnowDrift,
    /// Foot penetration, cm.
    foot_penetration: FootPenetration = FootPenetration,
    /// Snow temperature, degC, never above 0.
    snow_temperature: SnowTemperature = SnowTemperature,
    /// Insolation index, 2 to 20.
    insolation_index: InsolationIndex = InsolationIndex,
    /// Running sum of the new-snow index over the season, as the service that recorded it exported it.
    cumulative_snow_index: CumulativeSnowIndex = CumulativeSnowIndex,
}

impl Observation {
    /// What is stated of avalanches; `None` where no activity is given.
    #[must_use]
    pub fn avalanche(&self) -> Option<AvalancheRecord> {
        Some(AvalancheRecord {
            activity: self.avalanche_activity?,
            count: self.avalanche_count,
            r#type: self.avalanche_type,
            trigger: self.avalanche_trigger,
            size: self.avalanche_size,
        })
    }

    /// What contradicts itself in the day; empty for a day that can be true.
    #[must_use]
    pub fn contradictions(&self) -> Vec<Contradiction> {
        match self.avalanche() {
            Some(record) => record.contradictions(),
            None if self.describes_avalanches() => vec![Contradiction::DescribedWithoutActivity],
            None => Vec::new(),
        }
    }

    /// Whether the weather is a forecast and no observation, where the station's present day is `today`.
    ///
    /// # Errors
    /// [`ForecastContradiction`] for weather that is said to be observed on a day to come, and for avalanches that a forecast
    /// says were seen or ruled out.
    pub fn is_forecast(&self, date: Date, today: Date) -> Result<bool, ForecastContradiction> {
        match self.forecast {
            Some(false) if date > today => Err(ForecastContradiction::ObservedBeforehand { today }),
            Some(true) if self.avalanche_activity.is_some_and(|activity| activity != Activity::Unknown) => {
                Err(ForecastContradiction::Avalanches)
            }
            Some(forecast) => Ok(forecast),
            None => Ok(date > today),
        }
    }

    /// The day as the engines read it; an activity that was not given is unknown.
    #[must_use]
    pub fn day_record(&self, date: Date) -> DayRecord {
        DayRecord { date, values: self.values(), activity: self.avalanche_activity.unwrap_or(Activity::Unknown) }
    }

    const fn describes_avalanches(&self) -> bool {
        self.avalanche_count.is_some()
            || self.avalanche_type.is_some()
            || self.avalanche_trigger.is_some()
            || self.avalanche_size.is_some()
    }
}

/// Why a day can be neither a forecast nor an observation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ForecastContradiction {
    /// Nobody can have observed it.
    #[error("must be true or left out: the day is still to come (the station's present day is {today})")]
    ObservedBeforehand {
        /// The present day.
        today: Date,
    },
    /// Avalanches are observed and not forecast.
    #[error("must be false or left out where avalanche_activity is given: avalanches are observed and not forecast")]
    Avalanches,
}

#[cfg(test)]
mod tests {
    use super::*;
    use jiff::civil::date;
    use serde_json::json;
    use utoipa::PartialSchema;

    fn read(body: serde_json::Value) -> Result<Observation, String> {
        serde_json::from_value(body).map_err(|error| error.to_string())
    }

    #[test]
    fn every_variable_is_a_field_of_its_name() {
        let day = read(json!({})).unwrap();
        let fields = serde_json::to_value(day).unwrap();
        for variable in Variable::ALL {
            assert!(fields.get(variable.name()).is_some_and(serde_json::Value::is_null), "{}", variable.name());
        }
        assert_eq!(fields.as_object().unwrap().len(), VARIABLES + 6);
    }

    #[test]
    fn values_keep_their_places_and_nulls_stay_missing() {
        let day = read(json!({"air_temperature": -3, "snow_drift": true, "rain_at_900m": false, "cloud_cover": null,
                              "cumulative_snow_index": 316, "avalanche_activity": "observed", "avalanche_count": 2}))
        .unwrap();
        let values = day.values();
        assert_eq!(values[Variable::AirTemperature.index()], Some(-3.0));
        assert_eq!(values[Variable::SnowDrift.index()], Some(1.0));
        assert_eq!(values[Variable::RainAt900m.index()], Some(0.0));
        assert_eq!(values[Variable::CloudCover.index()], None);
        assert_eq!(values[Variable::CumulativeSnowIndex.index()], Some(316.0));
        assert_eq!(values.iter().flatten().count(), 4);
        let record = day.avalanche().unwrap();
        assert_eq!(record.count.unwrap().get(), 2);
        assert_eq!(Observation::from_values(&values, Some(&record)).unwrap(), day);
        let day_record = day.day_record(date(2007, 3, 1));
        assert_eq!((day_record.activity, day_record.values), (Activity::Observed, values));
    }

    #[test]
    fn a_silent_day_is_unknown_and_never_none() {
        let day = read(json!({})).unwrap();
        assert_eq!(day.avalanche(), None);
        assert_eq!(day.day_record(date(2007, 3, 1)).activity, Activity::Unknown);
    }

    #[test]
    fn unknown_fields_and_impossible_values_are_refused() {
        assert!(read(json!({"air_temp": 1})).unwrap_err().contains("unknown field `air_temp`"));
        assert!(read(json!({"insolation_index": 24})).unwrap_err().contains("between 2 and 20, got 24"));
        assert!(read(json!({"snow_drift": 1})).unwrap_err().contains("expected a boolean"));
        assert!(read(json!({"avalanche_activity": "maybe"})).unwrap_err().contains("`presumed`"));
        assert!(read(json!({"avalanche_size": 2.5})).is_ok());
        assert!(read(json!({"date": "2007-01-01"})).unwrap_err().contains("unknown field `date`"));
    }

    #[test]
    fn a_dated_day_is_the_same_day() {
        let body = json!({"date": "2007-03-01", "wind_speed": 4});
        let dated: DatedObservation = serde_json::from_value(body).unwrap();
        let (date, day) = dated.split();
        assert_eq!(date, jiff::civil::date(2007, 3, 1));
        assert_eq!(day.on(date), dated);
        assert!(serde_json::from_value::<DatedObservation>(json!({"wind_speed": 4})).is_err());
        let unknown = json!({"date": "2007-03-01", "x": 4});
        assert!(serde_json::from_value::<DatedObservation>(unknown).unwrap_err().to_string().contains("unknown field"));
    }

    #[test]
    fn weather_of_a_day_to_come_is_a_forecast() {
        let (yesterday, today, tomorrow) = (date(2007, 2, 28), date(2007, 3, 1), date(2007, 3, 2));
        let kind = |body, day| read(body).unwrap().is_forecast(day, today);
        for (day, expected) in [(yesterday, false), (today, false), (tomorrow, true)] {
            assert_eq!(kind(json!({}), day), Ok(expected));
            assert_eq!(kind(json!({"forecast": true, "avalanche_activity": "unknown"}), day), Ok(true));
        }
        assert_eq!(kind(json!({"forecast": false}), today), Ok(false));
        assert_eq!(
            kind(json!({"forecast": false}), tomorrow),
            Err(ForecastContradiction::ObservedBeforehand { today })
        );
        let seen = json!({"forecast": true, "avalanche_activity": "none"});
        assert_eq!(kind(seen, tomorrow), Err(ForecastContradiction::Avalanches));
    }

    #[test]
    fn contradictions_name_their_field() {
        let fields = |body| {
            let found = read(body).unwrap().contradictions();
            found.into_iter().map(Contradiction::observation_field).collect::<Vec<_>>()
        };
        assert_eq!(fields(json!({"avalanche_activity": "none", "avalanche_count": 2})), ["avalanche_count"]);
        assert_eq!(fields(json!({"avalanche_activity": "presumed", "avalanche_count": 1})), ["avalanche_count"]);
        assert_eq!(fields(json!({"avalanche_activity": "unknown", "avalanche_count": 1})), ["avalanche_count"]);
        assert_eq!(fields(json!({"avalanche_activity": "observed", "avalanche_count": 0})), ["avalanche_count"]);
        assert_eq!(
            fields(json!({"avalanche_activity": "none", "avalanche_type": "dry", "avalanche_trigger": "cornice",
                          "avalanche_size": 1})),
            ["avalanche_type", "avalanche_trigger", "avalanche_size"]
        );
        assert_eq!(fields(json!({"avalanche_count": 2})), ["avalanche_activity"]);
        let sound = [
            json!({}),
            json!({"avalanche_activity": "none", "avalanche_count": 0, "avalanche_type": "unknown"}),
            json!({"avalanche_activity": "presumed", "avalanche_type": "wet"}),
            json!({"avalanche_activity": "observed", "avalanche_size": 2}),
        ];
        for body in sound {
            assert_eq!(fields(body.clone()), Vec::<String>::new(), "{body}");
        }
    }

    #[test]
    fn the_schema_lists_every_field_with_its_unit() {
        let schema = serde_json::to_value(Observation::schema()).unwrap();
        let properties = schema["properties"].as_object().unwrap();
        assert_eq!(properties.len(), VARIABLES + 6);
        assert_eq!(schema["additionalProperties"], false);
        assert!(schema.get("required").is_none());
        let text = properties["wind_speed"].to_string();
        assert!(text.contains("m/s") && text.contains("WindSpeed"), "{text}");
        assert!(properties["avalanche_activity"].to_string().contains("schemas/Activity"));
        let record = serde_json::to_value(AvalancheRecord::schema()).unwrap();
        let names: Vec<_> = record["properties"].as_object().unwrap().keys().cloned().collect();
        assert_eq!(names, ["activity", "count", "type", "trigger", "size"]);
    }
}
