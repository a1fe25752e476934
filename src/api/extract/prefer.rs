//! What a caller would like (RFC 7240): to wait for an answer, or not to.

use std::{convert::Infallible, time::Duration};

use axum::{
    extract::FromRequestParts,
    http::{HeaderMap, HeaderValue, request::Parts},
    response::Response,
};

/// The longest that anybody may wait, s.
const LONGEST_S: u64 = 30;

/// `Prefer: wait=N`: how long the caller would wait for a better answer; zero where it does not say.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Wait(pub Duration);

impl<S: Sync> FromRequestParts<S> for Wait {
    type Rejection = Infallible;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Infallible> {
        let seconds = preferences(&parts.headers).find_map(|preference| {
            let (name, value) = preference.split_once('=')?;
            name.trim().eq_ignore_ascii_case("wait").then(|| value.trim().trim_matches('"').parse::<u64>().ok())?
        });
        Ok(Self(Duration::from_secs(seconds.unwrap_or(0).min(LONGEST_S))))
    }
}

impl Wait {
    /// The same, so that the answer comes before a request of at most `timeout` is given up.
    #[must_use]
    pub fn within(self, timeout: Duration) -> Self {
        const MARGIN: Duration = Duration::from_secs(1);
        Self(Duration::from_secs(self.0.min(timeout.saturating_sub(MARGIN)).as_secs()))
    }

    /// Says that the preference was heard.
    pub fn applied(self, response: &mut Response) {
        if !self.0.is_zero()
            && let Ok(value) = HeaderValue::from_str(&format!("wait={}", self.0.as_secs()))
        {
            response.headers_mut().insert("preference-applied", value);
        }
    }
}

/// Whether the caller asks not to wait.
pub fn respond_async(headers: &HeaderMap) -> bool {
    preferences(headers).any(|preference| preference.eq_ignore_ascii_case("respond-async"))
}

fn preferences(headers: &HeaderMap) -> impl Iterator<Item = &str> {
    let values = headers.get_all("prefer").iter().filter_map(|value| value.to_str().ok());
    values.flat_map(|value| value.split([',', ';'])).map(str::trim)
}
