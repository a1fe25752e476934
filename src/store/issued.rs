//! What was said in service: issued forecasts, which nothing changes any more, and the forecaster's own calls.

use firn_science::forecast::day::Label;
use jiff::{Timestamp, civil::Date};
use serde_json::Value;
use sqlx::{FromRow, Row, sqlite::SqliteRow};
use uuid::Uuid;

use super::{Result, Store, StoreError, from_json, parse_date, parse_timestamp, stations::Written, to_json};
use crate::domain::ids::{RegionId, StationId};

/// A forecast as it was issued.
#[derive(Clone, Debug, PartialEq)]
pub struct IssuedForecast {
    /// The day that was forecast.
    pub date: Date,
    /// Days between the last observation and that day.
    pub lead: u8,
    /// Whether the weather of the day was a forecast.
    pub forecast_weather: bool,
    /// The model that spoke.
    pub model: Uuid,
    /// The region whose avalanche day was forecast; none: the station's own.
    pub region: Option<RegionId>,
    /// Probability of an avalanche day.
    pub probability: f64,
    /// Whether it reached the threshold.
    pub warned: bool,
    /// Base rate of the training of the model.
    pub base_rate: f64,
    /// What counted as an avalanche day.
    pub label: Label,
    /// True where it was issued after the day had ended.
    pub hindcast: bool,
    /// The forecast as it was answered.
    pub body: Value,
    /// The past days that were nearest to it, as they were answered.
    pub similar_days: Value,
    /// When.
    pub issued: Timestamp,
    /// By whom; none where no key was needed.
    pub issued_by: Option<String>,
}

/// What the forecaster said of a day.
#[derive(Clone, Debug, PartialEq)]
pub struct ForecasterCall {
    /// The day.
    pub date: Date,
    /// Days between the last observation and that day.
    pub lead: u8,
    /// Whether an avalanche day was forecast.
    pub warned: bool,
    /// With what probability, if one was given.
    pub probability: Option<f64>,
    /// Danger level on the European scale, 1 to 5, if one was set.
    pub danger_level: Option<u8>,
    /// In words.
    pub note: Option<String>,
    /// True where it was made after the day had ended.
    pub hindcast: bool,
    /// Counts the changes, from 1.
    pub revision: u32,
    /// When.
    pub made: Timestamp,
    /// By whom; none where no key was needed.
    pub made_by: Option<String>,
}

struct IssuedRow(IssuedForecast);
struct CallRow(ForecasterCall);

impl FromRow<'_, SqliteRow> for IssuedRow {
    fn from_row(row: &SqliteRow) -> sqlx::Result<Self> {
        read_issued(row).map(Self).map_err(|error| sqlx::Error::Decode(Box::new(error)))
    }
}

impl FromRow<'_, SqliteRow> for CallRow {
    fn from_row(row: &SqliteRow) -> sqlx::Result<Self> {
        read_call(row).map(Self).map_err(|error| sqlx::Error::Decode(Box::new(error)))
    }
}

fn read_issued(row: &SqliteRow) -> Result<IssuedForecast> {
    Ok(IssuedForecast {
        date: parse_date(row.try_get("date")?)?,
        lead: row.try_get("lead")?,
        forecast_weather: row.try_get::<String, _>("weather")? == weather(true),
        model: row.try_get::<String, _>("model")?.parse().map_err(StoreError::corrupt)?,
        region: row
            .try_get::<Option<String>, _>("region")?
            .map(|region| region.parse().map_err(StoreError::corrupt))
            .transpose()?,
        probability: row.try_get("probability")?,
        warned: row.try_get("warned")?,
        base_rate: row.try_get("base_rate")?,
        label: match row.try_get("label")? {
            "observed" => Label::Observed,
            "presumed" => Label::Presumed,
            other => return Err(StoreError::corrupt(other)),
        },
        hindcast: row.try_get("hindcast")?,
        body: from_json(row.try_get("body")?)?,
        similar_days: from_json(row.try_get("similar")?)?,
        issued: parse_timestamp(row.try_get("issued")?)?,
        issued_by: row.try_get("issued_by")?,
    })
}

fn read_call(row: &SqliteRow) -> Result<ForecasterCall> {
    Ok(ForecasterCall {
        date: parse_date(row.try_get("date")?)?,
        lead: row.try_get("lead")?,
        warned: row.try_get("warned")?,
        probability: row.try_get("probability")?,
        danger_level: row.try_get("danger_level")?,
        note: row.try_get("note")?,
        hindcast: row.try_get("hindcast")?,
        revision: row.try_get("revision")?,
        made: parse_timestamp(row.try_get("made")?)?,
        made_by: row.try_get("made_by")?,
    })
}

/// How the weather of the day itself is called.
const fn weather(forecast: bool) -> &'static str {
    if forecast { "forecast" } else { "observed" }
}

