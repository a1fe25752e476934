//! Days: what was observed, what avalanches were recorded, and every state that either ever had.

use std::collections::HashMap;

use firn_science::forecast::day::{Activity, DayRecord, VARIABLES, Variable};
use jiff::{Timestamp, civil::Date};
use sqlx::{AssertSqlSafe, FromRow, Row, SqliteConnection, sqlite::SqliteRow};

use super::{
    Result, Store, StoreError, day_batch::DayBatch, from_json, parse_date, parse_timestamp, stations::Written, to_json,
};
use crate::domain::{avalanche::AvalancheRecord, ids::StationId};

/// Values of a day in the order of [`Variable::ALL`].
pub type Values = [Option<f64>; VARIABLES];

/// A day to write; a part that is `None` stays as it is.
#[derive(Clone, Debug, PartialEq)]
pub struct DayWrite {
    /// The station's local day.
    pub date: Date,
    /// Weather and snowpack; replaces all of them.
    pub values: Option<Values>,
    /// True where they are a forecast and no observation.
    pub forecast: bool,
    /// Avalanche activity.
    pub avalanche: Option<AvalancheRecord>,
}

/// Who writes, when, and how it came in.
#[derive(Clone, Debug)]
pub struct Author {
    /// The name of the key, or none where no key was needed.
    pub name: Option<String>,
    /// When.
    pub at: Timestamp,
    /// The call that brought it: `put`, `json`, `ndjson`, `csv`, `sais`.
    pub source: &'static str,
}

/// Something stored with the number of its revision (from 1) and when it last changed.
#[derive(Clone, Debug, PartialEq)]
pub struct Revised<T> {
    /// The thing itself.
    pub value: T,
    /// Counts the changes, from 1.
    pub revision: u32,
    /// When it last changed.
    pub updated: Timestamp,
}

/// Everything that is stored of one day.
#[derive(Clone, Debug, PartialEq)]
pub struct StoredDay {
    /// The station's local day.
    pub date: Date,
    /// Weather and snowpack.
    pub values: Option<Revised<Values>>,
    /// True where they are a forecast and no observation.
    pub forecast: bool,
    /// Avalanche activity.
    pub avalanche: Option<Revised<AvalancheRecord>>,
}

impl StoredDay {
    /// What was observed of it, as the science reads it: a weather forecast of the day is no part of it.
    #[must_use]
    pub fn record(&self) -> DayRecord {
        self.record_of(self.values.as_ref().filter(|_| !self.forecast))
    }

    /// As [`Self::record`], with the weather forecast in the place of what was observed; none where there is no forecast.
    #[must_use]
    pub fn forecast_record(&self) -> Option<DayRecord> {
        Some(self.record_of(Some(self.values.as_ref().filter(|_| self.forecast)?)))
    }

    fn record_of(&self, values: Option<&Revised<Values>>) -> DayRecord {
        let mut record = DayRecord::empty(self.date);
        if let Some(values) = values {
            record.values = values.value;
        }
        if let Some(avalanche) = &self.avalanche {
            record.activity = avalanche.value.activity;
        }
        record
    }
}

/// One earlier or present state of a day's observation or avalanche record.
#[derive(Clone, Debug, PartialEq)]
pub struct Revision {
    /// Its number, from 1.
    pub revision: u32,
    /// What it said.
    pub body: serde_json::Value,
    /// When it was written.
    pub recorded: Timestamp,
    /// By whom.
    pub recorded_by: Option<String>,
    /// Through which call.
    pub source: String,
}

/// Which of the two histories of a day.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// Weather and snowpack.
    Observation,
    /// Avalanche activity.
    Avalanche,
}

struct ValuesRow(Date, Revised<Values>, bool);
struct AvalancheRow(Date, Revised<AvalancheRecord>);
struct RevisionRow(Revision);

macro_rules! decoded_by {
    ($($row:ty: $read:path),+) => {
        $(impl FromRow<'_, SqliteRow> for $row {
            fn from_row(row: &SqliteRow) -> sqlx::Result<Self> {
                $read(row).map_err(|error| sqlx::Error::Decode(Box::new(error)))
            }
        })+
    };
}

decoded_by!(ValuesRow: read_values, AvalancheRow: read_avalanche, RevisionRow: read_revision);

