//! Bulletins in the form that avalanche warning services exchange: CAAML 6.0, profile BulletinEAWS, as JSON.
//!
//! The public schema is `CAAMLv6_BulletinEAWS.json` of github.com/canadianavalancheassociation/caaml-bulletin-eaws (with
//! `regionID` as in the copy that avalanche.report validates against, gitlab.com/albina-euregio). It has a place for a danger
//! level that a person has set, and none for the probability of a model: that stands in `customData.firn`.

use jiff::{Timestamp, ToSpan, civil::Date, tz::TimeZone};
use serde::Serialize;
use serde_json::Value;
use utoipa::ToSchema;

use crate::domain::station::Station;

/// The language of what is written here.
const LANGUAGE: &str = "en";

/// What stands above the bulletin of a place that does not exist.
const SYNTHETIC: &str = "Synthetic data: no forecast of a real place.";

/// Bulletins of several days or stations.
#[derive(Clone, Debug, Serialize, ToSchema)]
#[schema(as = CaamlBulletins)]
pub struct Bulletins {
    /// In the order of their days.
    pub bulletins: Vec<Bulletin>,
}

/// A bulletin of one day and region.
#[derive(Clone, Debug, Serialize, ToSchema)]
#[serde(rename_all = "camelCase")]
#[schema(as = CaamlBulletin)]
pub struct Bulletin {
    /// Names the bulletin; the same whenever it is asked for.
    #[serde(rename = "bulletinID")]
    pub bulletin_id: String,
    /// Language of the texts (ISO 639-1).
    #[schema(value_type = String, min_length = 2, max_length = 2)]
    pub lang: &'static str,
    /// When the forecast was issued or, where that was later, the danger level set.
    pub publication_time: Timestamp,
    /// The local day of the station.
    pub valid_time: ValidTime,
    /// Who answers for it.
    pub source: Source,
    /// The region of the station.
    pub regions: Vec<Region>,
    /// One rating: that of a person, or `no_rating`.
    pub danger_ratings: Vec<DangerRating>,
    /// Says of synthetic data that they are; else left out.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = String)]
    pub highlights: Option<&'static str>,
    /// What CAAML has no place for.
    pub custom_data: CustomData,
}

/// From when until when a bulletin is valid, RFC 3339 with the offset of the station's zone.
#[derive(Clone, Debug, Serialize, ToSchema)]
#[serde(rename_all = "camelCase")]
#[schema(as = CaamlValidTime)]
pub struct ValidTime {
    /// The first instant of the day.
    #[schema(format = DateTime)]
    pub start_time: String,
    /// The first instant of the next day.
    #[schema(format = DateTime)]
    pub end_time: String,
}

/// Who answers for a bulletin.
#[derive(Clone, Debug, Serialize, ToSchema)]
#[schema(as = CaamlSource)]
pub struct Source {
    /// The warning service.
    pub provider: Provider,
}

/// A warning service.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
#[schema(as = CaamlProvider)]
pub struct Provider {
    /// Its name.
    pub name: String,
    /// Its address in the web, if it has one.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = String)]
    pub website: Option<String>,
}

/// A region.
#[derive(Clone, Debug, Serialize, ToSchema)]
#[schema(as = CaamlRegion)]
pub struct Region {
    /// The id of its region among the European warning services; the id of the station where it has none.
    #[serde(rename = "regionID")]
    pub region_id: String,
    /// The name of the station.
    pub name: String,
}

/// A danger rating of the whole day.
#[derive(Clone, Debug, Serialize, ToSchema)]
#[serde(rename_all = "camelCase")]
#[schema(as = CaamlDangerRating)]
pub struct DangerRating {
    /// `low`, `moderate`, `considerable`, `high` or `very_high` as a person set it, else `no_rating`.
    #[schema(value_type = String, pattern = "^(low|moderate|considerable|high|very_high|no_rating)$")]
    pub main_value: &'static str,
    /// Always `all_day`.
    #[schema(value_type = String, pattern = "^all_day$")]
    pub valid_time_period: &'static str,
}

/// What CAAML has no place for, under the name of this service.
#[derive(Clone, Debug, Serialize, ToSchema)]
#[schema(as = CaamlCustomData)]
pub struct CustomData {
    /// The forecast of the model.
    pub firn: ModelForecast,
}

/// The forecast of the model as it was issued, and the call of the forecaster beside it.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
#[schema(as = CaamlModelForecast)]
pub struct ModelForecast {
    /// The station.
    pub station: String,
    /// True where the data were made by a generator.
    pub synthetic: bool,
    /// The day that was forecast.
    #[schema(value_type = String, format = Date)]
    pub date: Date,
    /// Days between the last observation that was read and that day.
    pub lead: u8,
    /// `forecast` where the weather of the day was a forecast, else `observed`.
    #[schema(value_type = String, pattern = "^(observed|forecast)$")]
    pub weather: &'static str,
    /// When it was issued.
    pub issued: Timestamp,
    /// True where that was after the day had ended.
    pub hindcast: bool,
    /// The forecast as it was answered: probability of an avalanche day, threshold and category, model, inputs, provenance.
    #[schema(value_type = Object)]
    pub forecast: Value,
    /// The past days that were nearest to it in the eyes of the machine, and whether they were avalanche days.
    #[schema(value_type = Vec<Object>)]
    pub similar_days: Value,
    /// Whether the forecaster warned; null where there is no call.
    pub called: Option<bool>,
    /// With what probability; null where none was given.
    pub called_probability: Option<f64>,
}

/// The danger level that a person has set.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LevelSet {
    /// 1 (low) to 5 (very high).
    pub level: u8,
    /// When.
    pub made: Timestamp,
}

