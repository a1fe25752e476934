//! The desk over NATS: a worker on another machine asks by request and reply. What is larger than one message goes in
//! chunks, so that workers need no file system in common with the desk.

use std::{
    collections::HashMap,
    sync::{Arc, Mutex, PoisonError},
    time::{Duration, Instant},
};

use async_nats::{Client, Message};
use futures_util::StreamExt;
use serde::{Deserialize, Serialize, de::DeserializeOwned};
use tokio_util::sync::CancellationToken;
use uuid::Uuid;

use super::{
    desk::Desk,
    engine::Boxed,
    link::{Assignment, Delivery, JobLink, LinkError, LogLine, Verdict},
};
use crate::domain::{
    ids::new_id,
    job::{Report, Spent},
};

/// A worker of another version could give other numbers for the same inputs.
const VERSION: &str = env!("CARGO_PKG_VERSION");

/// Where the desk listens.
const DESK: &str = "firn.desk";

/// Bytes of one chunk: well below the megabyte that a NATS server takes by default.
const CHUNK: usize = 512 * 1024;

/// How long chunks of an unfinished transfer are kept.
const TRANSFER_PATIENCE: Duration = Duration::from_secs(300);

/// How long a worker waits for an answer.
const PATIENCE: Duration = Duration::from_secs(20);

#[derive(Serialize, Deserialize)]
enum Ask {
    Claim {
        job: Uuid,
        worker: String,
        // the oldest workers do not say
        #[serde(default)]
        version: String,
    },
    Beat {
        job: Uuid,
        attempt: u32,
        report: Report,
    },
    Log {
        job: Uuid,
        attempt: u32,
        lines: Vec<LogLine>,
    },
    Checkpoint {
        job: Uuid,
        attempt: u32,
        #[serde(with = "serde_bytes")]
        bytes: Vec<u8>,
    },
    Keep {
        job: Uuid,
        attempt: u32,
        #[serde(with = "serde_bytes")]
        piece: Vec<u8>,
    },
    Release {
        job: Uuid,
        attempt: u32,
        spent: Spent,
    },
    Finish {
        job: Uuid,
        attempt: u32,
        delivery: Delivery,
        spent: Spent,
    },
}

#[derive(Serialize, Deserialize)]
enum Reply {
    Assignment(Assignment),
    Verdict(Verdict),
    Done,
    Failed(String),
}

/// What goes over the wire: a message, or a part of one that is too large.
#[derive(Serialize, Deserialize)]
enum Envelope {
    /// All of it.
    Whole(#[serde(with = "serde_bytes")] Vec<u8>),
    /// A part of a question; the last part brings the answer.
    Part {
        transfer: Uuid,
        last: bool,
        #[serde(with = "serde_bytes")]
        bytes: Vec<u8>,
    },
    /// The part was taken; the next, please.
    Next,
    /// The answer is large: fetch it from there.
    Large { transfer: Uuid, size: u64 },
    /// A part of a large answer, please.
    Fetch { transfer: Uuid, from: u64 },
}

fn broken(error: impl std::fmt::Display) -> LinkError {
    LinkError(error.to_string())
}

fn pack<T: Serialize>(value: &T) -> Result<Vec<u8>, LinkError> {
    rmp_serde::to_vec_named(value).map_err(broken)
}

fn unpack<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, LinkError> {
    rmp_serde::from_slice(bytes).map_err(broken)
}

/// The worker's end.
pub struct NatsLink {
    client: Client,
}

impl NatsLink {
    /// A link over an open connection.
    #[must_use]
    pub const fn new(client: Client) -> Self {
        Self { client }
    }

    async fn exchange(&self, envelope: &Envelope) -> Result<Envelope, LinkError> {
        // with its own patience: that of the connection is shorter than a slow store of artifacts may take
        let request = async_nats::Request::new().payload(pack(envelope)?.into()).timeout(Some(PATIENCE));
        let answer = self.client.send_request(DESK, request).await.map_err(broken)?;
        unpack(&answer.payload)
    }

    async fn ask(&self, ask: &Ask) -> Result<Reply, LinkError> {
        let bytes = pack(ask)?;
        let answer = if bytes.len() <= CHUNK {
            self.exchange(&Envelope::Whole(bytes)).await?
        } else {
            self.send_in_parts(&bytes).await?
        };
        let bytes = match answer {
            Envelope::Whole(bytes) => bytes,
            Envelope::Large { transfer, size } => self.fetch(transfer, size).await?,
            _ => return Err(LinkError("an answer out of turn".into())),
        };
        match unpack(&bytes)? {
            Reply::Failed(why) => Err(LinkError(why)),
            reply => Ok(reply),
        }
    }

    async fn send_in_parts(&self, bytes: &[u8]) -> Result<Envelope, LinkError> {
        let transfer = new_id();
        let many = bytes.len().div_ceil(CHUNK);
        let mut answer = Envelope::Next;
        for (index, part) in bytes.chunks(CHUNK).enumerate() {
            answer = self.exchange(&Envelope::Part { transfer, last: index + 1 == many, bytes: part.to_vec() }).await?;
        }
        Ok(answer)
    }

