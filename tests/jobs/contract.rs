//! What every engine must keep, tried on each of them.

use std::{
    collections::HashSet,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU32, Ordering},
    },
    time::{Duration, Instant},
};

use firn::{
    domain::job::{Job, Report, Spent, Status},
    jobs::{
        artifacts::digest,
        desk::Write,
        link::{Artifact, Assignment, Delivery, Output, Part, Verdict},
        processes::{Failure, Process},
    },
};
use serde_json::json;
use uuid::Uuid;

use crate::{processes::PATIENCE, rig::Rig};

macro_rules! contract {
    ($($name:ident, lease $lease_ms:literal ms;)+) => {
        mod local {
            $(#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
            async fn $name() {
                super::$name(super::Rig::local(super::Duration::from_millis($lease_ms)).await).await;
            })+
        }

        mod nats {
            $(#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
            async fn $name() {
                if let Some(rig) = super::Rig::nats(super::Duration::from_millis($lease_ms)).await {
                    super::$name(rig).await;
                }
            })+
        }
    };
}

contract! {
    every_accepted_job_ends_once, lease 10_000 ms;
    urgent_jobs_come_first_and_equals_in_their_order, lease 10_000 ms;
    a_lease_outlives_a_job_of_many_lease_times, lease 1_500 ms;
    an_attempt_that_was_taken_over_can_write_nothing, lease 1_000 ms;
    a_job_that_loses_every_worker_is_failed, lease 1_000 ms;
    a_lost_attempt_is_repeated_from_its_checkpoint, lease 1_000 ms;
    a_dismissed_job_frees_its_slot_within_a_second, lease 10_000 ms;
    progress_never_falls_within_an_attempt, lease 10_000 ms;
    nothing_is_fetched_ahead_of_free_slots, lease 10_000 ms;
    a_worker_that_stops_gives_back_what_it_holds, lease 10_000 ms;
    children_run_side_by_side_and_their_parent_is_put_together, lease 10_000 ms;
    a_lost_last_child_frees_its_parent, lease 500 ms;
    a_large_state_comes_back_whole, lease 1_000 ms;
    a_computation_that_stands_still_is_failed, lease 10_000 ms;
    a_state_on_its_way_holds_nothing_up, lease 1_500 ms;
    a_ticket_is_delivered_however_often_it_was_put_back, lease 10_000 ms;
    pieces_of_a_lost_attempt_and_of_its_heir_make_one_output, lease 1_000 ms;
    a_computation_hands_pieces_over_while_it_runs, lease 10_000 ms;
}

/// Claims a job as a worker would; panics where it cannot be had.
async fn claim(rig: &Rig, id: Uuid, worker: &str) -> (Job, Option<Vec<u8>>) {
    for _ in 0..40 {
        match rig.link.claim(id, worker).await {
            Ok(Assignment::Taken { job, checkpoint, .. }) => return (*job, checkpoint),
            Ok(Assignment::Over | Assignment::OtherVersion { .. }) => panic!("{id} is not to be had"),
            // the lease of the one before has not ended, or the desk listens only now
            Ok(Assignment::Busy { .. }) | Err(_) => tokio::time::sleep(Duration::from_millis(50)).await,
        }
    }
    panic!("{id} is busy");
}

fn spent(compute_ms: u64) -> Spent {
    Spent { compute_ms, ..Spent::default() }
}

fn result(message: &str) -> Delivery {
    Delivery::Finished(Output { results: json!({"message": message}), ..Output::default() })
}

async fn every_accepted_job_ends_once(rig: Rig) {
    let workers = [rig.worker("a", 2), rig.worker("b", 2)];
    let mut ids = Vec::new();
    for number in 0..40 {
        let inputs = json!({"message": number.to_string(), "delay_s": 0.02, "fail": number % 10 == 9});
        ids.push(rig.submit(inputs, 5).await);
    }
    for (number, id) in ids.iter().enumerate() {
        let job = rig.ended(*id).await;
        assert_eq!(job.attempt, 1, "{job:?}");
        if number % 10 == 9 {
            assert_eq!(job.status, Status::Failed);
            assert_eq!(job.exception.unwrap().code, "job-failed");
        } else {
            assert_eq!(job.status, Status::Successful);
            let results = rig.store.job_results(*id).await.unwrap();
            assert_eq!(results, Some(json!({"message": number.to_string()})));
        }
        let ends = rig.store.job_events(*id, 0).await.unwrap();
        let ends = ends.iter().filter(|event| ["successful", "failed"].iter().any(|end| event.body["status"] == *end));
        assert_eq!(ends.count(), 1);
    }
    assert_eq!(rig.desk.fenced_writes(), 0);
    for worker in workers {
        worker.stop(Duration::from_secs(5)).await;
    }
}

