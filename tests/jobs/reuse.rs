//! What was computed before is not computed again.

use serde_json::{Value, json};

use crate::support::{
    TestApp,
    app::beside_the_servers,
    data,
    trained::{id, train, until},
};

#[tokio::test]
async fn the_same_training_on_the_same_days_is_done_once() {
    let app = TestApp::start().await;
    let store = app.state.store.clone();
    beside_the_servers(data::synthetic(store, "synthetic", data::winters(7, 4))).await;
    let inputs = json!({"station": "synthetic", "label": "observed", "lead": 0});
    let first = train(&app, &inputs).await;
    assert_eq!(first["reused"], false);

    let ask = async |inputs: &Value, cache: &str| {
        let call = app.post("/v1/processes/train-model/execution").header("cache-control", cache);
        let answer = call.json(&json!({"inputs": inputs})).await;
        let job = answer.json(201);
        assert_eq!(answer.header("location"), format!("/v1/jobs/{}", id(&job)));
        if job["reused"] == false {
            app.delete(answer.header("location")).await.json(200);
        }
        job
    };
    // defaults that are written out are the same inputs
    let written_out = json!({"station": "synthetic", "label": "observed", "lead": 0, "kernel": "gaussian", "seed": 0});
    for inputs in [&inputs, &written_out] {
        let again = ask(inputs, "max-age=0").await;
        assert_eq!((&again["reused"], &again["jobID"]), (&json!(true), &first["jobID"]));
        assert_eq!(again["status"], "successful");
    }
    assert_eq!(app.read("/v1/models").await["models"].as_array().unwrap().len(), 1);

    // a key is bound to what it was first sent with, also where no new job was made
    let with_key = async |inputs: &Value| {
        let call = app.post("/v1/processes/train-model/execution").header("idempotency-key", "reused");
        call.json(&json!({"inputs": inputs})).await
    };
    let answer = with_key(&inputs).await.json(201);
    assert_eq!((&answer["reused"], &answer["jobID"]), (&json!(true), &first["jobID"]));
    assert_eq!(with_key(&inputs).await.json(201), answer);
    with_key(&written_out).await.problem("idempotency-key-reused");
    app.post("/v1/processes/echo/execution")
        .header("idempotency-key", "reused")
        .json(&json!({"inputs": {"message": "a"}}))
        .await
        .problem("idempotency-key-reused");

    assert_eq!(ask(&inputs, "no-cache").await["reused"], false);
    let other_seed = json!({"station": "synthetic", "label": "observed", "lead": 0, "seed": 1});
    assert_eq!(ask(&other_seed, "max-age=0").await["reused"], false);
    // other days are another content under the same name
    let day = app.read("/v1/stations/synthetic/observations?limit=1").await["observations"][0]["date"].clone();
    let path = format!("/v1/stations/synthetic/observations/{}", day.as_str().unwrap());
    assert!(app.put(&path, &json!({"air_temperature": -12.5})).await.status < 300);
    assert_eq!(ask(&inputs, "max-age=0").await["reused"], false);
}

/// What was edited while a job waited is what it computes from: it is found again by that, and not by what it was
/// accepted with.
#[tokio::test]
async fn a_job_is_found_again_by_the_days_that_it_read() {
    let app = TestApp::start().await;
    let store = app.state.store.clone();
    beside_the_servers(data::synthetic(store.clone(), "synthetic", data::winters(7, 4))).await;
    let inputs = json!({"inputs": {"station": "synthetic", "label": "observed", "lead": 0}});
    let slots: Vec<String> = {
        let mut ids = Vec::new();
        for _ in 0..app.state.config.job_slots {
            let body = json!({"inputs": {"message": "in the way", "delay_s": 600}});
            let job = app.post("/v1/processes/echo/execution").json(&body).await.json(201);
            ids.push(id(&job).to_owned());
        }
        ids
    };
    for slot in &slots {
        let running = app.get(&format!("/v1/jobs/{slot}")).header("prefer", "wait=20").await;
        assert_ne!(running.json(200)["status"], "successful");
    }
    let waiting = app.post("/v1/processes/train-model/execution").json(&inputs).await.json(201);
    let accepted = app.read(&format!("/v1/jobs/{}/prov", id(&waiting))).await["input_hash"].clone();

    let day = app.read("/v1/stations/synthetic/observations?limit=1").await["observations"][0].clone();
    let path = format!("/v1/stations/synthetic/observations/{}", day["date"].as_str().unwrap());
    let before = day["air_temperature"].clone();
    assert!(app.put(&path, &json!({"air_temperature": -12.5})).await.status < 300);
    for slot in &slots {
        app.delete(&format!("/v1/jobs/{slot}")).await.json(200);
    }
    until(&app, id(&waiting), |job| job["status"] == "successful").await;
    let computed = app.read(&format!("/v1/jobs/{}/prov", id(&waiting))).await["input_hash"].clone();
    assert_ne!(computed, accepted);
    let results = app.read(&format!("/v1/jobs/{}/results", id(&waiting))).await;
    assert_eq!(results["provenance"]["input_hash"], computed);

    // the same inputs on the same days as then
    let again = app.post("/v1/processes/train-model/execution").json(&inputs).await.json(201);
    assert_eq!((&again["reused"], &again["jobID"]), (&json!(true), &waiting["jobID"]));
    // and on the days as they were before
    assert_ne!(before, json!(-12.5));
    let mut restored = day.as_object().unwrap().clone();
    restored.retain(|name, value| name == "air_temperature" || (!value.is_null() && name.contains("wind")));
    assert!(app.put(&path, &Value::Object(restored)).await.status < 300);
    let other = app.post("/v1/processes/train-model/execution").json(&inputs).await.json(201);
    assert_eq!(other["reused"], false);
    app.delete(&format!("/v1/jobs/{}", id(&other))).await.json(200);
}

#[tokio::test]
async fn echo_is_always_computed_anew() {
    let app = TestApp::start().await;
    let ask = async || {
        let call = app.post("/v1/processes/echo/execution").json(&json!({"inputs": {"message": "a"}}));
        let job = call.header("prefer", "wait=20").await.json(201);
        assert_eq!((&job["status"], &job["reused"]), (&json!("successful"), &json!(false)));
        id(&job).to_owned()
    };
    assert_ne!(ask().await, ask().await);
}
