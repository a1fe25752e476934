//! `/v1/datasets/{dataset}/hits` and `/picture`: the hits of a data set, page by page and at a glance.

use std::collections::BTreeMap;

use axum::{
    extract::State,
    http::{HeaderMap, StatusCode, header},
    response::Response,
};
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};
use uuid::Uuid;

use super::{
    AppState,
    datasets::{DatasetPath, find},
    extract::{Conditions, Path, Query, etag},
    problem::ApiResult,
    respond,
    stations::Limit,
};
use crate::{
    domain::{
        dataset::{Columns, Dataset},
        problem::{Code, Problem},
    },
    formats::{
        emission::{
            MOST_ROWS,
            columns::{self, Layout},
        },
        figures::{self, ImageFormat},
    },
    science::emission::catalogue::Catalogue,
};

/// Which hits.
#[derive(Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub struct HitsQuery {
    /// Largest number of hits in the answer, 1 to 100000.
    #[serde(default)]
    #[param(value_type = Option<u32>, minimum = 1, maximum = 100_000, default = 1000)]
    limit: Option<Limit<1000, 100_000>>,
    /// Where the page begins: `next` of the page before.
    #[serde(default)]
    #[param(value_type = Option<u64>, minimum = 0, maximum = 5_000_000)]
    cursor: Option<RowNumber>,
}

/// The number of a hit, from 0.
#[derive(Clone, Copy, Deserialize)]
#[serde(try_from = "u64")]
struct RowNumber(u64);

impl TryFrom<u64> for RowNumber {
    type Error = String;

    fn try_from(row: u64) -> Result<Self, String> {
        if row <= MOST_ROWS as u64 { Ok(Self(row)) } else { Err(format!("must be from 0 to {MOST_ROWS}, not {row}")) }
    }
}

/// A page of hits.
#[derive(Serialize, ToSchema)]
pub struct HitPage {
    /// The data set.
    dataset: Uuid,
    /// True where a generator made it.
    synthetic: bool,
    /// Number of the first hit of the page, from 0.
    first: u64,
    /// Hits of the data set.
    total: u64,
    /// The columns, by their canonical names; null where a value is missing.
    columns: BTreeMap<&'static str, Vec<Option<f64>>>,
    /// The `cursor` of the next page; null on the last.
    next: Option<u64>,
}

/// Some rows of all columns of a data set.
async fn rows(state: &AppState, dataset: &Dataset, from: u64, to: u64) -> ApiResult<Columns> {
    let names = dataset.description.columns.iter().map(|statistics| statistics.column);
    let layout = Layout::new(dataset.description.events as u64, names);
    let mut found = Columns::new();
    for column in layout.columns.clone() {
        let range = layout.bytes_of(column, from..to).unwrap_or(0..0);
        let bytes = state.desk.artifacts().get(&dataset.sha256, range).await.map_err(Problem::internal)?;
        found.insert(column, columns::values(&bytes));
    }
    Ok(found)
}

/// A picture of a data set: the distribution of its amplitudes. As SVG, or as PNG (`Accept: image/png`).
#[utoipa::path(get, path = "/v1/datasets/{dataset}/picture", operation_id = "get_dataset_picture", tag = "datasets",
    params(DatasetPath),
    responses((status = 200, description = "The picture.", content((String = "image/svg+xml"), (String = "image/png")))))]
pub async fn get_picture(
    State(state): State<AppState>,
    Path(path): Path<DatasetPath>,
    conditions: Conditions,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let format = picture_format(&headers)
        .ok_or_else(|| Problem::new(Code::NotAcceptable, "served as image/svg+xml and image/png"))?;
    let dataset = find(&state, path.dataset).await?;
    let columns = rows(&state, &dataset, 0, dataset.description.events as u64).await?;
    let picture = tokio::task::spawn_blocking(move || {
        let catalogue = Catalogue::new(columns, dataset.body.metadata).map_err(Problem::internal)?;
        let figure = figures::of_catalogue(&catalogue, dataset.body.name.as_str(), dataset.truth.is_some());
        let nothing = || Problem::new(Code::UnknownOutput, "no column of the data set has values above 0 to draw");
        figure.ok_or_else(nothing)?.draw(format).map_err(Problem::internal)
    });
    let picture = picture.await.map_err(Problem::internal)??;
    Ok(respond::tagged_bytes(&conditions, StatusCode::OK, etag(&picture), format.media_type(), picture))
}

/// What the caller prefers; none where it accepts neither.
fn picture_format(headers: &HeaderMap) -> Option<ImageFormat> {
    let Some(accept) = headers.get(header::ACCEPT) else { return Some(ImageFormat::Svg) };
    let accept = accept.to_str().ok()?.to_ascii_lowercase();
    let names = |name: &str| accept.split(',').any(|range| range.split(';').next().unwrap_or_default().trim() == name);
    if names("image/svg+xml") || names("image/*") || names("*/*") {
        Some(ImageFormat::Svg)
    } else {
        names("image/png").then_some(ImageFormat::Png)
    }
}

/// A page as CSV with canonical names: what `POST /v1/datasets` reads.
fn csv(page: &Columns) -> String {
    let names: Vec<&str> = page.keys().map(|column| column.name()).collect();
    let mut text = names.join(",");
    text.push('\n');
    let rows = page.values().next().map_or(0, Vec::len);
    for row in 0..rows {
        for (at, values) in page.values().enumerate() {
            if at > 0 {
                text.push(',');
            }
            if let Some(value) = values.get(row).filter(|value| !value.is_nan()) {
                text.push_str(&value.to_string());
            }
        }
        text.push('\n');
    }
    text
}

/// The hits of a data set in the order of time, column by column; with `Accept: text/csv` as a table with canonical names.
#[utoipa::path(get, path = "/v1/datasets/{dataset}/hits", operation_id = "list_hits", tag = "datasets",
    params(DatasetPath, HitsQuery),
    responses((status = 200, description = "A page of hits; `Link: rel=\"next\"` is the next page.",
               content((HitPage = "application/json"), (String = "text/csv")))))]
pub async fn list_hits(
    State(state): State<AppState>,
    Path(path): Path<DatasetPath>,
    Query(query): Query<HitsQuery>,
    conditions: Conditions,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let as_csv = respond::prefers(&headers, "text/csv")
        .ok_or_else(|| Problem::new(Code::NotAcceptable, "served as application/json and text/csv"))?;
    let dataset = find(&state, path.dataset).await?;
    let limit = Limit::or_default(query.limit);
    let total = dataset.description.events as u64;
    let first = query.cursor.map_or(0, |row| row.0).min(total);
    let to = total.min(first + u64::from(limit));
    let page = rows(&state, &dataset, first, to).await?;
    let next = (to < total).then_some(to);
    let mut response = if as_csv {
        let body = csv(&page).into_bytes();
        respond::tagged_bytes(&conditions, StatusCode::OK, etag(&body), "text/csv", body)
    } else {
        let there = |value: f64| (!value.is_nan()).then_some(value);
        let columns =
            page.into_iter().map(|(column, values)| (column.name(), values.into_iter().map(there).collect())).collect();
        let synthetic = dataset.truth.is_some();
        let document = HitPage { dataset: dataset.id, synthetic, first, total, columns, next };
        respond::resource(&conditions, &document)?
    };
    if let Some(cursor) = next {
        let at = format!("/v1/datasets/{}/hits?limit={limit}&cursor={cursor}", dataset.id);
        respond::link_next(&mut response, &at);
    }
    Ok(response)
}
