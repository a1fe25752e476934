//! Bodies: their size, their media type, and JSON read into types.

use axum::{
    body::Bytes,
    extract::{FromRequest, Request, rejection::BytesRejection},
    http::{HeaderMap, HeaderValue, StatusCode, header},
};
use serde::de::DeserializeOwned;
use utoipa::ToSchema;

use crate::{
    api::problem::ApiError,
    domain::{
        problem::{Code, Problem},
        schema,
    },
};

/// Bytes of JSON that one resource may have; only imports are larger.
const LARGEST_RESOURCE: usize = 1024 * 1024;

/// What a body claims to be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MediaType {
    /// `application/json`.
    Json,
    /// `application/x-ndjson`: one JSON value a line.
    Ndjson,
    /// `text/csv`.
    Csv,
    /// `text/x-smet`: SMET in ASCII.
    Smet,
}

/// The media type of a request.
///
/// # Errors
/// 415 that lists `accepted` for any other.
pub fn media_type(headers: &HeaderMap, accepted: &[MediaType]) -> Result<MediaType, Problem> {
    let text = headers.get(header::CONTENT_TYPE).and_then(|value| value.to_str().ok()).unwrap_or_default();
    let essence = text.split(';').next().unwrap_or_default().trim().to_ascii_lowercase();
    let found = match essence.as_str() {
        "application/json" => Some(MediaType::Json),
        "application/x-ndjson" | "application/ndjson" | "application/jsonl" => Some(MediaType::Ndjson),
        "text/csv" => Some(MediaType::Csv),
        "text/x-smet" => Some(MediaType::Smet),
        _ => None,
    };
    found.filter(|found| accepted.contains(found)).ok_or_else(|| {
        let accepted: Vec<&str> = accepted.iter().map(|media| media.name()).collect();
        let detail = format!("Content-Type must be {}, not {essence:?}", accepted.join(" or "));
        Problem::new(Code::UnsupportedMediaType, detail)
    })
}

impl MediaType {
    /// The name in `Content-Type`.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Json => "application/json",
            Self::Ndjson => "application/x-ndjson",
            Self::Csv => "text/csv",
            Self::Smet => "text/x-smet",
        }
    }
}

/// The limit of the router, bytes, for the words of a refusal.
#[derive(Clone, Copy, Debug)]
pub struct BodyLimit(pub usize);

/// A whole body within the limit of the router.
#[derive(Debug)]
pub struct Body(pub Bytes);

impl<S: Send + Sync> FromRequest<S> for Body {
    type Rejection = ApiError;

    async fn from_request(request: Request, state: &S) -> Result<Self, Self::Rejection> {
        uncompressed(request.headers())?;
        let limit = request.extensions().get::<BodyLimit>().copied();
        let read = Bytes::from_request(request, state).await;
        read.map(Self).map_err(|rejection| ApiError(unreadable(&rejection, limit)))
    }
}

/// Refuses a content coding: bytes that were compressed would be read as a malformed file.
///
/// # Errors
/// 415 for any coding but `identity`.
pub fn uncompressed(headers: &HeaderMap) -> Result<(), Problem> {
    let codings = headers.get_all(header::CONTENT_ENCODING).iter();
    let plain = |value: &HeaderValue| value.as_bytes().eq_ignore_ascii_case(b"identity");
    if codings.into_iter().all(plain) {
        return Ok(());
    }
    let detail = "Content-Encoding is not supported: send the body as it is";
    Err(Problem::new(Code::UnsupportedMediaType, detail))
}

fn unreadable(rejection: &BytesRejection, limit: Option<BodyLimit>) -> Problem {
    if rejection.status() == StatusCode::PAYLOAD_TOO_LARGE {
        let limit = limit.map_or_else(String::new, |limit| format!(" of {} bytes", limit.0));
        let detail = format!("the body exceeds the limit{limit} of this service (setting max_body_mib)");
        Problem::new(Code::PayloadTooLarge, detail)
    } else {
        Problem::new(Code::InvalidHeader, format!("the body could not be read: {}", rejection.body_text()))
    }
}

/// A JSON body as `T`.
#[derive(Debug)]
pub struct JsonBody<T>(pub T);

impl<T, S> FromRequest<S> for JsonBody<T>
where
    T: DeserializeOwned + ToSchema + 'static,
    S: Send + Sync,
{
    type Rejection = ApiError;

    async fn from_request(request: Request, state: &S) -> Result<Self, Self::Rejection> {
        media_type(request.headers(), &[MediaType::Json])?;
        let Body(bytes) = Body::from_request(request, state).await?;
        if bytes.len() > LARGEST_RESOURCE {
            let detail = format!("a resource is at most {LARGEST_RESOURCE} bytes of JSON, not {}", bytes.len());
            return Err(Problem::new(Code::PayloadTooLarge, detail).into());
        }
        parse(&bytes).map(Self).map_err(ApiError)
    }
}

/// Reads a whole body as `T` where its bytes are needed as well.
///
/// # Errors
/// As [`JsonBody`].
pub fn parse_json<T: DeserializeOwned + ToSchema + 'static>(headers: &HeaderMap, bytes: &[u8]) -> Result<T, Problem> {
    media_type(headers, &[MediaType::Json])?;
    parse(bytes)
}

/// Reads the bytes as `T`, straight into the type: only a refusal is looked at twice.
fn parse<T: DeserializeOwned + ToSchema + 'static>(bytes: &[u8]) -> Result<T, Problem> {
    let mut deserializer = serde_json::Deserializer::from_slice(bytes);
    let value = serde_path_to_error::deserialize(&mut deserializer);
    match value {
        Ok(value) => deserializer.end().map(|()| value).map_err(|error| not_json(&error)),
        Err(error) => Err(json_fault::<T>(bytes, &error, "")),
    }
}

/// Why `bytes` are no `T`: not JSON at all (400), or JSON with fields at fault (422), their pointers below `prefix`.
#[must_use]
pub fn json_fault<T: ToSchema + 'static>(
    bytes: &[u8],
    error: &serde_path_to_error::Error<serde_json::Error>,
    prefix: &str,
) -> Problem {
    let value: serde_json::Value = match serde_json::from_slice(bytes) {
        Ok(value) => value,
        Err(error) => return not_json(&error),
    };
    let faults = schema::explain::<T>(&value, error, prefix);
    let detail = faults
        .first()
        .map_or_else(String::new, |first| format!("{} {}", pointer_or_body(&first.pointer), first.detail));
    Problem::new(Code::InvalidBody, detail).with_errors(faults)
}

fn pointer_or_body(pointer: &str) -> &str {
    if pointer.is_empty() { "the body" } else { pointer }
}

fn not_json(error: &serde_json::Error) -> Problem {
    Problem::new(Code::InvalidJson, format!("not JSON: {error}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_compressed_body_is_refused_as_such() {
        let with = |value| HeaderMap::from_iter([(header::CONTENT_ENCODING, HeaderValue::from_static(value))]);
        assert!(uncompressed(&HeaderMap::new()).is_ok());
        assert!(uncompressed(&with("identity")).is_ok());
        assert_eq!(uncompressed(&with("gzip")).unwrap_err().code, Code::UnsupportedMediaType);
    }
}
