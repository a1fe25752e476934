//! Everything is killed at random instants, and nothing is lost. `FIRN_CHAOS=full` runs the full number of jobs and kills.

use std::{
    collections::{BTreeMap, BTreeSet},
    time::{Duration, Instant},
};

use reqwest::Method;
use serde_json::{Value, json};

use crate::{
    lost_workers::{echo, ended, server, worker},
    processes::PATIENCE,
    support::{app::data_dir, binary::Serving},
};

/// Jobs and kills.
fn size() -> (usize, usize) {
    if std::env::var("FIRN_CHAOS").is_ok_and(|size| size == "full") { (200, 20) } else { (60, 6) }
}

fn some_time(most_ms: u64) -> Duration {
    Duration::from_millis(rand::random_range(150..most_ms))
}

const SETTINGS: [&str; 4] = ["--job-slots", "2", "--compute-threads", "2"];

/// Sends one execution a key at once; gives the ids of those that were answered.
async fn submit(server: &Serving, keys: &BTreeSet<usize>) -> tokio::task::JoinSet<Option<(usize, String)>> {
    let mut answers = tokio::task::JoinSet::new();
    for &key in keys {
        let inputs = json!({"inputs": {"message": key.to_string(), "delay_s": 0.25}});
        let request =
            server.call(Method::POST, "/v1/processes/echo/execution").header("idempotency-key", &key.to_string());
        let request = request.json(&inputs).0;
        answers.spawn(async move {
            let answer = request.send().await.ok()?;
            let status = answer.status().as_u16();
            let job: Value = answer.json().await.ok()?;
            assert_eq!(status, 201, "{job}");
            Some((key, job["jobID"].as_str()?.to_owned()))
        });
    }
    answers
}

#[tokio::test]
async fn a_server_that_is_killed_at_random_instants_does_every_job_once() {
    let (jobs, kills) = size();
    let data = data_dir();
    let mut accepted: BTreeMap<usize, String> = BTreeMap::new();
    let mut unanswered = BTreeSet::new();
    for kill in 0..kills {
        let mut server = Serving::start(data.path(), &SETTINGS);
        unanswered.extend(jobs * kill / kills..jobs * (kill + 1) / kills);
        let answers = submit(&server, &unanswered).await;
        tokio::time::sleep(some_time(1800)).await;
        server.kill();
        accepted.extend(answers.join_all().await.into_iter().flatten());
        unanswered.retain(|key| !accepted.contains_key(key));
    }

    let server = Serving::start(data.path(), &SETTINGS);
    // who got no answer asks again with the same key, and so does who got one
    let everybody: BTreeSet<usize> = (0..jobs).collect();
    for (key, id) in submit(&server, &everybody).await.join_all().await.into_iter().flatten() {
        assert_eq!(*accepted.entry(key).or_insert_with(|| id.clone()), id, "a key made two jobs");
    }
    assert_eq!(accepted.len(), jobs);
    let since = Instant::now();
    while !open_jobs(&server).await.is_empty() {
        assert!(since.elapsed() < 2 * PATIENCE, "jobs do not end");
        tokio::time::sleep(Duration::from_millis(200)).await;
    }
    let list = server.read("/v1/jobs?limit=1000").await["jobs"].as_array().unwrap().clone();
    assert_eq!(list.len(), jobs);
    let mut lost = 0;
    for (key, id) in &accepted {
        let job = list.iter().find(|job| job["jobID"] == **id).expect("it is listed");
        assert_eq!(job["status"], "successful", "{job}");
        assert_eq!(server.read(&format!("/v1/jobs/{id}/results")).await, json!({"message": key.to_string()}));
        let events = server.call(Method::GET, &format!("/v1/jobs/{id}/events")).await.text();
        assert_eq!(events.matches(r#""status":"successful""#).count(), 1, "{events}");
        lost += job["attempt"].as_u64().unwrap() - 1;
    }
    println!("{jobs} jobs, {kills} kills, {lost} attempts lost");
    assert!(lost > 0, "no kill hit a running job: the test showed nothing");
    assert!(lost <= 2 * kills as u64, "a kill can cost no more than what the two slots held");
}

async fn open_jobs(server: &Serving) -> Vec<Value> {
    server.read("/v1/jobs?status=accepted,running&limit=1000").await["jobs"].as_array().unwrap().clone()
}

#[tokio::test]
async fn a_kill_costs_at_most_ten_seconds_of_computing() {
    const DELAY_S: f64 = 16.0;
    let data = data_dir();
    let mut server = Serving::start(data.path(), &SETTINGS);
    let inputs = json!({"inputs": {"message": "long", "delay_s": DELAY_S}});
    let job = server.call(Method::POST, "/v1/processes/echo/execution").json(&inputs).await.json(201);
    let at = format!("/v1/jobs/{}", job["jobID"].as_str().unwrap());
    let done_s = |job: &Value| job["progress"].as_f64().unwrap() / 100.0 * DELAY_S;
    // so late that a start from the beginning would lose more than ten seconds, and well after a state was saved
    let mut before = server.read(&at).await;
    while done_s(&before) < 11.0 {
        tokio::time::sleep(Duration::from_millis(50)).await;
        before = server.read(&at).await;
    }
    server.kill();
    let server = Serving::start(data.path(), &SETTINGS);
    let mut after = server.read(&at).await;
    while after["attempt"] != 2 || after["progress"] == 0 {
        assert_ne!(after["attempt"], 3);
        tokio::time::sleep(Duration::from_millis(20)).await;
        after = server.read(&at).await;
    }
    let lost_s = done_s(&before) - done_s(&after);
    assert!(lost_s <= 10.0, "{lost_s} s were lost");
    while after["status"] == "running" {
        tokio::time::sleep(Duration::from_millis(50)).await;
        after = server.read(&at).await;
    }
    assert_eq!((&after["status"], &after["attempt"]), (&json!("successful"), &json!(2)));
    // the lost attempt counts up to its last sign of life, and what was lost of it was computed twice
    let provenance = server.read(&format!("{at}/prov")).await;
    let twice_s = provenance["computed_seconds"].as_f64().unwrap() - DELAY_S;
    assert!((1.0..=10.0).contains(&twice_s), "{twice_s} s were computed twice");
}

#[tokio::test]
async fn a_nats_server_that_is_killed_and_wiped_loses_no_job() {
    let Some((mut nats, app)) = server().await else { return };
    let _workers = [worker(&nats, "a", 2), worker(&nats, "b", 2)];
    let mut jobs = Vec::new();
    for kill in 0..5 {
        for number in 0..12 {
            jobs.push(echo(&app, json!({"message": format!("{kill} {number}"), "delay_s": 0.4})).await);
        }
        tokio::time::sleep(some_time(800)).await;
        nats.kill_and_restart(kill == 2);
    }
    for job in &jobs {
        let job = ended(&app, job).await;
        assert_eq!(job["status"], "successful", "{job}");
        let at = format!("/v1/jobs/{}", job["jobID"].as_str().unwrap());
        let events = app.get(&format!("{at}/events")).await.text();
        assert_eq!(events.matches(r#""status":"successful""#).count(), 1, "{events}");
    }
    assert_eq!(app.get("/readyz").await.status, 200);
}
