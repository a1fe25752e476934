//! `/v1/datasets`: catalogues of acoustic emission, taken in whole or not at all.

use axum::{
    extract::{Request, State},
    http::{HeaderMap, HeaderValue, StatusCode, header},
    response::{IntoResponse, Response},
};
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use utoipa::{IntoParams, ToSchema};
use uuid::Uuid;

use super::{
    AppState,
    auth::Caller,
    extract::{Conditions, JsonBody, Path, Query},
    landing::Link,
    problem::{ApiError, ApiResult},
    respond,
    spool::spool,
    stations::Limit,
};
use crate::{
    clock,
    domain::{
        dataset::{ColumnStatistics, Dataset, DatasetBody, DatasetName, LocationOrigin, Source, WaveformOrigin},
        problem::{Code, Problem},
    },
    formats::emission::{AmplitudeUnit, FileFormat, ReadOptions, WaveOptions},
    jobs::intake::{self, Upload},
    science::emission::{
        EmissionError,
        catalogue::{Metadata, Phase, QualityFlag},
    },
    store::StoreError,
};

/// Which data set.
#[derive(Deserialize, IntoParams)]
#[into_params(parameter_in = Path)]
#[serde(deny_unknown_fields)]
pub struct DatasetPath {
    /// Id of the data set.
    pub dataset: Uuid,
}

/// Which page of the list.
#[derive(Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub struct ListQuery {
    /// Largest number of data sets in the answer, 1 to 1000.
    #[serde(default)]
    #[param(value_type = Option<u32>, minimum = 1, maximum = 1000, default = 100)]
    limit: Option<Limit<100, 1000>>,
    /// Where the page begins: `next` of the page before.
    #[serde(default)]
    cursor: Option<Uuid>,
}

/// A number of the address with a rule.
macro_rules! number {
    ($name:ident, $rule:literal, $good:expr) => {
        #[derive(Clone, Copy, Deserialize)]
        #[serde(try_from = "f64")]
        struct $name(f64);

        impl TryFrom<f64> for $name {
            type Error = String;

            fn try_from(value: f64) -> Result<Self, String> {
                let good: fn(f64) -> bool = $good;
                if value.is_finite() && good(value) {
                    Ok(Self(value))
                } else {
                    Err(format!("must be {}, not {value}", $rule))
                }
            }
        }
    };
}

number!(Positive, "a finite number above 0", |value| value > 0.0);
number!(NotNegative, "a finite number of at least 0", |value| value >= 0.0);

/// What is said of a file.
#[derive(Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub struct UploadQuery {
    /// Name for humans, 1 to 200 characters.
    #[param(inline)]
    name: DatasetName,
    /// Unit of the amplitudes: `v`, `mv`, `uv` (behind the preamplifier) or `db_ae` (re 1 uV at the sensor). Needed wherever
    /// the column's name does not say it: it is never guessed.
    #[serde(default)]
    #[param(value_type = Option<String>, pattern = "^(v|mv|uv|db_ae)$", example = "v")]
    amplitude_unit: Option<AmplitudeUnit>,
    /// What the file is; left out: what `Content-Type` says, or else its first bytes.
    #[serde(default)]
    #[param(value_type = Option<String>, pattern = "^(csv|tsv|parquet|pridb|tradb|dta|wav|npy)$")]
    format: Option<FileFormat>,
    /// Temperature of the test, degC.
    #[serde(default)]
    #[param(minimum = -273.15)]
    temperature_c: Option<f64>,
    /// Mean grain size, mm; left out for a single crystal.
    #[serde(default)]
    #[param(value_type = Option<f64>, exclusive_minimum = 0)]
    grain_size_mm: Option<Positive>,
    /// Applied stress, MPa.
    #[serde(default)]
    stress_mpa: Option<f64>,
    /// `loading` or `unloading`, where all hits are of one phase.
    #[serde(default)]
    #[param(value_type = Option<String>, pattern = "^(loading|unloading)$")]
    phase: Option<Phase>,
    /// Gain of the preamplifier, dB.
    #[serde(default)]
    preamp_gain_db: Option<f64>,
    /// Detection threshold behind the preamplifier, V; of waveforms the one that hits are found with.
    #[serde(default)]
    #[param(value_type = Option<f64>, exclusive_minimum = 0)]
    threshold_v: Option<Positive>,
    /// Of waveforms: hit definition time T1, s.
    #[serde(default)]
    #[param(value_type = Option<f64>, exclusive_minimum = 0)]
    hit_definition_s: Option<Positive>,
    /// Of waveforms: hit lock-out time T2, s.
    #[serde(default)]
    #[param(value_type = Option<f64>, minimum = 0)]
    hit_lockout_s: Option<NotNegative>,
    /// Of waveforms: peak definition time, s; left out: the whole hit is searched.
    #[serde(default)]
    #[param(value_type = Option<f64>, exclusive_minimum = 0)]
    peak_definition_s: Option<Positive>,
    /// Of NPY: samples a second, Hz.
    #[serde(default)]
    #[param(value_type = Option<f64>, exclusive_minimum = 0)]
    sample_rate_hz: Option<Positive>,
    /// Of WAV: volts of the largest sample that the file can hold.
    #[serde(default)]
    #[param(value_type = Option<f64>, exclusive_minimum = 0)]
    full_scale_v: Option<Positive>,
}