    async fn fetch(&self, transfer: Uuid, size: u64) -> Result<Vec<u8>, LinkError> {
        let mut bytes = Vec::new();
        while (bytes.len() as u64) < size {
            match self.exchange(&Envelope::Fetch { transfer, from: bytes.len() as u64 }).await? {
                Envelope::Whole(part) if !part.is_empty() => bytes.extend_from_slice(&part),
                _ => return Err(LinkError("a large answer was lost on its way".into())),
            }
        }
        Ok(bytes)
    }

    async fn verdict(&self, ask: Ask) -> Result<Verdict, LinkError> {
        match self.ask(&ask).await? {
            Reply::Verdict(verdict) => Ok(verdict),
            _ => Err(LinkError("an answer out of turn".into())),
        }
    }
}

impl JobLink for NatsLink {
    fn claim<'a>(&'a self, job: Uuid, worker: &'a str) -> Boxed<'a, Result<Assignment, LinkError>> {
        Box::pin(async move {
            let version = VERSION.to_owned();
            match self.ask(&Ask::Claim { job, worker: worker.to_owned(), version }).await? {
                Reply::Assignment(assignment) => Ok(assignment),
                _ => Err(LinkError("an answer out of turn".into())),
            }
        })
    }

    fn beat<'a>(&'a self, job: Uuid, attempt: u32, report: &'a Report) -> Boxed<'a, Result<Verdict, LinkError>> {
        Box::pin(self.verdict(Ask::Beat { job, attempt, report: report.clone() }))
    }

    fn log<'a>(&'a self, job: Uuid, attempt: u32, lines: &'a [LogLine]) -> Boxed<'a, Result<(), LinkError>> {
        Box::pin(async move { self.ask(&Ask::Log { job, attempt, lines: lines.to_vec() }).await.map(|_| ()) })
    }

    fn checkpoint<'a>(&'a self, job: Uuid, attempt: u32, bytes: &'a [u8]) -> Boxed<'a, Result<Verdict, LinkError>> {
        Box::pin(self.verdict(Ask::Checkpoint { job, attempt, bytes: bytes.to_vec() }))
    }

    fn keep<'a>(&'a self, job: Uuid, attempt: u32, piece: &'a [u8]) -> Boxed<'a, Result<Verdict, LinkError>> {
        Box::pin(self.verdict(Ask::Keep { job, attempt, piece: piece.to_vec() }))
    }

    fn release(&self, job: Uuid, attempt: u32, spent: Spent) -> Boxed<'_, Result<Verdict, LinkError>> {
        Box::pin(self.verdict(Ask::Release { job, attempt, spent }))
    }

    fn finish<'a>(
        &'a self,
        job: Uuid,
        attempt: u32,
        delivery: &'a Delivery,
        spent: Spent,
    ) -> Boxed<'a, Result<Verdict, LinkError>> {
        Box::pin(self.verdict(Ask::Finish { job, attempt, delivery: delivery.clone(), spent }))
    }
}

/// Bytes of unfinished transfers in either direction, and when they last moved.
type Transfers = Arc<Mutex<HashMap<Uuid, (Instant, Vec<u8>)>>>;

/// The desk's end: answers workers until `stop`.
///
/// # Errors
/// [`LinkError`] where the subject cannot be listened on.
pub async fn serve(client: Client, desk: Desk, stop: CancellationToken) -> Result<(), LinkError> {
    let mut questions = client.queue_subscribe(DESK, "desk".into()).await.map_err(broken)?;
    let transfers = Transfers::default();
    loop {
        let message = tokio::select! {
            () = stop.cancelled() => return Ok(()),
            message = questions.next() => match message {
                Some(message) => message,
                None => return Err(LinkError("the connection is closed".into())),
            },
        };
        let (client, desk, transfers) = (client.clone(), desk.clone(), Arc::clone(&transfers));
        tokio::spawn(async move {
            if let Err(error) = answer(&client, &desk, &transfers, message).await {
                tracing::warn!(%error, "a worker got no answer");
            }
        });
    }
}

async fn answer(client: &Client, desk: &Desk, transfers: &Transfers, message: Message) -> Result<(), LinkError> {
    let Some(reply) = message.reply.clone() else { return Ok(()) };
    let envelope = match unpack(&message.payload)? {
        Envelope::Whole(bytes) => wrap(transfers, pack(&decide(desk, unpack(&bytes)?).await)?),
        Envelope::Part { transfer, last, bytes } => match gather(transfers, transfer, &bytes, last) {
            Some(whole) => wrap(transfers, pack(&decide(desk, unpack(&whole)?).await)?),
            None => Envelope::Next,
        },
        Envelope::Fetch { transfer, from } => hand_out(transfers, transfer, from),
        Envelope::Next | Envelope::Large { .. } => return Err(LinkError("a question out of turn".into())),
    };
    client.publish(reply, pack(&envelope)?.into()).await.map_err(broken)
}

