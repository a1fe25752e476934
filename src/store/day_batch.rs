//! Days on their way into the database: what changes is decided row by row and written many rows a statement, since each
//! statement is a journey to the thread that owns the database.

use std::{fmt::Write as _, sync::LazyLock};

use firn_science::forecast::day::{VARIABLES, Variable};
use jiff::civil::Date;
use sqlx::{QueryBuilder, Sqlite, Transaction};

use super::{
    Result, StoreError,
    observations::{Author, DayWrite, Revised, StoredDay, Values},
    stations::Written,
    to_json,
};
use crate::domain::{
    avalanche::{AvalancheRecord, activity_name},
    ids::StationId,
    observation::Observation,
};

/// Rows of one statement: with the 19 columns of a day, well below the 32,766 values that SQLite takes.
const ROWS: usize = 500;

/// What is to be written of the days of one station by one author.
pub(super) struct DayBatch<'a> {
    station: &'a StationId,
    author: &'a Author,
    values: Vec<(Date, u32, Values, bool)>,
    avalanches: Vec<(Date, u32, AvalancheRecord)>,
    observation_revisions: Vec<(Date, u32, String)>,
    avalanche_revisions: Vec<(Date, u32, String)>,
}

impl<'a> DayBatch<'a> {
    pub(super) const fn new(station: &'a StationId, author: &'a Author) -> Self {
        Self {
            station,
            author,
            values: Vec::new(),
            avalanches: Vec::new(),
            observation_revisions: Vec::new(),
            avalanche_revisions: Vec::new(),
        }
    }

    /// Takes in a day that is `before` in the database; one that says nothing new makes no revision.
    ///
    /// # Errors
    /// [`StoreError::Observed`] where it is a forecast of weather that was observed.
    pub(super) fn add(&mut self, before: Option<&StoredDay>, day: &DayWrite) -> Result<Written> {
        let mut changed = false;
        let known = before.and_then(|before| Some((before.values.as_ref()?, before.forecast)));
        if day.values.is_some() && day.forecast && known.is_some_and(|(_, forecast)| !forecast) {
            return Err(StoreError::Observed(day.date));
        }
        if let Some(values) = &day.values
            && known.is_none_or(|(known, forecast)| known.value != *values || forecast != day.forecast)
        {
            let revision = known.map_or(0, |(known, _)| known.revision) + 1;
            let mut body = Observation::from_values(values, None).map_err(StoreError::corrupt)?;
            body.forecast = Some(day.forecast);
            self.observation_revisions.push((day.date, revision, to_json(&body)?));
            self.values.push((day.date, revision, *values, day.forecast));
            changed = true;
        }
        if let Some(record) = &day.avalanche
            && let Some(revision) = next(before.and_then(|before| before.avalanche.as_ref()), record)
        {
            self.avalanche_revisions.push((day.date, revision, to_json(record)?));
            self.avalanches.push((day.date, revision, *record));
            changed = true;
        }
        Ok(match (before.is_some(), changed) {
            (false, _) => Written::Created,
            (true, true) => Written::Updated,
            (true, false) => Written::Unchanged,
        })
    }

    /// Writes all of it.
    pub(super) async fn write(self, tx: &mut Transaction<'_, Sqlite>) -> Result<()> {
        let updated = self.author.at.to_string();
        for rows in self.values.chunks(ROWS) {
            let mut query = QueryBuilder::<Sqlite>::new(UPSERT_VALUES.as_str());
            query.push_values(rows, |mut row, (date, revision, values, forecast)| {
                row.push_bind(self.station.as_str()).push_bind(date.to_string());
                for value in values {
                    row.push_bind(*value);
                }
                row.push_bind(*forecast).push_bind(*revision).push_bind(&updated);
            });
            query.build().execute(&mut **tx).await?;
        }
        for rows in self.avalanches.chunks(ROWS) {
            let mut query = QueryBuilder::<Sqlite>::new(
                r#"INSERT OR REPLACE INTO avalanche
                   (station, date, activity, count, type, "trigger", size, revision, updated) "#,
            );
            query.push_values(rows, |mut row, (date, revision, record)| {
                row.push_bind(self.station.as_str())
                    .push_bind(date.to_string())
                    .push_bind(activity_name(record.activity))
                    .push_bind(record.count.map(|count| count.get()))
                    .push_bind(record.r#type.map(|kind| kind.name()))
                    .push_bind(record.trigger.map(|trigger| trigger.name()))
                    .push_bind(record.size.map(f64::from))
                    .push_bind(*revision)
                    .push_bind(&updated);
            });
            query.build().execute(&mut **tx).await?;
        }
        self.write_revisions(tx, "INSERT INTO observation_revision ", &self.observation_revisions).await?;
        self.write_revisions(tx, "INSERT INTO avalanche_revision ", &self.avalanche_revisions).await
    }

    async fn write_revisions(
        &self,
        tx: &mut Transaction<'_, Sqlite>,
        insert: &'static str,
        revisions: &[(Date, u32, String)],
    ) -> Result<()> {
        for rows in revisions.chunks(ROWS) {
            let mut query = QueryBuilder::<Sqlite>::new(insert);
            query.push("(station, date, revision, body, recorded, recorded_by, source) ");
            query.push_values(rows, |mut row, (date, revision, body)| {
                row.push_bind(self.station.as_str())
                    .push_bind(date.to_string())
                    .push_bind(*revision)
                    .push_bind(body)
                    .push_bind(self.author.at.to_string())
                    .push_bind(self.author.name.as_deref())
                    .push_bind(self.author.source);
            });
            query.build().execute(&mut **tx).await?;
        }
        Ok(())
    }
}

/// The number of the revision that `value` makes; none where it says nothing new.
fn next<T: PartialEq>(before: Option<&Revised<T>>, value: &T) -> Option<u32> {
    match before {
        Some(before) if before.value == *value => None,
        before => Some(before.map_or(0, |before| before.revision) + 1),
    }
}

/// `INSERT OR REPLACE` over every variable, written once from the list of variables.
static UPSERT_VALUES: LazyLock<String> = LazyLock::new(|| {
    let mut sql = String::from("INSERT OR REPLACE INTO observation (station, date");
    for variable in Variable::ALL {
        // writing to a String cannot fail
        let _ = write!(sql, ", {}", variable.name());
    }
    sql.push_str(", forecast, revision, updated) ");
    sql
});

const _: () = assert!(ROWS * (VARIABLES + 5) < 32_766, "SQLite takes no more values in a statement");
