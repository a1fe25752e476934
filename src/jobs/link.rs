//! What a worker may ask of the desk, whether it sits in the same process or on another machine.

use serde::{Deserialize, Serialize};
use serde_json::Value;
use uuid::Uuid;

use super::engine::Boxed;
use crate::domain::job::{Exception, Job, Report, Spent};

/// The desk does not answer.
#[derive(Debug, thiserror::Error)]
#[error("the desk: {0}")]
pub struct LinkError(pub String);

/// The answer to a claim.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub enum Assignment {
    /// The job is yours.
    Taken {
        /// The job, with the number of this attempt.
        job: Box<Job>,
        /// Everything that the process needs.
        #[serde(with = "serde_bytes")]
        payload: Vec<u8>,
        /// What an earlier attempt saved last.
        #[serde(with = "serde_bytes")]
        checkpoint: Option<Vec<u8>>,
        /// How long its worker may be silent, ms.
        lease_ms: u64,
    },
    /// Another worker has it.
    Busy {
        /// When it may be had if that worker is lost, ms from now.
        retry_ms: u64,
    },
    /// It needs nobody any more.
    Over,
    /// The worker is of another version than the desk, and would not compute what the desk promised.
    OtherVersion {
        /// That of the desk.
        desk: String,
    },
}

/// Whether what a worker sent counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Verdict {
    /// It does.
    Counts,
    /// The attempt was dismissed or taken over: stop.
    Fenced,
}

/// How an attempt ended.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub enum Delivery {
    /// With a result.
    Finished(Output),
    /// Without.
    Failed(Exception),
}

/// What a computation gave.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Output {
    /// The results document.
    pub results: Value,
    /// What the desk keeps beside the job: a trained model.
    pub keep: Option<Value>,
    /// Outputs too large for the document; each stands in the results by reference.
    pub artifacts: Vec<Artifact>,
    /// Not a result: the job goes on as these, and is called again with what they gave.
    pub split: Vec<Part>,
}

/// A large output: its bytes, and after them those of its pieces.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Artifact {
    /// Its name in the results.
    pub name: String,
    /// Its media type.
    pub media_type: String,
    /// Its bytes, or the first of them.
    #[serde(with = "serde_bytes")]
    pub bytes: Vec<u8>,
    /// Digests (SHA-256, hex) of the pieces that were handed over while it was computed and that follow.
    #[serde(default)]
    pub pieces: Vec<String>,
}

/// A part of a job that is a job of its own.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Part {
    /// The process that computes it.
    pub process_id: String,
    /// Its inputs.
    pub inputs: Value,
}

/// A line for the log of a job.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LogLine {
    /// `info`, `warn` or `error`.
    pub level: String,
    /// What happened.
    pub message: String,
}

/// What a worker may ask of the desk.
pub trait JobLink: Send + Sync {
    /// Wishes to take a job.
    fn claim<'a>(&'a self, job: Uuid, worker: &'a str) -> Boxed<'a, Result<Assignment, LinkError>>;

    /// A sign of life.
    fn beat<'a>(&'a self, job: Uuid, attempt: u32, report: &'a Report) -> Boxed<'a, Result<Verdict, LinkError>>;

    /// Lines for the log.
    fn log<'a>(&'a self, job: Uuid, attempt: u32, lines: &'a [LogLine]) -> Boxed<'a, Result<(), LinkError>>;

    /// A state to go on from, should the worker be lost.
    fn checkpoint<'a>(&'a self, job: Uuid, attempt: u32, bytes: &'a [u8]) -> Boxed<'a, Result<Verdict, LinkError>>;

    /// A piece of an output, which the delivery names by its digest.
    fn keep<'a>(&'a self, job: Uuid, attempt: u32, piece: &'a [u8]) -> Boxed<'a, Result<Verdict, LinkError>>;

    /// Gives the job back unfinished.
    fn release(&self, job: Uuid, attempt: u32, spent: Spent) -> Boxed<'_, Result<Verdict, LinkError>>;

    /// Delivers the end of an attempt.
    fn finish<'a>(
        &'a self,
        job: Uuid,
        attempt: u32,
        delivery: &'a Delivery,
        spent: Spent,
    ) -> Boxed<'a, Result<Verdict, LinkError>>;
}
