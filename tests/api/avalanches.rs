//! What avalanches came down is often known days after the weather.

use insta::assert_json_snapshot;
use serde_json::{Value, json};

use crate::support::TestApp;

const WEATHER: &str = "/v1/stations/lochaber/observations/2007-02-14";
const AVALANCHES: &str = "/v1/stations/lochaber/avalanches/2007-02-14";

#[tokio::test]
async fn a_later_report_keeps_the_weather() {
    let app = TestApp::start().await;
    app.station("lochaber").await;
    app.put(WEATHER, &json!({"air_temperature": -3.5})).await.json(201);
    app.get(AVALANCHES).await.problem("no-avalanche-record");

    let report = json!({"activity": "observed", "count": 3, "type": "wet", "trigger": "natural", "size": 2.5});
    let made = app.put(AVALANCHES, &report).await;
    assert_eq!(made.header("etag"), "\"1\"");
    let record = made.json(201);
    assert_json_snapshot!(record, {".updated" => "[instant]"}, @r#"
    {
      "station": "lochaber",
      "date": "2007-02-14",
      "activity": "observed",
      "count": 3,
      "type": "wet",
      "trigger": "natural",
      "size": 2.5,
      "synthetic": false,
      "revision": 1,
      "updated": "[instant]"
    }
    "#);
    assert_eq!(app.read(AVALANCHES).await, record);

    let day = app.read(WEATHER).await;
    assert_eq!((&day["air_temperature"], &day["revision"]), (&json!(-3.5), &json!(1)));
    assert_eq!((&day["avalanche_activity"], &day["avalanche_size"]), (&json!("observed"), &json!(2.5)));
}

#[tokio::test]
async fn a_correction_keeps_what_was_said_before() {
    let app = TestApp::start().await;
    app.station("lochaber").await;
    app.put(AVALANCHES, &json!({"activity": "unknown"})).await.json(201);
    let tag = app.get(AVALANCHES).await.header("etag").to_owned();
    app.put(AVALANCHES, &json!({"activity": "unknown"})).await.json(200);
    app.put(AVALANCHES, &json!({"activity": "none"})).header("if-match", &tag).await.json(200);
    let late = app.put(AVALANCHES, &json!({"activity": "observed"})).header("if-match", &tag).await;
    late.problem("precondition-failed");
    let revisions = app.read(&format!("{AVALANCHES}/revisions")).await;
    let said: Vec<&Value> = revisions["revisions"].as_array().unwrap().iter().map(|r| &r["body"]["activity"]).collect();
    assert_eq!(json!(said), json!(["unknown", "none"]));
    // nothing was said of the weather, and so there is no history of it
    app.get(&format!("{WEATHER}/revisions")).await.problem("no-observation");
}

#[tokio::test]
async fn what_cannot_be_is_refused_and_nothing_is_stored() {
    let app = TestApp::start().await;
    app.station("lochaber").await;
    let before = app.rows().await;
    let cases = [
        (json!({}), "/activity"),
        (json!({"activity": "perhaps"}), "/activity"),
        (json!({"activity": "observed", "count": -1}), "/count"),
        (json!({"activity": "observed", "count": 1.5}), "/count"),
        (json!({"activity": "observed", "size": 2.25}), "/size"),
        (json!({"activity": "observed", "type": "powder"}), "/type"),
        (json!({"activity": "none", "count": 3}), "/count"),
        (json!({"activity": "none", "trigger": "natural"}), "/trigger"),
    ];
    for (body, pointer) in cases {
        assert_eq!(app.put(AVALANCHES, &body).await.pointers("invalid-body"), [pointer], "{body}");
    }
    let unknown = app.put("/v1/stations/absent/avalanches/2007-02-14", &json!({"activity": "none"})).await;
    unknown.problem("unknown-station");
    assert_eq!(app.rows().await, before);
}
