//! All SQL. SQLite in WAL mode is the truth: one writer connection, several readers, every write a transaction that is
//! on disk before anybody is told of it.

pub mod audit;
pub mod datasets;
mod day_batch;
pub mod issued;
pub mod jobs;
pub mod keys;
#[cfg(test)]
mod migration_tests;
pub mod models;
pub mod observations;
pub mod proposals;
pub mod regions;
pub mod selections;
pub mod stations;
pub mod transfers;
pub mod vallen;

use std::{
    fs::{File, TryLockError},
    io::{ErrorKind, Read as _},
    path::{Path, PathBuf},
    sync::Arc,
    time::Duration,
};

use firn_science::forecast::model::TrainedModel;
use jiff::{Timestamp, civil::Date};
use quick_cache::sync::Cache;
use sqlx::{
    Sqlite, SqlitePool, Transaction,
    sqlite::{SqliteConnectOptions, SqliteJournalMode, SqlitePoolOptions, SqliteSynchronous},
};
use uuid::Uuid;

use crate::domain::ids::new_id;

/// Trained models that are kept ready; one takes about a MiB.
const MODELS_IN_MEMORY: usize = 128;

/// Older releases can corrupt a WAL database when two connections write and checkpoint at the same instant
/// (sqlite.org/wal.html, "WAL-reset bug").
const OLDEST_SAFE_SQLITE: [u32; 3] = [3, 51, 3];

/// Marks a file as ours in the header of SQLite: "firn" in ASCII.
const APPLICATION_ID: u32 = 0x6669_726e;
const OURS: [u8; 4] = APPLICATION_ID.to_be_bytes();

