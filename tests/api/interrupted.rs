//! A server that ends while it works: by a signal, and by a power cut.

use reqwest::Method;
use serde_json::{Value, json};

use crate::support::{app::data_dir, binary::Serving, data};

/// A server with a training that runs and one that waits; their ids.
async fn at_work(server: &Serving) -> (String, String) {
    server.call(Method::PUT, "/v1/stations/long").json(&json!({"name": "x"})).await.json(201);
    let csv = data::csv(&data::winters(7, 14));
    server.call(Method::POST, "/v1/stations/long/observations").body("text/csv", csv).await.json(200);
    let submit = || async {
        let inputs = json!({"inputs": {"station": "long", "label": "observed", "lead": 0}});
        // the two are the same: the second must not be answered with the result of the first
        let call = server
            .call(Method::POST, "/v1/processes/train-model/execution")
            .json(&inputs)
            .header("cache-control", "no-cache");
        call.await.json(201)["jobID"].as_str().unwrap().to_owned()
    };
    let (first, second) = (submit().await, submit().await);
    while server.read(&format!("/v1/jobs/{first}")).await["status"] != "running" {
        tokio::time::sleep(std::time::Duration::from_millis(20)).await;
    }
    (first, second)
}

/// Both go on: the one that ran is taken again, the one that waited still waits or is taken.
async fn check_going_on(server: &Serving, running: &str, waiting: &str) {
    let at = format!("/v1/jobs/{running}");
    let mut record: Value = server.read(&at).await;
    while record["attempt"].as_u64() < Some(2) {
        assert!(record["status"] == "accepted" || record["status"] == "running", "{record}");
        tokio::time::sleep(std::time::Duration::from_millis(20)).await;
        record = server.read(&at).await;
    }
    assert!(record["exception"].is_null(), "{record}");
    let other = server.read(&format!("/v1/jobs/{waiting}")).await;
    assert_eq!((&other["status"], &other["attempt"]), (&json!("accepted"), &json!(0)), "{other}");
    for job in [waiting, running] {
        server.call(Method::DELETE, &format!("/v1/jobs/{job}")).await.json(200);
    }
}

const ONE_AT_A_TIME: [&str; 4] = ["--job-slots", "1", "--compute-threads", "1"];

#[tokio::test]
async fn jobs_of_a_killed_server_go_on_at_the_next_start() {
    let data = data_dir();
    let mut server = Serving::start(data.path(), &ONE_AT_A_TIME);
    let (running, waiting) = at_work(&server).await;
    server.kill();

    let again = Serving::start(data.path(), &ONE_AT_A_TIME);
    check_going_on(&again, &running, &waiting).await;
    // what was told to be stored is stored
    let days = again.read("/v1/stations/long/observations?limit=10000").await;
    assert_eq!(days["observations"].as_array().unwrap().len(), data::winters(7, 14).len());
    assert_eq!(again.read("/v1/models").await["models"], json!([]));
}

#[tokio::test]
async fn a_signal_ends_the_server_in_time_and_its_jobs_go_on() {
    let data = data_dir();
    let arguments = [&ONE_AT_A_TIME[..], &["--shutdown-timeout-s", "10"]].concat();
    let mut server = Serving::start(data.path(), &arguments);
    let (running, waiting) = at_work(&server).await;
    server.terminate();
    assert_eq!(server.ended().code(), Some(0));

    let again = Serving::start(data.path(), &arguments);
    check_going_on(&again, &running, &waiting).await;
}
