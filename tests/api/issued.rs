//! What was said in service, frozen, and how it did.

use jiff::{ToSpan, civil::Date, tz::TimeZone};
use serde_json::{Value, json};

use crate::support::{
    TestApp, data,
    trained::{id, train},
};

/// A server with a station of three winters and a quickly trained model.
async fn service() -> TestApp {
    let app = TestApp::start().await;
    app.station("a").await.import_csv("a", &data::csv(&data::winters(3, 3))).await.json(200);
    let inputs = json!({"station": "a", "label": "observed", "lead": 0, "kernel": "linear", "feature_set": "raw-30"});
    train(&app, &inputs).await;
    app
}

fn today() -> Date {
    firn::clock::today(&TimeZone::UTC)
}

fn at(date: impl std::fmt::Display, what: &str) -> String {
    format!("/v1/stations/a/forecasts/{date}{what}")
}

#[tokio::test]
async fn an_issued_forecast_is_never_changed() {
    let app = service().await;
    let today = today();
    app.get(&at(today, "/issued")).await.problem("not-issued");
    // without weather there is nothing to issue
    app.put(&at(today, ""), &json!({})).await.problem("no-observation");
    let observation = format!("/v1/stations/a/observations/{today}");
    let storm = json!({"air_temperature": -2.0, "wind_speed": 20.0, "new_snow_index": 8, "snow_drift": true});
    app.put(&observation, &storm).await.json(201);
    let issued = app.put(&at(today, ""), &json!({})).await.json(201);
    assert_eq!((&issued["hindcast"], &issued["call"]), (&json!(false), &Value::Null));
    assert_eq!(issued["forecast"], app.read(&at(today, "")).await);

    // the weather is corrected: what the model says now changes, what was issued does not
    app.put(&observation, &json!({"air_temperature": 8.0, "wind_speed": 0.0, "new_snow_index": 0})).await.json(200);
    let now = app.read(&at(today, "")).await;
    assert_ne!(now["probability"], issued["forecast"]["probability"]);
    assert_eq!(app.read(&at(today, "/issued")).await, issued);
    let again = app.put(&at(today, ""), &json!({})).await.problem("forecast-frozen");
    assert!(again["detail"].as_str().unwrap().contains("stays as it is"));
    let unseen = app.put(&at(today, ""), &json!({})).header("if-none-match", "*").await;
    unseen.problem("precondition-failed");
    assert_eq!(app.rows().await["issued_forecast"], 1);
    app.delete(&at(today, "")).await.problem("method-not-allowed");
}

#[tokio::test]
async fn a_call_may_change_until_the_day_has_ended() {
    let app = service().await;
    let tomorrow = today().tomorrow().unwrap();
    let call = app.put(&at(tomorrow, "/call"), &json!({"warned": true, "danger_level": 3})).await;
    assert_eq!(call.json(201)["revision"], 1);
    let better = json!({"warned": false, "probability": 0.2, "note": "the wind turned"});
    let changed = app.put(&at(tomorrow, "/call"), &better).header("if-match", call.header("etag")).await.json(200);
    assert_eq!((&changed["revision"], &changed["danger_level"]), (&json!(2), &Value::Null));
    app.put(&at(tomorrow, "/call"), &better)
        .header("if-match", call.header("etag"))
        .await
        .problem("precondition-failed");

    let past = app.put(&at("2013-01-10", "/call"), &json!({"warned": true})).await.json(201);
    assert_eq!(past["hindcast"], true);
    app.put(&at("2013-01-10", "/call"), &json!({"warned": false})).await.problem("forecast-frozen");
    for (body, pointer) in [
        (json!({"warned": true, "probability": 1.5}), "/probability"),
        (json!({"warned": true, "danger_level": 0}), "/danger_level"),
        (json!({"warned": "yes"}), "/warned"),
        (json!({}), "/warned"),
        (json!({"warned": true, "note": "x".repeat(2001)}), "/note"),
    ] {
        assert_eq!(app.put(&at(tomorrow, "/call"), &body).await.pointers("invalid-body"), [pointer]);
    }
}