/// A data set.
#[derive(Serialize, ToSchema)]
pub struct DatasetResource {
    /// Id of the data set.
    id: Uuid,
    /// Name for humans.
    name: DatasetName,
    /// True where a generator made it and nobody measured it.
    synthetic: bool,
    /// Hits or events.
    events: usize,
    /// Unit of its amplitudes: `V` (behind the preamplifier) or `dB_AE` (re 1 uV at the sensor); null without amplitudes.
    amplitude_unit: Option<&'static str>,
    /// The columns in a few numbers.
    columns: Vec<ColumnStatistics>,
    /// What the reader of an exponent must know.
    quality: Vec<QualityFlag>,
    /// Columns of the file that were not read.
    ignored_columns: Vec<String>,
    /// What was done to read the file.
    notes: Vec<String>,
    /// What it was made from.
    source: Source,
    /// How its hits were found in waveforms, and how they hang on threshold and time constants; null where they came as hits.
    waveform: Option<WaveformOrigin>,
    /// How its events were made of the hits of another data set; null where they were not located here.
    location: Option<LocationOrigin>,
    /// What is known about the test.
    metadata: Metadata,
    /// What is true of it, where a generator made it; null for measurements.
    #[schema(value_type = Option<Object>)]
    truth: Option<Value>,
    /// The job that made it, if one did.
    job: Option<Uuid>,
    /// Counts the changes, from 1.
    revision: u32,
    /// When it was taken in.
    created: Timestamp,
    /// The name of the key that sent it; null where no key was needed.
    created_by: Option<String>,
    /// When it last changed.
    updated: Timestamp,
    /// Where to go from here.
    links: Vec<Link>,
}

/// A page of data sets.
#[derive(Serialize, ToSchema)]
pub struct DatasetList {
    /// Newest first.
    datasets: Vec<DatasetResource>,
    /// The `cursor` of the next page; null on the last.
    next: Option<Uuid>,
}

impl From<Dataset> for DatasetResource {
    fn from(dataset: Dataset) -> Self {
        let at = format!("/v1/datasets/{}", dataset.id);
        Self {
            amplitude_unit: dataset.amplitude_unit(),
            id: dataset.id,
            name: dataset.body.name,
            synthetic: dataset.truth.is_some(),
            events: dataset.description.events,
            columns: dataset.description.columns,
            quality: dataset.description.quality,
            ignored_columns: dataset.description.ignored_columns,
            notes: dataset.description.notes,
            source: dataset.description.source,
            waveform: dataset.description.waveform,
            location: dataset.description.location,
            metadata: dataset.body.metadata,
            truth: dataset.truth,
            job: dataset.job,
            revision: dataset.revision,
            created: dataset.created,
            created_by: dataset.created_by,
            updated: dataset.updated,
            links: vec![
                Link::json(at.clone(), "self", "this document"),
                Link::json(format!("{at}/hits"), "items", "its hits"),
                Link::new(format!("{at}/picture"), "preview", "image/svg+xml", "a picture of it"),
            ],
        }
    }
}

/// The entity tag that writes are checked against.
fn tag(dataset: &Dataset) -> String {
    format!("\"{}\"", dataset.revision)
}

/// The data set of that id, or the problem that there is none.
pub(super) async fn find(state: &AppState, id: Uuid) -> ApiResult<Dataset> {
    let dataset = state.store.dataset(id).await?;
    dataset.ok_or_else(|| unknown(id))
}

/// 404 for an id of no data set.
fn unknown(id: Uuid) -> ApiError {
    Problem::new(Code::UnknownDataset, format!("there is no data set {id}; GET /v1/datasets lists them")).into()
}

