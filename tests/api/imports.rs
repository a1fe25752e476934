//! Many days at once: JSON, NDJSON, CSV and the Scottish service's export.

use insta::assert_json_snapshot;
use serde_json::{Value, json};

use crate::support::{Answer, TestApp, data};

const DAYS: &str = "/v1/stations/lochaber/observations";

async fn lochaber() -> TestApp {
    let app = TestApp::start().await;
    app.put("/v1/stations/lochaber", &json!({"name": "Lochaber", "timezone": "Europe/London"})).await.json(201);
    app
}

async fn send(app: &TestApp, media_type: &str, body: impl Into<reqwest::Body>) -> Answer {
    app.post(DAYS).body(media_type, body).await
}

/// Line, date, status, outcome, flagged fields and error codes of every row.
fn rows(report: &Value) -> Vec<String> {
    let list = |row: &Value, member: &str, of: &str| -> Vec<String> {
        row[member].as_array().unwrap().iter().map(|entry| entry[of].as_str().unwrap().to_owned()).collect()
    };
    let row = |row: &Value| {
        let text = |name: &str| row[name].as_str().unwrap_or("-").to_owned();
        let noticed = [list(row, "flags", "field"), list(row, "errors", "code")].concat();
        format!("{} {} {} {} {}", row["line"], text("date"), text("status"), text("outcome"), noticed.join(","))
    };
    report["report"].as_array().expect("a report").iter().map(|line| row(line).trim_end().to_owned()).collect()
}

