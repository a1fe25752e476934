//! Extractors whose every refusal is a problem with a pointer: axum's own answer in plain text.

mod body;
mod conditions;
mod params;
mod prefer;

pub use body::{Body, BodyLimit, JsonBody, MediaType, json_fault, media_type, parse_json, uncompressed};
pub use conditions::{Conditions, etag};
pub use params::{Path, Query};
pub use prefer::{Wait, respond_async};

pub use crate::domain::date::Date;
