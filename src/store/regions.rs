//! Regions, and the days that their models read.

use firn_science::forecast::{
    day::{DayRecord, Label},
    region::{Quiet, regional},
};
use jiff::civil::Date;
use sqlx::{FromRow, Row, Sqlite, SqliteConnection, Transaction, sqlite::SqliteRow};

use super::{
    Result, Store, StoreError,
    audit::{self, Action, Actor, NewEntry},
    from_json, parse_timestamp,
    stations::Written,
};
use crate::domain::{
    ids::{RegionId, StationId},
    region::{Region, RegionBody},
};

/// A region with its stations as a JSON array in their order; `WHERE`, `ORDER BY` and `LIMIT` follow.
const REGION: &str = "SELECT region.*, (SELECT json_group_array(station ORDER BY position) FROM region_station
    WHERE region_station.region = region.id) AS stations FROM region";

struct RegionRow(Region);

impl FromRow<'_, SqliteRow> for RegionRow {
    fn from_row(row: &SqliteRow) -> sqlx::Result<Self> {
        read(row).map(Self).map_err(|error| sqlx::Error::Decode(Box::new(error)))
    }
}

fn read(row: &SqliteRow) -> Result<Region> {
    let body = serde_json::json!({
        "name": row.try_get::<String, _>("name")?,
        "stations": from_json::<Vec<String>>(row.try_get("stations")?)?,
        "retrain": row.try_get::<Option<String>, _>("retrain")?.map(|day| serde_json::json!({"yearly": day})),
        "avalanche_day": {
            "stations": row.try_get::<u32, _>("stations_needed")?, "quiet": row.try_get::<String, _>("quiet")?,
        },
    });
    Ok(Region {
        id: row.try_get::<String, _>("id")?.parse().map_err(StoreError::corrupt)?,
        body: serde_json::from_value(body).map_err(StoreError::corrupt)?,
        revision: row.try_get("revision")?,
        created: parse_timestamp(row.try_get("created")?)?,
        updated: parse_timestamp(row.try_get("updated")?)?,
    })
}

const fn quiet(quiet: Quiet) -> &'static str {
    match quiet {
        Quiet::EveryStation => "every_station",
        Quiet::AnyStation => "any_station",
    }
}

async fn one(connection: &mut SqliteConnection, id: &RegionId) -> Result<Option<Region>> {
    let query = sqlx::AssertSqlSafe(format!("{REGION} WHERE id = ?"));
    let row = sqlx::query_as::<_, RegionRow>(query).bind(id.as_str()).fetch_optional(connection).await?;
    Ok(row.map(|row| row.0))
}

async fn write_stations(tx: &mut Transaction<'_, Sqlite>, id: &RegionId, stations: &[StationId]) -> Result<()> {
    sqlx::query("DELETE FROM region_station WHERE region = ?").bind(id.as_str()).execute(&mut **tx).await?;
    for (position, station) in (0_i64..).zip(stations) {
        sqlx::query("INSERT INTO region_station (region, station, position) VALUES (?, ?, ?)")
            .bind(id.as_str())
            .bind(station.as_str())
            .bind(position)
            .execute(&mut **tx)
            .await?;
    }
    Ok(())
}

impl Store {
    /// The region of that name.
    ///
    /// # Errors
    /// [`StoreError::Sql`] where the database cannot be read.
    pub async fn region(&self, id: &RegionId) -> Result<Option<Region>> {
        let mut connection = self.reader.acquire().await?;
        one(&mut connection, id).await
    }

    /// Up to `limit` regions in the order of their names, after the name `after`.
    ///
    /// # Errors
    /// [`StoreError::Sql`] where the database cannot be read.
    pub async fn regions(&self, after: &str, limit: u32) -> Result<Vec<Region>> {
        let query = sqlx::AssertSqlSafe(format!("{REGION} WHERE id > ? ORDER BY id LIMIT ?"));
        let rows = sqlx::query_as::<_, RegionRow>(query).bind(after).bind(limit).fetch_all(&self.reader).await?;
        Ok(rows.into_iter().map(|row| row.0).collect())
    }

    /// The regions that a station belongs to, in the order of their names.
    ///
    /// # Errors
    /// [`StoreError::Sql`] where the database cannot be read.
    pub async fn regions_of(&self, station: &StationId) -> Result<Vec<Region>> {
        let query = sqlx::AssertSqlSafe(format!(
            "{REGION} WHERE id IN (SELECT region FROM region_station WHERE station = ?) ORDER BY id"
        ));
        let rows = sqlx::query_as::<_, RegionRow>(query).bind(station.as_str()).fetch_all(&self.reader).await?;
        Ok(rows.into_iter().map(|row| row.0).collect())
    }

    /// Makes or replaces a region, whose stations must exist; `permits` decides on the state before.
    ///
    /// # Errors
    /// [`StoreError::Precondition`] where `permits` says no.
    pub async fn put_region(
        &self,
        id: &RegionId,
        body: &RegionBody,
        actor: &Actor,
        permits: impl FnOnce(Option<&Region>) -> bool,
    ) -> Result<(Region, Written)> {
        let mut tx = self.begin().await?;
        let before = one(&mut tx, id).await?;
        if !permits(before.as_ref()) {
            return Err(StoreError::Precondition);
        }
        let (written, action) = match &before {
            Some(region) if region.body == *body => return Ok((region.clone(), Written::Unchanged)),
            Some(_) => (Written::Updated, Action::RegionChanged),
            None => (Written::Created, Action::RegionCreated),
        };
        sqlx::query(
            "INSERT INTO region (id, name, stations_needed, quiet, retrain, revision, created, updated)
             VALUES (?1, ?2, ?3, ?4, ?6, 1, ?5, ?5)
             ON CONFLICT (id) DO UPDATE SET name = ?2, stations_needed = ?3, quiet = ?4, retrain = ?6, revision = revision + 1,
                 updated = ?5",
        )
        .bind(id.as_str())
        .bind(body.name.as_str())
        .bind(body.avalanche_day.stations)
        .bind(quiet(body.avalanche_day.quiet))
        .bind(actor.at.to_string())
        .bind(body.retrain.map(|retrain| retrain.yearly.to_string()))
        .execute(&mut *tx)
        .await?;
        write_stations(&mut tx, id, &body.stations).await?;
        let entry = NewEntry {
            action,
            target: &format!("/v1/regions/{id}"),
            reason: None,
            before: before.map(|region| serde_json::to_value(region.body)).transpose().map_err(StoreError::corrupt)?,
            after: Some(serde_json::to_value(body).map_err(StoreError::corrupt)?),
        };
        audit::write(&mut tx, actor, entry).await?;
        let region = one(&mut tx, id).await?.ok_or(StoreError::Missing)?;
        tx.commit().await?;
        Ok((region, written))
    }

    /// The days of each station of a region, in the order of its stations, with the avalanche activity of the region as a model
    /// of `label` sees it.
    ///
    /// # Errors
    /// [`StoreError::Sql`] where the database cannot be read.
    pub async fn regional_days(
        &self,
        region: &Region,
        label: Label,
        from: Date,
        to: Date,
    ) -> Result<Vec<Vec<DayRecord>>> {
        let mut stations = Vec::with_capacity(region.body.stations.len());
        for station in &region.body.stations {
            stations.push(self.day_records(station, from, to).await?);
        }
        let days: Vec<&[DayRecord]> = stations.iter().map(Vec::as_slice).collect();
        Ok(regional(&days, region.body.avalanche_day.rule(), label))
    }
}
