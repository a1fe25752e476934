//! A request that is awaited for its answer, and the answer with what every answer must keep to.

use std::{
    future::{Future, IntoFuture},
    pin::Pin,
    sync::LazyLock,
};

use firn::domain::problem::Code;
use reqwest::{RequestBuilder, header::HeaderMap};
use serde_json::Value;

use super::app::beside_the_servers;

/// A request; awaiting it sends it.
pub struct Call(pub RequestBuilder);

impl Call {
    /// The same with a JSON body.
    pub fn json(self, body: &Value) -> Self {
        Self(self.0.json(body))
    }

    /// The same with any body.
    pub fn body(self, media_type: &str, body: impl Into<reqwest::Body>) -> Self {
        Self(self.0.header("content-type", media_type).body(body))
    }

    /// The same with a header.
    pub fn header(self, name: &str, value: &str) -> Self {
        Self(self.0.header(name, value))
    }

    /// The same with a key.
    pub fn key(self, key: &str) -> Self {
        Self(self.0.bearer_auth(key))
    }
}

impl IntoFuture for Call {
    type Output = Answer;
    type IntoFuture = Pin<Box<dyn Future<Output = Answer> + Send>>;

    fn into_future(self) -> Self::IntoFuture {
        // a connection belongs to the runtime that opened it, and the next test has another
        Box::pin(beside_the_servers(async move {
            let (client, request) = self.0.build_split();
            let request = request.expect("a request");
            let (method, path) = (request.method().as_str().to_lowercase(), request.url().path().to_owned());
            let response = client.execute(request).await.expect("the server answers");
            assert_documented(&method, &path, response.status().as_u16());
            Answer {
                status: response.status().as_u16(),
                headers: response.headers().clone(),
                body: response.bytes().await.expect("the body arrives").to_vec(),
            }
        }))
    }
}

/// That the contract knows this answer: every status of an operation is written down there. An address or method that is no
/// operation has none.
fn assert_documented(method: &str, path: &str, status: u16) {
    static DOCUMENT: LazyLock<Value> = LazyLock::new(|| serde_json::from_str(firn::api::openapi::text()).unwrap());
    let fits = |template: &str| {
        let (parts, names) = (path.split('/'), template.split('/'));
        parts.clone().count() == names.clone().count() && parts.zip(names).all(|(a, b)| a == b || b.starts_with('{'))
    };
    let paths = DOCUMENT["paths"].as_object().expect("paths");
    // a literal address goes before one with a parameter
    let mut found: Vec<_> = paths.iter().filter(|(template, _)| fits(template)).collect();
    found.sort_by_key(|(template, _)| template.matches('{').count());
    if let Some(operation) = found.first().and_then(|(_, item)| item.get(method)) {
        let documented = operation["responses"].get(status.to_string()).is_some();
        assert!(documented, "{method} {path} answers {status}, which the contract does not know");
    }
}

/// What the server said.
#[derive(Debug)]
pub struct Answer {
    pub status: u16,
    pub headers: HeaderMap,
    pub body: Vec<u8>,
}

impl Answer {
    /// A header as text; panics where there is none.
    pub fn header(&self, name: &str) -> &str {
        let value = self.headers.get(name).unwrap_or_else(|| panic!("no header {name} in {self:?}"));
        value.to_str().expect("a header in ASCII")
    }

    /// The body as text.
    pub fn text(&self) -> String {
        String::from_utf8(self.body.clone()).expect("a body in UTF-8")
    }

    /// The JSON body of an answer of that status.
    pub fn json(&self, status: u16) -> Value {
        assert_eq!(self.status, status, "{}", String::from_utf8_lossy(&self.body));
        assert_eq!(self.header("content-type"), "application/json", "{self:?}");
        serde_json::from_slice(&self.body).expect("a JSON body")
    }

    /// The problem document of a refusal, after checking all that holds for every one of them.
    pub fn problem(&self, code: &str) -> Value {
        let known = Code::from_slug(code).unwrap_or_else(|| panic!("{code} is no code of the table"));
        assert_eq!(self.status, known.status(), "{}", String::from_utf8_lossy(&self.body));
        assert_eq!(self.header("content-type"), "application/problem+json");
        let problem: Value = serde_json::from_slice(&self.body).expect("a JSON body");
        assert_eq!(problem["code"], code, "{problem}");
        assert_eq!(problem["type"], known.type_uri(), "{problem}");
        assert_eq!(problem["title"], known.title(), "{problem}");
        assert_eq!(problem["status"], known.status(), "{problem}");
        assert!(problem["detail"].as_str().is_some_and(|detail| !detail.is_empty()), "{problem}");
        assert_eq!(problem["traceId"], self.header("x-request-id"), "{problem}");
        for error in problem["errors"].as_array().into_iter().flatten() {
            for member in ["pointer", "detail", "code"] {
                assert!(error[member].is_string(), "{problem}");
            }
        }
        problem
    }

    /// The pointers of a refusal, in their order.
    pub fn pointers(&self, code: &str) -> Vec<String> {
        let problem = self.problem(code);
        let errors = problem["errors"].as_array().unwrap_or_else(|| panic!("no errors in {problem}"));
        errors.iter().map(|error| error["pointer"].as_str().unwrap().to_owned()).collect()
    }
}
