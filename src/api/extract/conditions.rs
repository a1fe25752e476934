//! Conditional requests: RFC 9110, section 13.

use axum::{
    extract::FromRequestParts,
    http::{HeaderMap, HeaderName, HeaderValue, header, request::Parts},
};
use sha2::{Digest, Sha256};

use crate::{
    api::problem::ApiError,
    domain::problem::{Code, Problem},
};

/// The `If-Match` and `If-None-Match` of a request.
#[derive(Clone, Debug, Default)]
pub struct Conditions {
    if_match: Option<Tags>,
    if_none_match: Option<Tags>,
}

#[derive(Clone, Debug)]
enum Tags {
    Any,
    Listed(Vec<String>),
}

impl Tags {
    fn parse(name: &HeaderName, headers: &HeaderMap) -> Result<Option<Self>, Problem> {
        let Some(value) = headers.get(name) else { return Ok(None) };
        let refuse = || {
            let detail = format!("{name} must be * or a list of entity tags in double quotes, as ETag sends them");
            Problem::new(Code::InvalidHeader, detail)
        };
        let text = value.to_str().map_err(|_| refuse())?.trim();
        if text == "*" {
            return Ok(Some(Self::Any));
        }
        listed(text).map(|tags| Some(Self::Listed(tags))).ok_or_else(refuse)
    }

    fn names(&self, current: Option<&str>) -> bool {
        match (self, current) {
            (_, None) => false,
            (Self::Any, Some(_)) => true,
            (Self::Listed(tags), Some(current)) => tags.iter().any(|tag| tag == current),
        }
    }
}

/// The entity tags of a list, each with its quotes and without `W/`; none where the list is malformed. A comma is a
/// separator only outside of the quotes.
fn listed(text: &str) -> Option<Vec<String>> {
    let mut tags = Vec::new();
    let mut rest = text;
    loop {
        let opaque = rest.strip_prefix("W/").unwrap_or(rest).strip_prefix('"')?;
        let (tag, after) = opaque.split_once('"')?;
        tags.push(format!("\"{tag}\""));
        let after = after.trim_start();
        if after.is_empty() {
            return Some(tags);
        }
        rest = after.strip_prefix(',')?.trim_start();
    }
}

impl Conditions {
    /// Whether a write may go on, given the entity tag of what is there now (none: nothing is there).
    #[must_use]
    pub fn permit_write(&self, current: Option<&str>) -> bool {
        self.if_match.as_ref().is_none_or(|tags| tags.names(current))
            && self.if_none_match.as_ref().is_none_or(|tags| !tags.names(current))
    }

    /// Whether the caller of a read has this version already.
    #[must_use]
    pub fn is_fresh(&self, current: &str) -> bool {
        self.if_none_match.as_ref().is_some_and(|tags| tags.names(Some(current)))
    }
}

impl<S: Sync> FromRequestParts<S> for Conditions {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Self::Rejection> {
        Ok(Self {
            if_match: Tags::parse(&header::IF_MATCH, &parts.headers)?,
            if_none_match: Tags::parse(&header::IF_NONE_MATCH, &parts.headers)?,
        })
    }
}

/// The entity tag of a representation: the first 128 bits of its SHA-256.
#[must_use]
pub fn etag(body: &[u8]) -> HeaderValue {
    let digest = Sha256::digest(body);
    let hex: String = digest.iter().take(16).map(|byte| format!("{byte:02x}")).collect();
    HeaderValue::from_str(&format!("\"{hex}\"")).unwrap_or_else(|_| HeaderValue::from_static("\"\""))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn conditions(name: HeaderName, value: &str) -> Conditions {
        let mut headers = HeaderMap::new();
        headers.insert(&name, HeaderValue::from_str(value).unwrap());
        Conditions {
            if_match: Tags::parse(&header::IF_MATCH, &headers).unwrap(),
            if_none_match: Tags::parse(&header::IF_NONE_MATCH, &headers).unwrap(),
        }
    }

    #[test]
    fn if_match_needs_the_version_that_is_there() {
        let conditions = conditions(header::IF_MATCH, "\"1\", \"2\"");
        assert!(conditions.permit_write(Some("\"2\"")));
        assert!(!conditions.permit_write(Some("\"3\"")));
        assert!(!conditions.permit_write(None));
    }

    #[test]
    fn if_none_match_star_writes_only_what_is_new() {
        let conditions = conditions(header::IF_NONE_MATCH, "*");
        assert!(conditions.permit_write(None));
        assert!(!conditions.permit_write(Some("\"1\"")));
        assert!(conditions.is_fresh("\"1\""));
    }

    #[test]
    fn a_tag_without_quotes_is_refused() {
        let mut headers = HeaderMap::new();
        headers.insert(header::IF_MATCH, HeaderValue::from_static("abc"));
        assert_eq!(Tags::parse(&header::IF_MATCH, &headers).unwrap_err().code, Code::InvalidHeader);
    }

    #[test]
    fn lists_are_read_as_rfc_9110_writes_them() {
        assert_eq!(
            listed(r#""a", W/"b","c,d" , "","e""#).unwrap(),
            [r#""a""#, r#""b""#, r#""c,d""#, r#""""#, r#""e""#]
        );
        for bad in ["", "a", "\"", "\"a", "\"a\"b\"", "\"a\" \"b\"", "\"a\",", "w/\"a\"", "*, \"a\""] {
            assert!(listed(bad).is_none(), "{bad}");
        }
    }
}
