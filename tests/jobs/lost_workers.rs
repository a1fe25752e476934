//! Worker processes that are killed, frozen and asked to end, beside a server with NATS.

use std::time::{Duration, Instant};

use firn::config::EngineAddress;
use reqwest::Method;
use serde_json::{Value, json};

use crate::{
    processes::{NatsServer, PATIENCE, WorkerProcess},
    support::{
        TestApp,
        app::data_dir,
        binary::Serving,
        trained::{id, until},
    },
};

const LEASE_S: u64 = 2;

/// A server over a NATS server of its own; none where the machine has none.
pub async fn server() -> Option<(NatsServer, TestApp)> {
    let nats = NatsServer::start()?;
    let url = nats.url();
    let app = TestApp::with(|config| {
        config.engine = EngineAddress::Nats(url);
        config.lease = Duration::from_secs(LEASE_S);
    });
    Some((nats, app.await))
}

pub fn worker(nats: &NatsServer, name: &str, slots: usize) -> WorkerProcess {
    WorkerProcess::start(&nats.url(), name, slots)
}

/// Has an echo accepted and gives its id.
pub async fn echo(app: &TestApp, inputs: Value) -> String {
    let job = app.post("/v1/processes/echo/execution").json(&json!({"inputs": inputs})).await.json(201);
    id(&job).to_owned()
}

pub async fn ended(app: &TestApp, id: &str) -> Value {
    until(app, id, |job| !matches!(job["status"].as_str(), Some("accepted" | "running"))).await
}

#[tokio::test]
async fn killed_workers_lose_no_job() {
    let Some((nats, app)) = server().await else { return };
    let mut workers = [worker(&nats, "a", 2), worker(&nats, "b", 2)];
    let mut jobs = Vec::new();
    for number in 0..24 {
        jobs.push(echo(&app, json!({"message": number.to_string(), "delay_s": 0.5})).await);
    }
    for round in 0..4 {
        tokio::time::sleep(Duration::from_millis(rand::random_range(300..900))).await;
        workers[round % 2].kill();
        workers[round % 2] = worker(&nats, &format!("again-{round}"), 2);
    }
    let mut attempts = 0;
    for (number, job) in jobs.iter().enumerate() {
        let job = ended(&app, job).await;
        assert_eq!(job["status"], "successful", "{job}");
        let attempt = job["attempt"].as_u64().unwrap();
        assert!(attempt <= 5, "{job}");
        attempts += attempt;
        let results = app.read(&format!("/v1/jobs/{}/results", id(&job))).await;
        assert_eq!(results["message"], number.to_string());
    }
    assert!(attempts > 24, "no kill hit a running job: the test showed nothing");
}

