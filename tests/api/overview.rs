//! The forecast of every station in one answer.

use serde_json::{Value, json};

use crate::support::{TestApp, data, trained::train};

#[tokio::test]
async fn every_station_is_in_the_list_with_its_forecast_or_the_reason_why_there_is_none() {
    let app = TestApp::start().await;
    app.station("a").await.import_csv("a", &data::csv(&data::winters(3, 3))).await.json(200);
    let inputs = json!({"station": "a", "label": "observed", "lead": 0, "kernel": "linear", "feature_set": "raw-30"});
    train(&app, &inputs).await;
    app.put("/v1/stations/b", &json!({"name": "B", "latitude": 56.8, "altitude_m": 900})).await.json(201);
    app.station("c").await;
    let list = app.read("/v1/forecasts").await;
    let all = list["forecasts"].as_array().unwrap();
    assert_eq!(all.len(), 3);
    assert_eq!(all[0]["forecast"], app.read("/v1/stations/a/forecasts/latest").await);
    assert_eq!(all[0]["missing"], Value::Null);
    assert_eq!((&all[1]["forecast"], &all[1]["altitude_m"]), (&Value::Null, &json!(900.0)));
    assert_eq!(all[1]["missing"]["code"], "no-active-model");
    let day = app.read("/v1/forecasts?date=2013-01-10").await;
    assert_eq!(day["forecasts"][0]["forecast"], app.read("/v1/stations/a/forecasts/2013-01-10").await);
    let summer = app.read("/v1/forecasts?date=2013-08-10").await;
    assert_eq!(summer["forecasts"][0]["missing"]["code"], "no-observation");

    let page = app.get("/v1/forecasts?limit=2&date=2013-01-10").await;
    assert!(
        page.header("link").contains("/v1/forecasts?lead=0&date=2013-01-10&limit=2&cursor=b"),
        "{}",
        page.header("link")
    );
    assert_eq!(page.json(200)["next"], "b");
    let rest = app.read("/v1/forecasts?limit=2&cursor=b").await;
    assert_eq!((&rest["forecasts"][0]["station"], &rest["next"]), (&json!("c"), &Value::Null));
    for (query, pointer) in
        [("date=2013-02-30", "/date"), ("lead=2", "/lead"), ("weather=forecast", "/weather"), ("limit=0", "/limit")]
    {
        assert_eq!(app.get(&format!("/v1/forecasts?{query}")).await.pointers("invalid-parameter"), [pointer]);
    }
}
