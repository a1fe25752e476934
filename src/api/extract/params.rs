//! Parameters of the address.

use std::fmt;

use axum::{
    extract::{FromRequestParts, RawPathParams},
    http::request::Parts,
};
use serde::de::DeserializeOwned;

use crate::{
    api::problem::ApiError,
    domain::problem::{Code, Problem},
};

/// The query of the address as `T`; a name that `T` does not know is refused.
#[derive(Clone, Copy, Debug)]
pub struct Query<T>(pub T);

impl<T: DeserializeOwned, S: Sync> FromRequestParts<S> for Query<T> {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Self::Rejection> {
        parse_query(parts.uri.query().unwrap_or_default()).map(Self).map_err(ApiError)
    }
}

fn parse_query<T: DeserializeOwned>(query: &str) -> Result<T, Problem> {
    let deserializer = serde_urlencoded::Deserializer::new(form_urlencoded::parse(query.as_bytes()));
    serde_path_to_error::deserialize(deserializer).map_err(|error| parameter_fault(&error))
}

fn parameter_fault<E: fmt::Display>(error: &serde_path_to_error::Error<E>) -> Problem {
    let path = error.path().to_string();
    let message = plain(error.inner().to_string());
    // the path of an unknown or missing field is the struct itself: its name stands in the message, in backquotes
    let name = match path.as_str() {
        "." => message.split('`').nth(1).unwrap_or_default().to_owned(),
        _ => path,
    };
    Problem::field(Code::InvalidParameter, format!("/{name}"), "invalid_parameter", message)
}

/// What would be accepted, where a library's reader only says what it did not like.
fn plain(message: String) -> String {
    let accepted = match message.as_str() {
        "invalid digit found in string" | "cannot parse integer from empty string" => {
            "must be a whole number, 0 or more"
        }
        "number too large to fit in target type" => "must be a smaller whole number",
        "invalid float literal" | "cannot parse float from empty string" => "must be a number",
        "provided string was not `true` or `false`" => "must be true or false",
        uuid if uuid.starts_with("UUID parsing failed") => "must be an id as this service gives them: a UUID",
        _ => return message,
    };
    accepted.to_owned()
}

/// The variable parts of the path as `T`: a struct with their names.
#[derive(Clone, Copy, Debug)]
pub struct Path<T>(pub T);

impl<T: DeserializeOwned, S: Send + Sync> FromRequestParts<S> for Path<T> {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Self::Rejection> {
        let raw = RawPathParams::from_request_parts(parts, state)
            .await
            .map_err(|error| Problem::field(Code::InvalidParameter, "/path", "invalid_parameter", error.to_string()))?;
        // one pair a part, each percent-decoded: the same reader as for the query serves both
        let encoded = form_urlencoded::Serializer::new(String::new()).extend_pairs(raw.iter()).finish();
        parse_query(&encoded).map(Self).map_err(ApiError)
    }
}

#[cfg(test)]
mod tests {
    use jiff::civil;
    use serde::Deserialize;

    use super::*;
    use crate::domain::date::Date;

    #[derive(Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Range {
        #[serde(default)]
        from: Option<Date>,
        #[serde(default)]
        limit: Option<u32>,
    }

    fn fault(query: &str) -> (String, String) {
        let problem = parse_query::<Range>(query).unwrap_err();
        (problem.errors[0].pointer.clone(), problem.errors[0].detail.clone())
    }

    #[test]
    fn a_fault_names_the_parameter_and_what_is_accepted() {
        let (pointer, detail) = fault("from=2007-02-30");
        assert_eq!(pointer, "/from");
        assert!(detail.contains("YYYY-MM-DD"), "{detail}");
        let (pointer, detail) = fault("limit=many");
        assert_eq!(pointer, "/limit");
        assert_eq!(detail, "must be a whole number, 0 or more");
        let (pointer, detail) = fault("form=2007-02-01");
        assert_eq!(pointer, "/form");
        assert!(detail.contains("`from`"), "{detail}");
    }

    #[test]
    fn a_good_query_is_read() {
        let range: Range = parse_query("from=2007-02-14&limit=5").unwrap();
        assert_eq!(range.limit, Some(5));
        assert_eq!(range.from.unwrap().0, civil::date(2007, 2, 14));
    }
}