impl Store {
    /// Freezes a forecast; false, and nothing written, where one of that day, lead and kind of weather is frozen already.
    ///
    /// # Errors
    /// [`StoreError::Sql`] where the database cannot be written.
    pub async fn issue_forecast(&self, station: &StationId, forecast: &IssuedForecast) -> Result<bool> {
        let label = match forecast.label {
            Label::Observed => "observed",
            Label::Presumed => "presumed",
        };
        let mut tx = self.begin().await?;
        let done = sqlx::query(
            "INSERT INTO issued_forecast
                 (station, date, lead, weather, model, region, probability, warned, base_rate, label, hindcast, body, similar,
                  issued, issued_by)
             VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?) ON CONFLICT DO NOTHING",
        )
        .bind(station.as_str())
        .bind(forecast.date.to_string())
        .bind(forecast.lead)
        .bind(weather(forecast.forecast_weather))
        .bind(forecast.model.to_string())
        .bind(forecast.region.as_ref().map(RegionId::as_str))
        .bind(forecast.probability)
        .bind(forecast.warned)
        .bind(forecast.base_rate)
        .bind(label)
        .bind(forecast.hindcast)
        .bind(to_json(&forecast.body)?)
        .bind(to_json(&forecast.similar_days)?)
        .bind(forecast.issued.to_string())
        .bind(forecast.issued_by.as_deref())
        .execute(&mut *tx)
        .await?;
        tx.commit().await?;
        Ok(done.rows_affected() == 1)
    }

    /// The issued forecast of a day, if there is one.
    ///
    /// # Errors
    /// [`StoreError::Sql`] where the database cannot be read.
    pub async fn issued_forecast(
        &self,
        station: &StationId,
        date: Date,
        lead: u8,
        forecast_weather: bool,
    ) -> Result<Option<IssuedForecast>> {
        Ok(self.issued_forecasts(station, date, date, lead, forecast_weather).await?.pop())
    }

    /// The issued forecasts of the days from `from` to `to`, in their order: those that read a weather forecast of their day, or
    /// those that did not.
    ///
    /// # Errors
    /// [`StoreError::Sql`] where the database cannot be read.
    pub async fn issued_forecasts(
        &self,
        station: &StationId,
        from: Date,
        to: Date,
        lead: u8,
        forecast_weather: bool,
    ) -> Result<Vec<IssuedForecast>> {
        let rows: Vec<IssuedRow> = sqlx::query_as(
            "SELECT * FROM issued_forecast
             WHERE station = ? AND lead = ? AND weather = ? AND date BETWEEN ? AND ? ORDER BY date",
        )
        .bind(station.as_str())
        .bind(lead)
        .bind(weather(forecast_weather))
        .bind(from.to_string())
        .bind(to.to_string())
        .fetch_all(&self.reader)
        .await?;
        Ok(rows.into_iter().map(|row| row.0).collect())
    }

    /// All issued forecasts of the days from `from` to `to`, of every lead and kind of weather.
    ///
    /// # Errors
    /// [`StoreError::Sql`] where the database cannot be read.
    pub async fn issued_between(&self, station: &StationId, from: Date, to: Date) -> Result<Vec<IssuedForecast>> {
        let rows: Vec<IssuedRow> =
            sqlx::query_as("SELECT * FROM issued_forecast WHERE station = ? AND date BETWEEN ? AND ? ORDER BY date")
                .bind(station.as_str())
                .bind(from.to_string())
                .bind(to.to_string())
                .fetch_all(&self.reader)
                .await?;
        Ok(rows.into_iter().map(|row| row.0).collect())
    }

    /// The forecaster's calls of the days from `from` to `to`, in their order.
    ///
    /// # Errors
    /// [`StoreError::Sql`] where the database cannot be read.
    pub async fn forecaster_calls(
        &self,
        station: &StationId,
        from: Date,
        to: Date,
        lead: u8,
    ) -> Result<Vec<ForecasterCall>> {
        let rows: Vec<CallRow> = sqlx::query_as(
            "SELECT * FROM forecaster_call WHERE station = ? AND lead = ? AND date BETWEEN ? AND ? ORDER BY date",
        )
        .bind(station.as_str())
        .bind(lead)
        .bind(from.to_string())
        .bind(to.to_string())
        .fetch_all(&self.reader)
        .await?;
        Ok(rows.into_iter().map(|row| row.0).collect())
    }

    /// Writes a forecaster's call if `permits` agrees with the one before; its revision is counted here.
    ///
    /// # Errors
    /// [`StoreError::Precondition`] where it does not.
    pub async fn put_forecaster_call(
        &self,
        station: &StationId,
        call: &ForecasterCall,
        permits: impl FnOnce(Option<&ForecasterCall>) -> bool,
    ) -> Result<(ForecasterCall, Written)> {
        let mut tx = self.begin().await?;
        let before: Option<CallRow> =
            sqlx::query_as("SELECT * FROM forecaster_call WHERE station = ? AND date = ? AND lead = ?")
                .bind(station.as_str())
                .bind(call.date.to_string())
                .bind(call.lead)
                .fetch_optional(&mut *tx)
                .await?;
        let before = before.map(|row| row.0);
        if !permits(before.as_ref()) {
            return Err(StoreError::Precondition);
        }
        let row: CallRow = sqlx::query_as(
            "INSERT OR REPLACE INTO forecaster_call
                 (station, date, lead, warned, probability, danger_level, note, hindcast, revision, made, made_by)
             VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?) RETURNING *",
        )
        .bind(station.as_str())
        .bind(call.date.to_string())
        .bind(call.lead)
        .bind(call.warned)
        .bind(call.probability)
        .bind(call.danger_level)
        .bind(call.note.as_deref())
        .bind(call.hindcast)
        .bind(before.as_ref().map_or(1, |before| before.revision + 1))
        .bind(call.made.to_string())
        .bind(call.made_by.as_deref())
        .fetch_one(&mut *tx)
        .await?;
        tx.commit().await?;
        Ok((row.0, if before.is_some() { Written::Updated } else { Written::Created }))
    }
}
