//! The OpenAPI document: generated from the handlers, completed with what holds for all of them.

use std::sync::LazyLock;

use utoipa::{
    Modify, OpenApi, ToSchema,
    openapi::{
        Components, ContentBuilder, HeaderBuilder, Ref, RefOr, Required, ResponseBuilder, SecurityRequirement,
        path::{Operation, ParameterBuilder, ParameterIn},
        schema::{ObjectBuilder, Type},
        security::{HttpAuthScheme, HttpBuilder, SecurityScheme},
    },
};

use super::{problem::ProblemDocument, router};
use crate::domain::problem::FieldError;

/// What the document says of the service as a whole.
#[derive(OpenApi)]
#[openapi(
    info(
        title = "firn",
        description = "Avalanche forecasting and simulation service.\n\n\
            * Observation dates are the station's local days, instants are RFC 3339 in UTC, units stand with every field.\n\
            * `null` is a missing value and never 0; an avalanche activity of `unknown` is never `none`.\n\
            * Every refusal is `application/problem+json` (RFC 9457) with a JSON pointer to each field at fault; \
              `/problems` explains the kinds.\n\
            * Reads carry an `ETag` and answer 304 to `If-None-Match`; writes honour `If-Match` and `If-None-Match: *`.\n\
            * Lists are paged by `cursor`; `Link: rel=\"next\"` is the next page.",
        license(name = "MIT OR Apache-2.0", identifier = "MIT OR Apache-2.0"),
    ),
    tags(
        (name = "stations", description = "Places where somebody observes weather and snow every day."),
        (name = "observations", description = "Days of weather and snowpack, and their avalanches."),
        (name = "forecasts", description = "What the active model says of a day."),
        (name = "regions", description = "Several stations that feed one model, and what it says of them."),
        (name = "models", description = "Trained models, their evaluation and features."),
        (name = "datasets", description = "Catalogues of acoustic emission."),
        (name = "processes", description = "What can be executed as a job (OGC API - Processes Part 1)."),
        (name = "jobs", description = "Executions of processes."),
        (name = "service", description = "The service itself."),
    ),
    modifiers(&Common),
)]
pub struct Document;

/// What every operation has in common.
struct Common;

impl Modify for Common {
    fn modify(&self, document: &mut utoipa::openapi::OpenApi) {
        let components = document.components.get_or_insert_with(Components::new);
        let bearer = HttpBuilder::new().scheme(HttpAuthScheme::Bearer).description(Some(
            "A key made by `firn key create`. Not needed on a loopback address, nor where the operator allows anybody.",
        ));
        components.add_security_scheme("key", SecurityScheme::Http(bearer.build()));
        let mut schemas = vec![("Problem".to_owned(), <ProblemDocument as utoipa::PartialSchema>::schema())];
        <ProblemDocument as ToSchema>::schemas(&mut schemas);
        schemas.push(("FieldError".to_owned(), <FieldError as utoipa::PartialSchema>::schema()));
        components.schemas.extend(schemas);
    }
}

static TEXT: LazyLock<String> = LazyLock::new(|| {
    let mut document = router::document();
    complete(&mut document);
    // a document made of strings, numbers and maps with string keys always has a JSON form
    document.to_pretty_json().unwrap_or_default() + "\n"
});

/// The whole document as JSON; the same bytes on every call.
#[must_use]
pub fn text() -> &'static str {
    &TEXT
}

/// Adds to every operation the answers that any of them can give, so that none is undocumented.
fn complete(document: &mut utoipa::openapi::OpenApi) {
    for (path, item) in &mut document.paths.paths {
        let operations =
            [(&mut item.get, false), (&mut item.put, true), (&mut item.post, false), (&mut item.delete, false)];
        for (operation, writes) in operations {
            let Some(operation) = operation else { continue };
            refusals(path, writes, operation);
            if path.starts_with("/v1") {
                operation.security =
                    Some(vec![SecurityRequirement::new("key", Vec::<String>::new()), SecurityRequirement::default()]);
            }
        }
        if !path.starts_with("/v1") {
            continue;
        }
        if let Some(get) = &mut item.get {
            conditional(get);
        }
        if let Some(put) = &mut item.put {
            header(
                put,
                "if-match",
                ENTITY_TAGS,
                "Write only over one of these versions (`ETag`); `*`: over any. Else 412.",
            );
            header(put, "if-none-match", ENTITY_TAGS, "`*`: write only what is not there yet. Else 412.");
        }
        let rolls_back =
            |post: &&mut Operation| post.operation_id.as_deref().is_some_and(|id| id.starts_with("roll_back"));
        if let Some(post) = item.post.as_mut().filter(rolls_back) {
            let about =
                "Go back only from one of these versions (`ETag` of the active model); `*`: from any. Else 412.";
            header(post, "if-match", ENTITY_TAGS, about);
        }
    }
}