fn read_values(row: &SqliteRow) -> Result<ValuesRow> {
    let mut values = [None; VARIABLES];
    for variable in Variable::ALL {
        values[variable.index()] = row.try_get(variable.name())?;
    }
    let date = parse_date(row.try_get("date")?)?;
    let updated = parse_timestamp(row.try_get("updated")?)?;
    let revised = Revised { value: values, revision: row.try_get("revision")?, updated };
    Ok(ValuesRow(date, revised, row.try_get("forecast")?))
}

fn read_avalanche(row: &SqliteRow) -> Result<AvalancheRow> {
    let body = serde_json::json!({
        "activity": row.try_get::<String, _>("activity")?,
        "count": row.try_get::<Option<u32>, _>("count")?,
        "type": row.try_get::<Option<String>, _>("type")?,
        "trigger": row.try_get::<Option<String>, _>("trigger")?,
        "size": row.try_get::<Option<f64>, _>("size")?,
    });
    let value = serde_json::from_value(body).map_err(StoreError::corrupt)?;
    let date = parse_date(row.try_get("date")?)?;
    let updated = parse_timestamp(row.try_get("updated")?)?;
    Ok(AvalancheRow(date, Revised { value, revision: row.try_get("revision")?, updated }))
}

fn read_revision(row: &SqliteRow) -> Result<RevisionRow> {
    Ok(RevisionRow(Revision {
        revision: row.try_get("revision")?,
        body: from_json(row.try_get("body")?)?,
        recorded: parse_timestamp(row.try_get("recorded")?)?,
        recorded_by: row.try_get("recorded_by")?,
        source: row.try_get("source")?,
    }))
}

/// The days of a station from `from` to `to`, both included, at most `limit` of each table.
async fn select_days(
    connection: &mut SqliteConnection,
    station: &StationId,
    from: Date,
    to: Date,
    limit: u32,
) -> Result<Vec<StoredDay>> {
    let sql = |table: &str| {
        AssertSqlSafe(format!("SELECT * FROM {table} WHERE station = ? AND date BETWEEN ? AND ? ORDER BY date LIMIT ?"))
    };
    let (from, to) = (from.to_string(), to.to_string());
    let values: Vec<ValuesRow> = sqlx::query_as(sql("observation"))
        .bind(station.as_str())
        .bind(&from)
        .bind(&to)
        .bind(limit)
        .fetch_all(&mut *connection)
        .await?;
    let avalanches: Vec<AvalancheRow> = sqlx::query_as(sql("avalanche"))
        .bind(station.as_str())
        .bind(&from)
        .bind(&to)
        .bind(limit)
        .fetch_all(&mut *connection)
        .await?;
    Ok(merge(values, avalanches))
}

/// One list by date from the two sorted ones.
fn merge(values: Vec<ValuesRow>, avalanches: Vec<AvalancheRow>) -> Vec<StoredDay> {
    let mut days: Vec<StoredDay> = values
        .into_iter()
        .map(|ValuesRow(date, values, forecast)| StoredDay { date, values: Some(values), forecast, avalanche: None })
        .collect();
    let mut only_avalanche = Vec::new();
    for AvalancheRow(date, avalanche) in avalanches {
        match days.binary_search_by_key(&date, |day| day.date) {
            Ok(found) => days[found].avalanche = Some(avalanche),
            Err(_) => {
                only_avalanche.push(StoredDay { date, values: None, forecast: false, avalanche: Some(avalanche) });
            }
        }
    }
    if !only_avalanche.is_empty() {
        days.append(&mut only_avalanche);
        days.sort_by_key(|day| day.date);
    }
    days
}

/// The condition that a row has a value of one of `variables`, whose names are ours and not a caller's.
fn any_of(variables: &[Variable]) -> String {
    let names: Vec<String> = variables.iter().map(|variable| format!("{} IS NOT NULL", variable.name())).collect();
    if names.is_empty() { "0".into() } else { format!("({})", names.join(" OR ")) }
}

/// Of a day of an import, what may replace what is known: a table of avalanches alone must not wipe out the weather, nor
/// an export that still says unknown the avalanches that were reported later.
fn without_loss(before: Option<&StoredDay>, day: &DayWrite) -> DayWrite {
    let mut day = day.clone();
    let no_weather = day.values.is_some_and(|values| values.iter().all(Option::is_none));
    if no_weather && (day.avalanche.is_some() || before.is_some()) {
        day.values = None;
    }
    let unknown = day.avalanche.is_some_and(|record| record.activity == Activity::Unknown);
    if unknown && before.is_some_and(|before| before.avalanche.is_some()) {
        day.avalanche = None;
    }
    day
}