/// A failure of the store to change a data set, which somebody else may have removed.
fn changing(id: Uuid) -> impl FnOnce(StoreError) -> ApiError {
    move |error| if matches!(error, StoreError::Missing) { unknown(id) } else { error.into() }
}

/// What a file is by its `Content-Type`; none where that says nothing about it.
fn format_of(headers: &HeaderMap) -> Result<Option<FileFormat>, Problem> {
    let text = headers.get(header::CONTENT_TYPE).and_then(|value| value.to_str().ok()).unwrap_or_default();
    let essence = text.split(';').next().unwrap_or_default().trim().to_ascii_lowercase();
    match essence.as_str() {
        "" | "application/octet-stream" => Ok(None),
        "text/csv" => Ok(Some(FileFormat::Csv)),
        "text/tab-separated-values" => Ok(Some(FileFormat::Tsv)),
        "application/vnd.apache.parquet" => Ok(Some(FileFormat::Parquet)),
        "application/vnd.sqlite3" => Ok(Some(FileFormat::Pridb)),
        "audio/wav" => Ok(Some(FileFormat::Wav)),
        _ => {
            let detail = format!(
                "Content-Type must be text/csv, text/tab-separated-values, application/vnd.apache.parquet, \
                 application/vnd.sqlite3, audio/wav or application/octet-stream, not {essence:?}"
            );
            Err(Problem::new(Code::UnsupportedMediaType, detail))
        }
    }
}

fn wrong_metadata(prefix: &str, code: Code) -> impl Fn(EmissionError) -> Problem {
    move |error| {
        let name = match &error {
            EmissionError::Option { option, .. } => format!("{prefix}/{option}"),
            _ => prefix.to_owned(),
        };
        Problem::field(code, name, "out_of_range", error.to_string())
    }
}

/// Takes a file of hits in: CSV, TSV (also with the lines that Mistras puts before the header), Parquet, Vallen `.pridb`, Mistras
/// `.DTA` (`format=dta`); or of waveforms, in which hits are found: WAV, NPY, Vallen `.tradb` (`format=tradb`). The file is
/// read and checked in whole before anything is stored; a row at fault is named by its line. Columns have their canonical names (`time_s`, `amplitude_v` or `amplitude_db`, `duration_us`, `rise_time_us`,
/// `counts`, `energy_eu`, `channel`, `threshold_db`, `x_m`, `y_m`, `z_m`, `strain`, `stress_mpa`, `phase`) or one of the
/// usual ones; what is not known is left out and listed.
#[utoipa::path(post, path = "/v1/datasets", operation_id = "create_dataset", tag = "datasets", params(UploadQuery),
    request_body(content(
        (String = "text/csv", example = "time_s,amplitude_v,duration_us\n0.5,0.012,340\n"),
        (String = "text/tab-separated-values"),
        (String = "application/vnd.apache.parquet"),
        (String = "application/vnd.sqlite3"),
        (String = "audio/wav"),
        (String = "application/octet-stream"))),
    responses((status = 201, description = "The data set; `Location` is its address.", body = DatasetResource,
               headers(("Location" = String, description = "The data set.")))))]
pub async fn create_dataset(
    State(state): State<AppState>,
    Query(query): Query<UploadQuery>,
    caller: Caller,
    request: Request,
) -> ApiResult<Response> {
    let threshold_v = query.threshold_v.map(|value| value.0);
    let metadata = Metadata {
        temperature_c: query.temperature_c,
        grain_size_mm: query.grain_size_mm.map(|value| value.0),
        stress_mpa: query.stress_mpa,
        phase: query.phase,
        preamp_gain_db: query.preamp_gain_db,
        threshold_v,
        ..Metadata::default()
    };
    metadata.check().map_err(wrong_metadata("", Code::InvalidParameter))?;
    let format = query.format.or(format_of(request.headers())?);
    let folder = state.config.data_dir.join(super::spool::FOLDER);
    let spooled = spool(request, &folder, state.config.max_dataset_bytes).await?;
    let upload = Upload {
        path: spooled.path().to_owned(),
        format,
        options: ReadOptions {
            amplitude_unit: query.amplitude_unit,
            wave: WaveOptions {
                threshold_v,
                hit_definition_s: query.hit_definition_s.map(|value| value.0),
                hit_lockout_s: query.hit_lockout_s.map(|value| value.0),
                peak_definition_s: query.peak_definition_s.map(|value| value.0),
                sample_rate_hz: query.sample_rate_hz.map(|value| value.0),
                full_scale_v: query.full_scale_v.map(|value| value.0),
            },
        },
        body: DatasetBody { name: query.name, metadata },
        bytes: spooled.bytes,
        sha256: spooled.sha256.clone(),
        by: caller.name,
    };
    // two at once: each needs some hundreds of MiB for a large file
    let _turn = state.intake.acquire().await.map_err(Problem::internal)?;
    let dataset = intake::take_in(&state.desk, upload).await?;
    let location = format!("/v1/datasets/{}", dataset.id);
    let tag = tag(&dataset);
    let mut response =
        respond::tagged(&Conditions::default(), StatusCode::CREATED, &tag, &DatasetResource::from(dataset))?;
    if let Ok(location) = HeaderValue::from_str(&location) {
        response.headers_mut().insert(header::LOCATION, location);
    }
    Ok(response)
}

