//! Idempotency keys: a request that is sent twice is done once (IETF draft-ietf-httpapi-idempotency-key-header).

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use sqlx::{Row, Sqlite, Transaction};

use crate::store::{Result, Store, from_json, to_json};

/// A key that is held for one request.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Reservation {
    /// Whose key: keys of different callers are different.
    pub caller: String,
    /// The key as the caller sent it.
    pub key: String,
    /// SHA-256 (hex) of method, address and body.
    pub request_hash: String,
}

/// An answer that is given again.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Answer {
    /// The `Location`.
    pub location: String,
    /// The body.
    pub body: serde_json::Value,
}

/// What a key was found to be.
#[derive(Clone, Debug, PartialEq)]
pub enum Held {
    /// New: it is held for this request now.
    New,
    /// The same request was answered before.
    Answered(Answer),
    /// The same request is at work.
    AtWork,
    /// It was sent with another request.
    OtherRequest,
}

pub(super) async fn settle(tx: &mut Transaction<'_, Sqlite>, reservation: &Reservation, answer: &Answer) -> Result<()> {
    sqlx::query("UPDATE idempotency SET answer = ? WHERE caller = ? AND key = ?")
        .bind(to_json(answer)?)
        .bind(&reservation.caller)
        .bind(&reservation.key)
        .execute(&mut **tx)
        .await?;
    Ok(())
}

impl Store {
    /// Holds a key for a request, or says what it was found to be.
    ///
    /// # Errors
    /// [`crate::store::StoreError::Sql`] where it cannot be stored.
    pub async fn hold_key(&self, reservation: &Reservation, now: Timestamp) -> Result<Held> {
        let mut tx = self.begin().await?;
        let row = sqlx::query("SELECT request_hash, answer FROM idempotency WHERE caller = ? AND key = ?")
            .bind(&reservation.caller)
            .bind(&reservation.key)
            .fetch_optional(&mut *tx)
            .await?;
        if let Some(row) = row {
            if row.try_get::<String, _>("request_hash")? != reservation.request_hash {
                return Ok(Held::OtherRequest);
            }
            let answer: Option<String> = row.try_get("answer")?;
            return Ok(answer.as_deref().map(from_json).transpose()?.map_or(Held::AtWork, Held::Answered));
        }
        sqlx::query("INSERT INTO idempotency (caller, key, request_hash, created_ms) VALUES (?, ?, ?, ?)")
            .bind(&reservation.caller)
            .bind(&reservation.key)
            .bind(&reservation.request_hash)
            .bind(now.as_millisecond())
            .execute(&mut *tx)
            .await?;
        tx.commit().await?;
        Ok(Held::New)
    }

    /// Remembers the answer to a request that made no job: it was computed before.
    ///
    /// # Errors
    /// [`crate::store::StoreError::Sql`] where it cannot be stored.
    pub async fn settle_key(&self, reservation: &Reservation, answer: &Answer) -> Result<()> {
        let mut tx = self.begin().await?;
        settle(&mut tx, reservation, answer).await?;
        tx.commit().await?;
        Ok(())
    }

    /// Lets go of a key whose request was refused: nothing is remembered of it.
    ///
    /// # Errors
    /// [`crate::store::StoreError::Sql`] where it cannot be stored.
    pub async fn let_key_go(&self, reservation: &Reservation) -> Result<()> {
        let mut tx = self.begin().await?;
        sqlx::query("DELETE FROM idempotency WHERE caller = ? AND key = ? AND answer IS NULL")
            .bind(&reservation.caller)
            .bind(&reservation.key)
            .execute(&mut *tx)
            .await?;
        tx.commit().await?;
        Ok(())
    }

    /// Forgets keys older than `before`, and all that were at work where `all_at_work` (their server is gone).
    ///
    /// # Errors
    /// [`crate::store::StoreError::Sql`] where it cannot be stored.
    pub async fn forget_keys(&self, before: Timestamp, all_at_work: bool) -> Result<()> {
        let mut tx = self.begin().await?;
        sqlx::query("DELETE FROM idempotency WHERE created_ms < ? OR (? AND answer IS NULL)")
            .bind(before.as_millisecond())
            .bind(all_at_work)
            .execute(&mut *tx)
            .await?;
        tx.commit().await?;
        Ok(())
    }
}