/// The bulletin of a forecast that was issued. `level` is what a person set, if anybody did: nothing else makes a rating.
#[must_use]
pub fn bulletin(station: &Station, provider: &Provider, model: ModelForecast, level: Option<LevelSet>) -> Bulletin {
    let kind = if model.synthetic { "synthetic-" } else { "" };
    let zone = station.zone();
    Bulletin {
        bulletin_id: format!("{kind}{}-{}-lead{}-{}", station.id, model.date, model.lead, model.weather),
        lang: LANGUAGE,
        publication_time: level.map_or(model.issued, |level| level.made.max(model.issued)),
        valid_time: ValidTime {
            start_time: midnight(model.date, &zone),
            end_time: midnight(model.date.checked_add(1.day()).unwrap_or(Date::MAX), &zone),
        },
        source: Source { provider: provider.clone() },
        regions: vec![Region {
            region_id: station
                .body
                .eaws_region
                .as_ref()
                .map_or(station.id.as_str(), |region| region.as_str())
                .to_owned(),
            name: station.body.name.as_str().to_owned(),
        }],
        danger_ratings: vec![DangerRating { main_value: rating(level), valid_time_period: "all_day" }],
        highlights: model.synthetic.then_some(SYNTHETIC),
        custom_data: CustomData { firn: model },
    }
}

/// The name of a level on the European danger scale.
const fn rating(level: Option<LevelSet>) -> &'static str {
    match level {
        Some(LevelSet { level: 1, .. }) => "low",
        Some(LevelSet { level: 2, .. }) => "moderate",
        Some(LevelSet { level: 3, .. }) => "considerable",
        Some(LevelSet { level: 4, .. }) => "high",
        Some(LevelSet { level: 5, .. }) => "very_high",
        _ => "no_rating",
    }
}

/// The first instant of a local day, which is not always midnight, with the offset from UTC that it has.
fn midnight(date: Date, zone: &TimeZone) -> String {
    match date.to_zoned(zone.clone()).and_then(|day| day.start_of_day()) {
        Ok(start) => start.timestamp().display_with_offset(start.offset()).to_string(),
        // beyond the last instant that a time can name
        Err(_) => format!("{date}T00:00:00Z"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use jiff::civil::date;
    use serde_json::json;

    fn station(zone: &str, region: Option<&str>) -> Station {
        Station {
            id: "lochaber".parse().unwrap(),
            body: serde_json::from_value(json!({"name": "Lochaber", "timezone": zone, "eaws_region": region})).unwrap(),
            synthetic: false,
            revision: 1,
            created: Timestamp::UNIX_EPOCH,
            updated: Timestamp::UNIX_EPOCH,
        }
    }

    fn model(date: Date, synthetic: bool) -> ModelForecast {
        ModelForecast {
            station: "lochaber".to_owned(),
            synthetic,
            date,
            lead: 1,
            weather: "observed",
            issued: "2007-03-24T17:00:00Z".parse().unwrap(),
            hindcast: false,
            forecast: json!({"probability": 0.4}),
            similar_days: json!([]),
            called: None,
            called_probability: None,
        }
    }

    fn written(station: &Station, model: ModelForecast, level: Option<LevelSet>) -> Value {
        let provider = Provider { name: "A service".to_owned(), website: None };
        serde_json::to_value(bulletin(station, &provider, model, level)).unwrap()
    }

    /// The clocks go forward on 25 March 2007 in London: that day has 23 hours.
    #[test]
    fn a_bulletin_is_valid_for_the_local_day() {
        let found = written(&station("Europe/London", None), model(date(2007, 3, 25), false), None);
        let expected = json!({"startTime": "2007-03-25T00:00:00+00:00", "endTime": "2007-03-26T00:00:00+01:00"});
        assert_eq!(found["validTime"], expected);
        assert_eq!(found["publicationTime"], "2007-03-24T17:00:00Z");
        assert_eq!(found["regions"], json!([{"regionID": "lochaber", "name": "Lochaber"}]));
        assert_eq!(found["bulletinID"], "lochaber-2007-03-25-lead1-observed");
        let far = written(&station("Asia/Tokyo", Some("JP-01")), model(Date::MAX, false), None);
        assert_eq!(far["regions"][0]["regionID"], "JP-01");
        assert!(far["validTime"]["endTime"].as_str().unwrap().starts_with("9999-12-31T"));
    }

    /// The European avalanche danger scale (avalanches.org).
    #[test]
    fn only_a_person_makes_a_rating() {
        let london = station("Europe/London", None);
        let day = date(2007, 3, 25);
        let none = written(&london, model(day, false), None);
        assert_eq!(none["dangerRatings"], json!([{"mainValue": "no_rating", "validTimePeriod": "all_day"}]));
        let made: Timestamp = "2007-03-24T18:30:00Z".parse().unwrap();
        let names = ["low", "moderate", "considerable", "high", "very_high"];
        for (level, name) in (1..).zip(names) {
            let found = written(&london, model(day, false), Some(LevelSet { level, made }));
            assert_eq!(found["dangerRatings"][0]["mainValue"], name);
            assert_eq!(found["publicationTime"], "2007-03-24T18:30:00Z");
        }
    }

    #[test]
    fn what_is_synthetic_says_so() {
        let found = written(&station("UTC", None), model(date(2007, 3, 25), true), None);
        assert!(found["highlights"].as_str().unwrap().contains("no forecast of a real place"));
        assert!(found["bulletinID"].as_str().unwrap().starts_with("synthetic-"));
        assert_eq!(found["customData"]["firn"]["synthetic"], true);
        assert!(written(&station("UTC", None), model(date(2007, 3, 25), false), None).get("highlights").is_none());
    }
}
