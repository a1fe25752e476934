//! Fourteen winters of Lochaber, in over HTTP as the service exported them and out again value by value.

use std::collections::HashMap;

use serde_json::{Value, json};

use crate::support::{TestApp, data::shared};

type Row = HashMap<String, String>;

/// Field of the API, column of the decoded file, and what a unit of the column is in the unit of the field.
const NUMBERS: [(&str, &str, f64); 9] = [
    ("air_temperature", "air_temp_c", 1.0),
    // exactly 0.44704 m/s a mile an hour
    ("wind_speed", "wind_speed_mph", 0.44704),
    ("wind_direction", "wind_dir_deg", 1.0),
    ("cloud_cover", "cloud_pct", 1.0),
    ("new_snow_index", "snow_index", 1.0),
    ("foot_penetration", "foot_pen_cm", 1.0),
    ("snow_temperature", "snow_temp_c", 1.0),
    ("insolation_index", "insolation", 1.0),
    ("cumulative_snow_index", "no_settle", 1.0),
];

fn number(row: &Row, column: &str) -> Option<f64> {
    Some(row[column].as_str()).filter(|field| !field.is_empty()).map(|field| field.parse().unwrap())
}

fn flag(row: &Row, column: &str) -> Value {
    number(row, column).map_or(Value::Null, |value| json!(value == 1.0))
}

fn activity(row: &Row) -> &'static str {
    match (row["aval_observed"].as_str(), row["aval_presumed"].as_str()) {
        ("1", "1") => "observed",
        ("0", "1") => "presumed",
        ("0", "0") => "none",
        ("", "") => "unknown",
        other => panic!("{other:?}"),
    }
}

fn word(row: &Row, column: &str) -> Value {
    match row[column].as_str() {
        "" => Value::Null,
        "natural+triggered" => json!("natural_and_triggered"),
        word => json!(word),
    }
}

/// The whole archive, page by page.
async fn read_all(app: &TestApp) -> Vec<Value> {
    let mut days = Vec::new();
    let mut path = Some("/v1/stations/lochaber/observations?limit=700".to_owned());
    while let Some(at) = path {
        let page = app.read(&at).await;
        days.extend(page["observations"].as_array().unwrap().iter().cloned());
        let next = page["next"].as_str();
        path = next.map(|cursor| format!("/v1/stations/lochaber/observations?limit=700&cursor={cursor}"));
    }
    days
}

#[tokio::test]
async fn every_value_of_the_archive_arrives() {
    let Some(export) = shared("sais_lochaber_1993-2007.csv") else { return };
    let Some(decoded) = shared("sais_lochaber_1993-2007_decoded.csv") else { return };
    let app = TestApp::start().await;
    app.put("/v1/stations/lochaber", &json!({"name": "Lochaber", "timezone": "Europe/London"})).await.json(201);
    let post = || app.post("/v1/stations/lochaber/observations?format=sais").body("text/csv", export.clone());

    let report = post().await.json(200);
    assert_eq!((&report["rows"], &report["created"], &report["refused"]), (&json!(1582), &json!(1582), &json!(0)));
    let flagged: Vec<&Value> =
        report["report"].as_array().unwrap().iter().filter(|row| row["flags"] != json!([])).collect();
    assert_eq!(flagged.len(), 1, "{flagged:?}");
    assert_eq!((&flagged[0]["date"], &flagged[0]["flags"][0]["value"]), (&json!("2006-04-16"), &json!("24")));
    assert_eq!(flagged[0]["flags"][0]["field"], "insolation_index");

    let days = read_all(&app).await;
    assert_eq!(days.len(), 1582);
    assert!(days.is_sorted_by_key(|day| day["date"].as_str().unwrap()));
    let rows = csv::Reader::from_reader(decoded.as_slice()).into_deserialize::<Row>().map(|row| row.unwrap());
    let truth: HashMap<String, Row> = rows.map(|row| (row["date"].clone(), row)).collect();
    for day in &days {
        let date = day["date"].as_str().unwrap();
        let row = &truth[date];
        for (field, column, unit) in NUMBERS {
            let expected = number(row, column).map(|value| value * unit);
            assert_eq!(day[field].as_f64(), expected, "{date} {field}");
            assert!(day[field].is_null() == expected.is_none(), "{date} {field}");
        }
        assert_eq!(day["rain_at_900m"], flag(row, "rain_900"), "{date}");
        assert_eq!(day["snow_drift"], flag(row, "drift"), "{date}");
        assert_eq!(day["avalanche_activity"], activity(row), "{date}");
        assert_eq!(day["avalanche_count"].as_f64(), number(row, "n_avalanches"), "{date}");
        assert_eq!(day["avalanche_type"], word(row, "aval_type"), "{date}");
        assert_eq!(day["avalanche_trigger"], word(row, "aval_trigger"), "{date}");
        for absent in ["snow_height", "new_snow_24h", "precipitation_24h", "avalanche_size"] {
            assert_eq!(day[absent], Value::Null, "{date} {absent}");
        }
    }
    let of = |activity: &str| days.iter().filter(|day| day["avalanche_activity"] == activity).count();
    assert_eq!((of("observed"), of("presumed"), of("unknown")), (294, 619 - 294, 10));

    let stored = app.rows().await;
    assert_eq!(post().await.json(200)["unchanged"], 1582);
    assert_eq!(app.rows().await, stored, "the same file again makes no revision");

    // and once more through our own CSV
    let csv = app.get("/v1/stations/lochaber/observations?limit=10000").header("accept", "text/csv").await.text();
    let again = app.import_csv("lochaber", &csv).await.json(200);
    assert_eq!((&again["unchanged"], &again["flagged"]), (&json!(1582), &json!(0)));
    assert_eq!(app.rows().await, stored);
}
