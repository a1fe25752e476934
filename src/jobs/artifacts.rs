//! The bytes of large outputs, each under its digest, in a folder or, built with the feature `s3`, in what speaks S3.

use std::{
    ops::Range,
    path::{Path, PathBuf},
    sync::Arc,
};

use object_store::{
    ObjectStore, ObjectStoreExt, PutPayload, WriteMultipart, local::LocalFileSystem, path::Path as Key,
};
use serde::Deserialize;
use sha2::{Digest, Sha256};

use super::link::Artifact;
use crate::store::jobs::OutputRecord;

/// Where the bytes of large outputs lie; clones share it.
#[derive(Clone)]
pub struct Artifacts(Arc<dyn ObjectStore>);

/// The address of a place for large outputs.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(try_from = "String")]
pub enum ArtifactAddress {
    /// A folder.
    Folder(PathBuf),
    /// Below a prefix of a bucket of S3.
    S3 {
        /// The bucket.
        bucket: String,
        /// What every key begins with; empty: nothing.
        prefix: String,
    },
}

impl std::str::FromStr for ArtifactAddress {
    type Err = &'static str;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let Some(place) = text.strip_prefix("s3://") else {
            let good = !text.is_empty() && !text.contains("://");
            return if good { Ok(Self::Folder(text.into())) } else { Err("must be a folder or s3://BUCKET/PREFIX") };
        };
        let (bucket, prefix) = place.split_once('/').unwrap_or((place, ""));
        if bucket.is_empty() {
            return Err("must name a bucket: s3://BUCKET/PREFIX");
        }
        Ok(Self::S3 { bucket: bucket.into(), prefix: prefix.trim_matches('/').into() })
    }
}

impl TryFrom<String> for ArtifactAddress {
    type Error = &'static str;

    fn try_from(text: String) -> Result<Self, Self::Error> {
        text.parse()
    }
}

