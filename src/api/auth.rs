//! Who calls, and what they may do.

use std::net::IpAddr;

use axum::{
    extract::{FromRequestParts, Request, State},
    http::{HeaderValue, Method, header, request::Parts, uri::Authority},
    middleware::Next,
    response::Response,
};

use super::{
    AppState,
    problem::{ApiError, REQUEST_ID},
};
use crate::{
    clock,
    config::Config,
    domain::problem::{Code, Problem},
    store::{audit::Actor, keys::Role},
};

/// Who sent a request.
#[derive(Clone, Debug)]
pub struct Caller {
    /// The name of the key; none where no key was needed.
    pub name: Option<String>,
    role: Role,
}

impl Caller {
    /// The caller as the audit names them, now.
    #[must_use]
    pub fn actor(&self) -> Actor {
        Actor { name: self.name.clone(), trace: REQUEST_ID.try_with(Clone::clone).ok(), at: clock::now() }
    }
}

impl<S: Sync> FromRequestParts<S> for Caller {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Self::Rejection> {
        let caller = parts.extensions.get::<Self>().cloned();
        caller.ok_or_else(|| ApiError(Problem::internal("a route without authentication asks who calls")))
    }
}

/// Whether every caller needs a key: on any address but loopback, unless the operator said otherwise.
#[must_use]
pub fn keys_needed(config: &Config) -> bool {
    !config.listen.ip().is_loopback() && !config.allow_anonymous
}

/// Lets a request pass with its [`Caller`], or refuses it with 401 or 403.
pub async fn authenticate(
    State(state): State<AppState>,
    mut request: Request,
    next: Next,
) -> Result<Response, ApiError> {
    let path = request.uri().path().to_owned();
    if is_public(&path) {
        return Ok(next.run(request).await);
    }
    // the body of a request cannot be shared between threads, so its header is taken out before the store is asked
    let credentials = request.headers().get(header::AUTHORIZATION).cloned();
    let host = request.headers().get(header::HOST).cloned();
    let caller = identify(&state, credentials, host).await?;
    let needed = role_for(request.method(), &path);
    if caller.role < needed {
        let detail = format!("this call needs the role {}, the key has {}", needed.name(), caller.role.name());
        return Err(Problem::new(Code::Forbidden, detail).into());
    }
    request.extensions_mut().insert(caller);
    Ok(next.run(request).await)
}

/// What a monitor, a browser or a client library needs before it has a key: nothing of it is data.
fn is_public(path: &str) -> bool {
    !(path == "/v1" || path.starts_with("/v1/"))
}

fn role_for(method: &Method, path: &str) -> Role {
    // a what-if is a question with a body: nothing of it is stored
    let asks = path.starts_with("/v1/stations/") && path.ends_with("/forecasts/what-if");
    if path == "/v1/audit" {
        Role::Operator
    } else if *method == Method::GET || *method == Method::HEAD || *method == Method::OPTIONS || asks {
        Role::Reader
    } else if path.ends_with("/active-model")
        || path.ends_with("/active-model/rollback")
        || path.starts_with("/v1/regions/")
        || (path.starts_with("/v1/stations/") && path.contains("/proposals/"))
    {
        Role::Operator
    } else {
        Role::Forecaster
    }
}

/// Whether `Host` is a name that no page of the web can have: DNS may give any other name our address (DNS rebinding).
fn names_this_machine(host: &HeaderValue) -> bool {
    let Ok(authority) = host.to_str().unwrap_or_default().parse::<Authority>() else { return false };
    let name = authority.host();
    let address: Option<IpAddr> = name.trim_start_matches('[').trim_end_matches(']').parse().ok();
    name.eq_ignore_ascii_case("localhost") || address.is_some_and(|address| address.is_loopback())
}

async fn identify(
    state: &AppState,
    credentials: Option<HeaderValue>,
    host: Option<HeaderValue>,
) -> Result<Caller, ApiError> {
    let Some(value) = credentials else {
        if keys_needed(&state.config) {
            return Err(Problem::new(Code::Unauthorized, "this service wants a key with every request").into());
        }
        if !state.config.allow_anonymous && !host.as_ref().is_none_or(names_this_machine) {
            let detail = "without a key the Host must be localhost or the address that the service listens on";
            return Err(Problem::new(Code::Misdirected, detail).into());
        }
        return Ok(Caller { name: None, role: Role::Admin });
    };
    let key = value.to_str().ok().and_then(|text| {
        let (scheme, key) = text.split_once(' ')?;
        scheme.eq_ignore_ascii_case("bearer").then(|| key.trim())
    });
    let found = match key {
        Some(key) => state.store.authenticate(key, clock::now()).await?,
        None => None,
    };
    let found = found.ok_or_else(|| Problem::new(Code::Unauthorized, "the key is not valid"))?;
    Ok(Caller { name: Some(found.name), role: found.role })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_names_of_this_machine_need_no_key() {
        for good in ["localhost", "LOCALHOST:8080", "127.0.0.1:8080", "127.9.9.9", "[::1]:8080"] {
            assert!(names_this_machine(&HeaderValue::from_static(good)), "{good}");
        }
        for bad in ["evil.example", "localhost.evil.example:8080", "192.168.0.1", "[::2]:80", "", "a b"] {
            assert!(!names_this_machine(&HeaderValue::from_static(bad)), "{bad}");
        }
    }
}