/// What a file says of a day, with what is known of variables that no row of the file has: a table of snow heights alone
/// must not wipe out the wind.
fn with_unsaid(before: Option<&StoredDay>, mut day: DayWrite, said: &[bool; VARIABLES]) -> DayWrite {
    // an observation keeps nothing of the forecast that it replaces
    let known = before.filter(|before| before.forecast == day.forecast).and_then(|before| before.values.as_ref());
    if let (Some(values), Some(known)) = (&mut day.values, known) {
        for ((value, known), said) in values.iter_mut().zip(known.value).zip(said) {
            if !said {
                *value = known;
            }
        }
    }
    day
}

/// Which variables at least one of the days has.
fn said(days: &[DayWrite]) -> [bool; VARIABLES] {
    let mut said = [false; VARIABLES];
    for values in days.iter().filter_map(|day| day.values.as_ref()) {
        said.iter_mut().zip(values).for_each(|(said, value)| *said |= value.is_some());
    }
    said
}

impl Store {
    /// Writes all `days` in one transaction and says what became of each; a day that says nothing new makes no revision,
    /// and a part that says nothing at all (no weather, an unknown activity) replaces nothing that is known.
    ///
    /// # Errors
    /// [`StoreError::Sql`], and [`StoreError::Observed`] for a forecast of a day that was observed: then nothing was written.
    pub async fn put_days(&self, station: &StationId, days: &[DayWrite], author: &Author) -> Result<Vec<Written>> {
        self.write_days(station, days, author, &[true; VARIABLES]).await
    }

    /// As [`Store::put_days`], for a file with a column a variable: one that no row has a value of stays as it is known.
    ///
    /// # Errors
    /// As [`Store::put_days`].
    pub async fn merge_days(&self, station: &StationId, days: &[DayWrite], author: &Author) -> Result<Vec<Written>> {
        self.write_days(station, days, author, &said(days)).await
    }

    async fn write_days(
        &self,
        station: &StationId,
        days: &[DayWrite],
        author: &Author,
        said: &[bool; VARIABLES],
    ) -> Result<Vec<Written>> {
        let (Some(from), Some(to)) = (days.iter().map(|d| d.date).min(), days.iter().map(|d| d.date).max()) else {
            return Ok(Vec::new());
        };
        let mut tx = self.begin().await?;
        let known = select_days(&mut tx, station, from, to, u32::MAX).await?;
        let known: HashMap<Date, StoredDay> = known.into_iter().map(|day| (day.date, day)).collect();
        let mut batch = DayBatch::new(station, author);
        let mut written = Vec::with_capacity(days.len());
        for day in days {
            let before = known.get(&day.date);
            let day = with_unsaid(before, without_loss(before, day), said);
            written.push(batch.add(before, &day)?);
        }
        batch.write(&mut tx).await?;
        tx.commit().await?;
        Ok(written)
    }

    /// Writes one day if `permits` agrees with what is there before.
    ///
    /// # Errors
    /// [`StoreError::Precondition`] where it does not, [`StoreError::Observed`] for a forecast of a day that was observed; nothing
    /// was written then.
    pub async fn put_day(
        &self,
        station: &StationId,
        day: &DayWrite,
        author: &Author,
        permits: impl FnOnce(Option<&StoredDay>) -> bool,
    ) -> Result<(StoredDay, Written)> {
        let mut tx = self.begin().await?;
        let before = select_days(&mut tx, station, day.date, day.date, 1).await?.pop();
        if !permits(before.as_ref()) {
            return Err(StoreError::Precondition);
        }
        let mut batch = DayBatch::new(station, author);
        let written = batch.add(before.as_ref(), day)?;
        batch.write(&mut tx).await?;
        let after = select_days(&mut tx, station, day.date, day.date, 1).await?.pop();
        tx.commit().await?;
        Ok((after.ok_or(StoreError::Missing)?, written))
    }

    /// What is stored of one day.
    ///
    /// # Errors
    /// [`StoreError::Sql`] where the database cannot be read.
    pub async fn day(&self, station: &StationId, date: Date) -> Result<Option<StoredDay>> {
        let mut connection = self.reader.acquire().await?;
        Ok(select_days(&mut connection, station, date, date, 1).await?.pop())
    }

