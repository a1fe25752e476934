//! What the desk answers workers: claims, signs of life, deliveries.

use std::{
    sync::PoisonError,
    time::{Duration, Instant},
};

use jiff::{SignedDuration, Timestamp};
use serde_json::{Value, json};
use uuid::Uuid;

use super::{Desk, Write, new_job};
use crate::{
    clock,
    domain::{
        job::{Exception, Job, Report, Spent},
        problem::{Code, Problem},
    },
    jobs::{
        artifacts::digest,
        engine::Boxed,
        link::{Artifact, Assignment, Delivery, JobLink, LinkError, LogLine, Output, Verdict},
        processes::Process,
    },
    store::{
        StoreError,
        jobs::{Beat, Claim, Kept, Outcome, OutputRecord},
    },
};

/// Progress is written at most this often a job; a sign of life between two writes is only read.
const WRITE_EVERY: Duration = Duration::from_millis(500);

/// An output up to this size stands in the row of the job, bytes.
const LARGEST_INLINE: usize = 256 * 1024;

impl Desk {
    fn lease(&self) -> SignedDuration {
        SignedDuration::try_from(self.0.rules.lease).unwrap_or(SignedDuration::from_secs(30))
    }

    fn fenced(&self, write: Write, error: StoreError) -> Result<Verdict, LinkError> {
        match error {
            StoreError::Fenced | StoreError::Missing | StoreError::Transition(_) => {
                self.0.tally.fenced(write);
                Ok(Verdict::Fenced)
            }
            other => Err(LinkError(other.to_string())),
        }
    }

    async fn assign(&self, id: Uuid, worker: &str) -> Result<Assignment, LinkError> {
        let link = |error: StoreError| LinkError(error.to_string());
        let survives = self.0.engine.workers_survive();
        let claim = self.0.store.claim_job(id, worker, clock::now(), self.lease(), survives).await.map_err(link)?;
        self.changed(id);
        let (job, checkpoint) = match claim {
            Claim::Busy(left) => return Ok(Assignment::Busy { retry_ms: ms(left) }),
            Claim::Over => return Ok(Assignment::Over),
            Claim::GivenUp(ended) => {
                self.0.tally.lease_lost();
                self.see_to(ended).await;
                return Ok(Assignment::Over);
            }
            Claim::Taken { job, checkpoint, lease_lost } => {
                if lease_lost {
                    self.0.tally.lease_lost();
                }
                (job, checkpoint)
            }
        };
        let payload = match Process::from_id(&job.process_id) {
            Some(process) => {
                self.0.tally.attempt(process);
                process.payload(self.shelf(), &job).await
            }
            None => Err(Problem::new(Code::JobFailed, format!("there is no process {} any more", job.process_id))),
        };
        match payload {
            Ok(payload) => {
                if payload.input_hash != job.input_hash {
                    // what the inputs name was edited while the job waited: it is found again by what it computes
                    self.0.store.set_input_hash(job.id, job.attempt, &payload.input_hash).await.map_err(link)?;
                }
                let lease_ms = ms(self.lease());
                Ok(Assignment::Taken { job, payload: payload.bytes, checkpoint, lease_ms })
            }
            Err(problem) if problem.code == Code::Internal => {
                // not the fault of the job: it is tried again
                self.0.store.release_job(job.id, job.attempt, Spent::default(), clock::now()).await.map_err(link)?;
                Err(LinkError(problem.cause.unwrap_or(problem.detail)))
            }
            Err(problem) => {
                let exception = Exception { code: problem.code.slug().into(), detail: problem.detail };
                self.end(job.id, job.attempt, Outcome::Failed(exception), None, Spent::default())
                    .await
                    .map_err(link)?;
                Ok(Assignment::Over)
            }
        }
    }

    async fn beaten(&self, id: Uuid, attempt: u32, report: &Report) -> Result<Verdict, LinkError> {
        let link = |error: StoreError| LinkError(error.to_string());
        let due = {
            let written = self.0.written.lock().unwrap_or_else(PoisonError::into_inner);
            written.get(&id).is_none_or(|(at, before)| {
                let age = at.elapsed();
                age >= self.0.rules.lease / 4 || (age >= WRITE_EVERY && before != report)
            })
        };
        let beat = if due {
            let beat = self.0.store.beat_job(id, attempt, report, clock::now(), self.lease()).await.map_err(link)?;
            if beat == Beat::Go {
                let mut written = self.0.written.lock().unwrap_or_else(PoisonError::into_inner);
                written.insert(id, (Instant::now(), report.clone()));
            }
            self.changed(id);
            beat
        } else {
            self.0.store.is_attempt_current(id, attempt).await.map_err(link)?
        };
        if beat == Beat::Go {
            return Ok(Verdict::Counts);
        }
        let newer = self.0.store.job(id).await.map_err(link)?.is_some_and(|job| job.attempt != attempt);
        if newer {
            // not merely dismissed: a worker that was thought lost writes for an attempt that was taken over
            self.0.tally.fenced(Write::Beat);
        } else {
            self.over(id);
        }
        Ok(Verdict::Fenced)
    }

