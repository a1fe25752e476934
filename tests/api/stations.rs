//! Somebody sets a station up.

use insta::assert_json_snapshot;
use serde_json::{Value, json};

use crate::support::TestApp;

fn lochaber() -> Value {
    json!({"name": "Lochaber", "latitude": 56.8, "longitude": -5.0, "altitude_m": 900, "timezone": "Europe/London",
           "variables": ["air_temperature", "wind_speed"]})
}

#[tokio::test]
async fn a_station_is_made_and_read() {
    let app = TestApp::start().await;
    let made = app.put("/v1/stations/lochaber", &lochaber()).await;
    assert_eq!(made.header("location"), "/v1/stations/lochaber");
    assert_eq!(made.header("etag"), "\"1\"");
    let body = made.json(201);
    assert_json_snapshot!(body, {".created" => "[instant]", ".updated" => "[instant]"}, @r#"
    {
      "id": "lochaber",
      "name": "Lochaber",
      "latitude": 56.8,
      "longitude": -5.0,
      "altitude_m": 900.0,
      "timezone": "Europe/London",
      "eaws_region": null,
      "variables": [
        "air_temperature",
        "wind_speed"
      ],
      "retrain": null,
      "synthetic": false,
      "revision": 1,
      "created": "[instant]",
      "updated": "[instant]"
    }
    "#);
    assert_eq!(app.read("/v1/stations/lochaber").await, body);
}

#[tokio::test]
async fn all_but_the_name_may_be_left_out() {
    let app = TestApp::start().await;
    let body = app.put("/v1/stations/a", &json!({"name": "A"})).await.json(201);
    assert_json_snapshot!(body, {".created" => "[instant]", ".updated" => "[instant]"}, @r#"
    {
      "id": "a",
      "name": "A",
      "latitude": null,
      "longitude": null,
      "altitude_m": null,
      "timezone": null,
      "eaws_region": null,
      "variables": null,
      "retrain": null,
      "synthetic": false,
      "revision": 1,
      "created": "[instant]",
      "updated": "[instant]"
    }
    "#);
}

#[tokio::test]
async fn the_same_again_changes_nothing_and_another_body_replaces_it() {
    let app = TestApp::start().await;
    let first = app.put("/v1/stations/lochaber", &lochaber()).await.json(201);
    let again = app.put("/v1/stations/lochaber", &lochaber()).await;
    assert_eq!(again.header("etag"), "\"1\"");
    assert_eq!(again.json(200), first);

    let renamed = app.put("/v1/stations/lochaber", &json!({"name": "Ben Nevis range"})).await;
    assert_eq!(renamed.header("etag"), "\"2\"");
    let renamed = renamed.json(200);
    assert_eq!(renamed["name"], "Ben Nevis range");
    // a PUT replaces: what it leaves out is gone
    assert_eq!((&renamed["latitude"], &renamed["variables"]), (&Value::Null, &Value::Null));
    assert_eq!((&renamed["revision"], &renamed["created"]), (&json!(2), &first["created"]));
}

#[tokio::test]
async fn two_editors_do_not_overwrite_each_other() {
    let app = TestApp::start().await;
    let seen = app.put("/v1/stations/lochaber", &lochaber()).await;
    let tag = seen.header("etag").to_owned();
    let theirs = json!({"name": "theirs"});
    app.put("/v1/stations/lochaber", &theirs).header("if-match", &tag).await.json(200);
    let mine = app.put("/v1/stations/lochaber", &json!({"name": "mine"})).header("if-match", &tag).await;
    mine.problem("precondition-failed");
    assert_eq!(app.read("/v1/stations/lochaber").await["name"], "theirs");
    // If-Match on what is not there would make what nobody has seen
    let absent = app.put("/v1/stations/absent", &theirs).header("if-match", "*").await;
    absent.problem("precondition-failed");
    app.get("/v1/stations/absent").await.problem("unknown-station");
}

#[tokio::test]
async fn if_none_match_star_only_makes_new_stations() {
    let app = TestApp::start().await;
    let make = || app.put("/v1/stations/lochaber", &json!({"name": "once"})).header("if-none-match", "*");
    make().await.json(201);
    make().await.problem("precondition-failed");
    assert_eq!(app.read("/v1/stations/lochaber").await["revision"], 1);
}

#[tokio::test]
async fn a_reader_who_has_it_already_is_told_so() {
    let app = TestApp::start().await;
    app.put("/v1/stations/lochaber", &lochaber()).await.json(201);
    for path in ["/v1/stations/lochaber", "/v1/stations", "/v1", "/v1/processes", "/v1/feature-sets"] {
        let tag = app.get(path).await.header("etag").to_owned();
        let again = app.get(path).header("if-none-match", &tag).await;
        assert_eq!((again.status, again.body.len()), (304, 0), "{path}");
        assert_eq!(again.header("etag"), tag, "{path}");
        assert_eq!(app.get(path).header("if-none-match", "\"another\"").await.status, 200, "{path}");
    }
}

#[tokio::test]
async fn the_list_is_paged_in_the_order_of_names() {
    let app = TestApp::start().await;
    for name in ["c", "a", "d", "b", "e"] {
        app.station(name).await;
    }
    let mut path = Some("/v1/stations?limit=2".to_owned());
    let mut pages = Vec::new();
    while let Some(at) = path {
        let answer = app.get(&at).await;
        let page = answer.json(200);
        let ids: Vec<Value> =
            page["stations"].as_array().unwrap().iter().map(|station| station["id"].clone()).collect();
        pages.push(ids);
        path = answer.headers.get("link").map(|link| {
            let link = link.to_str().unwrap();
            link.strip_prefix('<')
                .and_then(|link| link.strip_suffix(">; rel=\"next\""))
                .expect("a next link")
                .to_owned()
        });
        assert_eq!(path.is_none(), page["next"].is_null(), "the body and the header agree");
    }
    assert_eq!(json!(pages), json!([["a", "b"], ["c", "d"], ["e"]]));
}

#[tokio::test]
async fn a_bad_station_is_refused_with_all_that_is_wrong() {
    let app = TestApp::start().await;
    let before = app.rows().await;
    let body = json!({"latitude": 91, "altitude_m": "high", "variables": ["air_temperature", "snow"], "owner": "x"});
    let refused = app.put("/v1/stations/lochaber", &body).await;
    let mut pointers = refused.pointers("invalid-body");
    pointers.sort();
    assert_eq!(pointers, ["/altitude_m", "/latitude", "/name", "/owner", "/variables/1"]);

    let zone = app.put("/v1/stations/lochaber", &json!({"name": "x", "timezone": "Europe/Atlantis"})).await;
    assert_json_snapshot!(zone.problem("invalid-body"), {".traceId" => "[id]"}, @r#"
    {
      "type": "/problems/invalid-body",
      "title": "The body has unacceptable values",
      "status": 422,
      "detail": "/timezone must be a name of the IANA time zone database, such as Europe/London",
      "code": "invalid-body",
      "errors": [
        {
          "pointer": "/timezone",
          "detail": "must be a name of the IANA time zone database, such as Europe/London",
          "code": "invalid_value"
        }
      ],
      "traceId": "[id]"
    }
    "#);

    for name in ["_a", "a%20b", "a.b", "%C3%A9", &"x".repeat(65)] {
        let refused = app.put(&format!("/v1/stations/{name}"), &json!({"name": "x"})).await;
        assert_eq!(refused.pointers("invalid-parameter"), ["/station"], "{name}");
    }
    for name in ["", "a\u{7}b", &"x".repeat(201)] {
        let refused = app.put("/v1/stations/lochaber", &json!({"name": name})).await;
        assert_eq!(refused.pointers("invalid-body"), ["/name"], "{name:?}");
    }
    assert_eq!(app.rows().await, before);
}

#[tokio::test]
async fn a_station_named_like_another_in_capitals_is_another() {
    let app = TestApp::start().await;
    app.station("lochaber").await.station("Lochaber").await;
    let ids: Vec<Value> =
        app.read("/v1/stations").await["stations"].as_array().unwrap().iter().map(|s| s["id"].clone()).collect();
    assert_eq!(json!(ids), json!(["Lochaber", "lochaber"]));
}

#[tokio::test]
async fn variables_named_twice_are_refused() {
    let app = TestApp::start().await;
    let body = json!({"name": "x", "variables": ["wind_speed", "wind_speed"]});
    assert_eq!(app.put("/v1/stations/a", &body).await.pointers("invalid-body"), ["/variables"]);
}