/// What can go wrong between us and the database.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// The database said no.
    #[error("database: {0}")]
    Sql(#[from] sqlx::Error),
    /// The schema could not be brought up to date.
    #[error("migration: {0}")]
    Migrate(#[from] sqlx::migrate::MigrateError),
    /// A file of the data directory could not be used.
    #[error("{path}: {source}")]
    Io {
        /// Which file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// Another process works on the same data directory.
    #[error("{0} is in use by another firn process")]
    Locked(PathBuf),
    /// The file is a database of another program.
    #[error("{0} is not a database of firn")]
    Foreign(PathBuf),
    /// The linked SQLite is one that can corrupt its file.
    #[error("SQLite {0} can corrupt a WAL database; 3.51.3 or later is needed")]
    UnsafeSqlite(String),
    /// A row holds what no version of ours writes.
    #[error("corrupt row: {0}")]
    Corrupt(String),
    /// A change that the state machine of jobs forbids.
    #[error(transparent)]
    Transition(#[from] crate::domain::job::TransitionError),
    /// The attempt counts no more: the job ended, or another worker has taken it.
    #[error("the attempt counts no more")]
    Fenced,
    /// Another key has the name.
    #[error("there is a key named {0} already; a name stands for one key, so that the history tells who wrote")]
    NameTaken(String),
    /// `If-Match` or `If-None-Match` does not hold.
    #[error("the precondition does not hold")]
    Precondition,
    /// The job is part of another one and goes with it.
    #[error("the job is part of job {0}")]
    Child(Uuid),
    /// A weather forecast of a day that was observed.
    #[error("{0} was observed")]
    Observed(Date),
    /// The row that should change is not there.
    #[error("no such row")]
    Missing,
}

impl StoreError {
    fn corrupt(what: impl std::fmt::Display) -> Self {
        Self::Corrupt(what.to_string())
    }
}

/// Shorthand of this module.
pub type Result<T> = std::result::Result<T, StoreError>;

/// The open database; clones share it.
#[derive(Clone)]
pub struct Store {
    writer: SqlitePool,
    reader: SqlitePool,
    trained: Arc<Cache<Uuid, Arc<TrainedModel>>>,
}

impl Store {
    /// Opens (and creates or migrates) the database of `data_dir`.
    ///
    /// # Errors
    /// [`StoreError`] where the directory cannot be written, is in use, or holds something else.
    pub async fn open(data_dir: &Path) -> Result<Self> {
        create_directory(data_dir)?;
        let path = data_dir.join("firn.db");
        refuse_foreign(&path)?;
        create_private(&path)?;
        let options = SqliteConnectOptions::new()
            .filename(&path)
            .create_if_missing(true)
            .journal_mode(SqliteJournalMode::Wal)
            .synchronous(SqliteSynchronous::Full)
            .foreign_keys(true)
            .busy_timeout(Duration::from_secs(5))
            .optimize_on_close(true, None);
        let writer = SqlitePoolOptions::new().max_connections(1).connect_with(options.clone()).await?;
        check_library(&writer).await?;
        claim_file(&writer, &path).await?;
        sqlx::migrate!("./migrations").run(&writer).await?;
        sqlx::query("INSERT OR IGNORE INTO instance (only_row, id) VALUES (1, ?)")
            .bind(new_id().to_string())
            .execute(&writer)
            .await?;
        let reader = SqlitePoolOptions::new().max_connections(4).connect_with(options.read_only(true)).await?;
        Ok(Self { writer, reader, trained: Arc::new(Cache::new(MODELS_IN_MEMORY)) })
    }

    /// Which service the database is of: the same after a restart, and of nobody else but a copy of it.
    ///
    /// # Errors
    /// [`StoreError::Sql`] where the database cannot be read.
    pub async fn instance(&self) -> Result<Uuid> {
        let id: String = sqlx::query_scalar("SELECT id FROM instance").fetch_one(&self.reader).await?;
        id.parse().map_err(StoreError::corrupt)
    }

    /// Ends every connection after a last checkpoint.
    pub async fn close(&self) {
        self.reader.close().await;
        self.writer.close().await;
    }

    /// Proves that the database can be written now.
    ///
    /// # Errors
    /// [`StoreError::Sql`] where it cannot.
    pub async fn check(&self) -> Result<()> {
        let transaction = self.begin().await?;
        transaction.rollback().await?;
        sqlx::query("SELECT 1").execute(&self.reader).await?;
        Ok(())
    }

    /// A write transaction that holds the write lock from its first statement, so that it cannot fail half-way for
    /// being late.
    async fn begin(&self) -> Result<Transaction<'static, Sqlite>> {
        Ok(self.writer.begin_with("PRAGMA synchronous = FULL; BEGIN IMMEDIATE").await?)
    }

    /// The same for what a power cut may undo, because whoever it was told to starts again as well: signs of life, and
    /// claims of workers in this process. It is not waited for the disk; a killed process loses nothing, and a later
    /// write that is on the disk takes all before it along.
    async fn begin_lightly(&self) -> Result<Transaction<'static, Sqlite>> {
        Ok(self.writer.begin_with("PRAGMA synchronous = NORMAL; BEGIN IMMEDIATE").await?)
    }
}

/// Makes sure that one server alone works on a data directory: two would take up each other's jobs. The lock lasts as
/// long as the file that is returned; commands such as `firn key` do not need it.
///
/// # Errors
/// [`StoreError::Locked`] where another server holds it, [`StoreError::Io`] where the directory cannot be written.
pub fn lock(data_dir: &Path) -> Result<File> {
    create_directory(data_dir)?;
    let path = data_dir.join("firn.lock");
    let file = File::options().create(true).truncate(false).write(true).open(&path).map_err(at(&path))?;
    match file.try_lock() {
        Ok(()) => Ok(file),
        Err(TryLockError::WouldBlock) => Err(StoreError::Locked(data_dir.to_owned())),
        Err(TryLockError::Error(source)) => Err(at(&path)(source)),
    }
}

fn create_directory(path: &Path) -> Result<()> {
    if path.is_dir() {
        return Ok(());
    }
    std::fs::create_dir_all(path).map_err(at(path))?;
    // a folder that we make holds hashes of keys and nobody else's business; one that is there is as its owner wants it
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt as _;
        std::fs::set_permissions(path, std::fs::Permissions::from_mode(0o700)).map_err(at(path))?;
    }
    Ok(())
}

