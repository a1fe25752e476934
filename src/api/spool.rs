//! Large bodies: written to a file while they arrive, so that memory does not grow with them.

use std::path::{Path, PathBuf};

use axum::extract::Request;
use futures_util::StreamExt as _;
use sha2::{Digest, Sha256};
use tempfile::{NamedTempFile, TempPath};
use tokio::io::{AsyncWriteExt as _, BufWriter};

use super::extract::uncompressed;
use crate::domain::problem::{Code, Problem};

/// The folder of uploads below that of the database.
pub const FOLDER: &str = "uploads";

/// Bytes that are written at once.
const BUFFER: usize = 1024 * 1024;

/// A body that is wholly here; the file goes when this does.
pub struct Spooled {
    path: TempPath,
    /// Its length, bytes.
    pub bytes: u64,
    /// Its SHA-256 (hex).
    pub sha256: String,
}

impl Spooled {
    /// Where it lies.
    pub fn path(&self) -> &Path {
        &self.path
    }
}

/// Writes the body of a request to a file in `folder`.
///
/// # Errors
/// A body of more than `limit` bytes, one that ends before it should, or a disk that takes no more.
pub async fn spool(request: Request, folder: &Path, limit: u64) -> Result<Spooled, Problem> {
    uncompressed(request.headers())?;
    let too_large = || {
        let detail = format!("the file exceeds the limit of {limit} bytes of this service (setting max_dataset_mib)");
        Problem::new(Code::PayloadTooLarge, detail)
    };
    let folder: PathBuf = folder.to_owned();
    let file = tokio::task::spawn_blocking(move || {
        std::fs::create_dir_all(&folder)?;
        NamedTempFile::new_in(&folder)
    });
    let (file, path) = file.await.map_err(Problem::internal)?.map_err(Problem::internal)?.into_parts();
    let mut file = BufWriter::with_capacity(BUFFER, tokio::fs::File::from_std(file));
    let (mut bytes, mut hasher) = (0_u64, Sha256::new());
    let mut body = request.into_body().into_data_stream();
    while let Some(chunk) = body.next().await {
        let chunk = chunk.map_err(|error| {
            Problem::new(Code::InvalidHeader, format!("the body could not be read to its end: {error}"))
        })?;
        bytes += chunk.len() as u64;
        if bytes > limit {
            return Err(too_large());
        }
        hasher.update(&chunk);
        file.write_all(&chunk).await.map_err(Problem::internal)?;
    }
    file.flush().await.map_err(Problem::internal)?;
    let sha256 = hasher.finalize().iter().map(|byte| format!("{byte:02x}")).collect();
    Ok(Spooled { path, bytes, sha256 })
}

/// Removes what uploads left behind that were on their way when an earlier process ended.
///
/// # Errors
/// Where the folder cannot be removed.
pub fn sweep(data_dir: &Path) -> std::io::Result<()> {
    match std::fs::remove_dir_all(data_dir.join(FOLDER)) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => Err(error),
        _ => Ok(()),
    }
}
