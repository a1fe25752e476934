//! A database of an earlier version, opened by this one: nothing of it is lost.

use std::path::Path;

use jiff::{Timestamp, civil::date};
use sqlx::{
    Row, SqlitePool,
    migrate::Migrator,
    sqlite::{SqliteConnectOptions, SqlitePoolOptions},
};

use super::{Store, StoreError, audit::Actor};
use crate::domain::ids::Place;

const OLD: &str = "01920000-0000-7000-8000-000000000001";
const NEW: &str = "01920000-0000-7000-8000-000000000002";
const JOB: &str = "01920000-0000-7000-8000-00000000000a";

/// The database as it was before there were regions: a station with two models of which the newer is active, a selection, an
/// issued forecast.
async fn before_regions(folder: &Path) {
    let options =
        SqliteConnectOptions::new().filename(folder.join("firn.db")).create_if_missing(true).foreign_keys(true);
    let pool = SqlitePoolOptions::new().max_connections(1).connect_with(options).await.unwrap();
    super::claim_file(&pool, folder).await.unwrap();
    let all = sqlx::migrate!("./migrations");
    let earlier: Vec<_> = all.iter().filter(|migration| migration.version < 30).cloned().collect();
    assert!(earlier.len() >= 7);
    Migrator { migrations: earlier.into(), ..Migrator::DEFAULT }.run(&pool).await.unwrap();
    for statement in [
        "INSERT INTO station (id, name, revision, created, updated)
         VALUES ('a', 'A', 1, '2026-01-01T00:00:00Z', '2026-01-01T00:00:00Z')".to_owned(),
        format!("INSERT INTO selection (job, station, body, created) VALUES ('{JOB}', 'a', '{{}}', '2026-01-01T00:00:00Z')"),
        format!(
            "INSERT INTO model (id, station, job, lead, summary, machine, evaluation, created, selection)
             VALUES ('{OLD}', 'a', '{JOB}', 0, '{{\"n\": 1}}', '{{}}', '{{\"e\": 1}}', '2026-01-01T00:00:00Z', NULL),
                    ('{NEW}', 'a', '{JOB}', 0, '{{\"n\": 2}}', '{{}}', '{{\"e\": 2}}', '2026-01-02T00:00:00Z', '{JOB}')"
        ),
        format!(
            "INSERT INTO activation (station, lead, model, activated, activated_by)
             VALUES ('a', 0, '{OLD}', '2026-01-01T00:00:00Z', NULL), ('a', 0, '{NEW}', '2026-01-02T00:00:00Z', 'anna')"
        ),
        format!(
            "INSERT INTO issued_forecast (station, date, lead, model, probability, warned, base_rate, label, hindcast, body, issued)
             VALUES ('a', '2026-01-03', 0, '{NEW}', 0.5, 1, 0.2, 'observed', 0, '{{\"b\": 1}}', '2026-01-03T06:00:00Z')"
        ),
    ] {
        sqlx::query(sqlx::AssertSqlSafe(statement)).execute(&pool).await.unwrap();
    }
    pool.close().await;
}

async fn count(pool: &SqlitePool, query: &'static str) -> usize {
    sqlx::query(query).fetch_all(pool).await.unwrap().len()
}

#[tokio::test]
async fn what_was_there_before_regions_is_there_after() {
    let folder = tempfile::tempdir().unwrap();
    before_regions(folder.path()).await;
    let store = Store::open(folder.path()).await.unwrap();
    let a = Place::Station("a".parse().unwrap());

    let models = store.models(Some(&a), None, 10).await.unwrap();
    let told: Vec<_> = models.iter().map(|model| (model.id.to_string(), model.summary["n"].as_i64())).collect();
    assert_eq!(told, [(NEW.to_owned(), Some(2)), (OLD.to_owned(), Some(1))]);
    assert_eq!(models[0].selection.map(|job| job.to_string()).as_deref(), Some(JOB));
    assert_eq!(models[0].place, a);
    assert_eq!(store.model_evaluation(models[1].id).await.unwrap().unwrap()["e"], 1);
    let active = store.active_model(&a, 0).await.unwrap().unwrap();
    assert_eq!((active.model.to_string(), active.activated_by.as_deref()), (NEW.to_owned(), Some("anna")));

    // an activation of that time can be rolled back
    let actor = Actor::service(Timestamp::UNIX_EPOCH);
    let back = store.roll_back_model(&a, 0, None, &actor, |_| true).await.unwrap().unwrap();
    assert_eq!((back.model.to_string(), back.back_to), (OLD.to_owned(), None));

    // what was issued is there, of the station's own days, and still frozen
    let from = date(2026, 1, 1);
    let issued = store.issued_forecasts(a.station().unwrap(), from, date(2026, 2, 1), 0, false).await.unwrap();
    assert_eq!((issued.len(), issued[0].model.to_string(), &issued[0].region), (1, NEW.to_owned(), &None));
    let change = sqlx::query("UPDATE issued_forecast SET probability = 1").execute(&store.writer).await;
    assert!(change.unwrap_err().to_string().contains("never changed"));
    let shorten = sqlx::query("DELETE FROM audit").execute(&store.writer).await;
    assert!(shorten.unwrap_err().to_string().contains("never shortened"));

    assert_eq!(count(&store.writer, "PRAGMA foreign_key_check").await, 0);
    let dangling = "SELECT sql FROM sqlite_schema WHERE instr(name || sql, '_before') OR instr(name || sql, '_anew')";
    assert_eq!(count(&store.writer, dangling).await, 0, "no table refers to one that is gone");
    // a model of no place, or of two, cannot be
    let nowhere = sqlx::query("UPDATE model SET station = NULL").execute(&store.writer).await;
    assert!(matches!(nowhere.map_err(StoreError::from), Err(StoreError::Sql(_))));
    let stations: i64 =
        sqlx::query("SELECT count(*) AS n FROM station").fetch_one(&store.reader).await.unwrap().get("n");
    assert_eq!(stations, 1);
    store.close().await;
}