    /// The days from `from` to `to`, both included, in order of date, at most `limit`.
    ///
    /// # Errors
    /// [`StoreError::Sql`] where the database cannot be read.
    pub async fn days(&self, station: &StationId, from: Date, to: Date, limit: u32) -> Result<Vec<StoredDay>> {
        // one snapshot for the two tables, so that no day shows half of a concurrent write
        let mut tx = self.reader.begin().await?;
        let mut days = select_days(&mut tx, station, from, to, limit).await?;
        tx.commit().await?;
        days.truncate(limit as usize);
        Ok(days)
    }

    /// All days from `from` to `to`, both included, as the science reads them: what was observed and no weather forecast.
    ///
    /// # Errors
    /// [`StoreError::Sql`] where the database cannot be read.
    pub async fn day_records(&self, station: &StationId, from: Date, to: Date) -> Result<Vec<DayRecord>> {
        let days = self.days(station, from, to, u32::MAX).await?;
        // a day of which there is only a forecast is not there
        let observed = days.iter().filter(|day| !day.forecast || day.avalanche.is_some());
        Ok(observed.map(StoredDay::record).collect())
    }

    /// The avalanche records of a station on these days; a day without one is not among them.
    ///
    /// # Errors
    /// [`StoreError::Sql`] where the database cannot be read.
    pub async fn avalanches_on(&self, station: &StationId, dates: &[Date]) -> Result<HashMap<Date, AvalancheRecord>> {
        let dates: Vec<String> = dates.iter().map(Date::to_string).collect();
        let rows: Vec<AvalancheRow> =
            sqlx::query_as("SELECT * FROM avalanche WHERE station = ? AND date IN (SELECT value FROM json_each(?))")
                .bind(station.as_str())
                .bind(to_json(&dates)?)
                .fetch_all(&self.reader)
                .await?;
        Ok(rows.into_iter().map(|AvalancheRow(date, record)| (date, record.value)).collect())
    }

    /// The newest day until `until` that has a value of one of `variables`, if there is any.
    ///
    /// # Errors
    /// [`StoreError::Sql`] where the database cannot be read.
    pub async fn last_observation(
        &self,
        station: &StationId,
        variables: &[Variable],
        until: Date,
    ) -> Result<Option<Date>> {
        let sql = format!(
            "SELECT max(date) FROM observation WHERE station = ? AND date <= ? AND forecast = 0 AND {}",
            any_of(variables)
        );
        let date: Option<String> = sqlx::query_scalar(AssertSqlSafe(sql))
            .bind(station.as_str())
            .bind(until.to_string())
            .fetch_one(&self.reader)
            .await?;
        date.as_deref().map(parse_date).transpose()
    }

    /// The day nearest to `date` that has a value of one of `variables`: what a mistyped date may have meant.
    ///
    /// # Errors
    /// [`StoreError::Sql`] where the database cannot be read.
    pub async fn nearest_observation(
        &self,
        station: &StationId,
        variables: &[Variable],
        date: Date,
    ) -> Result<Option<Date>> {
        let sql = format!(
            "SELECT date FROM observation WHERE station = ?1 AND forecast = 0 AND {}
             ORDER BY abs(julianday(date) - julianday(?2)), date LIMIT 1",
            any_of(variables)
        );
        let date: Option<String> = sqlx::query_scalar(AssertSqlSafe(sql))
            .bind(station.as_str())
            .bind(date.to_string())
            .fetch_optional(&self.reader)
            .await?;
        date.as_deref().map(parse_date).transpose()
    }

    /// Every state that a day's observation or avalanche record ever had, oldest first.
    ///
    /// # Errors
    /// [`StoreError::Sql`] where the database cannot be read.
    pub async fn revisions(&self, station: &StationId, date: Date, part: Part) -> Result<Vec<Revision>> {
        let sql = match part {
            Part::Observation => "SELECT * FROM observation_revision WHERE station = ? AND date = ? ORDER BY revision",
            Part::Avalanche => "SELECT * FROM avalanche_revision WHERE station = ? AND date = ? ORDER BY revision",
        };
        let rows: Vec<RevisionRow> =
            sqlx::query_as(sql).bind(station.as_str()).bind(date.to_string()).fetch_all(&self.reader).await?;
        Ok(rows.into_iter().map(|row| row.0).collect())
    }
}
