//! A forecaster records days one by one, corrects them, and reads them back.

use std::future::IntoFuture;

use firn::store::keys::Role;
use insta::assert_json_snapshot;
use serde_json::{Value, json};

use crate::support::{TestApp, app::beside_the_servers};

const DAY: &str = "/v1/stations/lochaber/observations/2007-02-14";

fn day() -> Value {
    json!({"air_temperature": -3.5, "wind_speed": 12, "new_snow_index": 6, "snow_drift": true, "rain_at_900m": false,
           "avalanche_activity": "observed", "avalanche_count": 2, "avalanche_type": "dry"})
}

async fn lochaber() -> TestApp {
    let app = TestApp::start().await;
    app.station("lochaber").await;
    app
}

fn dates(list: &Value) -> Vec<&str> {
    let days = list["observations"].as_array().expect("a list");
    days.iter().map(|day| day["date"].as_str().expect("a date")).collect()
}

#[tokio::test]
async fn a_day_is_recorded_and_read() {
    let app = lochaber().await;
    let made = app.put(DAY, &day()).await;
    assert_eq!(made.header("location"), DAY);
    assert_eq!(made.header("etag"), "\"1.1\"");
    let body = made.json(201);
    assert_json_snapshot!(body, {".updated" => "[instant]"}, @r#"
    {
      "station": "lochaber",
      "date": "2007-02-14",
      "air_temperature": -3.5,
      "wind_speed": 12.0,
      "wind_direction": null,
      "cloud_cover": null,
      "snow_height": null,
      "new_snow_24h": null,
      "new_snow_index": 6.0,
      "precipitation_24h": null,
      "rain_at_900m": false,
      "snow_drift": true,
      "foot_penetration": null,
      "snow_temperature": null,
      "insolation_index": null,
      "cumulative_snow_index": null,
      "avalanche_activity": "observed",
      "avalanche_count": 2,
      "avalanche_type": "dry",
      "avalanche_trigger": null,
      "avalanche_size": null,
      "forecast": false,
      "synthetic": false,
      "revision": 1,
      "avalanche_revision": 1,
      "updated": "[instant]"
    }
    "#);
    assert_eq!(app.read(DAY).await, body);
}

#[tokio::test]
async fn the_same_again_makes_no_revision() {
    let app = lochaber().await;
    let first = app.put(DAY, &day()).await.json(201);
    let rows = app.rows().await;
    assert_eq!(app.put(DAY, &day()).await.json(200), first);
    assert_eq!(app.rows().await, rows);
    let revisions = app.read(&format!("{DAY}/revisions")).await;
    assert_eq!(revisions["revisions"].as_array().unwrap().len(), 1);
}

#[tokio::test]
async fn revisions_keep_who_wrote_what_and_when() {
    let app = lochaber().await;
    let store = app.state.store.clone();
    let key = beside_the_servers(async move {
        store.create_key("anna", Role::Forecaster, None, firn::clock::now()).await.unwrap()
    })
    .await;
    app.put(DAY, &json!({"air_temperature": -3.5})).key(&key).await.json(201);
    app.put(DAY, &json!({"air_temperature": -2.5, "avalanche_activity": "none"})).await.json(200);

    let revisions = app.read(&format!("{DAY}/revisions")).await;
    assert_json_snapshot!(revisions, {".revisions[].recorded" => "[instant]"}, @r#"
    {
      "revisions": [
        {
          "revision": 1,
          "recorded": "[instant]",
          "recorded_by": "anna",
          "source": "put",
          "body": {
            "air_temperature": -3.5,
            "wind_speed": null,
            "wind_direction": null,
            "cloud_cover": null,
            "snow_height": null,
            "new_snow_24h": null,
            "new_snow_index": null,
            "precipitation_24h": null,
            "rain_at_900m": null,
            "snow_drift": null,
            "foot_penetration": null,
            "snow_temperature": null,
            "insolation_index": null,
            "cumulative_snow_index": null,
            "avalanche_activity": null,
            "avalanche_count": null,
            "avalanche_type": null,
            "avalanche_trigger": null,
            "avalanche_size": null,
            "forecast": false
          }
        },
        {
          "revision": 2,
          "recorded": "[instant]",
          "recorded_by": null,
          "source": "put",
          "body": {
            "air_temperature": -2.5,
            "wind_speed": null,
            "wind_direction": null,
            "cloud_cover": null,
            "snow_height": null,
            "new_snow_24h": null,
            "new_snow_index": null,
            "precipitation_24h": null,
            "rain_at_900m": null,
            "snow_drift": null,
            "foot_penetration": null,
            "snow_temperature": null,
            "insolation_index": null,
            "cumulative_snow_index": null,
            "avalanche_activity": null,
            "avalanche_count": null,
            "avalanche_type": null,
            "avalanche_trigger": null,
            "avalanche_size": null,
            "forecast": false
          }
        }
      ]
    }
    "#);
    let stamp =
        |revision: &Value| revision["recorded"].as_str().unwrap().parse::<jiff::Timestamp>().expect("an instant");
    let stamps: Vec<_> = revisions["revisions"].as_array().unwrap().iter().map(stamp).collect();
    assert!(stamps.is_sorted(), "{stamps:?}");
}

#[tokio::test]
async fn a_day_is_replaced_as_a_whole_but_its_avalanches_stay_unless_named() {
    let app = lochaber().await;
    app.put(DAY, &day()).await.json(201);
    let after = app.put(DAY, &json!({"snow_height": 120})).await.json(200);
    assert_eq!((&after["snow_height"], &after["air_temperature"]), (&json!(120.0), &Value::Null));
    assert_eq!((&after["avalanche_activity"], &after["avalanche_count"]), (&json!("observed"), &json!(2)));
    assert_eq!((&after["revision"], &after["avalanche_revision"]), (&json!(2), &json!(1)));
}

#[tokio::test]
async fn null_is_not_zero() {
    let app = lochaber().await;
    let body = json!({"new_snow_index": 0, "cloud_cover": null, "rain_at_900m": false});
    let day = app.put(DAY, &body).await.json(201);
    assert_eq!(day["new_snow_index"], 0.0);
    assert_eq!(day["rain_at_900m"], false);
    for missing in ["cloud_cover", "snow_drift", "air_temperature", "avalanche_activity", "avalanche_count"] {
        assert!(day.as_object().unwrap().contains_key(missing), "{missing}");
        assert_eq!(day[missing], Value::Null, "{missing}");
    }
    let csv = app.get("/v1/stations/lochaber/observations").header("accept", "text/csv").await.text();
    let row = csv.lines().nth(1).unwrap();
    assert!(row.starts_with("2007-02-14,,,,,,,0,,false,,"), "{row}");
}

#[tokio::test]
async fn unknown_is_not_none_and_neither_is_nothing() {
    let app = lochaber().await;
    let put = |date: &str, body: Value| app.put(&format!("/v1/stations/lochaber/observations/{date}"), &body);
    put("2007-02-01", json!({"air_temperature": 0})).await.json(201);
    put("2007-02-02", json!({"avalanche_activity": "unknown"})).await.json(201);
    put("2007-02-03", json!({"avalanche_activity": "none"})).await.json(201);
    let list = app.read("/v1/stations/lochaber/observations").await;
    let activity: Vec<&Value> =
        list["observations"].as_array().unwrap().iter().map(|day| &day["avalanche_activity"]).collect();
    assert_eq!(json!(activity), json!([null, "unknown", "none"]));
    app.get("/v1/stations/lochaber/avalanches/2007-02-01").await.problem("no-avalanche-record");
    assert_eq!(app.read("/v1/stations/lochaber/avalanches/2007-02-02").await["activity"], "unknown");
    // the day has a record of avalanches, but that is no observation of weather
    assert_eq!(app.read("/v1/stations/lochaber/observations/2007-02-02").await["air_temperature"], Value::Null);
}

#[tokio::test]
async fn two_forecasters_do_not_overwrite_each_other() {
    let app = lochaber().await;
    let tag = app.put(DAY, &day()).await.header("etag").to_owned();
    // the avalanche record belongs to the day: a change of it makes a new version too
    app.put("/v1/stations/lochaber/avalanches/2007-02-14", &json!({"activity": "none"})).await.json(200);
    app.put(DAY, &json!({"air_temperature": 1})).header("if-match", &tag).await.problem("precondition-failed");
    let now = app.get(DAY).await;
    assert_eq!(now.json(200)["air_temperature"], -3.5);
    app.put(DAY, &json!({"air_temperature": 1})).header("if-match", now.header("etag")).await.json(200);
    app.put(DAY, &day()).header("if-none-match", "*").await.problem("precondition-failed");
}

#[tokio::test]
async fn an_impossible_day_is_refused_field_by_field() {
    let app = lochaber().await;
    let before = app.rows().await;
    let body = json!({"air_temperature": 300, "wind_speed": "strong", "snow": 1, "snow_temperature": 0.5,
                      "avalanche_activity": "maybe", "rain_at_900m": 1});
    let refused = app.put(DAY, &body).await;
    let mut pointers = refused.pointers("invalid-body");
    pointers.sort();
    assert_eq!(
        pointers,
        ["/air_temperature", "/avalanche_activity", "/rain_at_900m", "/snow", "/snow_temperature", "/wind_speed"]
    );
    let one = app.put(DAY, &json!({"air_temperature": 300})).await;
    assert_json_snapshot!(one.problem("invalid-body"), {".traceId" => "[id]"}, @r#"
    {
      "type": "/problems/invalid-body",
      "title": "The body has unacceptable values",
      "status": 422,
      "detail": "/air_temperature must be from -60 to 40 (Air temperature, degC), not 300",
      "code": "invalid-body",
      "errors": [
        {
          "pointer": "/air_temperature",
          "detail": "must be from -60 to 40 (Air temperature, degC), not 300",
          "code": "out_of_range"
        }
      ],
      "traceId": "[id]"
    }
    "#);
    assert_eq!(app.rows().await, before);
}

#[tokio::test]
async fn fields_that_cannot_be_true_together_are_refused() {
    let app = lochaber().await;
    let before = app.rows().await;
    let cases = [
        (json!({"avalanche_activity": "none", "avalanche_count": 2}), "/avalanche_count"),
        (json!({"avalanche_activity": "observed", "avalanche_count": 0}), "/avalanche_count"),
        (json!({"avalanche_activity": "none", "avalanche_type": "wet"}), "/avalanche_type"),
        (json!({"avalanche_size": 2.5}), "/avalanche_activity"),
    ];
    for (body, pointer) in cases {
        assert_eq!(app.put(DAY, &body).await.pointers("invalid-body"), [pointer], "{body}");
    }
    assert_eq!(app.rows().await, before);
}

#[tokio::test]
async fn an_impossible_date_and_an_unknown_station_are_told_apart() {
    let app = lochaber().await;
    let before = app.rows().await;
    for date in ["2007-02-30", "20070214", "2007-2-14", "today", "2007-02-14T00:00:00Z"] {
        let refused = app.put(&format!("/v1/stations/lochaber/observations/{date}"), &day()).await;
        assert_eq!(refused.pointers("invalid-parameter"), ["/date"], "{date}");
        assert!(refused.problem("invalid-parameter")["detail"].as_str().unwrap().contains("YYYY-MM-DD"));
    }
    for call in
        [app.put("/v1/stations/absent/observations/2007-02-14", &day()), app.get("/v1/stations/absent/observations")]
    {
        let problem = call.await.problem("unknown-station");
        assert!(problem["detail"].as_str().unwrap().contains("PUT /v1/stations/absent"), "{problem}");
    }
    app.get(DAY).await.problem("no-observation");
    app.get(&format!("{DAY}/revisions")).await.problem("no-observation");
    assert_eq!(app.rows().await, before);
}

#[tokio::test]
async fn a_range_is_read_in_pages() {
    let app = lochaber().await;
    let days: Vec<Value> = (1..=9).map(|d| json!({"date": format!("2007-02-{d:02}"), "cloud_cover": d})).collect();
    app.post("/v1/stations/lochaber/observations").json(&json!(days)).await.json(200);
    // a day of which only the avalanches are known has its place in the list
    app.put("/v1/stations/lochaber/avalanches/2007-02-20", &json!({"activity": "observed"})).await.json(201);

    let all = app.read("/v1/stations/lochaber/observations").await;
    assert_eq!((dates(&all).len(), dates(&all).last(), &all["next"]), (10, Some(&"2007-02-20"), &Value::Null));
    let some = app.read("/v1/stations/lochaber/observations?from=2007-02-03&to=2007-02-05").await;
    assert_eq!(dates(&some), ["2007-02-03", "2007-02-04", "2007-02-05"]);
    assert_eq!(dates(&app.read("/v1/stations/lochaber/observations?from=2008-01-01").await).len(), 0);

    let mut path = Some("/v1/stations/lochaber/observations?from=2007-02-02&to=2007-02-28&limit=3".to_owned());
    let mut pages = Vec::new();
    while let Some(at) = path {
        let answer = app.get(&at).await;
        pages.push(dates(&answer.json(200)).iter().map(|date| date[8..].to_owned()).collect::<Vec<_>>());
        let link = answer.headers.get("link").map(|link| link.to_str().unwrap().to_owned());
        path = link.map(|link| link[1..link.find('>').unwrap()].to_owned());
    }
    assert_eq!(pages, [vec!["02", "03", "04"], vec!["05", "06", "07"], vec!["08", "09", "20"]]);
}

#[tokio::test]
async fn a_range_that_cannot_be_is_refused() {
    let app = lochaber().await;
    let list = |query: &str| app.get(&format!("/v1/stations/lochaber/observations?{query}"));
    assert_eq!(list("from=2007-02-02&to=2007-02-01").await.pointers("invalid-parameter"), ["/to"]);
    assert_eq!(list("from=2007-02-30").await.pointers("invalid-parameter"), ["/from"]);
    assert_eq!(list("limit=0").await.pointers("invalid-parameter"), ["/limit"]);
    assert_eq!(list("limit=10001").await.pointers("invalid-parameter"), ["/limit"]);
    assert_eq!(list("limit=-1").await.pointers("invalid-parameter"), ["/limit"]);
    assert_eq!(list("form=2007-02-01").await.pointers("invalid-parameter"), ["/form"]);
    assert_eq!(list("cursor=x").await.pointers("invalid-parameter"), ["/cursor"]);
    assert_eq!(dates(&list("cursor=9999-12-31").await.json(200)).len(), 0);
}

#[tokio::test]
async fn what_is_read_as_csv_can_be_sent_in_again() {
    let app = lochaber().await;
    app.put(DAY, &day()).await.json(201);
    app.put("/v1/stations/lochaber/avalanches/2007-02-15", &json!({"activity": "presumed"})).await.json(201);
    let answer = app.get("/v1/stations/lochaber/observations").header("accept", "text/csv").await;
    assert_eq!(answer.header("content-type"), "text/csv; charset=utf-8");
    let csv = answer.text();
    insta::assert_snapshot!(csv, @r#"
    date,air_temperature,wind_speed,wind_direction,cloud_cover,snow_height,new_snow_24h,new_snow_index,precipitation_24h,rain_at_900m,snow_drift,foot_penetration,snow_temperature,insolation_index,cumulative_snow_index,avalanche_activity,avalanche_count,avalanche_type,avalanche_trigger,avalanche_size
    2007-02-14,-3.5,12,,,,,6,,false,true,,,,,observed,2,dry,,
    2007-02-15,,,,,,,,,,,,,,,presumed,,,,
    "#);
    let again = app.get("/v1/stations/lochaber/observations").header("accept", "text/csv");
    assert_eq!(again.header("if-none-match", answer.header("etag")).await.status, 304);

    app.station("copy").await;
    let copied = app.import_csv("copy", &csv).await.json(200);
    assert_eq!((&copied["created"], &copied["flagged"]), (&json!(2), &json!(0)));
    let copy = app.get("/v1/stations/copy/observations").header("accept", "text/csv").await;
    assert_eq!(copy.text(), csv);
    let rows = app.rows().await;
    let again = app.import_csv("copy", &csv).await.json(200);
    assert_eq!((&again["unchanged"], &again["updated"]), (&json!(2), &json!(0)));
    assert_eq!(app.rows().await, rows);
}

#[tokio::test]
async fn writers_at_the_same_instant_lose_nothing() {
    let app = lochaber().await;
    let bodies: Vec<Value> = (0..20).map(|height| json!({"snow_height": height})).collect();
    let calls: Vec<_> = bodies.iter().map(|body| tokio::spawn(app.put(DAY, body).into_future())).collect();
    let mut created = 0;
    for call in calls {
        let answer = call.await.unwrap();
        assert!(matches!(answer.status, 200 | 201), "{answer:?}");
        created += usize::from(answer.status == 201);
    }
    assert_eq!(created, 1);
    let revisions = app.read(&format!("{DAY}/revisions")).await;
    let revisions = revisions["revisions"].as_array().unwrap();
    assert!(revisions.iter().zip(1..).all(|(revision, number)| revision["revision"] == number), "{revisions:?}");
    let mut heights: Vec<i64> =
        revisions.iter().map(|revision| revision["body"]["snow_height"].as_f64().unwrap() as i64).collect();
    assert_eq!(app.read(DAY).await["snow_height"], *heights.last().unwrap() as f64);
    heights.sort_unstable();
    assert_eq!(heights, (0..20).collect::<Vec<_>>());
}