    async fn received(&self, id: Uuid, attempt: u32, delivery: &Delivery, spent: Spent) -> Result<Verdict, LinkError> {
        let output = match delivery {
            Delivery::Failed(exception) => {
                let outcome = Outcome::Failed(exception.clone());
                return self.verdict(Write::Result, self.end(id, attempt, outcome, None, spent).await);
            }
            Delivery::Finished(output) => output,
        };
        if !output.split.is_empty() {
            return match self.children(id, output).await {
                Ok(jobs) => self.verdict(Write::Result, self.end(id, attempt, Outcome::Split(jobs), None, spent).await),
                Err(problem) if problem.code == Code::Internal => {
                    Err(LinkError(problem.cause.unwrap_or(problem.detail)))
                }
                Err(problem) => {
                    let exception = Exception { code: problem.code.slug().into(), detail: problem.detail };
                    self.verdict(Write::Result, self.end(id, attempt, Outcome::Failed(exception), None, spent).await)
                }
            };
        }
        let large_outputs = !output.artifacts.is_empty();
        if large_outputs
            && self.0.store.is_attempt_current(id, attempt).await.map_err(|error| LinkError(error.to_string()))?
                == Beat::Stop
        {
            // before its outputs are stored, which nobody would remove
            return self.fenced(Write::Result, StoreError::Fenced);
        }
        let pieces = output.artifacts.iter().flat_map(|artifact| &artifact.pieces);
        if let Some(piece) = self.foreign(id, pieces.collect()).await? {
            let detail = format!("an output names the piece {piece}, which was not handed over");
            let outcome = Outcome::Failed(Exception { code: Code::JobFailed.slug().into(), detail });
            return self.verdict(Write::Result, self.end(id, attempt, outcome, None, spent).await);
        }
        let _naming = self.0.naming.read().await;
        let mut outputs = Vec::new();
        let (mut results, large) = apart(&output.results);
        for artifact in output.artifacts.iter().chain(&large) {
            outputs.push(self.0.artifacts.put(artifact).await.map_err(|error| LinkError(error.to_string()))?);
        }
        if let Some(object) = results.as_object_mut() {
            for output in &outputs {
                object.insert(output.name.clone(), reference(id, output));
            }
        }
        let outcome = Outcome::Successful { results, outputs };
        self.verdict(Write::Result, self.end(id, attempt, outcome, output.keep.as_ref(), spent).await)
    }

    /// The first of some pieces that a job has not handed over.
    async fn foreign<'a>(&self, id: Uuid, pieces: Vec<&'a String>) -> Result<Option<&'a String>, LinkError> {
        if pieces.is_empty() {
            return Ok(None);
        }
        let own = self.0.store.job_pieces(id).await.map_err(|error| LinkError(error.to_string()))?;
        Ok(pieces.into_iter().find(|piece| !own.contains(piece)))
    }

    async fn keep_piece(&self, id: Uuid, attempt: u32, piece: &[u8]) -> Result<Verdict, LinkError> {
        let _naming = self.0.naming.read().await;
        // named before it is there: what nobody names would never be removed
        if let Err(error) = self.0.store.name_piece(id, attempt, &digest(piece)).await {
            return self.fenced(Write::Piece, error);
        }
        self.0.artifacts.put_piece(piece).await.map_err(|error| LinkError(error.to_string()))?;
        Ok(Verdict::Counts)
    }

    fn verdict(&self, write: Write, written: Result<(), StoreError>) -> Result<Verdict, LinkError> {
        written.map_or_else(|error| self.fenced(write, error), |()| Ok(Verdict::Counts))
    }

    /// The jobs that a job goes on as, each checked like a submission.
    async fn children(&self, parent: Uuid, output: &Output) -> Result<Vec<Job>, Problem> {
        let above = self.0.store.job(parent).await.map_err(Problem::internal)?;
        let above = above.ok_or_else(|| Problem::internal("the parent is gone"))?;
        let mut jobs = Vec::with_capacity(output.split.len());
        for (position, part) in (0..).zip(&output.split) {
            let process = Process::from_id(&part.process_id)
                .ok_or_else(|| Problem::new(Code::NoSuchProcess, format!("there is no process {}", part.process_id)))?;
            let accepted = process.accept(self.shelf(), &part.inputs).await?;
            let mut job = new_job(process, accepted.inputs, accepted.hash);
            job.parent = Some(parent);
            job.position = Some(position);
            job.priority = above.priority;
            job.labels.clone_from(&above.labels);
            job.submitted_by.clone_from(&above.submitted_by);
            jobs.push(job);
        }
        Ok(jobs)
    }

    /// What a job wants kept beside it, as the store keeps it; or why that is not what its process gives.
    async fn kept(
        &self,
        id: Uuid,
        keep: Option<&Value>,
        now: Timestamp,
    ) -> Result<Result<Option<Kept>, serde_json::Error>, StoreError> {
        let Some(keep) = keep else { return Ok(Ok(None)) };
        let job = self.0.store.job(id).await?.ok_or(StoreError::Missing)?;
        let process = Process::from_id(&job.process_id).ok_or(StoreError::Missing)?;
        Ok(process.kept(&job, keep, now).map(Some))
    }

    /// Ends an attempt in the store, with what is kept beside it, and sees to what that brings about.
    async fn end(
        &self,
        id: Uuid,
        attempt: u32,
        outcome: Outcome,
        keep: Option<&Value>,
        spent: Spent,
    ) -> Result<(), StoreError> {
        let now = clock::now();
        let (outcome, kept) = match self.kept(id, keep, now).await? {
            Ok(kept) => (outcome, kept),
            // to deliver it again would not mend it
            Err(error) => {
                (Outcome::Failed(Exception { code: Code::JobFailed.slug().into(), detail: error.to_string() }), None)
            }
        };
        let ended = self.0.store.finish_job(id, attempt, outcome, kept.as_ref(), spent, now).await?;
        self.over(id);
        self.see_to(ended).await;
        Ok(())
    }
}

