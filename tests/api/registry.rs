//! Which model speaks, who said so, and the way back.

use firn::{clock, store::keys::Role};
use insta::assert_json_snapshot;
use serde_json::{Value, json};

use crate::support::{
    TestApp,
    app::beside_the_servers,
    data,
    trained::{id, train},
};

const ACTIVE: &str = "/v1/stations/a/active-model";
const ROLL_BACK: &str = "/v1/stations/a/active-model/rollback";

/// A station with so many models.
async fn with_models(count: u64) -> (TestApp, Vec<String>) {
    let app = TestApp::start().await;
    app.station("a").await.import_csv("a", &data::csv(&data::winters(3, 3))).await.json(200);
    let mut models = Vec::new();
    for seed in 0..count {
        let inputs = json!({"station": "a", "label": "presumed", "lead": 0, "kernel": "linear", "feature_set": "raw-30",
                            "seed": seed});
        let job = train(&app, &inputs).await;
        let results = app.read(&format!("/v1/jobs/{}/results", id(&job))).await;
        models.push(results["model_id"].as_str().unwrap().to_owned());
    }
    (app, models)
}

#[tokio::test]
async fn a_roll_back_goes_back_step_by_step() {
    let (app, models) = with_models(3).await;
    let active = async || app.read(ACTIVE).await["model_id"].as_str().unwrap().to_owned();
    let back = async |body: Value| app.post(ROLL_BACK).json(&body).await;
    // the first model has none before it
    back(json!({})).await.problem("no-earlier-model");
    for model in [&models[1], &models[2]] {
        app.put(ACTIVE, &json!({"model_id": model, "reason": "newer"})).await.json(200);
    }
    let gone = back(json!({"reason": "false alarms"})).await.json(200);
    assert_eq!((&gone["model_id"], &gone["reason"]), (&json!(models[1]), &json!("false alarms")));
    assert_eq!(active().await, models[1]);
    back(json!({})).await.json(200);
    assert_eq!(active().await, models[0]);
    back(json!({})).await.problem("no-earlier-model");
    // after a roll-back another model may be tried, and taken back to where it was tried
    app.put(ACTIVE, &json!({"model_id": models[2]})).await.json(200);
    assert_eq!(back(json!({})).await.json(200)["model_id"], models[0]);
    // a roll-back of what somebody else has changed meanwhile is stopped
    let before = app.get(ACTIVE).await;
    app.put(ACTIVE, &json!({"model_id": models[1]})).await.json(200);
    let stale = app.post(ROLL_BACK).json(&json!({})).header("if-match", before.header("etag")).await;
    stale.problem("precondition-failed");
    assert_eq!(active().await, models[1]);
    let long = json!({"reason": "x".repeat(2001)});
    assert_eq!(back(long.clone()).await.pointers("invalid-body"), ["/reason"]);
    // the other lead has its own history
    app.post(&format!("{ROLL_BACK}?lead=1")).json(&json!({})).await.problem("no-earlier-model");

    let log = app.read(&format!("/v1/audit?target={ACTIVE}")).await;
    let told: Vec<(&str, Option<usize>, Option<usize>)> = log["entries"]
        .as_array()
        .unwrap()
        .iter()
        .map(|entry| {
            let of = |part: &str| models.iter().position(|model| entry[part]["model_id"] == json!(model));
            (entry["action"].as_str().unwrap(), of("before"), of("after"))
        })
        .collect();
    let (activated, back) = ("model_activated", "model_rolled_back");
    let expected = [
        (activated, Some(0), Some(1)),
        (back, Some(2), Some(0)),
        (activated, Some(0), Some(2)),
        (back, Some(1), Some(0)),
        (back, Some(2), Some(1)),
        (activated, Some(1), Some(2)),
        (activated, Some(0), Some(1)),
        (activated, None, Some(0)),
    ];
    assert_eq!(told, expected);
}

#[tokio::test]
async fn the_audit_says_who_did_what_and_why() {
    let data = crate::support::app::data_dir();
    let app = TestApp::on(data, |config| config.allow_anonymous = true).await;
    let store = app.state.store.clone();
    let [operator, forecaster] = beside_the_servers(async move {
        let now = clock::now();
        let operator = store.create_key("olga", Role::Operator, None, now).await.unwrap();
        let forecaster = store.create_key("fred", Role::Forecaster, None, now).await.unwrap();
        [operator, forecaster]
    })
    .await;
    app.put("/v1/stations/a", &json!({"name": "A"})).key(&forecaster).await.json(201);
    app.put("/v1/stations/a", &json!({"name": "A"})).key(&forecaster).await.json(200);
    app.put("/v1/stations/a", &json!({"name": "B"})).key(&forecaster).header("x-request-id", "trace-7").await.json(200);
    // what a region is is for the operator to say
    let region = json!({"name": "R", "stations": ["a"]});
    app.put("/v1/regions/r", &region).key(&forecaster).await.problem("forbidden");
    app.put("/v1/regions/r", &region).key(&operator).await.json(201);
    app.get("/v1/audit").key(&forecaster).await.problem("forbidden");
    let id = forecaster.split('_').nth(1).unwrap().to_owned();
    let store = app.state.store.clone();
    let revoked = id.clone();
    assert!(beside_the_servers(async move { store.revoke_key(&revoked, clock::now()).await.unwrap() }).await);

    let log = app.get("/v1/audit").key(&operator).await.json(200);
    let actions: Vec<&str> =
        log["entries"].as_array().unwrap().iter().map(|entry| entry["action"].as_str().unwrap()).collect();
    let expected =
        ["key_revoked", "region_created", "station_changed", "station_created", "key_created", "key_created"];
    assert_eq!(actions, expected, "what was refused or changed nothing is not there");
    assert_eq!(log["entries"][0]["target"], format!("key:{id}"));
    assert_json_snapshot!(log["entries"][2], {".id" => "[id]", ".at" => "[instant]"}, @r#"
    {
      "id": "[id]",
      "at": "[instant]",
      "who": "fred",
      "action": "station_changed",
      "target": "/v1/stations/a",
      "reason": null,
      "before": {
        "name": "A",
        "latitude": null,
        "longitude": null,
        "altitude_m": null,
        "timezone": null,
        "eaws_region": null,
        "variables": null,
        "retrain": null
      },
      "after": {
        "name": "B",
        "latitude": null,
        "longitude": null,
        "altitude_m": null,
        "timezone": null,
        "eaws_region": null,
        "variables": null,
        "retrain": null
      },
      "trace_id": "trace-7"
    }
    "#);
    assert!(!log.to_string().contains(forecaster.rsplit('_').next().unwrap()), "no secret is in the audit");

    // page by page, and by what was done to what
    let page = app.get("/v1/audit?limit=2&action=key_created").key(&operator).await;
    assert!(page.headers.get("link").is_none());
    assert_eq!(page.json(200)["next"], Value::Null);
    let page = app.get("/v1/audit?limit=4").key(&operator).await;
    assert!(page.header("link").starts_with("</v1/audit?limit=4&cursor="), "{page:?}");
    let cursor = page.json(200)["next"].as_i64().unwrap();
    let rest = app.get(&format!("/v1/audit?limit=4&cursor={cursor}")).key(&operator).await.json(200);
    assert_eq!(rest["entries"].as_array().unwrap().len(), 2);
}