/// Makes the file before SQLite does, which would let everybody read it; its journals get the rights of the file.
fn create_private(path: &Path) -> Result<()> {
    let mut options = File::options();
    options.append(true).create(true);
    #[cfg(unix)]
    {
        use std::os::unix::fs::OpenOptionsExt as _;
        options.mode(0o600);
    }
    options.open(path).map(drop).map_err(at(path))
}

fn at(path: &Path) -> impl Fn(std::io::Error) -> StoreError {
    let path = path.to_owned();
    move |source| StoreError::Io { path: path.clone(), source }
}

/// Looks at the header of the file before SQLite does, which would switch a foreign database to WAL.
fn refuse_foreign(path: &Path) -> Result<()> {
    let mut header = [0; 72];
    match File::open(path).and_then(|mut file| file.read_exact(&mut header)) {
        // no file yet, or one that SQLite has not written yet
        Err(error) if matches!(error.kind(), ErrorKind::NotFound | ErrorKind::UnexpectedEof) => Ok(()),
        Err(error) => Err(at(path)(error)),
        // sqlite.org/fileformat.html: the application id is the big-endian number at offset 68
        Ok(()) if header.starts_with(b"SQLite format 3\0") && (header[68..72] == OURS || header[68..72] == [0; 4]) => {
            Ok(())
        }
        Ok(()) => Err(StoreError::Foreign(path.to_owned())),
    }
}

async fn check_library(pool: &SqlitePool) -> Result<()> {
    let version: String = sqlx::query_scalar("SELECT sqlite_version()").fetch_one(pool).await?;
    let parts: Vec<u32> = version.split('.').filter_map(|part| part.parse().ok()).collect();
    if parts.as_slice() < OLDEST_SAFE_SQLITE.as_slice() {
        return Err(StoreError::UnsafeSqlite(version));
    }
    Ok(())
}

async fn claim_file(pool: &SqlitePool, path: &Path) -> Result<()> {
    let id: u32 = sqlx::query_scalar("PRAGMA application_id").fetch_one(pool).await?;
    let tables: i64 = sqlx::query_scalar("SELECT count(*) FROM sqlite_schema").fetch_one(pool).await?;
    match id {
        APPLICATION_ID => Ok(()),
        0 if tables == 0 => {
            sqlx::query(sqlx::AssertSqlSafe(format!("PRAGMA application_id = {APPLICATION_ID}"))).execute(pool).await?;
            Ok(())
        }
        _ => Err(StoreError::Foreign(path.to_owned())),
    }
}

fn parse_timestamp(text: &str) -> Result<Timestamp> {
    text.parse().map_err(StoreError::corrupt)
}

fn parse_date(text: &str) -> Result<Date> {
    text.parse().map_err(StoreError::corrupt)
}

fn from_json<T: serde::de::DeserializeOwned>(text: &str) -> Result<T> {
    serde_json::from_str(text).map_err(StoreError::corrupt)
}

fn to_json<T: serde::Serialize + ?Sized>(value: &T) -> Result<String> {
    serde_json::to_string(value).map_err(StoreError::corrupt)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn what_is_written_lightly_changes_nothing_for_what_follows() {
        const FULL: i64 = 2;
        const NORMAL: i64 = 1;
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).await.unwrap();
        let mode = async |mut tx: Transaction<'static, Sqlite>| -> i64 {
            let mode = sqlx::query_scalar("PRAGMA synchronous").fetch_one(&mut *tx).await.unwrap();
            tx.commit().await.unwrap();
            mode
        };
        assert_eq!(mode(store.begin().await.unwrap()).await, FULL);
        assert_eq!(mode(store.begin_lightly().await.unwrap()).await, NORMAL);
        assert_eq!(mode(store.begin().await.unwrap()).await, FULL);
    }
}