#[tokio::test]
async fn one_day_needs_no_list() {
    let app = lochaber().await;
    let report = app.post(DAYS).json(&json!({"date": "2007-02-14", "air_temperature": -3.5})).await.json(200);
    assert_json_snapshot!(report, @r#"
    {
      "format": "json",
      "rows": 1,
      "accepted": 1,
      "refused": 0,
      "created": 1,
      "updated": 0,
      "unchanged": 0,
      "flagged": 0,
      "not_reported": [],
      "ignored_columns": [],
      "notes": [],
      "report": [
        {
          "line": 1,
          "date": "2007-02-14",
          "status": "accepted",
          "outcome": "created",
          "flags": [],
          "errors": []
        }
      ]
    }
    "#);
    assert_eq!(app.read(&format!("{DAYS}/2007-02-14")).await["air_temperature"], -3.5);
}

#[tokio::test]
async fn a_list_says_what_became_of_every_day() {
    let app = lochaber().await;
    let two = json!([{"date": "2007-02-14", "cloud_cover": 10}, {"date": "2007-02-15", "cloud_cover": 20}]);
    app.post(DAYS).json(&two).await.json(200);
    let three = json!([{"date": "2007-02-15", "cloud_cover": 20}, {"date": "2007-02-14", "cloud_cover": 15},
                       {"date": "2007-02-16"}]);
    let report = app.post(DAYS).json(&three).await.json(200);
    assert_eq!(
        rows(&report),
        ["1 2007-02-15 accepted unchanged", "2 2007-02-14 accepted updated", "3 2007-02-16 accepted created"]
    );
    assert_eq!((&report["created"], &report["updated"], &report["unchanged"]), (&json!(1), &json!(1), &json!(1)));
    // a day that was observed although nothing was reported of it is a day
    assert_eq!(app.read(&format!("{DAYS}/2007-02-16")).await["revision"], 1);
}

#[tokio::test]
async fn an_empty_list_is_no_mistake() {
    let app = lochaber().await;
    assert_eq!(app.post(DAYS).json(&json!([])).await.json(200)["rows"], 0);
    assert_eq!(send(&app, "application/x-ndjson", "\n\n").await.json(200)["rows"], 0);
}

#[tokio::test]
async fn one_bad_value_in_a_list_stores_nothing_and_is_pointed_at() {
    let app = lochaber().await;
    let before = app.rows().await;
    let days = json!([{"date": "2007-02-14"}, {"date": "2007-02-15"}, {"date": "2007-02-16"},
                      {"date": "2007-02-17", "wind_speed": 300}, {"date": "2007-02-30"}, {"air_temperature": 1}, 7]);
    let refused = app.post(DAYS).json(&days).await;
    assert_eq!(refused.pointers("invalid-body"), ["/3/wind_speed", "/4/date", "/5/date", "/6"]);
    assert!(refused.problem("invalid-body")["detail"].as_str().unwrap().contains("from 0 to 100"));
    let one = app.post(DAYS).json(&json!({"date": "2007-02-14", "air_temperature": 300})).await;
    assert_eq!(one.pointers("invalid-body"), ["/air_temperature"]);
    assert_eq!(app.rows().await, before);
}

#[tokio::test]
async fn partial_stores_the_good_rows_and_reports_the_others() {
    let app = lochaber().await;
    let days = json!([{"date": "2007-02-14"}, {"date": "2007-02-15", "wind_speed": 300}, {"date": "2007-02-16"}]);
    let report = app.post(&format!("{DAYS}?partial=true")).json(&days).await.json(200);
    assert_eq!(
        rows(&report),
        ["1 2007-02-14 accepted created", "2 2007-02-15 refused - out_of_range", "3 2007-02-16 accepted created"]
    );
    assert_eq!((&report["accepted"], &report["refused"]), (&json!(2), &json!(1)));
    app.get(&format!("{DAYS}/2007-02-15")).await.problem("no-observation");
    app.read(&format!("{DAYS}/2007-02-16")).await;
    let none = app.post(&format!("{DAYS}?partial=true")).json(&json!([{"date": "x"}])).await.json(200);
    assert_eq!((&none["accepted"], &none["refused"]), (&json!(0), &json!(1)));
}

#[tokio::test]
async fn a_day_that_comes_twice_is_refused_in_every_format() {
    let app = lochaber().await;
    let before = app.rows().await;
    let json_days = json!([{"date": "2007-02-13"}, {"date": "2007-02-14"}, {"date": "2007-02-14", "cloud_cover": 5}]);
    let refused = app.post(DAYS).json(&json_days).await;
    assert_eq!(refused.pointers("invalid-body"), ["/2/date"]);
    let lines = "{\"date\":\"2007-02-14\"}\n{\"date\":\"2007-02-14\"}\n";
    assert_eq!(send(&app, "application/x-ndjson", lines).await.pointers("import-refused"), ["/2/date"]);
    let csv = "date,cloud_cover\n2007-02-14,1\n2007-02-14,1\n";
    assert_eq!(send(&app, "text/csv", csv).await.pointers("import-refused"), ["/3/date"]);
    assert_eq!(app.rows().await, before);

    let report = app.post(&format!("{DAYS}?partial=true")).json(&json_days).await.json(200);
    assert_eq!(rows(&report)[1..], ["2 2007-02-14 accepted created", "3 2007-02-14 refused - duplicate_day"]);
    assert_eq!(app.read(&format!("{DAYS}/2007-02-14")).await["cloud_cover"], Value::Null);
}

#[tokio::test]
async fn json_lines_are_read_line_by_line() {
    let app = lochaber().await;
    let good = "{\"date\":\"2007-02-14\",\"cloud_cover\":10}\n\n{\"date\":\"2007-02-15\",\"cloud_cover\":20}";
    let report = send(&app, "application/x-ndjson", good).await.json(200);
    assert_eq!(rows(&report), ["1 2007-02-14 accepted created", "3 2007-02-15 accepted created"]);

    let before = app.rows().await;
    let bad =
        "{\"date\":\"2007-02-16\"}\n{\"date\":\"2007-02-17\",\n{\"date\":\"2007-02-18\",\"cloud_cover\":101}\n{} {}\n";
    let refused = send(&app, "application/x-ndjson", bad).await;
    let problem = refused.problem("import-refused");
    assert_eq!(refused.pointers("import-refused")[..2], ["/2", "/3/cloud_cover"]);
    assert_eq!(rows(&problem)[0], "1 2007-02-16 accepted -", "accepted, but nothing was stored");
    assert_eq!(rows(&problem).len(), 4);
    assert_eq!(app.rows().await, before);
}

#[tokio::test]
async fn an_impossible_value_of_a_file_is_flagged_and_its_row_kept() {
    let app = lochaber().await;
    let csv = "date,insolation_index,air_temperature,avalanche_activity,avalanche_count\n\
               2006-04-15,18,2.5,none,\n\
               2006-04-16,24,cold,observed,0\n";
    let report = send(&app, "text/csv; charset=utf-8", csv).await.json(200);
    assert_json_snapshot!(report["report"][1], @r#"
    {
      "line": 3,
      "date": "2006-04-16",
      "status": "accepted",
      "outcome": "created",
      "flags": [
        {
          "field": "insolation_index",
          "code": "out_of_range",
          "value": "24",
          "detail": "must be between 2 and 20; kept as missing"
        },
        {
          "field": "air_temperature",
          "code": "unreadable",
          "value": "cold",
          "detail": "must be a number, or blank where it is missing; kept as missing"
        },
        {
          "field": "avalanche_count",
          "code": "contradiction",
          "value": "0",
          "detail": "the activity is `observed`, so the count cannot be 0: give the number seen, or null; kept as missing"
        }
      ],
      "errors": []
    }
    "#);
    assert_eq!((&report["flagged"], &report["accepted"], &report["refused"]), (&json!(1), &json!(2), &json!(0)));
    let day = app.read(&format!("{DAYS}/2006-04-16")).await;
    assert_eq!((&day["insolation_index"], &day["air_temperature"]), (&Value::Null, &Value::Null));
    assert_eq!((&day["avalanche_activity"], &day["avalanche_count"]), (&json!("observed"), &Value::Null));
}

#[tokio::test]
async fn a_file_that_is_no_csv_is_refused_with_line_and_column() {
    let app = lochaber().await;
    let before = app.rows().await;
    let malformed = send(&app, "text/csv", "date,cloud_cover\n2007-02-14,\"10\n").await;
    assert_json_snapshot!(malformed.problem("malformed-file"), {".traceId" => "[id]"}, @r#"
    {
      "type": "/problems/malformed-file",
      "title": "The file could not be read",
      "status": 422,
      "detail": "line 2, column 12: malformed CSV: a quote that is never closed",
      "code": "malformed-file",
      "traceId": "[id]",
      "line": 2,
      "column": 12
    }
    "#);
    let place = |answer: &Answer| {
        let problem = answer.problem("malformed-file");
        (problem["line"].clone(), problem["column"].clone())
    };
    let column = send(&app, "text/csv", "date,cloud_cover,snow\n2007-02-14,10,1\n").await;
    assert_eq!(place(&column), (json!(1), json!(18)));
    let twice = send(&app, "text/csv", "date,cloud_cover,cloud_cover\n").await;
    assert_eq!(place(&twice), (json!(1), json!(18)));
    let no_date = send(&app, "text/csv", "cloud_cover\n10\n").await;
    assert_eq!(place(&no_date), (json!(1), Value::Null));
    let binary = send(&app, "text/csv", vec![b'd', b'\n', 0]).await;
    assert_eq!(place(&binary), (json!(2), json!(1)));
    send(&app, "text/csv", "").await.problem("malformed-file");

    let ragged = send(&app, "text/csv", "date,cloud_cover\n2007-02-14,10\n2007-02-15\n2007-02-30,1\n").await;
    let problem = ragged.problem("import-refused");
    assert_eq!(
        rows(&problem),
        ["2 2007-02-14 accepted -", "3 2007-02-15 refused - ragged_row", "4 - refused - unreadable_date"]
    );
    assert!(problem["errors"][0]["detail"].as_str().unwrap().contains("line 3, column 11"), "{problem}");
    assert_eq!(app.rows().await, before);
}

#[tokio::test]
async fn what_is_not_json_is_refused_with_its_place() {
    let app = lochaber().await;
    let broken = send(&app, "application/json", "[{\"date\": \"2007-02-14\",]").await.problem("invalid-json");
    assert!(broken["detail"].as_str().unwrap().contains("line 1 column"), "{broken}");
    send(&app, "application/json", "").await.problem("invalid-json");
    send(&app, "application/json", vec![0xff, 0xfe]).await.problem("invalid-json");
    send(&app, "application/json", "[{\"date\":\"2007-02-14\",\"cloud_cover\":1e999}]").await.problem("invalid-json");
}

#[tokio::test]
async fn a_media_type_that_is_not_read_is_refused() {
    let app = lochaber().await;
    let before = app.rows().await;
    for media_type in ["application/xml", "text/plain", "multipart/form-data", "nonsense"] {
        let problem = send(&app, media_type, "2007-02-14").await.problem("unsupported-media-type");
        assert!(problem["detail"].as_str().unwrap().contains("application/json or application/x-ndjson or text/csv"));
    }
    let export = app.post(&format!("{DAYS}?format=sais")).json(&json!([])).await;
    assert!(export.problem("unsupported-media-type")["detail"].as_str().unwrap().contains("text/csv"));
    assert_eq!(app.rows().await, before);
}

#[tokio::test]
async fn an_unknown_station_or_parameter_is_refused_whatever_the_body() {
    let app = lochaber().await;
    let day = json!({"date": "2007-02-14"});
    app.post("/v1/stations/absent/observations").json(&day).await.problem("unknown-station");
    assert_eq!(app.post(&format!("{DAYS}?format=xls")).json(&day).await.pointers("invalid-parameter"), ["/format"]);
    assert_eq!(app.post(&format!("{DAYS}?partial=maybe")).json(&day).await.pointers("invalid-parameter"), ["/partial"]);
    assert_eq!(app.post(&format!("{DAYS}?parital=true")).json(&day).await.pointers("invalid-parameter"), ["/parital"]);
    app.get(&format!("{DAYS}/2007-02-14")).await.problem("no-observation");
}

#[tokio::test]
async fn a_body_over_the_limit_is_refused() {
    let app = TestApp::with(|config| config.max_body_bytes = 2000).await;
    app.station("lochaber").await;
    let before = app.rows().await;
    let days: Vec<Value> = (1..=28)
        .map(|d| json!({"date": format!("2007-02-{d:02}"), "cloud_cover": d, "wind_speed": d, "air_temperature": d}))
        .collect();
    let body = json!(days).to_string();
    assert!(body.len() > 2000, "{}", body.len());
    let refused = send(&app, "application/json", body.clone()).await.problem("payload-too-large");
    assert!(refused["detail"].as_str().unwrap().contains("2000 bytes"), "{refused}");
    // without a length in advance the limit holds just the same
    let head =
        format!("POST {DAYS} HTTP/1.1\r\nhost: localhost\r\ncontent-type: application/json\r\nconnection: close\r\n");
    let chunked = format!("{head}transfer-encoding: chunked\r\n\r\n{:x}\r\n{body}\r\n0\r\n\r\n", body.len());
    let answer = app.raw(&chunked).await;
    assert!(answer.starts_with("HTTP/1.1 413 ") && answer.contains("application/problem+json"), "{answer}");
    app.put("/v1/stations/x", &json!({"name": "x".repeat(3000)})).await.problem("payload-too-large");
    assert_eq!(app.rows().await, before);
    app.post(DAYS).json(&json!(days[..5])).await.json(200);
}

const HEADER: &str = "Date, Area, Obs, Air Temp, Wind Dir, Wind Speed, Cloud, Drift, Foot Pen, Rain at 900, Avalanche Code, No Settle, Snow Index, Insolation, Snow Temp, Comments";

#[tokio::test]
async fn an_export_is_read_with_its_traps() {
    let app = lochaber().await;
    let export = format!(
        "{HEADER},\n\
         14/02/2007 00:00,Lochaber,AB,-3.5,230,20,80,1,25,0,2011,40,6,8,2.5,,\n\
         15/04/2007 23:00,Lochaber,CD,6.9,225,20,-9999,0,8,0,4400,46,0,24,-1,wind slab on NE, deep \"stuff\",\n"
    );
    let report = app.post(&format!("{DAYS}?format=sais")).body("text/csv", export.clone()).await.json(200);
    assert_eq!(report["format"], "sais");
    assert_eq!(rows(&report), ["2 2007-02-14 accepted created", "3 2007-04-16 accepted created insolation_index"]);
    let first = app.read(&format!("{DAYS}/2007-02-14")).await;
    assert_json_snapshot!(first, {".updated" => "[instant]"}, @r#"
    {
      "station": "lochaber",
      "date": "2007-02-14",
      "air_temperature": -3.5,
      "wind_speed": 8.9408,
      "wind_direction": 230.0,
      "cloud_cover": 80.0,
      "snow_height": null,
      "new_snow_24h": null,
      "new_snow_index": 6.0,
      "precipitation_24h": null,
      "rain_at_900m": false,
      "snow_drift": true,
      "foot_penetration": 25.0,
      "snow_temperature": -2.5,
      "insolation_index": 8.0,
      "cumulative_snow_index": 40.0,
      "avalanche_activity": "observed",
      "avalanche_count": 2,
      "avalanche_type": "dry",
      "avalanche_trigger": "natural",
      "avalanche_size": null,
      "forecast": false,
      "synthetic": false,
      "revision": 1,
      "avalanche_revision": 1,
      "updated": "[instant]"
    }
    "#);
    let second = app.read(&format!("{DAYS}/2007-04-16")).await;
    assert_eq!((&second["cloud_cover"], &second["insolation_index"]), (&Value::Null, &Value::Null));
    assert_eq!((&second["avalanche_activity"], &second["snow_temperature"]), (&json!("presumed"), &json!(-1.0)));
    // observers and their words reach no answer
    let everything = [report.to_string(), first.to_string(), second.to_string()].concat();
    for private in ["AB", "CD", "slab", "stuff"] {
        assert!(!everything.contains(private), "{private}");
    }
    let again = app.post(&format!("{DAYS}?format=sais")).body("text/csv", export).await.json(200);
    assert_eq!(again["unchanged"], 2);
}

#[tokio::test]
async fn two_profiles_of_one_day_make_one_day() {
    let app = lochaber().await;
    let export = format!(
        "{HEADER},\n\
         14/02/2007 09:00,Lochaber,,-3.5,230,20,80,1,25,0,2011,40,6,8,2.5,,\n\
         14/02/2007 14:00,Lochaber,,-1.5,240,20,90,1,25,0,0,40,6,8,2.5,,\n"
    );
    let report = app.post(&format!("{DAYS}?format=sais")).body("text/csv", export).await.json(200);
    let outcomes: Vec<&Value> = report["report"].as_array().unwrap().iter().map(|row| &row["outcome"]).collect();
    assert_eq!(json!(outcomes), json!(["merged", "created"]));
    assert_eq!((&report["rows"], &report["created"]), (&json!(2), &json!(1)));
    // the values of the later profile, the stronger activity
    let day = app.read(&format!("{DAYS}/2007-02-14")).await;
    assert_eq!((&day["air_temperature"], &day["avalanche_activity"]), (&json!(-1.5), &json!("observed")));
}

#[tokio::test]
async fn a_bad_row_of_an_export_refuses_all_of_it() {
    let app = lochaber().await;
    let before = app.rows().await;
    let export = format!(
        "{HEADER},\n\
         14/02/2007 00:00,Lochaber,,-3.5,230,20,80,1,25,0,0,40,6,8,2.5,,\n\
         31/02/2007 00:00,Lochaber,,-3.5,230,20,80,1,25,0,0,40,6,8,2.5,,\n\
         15/02/2007 00:00,Glencoe,,-3.5,230,20,80,1,25,0,0,40,6,8,2.5,,\n"
    );
    let refused = app.post(&format!("{DAYS}?format=sais")).body("text/csv", export.clone()).await;
    let problem = refused.problem("import-refused");
    assert_eq!(rows(&problem)[1..], ["3 - refused - unreadable_date", "4 2007-02-15 refused - other_area"]);
    assert_eq!(app.rows().await, before);
    let glencoe = app.post(&format!("{DAYS}?format=sais&partial=true&area=Glencoe")).body("text/csv", export).await;
    assert_eq!(glencoe.json(200)["accepted"], 1);
}

#[tokio::test]
async fn an_import_takes_nothing_away_that_is_known() {
    let app = lochaber().await;
    let day = "/v1/stations/lochaber/observations/2007-02-14";
    app.put(day, &json!({"air_temperature": -3.5, "avalanche_activity": "observed", "avalanche_count": 2}))
        .await
        .json(201);
    let before = app.read(day).await;

    // a table of avalanches alone says nothing of the weather, and unknown is no news
    let same = send(&app, "text/csv", "date,avalanche_activity,avalanche_count\n2007-02-14,observed,2\n").await;
    assert_eq!(same.json(200)["unchanged"], 1);
    let unknown =
        send(&app, "application/json", json!([{"date": "2007-02-14", "avalanche_activity": "unknown"}]).to_string());
    assert_eq!(unknown.await.json(200)["unchanged"], 1);
    assert_eq!(app.read(day).await, before);

    // what it does say, it says
    let more = send(&app, "text/csv", "date,avalanche_activity\n2007-02-14,presumed\n").await;
    assert_eq!(more.json(200)["updated"], 1);
    let after = app.read(day).await;
    assert_eq!((&after["air_temperature"], &after["avalanche_activity"]), (&json!(-3.5), &json!("presumed")));
}

#[tokio::test]
async fn a_table_that_is_no_export_is_refused_whole() {
    let app = lochaber().await;
    app.put("/v1/stations/lochaber/observations/2007-02-14", &json!({"cloud_cover": 50})).await.json(201);
    let before = app.rows().await;
    let table = "date,season,air_temp_c,wind_dir_deg,snow_temp_c\n2007-02-14,2006,-3,230,-2\n";
    let refused = app.post(&format!("{DAYS}?format=sais&partial=true")).body("text/csv", table).await;
    refused.problem("malformed-file");
    assert_eq!(app.rows().await, before);
}

/// A file has columns, and says nothing of the variables that it has none of.
#[tokio::test]
async fn a_file_of_some_columns_leaves_the_others_as_they_are() {
    let app = lochaber().await;
    let day = format!("{DAYS}/2020-01-02");
    app.put(&day, &json!({"air_temperature": -5, "wind_speed": 9, "snow_height": 3})).await.json(201);
    let file = "date,snow_height,wind_speed\n2020-01-02,4,\n2020-01-03,5,\n";
    let report = send(&app, "text/csv", file).await.json(200);
    assert_eq!((&report["updated"], &report["created"]), (&json!(1), &json!(1)));
    assert_eq!(report["not_reported"], json!(["wind_speed"]));
    let known = app.read(&day).await;
    let of = |name: &str| known[name].as_f64();
    assert_eq!((of("air_temperature"), of("wind_speed"), of("snow_height")), (Some(-5.0), Some(9.0), Some(4.0)));
    // a column that has values speaks for each of its rows
    let file = "date,wind_speed,snow_height\n2020-01-02,,4\n2020-01-03,7,5\n";
    send(&app, "text/csv", file).await.json(200);
    assert_eq!(app.read(&day).await["wind_speed"], Value::Null);
    assert_eq!(app.read(&day).await["air_temperature"], -5.0);
    // in JSON a day is said whole
    app.post(DAYS).json(&json!([{"date": "2020-01-02", "snow_height": 6}])).await.json(200);
    assert_eq!(app.read(&day).await["air_temperature"], Value::Null);
}

#[tokio::test]
async fn one_day_of_json_means_what_a_put_of_it_means() {
    let app = lochaber().await;
    let day = json!({"date": "2020-01-02", "air_temperature": -5, "avalanche_activity": "observed"});
    app.post(DAYS).json(&day).await.json(200);
    let mistaken = json!({"date": "2020-01-02", "air_temperature": -5, "avalanche_activity": "unknown"});
    let report = app.post(DAYS).json(&mistaken).await.json(200);
    assert_eq!(report["updated"], 1);
    assert_eq!(app.read(&format!("{DAYS}/2020-01-02")).await["avalanche_activity"], "unknown");
}

/// The refusal of a body must not be many times as large as the body.
#[tokio::test]
async fn a_body_of_unknown_fields_is_refused_in_few_words() {
    let app = lochaber().await;
    let fields: Vec<String> = (0..20_000).map(|number| format!("\"f{number}\":1")).collect();
    let body = format!("[{{\"date\":\"2020-01-02\",{}}}]", fields.join(","));
    let answer = app.post(DAYS).body("application/json", body.clone()).await;
    answer.problem("invalid-body");
    assert!(answer.body.len() < 20_000, "{} bytes for {}", answer.body.len(), body.len());
}

#[tokio::test]
async fn smet_goes_out_and_in_again_field_by_field() {
    let app = TestApp::start().await;
    app.station("a").await.station("b").await;
    let days = data::winters(3, 1);
    app.import_csv("a", &data::csv(&days)).await.json(200);
    let smet = app.get("/v1/stations/a/observations?limit=10000").header("accept", "text/x-smet").await;
    assert_eq!(smet.header("content-type"), "text/x-smet; charset=utf-8");
    let report = app.post("/v1/stations/b/observations").body("text/x-smet", smet.text()).await.json(200);
    assert_eq!((&report["format"], &report["refused"], &report["flagged"]), (&json!("smet"), &json!(0), &json!(0)));
    let a = app.read("/v1/stations/a/observations?limit=10000").await;
    let b = app.read("/v1/stations/b/observations?limit=10000").await;
    let (a, b) = (a["observations"].as_array().unwrap(), b["observations"].as_array().unwrap());
    assert_eq!(a.len(), b.len());
    for (a, b) in a.iter().zip(b) {
        for (name, value) in a.as_object().unwrap() {
            if !name.starts_with("avalanche") && !["station", "updated"].contains(&name.as_str()) {
                assert_eq!(value, &b[name], "{name} of {}", a["date"]);
            }
        }
    }
    // avalanches have no field in SMET: those that are known stay
    let again = app.post("/v1/stations/a/observations").body("text/x-smet", smet.text()).await.json(200);
    assert_eq!((&again["updated"], &again["created"]), (&json!(0), &json!(0)), "nothing changed");
    let any = app.get("/v1/stations/a/observations").header("accept", "text/*").await;
    assert_eq!(any.header("content-type"), "text/csv; charset=utf-8");
    let broken =
        app.post("/v1/stations/a/observations").body("text/x-smet", "SMET 1.1 ASCII\nfields = TA\n[DATA]\n").await;
    broken.problem("malformed-file");
}

#[tokio::test]
async fn a_file_of_anybody_is_read_by_its_mapping() {
    let app = TestApp::start().await;
    app.station("a").await;
    let send = |mapping: Value, body: &str| {
        let query: String =
            form_urlencoded::Serializer::new(String::new()).append_pair("mapping", &mapping.to_string()).finish();
        app.post(&format!("/v1/stations/a/observations?{query}")).body("text/csv", body.to_owned())
    };
    let good = json!({"date": "Day", "date_format": "DD.MM.YYYY",
        "columns": {"TA": {"variable": "air_temperature", "unit": "K"}, "FF": {"variable": "wind_speed", "unit": "km/h"}}});
    let report = send(good.clone(), "Day,TA,FF,Obs\n14.02.2007,269.65,36,ann\n").await.json(200);
    assert_eq!((&report["created"], &report["ignored_columns"]), (&json!(1), &json!(["Obs"])));
    let day = app.read("/v1/stations/a/observations/2007-02-14").await;
    assert_eq!((&day["air_temperature"], &day["wind_speed"]), (&json!(-3.5), &json!(10.0)));

    let rows = app.rows().await;
    let mut unit = good.clone();
    unit["columns"]["FF"]["unit"] = json!("Bft");
    assert_eq!(send(unit, "Day,TA,FF\n").await.pointers("invalid-mapping"), ["/mapping/columns/FF/unit"]);
    let mut variable = good.clone();
    variable["columns"]["FF"]["variable"] = json!("gusts");
    assert_eq!(send(variable, "Day,TA,FF\n").await.pointers("invalid-mapping"), ["/mapping/columns/FF/variable"]);
    assert_eq!(send(json!({"columns": {}}), "x\n").await.pointers("invalid-mapping"), ["/mapping"]);
    send(good, "Day,TA\n").await.problem("malformed-file");
    let smet = app.post("/v1/stations/a/observations?mapping=%7B%7D").body("text/csv", "x\n").await;
    assert_eq!(smet.pointers("invalid-mapping"), ["/mapping"]);
    assert_eq!(app.rows().await, rows);
}
