//! Retrains what is due by the calendar: once for each place, lead and year, whatever ends the process in between.

use jiff::{Timestamp, Zoned, civil::Date};

use super::{
    desk::Desk,
    processes::{Process, retrain_model},
};
use crate::{
    domain::problem::{Code, Problem},
    store::{
        StoreError,
        proposals::{Due, Schedule},
    },
};

/// The leads that a place may have a model of.
const LEADS: [u8; 2] = [0, 1];

/// Starts the retrainings that are due at `now`, also those that were due while nobody was there; says how many it started.
///
/// An active model is due where it was made before the last such day of the year, and no retraining was taken up for that day.
///
/// # Errors
/// [`StoreError`] where the database does not answer; what was started stays started.
pub async fn start_due(desk: &Desk, now: Timestamp) -> Result<usize, StoreError> {
    let mut started = 0;
    for schedule in desk.store().schedules().await? {
        for lead in LEADS {
            if let Some(day) = due(desk, &schedule, lead, now).await? {
                let due = Due { place: schedule.place.clone(), lead, day };
                started += usize::from(start(desk, &due, now).await?);
            }
        }
    }
    Ok(started)
}

/// The local day on which the model of a place was due and has not been retrained for.
async fn due(desk: &Desk, schedule: &Schedule, lead: u8, now: Timestamp) -> Result<Option<Date>, StoreError> {
    let store = desk.store();
    let local = |at: Timestamp| Zoned::new(at, schedule.zone.clone()).date();
    let Some(day) = schedule.yearly.last_until(local(now)) else { return Ok(None) };
    let Some(active) = store.active_model(&schedule.place, lead).await? else { return Ok(None) };
    let model = store.model(active.model).await?.ok_or(StoreError::Missing)?;
    if local(model.created) >= day {
        return Ok(None);
    }
    let due = Due { place: schedule.place.clone(), lead, day };
    Ok((!store.is_taken_up(&due).await?).then_some(day))
}

/// Starts one; says whether it did.
async fn start(desk: &Desk, due: &Due, now: Timestamp) -> Result<bool, StoreError> {
    let Due { place, lead, day } = due;
    let inputs = serde_json::to_value(retrain_model::Inputs::of(place, *lead))
        .map_err(|error| StoreError::Corrupt(error.to_string()))?;
    match desk.submit_due(Process::RetrainModel, &inputs, due, now).await {
        Ok(started) => {
            if started {
                tracing::info!(%place, lead, %day, "the model is retrained, as it is each year");
            }
            Ok(started)
        }
        // to be tried again in the next round
        Err(Problem { code: Code::Overloaded | Code::ShuttingDown, .. }) => Ok(false),
        Err(problem) if problem.code == Code::Internal => {
            Err(StoreError::Corrupt(problem.cause.unwrap_or(problem.detail)))
        }
        Err(problem) => {
            tracing::warn!(%place, lead, %day, %problem, "the model cannot be retrained this year");
            desk.store().take_up(due, Err(&problem.detail), now).await?;
            Ok(false)
        }
    }
}
