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
        let call = server.call(Method::POST, "/v1/processes/train-model/execution").json(&inputs);
        call.await.json(201)["jobID"].as_str().unwrap().to_owned()
    };
    let (first, second) = (submit().await, submit().await);
    while server.read(&format!("/v1/jobs/{first}")).await["status"] != "running" {
        tokio::time::sleep(std::time::Duration::from_millis(20)).await;
    }
    (first, second)
}

async fn check_interrupted(server: &Serving, job: &str) {
    let record: Value = server.read(&format!("/v1/jobs/{job}")).await;
    assert_eq!(
        (&record["status"], &record["exception"]["code"]),
        (&json!("failed"), &json!("interrupted")),
        "{record}"
    );
    assert!(record["finished"].is_string(), "{record}");
    let results = server.call(Method::GET, &format!("/v1/jobs/{job}/results")).await;
    results.problem("interrupted");
}

const ONE_AT_A_TIME: [&str; 4] = ["--job-slots", "1", "--compute-threads", "1"];

#[tokio::test]
async fn jobs_of_a_killed_server_are_failed_at_the_next_start() {
    let data = data_dir();
    let mut server = Serving::start(data.path(), &ONE_AT_A_TIME);
    let (running, waiting) = at_work(&server).await;
    server.kill();

    let again = Serving::start(data.path(), &ONE_AT_A_TIME);
    check_interrupted(&again, &running).await;
    check_interrupted(&again, &waiting).await;
    // what was told to be stored is stored
    let days = again.read("/v1/stations/long/observations?limit=10000").await;
    assert_eq!(days["observations"].as_array().unwrap().len(), data::winters(7, 14).len());
    assert_eq!(again.read("/v1/models").await["models"], json!([]));
}

#[tokio::test]
async fn a_signal_ends_the_server_in_time_and_its_jobs_with_a_reason() {
    let data = data_dir();
    let arguments = [&ONE_AT_A_TIME[..], &["--shutdown-timeout-s", "10"]].concat();
    let mut server = Serving::start(data.path(), &arguments);
    let (running, waiting) = at_work(&server).await;
    server.terminate();
    assert_eq!(server.ended().code(), Some(0));

    let again = Serving::start(data.path(), &arguments);
    check_interrupted(&again, &running).await;
    check_interrupted(&again, &waiting).await;
}