fn ms(time: SignedDuration) -> u64 {
    u64::try_from(time.as_millis()).unwrap_or(0)
}

/// How a large output stands in the results document.
fn reference(job: Uuid, output: &OutputRecord) -> Value {
    json!({
        "href": format!("/v1/jobs/{job}/results/{}", output.name),
        "type": output.media_type, "length": output.size, "sha256": output.sha256,
    })
}

/// The results document without its large members, and these as outputs of their own.
fn apart(results: &Value) -> (Value, Vec<Artifact>) {
    let Some(members) = results.as_object() else { return (results.clone(), Vec::new()) };
    let mut small = serde_json::Map::new();
    let mut large = Vec::new();
    for (name, value) in members {
        let text = value.to_string();
        if text.len() <= LARGEST_INLINE {
            small.insert(name.clone(), value.clone());
        } else {
            let (name, media_type) = (name.clone(), "application/json".to_owned());
            large.push(Artifact { name, media_type, bytes: text.into_bytes(), pieces: Vec::new() });
        }
    }
    (Value::Object(small), large)
}

impl JobLink for Desk {
    fn claim<'a>(&'a self, job: Uuid, worker: &'a str) -> Boxed<'a, Result<Assignment, LinkError>> {
        Box::pin(self.assign(job, worker))
    }

    fn beat<'a>(&'a self, job: Uuid, attempt: u32, report: &'a Report) -> Boxed<'a, Result<Verdict, LinkError>> {
        Box::pin(self.beaten(job, attempt, report))
    }

    fn log<'a>(&'a self, job: Uuid, attempt: u32, lines: &'a [LogLine]) -> Boxed<'a, Result<(), LinkError>> {
        Box::pin(async move {
            let lines: Vec<_> = lines.iter().map(|line| (line.level.clone(), line.message.clone())).collect();
            let stored = self.0.store.append_job_log(job, attempt, &lines, clock::now()).await;
            self.verdict(Write::Log, stored).map(|_| ())
        })
    }

    fn checkpoint<'a>(&'a self, job: Uuid, attempt: u32, bytes: &'a [u8]) -> Boxed<'a, Result<Verdict, LinkError>> {
        Box::pin(async move {
            let saved = self.0.store.save_checkpoint(job, attempt, bytes, clock::now()).await;
            self.verdict(Write::Checkpoint, saved)
        })
    }

    fn keep<'a>(&'a self, job: Uuid, attempt: u32, piece: &'a [u8]) -> Boxed<'a, Result<Verdict, LinkError>> {
        Box::pin(self.keep_piece(job, attempt, piece))
    }

    fn release(&self, job: Uuid, attempt: u32, spent: Spent) -> Boxed<'_, Result<Verdict, LinkError>> {
        Box::pin(async move {
            let released = self.0.store.release_job(job, attempt, spent, clock::now()).await;
            self.over(job);
            self.verdict(Write::Release, released)
        })
    }

    fn finish<'a>(
        &'a self,
        job: Uuid,
        attempt: u32,
        delivery: &'a Delivery,
        spent: Spent,
    ) -> Boxed<'a, Result<Verdict, LinkError>> {
        Box::pin(self.received(job, attempt, delivery, spent))
    }
}
