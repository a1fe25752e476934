//! Days to send in.

use std::path::PathBuf;

use firn::{
    domain::{avalanche::AvalancheRecord, ids::StationId, observation::Observation, station::StationBody},
    formats::observations_csv,
    science::forecast::{
        day::{Activity, DayRecord},
        synthetic::synthetic_station,
    },
    store::{
        Store,
        audit::Actor,
        observations::{Author, DayWrite},
    },
};
use serde_json::json;

/// Winters of a generated station, from 2011/12 on.
pub fn winters(seed: u64, count: usize) -> Vec<DayRecord> {
    synthetic_station(seed, 2011, count)
}

/// The same days as our own CSV.
pub fn csv(days: &[DayRecord]) -> String {
    observations_csv::write(days.iter().map(|day| {
        let record = (day.activity != Activity::Unknown).then(|| AvalancheRecord::of(day.activity));
        Observation::from_values(&day.values, record.as_ref()).unwrap().on(day.date)
    }))
}

/// Puts the days into a station that says everywhere that it is synthetic, as the demo does.
pub async fn synthetic(store: Store, id: &'static str, days: Vec<DayRecord>) {
    let id: StationId = id.parse().unwrap();
    let body: StationBody = serde_json::from_value(json!({"name": "Generated, no real place"})).unwrap();
    let now = firn::clock::now();
    store.put_station(&id, &body, true, &Actor::service(now), |_| true).await.unwrap();
    let write = |day: &DayRecord| DayWrite {
        date: day.date,
        values: Some(day.values),
        forecast: false,
        avalanche: Some(AvalancheRecord::of(day.activity)),
    };
    let writes: Vec<DayWrite> = days.iter().map(write).collect();
    let author = Author { name: None, at: now, source: "synthetic" };
    store.put_days(&id, &writes, &author).await.unwrap();
}

/// A file of the shared data, or a message that the test is skipped.
pub fn shared(name: &str) -> Option<Vec<u8>> {
    let beside = || PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../shared/data");
    let folder = std::env::var_os("FIRN_SHARED_DATA").map_or_else(beside, PathBuf::from);
    let path = folder.join(name);
    let found = std::fs::read(&path).ok();
    if found.is_none() {
        println!("skipped: {} is absent", path.display());
    }
    found
}
