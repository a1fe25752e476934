//! `/v1/models/{model}/selection`: how many features it takes, for a model that was trained with the answer.

use axum::{
    extract::State,
    http::{HeaderMap, StatusCode},
    response::Response,
};
use serde::Serialize;
use serde_json::Value;
use utoipa::ToSchema;
use uuid::Uuid;

use super::{
    AppState,
    extract::{Conditions, Path, etag},
    models::{self, ModelPath},
    problem::ApiResult,
    respond,
};
use crate::{
    domain::{
        ids::{RegionId, StationId},
        problem::{Code, Problem},
    },
    formats::figures::{self, ImageFormat},
    science::forecast::selection::FeatureSelection,
    store::selections::SelectionRecord,
};

/// The elimination that chose the features of a model.
#[derive(Serialize, ToSchema)]
pub struct SelectionResource {
    /// The model.
    model_id: Uuid,
    /// The features that the model reads, in the order of its columns.
    used: Vec<String>,
    /// The job of the process `select-features` that found it.
    job: Uuid,
    /// The station whose days it was made on; null where it was a region.
    station: Option<StationId>,
    /// The region whose stations it was made on; null where it was a station.
    region: Option<RegionId>,
    /// True where these were made by a generator.
    synthetic: bool,
    /// The curve, the ranking and the proposal.
    #[serde(flatten)]
    selection: FeatureSelection,
    /// Version of firn, SHA-256 of everything that it was made on, and seed.
    #[schema(value_type = Object)]
    provenance: Value,
}

/// The elimination that chose the features of a model: the score of held-out seasons at every number of features with its
/// spread, the ranking, the proposed number. As JSON, or as a picture (`Accept: image/svg+xml` or
/// `image/png`).
#[utoipa::path(get, path = "/v1/models/{model}/selection", operation_id = "get_model_selection", tag = "models",
    params(ModelPath), responses((status = 200, description = "The elimination.",
        content((SelectionResource = "application/json"), (String = "image/svg+xml"), (Vec<u8> = "image/png")))))]
pub async fn get_selection(
    State(state): State<AppState>,
    Path(path): Path<ModelPath>,
    conditions: Conditions,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let formats = [ImageFormat::Svg, ImageFormat::Png];
    let wanted = formats.map(|format| respond::prefers(&headers, format.media_type()));
    if wanted == [None, None] {
        let detail = "served as application/json, image/svg+xml and image/png";
        return Err(Problem::new(Code::NotAcceptable, detail).into());
    }
    let picture = formats.into_iter().zip(wanted).find(|(_, wanted)| *wanted == Some(true)).map(|(format, _)| format);
    let model = models::find(&state, path.model).await?;
    let job = model.selection.ok_or_else(|| {
        let detail = format!("model {} was trained without a selection of features", model.id);
        Problem::new(Code::NoSelection, detail)
    })?;
    let trained = state.store.trained_model(model.id).await?.ok_or_else(|| models::unknown(model.id))?;
    let found = state.store.selection(job).await?.ok_or_else(|| Problem::internal("a selection is gone"))?;
    if let Some(format) = picture {
        let figure = figures::of_selection(&found.selection, Some(trained.features.len()), found.synthetic);
        // some hundredths of a second: not on a thread that answers others
        let drawn = tokio::task::spawn_blocking(move || figure.draw(format)).await.map_err(Problem::internal)?;
        let bytes = drawn.map_err(Problem::internal)?;
        return Ok(respond::tagged_bytes(&conditions, StatusCode::OK, etag(&bytes), format.media_type(), bytes));
    }
    let SelectionRecord { place, synthetic, selection, provenance } = found;
    let (station, region) = (place.station().cloned(), place.region().cloned());
    let used = trained.features.clone();
    let resource =
        SelectionResource { model_id: model.id, used, job, station, region, synthetic, selection, provenance };
    respond::resource(&conditions, &resource)
}