/// Lists data sets, newest first.
#[utoipa::path(get, path = "/v1/datasets", operation_id = "list_datasets", tag = "datasets", params(ListQuery),
    responses((status = 200, description = "A page of data sets.", body = DatasetList)))]
pub async fn list_datasets(
    State(state): State<AppState>,
    Query(query): Query<ListQuery>,
    conditions: Conditions,
) -> ApiResult<Response> {
    let limit = Limit::or_default(query.limit);
    let mut datasets = state.store.datasets(query.cursor, limit + 1).await?;
    let more = datasets.len() > limit as usize;
    datasets.truncate(limit as usize);
    let next = datasets.last().filter(|_| more).map(|dataset| dataset.id);
    let list = DatasetList { datasets: datasets.into_iter().map(Into::into).collect(), next };
    let mut response = respond::resource(&conditions, &list)?;
    if let Some(cursor) = next {
        respond::link_next(&mut response, &format!("/v1/datasets?limit={limit}&cursor={cursor}"));
    }
    Ok(response)
}

/// One data set: its columns in a few numbers, quality flags, metadata.
#[utoipa::path(get, path = "/v1/datasets/{dataset}", operation_id = "get_dataset", tag = "datasets", params(DatasetPath),
    responses((status = 200, description = "The data set.", body = DatasetResource)))]
pub async fn get_dataset(
    State(state): State<AppState>,
    Path(path): Path<DatasetPath>,
    conditions: Conditions,
) -> ApiResult<Response> {
    let dataset = find(&state, path.dataset).await?;
    let tag = tag(&dataset);
    respond::tagged(&conditions, StatusCode::OK, &tag, &DatasetResource::from(dataset))
}

/// Replaces name and metadata of a data set; its hits never change.
#[utoipa::path(put, path = "/v1/datasets/{dataset}", operation_id = "put_dataset", tag = "datasets", params(DatasetPath),
    request_body(content = DatasetBody, example = json!({"name": "polycrystal 0.87 mm", "metadata": {
        "material": "ice", "temperature_c": -10.0, "grain_size_mm": 0.87, "stress_mpa": 0.55}})),
    responses((status = 200, description = "The data set now.", body = DatasetResource)))]
pub async fn put_dataset(
    State(state): State<AppState>,
    Path(path): Path<DatasetPath>,
    conditions: Conditions,
    JsonBody(body): JsonBody<DatasetBody>,
) -> ApiResult<Response> {
    body.metadata.check().map_err(wrong_metadata("/metadata", Code::InvalidBody))?;
    let (id, now) = (path.dataset, clock::now());
    let permits = |before: &Dataset| conditions.permit_write(Some(&tag(before)));
    let dataset = state.store.put_dataset(id, &body, now, permits).await.map_err(changing(id))?;
    let tag = tag(&dataset);
    respond::tagged(&Conditions::default(), StatusCode::OK, &tag, &DatasetResource::from(dataset))
}

/// Removes a data set. Results that were computed from it stay; jobs that wait for it will fail.
#[utoipa::path(delete, path = "/v1/datasets/{dataset}", operation_id = "delete_dataset", tag = "datasets", params(DatasetPath),
    responses((status = 204, description = "It is gone.")))]
pub async fn delete_dataset(
    State(state): State<AppState>,
    Path(path): Path<DatasetPath>,
    conditions: Conditions,
) -> ApiResult<Response> {
    let permits = |before: &Dataset| conditions.permit_write(Some(&tag(before)));
    state.desk.remove_dataset(path.dataset, permits).await.map_err(changing(path.dataset))?;
    Ok(StatusCode::NO_CONTENT.into_response())
}
