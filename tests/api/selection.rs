//! How many features it takes: from the days to a model that was trained with the answer.

use serde_json::{Value, json};

use crate::support::{
    TestApp, data,
    trained::{id, train, trained, until},
};

const EXECUTION: &str = "/v1/processes/select-features/execution";

async fn selected(app: &TestApp, inputs: &Value) -> Value {
    let job = app.post(EXECUTION).json(&json!({"inputs": inputs})).await.json(201);
    let ended = until(app, id(&job), |job| !matches!(job["status"].as_str(), Some("accepted" | "running"))).await;
    assert_eq!(ended["status"], "successful", "{ended}");
    ended
}

async fn refused(app: &TestApp, process: &str, inputs: Value) -> Vec<String> {
    let answer = app.post(&format!("/v1/processes/{process}/execution")).json(&json!({"inputs": inputs})).await;
    answer.pointers("invalid-inputs")
}

#[tokio::test]
async fn a_selection_ends_in_a_model_that_keeps_its_curve() {
    let app = TestApp::start().await;
    app.station("a").await.station("b").await;
    for station in ["a", "b"] {
        app.import_csv(station, &data::csv(&data::winters(3, 4))).await.json(200);
    }
    let task = json!({"station": "a", "label": "observed", "lead": 0, "feature_set": "raw-30"});
    let job = selected(&app, &task).await;
    let results = app.read(&format!("/v1/jobs/{}/results", id(&job))).await;
    let curve = results["curve"].as_array().unwrap();
    assert_eq!(curve.len(), 30);
    assert!(curve.iter().zip(1..).all(|(point, size)| point["features"] == size), "{curve:?}");
    let proposed = results["proposed"].as_u64().unwrap();
    assert!(proposed >= 1 && proposed <= results["best"].as_u64().unwrap());
    assert_eq!((results["days"].as_u64(), &results["station"]), (Some(496), &json!("a")));
    let picture = &results["picture"];
    assert_eq!(picture["type"], "image/svg+xml");
    let svg = app.get(picture["href"].as_str().unwrap()).await;
    assert_eq!(svg.header("content-type"), "image/svg+xml");
    assert!(svg.text().contains("best"), "{}", svg.text());

    // as many features as proposed, unless told otherwise
    let with = |name: &str, value: Value| {
        let mut inputs = task.clone();
        inputs["selection"] = json!(id(&job));
        inputs[name] = value;
        inputs
    };
    for (inputs, count) in [(with("seed", json!(1)), proposed), (with("feature_count", json!(7)), 7)] {
        let trained = train(&app, &inputs).await;
        let model =
            app.read(&format!("/v1/jobs/{}/results", id(&trained))).await["model_id"].as_str().unwrap().to_owned();
        let document = app.read(&format!("/v1/models/{model}")).await;
        assert_eq!(document["training"]["features"], count);
        assert_eq!(document["training"]["feature_choice"], "eliminated");
        assert!(document["links"].as_array().unwrap().iter().any(|link| link["rel"] == "selection"));
        let selection = app.read(&format!("/v1/models/{model}/selection")).await;
        assert_eq!((&selection["curve"], &selection["job"]), (&results["curve"], &json!(id(&job))));
        let mut used: Vec<String> = serde_json::from_value(selection["used"].clone()).unwrap();
        let ranking = selection["ranking"].as_array().unwrap().iter().take(used.len());
        let mut first: Vec<String> = ranking.map(|entry| entry["feature"].as_str().unwrap().to_owned()).collect();
        used.sort();
        first.sort();
        assert_eq!(used, first, "the ranking on all seasons is the one that the final model follows");
        let features = app.read(&format!("/v1/models/{model}/features")).await;
        assert_eq!(features["features"].as_array().unwrap().len() as u64, count);
        let svg = app.get(&format!("/v1/models/{model}/selection")).header("accept", "image/svg+xml").await;
        assert!(svg.text().starts_with("<svg ") && svg.text().contains("of the model"), "{}", svg.text());
        let png = app.get(&format!("/v1/models/{model}/selection")).header("accept", "image/png").await;
        assert_eq!((png.status, png.header("content-type")), (200, "image/png"));
        let neither = app.get(&format!("/v1/models/{model}/selection")).header("accept", "image/gif").await;
        neither.problem("not-acceptable");
    }
    // a selection of another task
    for (name, value) in [("station", "b"), ("label", "presumed"), ("feature_set", "expert")] {
        assert_eq!(refused(&app, "train-model", with(name, json!(value))).await, ["/inputs/selection"], "{name}");
    }
    // the job may go, what it found stays
    assert!(matches!(app.delete(&format!("/v1/jobs/{}", id(&job))).await.status, 200..=204));
    let again = train(&app, &with("seed", json!(2))).await;
    assert_eq!(again["status"], "successful");
}

#[tokio::test]
async fn what_cannot_be_selected_or_named_is_pointed_at() {
    let trained = trained().await;
    let app = &trained.app;
    let task = json!({"station": "synthetic", "label": "observed", "lead": 0});
    let with = |name: &str, value: Value| {
        let mut inputs = task.clone();
        inputs[name] = value;
        inputs
    };
    for (name, value) in [
        ("lead", json!(2)),
        ("label", json!("seen")),
        ("kernel", json!("gaussian")),
        ("station", json!("absent")),
        ("feature_set", json!("all")),
    ] {
        assert_eq!(refused(app, "select-features", with(name, value)).await, [format!("/inputs/{name}")]);
    }
    let mut backwards = with("from", json!("2013-01-01"));
    backwards["to"] = json!("2012-01-01");
    assert_eq!(refused(app, "select-features", backwards).await, ["/inputs/to"]);
    let narrow = with("to", json!("2012-06-30"));
    app.post(EXECUTION).json(&json!({"inputs": narrow})).await.problem("training-window");

    let unknown = json!("00000000-0000-7000-8000-000000000000");
    for (name, value) in [
        ("selection", unknown),
        ("selection", trained.job["jobID"].clone()),
        ("feature_count", json!(0)),
        ("feature_count", json!(65)),
        ("features", json!([])),
        ("features", json!(["snow_drift_t", "snow_drift_t"])),
        ("features", json!(["snow_drift_t", "nothing"])),
    ] {
        assert_eq!(
            refused(app, "train-model", with(name, value.clone())).await,
            [format!("/inputs/{name}")],
            "{value}"
        );
    }
    let mut both = with("features", json!(["snow_drift_t"]));
    both["feature_count"] = json!(1);
    assert_eq!(refused(app, "train-model", both).await, ["/inputs/features"]);
    let mut linear = with("feature_count", json!(5));
    linear["kernel"] = json!("linear");
    assert_eq!(refused(app, "train-model", linear).await, ["/inputs/kernel"]);
    let without = app.get(&format!("/v1/models/{}/selection", trained.model_id())).await;
    without.problem("no-selection");
}
