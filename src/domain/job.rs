//! A job and the one state machine that every change of its state goes through.

use std::collections::BTreeMap;

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;
use uuid::Uuid;

/// The five states of OGC API - Processes Part 1, section 7.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum Status {
    /// Waits for a free slot.
    Accepted,
    /// Is being computed.
    Running,
    /// Has results.
    Successful,
    /// Ended with an exception.
    Failed,
    /// Was given up on request.
    Dismissed,
}

/// What may happen to a job.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event {
    /// A worker takes it: for the first time, or after the attempt before was lost.
    Claim,
    /// A worker gives it back unfinished, to be taken again.
    Release,
    /// The computation has its result.
    Succeed,
    /// The computation cannot have a result.
    Fail,
    /// The owner gives it up.
    Dismiss,
}

/// An [`Event`] that makes no sense in a state.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a job that is {status:?} cannot {event:?}")]
pub struct TransitionError {
    /// The state it was in.
    pub status: Status,
    /// What should have happened.
    pub event: Event,
}

impl Status {
    /// Every state.
    pub const ALL: [Self; 5] = [Self::Accepted, Self::Running, Self::Successful, Self::Failed, Self::Dismissed];

    /// The state after `event`.
    ///
    /// # Errors
    /// [`TransitionError`] where the event is not possible: an ended job never changes again.
    pub const fn after(self, event: Event) -> Result<Self, TransitionError> {
        match (self, event) {
            (Self::Accepted | Self::Running, Event::Claim) => Ok(Self::Running),
            (Self::Running, Event::Release) => Ok(Self::Accepted),
            (Self::Running, Event::Succeed) => Ok(Self::Successful),
            (Self::Accepted | Self::Running, Event::Fail) => Ok(Self::Failed),
            (Self::Accepted | Self::Running, Event::Dismiss) => Ok(Self::Dismissed),
            (status, event) => Err(TransitionError { status, event }),
        }
    }

    /// True once nothing can happen to the job any more.
    #[must_use]
    pub const fn ended(self) -> bool {
        matches!(self, Self::Successful | Self::Failed | Self::Dismissed)
    }

    /// The name in JSON and in the store.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Accepted => "accepted",
            Self::Running => "running",
            Self::Successful => "successful",
            Self::Failed => "failed",
            Self::Dismissed => "dismissed",
        }
    }

    /// The state of that [`Status::name`].
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|status| status.name() == name)
    }
}

/// Why a job failed: what the results endpoint answers instead of results.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Exception {
    /// The problem code, as in `/problems/{code}`.
    #[schema(example = "interrupted")]
    pub code: String,
    /// What happened, for a human.
    pub detail: String,
}

/// How far a running job is.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// How much of the attempt is done, 0 to 100; never falls within an attempt.
    pub percent: u8,
    /// What is being done.
    pub phase: String,
    /// How fast: a number of `rate_unit` a second.
    pub rate: Option<f64>,
    /// What `rate` counts.
    pub rate_unit: Option<String>,
    /// Expected time to the end, s.
    pub eta_seconds: Option<f64>,
}

/// Names and values that a client hangs on a job to find it again.
pub type Labels = BTreeMap<String, String>;

/// How an output is answered (OGC API - Processes Part 1, section 7.11.2.3).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Transmission {
    /// In the document, unless it is too large for that.
    #[default]
    Value,
    /// As its address.
    Reference,
}

/// Which of its outputs a job was asked for, and in which form.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Wanted {
    /// Only these; empty: all.
    pub outputs: BTreeMap<String, Transmission>,
    /// The one output as it is, instead of a document.
    pub raw: bool,
}

/// How urgent a job is, 0 (last) to 9 (first).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(try_from = "f64", into = "u8")]
pub struct Priority(u8);

impl Priority {
    /// The largest value.
    pub const MAX: u8 = 9;

    /// The value, 0 to 9.
    #[must_use]
    pub const fn get(self) -> u8 {
        self.0
    }
}

impl Default for Priority {
    fn default() -> Self {
        Self(5)
    }
}

