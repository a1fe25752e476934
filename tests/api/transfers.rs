//! A model at a place that it was not trained at.

use serde_json::{Value, json};

use crate::support::{
    TestApp, data,
    trained::{id, train, until},
};

const EXECUTION: &str = "/v1/processes/evaluate-transfer/execution";

async fn evaluated(app: &TestApp, inputs: Value) -> Value {
    let job = app.post(EXECUTION).json(&json!({"inputs": inputs})).await.json(201);
    let ended = until(app, id(&job), |job| !matches!(job["status"].as_str(), Some("accepted" | "running"))).await;
    assert_eq!(ended["status"], "successful", "{ended}");
    app.read(&format!("/v1/jobs/{}/results", id(&job))).await
}

#[tokio::test]
async fn a_model_is_scored_at_another_station() {
    let app = TestApp::start().await;
    app.station("home").await.import_csv("home", &data::csv(&data::winters(3, 3))).await.json(200);
    let away = data::csv(&data::winters(4, 4));
    app.station("away").await.import_csv("away", &away).await.json(200);
    // a station that does not report foot penetration
    let body = json!({"name": "Poorer", "variables": ["air_temperature", "wind_speed", "new_snow_index"]});
    app.put("/v1/stations/poorer", &body).await.json(201);
    let head: Vec<&str> = away.lines().next().unwrap().split(',').collect();
    let kept: Vec<usize> = (0..head.len())
        .filter(|&at| {
            ["date", "air_temperature", "wind_speed", "new_snow_index"].contains(&head[at])
                || head[at].starts_with("avalanche")
        })
        .collect();
    let narrow = |line: &str| {
        let fields: Vec<&str> = line.split(',').collect();
        kept.iter().map(|&at| fields[at]).collect::<Vec<_>>().join(",")
    };
    let poorer: Vec<String> = away.lines().map(narrow).collect();
    app.import_csv("poorer", &(poorer.join("\n") + "\n")).await.json(200);
    let inputs =
        json!({"station": "home", "label": "observed", "lead": 0, "kernel": "linear", "feature_set": "raw-30"});
    let job = train(&app, &inputs).await;
    let results = app.read(&format!("/v1/jobs/{}/results", id(&job))).await;
    let model = results["model_id"].as_str().unwrap();

    let there = evaluated(&app, json!({"model": model, "station": "away"})).await;
    assert_eq!((&there["model_id"], &there["station"]), (&json!(model), &json!("away")));
    assert_eq!(there["seasons"], json!([2011, 2012, 2013, 2014]));
    for name in ["svm", "climatology", "persistence", "knn10", "knn30", "logistic"] {
        for score in ["auc", "brier", "brier_skill", "pss", "hss"] {
            assert!(there["scores"][name][score].is_number(), "{name} {score}: {}", there["scores"]);
        }
    }
    assert_eq!(there["scores"]["climatology"]["brier_skill"], 0.0);
    assert!(there["bootstrap"]["models"]["svm"]["auc"]["lower"].is_number());
    assert_eq!((&there["not_reported"], &there["left_out"]), (&json!([]), &json!([])));
    let days: u64 = there["per_season"].as_array().unwrap().iter().map(|season| season["days"].as_u64().unwrap()).sum();
    assert_eq!(there["days"], days);
    // a forecast of the model there, counted by hand: warned where the probability reaches the threshold
    let table = &there["scores"]["svm"]["contingency"];
    let warned = table["a"].as_u64().unwrap() + table["b"].as_u64().unwrap();
    assert!(warned > 0 && warned < days, "{table}");

    let poorer = evaluated(&app, json!({"model": model, "station": "poorer"})).await;
    let missing: Vec<&str> = poorer["not_reported"].as_array().unwrap().iter().map(|v| v.as_str().unwrap()).collect();
    assert!(missing.contains(&"foot_penetration") && !missing.contains(&"wind_speed"), "{missing:?}");
    let warnings = poorer["drift"]["warnings"].to_string();
    assert!(warnings.contains("foot_penetration is not reported at the target"), "{warnings}");

    // listed at the model, newest first
    let list = app.read(&format!("/v1/models/{model}/transfers?limit=1")).await;
    assert_eq!(list["transfers"][0]["station"], "poorer");
    let cursor = list["next"].as_str().unwrap();
    let rest = app.read(&format!("/v1/models/{model}/transfers?cursor={cursor}")).await;
    assert_eq!((rest["transfers"].as_array().unwrap().len(), &rest["next"]), (1, &Value::Null));
    assert_eq!(rest["transfers"][0]["scores"], there["scores"]);

    // the same again is not computed again; the seasons that it was trained on are no test of it
    let again = app.post(EXECUTION).json(&json!({"inputs": {"model": model, "station": "away"}})).await;
    assert_eq!(again.json(201)["reused"], true);
    let home = app.post(EXECUTION).json(&json!({"inputs": {"model": model, "station": "home"}})).await;
    assert_eq!(home.pointers("training-window"), ["/inputs/from"]);
    let narrow = json!({"model": model, "station": "away", "from": "2014-07-01", "to": "2015-06-30"});
    let one = evaluated(&app, narrow).await;
    assert_eq!((&one["seasons"], &one["bootstrap"]), (&json!([2014]), &Value::Null));
    assert_eq!((&one["scores"]["climatology"], &one["scores"]["svm"]["brier_skill"]), (&Value::Null, &Value::Null));
}

#[tokio::test]
async fn what_cannot_be_scored_is_refused_without_a_job() {
    let app = TestApp::start().await;
    app.station("a").await;
    let nobody = "00000000-0000-7000-8000-000000000000";
    let before = app.rows().await;
    let refused = async |inputs: Value| {
        let answer = app.post(EXECUTION).json(&json!({"inputs": inputs})).await;
        answer.pointers("invalid-inputs")
    };
    assert_eq!(refused(json!({"model": nobody, "station": "a"})).await, ["/inputs/model"]);
    assert_eq!(refused(json!({"model": "x", "station": "a"})).await, ["/inputs/model"]);
    assert_eq!(refused(json!({"station": "a"})).await, ["/inputs/model"]);
    let backwards = json!({"model": nobody, "station": "a", "from": "2020-01-02", "to": "2020-01-01"});
    assert_eq!(refused(backwards).await, ["/inputs/to"]);
    assert_eq!(app.rows().await, before);
}
