//! How long ended jobs are kept, on the store alone.

use firn::{
    domain::{
        ids::new_id,
        job::{Job, Labels, Priority, Report, Spent, Status, Wanted},
    },
    store::{
        Store,
        jobs::{Answer, Claim, Held, Outcome, OutputRecord, Reservation, Retention},
    },
};
use jiff::{SignedDuration, Timestamp};
use serde_json::json;
use tempfile::TempDir;
use uuid::Uuid;

use crate::support::app::data_dir;

/// An hour of the 1st of November 2026.
fn at(hour: i64) -> Timestamp {
    "2026-11-01T00:00:00Z".parse::<Timestamp>().unwrap() + SignedDuration::from_hours(hour)
}

fn job(created: Timestamp, parent: Option<Uuid>) -> Job {
    Job {
        id: new_id(),
        process_id: "echo".into(),
        status: Status::Accepted,
        report: Report::default(),
        message: None,
        exception: None,
        inputs: json!({}),
        input_hash: String::new(),
        version: "0".into(),
        submitted_by: None,
        labels: Labels::new(),
        wanted: Wanted::default(),
        priority: Priority::default(),
        parent,
        position: None,
        attempt: 0,
        worker: None,
        spent: Spent::default(),
        created,
        started: None,
        finished: None,
        updated: created,
    }
}

async fn store() -> (Store, TempDir) {
    let data = data_dir();
    (Store::open(data.path()).await.unwrap(), data)
}

/// A job that ended at `end` with an output of `size` bytes under `sha256`.
async fn done(store: &Store, end: Timestamp, size: u64, sha256: &str, parent: Option<Uuid>) -> Uuid {
    let job = job(end, parent);
    store.insert_job(&job, None).await.unwrap();
    let claim = store.claim_job(job.id, "w", end, SignedDuration::from_secs(30), true).await.unwrap();
    assert!(matches!(claim, Claim::Taken { .. }));
    let output = OutputRecord { name: "x".into(), media_type: "text/plain".into(), size, sha256: sha256.into() };
    let outcome = Outcome::Successful { results: json!({}), outputs: vec![output] };
    store.finish_job(job.id, 1, outcome, None, Spent::default(), end).await.unwrap();
    job.id
}

async fn is_there(store: &Store, id: Uuid) -> bool {
    store.job(id).await.unwrap().is_some()
}

#[tokio::test]
async fn old_jobs_go_with_their_children_and_open_ones_stay() {
    let (store, _data) = store().await;
    let old = done(&store, at(1), 10, "old", None).await;
    let child = done(&store, at(30), 10, "child", Some(old)).await;
    let young = done(&store, at(30), 10, "young", None).await;
    let open = job(at(0), None);
    store.insert_job(&open, None).await.unwrap();
    let retention = Retention { ended_before: at(24), most_bytes: u64::MAX };
    let (jobs, mut digests) = store.retire_jobs(retention).await.unwrap();
    digests.sort();
    assert_eq!((jobs, digests), (1, vec!["child".to_owned(), "old".to_owned()]));
    assert!(!is_there(&store, old).await && !is_there(&store, child).await);
    assert!(is_there(&store, young).await && is_there(&store, open.id).await);
    assert_eq!(store.retire_jobs(retention).await.unwrap(), (0, vec![]));
}

#[tokio::test]
async fn the_oldest_jobs_go_when_all_need_too_much() {
    let (store, _data) = store().await;
    let mut ids = Vec::new();
    for (hour, digest) in [(1, "a"), (2, "b"), (3, "a")] {
        ids.push(done(&store, at(hour), 1000, digest, None).await);
    }
    // each needs its output and a few bytes of inputs and results
    let retention = Retention { ended_before: at(0), most_bytes: 2500 };
    // the bytes of the one that goes are still those of the newest
    assert_eq!(store.retire_jobs(retention).await.unwrap(), (1, vec![]));
    assert!(!is_there(&store, ids[0]).await && is_there(&store, ids[1]).await && is_there(&store, ids[2]).await);
    let (jobs, mut digests) = store.retire_jobs(Retention { ended_before: at(0), most_bytes: 0 }).await.unwrap();
    digests.sort();
    assert_eq!((jobs, digests), (2, vec!["a".to_owned(), "b".to_owned()]));
}