impl TryFrom<u8> for Priority {
    type Error = &'static str;

    fn try_from(value: u8) -> Result<Self, Self::Error> {
        if value <= Self::MAX { Ok(Self(value)) } else { Err("must be from 0 (last) to 9 (first)") }
    }
}

impl TryFrom<f64> for Priority {
    type Error = &'static str;

    /// JSON has one kind of number: 5 and 5.0 are the same priority.
    fn try_from(value: f64) -> Result<Self, Self::Error> {
        (0..=Self::MAX).find(|whole| f64::from(*whole) == value).map(Self).ok_or("must be from 0 (last) to 9 (first)")
    }
}

impl From<Priority> for u8 {
    fn from(priority: Priority) -> Self {
        priority.0
    }
}

/// What was spent on a job over all its attempts; on one that ended without a word, up to its last sign of life.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Spent {
    /// Computing, ms.
    pub compute_ms: u64,
    /// How many states were stored to go on from.
    pub states: u32,
    /// For how much of the computing it stood still to save them, ms.
    pub saving_ms: u64,
    /// How long it took to store them, beside the computing, ms.
    pub storing_ms: u64,
}

/// One job as the store keeps it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Job {
    /// Its id, a UUID version 7.
    pub id: Uuid,
    /// Which process it executes.
    pub process_id: String,
    /// Where it is in its life.
    pub status: Status,
    /// How far its newest attempt is.
    pub report: Report,
    /// A sentence on its state.
    pub message: Option<String>,
    /// Why it failed.
    pub exception: Option<Exception>,
    /// The inputs with every default and the seed filled in.
    pub inputs: serde_json::Value,
    /// SHA-256 (hex) of the resolved inputs and of the content that they name.
    pub input_hash: String,
    /// The version of firn that accepted it.
    pub version: String,
    /// Who submitted it: the name of a key, or none where no key was needed.
    pub submitted_by: Option<String>,
    /// Names and values to find it again.
    pub labels: Labels,
    /// Which outputs it was asked for.
    #[serde(default)]
    pub wanted: Wanted,
    /// How urgent it is.
    pub priority: Priority,
    /// The job whose result this one is a part of.
    pub parent: Option<Uuid>,
    /// Its place among the children of its parent.
    pub position: Option<u32>,
    /// Counts the claims, from 1; 0: nobody has taken it. The fence of every write.
    pub attempt: u32,
    /// Who took it last.
    pub worker: Option<String>,
    /// What was spent on it.
    pub spent: Spent,
    /// When it was accepted.
    pub created: Timestamp,
    /// When it was first started.
    pub started: Option<Timestamp>,
    /// When it ended.
    pub finished: Option<Timestamp>,
    /// When it last changed.
    pub updated: Timestamp,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_ended_job_never_changes() {
        for status in Status::ALL.into_iter().filter(|s| s.ended()) {
            for event in [Event::Claim, Event::Release, Event::Succeed, Event::Fail, Event::Dismiss] {
                assert_eq!(status.after(event), Err(TransitionError { status, event }));
            }
        }
    }

    #[test]
    fn a_priority_is_a_whole_number_from_0_to_9() {
        let read = |text: &str| serde_json::from_str::<Priority>(text).map(Priority::get).ok();
        assert_eq!(
            (read("9"), read("0.0"), read("5.5"), read("10"), read("-1"), read("1e99")),
            (Some(9), Some(0), None, None, None, None)
        );
    }

    #[test]
    fn success_needs_a_start() {
        assert!(Status::Accepted.after(Event::Succeed).is_err());
        assert_eq!(Status::Accepted.after(Event::Claim), Ok(Status::Running));
        assert_eq!(Status::Running.after(Event::Claim), Ok(Status::Running));
        assert_eq!(Status::Running.after(Event::Release), Ok(Status::Accepted));
        assert!(Status::Accepted.after(Event::Release).is_err());
        assert_eq!(Status::Running.after(Event::Succeed), Ok(Status::Successful));
    }
}