/// Why a request can be refused or fail, by status.
const REFUSALS: [(&str, &str); 15] = [
    ("400", "A parameter, a header or the JSON of the body cannot be read."),
    ("401", "The key is missing or not valid."),
    ("403", "The role of the key does not allow this call, or a page of another origin made it."),
    ("404", "What the address names is not there."),
    ("406", "None of the accepted formats can be served."),
    ("408", "The request was not complete, or not answered, in time."),
    ("409", "The same request is being worked on, or the state of the resource does not allow this."),
    ("412", "`If-Match` or `If-None-Match` does not hold."),
    ("413", "The body is too large."),
    ("415", "The content type of the body is not supported."),
    ("416", "The range begins beyond the end."),
    ("421", "The request was meant for another host."),
    ("422", "A value is not acceptable; `errors` has a JSON pointer to each field at fault."),
    ("500", "The service failed."),
    ("503", "The service is too busy, not ready or shutting down."),
];

/// What an operation can answer beyond what its method, path and body bring with them.
fn further_refusals(operation_id: Option<&str>) -> &'static [&'static str] {
    match operation_id {
        Some("dismiss_job") => &["409", "412"],
        Some("execute_process" | "put_forecaster_call" | "put_observation" | "import_observations") => &["409"],
        Some("issue_forecast") => &["409", "422"],
        Some("roll_back_model" | "roll_back_region_model") => &["409", "412"],
        Some("accept_proposal" | "decline_proposal" | "accept_region_proposal" | "decline_region_proposal") => &["409"],
        Some("list_observations" | "list_hits" | "get_dataset_picture" | "get_model_selection") => &["406"],
        Some("delete_dataset") => &["412"],
        Some("get_job_frame") => &["406", "422"],
        Some("get_job_output") => &["416", "422"],
        Some(
            "get_job_results"
            | "list_job_frames"
            | "list_forecasts"
            | "get_latest_forecast"
            | "get_forecast"
            | "list_similar_days"
            | "explain_forecast",
        ) => &["422"],
        _ => &[],
    }
}

/// Documents every refusal that an operation can answer, and no other.
fn refusals(path: &str, writes: bool, operation: &mut Operation) {
    let mut statuses = vec!["400", "408", "421", "500", "503"];
    if path.starts_with("/v1") {
        statuses.extend(["401", "403"]);
    }
    if path.contains('{') {
        statuses.push("404");
    }
    if operation.request_body.is_some() {
        statuses.extend(["413", "415", "422"]);
    }
    if writes {
        statuses.push("412");
    }
    statuses.extend(further_refusals(operation.operation_id.as_deref()));
    for (status, about) in REFUSALS.iter().filter(|(status, _)| statuses.contains(status)) {
        let content = ContentBuilder::new().schema(Some(Ref::from_schema_name("Problem"))).build();
        let response = ResponseBuilder::new().description(*about).content("application/problem+json", content).build();
        // a refusal that an operation describes itself says more
        operation.responses.responses.entry((*status).into()).or_insert_with(|| response.into());
    }
}

/// The form of `If-Match` and `If-None-Match` (RFC 9110, section 13.1): `*` or a list of entity tags.
const ENTITY_TAGS: &str = r#"^(\*|(W/)?"[!#-~]*"(, ?(W/)?"[!#-~]*")*)$"#;

/// Adds a request header that is optional.
fn header(operation: &mut Operation, name: &str, pattern: &str, about: &str) {
    let schema = ObjectBuilder::new().schema_type(Type::String).pattern(Some(pattern)).build();
    let parameter = ParameterBuilder::new()
        .name(name)
        .parameter_in(ParameterIn::Header)
        .required(Required::False)
        .description(Some(about))
        .schema(Some(schema))
        .build();
    operation.parameters.get_or_insert_default().push(parameter.into());
}

/// Reads below `/v1` carry an entity tag and say 304 to whoever has it.
fn conditional(get: &mut Operation) {
    header(
        get,
        "if-none-match",
        ENTITY_TAGS,
        "Versions (`ETag`) that the caller has; where nothing changed the answer is 304.",
    );
    let seen = ResponseBuilder::new().description("Unchanged since the `ETag` in `If-None-Match`.").build();
    get.responses.responses.insert("304".into(), seen.into());
    if let Some(RefOr::T(ok)) = get.responses.responses.get_mut("200") {
        let tag = HeaderBuilder::new()
            .schema(Some(ObjectBuilder::new().schema_type(Type::String)))
            .description(Some("Changes whenever the answer does."));
        ok.headers.insert("ETag".into(), tag.build().into());
    }
}
