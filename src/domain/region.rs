//! A region: stations that feed one model, and what its avalanche days are.

use firn_science::forecast::region::{Quiet, RegionRule};
use jiff::Timestamp;
use serde::{Deserialize, Deserializer, Serialize, de::Error};
use utoipa::{
    ToSchema,
    openapi::schema::{ArrayBuilder, ObjectBuilder, Schema, Type},
};

use super::{
    ids::{RegionId, StationId},
    retrain::Retrain,
    station::StationName,
};

/// Most stations of a region.
pub const MOST_STATIONS: usize = 100;

/// What the owner of a region says of it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct RegionBody {
    /// Name for humans, 1 to 200 characters.
    pub name: StationName,
    /// Names of its stations, 1 to 100, each once. All must exist.
    #[serde(deserialize_with = "distinct")]
    #[schema(schema_with = stations_schema)]
    pub stations: Vec<StationId>,
    /// What an avalanche day of the region is.
    #[serde(default)]
    pub avalanche_day: AvalancheDay,
    /// When its models are retrained by themselves, as a proposal; null: on request only. The day is that of the zone of its
    /// first station.
    #[serde(default)]
    pub retrain: Option<Retrain>,
}

/// What an avalanche day of a region is, and what a quiet one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct AvalancheDay {
    /// Stations with an avalanche that make an avalanche day of the region, 1 or more.
    #[serde(default = "one", deserialize_with = "stations_needed")]
    #[schema(minimum = 1, maximum = 100, default = 1)]
    pub stations: u32,
    /// What a day is on which too few stations had one. `every_station`: quiet where it would be whatever the stations without
    /// a record had seen, else unknown. `any_station`: quiet where at least one station says so.
    #[serde(default)]
    #[schema(value_type = String, pattern = "^(every_station|any_station)$", default = "every_station")]
    pub quiet: Quiet,
}

fn stations_schema() -> Schema {
    let id = ObjectBuilder::new().schema_type(Type::String).pattern(Some(StationId::PATTERN));
    let list = ArrayBuilder::new()
        .items(id)
        .unique_items(true)
        .min_items(Some(1))
        .max_items(Some(MOST_STATIONS))
        .description(Some("Names of its stations, 1 to 100, each once. All must exist."));
    Schema::Array(list.build())
}

const fn one() -> u32 {
    1
}

impl Default for AvalancheDay {
    fn default() -> Self {
        Self { stations: one(), quiet: Quiet::default() }
    }
}

impl AvalancheDay {
    /// The same for the science.
    #[must_use]
    pub const fn rule(self) -> RegionRule {
        RegionRule { stations: self.stations as usize, quiet: self.quiet }
    }
}

/// A number of stations as any JSON number: 2.0 is the number 2 as well.
fn stations_needed<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u32, D::Error> {
    let given = f64::deserialize(deserializer)?;
    let needed = (1..=100).find(|needed| f64::from(*needed) == given);
    needed.ok_or_else(|| D::Error::custom("must be a whole number from 1 to 100"))
}

fn distinct<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<StationId>, D::Error> {
    let stations = Vec::<StationId>::deserialize(deserializer)?;
    let repeated = stations.iter().enumerate().any(|(at, station)| stations[..at].contains(station));
    if stations.is_empty() || stations.len() > MOST_STATIONS || repeated {
        return Err(D::Error::custom(format!("must be 1 to {MOST_STATIONS} names of stations, each once")));
    }
    Ok(stations)
}

/// A region as the store keeps it.
#[derive(Clone, Debug, PartialEq)]
pub struct Region {
    /// Its name in every address.
    pub id: RegionId,
    /// What its owner says of it.
    pub body: RegionBody,
    /// Counts the changes, from 1.
    pub revision: u32,
    /// When it was made.
    pub created: Timestamp,
    /// When it last changed.
    pub updated: Timestamp,
}