#[tokio::test]
async fn a_worker_frozen_past_its_lease_is_fenced() {
    let Some((nats, app)) = server().await else { return };
    let zombie = worker(&nats, "zombie", 1);
    let job = echo(&app, json!({"message": "a", "delay_s": 4})).await;
    until(&app, &job, |job| job["progress"].as_u64() > Some(0)).await;
    zombie.signal("STOP");
    let _heir = worker(&nats, "heir", 1);
    until(&app, &job, |job| job["attempt"] == 2).await;
    zombie.signal("CONT");

    let ended = ended(&app, &job).await;
    assert_eq!((&ended["status"], &ended["attempt"]), (&json!("successful"), &json!(2)));
    assert_eq!(app.read(&format!("/v1/jobs/{job}/prov")).await["worker"], "heir");
    // the first thing that the zombie said was refused, and it gave up
    let since = Instant::now();
    while app.state.desk.fenced_writes() == 0 {
        assert!(since.elapsed() < Duration::from_secs(30), "nothing was refused:\n{}", zombie.log());
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    let events = app.get(&format!("/v1/jobs/{job}/events")).await.text();
    assert_eq!(events.matches(r#""status":"successful""#).count(), 1, "{events}");
    // and it works on
    let next: Vec<String> = [
        echo(&app, json!({"message": "x", "delay_s": 2})).await,
        echo(&app, json!({"message": "y", "delay_s": 2})).await,
    ]
    .into();
    let mut hands = Vec::new();
    for job in next {
        self::ended(&app, &job).await;
        hands.push(app.read(&format!("/v1/jobs/{job}/prov")).await["worker"].as_str().unwrap().to_owned());
    }
    hands.sort();
    assert_eq!(hands, ["heir", "zombie"]);
}

#[tokio::test]
async fn a_worker_that_is_asked_to_end_gives_its_job_back_at_once() {
    let Some((nats, app)) = server().await else { return };
    let mut first = worker(&nats, "first", 1);
    let job = echo(&app, json!({"message": "a", "delay_s": 5})).await;
    until(&app, &job, |job| job["progress"].as_u64() >= Some(30)).await;
    first.signal("TERM");
    assert_eq!(first.ended(), Some(0), "{}", first.log());
    let given_back = app.read(&format!("/v1/jobs/{job}")).await;
    assert_eq!((&given_back["status"], &given_back["attempt"]), (&json!("accepted"), &json!(1)));
    let _second = worker(&nats, "second", 1);
    let resumed = until(&app, &job, |job| job["attempt"] == 2).await;
    assert!(resumed["progress"].as_u64() >= Some(30), "{resumed}");
    assert_eq!(ended(&app, &job).await["status"], "successful");
}

#[tokio::test]
async fn workers_outlive_a_killed_server_and_deliver_to_the_next() {
    let Some(nats) = NatsServer::start() else { return };
    let (data, url) = (data_dir(), nats.url());
    let arguments = ["--engine", &url, "--lease-s", "10"];
    let mut server = Serving::start(data.path(), &arguments);
    let worker = WorkerProcess::start(&url, "afar", 1);
    let inputs = json!({"inputs": {"message": "a", "delay_s": 3, "attachment_bytes": 2_000_000}});
    let job = server.call(Method::POST, "/v1/processes/echo/execution").json(&inputs).await.json(201);
    let at = format!("/v1/jobs/{}", id(&job));
    while server.read(&at).await["progress"] == 0 {
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    server.kill();
    // the job ends while nobody listens
    tokio::time::sleep(Duration::from_secs(4)).await;
    let server = Serving::start(data.path(), &arguments);
    let mut job = server.read(&at).await;
    let since = Instant::now();
    while job["status"] == "running" {
        assert!(since.elapsed() < PATIENCE, "it is not delivered:\n{}", worker.log());
        tokio::time::sleep(Duration::from_millis(50)).await;
        job = server.read(&at).await;
    }
    assert_eq!((&job["status"], &job["attempt"]), (&json!("successful"), &json!(1)), "nothing was computed twice");
    // more than a message of NATS can hold came in parts, and came whole
    let attachment = server.call(Method::GET, &format!("{at}/results/attachment")).await;
    assert!(attachment.body.iter().enumerate().all(|(at, byte)| *byte == (at % 251) as u8));
    assert_eq!(attachment.body.len(), 2_000_000);
}

#[tokio::test]
async fn a_new_lease_reaches_the_queues_that_are_there() {
    let Some(nats) = NatsServer::start() else { return };
    // it is there before any server, and hears of the lease from the one that comes
    let mut first = worker(&nats, "first", 1);
    let (data, url) = (data_dir(), nats.url());
    let mut server = Serving::start(data.path(), &["--engine", &url, "--lease-s", "600"]);
    assert_eq!(leases_s(&url).await, [600; 10]);
    server.terminate();
    assert!(server.ended().success());

    let server = Serving::start(data.path(), &["--engine", &url, "--lease-s", "2"]);
    assert_eq!(leases_s(&url).await, [2; 10]);
    let inputs = json!({"inputs": {"message": "a", "delay_s": 4}});
    let job = server.call(Method::POST, "/v1/processes/echo/execution").json(&inputs).await.json(201);
    let at = format!("/v1/jobs/{}", id(&job));
    let since = Instant::now();
    while server.read(&at).await["status"] != "running" {
        assert!(since.elapsed() < PATIENCE, "nobody takes it:\n{}", first.log());
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    first.kill();
    let _second = worker(&nats, "second", 1);
    let since = Instant::now();
    while server.read(&at).await["attempt"] != 2 {
        assert!(since.elapsed() < PATIENCE, "its ticket does not come back");
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
}

/// The leases that the queues have, s.
async fn leases_s(url: &str) -> Vec<u64> {
    let context = async_nats::jetstream::new(async_nats::connect(url).await.unwrap());
    let stream = context.get_stream("FIRN_TICKETS").await.unwrap();
    let mut leases = Vec::new();
    for priority in 0..10 {
        leases.push(stream.consumer_info(format!("priority-{priority}")).await.unwrap().config.ack_wait.as_secs());
    }
    leases
}