async fn decide(desk: &Desk, ask: Ask) -> Reply {
    let decided = match ask {
        Ask::Claim { version, .. } if version != VERSION => {
            Ok(Reply::Assignment(Assignment::OtherVersion { desk: VERSION.into() }))
        }
        Ask::Claim { job, worker, .. } => desk.claim(job, &worker).await.map(Reply::Assignment),
        Ask::Beat { job, attempt, report } => desk.beat(job, attempt, &report).await.map(Reply::Verdict),
        Ask::Log { job, attempt, lines } => desk.log(job, attempt, &lines).await.map(|()| Reply::Done),
        Ask::Checkpoint { job, attempt, bytes } => desk.checkpoint(job, attempt, &bytes).await.map(Reply::Verdict),
        Ask::Keep { job, attempt, piece } => desk.keep(job, attempt, &piece).await.map(Reply::Verdict),
        Ask::Release { job, attempt, spent } => desk.release(job, attempt, spent).await.map(Reply::Verdict),
        Ask::Finish { job, attempt, delivery, spent } => {
            desk.finish(job, attempt, &delivery, spent).await.map(Reply::Verdict)
        }
    };
    decided.unwrap_or_else(|error| Reply::Failed(error.to_string()))
}

fn lock(transfers: &Transfers) -> std::sync::MutexGuard<'_, HashMap<Uuid, (Instant, Vec<u8>)>> {
    let mut held = transfers.lock().unwrap_or_else(PoisonError::into_inner);
    held.retain(|_, (moved, _)| moved.elapsed() < TRANSFER_PATIENCE);
    held
}

fn gather(transfers: &Transfers, id: Uuid, part: &[u8], last: bool) -> Option<Vec<u8>> {
    let mut held = lock(transfers);
    let entry = held.entry(id).or_insert_with(|| (Instant::now(), Vec::new()));
    entry.0 = Instant::now();
    entry.1.extend_from_slice(part);
    if last { held.remove(&id).map(|(_, bytes)| bytes) } else { None }
}

fn wrap(transfers: &Transfers, bytes: Vec<u8>) -> Envelope {
    if bytes.len() <= CHUNK {
        return Envelope::Whole(bytes);
    }
    let (transfer, size) = (new_id(), bytes.len() as u64);
    lock(transfers).insert(transfer, (Instant::now(), bytes));
    Envelope::Large { transfer, size }
}

fn hand_out(transfers: &Transfers, id: Uuid, from: u64) -> Envelope {
    let mut held = lock(transfers);
    let Some((moved, bytes)) = held.get_mut(&id) else { return Envelope::Whole(Vec::new()) };
    *moved = Instant::now();
    let from = usize::try_from(from).unwrap_or(usize::MAX).min(bytes.len());
    let part = bytes[from..bytes.len().min(from + CHUNK)].to_vec();
    if from + part.len() == bytes.len() {
        held.remove(&id);
    }
    Envelope::Whole(part)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn a_worker_of_another_version_gets_no_job() {
        use crate::{
            jobs::{Rules, artifacts::Artifacts, engine::local::Local},
            store::Store,
        };
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).await.unwrap();
        let artifacts = Artifacts::folder(&folder.path().join("artifacts")).unwrap();
        let rules = Rules { most_waiting: 1, lease: Duration::from_secs(1), runout_memory_bytes: 0 };
        let desk = Desk::new(store, Arc::new(Local::default()), artifacts, rules);
        let claim = |version: &str| Ask::Claim { job: new_id(), worker: "w".into(), version: version.into() };
        assert!(matches!(
            decide(&desk, claim("0.0.0")).await,
            Reply::Assignment(Assignment::OtherVersion { desk }) if desk == VERSION
        ));
        // of the same version, it is only told that there is no such job
        assert!(matches!(decide(&desk, claim(VERSION)).await, Reply::Assignment(Assignment::Over)));
    }

    #[test]
    fn a_claim_of_a_worker_that_does_not_say_its_version_can_be_read() {
        #[derive(Serialize)]
        enum Oldest {
            Claim { job: Uuid, worker: String },
        }
        let bytes = pack(&Oldest::Claim { job: Uuid::from_u128(1), worker: "old".into() }).unwrap();
        assert!(matches!(unpack(&bytes).unwrap(), Ask::Claim { version, .. } if version.is_empty()));
    }

    #[test]
    fn a_large_message_comes_back_from_its_parts() {
        let transfers = Transfers::default();
        let bytes: Vec<u8> = (0..CHUNK * 2 + 7).map(|at| (at % 251) as u8).collect();
        let Envelope::Large { transfer, size } = wrap(&transfers, bytes.clone()) else { panic!("it is large") };
        let mut got = Vec::new();
        while (got.len() as u64) < size {
            let Envelope::Whole(part) = hand_out(&transfers, transfer, got.len() as u64) else { panic!("a part") };
            assert!(!part.is_empty());
            got.extend(part);
        }
        assert!(got == bytes);
        assert!(lock(&transfers).is_empty());

        let id = new_id();
        assert_eq!(gather(&transfers, id, &[1, 2], false), None);
        assert_eq!(gather(&transfers, id, &[3], true), Some(vec![1, 2, 3]));
    }
}
