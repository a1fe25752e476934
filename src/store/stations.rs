//! Stations.

use sqlx::{FromRow, Row, sqlite::SqliteRow};

use super::{
    Result, Store, StoreError,
    audit::{self, Action, Actor, NewEntry},
    from_json, parse_timestamp, to_json,
};
use crate::domain::{
    ids::StationId,
    station::{Station, StationBody},
};

/// What became of a PUT.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Written {
    /// There was nothing before.
    Created,
    /// It replaced something else.
    Updated,
    /// It said what was already known.
    Unchanged,
}

struct StationRow(Station);

impl FromRow<'_, SqliteRow> for StationRow {
    fn from_row(row: &SqliteRow) -> sqlx::Result<Self> {
        read(row).map(Self).map_err(|error| sqlx::Error::Decode(Box::new(error)))
    }
}

fn read(row: &SqliteRow) -> Result<Station> {
    let variables: Option<String> = row.try_get("variables")?;
    let body = serde_json::json!({
        "name": row.try_get::<String, _>("name")?,
        "latitude": row.try_get::<Option<f64>, _>("latitude")?,
        "longitude": row.try_get::<Option<f64>, _>("longitude")?,
        "altitude_m": row.try_get::<Option<f64>, _>("altitude_m")?,
        "timezone": row.try_get::<Option<String>, _>("timezone")?,
        "eaws_region": row.try_get::<Option<String>, _>("eaws_region")?,
        "retrain": row.try_get::<Option<String>, _>("retrain")?.map(|day| serde_json::json!({"yearly": day})),
        "variables": variables.map(|text| from_json::<serde_json::Value>(&text)).transpose()?,
    });
    Ok(Station {
        id: row.try_get::<String, _>("id")?.parse().map_err(StoreError::corrupt)?,
        body: serde_json::from_value(body).map_err(StoreError::corrupt)?,
        synthetic: row.try_get("synthetic")?,
        revision: row.try_get("revision")?,
        created: parse_timestamp(row.try_get("created")?)?,
        updated: parse_timestamp(row.try_get("updated")?)?,
    })
}

impl Store {
    /// The station of that name.
    ///
    /// # Errors
    /// [`StoreError::Sql`] where the database cannot be read.
    pub async fn station(&self, id: &StationId) -> Result<Option<Station>> {
        let row = sqlx::query_as::<_, StationRow>("SELECT * FROM station WHERE id = ?")
            .bind(id.as_str())
            .fetch_optional(&self.reader)
            .await?;
        Ok(row.map(|row| row.0))
    }

    /// Up to `limit` stations in the order of their names, after the name `after`.
    ///
    /// # Errors
    /// [`StoreError::Sql`] where the database cannot be read.
    pub async fn stations(&self, after: &str, limit: u32) -> Result<Vec<Station>> {
        let rows = sqlx::query_as::<_, StationRow>("SELECT * FROM station WHERE id > ? ORDER BY id LIMIT ?")
            .bind(after)
            .bind(limit)
            .fetch_all(&self.reader)
            .await?;
        Ok(rows.into_iter().map(|row| row.0).collect())
    }

    /// Makes or replaces a station; `permits` decides on the state before, so that no change in between is overwritten.
    ///
    /// # Errors
    /// [`StoreError::Precondition`] where `permits` says no.
    pub async fn put_station(
        &self,
        id: &StationId,
        body: &StationBody,
        synthetic: bool,
        actor: &Actor,
        permits: impl FnOnce(Option<&Station>) -> bool,
    ) -> Result<(Station, Written)> {
        let mut tx = self.begin().await?;
        let before = sqlx::query_as::<_, StationRow>("SELECT * FROM station WHERE id = ?")
            .bind(id.as_str())
            .fetch_optional(&mut *tx)
            .await?
            .map(|row| row.0);
        if !permits(before.as_ref()) {
            return Err(StoreError::Precondition);
        }
        let (written, action) = match &before {
            Some(station) if station.body == *body => return Ok((station.clone(), Written::Unchanged)),
            Some(_) => (Written::Updated, Action::StationChanged),
            None => (Written::Created, Action::StationCreated),
        };
        let variables = body.variables.as_ref().map(to_json).transpose()?;
        let row = sqlx::query_as::<_, StationRow>(
            "INSERT INTO station (id, name, latitude, longitude, altitude_m, timezone, variables, synthetic, revision, created, updated,
                                  eaws_region, retrain)
             VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, 1, ?9, ?9, ?10, ?11)
             ON CONFLICT (id) DO UPDATE SET name = ?2, latitude = ?3, longitude = ?4, altitude_m = ?5, timezone = ?6,
                 variables = ?7, eaws_region = ?10, retrain = ?11, revision = revision + 1, updated = ?9
             RETURNING *",
        )
        .bind(id.as_str())
        .bind(body.name.as_str())
        .bind(body.latitude.map(f64::from))
        .bind(body.longitude.map(f64::from))
        .bind(body.altitude_m.map(f64::from))
        .bind(body.timezone.as_ref().map(|zone| zone.as_str()))
        .bind(variables)
        .bind(synthetic)
        .bind(actor.at.to_string())
        .bind(body.eaws_region.as_ref().map(|region| region.as_str()))
        .bind(body.retrain.map(|retrain| retrain.yearly.to_string()))
        .fetch_one(&mut *tx)
        .await?;
        let entry = NewEntry {
            action,
            target: &format!("/v1/stations/{id}"),
            reason: None,
            before: before
                .map(|station| serde_json::to_value(station.body))
                .transpose()
                .map_err(StoreError::corrupt)?,
            after: Some(serde_json::to_value(body).map_err(StoreError::corrupt)?),
        };
        audit::write(&mut tx, actor, entry).await?;
        tx.commit().await?;
        Ok((row.0, written))
    }
}
