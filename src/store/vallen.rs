//! Databases of Vallen recorders, read only: `.pridb` (hits) and `.tradb` (waveforms). They are SQLite files of their own and
//! have nothing to do with ours, but SQL stands only here.
//!
//! The views that Vallen's programs put beside the tables may be missing, so that the tables are joined here: `ae_data` with
//! `ae_params` (what a count of the converter is) and `ae_globalinfo` (the clock); `tr_data` with `tr_params` alike.

use std::{collections::BTreeMap, path::Path};

use futures_util::TryStreamExt as _;
use sqlx::{
    AssertSqlSafe, ConnectOptions as _, Connection as _, Row as _, SqliteConnection, sqlite::SqliteConnectOptions,
};

use crate::science::emission::catalogue::Column;

/// A database that is none of Vallen's, or is broken.
#[derive(Debug, thiserror::Error)]
pub enum VallenError {
    /// SQLite cannot read it.
    #[error("the database cannot be read: {0}")]
    Sql(#[from] sqlx::Error),
    /// The file could not be opened.
    #[error("{0}")]
    Io(#[from] std::io::Error),
    /// It is not what it should be.
    #[error("{0}")]
    Content(String),
    /// More rows than are accepted.
    #[error("more than {0} rows")]
    TooMany(usize),
}

/// Shorthand of this module.
type Result<T> = std::result::Result<T, VallenError>;

/// The hits of a `.pridb`.
#[derive(Clone, Debug, PartialEq)]
pub struct Hits {
    /// The columns that every hit has.
    pub columns: BTreeMap<Column, Vec<f64>>,
    /// Test pulses, which are left out.
    pub test_pulses: usize,
    /// Hits that the recorder marked as saturated.
    pub saturated: usize,
    /// Columns of the file that are not read, or that some hit has not.
    pub ignored: Vec<String>,
}

/// A stretch of waveform of a `.tradb`.
#[derive(Clone, Debug, PartialEq)]
pub struct Record {
    /// Time of the first sample, s.
    pub start_s: f64,
    /// Number of the channel.
    pub channel: u32,
    /// Samples a second, Hz.
    pub rate_hz: f64,
    /// Volts of one count.
    pub volts: f64,
    /// 0: counts as 16-bit numbers; 2: the same packed as FLAC.
    pub format: i64,
    /// The bytes.
    pub data: Vec<u8>,
}

/// Status bits of the recorder.
const SATURATED: i64 = 1 << 4;
const TEST_PULSE: i64 = 1 << 6 | 1 << 11;

async fn open(path: &Path) -> Result<SqliteConnection> {
    whole(path)?;
    // immutable: nobody writes to it, and no file may appear beside it
    let options = SqliteConnectOptions::new().filename(path).read_only(true).immutable(true);
    Ok(options.pragma("trusted_schema", "OFF").connect().await?)
}

/// Refuses a file that is shorter than its own header says: SQLite would read as far as it goes.
fn whole(path: &Path) -> Result<()> {
    use std::io::Read as _;
    let mut header = [0; 100];
    let mut file = std::fs::File::open(path)?;
    let size = file.metadata()?.len();
    let broken = |what: &str| Err(VallenError::Content(what.into()));
    if file.read_exact(&mut header).is_err() || !header.starts_with(b"SQLite format 3\0") {
        return broken("it is no SQLite database");
    }
    // sqlite.org/fileformat.html: page size at offset 16 (1 stands for 65536), pages at offset 28
    let page = match u16::from_be_bytes([header[16], header[17]]) {
        1 => 65_536,
        size => u64::from(size),
    };
    let pages = u64::from(u32::from_be_bytes([header[28], header[29], header[30], header[31]]));
    if pages * page > size {
        return broken("the file was cut: it is shorter than its header says");
    }
    Ok(())
}

/// The columns of a table, by the names that it gives them.
async fn columns(connection: &mut SqliteConnection, table: &str) -> Result<Vec<String>> {
    let names: Vec<String> =
        sqlx::query_scalar("SELECT name FROM pragma_table_info(?)").bind(table).fetch_all(connection).await?;
    if names.is_empty() {
        return Err(VallenError::Content(format!("there is no table {table}")));
    }
    Ok(names)
}

/// The clock, ticks a second.
async fn time_base(connection: &mut SqliteConnection, table: &str) -> Result<f64> {
    let sql = format!("SELECT CAST(Value AS REAL) FROM {table} WHERE Key = 'TimeBase'");
    let found: Option<Option<f64>> = sqlx::query_scalar(AssertSqlSafe(sql)).fetch_optional(connection).await?;
    let found = found.flatten().filter(|base| base.is_finite() && *base > 0.0);
    found.ok_or_else(|| VallenError::Content(format!("{table} has no TimeBase above 0")))
}

/// `ADC_µV` is written with one micro sign or the other.
fn volts_column(names: &[String]) -> Result<String> {
    let found = names.iter().find(|name| name.starts_with("ADC_") && name.ends_with('V'));
    let found = found.ok_or_else(|| VallenError::Content("ae_params has no column ADC_µV".into()))?;
    Ok(found.replace('"', "\"\""))
}

/// A column of `ae_data` as a number of the catalogue.
struct Field {
    name: &'static str,
    column: Column,
    /// SQL of the value in the unit of the column; `{base}` is the clock, `{volts}` the microvolts of a count.
    value: &'static str,
    needed: bool,
}

const FIELDS: [Field; 8] = [
    Field { name: "Time", column: Column::TimeS, value: "d.Time / {base}", needed: true },
    Field { name: "Amp", column: Column::AmplitudeV, value: "d.Amp * p.{volts} * 1e-6", needed: true },
    Field { name: "Dur", column: Column::DurationUs, value: "d.Dur * 1e6 / {base}", needed: false },
    Field { name: "RiseT", column: Column::RiseTimeUs, value: "d.RiseT * 1e6 / {base}", needed: false },
    Field { name: "Counts", column: Column::Counts, value: "d.Counts", needed: false },
    Field { name: "Eny", column: Column::EnergyEu, value: "d.Eny * p.ADC_TE", needed: false },
    Field { name: "Chan", column: Column::Channel, value: "d.Chan", needed: false },
    Field { name: "Thr", column: Column::ThresholdDb, value: "d.Thr * p.{volts}", needed: false },
];

/// Reads the hits of a `.pridb` in the order of time: amplitudes in V at the sensor.
///
/// # Errors
/// [`VallenError`], also for more than `most` hits.
pub async fn read_hits(path: &Path, most: usize) -> Result<Hits> {
    let mut connection = open(path).await?;
    let there = columns(&mut connection, "ae_data").await?;
    let parameters = columns(&mut connection, "ae_params").await?;
    let volts = format!("\"{}\"", volts_column(&parameters)?);
    let base = format!("{:e}", time_base(&mut connection, "ae_globalinfo").await?);
    let has = |names: &[String], name: &str| names.iter().any(|other| other == name);
    if let Some(missing) = FIELDS.iter().find(|field| field.needed && !has(&there, field.name)) {
        return Err(VallenError::Content(format!("ae_data has no column {}", missing.name)));
    }
    let usable =
        |field: &&Field| has(&there, field.name) && (!field.value.contains("ADC_TE") || has(&parameters, "ADC_TE"));
    let fields: Vec<&Field> = FIELDS.iter().filter(usable).collect();
    let values: Vec<String> = fields
        .iter()
        .map(|field| format!("CAST({} AS REAL)", field.value.replace("{base}", &base).replace("{volts}", &volts)))
        .collect();
    let status = if has(&there, "Status") { "coalesce(d.Status, 0)" } else { "0" };
    // 2 is a hit; 1, 3 and more are parametric sets, states and markers
    let sql = format!(
        "SELECT {status}, {} FROM ae_data AS d LEFT JOIN ae_params AS p ON p.ID = d.ParamID WHERE d.SetType = 2
         ORDER BY d.Time, d.SetID",
        values.join(", ")
    );
    let mut found: Vec<Vec<f64>> = vec![Vec::new(); fields.len()];
    let (mut test_pulses, mut saturated) = (0, 0);
    let mut rows = sqlx::query(AssertSqlSafe(sql)).fetch(&mut connection);
    while let Some(row) = rows.try_next().await? {
        let status: i64 = row.try_get(0)?;
        if status & TEST_PULSE != 0 {
            test_pulses += 1;
            continue;
        }
        saturated += usize::from(status & SATURATED != 0);
        for (place, values) in found.iter_mut().enumerate() {
            values.push(row.try_get::<Option<f64>, _>(place + 1)?.unwrap_or(f64::NAN));
        }
        if found.first().is_some_and(|values| values.len() > most) {
            return Err(VallenError::TooMany(most));
        }
    }
    drop(rows);
    connection.close().await?;
    let mut ignored: Vec<String> =
        there.into_iter().filter(|name| !fields.iter().any(|field| field.name == name)).collect();
    let mut columns = BTreeMap::new();
    for (field, mut values) in fields.into_iter().zip(found) {
        if field.column == Column::ThresholdDb {
            values.iter_mut().for_each(|microvolts| *microvolts = 20.0 * microvolts.log10());
        }
        // what some hits have not is of no use for any analysis
        if !field.needed && values.iter().any(|value| !value.is_finite()) {
            ignored.push(field.name.to_owned());
        } else {
            columns.insert(field.column, values);
        }
    }
    Ok(Hits { columns, test_pulses, saturated, ignored })
}

/// Reads the waveforms of a `.tradb` in the order of time and hands each to `take`.
///
/// # Errors
/// [`VallenError`], and what `take` refuses.
pub async fn read_waveforms(
    path: &Path,
    mut take: impl FnMut(Record) -> std::result::Result<(), String>,
) -> Result<()> {
    let mut connection = open(path).await?;
    for (table, needed) in [
        ("tr_data", &["Time", "Chan", "Pretrigger", "SampleRate", "DataFormat", "Data", "ParamID", "SetID"][..]),
        ("tr_params", &["ID", "TR_mV"][..]),
    ] {
        let there = columns(&mut connection, table).await?;
        if let Some(missing) = needed.iter().find(|name| !there.iter().any(|other| other == *name)) {
            return Err(VallenError::Content(format!("{table} has no column {missing}")));
        }
    }
    let base = time_base(&mut connection, "tr_globalinfo").await?;
    let mut rows = sqlx::query(
        "SELECT CAST(d.Time AS REAL) AS time, coalesce(d.Chan, 0) AS chan, CAST(coalesce(d.Pretrigger, 0) AS REAL) AS before,
                CAST(d.SampleRate AS REAL) AS rate, d.DataFormat AS format, d.Data AS data, CAST(p.TR_mV AS REAL) AS mv
         FROM tr_data AS d LEFT JOIN tr_params AS p ON p.ID = d.ParamID ORDER BY d.Time, d.SetID",
    )
    .fetch(&mut connection);
    while let Some(row) = rows.try_next().await? {
        let number = |name: &str| -> Result<f64> {
            let value = row.try_get::<Option<f64>, _>(name)?.filter(|value| value.is_finite());
            value.ok_or_else(|| VallenError::Content(format!("a record without {name}")))
        };
        let rate_hz = number("rate")?;
        if rate_hz <= 0.0 {
            return Err(VallenError::Content("a record with a sample rate that is not above 0".into()));
        }
        let record = Record {
            start_s: number("time")? / base - number("before")? / rate_hz,
            channel: u32::try_from(row.try_get::<i64, _>("chan")?).unwrap_or(0),
            rate_hz,
            volts: number("mv")? * 1e-3,
            format: row.try_get("format")?,
            data: row.try_get("data")?,
        };
        take(record).map_err(VallenError::Content)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A `.pridb` as vallenae 0.11 lays it out, without its views: three hits, a test pulse and a parametric set.
    async fn pridb(path: &Path) {
        let mut connection =
            SqliteConnectOptions::new().filename(path).create_if_missing(true).connect().await.unwrap();
        for statement in [
            "CREATE TABLE ae_data (SetID INTEGER PRIMARY KEY, SetType INT, Time INT, Chan INT, Status INT, ParamID INT, Thr INT,
                 Amp INT, RiseT INT, Dur INT, Eny INT, SS INT, RMS INT, Counts INT, TRAI INT)",
            "CREATE TABLE ae_params (ID INTEGER PRIMARY KEY, SetupID INT, Chan INT, \"ADC_µV\" REAL, ADC_TE REAL, ADC_SS REAL)",
            "CREATE TABLE ae_fieldinfo (field, Unit, SetTypes, Parameter, Factor)",
            "CREATE TABLE ae_globalinfo (Key UNIQUE, Value)",
            "INSERT INTO ae_globalinfo VALUES ('Version', 1), ('TimeBase', 10000000)",
            "INSERT INTO ae_params VALUES (1, 1, 1, 0.5, 0.25, 1), (2, 1, 2, 2.0, 0.25, 1)",
            // times fall between channels, as they may
            "INSERT INTO ae_data VALUES
                 (1, 1, 5000000, NULL, 0, 1, NULL, NULL, NULL, NULL, NULL, NULL, NULL, NULL, NULL),
                 (2, 2, 20000000, 1, 0, 1, 200, 2000, 100, 3000, 400, 1, 1, 7, NULL),
                 (3, 2, 10000000, 2, 16, 2, 50, 1000, 20, 500, 80, 1, 1, 3, NULL),
                 (4, 2, 25000000, 2, 64, 2, 50, 1000, 20, 500, 80, 1, 1, 3, NULL),
                 (5, 2, 30000000, 1, 0, 1, 200, 4000, NULL, 700, 90, 1, 1, 9, NULL)",
        ] {
            sqlx::query(statement).execute(&mut connection).await.unwrap();
        }
        connection.close().await.unwrap();
    }

    #[tokio::test]
    async fn hits_are_joined_with_what_a_count_is() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.pridb");
        pridb(&path).await;
        let hits = read_hits(&path, 100).await.unwrap();
        let close = |column: Column, expected: &[f64]| {
            let found = &hits.columns[&column];
            assert_eq!(found.len(), expected.len());
            for (a, b) in found.iter().zip(expected) {
                assert!((a - b).abs() < 1e-9 * b.abs().max(1e-3), "{column:?}: {found:?}");
            }
        };
        close(Column::TimeS, &[1.0, 2.0, 3.0]);
        close(Column::AmplitudeV, &[2e-3, 1e-3, 2e-3]);
        close(Column::DurationUs, &[50.0, 300.0, 70.0]);
        close(Column::EnergyEu, &[20.0, 100.0, 22.5]);
        // 100 uV are 40 dB_AE
        close(Column::ThresholdDb, &[40.0, 40.0, 40.0]);
        close(Column::Channel, &[2.0, 1.0, 1.0]);
        assert_eq!((hits.test_pulses, hits.saturated), (1, 1));
        // one hit has no rise time
        assert!(!hits.columns.contains_key(&Column::RiseTimeUs) && hits.ignored.contains(&"RiseT".to_owned()));
        assert!(matches!(read_hits(&path, 2).await, Err(VallenError::TooMany(2))));
    }

    #[tokio::test]
    async fn a_file_that_was_cut_or_is_another_says_so() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.pridb");
        pridb(&path).await;
        let whole = std::fs::read(&path).unwrap();
        for cut in [0, 50, 100, 4096, whole.len() - 1] {
            std::fs::write(&path, &whole[..cut]).unwrap();
            let said = read_hits(&path, 100).await.unwrap_err().to_string();
            assert!(said.contains("cut") || said.contains("no SQLite"), "{cut}: {said}");
        }
        // overwritten in the middle
        let mut wrong = whole.clone();
        wrong[4096..8192].fill(0xa5);
        std::fs::write(&path, wrong).unwrap();
        assert!(read_hits(&path, 100).await.is_err());
        let other = folder.path().join("b.db");
        let mut connection =
            SqliteConnectOptions::new().filename(&other).create_if_missing(true).connect().await.unwrap();
        sqlx::query("CREATE TABLE a (b)").execute(&mut connection).await.unwrap();
        connection.close().await.unwrap();
        assert_eq!(read_hits(&other, 100).await.unwrap_err().to_string(), "there is no table ae_data");
    }
}