/// Workers that cannot reach the desk put a ticket back about once a second: it must not wear out.
async fn a_ticket_is_delivered_however_often_it_was_put_back(rig: Rig) {
    let id = rig.submit(json!({"message": "patient"}), 5).await;
    for _ in 0..1_200 {
        rig.engine.next().await.unwrap().put_back(Duration::ZERO).await;
    }
    let worker = rig.worker("late", 1);
    assert_eq!(rig.ended(id).await.status, Status::Successful);
    worker.stop(Duration::from_secs(5)).await;
}

async fn urgent_jobs_come_first_and_equals_in_their_order(rig: Rig) {
    let mut expected = Vec::new();
    for (number, priority) in [5, 0, 9, 5, 9, 5, 1].into_iter().enumerate() {
        expected
            .push((std::cmp::Reverse(priority), rig.submit(json!({"message": number.to_string()}), priority).await));
    }
    let worker = rig.worker("one", 1);
    for (_, id) in &expected {
        rig.ended(*id).await;
    }
    let mut jobs = rig.jobs().await;
    jobs.sort_by_key(|job| job.started);
    let order: Vec<Uuid> = jobs.into_iter().map(|job| job.id).collect();
    // ids are ordered in time
    expected.sort();
    assert_eq!(order, expected.into_iter().map(|(_, id)| id).collect::<Vec<_>>());
    worker.stop(Duration::from_secs(5)).await;
}

async fn a_lease_outlives_a_job_of_many_lease_times(rig: Rig) {
    let id = rig.submit(json!({"message": "long", "delay_s": 6}), 5).await;
    // one of them has nothing to do but to take over
    let workers = [rig.worker("a", 1), rig.worker("b", 1)];
    let job = rig.ended(id).await;
    assert_eq!((job.status, job.attempt), (Status::Successful, 1), "{job:?}");
    assert_eq!(rig.desk.fenced_writes(), 0);
    for worker in workers {
        worker.stop(Duration::from_secs(5)).await;
    }
}

async fn an_attempt_that_was_taken_over_can_write_nothing(rig: Rig) {
    let id = rig.submit(json!({"message": "a"}), 5).await;
    let (zombie, _) = claim(&rig, id, "zombie").await;
    assert!(matches!(rig.link.claim(id, "heir").await.unwrap(), Assignment::Busy { .. }), "the lease holds");
    let (heir, _) = claim(&rig, id, "heir").await;
    assert_eq!((zombie.attempt, heir.attempt), (1, 2));

    let before = rig.job(id).await;
    let half = Report { percent: 50, phase: "half".into(), ..Report::default() };
    assert_eq!(rig.link.beat(id, 1, &half).await.unwrap(), Verdict::Fenced);
    assert_eq!(rig.link.checkpoint(id, 1, &[1]).await.unwrap(), Verdict::Fenced);
    assert_eq!(rig.link.keep(id, 1, &[1]).await.unwrap(), Verdict::Fenced);
    assert_eq!(rig.link.release(id, 1, spent(10)).await.unwrap(), Verdict::Fenced);
    assert_eq!(rig.link.finish(id, 1, &result("of the zombie"), spent(10)).await.unwrap(), Verdict::Fenced);
    assert_eq!(rig.job(id).await, before);
    assert_eq!(rig.desk.fenced_writes(), 5);

    assert_eq!(rig.link.finish(id, 2, &result("of the heir"), spent(10)).await.unwrap(), Verdict::Counts);
    assert_eq!(rig.link.finish(id, 2, &result("twice"), spent(10)).await.unwrap(), Verdict::Fenced);
    assert_eq!(rig.link.finish(id, 1, &result("too late"), spent(10)).await.unwrap(), Verdict::Fenced);
    assert_eq!(rig.store.job_results(id).await.unwrap(), Some(json!({"message": "of the heir"})));
    assert_eq!(rig.desk.fenced_writes(), 7);
    let tally = rig.desk.tally();
    let kinds = Write::ALL.map(|write| (write.name(), tally.fenced_writes(write)));
    assert_eq!(kinds, [("beat", 1), ("log", 0), ("checkpoint", 1), ("piece", 1), ("release", 1), ("result", 3)]);
    assert_eq!((tally.attempts(Process::Echo), tally.leases_lost(), tally.dismissals()), (2, 1, 0));
    assert!(matches!(rig.link.claim(id, "third").await.unwrap(), Assignment::Over));
}