/// The store of large outputs does not do what it should.
#[derive(Debug, thiserror::Error)]
pub enum ArtifactError {
    /// It does not answer, or refuses.
    #[error("artifact store: {0}")]
    Store(#[from] object_store::Error),
    /// The folder cannot be made.
    #[error("artifact store: {path}: {source}")]
    Folder {
        /// Which.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// This build does not speak S3.
    #[error("this firn speaks no S3: build it with --features s3")]
    NoS3,
}

impl Artifacts {
    /// The place at an address, once it is certain that it answers.
    ///
    /// # Errors
    /// [`ArtifactError`] where it does not, or where this build does not know its kind.
    pub async fn open(address: &ArtifactAddress) -> Result<Self, ArtifactError> {
        match address {
            ArtifactAddress::Folder(path) => Self::folder(path),
            ArtifactAddress::S3 { bucket, prefix } => s3(bucket, prefix).await,
        }
    }

    /// A folder, made where it is not there.
    ///
    /// # Errors
    /// [`ArtifactError`] where the folder cannot be made.
    pub fn folder(path: &Path) -> Result<Self, ArtifactError> {
        std::fs::create_dir_all(path).map_err(|source| ArtifactError::Folder { path: path.into(), source })?;
        Ok(Self(Arc::new(LocalFileSystem::new_with_prefix(path)?.with_fsync(true))))
    }

    /// Stores an output and says how to find it; storing the same bytes again changes nothing.
    ///
    /// # Errors
    /// [`ArtifactError`] where the bytes could not be stored, or a piece is not there.
    pub async fn put(&self, artifact: &Artifact) -> Result<OutputRecord, ArtifactError> {
        let (sha256, size) = if artifact.pieces.is_empty() {
            (self.put_piece(&artifact.bytes).await?, artifact.bytes.len() as u64)
        } else {
            self.join(artifact).await?
        };
        Ok(OutputRecord { name: artifact.name.clone(), media_type: artifact.media_type.clone(), size, sha256 })
    }

    /// Stores bytes under their digest, and returns it.
    ///
    /// # Errors
    /// [`ArtifactError`] where they could not be stored.
    pub async fn put_piece(&self, bytes: &[u8]) -> Result<String, ArtifactError> {
        let sha256 = digest(bytes);
        self.0.put(&key(&sha256), PutPayload::from(bytes.to_vec())).await?;
        Ok(sha256)
    }

    /// Puts an output together of its bytes and its pieces, of which only one is in memory at a time: the first pass finds
    /// the digest under which the second one writes.
    async fn join(&self, artifact: &Artifact) -> Result<(String, u64), ArtifactError> {
        let (mut sum, mut size) = (Sha256::new_with_prefix(&artifact.bytes), artifact.bytes.len() as u64);
        for piece in &artifact.pieces {
            let bytes = self.0.get(&key(piece)).await?.bytes().await?;
            sum.update(&bytes);
            size += bytes.len() as u64;
        }
        let sha256 = hex(&sum.finalize());
        let mut upload = WriteMultipart::new(self.0.put_multipart(&key(&sha256)).await?);
        upload.write(&artifact.bytes);
        for piece in &artifact.pieces {
            upload.wait_for_capacity(1).await?;
            upload.put(self.0.get(&key(piece)).await?.bytes().await?);
        }
        upload.finish().await?;
        Ok((sha256, size))
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

/// Address and credentials of the service are in the environment, under the names that every client of S3 knows.
#[cfg(feature = "s3")]
async fn s3(bucket: &str, prefix: &str) -> Result<Artifacts, ArtifactError> {
    use futures_util::StreamExt as _;
    use object_store::{RetryConfig, aws::AmazonS3Builder, prefix::PrefixStore};

    // a delivery that fails is tried again by its worker: nothing is won by a longer wait here
    let retry =
        RetryConfig { max_retries: 3, retry_timeout: std::time::Duration::from_secs(10), ..RetryConfig::default() };
    let store = AmazonS3Builder::from_env().with_bucket_name(bucket).with_retry(retry).build()?;
    let store = PrefixStore::new(store, prefix);
    // a bucket that is not there would else be noticed only with the first result
    store.list(None).next().await.transpose()?;
    Ok(Artifacts(Arc::new(store)))
}

#[cfg(not(feature = "s3"))]
#[expect(clippy::unused_async, reason = "the same function as with the feature")]
async fn s3(_: &str, _: &str) -> Result<Artifacts, ArtifactError> {
    Err(ArtifactError::NoS3)
}

/// SHA-256 of bytes, in hex: under which they are stored.
#[must_use]
pub fn digest(bytes: &[u8]) -> String {
    hex(&Sha256::digest(bytes))
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn key(sha256: &str) -> Key {
    Key::from(sha256)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_is_a_folder_or_a_place_in_a_bucket() {
        let s3 = |bucket: &str, prefix: &str| ArtifactAddress::S3 { bucket: bucket.into(), prefix: prefix.into() };
        assert_eq!("a/b".parse(), Ok(ArtifactAddress::Folder("a/b".into())));
        assert_eq!("s3://b".parse(), Ok(s3("b", "")));
        assert_eq!("s3://b/p/q/".parse(), Ok(s3("b", "p/q")));
        for bad in ["", "s3://", "s3:///p", "gs://b/p"] {
            assert!(bad.parse::<ArtifactAddress>().is_err(), "{bad}");
        }
    }

    #[tokio::test]
    async fn pieces_follow_the_bytes_of_an_output() {
        let folder = tempfile::tempdir().unwrap();
        let artifacts = Artifacts::folder(folder.path()).unwrap();
        // one more byte than a part of an upload has
        let pieces = [vec![1; 5 * 1024 * 1024 + 1], vec![2; 3], Vec::new()];
        let mut named = Vec::new();
        for piece in &pieces {
            named.push(artifacts.put_piece(piece).await.unwrap());
        }
        named.push(named[1].clone());
        let artifact = Artifact { name: "a".into(), media_type: "b".into(), bytes: vec![0; 7], pieces: named };
        let expected = [&[0; 7], &*pieces[0], &[2; 6]].concat();
        let record = artifacts.put(&artifact).await.unwrap();
        assert_eq!((record.size, &record.sha256), (expected.len() as u64, &digest(&expected)));
        assert_eq!(artifacts.put(&artifact).await.unwrap(), record);
        assert!(artifacts.get(&record.sha256, 0..record.size).await.unwrap() == expected);
        let missing = Artifact { pieces: vec![digest(b"nothing")], ..artifact };
        assert!(artifacts.put(&missing).await.is_err());
    }

    #[cfg(not(feature = "s3"))]
    #[tokio::test]
    async fn a_build_without_s3_says_so() {
        let refused = Artifacts::open(&"s3://b/p".parse().unwrap()).await.err().map(|error| error.to_string());
        assert_eq!(refused.as_deref(), Some("this firn speaks no S3: build it with --features s3"));
    }
}
