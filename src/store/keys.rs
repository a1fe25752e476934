//! API keys: the secret is shown once and kept as a hash.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use sqlx::{FromRow, Row, sqlite::SqliteRow};
use subtle::ConstantTimeEq;

use super::{
    Result, Store, StoreError,
    audit::{self, Action, Actor, NewEntry},
    parse_timestamp,
};

/// Keys are made and withdrawn by whoever has the data directory.
const BY_COMMAND: Option<&str> = Some("by the command `firn key`");

/// What the owner of a key may do; each role may do what the ones before it may.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Role {
    /// Reads everything.
    Reader,
    /// Writes observations and submits jobs.
    Forecaster,
    /// Activates models.
    Operator,
    /// Manages keys.
    Admin,
}

impl Role {
    /// The name in the store and on the command line.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Reader => "reader",
            Self::Forecaster => "forecaster",
            Self::Operator => "operator",
            Self::Admin => "admin",
        }
    }

    fn from_name(name: &str) -> Option<Self> {
        [Self::Reader, Self::Forecaster, Self::Operator, Self::Admin].into_iter().find(|role| role.name() == name)
    }
}

/// A key without its secret.
#[derive(Clone, Debug, PartialEq)]
pub struct ApiKey {
    /// The public part, which also begins the key itself.
    pub id: String,
    /// Whose or what for.
    pub name: String,
    /// What it allows.
    pub role: Role,
    /// When it was made.
    pub created: Timestamp,
    /// When it ends to be valid.
    pub expires: Option<Timestamp>,
    /// When it was last used, to the minute.
    pub last_used: Option<Timestamp>,
    /// When it was withdrawn.
    pub revoked: Option<Timestamp>,
}

impl ApiKey {
    /// True while the key opens the door.
    #[must_use]
    pub fn is_valid(&self, now: Timestamp) -> bool {
        self.revoked.is_none() && self.expires.is_none_or(|end| now < end)
    }
}

struct KeyRow {
    key: ApiKey,
    hash: String,
}

impl FromRow<'_, SqliteRow> for KeyRow {
    fn from_row(row: &SqliteRow) -> sqlx::Result<Self> {
        read(row).map_err(|error| sqlx::Error::Decode(Box::new(error)))
    }
}

fn read(row: &SqliteRow) -> Result<KeyRow> {
    let instant = |name: &str| -> Result<Option<Timestamp>> {
        row.try_get::<Option<String>, _>(name)?.as_deref().map(parse_timestamp).transpose()
    };
    let role: String = row.try_get("role")?;
    let key = ApiKey {
        id: row.try_get("id")?,
        name: row.try_get("name")?,
        role: Role::from_name(&role).ok_or_else(|| StoreError::corrupt(role))?,
        created: parse_timestamp(row.try_get("created")?)?,
        expires: instant("expires")?,
        last_used: instant("last_used")?,
        revoked: instant("revoked")?,
    };
    Ok(KeyRow { key, hash: row.try_get("hash")? })
}