async fn a_job_that_loses_every_worker_is_failed(rig: Rig) {
    let id = rig.submit(json!({"message": "poison"}), 5).await;
    for attempt in 1..=5 {
        assert_eq!(claim(&rig, id, "doomed").await.0.attempt, attempt);
    }
    // whoever looks at it once the last lease has ended ends it: here the tickets that a worker gets
    let worker = rig.worker("next", 1);
    let job = rig.ended(id).await;
    assert_eq!((job.status, job.attempt), (Status::Failed, 5));
    // counted after the end is stored, which is what was waited for
    worker.stop(Duration::from_secs(5)).await;
    assert_eq!(rig.desk.tally().leases_lost(), 5);
    assert_eq!(job.exception.unwrap().code, "crashed-repeatedly");
    let log = rig.store.job_log(id).await.unwrap();
    assert_eq!(log.iter().filter(|line| line.level == "warn").count(), 4, "{log:?}");
}

async fn a_lost_attempt_is_repeated_from_its_checkpoint(rig: Rig) {
    let id = rig.submit(json!({"message": "a", "delay_s": 600}), 5).await;
    let (_, nothing) = claim(&rig, id, "lost").await;
    assert_eq!(nothing, None);
    let late = Report { percent: 99, phase: "waiting".into(), ..Report::default() };
    assert_eq!(rig.link.beat(id, 1, &late).await.unwrap(), Verdict::Counts);
    // echo's state: the seconds that it has waited
    assert_eq!(rig.link.checkpoint(id, 1, &599.5_f64.to_le_bytes()).await.unwrap(), Verdict::Counts);
    let worker = rig.worker("heir", 1);
    let job = rig.ended(id).await;
    assert_eq!((job.status, job.attempt), (Status::Successful, 2), "{job:?}");
    worker.stop(Duration::from_secs(5)).await;
}

async fn a_dismissed_job_frees_its_slot_within_a_second(rig: Rig) {
    let worker = rig.worker("one", 1);
    let long = rig.submit(json!({"message": "long", "delay_s": 600}), 5).await;
    rig.until(long, |job| job.report.percent > 0 || !job.report.phase.is_empty()).await;
    let next = rig.submit(json!({"message": "next"}), 5).await;
    assert_eq!(rig.job(next).await.status, Status::Accepted);
    rig.desk.dismiss(long).await.unwrap();
    let (long, next) = (rig.job(long).await, rig.ended(next).await);
    assert_eq!((long.status, next.status), (Status::Dismissed, Status::Successful));
    let waited = next.started.unwrap().duration_since(long.finished.unwrap());
    assert!(waited.as_millis() <= 1000, "the slot was freed after {waited}");
    assert_eq!(rig.desk.fenced_writes(), 0, "a dismissal is no fenced write");
    assert_eq!((rig.desk.tally().dismissals(), rig.desk.tally().leases_lost()), (1, 0));
    assert!(rig.desk.dismiss(long.id).await.is_err());
    worker.stop(Duration::from_secs(5)).await;
}

