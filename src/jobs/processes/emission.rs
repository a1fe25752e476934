//! What the processes of acoustic emission share: data sets from the store to the worker, and figures from it.

use firn_science::emission::{
    EmissionError,
    analysis::AnalysisError,
    catalogue::{Catalogue, Metadata},
};
use jiff::Timestamp;
use serde::{Deserialize, Serialize, de::DeserializeOwned};
use serde_bytes::ByteBuf;
use serde_json::{Value, json};
use sha2::{Digest, Sha256};
use utoipa::ToSchema;
use uuid::Uuid;

use super::{Failure, Shelf, invalid_inputs};
use crate::{
    domain::{
        dataset::{self, Columns, Dataset, DatasetBody, DatasetName},
        ids::new_id,
        job::Job,
        problem::{Code, FieldError, Problem},
    },
    formats::{
        emission::columns,
        figures::{Figure, ImageFormat},
    },
    jobs::{
        desk::{COLUMNS, OCTETS},
        link::{Artifact, Output},
    },
};

/// The largest seed: every JSON reader keeps it as it is.
pub const LARGEST_SEED: u64 = 9_007_199_254_740_991;

/// In which formats figures are made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum Figures {
    /// None.
    None,
    /// As SVG.
    #[default]
    Svg,
    /// As PNG.
    Png,
    /// As both.
    Both,
}

impl Figures {
    fn formats(self) -> &'static [ImageFormat] {
        match self {
            Self::None => &[],
            Self::Svg => &[ImageFormat::Svg],
            Self::Png => &[ImageFormat::Png],
            Self::Both => &[ImageFormat::Svg, ImageFormat::Png],
        }
    }
}

/// What is told of a data set with every result.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Head {
    /// Its id; none for a file that is not stored.
    pub id: Option<Uuid>,
    /// Its name.
    pub name: String,
    /// SHA-256 (hex) of its columns.
    pub sha256: String,
    /// Whether a generator made it.
    pub synthetic: bool,
    /// Its events.
    pub events: usize,
    /// What was known about the test.
    pub metadata: Metadata,
}

/// A data set with its hits.
pub struct Opened {
    /// What is told of it.
    pub head: Head,
    /// What is true of it, where a generator made it.
    pub truth: Option<Value>,
    /// The file of its columns.
    pub bytes: Vec<u8>,
}

/// Finds a data set; the inputs name it at `pointer`.
///
/// # Errors
/// A [`Problem`] with the pointer where it is not there, or a failure of ours.
pub async fn open(shelf: Shelf<'_>, id: Uuid, pointer: &str) -> Result<Opened, Problem> {
    let dataset = shelf.store.dataset(id).await.map_err(Problem::internal)?.ok_or_else(|| {
        let detail = format!("there is no data set {id}; GET /v1/datasets lists them");
        invalid_inputs(vec![FieldError::new(pointer, "unknown_dataset", detail)])
    })?;
    let bytes = shelf.artifacts.get(&dataset.sha256, 0..dataset.size).await.map_err(Problem::internal)?;
    Ok(Opened { truth: dataset.truth.clone(), head: head(dataset), bytes })
}

fn head(dataset: Dataset) -> Head {
    Head {
        id: Some(dataset.id),
        name: dataset.body.name.into(),
        sha256: dataset.sha256,
        synthetic: dataset.truth.is_some(),
        events: dataset.description.events,
        metadata: dataset.body.metadata,
    }
}

impl Opened {
    /// Its hits.
    ///
    /// # Errors
    /// Where the file of its columns is damaged.
    pub fn catalogue(&self) -> Result<Catalogue, Problem> {
        catalogue(&self.head, &self.bytes).map_err(Problem::internal)
    }
}

fn catalogue(head: &Head, bytes: &[u8]) -> Result<Catalogue, String> {
    let columns = columns::read(bytes).map_err(|error| error.to_string())?;
    Catalogue::new(columns, head.metadata.clone()).map_err(|error| error.to_string())
}

/// A data set that a job makes, on its way from the worker to the store.
#[derive(Serialize, Deserialize)]
pub struct Made {
    /// Its name.
    pub name: DatasetName,
    /// What is known about the test.
    pub metadata: Metadata,
    /// What can be seen in it.
    pub description: dataset::Description,
    /// What is true of it, where a generator made it or its hits.
    pub truth: Option<Value>,
}

/// [`Made`] beside where its columns lie.
#[derive(Serialize, Deserialize)]
struct Kept {
    made: Made,
    sha256: String,
    size: u64,
}

impl Made {
    /// The output of its job: the columns as an artifact, the rest for [`kept`].
    ///
    /// # Errors
    /// [`Failure`] where it cannot be written down.
    pub fn output(self, columns: &Columns, results: Value) -> Result<Output, Failure> {
        let bytes = columns::write(columns);
        let sha256 = Sha256::digest(&bytes).iter().map(|byte| format!("{byte:02x}")).collect();
        let kept = Kept { made: self, sha256, size: bytes.len() as u64 };
        Ok(Output {
            results,
            keep: Some(serde_json::to_value(&kept).map_err(science)?),
            artifacts: vec![Artifact { name: COLUMNS.into(), media_type: OCTETS.into(), bytes, ..Artifact::default() }],
            ..Output::default()
        })
    }
}

/// The data set that [`Made::output`] wants kept, as the store keeps it.
///
/// # Errors
/// Where it is not what that gave.
pub fn kept(job: &Job, keep: &Value, now: Timestamp) -> Result<Box<Dataset>, serde_json::Error> {
    let Kept { made, sha256, size } = serde_json::from_value(keep.clone())?;
    Ok(Box::new(Dataset {
        id: new_id(),
        body: DatasetBody { name: made.name, metadata: made.metadata },
        description: made.description,
        truth: made.truth,
        job: Some(job.id),
        sha256,
        size,
        revision: 1,
        created: now,
        created_by: job.submitted_by.clone(),
        updated: now,
    }))
}