fn hash(secret: &str) -> String {
    // a 256-bit random secret cannot be guessed, so a slow password hash would add nothing
    hex(&Sha256::digest(secret.as_bytes()))
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

impl Store {
    /// Makes a key and returns the text that its owner must keep: `firn_<id>_<secret>`.
    ///
    /// # Errors
    /// [`StoreError::NameTaken`] where another key has the name: the history of what is written shows names.
    pub async fn create_key(
        &self,
        name: &str,
        role: Role,
        expires: Option<Timestamp>,
        now: Timestamp,
    ) -> Result<String> {
        let id = hex(&rand::random::<[u8; 6]>());
        let secret = hex(&rand::random::<[u8; 32]>());
        let mut tx = self.begin().await?;
        let taken: Option<i64> =
            sqlx::query_scalar("SELECT 1 FROM api_key WHERE name = ?").bind(name).fetch_optional(&mut *tx).await?;
        if taken.is_some() {
            return Err(StoreError::NameTaken(name.to_owned()));
        }
        sqlx::query("INSERT INTO api_key (id, hash, name, role, created, expires) VALUES (?, ?, ?, ?, ?, ?)")
            .bind(&id)
            .bind(hash(&secret))
            .bind(name)
            .bind(role.name())
            .bind(now.to_string())
            .bind(expires.map(|end| end.to_string()))
            .execute(&mut *tx)
            .await?;
        let entry = NewEntry {
            action: Action::KeyCreated,
            target: &format!("key:{id}"),
            reason: BY_COMMAND,
            before: None,
            after: Some(serde_json::json!({"name": name, "role": role, "expires": expires})),
        };
        audit::write(&mut tx, &Actor::service(now), entry).await?;
        tx.commit().await?;
        Ok(format!("firn_{id}_{secret}"))
    }

    /// Every key, oldest first.
    ///
    /// # Errors
    /// [`StoreError::Sql`] where the database cannot be read.
    pub async fn keys(&self) -> Result<Vec<ApiKey>> {
        let rows =
            sqlx::query_as::<_, KeyRow>("SELECT * FROM api_key ORDER BY created, id").fetch_all(&self.reader).await?;
        Ok(rows.into_iter().map(|row| row.key).collect())
    }

    /// Withdraws a key for good; false where there is none of that id that was still in force.
    ///
    /// # Errors
    /// [`StoreError::Sql`] where it cannot be stored.
    pub async fn revoke_key(&self, id: &str, now: Timestamp) -> Result<bool> {
        let mut tx = self.begin().await?;
        let done = sqlx::query("UPDATE api_key SET revoked = ? WHERE id = ? AND revoked IS NULL")
            .bind(now.to_string())
            .bind(id)
            .execute(&mut *tx)
            .await?;
        let revoked = done.rows_affected() > 0;
        if revoked {
            let entry = NewEntry {
                action: Action::KeyRevoked,
                target: &format!("key:{id}"),
                reason: BY_COMMAND,
                before: None,
                after: None,
            };
            audit::write(&mut tx, &Actor::service(now), entry).await?;
        }
        tx.commit().await?;
        Ok(revoked)
    }

    /// The valid key that `text` is, or none.
    ///
    /// # Errors
    /// [`StoreError::Sql`] where the database cannot be read.
    pub async fn authenticate(&self, text: &str, now: Timestamp) -> Result<Option<ApiKey>> {
        let Some((id, secret)) = text.strip_prefix("firn_").and_then(|rest| rest.split_once('_')) else {
            return Ok(None);
        };
        let row = sqlx::query_as::<_, KeyRow>("SELECT * FROM api_key WHERE id = ?")
            .bind(id)
            .fetch_optional(&self.reader)
            .await?;
        let Some(row) = row else { return Ok(None) };
        let same: bool = row.hash.as_bytes().ct_eq(hash(secret).as_bytes()).into();
        if !same || !row.key.is_valid(now) {
            return Ok(None);
        }
        // a read must neither wait for the writer nor fail with it
        let (store, key) = (self.clone(), row.key.clone());
        tokio::spawn(async move {
            if let Err(error) = store.note_use(&key, now).await {
                tracing::warn!(%error, "the use of a key could not be noted");
            }
        });
        Ok(Some(row.key))
    }

    /// One write a minute at most: a dashboard that polls must not keep the disk busy.
    async fn note_use(&self, key: &ApiKey, now: Timestamp) -> Result<()> {
        let fresh = key.last_used.is_some_and(|last| now.as_second() - last.as_second() < 60);
        if !fresh {
            let mut tx = self.begin().await?;
            sqlx::query("UPDATE api_key SET last_used = ? WHERE id = ?")
                .bind(now.to_string())
                .bind(&key.id)
                .execute(&mut *tx)
                .await?;
            tx.commit().await?;
        }
        Ok(())
    }
}
