//! The bytes of large outputs, each under its digest, in a folder or, built with the feature `s3`, in what speaks S3.

use std::{
    ops::Range,
    path::{Path, PathBuf},
    sync::Arc,
};

use futures_util::TryStreamExt as _;
use object_store::{
    ObjectStore, ObjectStoreExt, PutPayload, WriteMultipart, local::LocalFileSystem, path::Path as Key,
};
use serde::Deserialize;
use sha2::{Digest, Sha256};
use uuid::Uuid;

use super::link::Artifact;
use crate::store::jobs::OutputRecord;

/// The object that says whose the place is.
const OWNER: &str = "owner";

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
    /// Another service keeps its outputs there: each would remove those of the other.
    #[error("artifact store: it belongs to another firn ({0}); give each a folder or prefix of its own")]
    Foreign(String),
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
        remove_unfinished(path).map_err(|source| ArtifactError::Folder { path: path.into(), source })?;
        Ok(Self(Arc::new(LocalFileSystem::new_with_prefix(path)?.with_fsync(true))))
    }

    /// Takes the place for the service of this id, once and for all.
    ///
    /// # Errors
    /// [`ArtifactError::Foreign`] where it is another's, else [`ArtifactError`] where it does not answer.
    pub async fn claim(&self, instance: Uuid) -> Result<(), ArtifactError> {
        let (owner, own) = (Key::from(OWNER), instance.to_string());
        let found = match self.0.get(&owner).await {
            Ok(found) => found.bytes().await?,
            Err(object_store::Error::NotFound { .. }) => {
                self.0.put(&owner, PutPayload::from(own.into_bytes())).await?;
                return Ok(());
            }
            Err(error) => return Err(error.into()),
        };
        if found == own.as_bytes() {
            Ok(())
        } else {
            Err(ArtifactError::Foreign(String::from_utf8_lossy(&found).into()))
        }
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

    /// The digests of all that lies there, in no order; what does not look like ours is not among them.
    ///
    /// # Errors
    /// [`ArtifactError`] where the store does not answer.
    pub async fn digests(&self) -> Result<Vec<String>, ArtifactError> {
        let found = self.0.list(None).try_filter_map(async |object| {
            let name = object.location.as_ref();
            Ok(is_digest(name).then(|| name.to_owned()))
        });
        Ok(found.try_collect().await?)
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

fn is_digest(name: &str) -> bool {
    name.len() == 64 && name.bytes().all(|byte| matches!(byte, b'0'..=b'9' | b'a'..=b'f'))
}

/// Removes what a killed process had begun to write: `object_store` writes beside the place, with # and a number behind
/// the name, and lists no such file.
fn remove_unfinished(folder: &Path) -> std::io::Result<()> {
    for entry in std::fs::read_dir(folder)? {
        let entry = entry?;
        let name = entry.file_name();
        if name.to_str().and_then(|name| name.split_once('#')).is_some_and(|(digest, _)| is_digest(digest)) {
            std::fs::remove_file(entry.path())?;
        }
    }
    Ok(())
}

/// Address and credentials of the service are in the environment, under the names that every client of S3 knows.
#[cfg(feature = "s3")]
async fn s3(bucket: &str, prefix: &str) -> Result<Artifacts, ArtifactError> {
    use object_store::{RetryConfig, aws::AmazonS3Builder, prefix::PrefixStore};

    // a delivery that fails is tried again by its worker: nothing is won by a longer wait here
    let retry =
        RetryConfig { max_retries: 3, retry_timeout: std::time::Duration::from_secs(10), ..RetryConfig::default() };
    let store = AmazonS3Builder::from_env().with_bucket_name(bucket).with_retry(retry).build()?;
    let store = PrefixStore::new(store, prefix);
    // a bucket that is not there would else be noticed only with the first result
    store.list(None).try_next().await?;
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

    #[tokio::test]
    async fn a_place_is_of_one_service() {
        let folder = tempfile::tempdir().unwrap();
        let artifacts = Artifacts::folder(folder.path()).unwrap();
        let (own, other) = (Uuid::from_u128(1), Uuid::from_u128(2));
        artifacts.claim(own).await.unwrap();
        artifacts.claim(own).await.unwrap();
        assert!(matches!(artifacts.claim(other).await, Err(ArtifactError::Foreign(owner)) if owner == own.to_string()));
        assert!(artifacts.digests().await.unwrap().is_empty());
    }

    #[tokio::test]
    async fn what_was_begun_is_removed_and_what_is_not_ours_stays() {
        let folder = tempfile::tempdir().unwrap();
        let half = format!("{}#1", digest(b"a"));
        for name in [&half, "notes", "notes#1"] {
            std::fs::write(folder.path().join(name), "x").unwrap();
        }
        let artifacts = Artifacts::folder(folder.path()).unwrap();
        let stored = artifacts.put_piece(b"b").await.unwrap();
        assert_eq!(artifacts.digests().await.unwrap(), [stored]);
        let mut names: Vec<_> = std::fs::read_dir(folder.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
        names.sort();
        assert_eq!(names.len(), 3, "{names:?}");
        assert!(!folder.path().join(&half).exists());
    }

    #[cfg(not(feature = "s3"))]
    #[tokio::test]
    async fn a_build_without_s3_says_so() {
        let refused = Artifacts::open(&"s3://b/p".parse().unwrap()).await.err().map(|error| error.to_string());
        assert_eq!(refused.as_deref(), Some("this firn speaks no S3: build it with --features s3"));
    }
}