/// SHA-256 (hex) of the inputs and of every data set that they name.
pub fn hash(inputs: &Value, heads: &[&Head]) -> String {
    let mut hasher = Sha256::new();
    hasher.update(inputs.to_string().as_bytes());
    for head in heads {
        hasher.update(head.sha256.as_bytes());
        hasher.update(serde_json::to_vec(&head.metadata).unwrap_or_default());
    }
    hasher.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
}

/// What a worker gets: it has no store.
#[derive(Serialize, Deserialize)]
struct Payload {
    /// JSON: the inputs are enums that only a format with names can hold.
    inputs: String,
    heads: String,
    truths: String,
    input_hash: String,
    version: String,
    columns: Vec<ByteBuf>,
}

/// What a worker needs for a job on some data sets.
///
/// # Errors
/// A failure of ours.
pub fn pack(job: &Job, opened: Vec<Opened>) -> Result<Vec<u8>, Problem> {
    let truths: Vec<Option<Value>> = opened.iter().map(|opened| opened.truth.clone()).collect();
    let (heads, columns): (Vec<Head>, Vec<ByteBuf>) =
        opened.into_iter().map(|opened| (opened.head, ByteBuf::from(opened.bytes))).unzip();
    let payload = Payload {
        inputs: job.inputs.to_string(),
        input_hash: hash(&job.inputs, &heads.iter().collect::<Vec<_>>()),
        heads: serde_json::to_string(&heads).map_err(Problem::internal)?,
        truths: serde_json::to_string(&truths).map_err(Problem::internal)?,
        version: job.version.clone(),
        columns,
    };
    rmp_serde::to_vec(&payload).map_err(Problem::internal)
}

/// What [`pack`] packed.
pub struct Unpacked<T> {
    /// The inputs.
    pub inputs: T,
    /// What is told of the data sets.
    pub heads: Vec<Head>,
    /// What is true of them, where a generator made them.
    pub truths: Vec<Option<Value>>,
    /// Their hits.
    pub catalogues: Vec<Catalogue>,
    /// Version and input hash.
    pub provenance: Value,
}

/// Reads what a worker was given.
///
/// # Errors
/// [`Failure`] where it is damaged.
pub fn unpack<T: DeserializeOwned>(payload: &[u8]) -> Result<Unpacked<T>, Failure> {
    let payload: Payload = rmp_serde::from_slice(payload).map_err(science)?;
    let heads: Vec<Head> = serde_json::from_str(&payload.heads).map_err(science)?;
    let catalogues = heads.iter().zip(&payload.columns).map(|(head, bytes)| catalogue(head, bytes));
    Ok(Unpacked {
        inputs: serde_json::from_str(&payload.inputs).map_err(science)?,
        truths: serde_json::from_str(&payload.truths).map_err(science)?,
        catalogues: catalogues.collect::<Result<_, _>>().map_err(science)?,
        provenance: json!({"version": payload.version, "input_hash": payload.input_hash}),
        heads,
    })
}

/// A failure of the computation, in its words.
pub fn science(error: impl std::fmt::Display) -> Failure {
    Failure::Science(error.to_string())
}

/// A failure of an analysis.
pub fn failure(error: AnalysisError) -> Failure {
    if error.error == EmissionError::Cancelled { Failure::Cancelled } else { science(error) }
}

/// A refusal of an analysis before there is a job; `at` is where the analysis stands in the inputs, `dataset` where its data do.
pub fn field_error(error: &EmissionError, at: &str, dataset: &str) -> FieldError {
    let (pointer, code) = match error {
        EmissionError::Option { option, .. } => (format!("{at}/{option}"), "out_of_range"),
        EmissionError::MissingColumn { .. } => (dataset.to_owned(), "missing_column"),
        EmissionError::MissingMetadata { .. } => (dataset.to_owned(), "missing_metadata"),
        EmissionError::TooFewEvents { .. } => (dataset.to_owned(), "too_few_events"),
        _ => (at.to_owned(), "refused"),
    };
    FieldError::new(pointer, code, error.to_string())
}

/// Figures as large outputs, and what is said of them in the results: which output holds which figure.
///
/// # Errors
/// [`Failure`] where one cannot be drawn.
pub fn drawn(figures: &[Figure], wanted: Figures) -> Result<(Vec<Artifact>, Value), Failure> {
    let (mut artifacts, mut list) = (Vec::new(), Vec::new());
    for figure in figures {
        let mut outputs = Vec::new();
        for format in wanted.formats() {
            let name = format!("{}.{}", figure.name, format.extension());
            let bytes = figure.draw(*format).map_err(science)?;
            artifacts.push(Artifact {
                name: name.clone(),
                media_type: format.media_type().into(),
                bytes,
                ..Artifact::default()
            });
            outputs.push(name);
        }
        if !outputs.is_empty() {
            list.push(json!({"title": figure.title, "outputs": outputs}));
        }
    }
    Ok((artifacts, Value::Array(list)))
}

/// 422 where the seed is larger than every JSON reader keeps it.
pub fn check_seed(seed: u64) -> Option<FieldError> {
    let rule = format!("must be from 0 to {LARGEST_SEED} (2^53 - 1)");
    (seed > LARGEST_SEED).then(|| FieldError::new("/inputs/seed", "out_of_range", rule))
}

/// A data set that was there when the job was accepted is not there any more.
pub fn gone(problem: Problem) -> Problem {
    if problem.code == Code::InvalidInputs { Problem::new(Code::UnknownDataset, problem.detail) } else { problem }
}
