//! SIGTERM: nothing new, what runs is saved and given back, streams end, and so does the process.

use std::time::Duration;

use firn::{domain::job::Status, store::Store};
use reqwest::Method;
use serde_json::{Value, json};

use crate::support::{app::data_dir, binary::Serving};

const ONE_SLOT: [&str; 6] = ["--job-slots", "1", "--compute-threads", "1", "--shutdown-timeout-s", "10"];

async fn echo(server: &Serving, message: &str, delay_s: f64) -> String {
    let inputs = json!({"inputs": {"message": message, "delay_s": delay_s}});
    let job = server.call(Method::POST, "/v1/processes/echo/execution").json(&inputs).await.json(201);
    job["jobID"].as_str().unwrap().to_owned()
}

async fn until(server: &Serving, id: &str, wanted: impl Fn(&Value) -> bool) -> Value {
    for _ in 0..6000 {
        let job = server.read(&format!("/v1/jobs/{id}")).await;
        if wanted(&job) {
            return job;
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    panic!("waited too long for {id}");
}

#[tokio::test]
async fn a_signal_saves_what_runs_and_the_next_start_goes_on() {
    let data = data_dir();
    let mut server = Serving::start(data.path(), &ONE_SLOT);
    // no checkpoint of its own before the signal: the first comes after 5 s
    let running = echo(&server, "running", 6.0).await;
    let waiting = echo(&server, "waiting", 0.0).await;
    let before = until(&server, &running, |job| job["progress"].as_u64() >= Some(30)).await;
    let mut stream = server.call(Method::GET, &format!("/v1/jobs/{waiting}/events")).0.send().await.unwrap();
    let poll = server.call(Method::GET, &format!("/v1/jobs/{waiting}")).header("prefer", "wait=25");
    let poll = tokio::spawn(async move { poll.await });
    assert!(stream.chunk().await.unwrap().is_some(), "it streams");

    server.terminate();
    while stream.chunk().await.unwrap().is_some() {}
    assert_eq!(poll.await.unwrap().json(200)["status"], "accepted");
    // it says so as long as it is there
    server.call(Method::GET, "/readyz").await.problem("shutting-down");
    assert_eq!(server.call(Method::GET, "/livez").await.status, 200);
    let more = json!({"inputs": {"message": "more"}});
    server.call(Method::POST, "/v1/processes/echo/execution").json(&more).await.problem("shutting-down");
    assert_eq!(server.ended().code(), Some(0));

    let store = Store::open(data.path()).await.unwrap();
    let (saved, untouched) = (stored(&store, &running).await, stored(&store, &waiting).await);
    assert_eq!((saved.0, saved.1), (Status::Accepted, 1));
    assert_eq!((untouched.0, untouched.1), (Status::Accepted, 0), "no slot took another ticket");
    store.close().await;

    let again = Serving::start(data.path(), &ONE_SLOT);
    let resumed = until(&again, &running, |job| job["attempt"] == 2).await;
    assert!(resumed["progress"].as_u64() >= before["progress"].as_u64(), "{before} {resumed}");
    let ended = until(&again, &running, |job| job["status"] == "successful").await;
    assert_eq!(ended["attempt"], 2);
    let both_s = again.read(&format!("/v1/jobs/{running}/prov")).await["computed_seconds"].as_f64().unwrap();
    assert!(both_s < 7.5, "both attempts took {both_s} s for a job of 6 s");
    until(&again, &waiting, |job| job["status"] == "successful").await;
    let log = again.read(&format!("/v1/jobs/{running}/log")).await;
    let said: Vec<&str> =
        log["lines"].as_array().unwrap().iter().map(|line| line["message"].as_str().unwrap()).collect();
    assert_eq!(
        said,
        [
            "taken by local, from its beginning",
            "given back unfinished: its worker stops",
            "taken by local, from its last checkpoint",
        ]
    );
}

async fn stored(store: &Store, id: &str) -> (Status, u32) {
    let job = store.job(id.parse().unwrap()).await.unwrap().expect("it is kept");
    (job.status, job.attempt)
}
