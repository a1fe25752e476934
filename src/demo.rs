//! `firn serve --demo`: a station made by a generator, so that a fresh machine has something to look at.

use std::net::SocketAddr;

use firn_science::forecast::{day::DayRecord, synthetic};
use serde_json::json;

use crate::{
    api::AppState,
    clock,
    domain::{
        avalanche::AvalancheRecord,
        ids::{Place, StationId},
        job::{Job, Labels, Priority, Wanted},
        station::{Station, StationBody},
    },
    jobs::{Submission, Submitted, processes::Process},
    server::ServerError,
    store::{
        StoreError,
        audit::Actor,
        jobs::Answer,
        observations::{Author, DayWrite},
    },
};

/// The name of the station in every address: nobody shall take it for a place.
const STATION: &str = "synthetic";

/// Seed of the generator: the demo is the same everywhere.
const SEED: u64 = 2007;

/// The seasons that are made: long enough for season folds, short enough to train within seconds.
const SEASONS: (i16, usize) = (2016, 10);

/// Adds the synthetic station with its days and starts the training of its model, unless that was done before; says
/// where to look.
///
/// # Errors
/// Where the data cannot be stored.
pub async fn start(state: &AppState, address: SocketAddr) -> Result<(), ServerError> {
    let id: StationId = STATION.parse()?;
    let days = synthetic::synthetic_station(SEED, SEASONS.0, SEASONS.1);
    let body: StationBody = serde_json::from_value(json!({
        "name": "Synthetic station (generated data, not a real place)", "timezone": "UTC",
    }))?;
    let permits = |before: Option<&Station>| before.is_none_or(|station| station.synthetic);
    match state.store.put_station(&id, &body, true, &Actor::service(clock::now()), permits).await {
        Ok(_) => {}
        Err(StoreError::Precondition) => {
            return Err(
                format!("the station `{STATION}` is one of yours: the demo wants another data directory").into()
            );
        }
        Err(error) => return Err(error.into()),
    }
    // also after a start that ended half-way: what is there already is left as it is
    let writes = days.iter().map(write).collect::<Vec<_>>();
    let author = Author { name: None, at: clock::now(), source: "synthetic" };
    state.store.put_days(&id, &writes, &author).await?;
    if state.store.active_model(&Place::Station(id.clone()), 0).await?.is_none() {
        let inputs = json!({"station": STATION, "label": "observed", "lead": 0});
        let submission = Submission {
            process: Process::TrainModel,
            inputs,
            labels: Labels::new(),
            wanted: Wanted::default(),
            priority: Priority::default(),
            submitted_by: None,
            anew: false,
            reservation: None,
        };
        let render = |job: &Job, _| Answer { location: format!("/v1/jobs/{}", job.id), body: json!(null) };
        match state.desk.submit(submission, render).await {
            Ok(Submitted::New(answer)) => {
                tracing::info!("the demo trains its model: http://{address}{}", answer.location)
            }
            Ok(_) => {}
            Err(problem) => tracing::error!(%problem, "the demo's model cannot be trained"),
        }
    }
    tracing::info!("look at http://{address}/ ; its station `{STATION}` is made by a generator and is no real place");
    Ok(())
}

fn write(day: &DayRecord) -> DayWrite {
    let avalanche = Some(AvalancheRecord::of(day.activity));
    DayWrite { date: day.date, values: Some(day.values), forecast: false, avalanche }
}
