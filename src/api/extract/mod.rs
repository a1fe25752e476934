//! Extractors whose every refusal is a problem with a pointer: axum's own answer in plain text.

mod body;
mod conditions;
mod params;

pub use body::{Body, BodyLimit, JsonBody, MediaType, json_fault, media_type};
pub use conditions::{Conditions, etag};
pub use params::{Path, Query};

pub use crate::domain::date::Date;
