//! Sees to it that nothing is forgotten: issues tickets again that an engine lost, retires what is old, and
//! starts the retrainings that the calendar asks for.

use std::time::Duration;

use jiff::{SignedDuration, Timestamp};
use tokio_util::sync::CancellationToken;

use super::{desk::Desk, retraining};
use crate::{
    clock,
    store::{StoreError, jobs::Retention},
};

/// How often lost tickets are looked for.
const ROUND: Duration = Duration::from_secs(2);

/// A ticket that was issued so recently may still be on its way, s.
const TICKET_PATIENCE_S: i64 = 15;

/// Tickets that are issued again at once: more would only wait.
const MOST_TICKETS: u32 = 10_000;

/// Rounds between two looks at what is old: ten minutes.
const ROUNDS_TO_RETIRE: u32 = 300;

/// Rounds between two looks at the calendar: one minute.
const ROUNDS_TO_RETRAIN: u32 = 30;

/// Rounds between two looks at outputs that nobody names: a day. The first look is at the start, after whatever ended the
/// process before.
const ROUNDS_TO_SWEEP: u32 = 43_200;

/// How long an idempotency key is remembered, hours.
const KEY_HOURS: i64 = 24;

/// How long and how much is kept of ended jobs.
#[derive(Clone, Copy, Debug)]
pub struct Keep {
    /// Ended jobs are kept this long, days.
    pub days: u32,
    /// Ended jobs are kept as long as they need no more than this, bytes.
    pub bytes: u64,
}

/// Takes up what an earlier process left: whoever held a job died with it where the workers are in this process.
///
/// # Errors
/// [`StoreError`] where it cannot be stored.
pub async fn take_up(desk: &Desk, workers_are_here: bool) -> Result<(), StoreError> {
    desk.store().forget_keys(Timestamp::MIN, true).await?;
    if workers_are_here {
        let orphans = desk.store().end_all_leases().await?;
        if orphans > 0 {
            tracing::info!(jobs = orphans, "jobs of an earlier process go on from their last checkpoint");
        }
    }
    issue_again(desk, Timestamp::MAX).await
}

/// Looks after the jobs until `stop`.
pub async fn run(desk: Desk, keep: Keep, stop: CancellationToken) {
    let mut round = 0_u32;
    loop {
        tokio::select! {
            () = stop.cancelled() => return,
            () = tokio::time::sleep(ROUND) => {}
        }
        let patience = SignedDuration::from_secs(TICKET_PATIENCE_S);
        let before = clock::now().checked_sub(patience).unwrap_or(Timestamp::MIN);
        if let Err(error) = issue_lost(&desk, before).await {
            tracing::error!(%error, "lost tickets could not be looked for");
        }
        if let Err(error) = desk.sweep_pieces().await {
            tracing::error!(%error, "pieces of outputs that are no more needed could not be removed");
        }
        if round.is_multiple_of(ROUNDS_TO_RETIRE)
            && let Err(error) = retire(&desk, keep).await
        {
            tracing::error!(%error, "old jobs could not be retired");
        }
        // in the first round too: what was due while nobody was there is made up for
        if round.is_multiple_of(ROUNDS_TO_RETRAIN)
            && let Err(error) = retraining::start_due(&desk, clock::now()).await
        {
            tracing::error!(%error, "models that are due could not be retrained");
        }
        if round.is_multiple_of(ROUNDS_TO_SWEEP) {
            match desk.sweep_artifacts().await {
                Ok(0) => {}
                Ok(outputs) => tracing::info!(outputs, "outputs that nobody names were removed"),
                Err(error) => tracing::error!(%error, "outputs that nobody names could not be looked for"),
            }
        }
        round = round.wrapping_add(1);
    }
}

/// Issues tickets again where the engine holds fewer than there are jobs: a queue that is merely long gets no doubles.
async fn issue_lost(desk: &Desk, ticketed_before: Timestamp) -> Result<(), StoreError> {
    // asked before the jobs are counted: one that is accepted in between has its ticket on the way
    let held = match desk.engine().held().await {
        Ok(held) => held,
        Err(error) => {
            tracing::warn!(%error, "it cannot be told whether tickets were lost");
            return Ok(());
        }
    };
    if held >= desk.store().jobs_with_tickets().await? { Ok(()) } else { issue_again(desk, ticketed_before).await }
}

async fn issue_again(desk: &Desk, ticketed_before: Timestamp) -> Result<(), StoreError> {
    let jobs = desk.store().jobs_without_ticket(ticketed_before, clock::now(), MOST_TICKETS).await?;
    // marked first: where the engine does not take them, that is noted after
    let ids: Vec<_> = jobs.iter().map(|(id, ..)| *id).collect();
    desk.store().mark_ticketed(&ids, clock::now()).await?;
    desk.ticket(&jobs).await;
    Ok(())
}

async fn retire(desk: &Desk, keep: Keep) -> Result<(), StoreError> {
    let now = clock::now();
    let before = |hours: i64| now.checked_sub(SignedDuration::from_hours(hours)).unwrap_or(Timestamp::MIN);
    let retention = Retention { ended_before: before(24 * i64::from(keep.days)), most_bytes: keep.bytes };
    let jobs = desk.retire(retention).await?;
    if jobs > 0 {
        tracing::info!(jobs, "old jobs were retired");
    }
    desk.store().forget_keys(before(KEY_HOURS), false).await
}
