//! The bytes of large outputs, each under its digest, in a folder or in whatever `object_store` speaks to.

use std::{ops::Range, path::Path, sync::Arc};

use object_store::{ObjectStore, ObjectStoreExt, PutPayload, local::LocalFileSystem, path::Path as Key};
use sha2::{Digest, Sha256};

use super::link::Artifact;
use crate::store::jobs::OutputRecord;

/// Where the bytes of large outputs lie; clones share it.
#[derive(Clone)]
pub struct Artifacts(Arc<dyn ObjectStore>);

/// The store of large outputs does not do what it should.
#[derive(Debug, thiserror::Error)]
#[error("artifact store: {0}")]
pub struct ArtifactError(#[from] object_store::Error);

impl Artifacts {
    /// A folder, made where it is not there.
    ///
    /// # Errors
    /// Where the folder cannot be made.
    pub fn folder(path: &Path) -> Result<Self, Box<dyn std::error::Error + Send + Sync>> {
        std::fs::create_dir_all(path)?;
        Ok(Self(Arc::new(LocalFileSystem::new_with_prefix(path)?.with_fsync(true))))
    }

    /// Stores an output and says how to find it; storing the same bytes again changes nothing.
    ///
    /// # Errors
    /// [`ArtifactError`] where the bytes could not be stored.
    pub async fn put(&self, artifact: &Artifact) -> Result<OutputRecord, ArtifactError> {
        let sha256: String = Sha256::digest(&artifact.bytes).iter().map(|byte| format!("{byte:02x}")).collect();
        let payload = PutPayload::from(artifact.bytes.clone());
        self.0.put(&key(&sha256), payload).await?;
        let size = artifact.bytes.len() as u64;
        Ok(OutputRecord { name: artifact.name.clone(), media_type: artifact.media_type.clone(), size, sha256 })
    }

    /// Some of the bytes under a digest.
    ///
    /// # Errors
    /// [`ArtifactError`] where they are not there.
    pub async fn get(&self, sha256: &str, range: Range<u64>) -> Result<Vec<u8>, ArtifactError> {
        if range.is_empty() {
            return Ok(Vec::new());
        }
        Ok(self.0.get_range(&key(sha256), range).await?.to_vec())
    }

    /// Removes what nobody names any more; what cannot be removed now is only logged.
    pub async fn remove(&self, digests: &[String]) {
        for digest in digests {
            match self.0.delete(&key(digest)).await {
                Ok(()) | Err(object_store::Error::NotFound { .. }) => {}
                Err(error) => tracing::warn!(%error, digest, "an output that is no more needed could not be removed"),
            }
        }
    }
}

fn key(sha256: &str) -> Key {
    Key::from(sha256)
}