async fn progress_never_falls_within_an_attempt(rig: Rig) {
    let worker = rig.worker("one", 1);
    let id = rig.submit(json!({"message": "a", "delay_s": 4}), 5).await;
    let mut seen = Vec::new();
    loop {
        let job = rig.job(id).await;
        seen.push(job.report.percent);
        if job.status.ended() {
            assert_eq!((job.status, job.report.percent), (Status::Successful, 100));
            break;
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    assert!(seen.is_sorted(), "{seen:?}");
    assert!(seen.into_iter().collect::<HashSet<u8>>().len() >= 4);
    worker.stop(Duration::from_secs(5)).await;
}

async fn nothing_is_fetched_ahead_of_free_slots(rig: Rig) {
    let first = rig.worker("first", 2);
    let mut ids = Vec::new();
    for number in 0..6 {
        ids.push(rig.submit(json!({"message": number.to_string(), "delay_s": 600}), 5).await);
    }
    let running = async |wanted: usize| {
        for _ in 0..1000 {
            let running = rig.jobs().await.into_iter().filter(|job| job.status == Status::Running).count();
            if running == wanted {
                return;
            }
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
        panic!("{wanted} jobs never ran");
    };
    running(2).await;
    // what the first had fetched ahead, the second could not have
    let second = rig.worker("second", 4);
    running(6).await;
    let by = |name: &'static str, jobs: &[Job]| jobs.iter().filter(|job| job.worker.as_deref() == Some(name)).count();
    let jobs = rig.jobs().await;
    assert_eq!((by("first", &jobs), by("second", &jobs)), (2, 4));
    assert_eq!(jobs.iter().map(|job| job.attempt).max(), Some(1));
    for id in ids {
        rig.desk.dismiss(id).await.unwrap();
    }
    first.stop(Duration::from_secs(5)).await;
    second.stop(Duration::from_secs(5)).await;
}

async fn a_worker_that_stops_gives_back_what_it_holds(rig: Rig) {
    let id = rig.submit(json!({"message": "a", "delay_s": 4}), 5).await;
    let first = rig.worker("first", 1);
    rig.until(id, |job| job.report.percent >= 40).await;
    first.stop(Duration::from_secs(10)).await;
    let given_back = rig.job(id).await;
    assert_eq!((given_back.status, given_back.attempt), (Status::Accepted, 1), "{given_back:?}");
    assert!(given_back.spent.compute_ms >= 1600);

    let second = rig.worker("second", 1);
    let mut last = 0;
    loop {
        let job = rig.job(id).await;
        if job.attempt == 2 {
            assert!(job.report.percent >= 40, "it begins where the first attempt was: {job:?}");
            assert!(job.report.percent >= last);
            last = job.report.percent;
        }
        if job.status.ended() {
            assert_eq!((job.status, job.attempt), (Status::Successful, 2));
            // both attempts together took the time of one, not of one and a half
            assert!(job.spent.compute_ms < 5600, "{}", job.spent.compute_ms);
            break;
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    second.stop(Duration::from_secs(5)).await;
}

async fn children_run_side_by_side_and_their_parent_is_put_together(rig: Rig) {
    let worker = rig.worker("four", 4);
    let parent = rig.submit(json!({"message": "a", "delay_s": 1.5, "parts": 4}), 7).await;
    let ended = rig.ended(parent).await;
    assert_eq!((ended.status, ended.attempt), (Status::Successful, 2), "split, then put together: {ended:?}");
    let results = rig.store.job_results(parent).await.unwrap().unwrap();
    assert_eq!(results["parts"], json!([{"message": "a"}, {"message": "a"}, {"message": "a"}, {"message": "a"}]));
    let children: Vec<Job> = rig.jobs().await.into_iter().filter(|job| job.parent == Some(parent)).collect();
    assert_eq!(children.iter().filter_map(|job| job.position).collect::<Vec<_>>(), [0, 1, 2, 3]);
    assert!(children.iter().all(|job| job.priority.get() == 7 && job.attempt == 1));
    // side by side: all had begun before any had ended
    let last_start = children.iter().filter_map(|job| job.started).max();
    assert!(last_start < children.iter().filter_map(|job| job.finished).min());
    worker.stop(Duration::from_secs(5)).await;
}

async fn a_lost_last_child_frees_its_parent(rig: Rig) {
    let parent = rig.submit(json!({"message": "a", "parts": 1}), 5).await;
    claim(&rig, parent, "splitter").await;
    let part = Part { process_id: "echo".into(), inputs: json!({"message": "a"}) };
    let split = Delivery::Finished(Output { split: vec![part], ..Output::default() });
    assert_eq!(rig.link.finish(parent, 1, &split, spent(0)).await.unwrap(), Verdict::Counts);
    let child = rig.jobs().await.into_iter().find(|job| job.parent == Some(parent)).unwrap();
    for _ in 0..5 {
        claim(&rig, child.id, "doomed").await;
    }
    let worker = rig.worker("next", 1);
    let ended = rig.ended(parent).await;
    assert_eq!(ended.status, Status::Failed);
    let detail = ended.exception.unwrap().detail;
    assert!(detail.starts_with("part 0 has no result: 5 attempts"), "{detail}");
    worker.stop(Duration::from_secs(5)).await;
}

async fn a_large_state_comes_back_whole(rig: Rig) {
    let id = rig.submit(json!({"message": "a"}), 5).await;
    claim(&rig, id, "lost").await;
    let state: Vec<u8> = (0..12_000_003).map(|at| (at % 251) as u8).collect();
    assert_eq!(rig.link.checkpoint(id, 1, &state).await.unwrap(), Verdict::Counts);
    let (_, resumed) = claim(&rig, id, "heir").await;
    assert!(resumed == Some(state));
}

async fn a_computation_that_stands_still_is_failed(mut rig: Rig) {
    rig.stall = Duration::from_millis(700);
    let (calls, wake) = (Arc::new(AtomicU32::new(0)), Arc::new(AtomicBool::new(false)));
    let (counted, woken) = (Arc::clone(&calls), Arc::clone(&wake));
    let worker = rig.worker_with("one", 1, move |process, payload, progress| {
        if counted.fetch_add(1, Ordering::Relaxed) > 0 {
            return process.compute(payload, progress);
        }
        while !woken.load(Ordering::Relaxed) {
            std::thread::sleep(Duration::from_millis(10));
        }
        // what it says once it goes on is of no more use, and it can hear that
        if progress.cancelled() { Err(Failure::Cancelled) } else { panic!("it was not told") }
    });
    let still = rig.submit(json!({"message": "still"}), 5).await;
    let next = rig.submit(json!({"message": "next", "delay_s": 2}), 5).await;
    let job = rig.ended(still).await;
    let exception = job.exception.unwrap();
    assert_eq!((job.status, exception.code.as_str(), job.attempt), (Status::Failed, "stalled", 1));
    // the slot goes on with other threads, and a computation that steps is left alone however long it takes
    assert_eq!(rig.ended(next).await.status, Status::Successful);
    wake.store(true, Ordering::Relaxed);
    worker.stop(Duration::from_secs(5)).await;
    assert_eq!(calls.load(Ordering::Relaxed), 2);
}

async fn a_state_on_its_way_holds_nothing_up(mut rig: Rig) {
    // a state takes longer than several leases to store
    rig.slow_states(Duration::from_secs(6));
    let stopped = Arc::new(AtomicBool::new(false));
    let stops = Arc::clone(&stopped);
    let _worker = rig.worker_with("one", 1, move |_, _, progress| {
        while !progress.cancelled() {
            progress.checkpoint(&|| vec![1]);
            std::thread::sleep(Duration::from_millis(10));
        }
        stops.store(true, Ordering::Relaxed);
        Err(Failure::Cancelled)
    });
    let long = rig.submit(json!({"message": "long"}), 5).await;
    rig.state_on_its_way().await;
    // it has nothing to do but to take over
    let _idle = rig.worker("two", 1);
    tokio::time::sleep(Duration::from_secs(4)).await;
    let job = rig.job(long).await;
    assert_eq!((job.status, job.attempt), (Status::Running, 1), "its lease is kept");
    let since = Instant::now();
    rig.desk.dismiss(long).await.unwrap();
    while !stopped.load(Ordering::Relaxed) {
        assert!(since.elapsed() < PATIENCE);
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    assert!(since.elapsed() < Duration::from_secs(1), "it stopped after {:?}", since.elapsed());
}

/// An output that begins with these bytes.
fn output_of(bytes: &[u8], pieces: Vec<String>) -> Delivery {
    let artifact = Artifact { name: "film".into(), media_type: "a/b".into(), bytes: bytes.to_vec(), pieces };
    Delivery::Finished(Output { results: json!({}), artifacts: vec![artifact], ..Output::default() })
}

/// The bytes of the only output of a job.
async fn stored_output(rig: &Rig, id: Uuid) -> Vec<u8> {
    let outputs = rig.store.job_outputs(id).await.unwrap();
    assert_eq!(outputs.len(), 1);
    rig.desk.artifacts().get(&outputs[0].sha256, 0..outputs[0].size).await.unwrap()
}

/// Waits until nothing is left of the pieces of a job that has ended.
async fn swept(rig: &Rig, id: Uuid, pieces: &[Vec<u8>]) {
    let since = Instant::now();
    while !rig.store.job_pieces(id).await.unwrap().is_empty() {
        assert!(since.elapsed() < PATIENCE);
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    for piece in pieces {
        assert!(rig.desk.artifacts().get(&digest(piece), 0..1).await.is_err(), "a piece is left");
    }
}

async fn pieces_of_a_lost_attempt_and_of_its_heir_make_one_output(rig: Rig) {
    let id = rig.submit(json!({"message": "a"}), 5).await;
    claim(&rig, id, "lost").await;
    // larger than a message
    let pieces = [vec![1; 1_500_000], vec![2; 3]];
    assert_eq!(rig.link.keep(id, 1, &pieces[0]).await.unwrap(), Verdict::Counts);
    claim(&rig, id, "heir").await;
    assert_eq!(rig.link.keep(id, 1, &[9; 9]).await.unwrap(), Verdict::Fenced);
    for _ in 0..2 {
        // an answer that was lost: it is sent again
        assert_eq!(rig.link.keep(id, 2, &pieces[1]).await.unwrap(), Verdict::Counts);
    }
    let named = pieces.iter().map(|piece| digest(piece)).collect();
    assert_eq!(rig.link.finish(id, 2, &output_of(b"head", named), spent(1)).await.unwrap(), Verdict::Counts);
    assert_eq!(rig.job(id).await.status, Status::Successful);
    assert!(stored_output(&rig, id).await == [b"head", &*pieces[0], &pieces[1]].concat());
    swept(&rig, id, &pieces).await;
    assert!(stored_output(&rig, id).await.len() == 1_500_007, "the output outlives its pieces");

    // what another job handed over, or nobody
    let other = rig.submit(json!({"message": "b"}), 5).await;
    claim(&rig, other, "thief").await;
    let delivery = output_of(b"", vec![digest(&pieces[0])]);
    assert_eq!(rig.link.finish(other, 1, &delivery, spent(1)).await.unwrap(), Verdict::Counts);
    assert_eq!(rig.job(other).await.status, Status::Failed);

    // of a dismissed job nothing stays
    let dismissed = rig.submit(json!({"message": "c"}), 5).await;
    claim(&rig, dismissed, "late").await;
    assert_eq!(rig.link.keep(dismissed, 1, &[7; 7]).await.unwrap(), Verdict::Counts);
    rig.desk.dismiss(dismissed).await.unwrap();
    assert_eq!(rig.link.keep(dismissed, 1, &[8; 8]).await.unwrap(), Verdict::Fenced);
    swept(&rig, dismissed, &[vec![7; 7], vec![8; 8]]).await;
}

async fn a_computation_hands_pieces_over_while_it_runs(rig: Rig) {
    let id = rig.submit(json!({"message": "a"}), 5).await;
    // more than may be on their way at once
    let pieces: Vec<Vec<u8>> = (0..9).map(|piece| vec![piece; 600_000]).collect();
    let made = pieces.clone();
    let worker = rig.worker_with("a", 1, move |_, _, progress| {
        let named = made.iter().map(|piece| digest(piece)).collect();
        for piece in &made {
            progress.keep(piece.clone()).expect("a worker stores pieces");
        }
        match output_of(b"head", named) {
            Delivery::Finished(output) => Ok(output),
            Delivery::Failed(_) => unreachable!(),
        }
    });
    let job = rig.ended(id).await;
    assert_eq!(job.status, Status::Successful, "{job:?}");
    assert!(stored_output(&rig, id).await == [b"head".to_vec(), pieces.concat()].concat());
    swept(&rig, id, &pieces).await;
    worker.stop(Duration::from_secs(5)).await;
}