#[tokio::test]
async fn what_was_issued_is_verified_beside_the_others() {
    let app = service().await;
    let nothing = app.read("/v1/stations/a/forecasts/verification").await;
    assert_eq!((&nothing["days"], &nothing["model"]["scores"]["pss"]), (&json!(0), &Value::Null));
    // two winters are issued after the event, with a forecaster who knows the second one by heart
    let (mut events, mut known, mut called) = (0_u64, 0_u64, 0_u64);
    for winter in [2012, 2013] {
        for day in 0..30 {
            let date = Date::new(winter, 1, 1).unwrap().checked_add(day.days()).unwrap();
            app.put(&at(date, ""), &json!({})).await.json(201);
            let record = app.get(&format!("/v1/stations/a/avalanches/{date}")).await;
            if record.status == 404 {
                continue;
            }
            let event = record.json(200)["activity"] == "observed";
            (events, known) = (events + u64::from(event), known + 1);
            if winter == 2013 {
                app.put(&at(date, "/call"), &json!({"warned": event})).await.json(201);
                called += 1;
            }
        }
    }
    assert!(events > 5 && known > 50 && known < 60 && called > 20, "{events} {known} {called}");
    let window =
        "/v1/stations/a/forecasts/verification?hindcasts=true&from=2012-01-01&to=2013-12-31&cost_loss_ratio=0.2";
    assert_eq!(app.read("/v1/stations/a/forecasts/verification").await["days"], 0, "a hindcast is no forecast");
    let found = app.read(window).await;
    assert_eq!(
        (&found["days"], &found["events"], &found["waiting"]),
        (&json!(known), &json!(events), &json!(60 - known))
    );
    assert_eq!(found["seasons"], json!([2011, 2012]));
    for side in ["model", "persistence", "climatology"] {
        assert_eq!(found[side]["days"], known, "{side}");
        assert!(found[side]["scores"]["brier"].is_number() && found[side]["scores"]["expected_cost"].is_number());
        assert!(found[side]["intervals"]["pss"]["lower"].is_number(), "{side}");
    }
    assert_eq!((&found["forecaster"]["days"], &found["model_on_called_days"]["days"]), (&json!(30), &json!(30)));
    assert_eq!(
        (&found["forecaster"]["scores"]["pss"], &found["forecaster"]["scores"]["brier"]),
        (&json!(1.0), &json!(0.0))
    );
    let table = &found["model"]["scores"]["contingency"];
    let cells: u64 = ["a", "b", "c", "d"].iter().map(|cell| table[cell].as_u64().unwrap()).sum();
    assert_eq!(cells, known);
    assert_eq!(found["cost_loss"].as_array().unwrap().len(), 19);
    assert!(found["brier_decomposition"]["resolution"].is_number() && found["drift"]["calibration_z"].is_number());

    // an outcome that becomes known is counted, one that becomes unknown waits
    app.put("/v1/stations/a/avalanches/2012-01-05", &json!({"activity": "unknown"})).await.json(200);
    let after = app.read(window).await;
    assert_eq!((&after["days"], &after["waiting"]), (&json!(known - 1), &json!(61 - known)));
    // another label has none
    assert_eq!(app.read(&format!("{window}&label=presumed")).await["days"], 0);
    for (query, pointer) in
        [("from=2013-01-02&to=2013-01-01", "/to"), ("lead=2", "/lead"), ("cost_loss_ratio=1", "/cost_loss_ratio")]
    {
        let answer = app.get(&format!("/v1/stations/a/forecasts/verification?{query}")).await;
        assert_eq!(answer.pointers("invalid-parameter"), [pointer]);
    }
}

#[tokio::test]
async fn the_model_that_issued_is_named_even_after_another_took_over() {
    let app = service().await;
    let issued = app.put(&at("2013-01-10", ""), &json!({})).await.json(201);
    let inputs =
        json!({"station": "a", "label": "observed", "lead": 0, "kernel": "linear", "feature_set": "raw-30", "seed": 2});
    let job = train(&app, &inputs).await;
    let second = app.read(&format!("/v1/jobs/{}/results", id(&job))).await["model_id"].clone();
    app.put("/v1/stations/a/active-model", &json!({"model_id": second})).await.json(200);
    assert_eq!(app.read(&at("2013-01-10", "/issued")).await["model_id"], issued["model_id"]);
    assert_ne!(issued["model_id"], second);
}
