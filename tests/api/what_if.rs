//! Why a forecast says what it says, and what it would say if the day were otherwise.

use serde_json::{Value, json};

use crate::support::trained::trained;

const FORECASTS: &str = "/v1/stations/synthetic/forecasts";

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("no number: {value}"))
}

#[tokio::test]
async fn an_explanation_adds_up_to_the_forecast() {
    let app = &trained().await.app;
    let forecast = app.read(&format!("{FORECASTS}/2014-01-15")).await;
    let explanation = app.read(&format!("{FORECASTS}/2014-01-15/explanation")).await;
    assert_eq!(explanation["decision_value"], forecast["decision_value"]);
    assert_eq!(explanation["model_id"], forecast["model_id"]);
    assert_eq!((&explanation["synthetic"], &explanation["lead"]), (&json!(true), &json!(0)));
    let parts = explanation["contributions"].as_array().unwrap();
    assert_eq!(parts.len(), 64);
    let sum: f64 = parts.iter().map(|part| number(&part["contribution"])).sum();
    assert!((number(&explanation["base"]) + sum - number(&forecast["decision_value"])).abs() < 1e-9);
    assert!(explanation["method"].as_str().unwrap().contains("integrated gradients"));
    for (list, names) in [("imputed", "imputed"), ("out_of_range", "out_of_range")] {
        let told: Vec<&Value> = explanation[list].as_array().unwrap().iter().map(|entry| &entry["feature"]).collect();
        assert_eq!(json!(told), forecast["inputs"][names]);
    }
    app.get(&format!("{FORECASTS}/2014-07-01/explanation")).await.problem("no-observation");
}

#[tokio::test]
async fn similar_days_come_with_their_avalanches() {
    let app = &trained().await.app;
    let answer = app.read(&format!("{FORECASTS}/2014-01-15/similar-days?limit=20")).await;
    let days = answer["similar_days"].as_array().unwrap();
    assert_eq!(days.len(), 20);
    for day in days {
        let recorded = app.read(&format!("/v1/stations/synthetic/avalanches/{}", day["date"].as_str().unwrap())).await;
        assert_eq!(day["avalanches"]["activity"], recorded["activity"], "{day}");
        assert_eq!(day["label"] == true, recorded["activity"] == "observed", "{day}");
    }
}

#[tokio::test]
async fn a_what_if_changes_the_forecast_and_nothing_else() {
    let app = &trained().await.app;
    let rows = app.rows().await;
    let ask = |body: Value| app.post(&format!("{FORECASTS}/what-if")).json(&body);
    let same = ask(json!({"date": "2014-01-15"})).await.json(200);
    let forecast = app.read(&format!("{FORECASTS}/2014-01-15")).await;
    assert_eq!((&same["as_observed"], &same["changed"]), (&forecast, &forecast));
    assert_eq!((&same["difference"], &same["response"]), (&json!(0.0), &Value::Null));

    let storm = json!({"new_snow_index": 10, "snow_drift": true, "foot_penetration": 60, "wind_speed": 25});
    let changes = json!([
        {"values": storm}, {"date": "2014-01-14", "values": storm, "avalanche_activity": "observed"},
    ]);
    let stormy = ask(json!({"date": "2014-01-15", "changes": changes})).await.json(200);
    assert!(number(&stormy["difference"]) > 0.1, "{stormy}");
    let difference = number(&stormy["changed"]["probability"]) - number(&forecast["probability"]);
    assert_eq!(number(&stormy["difference"]), difference);

    // a value that is made missing is imputed, and says so
    let blind = ask(json!({"date": "2014-01-15", "changes": [{"values": {"air_temperature": null}}]})).await.json(200);
    assert!(blind["changed"]["inputs"]["missing"].as_array().unwrap().contains(&json!("air_temperature")));

    // weather of a day that nobody observed
    let made = ask(json!({"date": "2014-07-01", "changes": [{"values": {"air_temperature": 12}}]})).await.json(200);
    assert_eq!((&made["as_observed"], &made["difference"]), (&Value::Null, &Value::Null));
    ask(json!({"date": "2014-07-01"})).await.problem("no-observation");
    assert_eq!(app.rows().await, rows, "nothing is stored");
}

#[tokio::test]
async fn a_response_curve_follows_one_variable() {
    let app = &trained().await.app;
    let ask = |body: Value| app.post(&format!("{FORECASTS}/what-if")).json(&body);
    let response = json!({"variable": "air_temperature", "from": -10, "to": 5, "points": 16});
    let answer = ask(json!({"date": "2014-01-15", "response": response})).await.json(200);
    let curve = &answer["response"];
    assert_eq!((&curve["variable"], &curve["unit"]), (&json!("air_temperature"), &json!("degC")));
    let points = curve["points"].as_array().unwrap();
    assert_eq!(
        points.iter().map(|point| number(&point["value"])).collect::<Vec<_>>(),
        (-10..=5).map(f64::from).collect::<Vec<_>>()
    );
    // each point is the what-if of that value
    let one = ask(json!({"date": "2014-01-15", "changes": [{"values": {"air_temperature": -3}}]})).await.json(200);
    assert_eq!(points[7]["probability"], one["changed"]["probability"]);
    // without ends: the range of the training; true or false has two points; an index takes whole steps
    let range = ask(json!({"date": "2014-01-15", "response": {"variable": "wind_speed"}})).await.json(200);
    assert_eq!(range["response"]["points"].as_array().unwrap().len(), 25);
    let drift = ask(json!({"date": "2014-01-15", "response": {"variable": "snow_drift"}})).await.json(200);
    assert_eq!(drift["response"]["points"].as_array().unwrap().len(), 2);
}

#[tokio::test]
async fn a_what_if_at_fault_is_pointed_at() {
    let app = &trained().await.app;
    let ask = |body: Value| app.post(&format!("{FORECASTS}/what-if")).json(&body);
    let of = |values: Value| json!({"date": "2014-01-15", "changes": [{"values": values}]});
    let response = |body: Value| json!({"date": "2014-01-15", "response": body});
    let cases = [
        (of(json!({"temperature": 3})), "/changes/0/values/temperature"),
        (of(json!({"air_temperature": 300})), "/changes/0/values/air_temperature"),
        (of(json!({"air_temperature": "warm"})), "/changes/0/values/air_temperature"),
        (of(json!({"snow_drift": 1})), "/changes/0/values/snow_drift"),
        (json!({"date": "2014-01-15", "changes": [{}, {}]}), "/changes/1/date"),
        (response(json!({"variable": "wind"})), "/response/variable"),
        (response(json!({"variable": "wind_speed", "points": 1})), "/response/points"),
        (response(json!({"variable": "wind_speed", "from": -1})), "/response/from"),
        (response(json!({"variable": "wind_speed", "from": 5, "to": 5})), "/response/to"),
        (response(json!({"variable": "snow_height", "to": 5})), "/response/from"),
        (json!({"date": "2014-02-30"}), "/date"),
        (json!({"date": "2014-01-15", "lead": 2}), "/lead"),
        (json!({}), "/date"),
    ];
    for (body, pointer) in cases {
        assert_eq!(ask(body.clone()).await.pointers("invalid-body"), [pointer], "{body}");
    }
    let other = ask(json!({"date": "2014-01-15", "lead": 1})).await;
    other.problem("no-active-model");
}