#[tokio::test]
async fn a_job_needs_what_its_children_need() {
    let (store, _data) = store().await;
    let parent = done(&store, at(1), 10, "parent", None).await;
    for (hour, digest) in [(2, "a"), (3, "b")] {
        done(&store, at(hour), 1000, digest, Some(parent)).await;
    }
    let young = done(&store, at(4), 100, "young", None).await;
    // its own output alone would fit in
    let (jobs, digests) = store.retire_jobs(Retention { ended_before: at(0), most_bytes: 1500 }).await.unwrap();
    assert_eq!((jobs, digests.len()), (1, 3));
    assert!(!is_there(&store, parent).await && is_there(&store, young).await);
}

#[tokio::test]
async fn what_was_spent_on_a_lost_attempt_counts_up_to_its_last_sign_of_life() {
    let (store, _data) = store().await;
    let job = job(at(0), None);
    store.insert_job(&job, None).await.unwrap();
    let lease = SignedDuration::from_secs(30);
    store.claim_job(job.id, "lost", at(1), lease, true).await.unwrap();
    store.beat_job(job.id, 1, &Report::default(), at(1) + SignedDuration::from_secs(20), lease).await.unwrap();
    let claim = store.claim_job(job.id, "heir", at(2), lease, true).await.unwrap();
    let Claim::Taken { job: taken, lease_lost, .. } = claim else { panic!("{claim:?}") };
    assert!(lease_lost);
    assert_eq!((taken.attempt, taken.spent.compute_ms), (2, 20_000));
    let spent = Spent { compute_ms: 5_000, states: 2, saving_ms: 7, storing_ms: 30 };
    store.release_job(job.id, 2, spent, at(3)).await.unwrap();
    // what was given back was not lost
    let claim = store.claim_job(job.id, "last", at(4), lease, true).await.unwrap();
    assert!(matches!(claim, Claim::Taken { lease_lost: false, .. }), "{claim:?}");
    store.dismiss_job(job.id, at(4) + SignedDuration::from_secs(2)).await.unwrap();
    let job = store.job(job.id).await.unwrap().unwrap();
    assert_eq!(job.spent, Spent { compute_ms: 27_000, states: 2, saving_ms: 7, storing_ms: 30 });
}

#[tokio::test]
async fn keys_are_forgotten_after_their_time_and_half_accepted_ones_at_a_start() {
    let (store, _data) = store().await;
    let key = |key: &str| Reservation { caller: String::new(), key: key.into(), request_hash: "h".into() };
    let answer = Answer { location: "/v1/jobs/x".into(), body: json!({}) };
    for (name, hour) in [("old", 1), ("young", 30)] {
        assert_eq!(store.hold_key(&key(name), at(hour)).await.unwrap(), Held::New);
        store.insert_job(&job(at(hour), None), Some((&key(name), &answer))).await.unwrap();
    }
    assert_eq!(store.hold_key(&key("half"), at(30)).await.unwrap(), Held::New);
    store.forget_keys(at(24), false).await.unwrap();
    assert_eq!(store.hold_key(&key("young"), at(31)).await.unwrap(), Held::Answered(answer));
    assert_eq!(store.hold_key(&key("half"), at(31)).await.unwrap(), Held::AtWork);
    store.forget_keys(Timestamp::MIN, true).await.unwrap();
    assert_eq!(store.hold_key(&key("half"), at(31)).await.unwrap(), Held::New);
    assert_eq!(store.hold_key(&key("old"), at(31)).await.unwrap(), Held::New);
}

#[tokio::test]
async fn a_log_is_bounded() {
    let (store, _data) = store().await;
    let job = job(at(0), None);
    store.insert_job(&job, None).await.unwrap();
    store.claim_job(job.id, "w", at(0), SignedDuration::from_secs(30), true).await.unwrap();
    let lines: Vec<(String, String)> = (0..700).map(|number| ("info".into(), number.to_string())).collect();
    store.append_job_log(job.id, 1, &lines, at(0)).await.unwrap();
    store.append_job_log(job.id, 1, &lines, at(0)).await.unwrap();
    assert_eq!(store.job_log(job.id).await.unwrap().len(), 1000);
    assert!(store.append_job_log(job.id, 2, &lines, at(0)).await.is_err(), "of an attempt that does not count");
}
