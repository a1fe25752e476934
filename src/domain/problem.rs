//! What went wrong, in the words of the caller: one table of codes, one value that every refusal becomes.
//!
//! Inner modules have their own `thiserror` enums; whoever knows the request turns them into a [`Problem`], and `api`
//! alone turns that into RFC 9457 `application/problem+json`.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

macro_rules! codes {
    ($($variant:ident $slug:literal $status:literal $title:literal $help:literal;)+) => {
        /// Every kind of refusal or failure that the service knows.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        pub enum Code {
            $(#[doc = $help] $variant,)+
        }

        impl Code {
            /// Every code, in the order of the table.
            pub const ALL: &'static [Self] = &[$(Self::$variant),+];

            /// The stable name: the last part of the problem's `type`.
            #[must_use]
            pub const fn slug(self) -> &'static str {
                match self { $(Self::$variant => $slug),+ }
            }

            /// The HTTP status that goes with the code.
            #[must_use]
            pub const fn status(self) -> u16 {
                match self { $(Self::$variant => $status),+ }
            }

            /// The summary, the same for every occurrence.
            #[must_use]
            pub const fn title(self) -> &'static str {
                match self { $(Self::$variant => $title),+ }
            }

            /// What it means and what to do about it.
            #[must_use]
            pub const fn help(self) -> &'static str {
                match self { $(Self::$variant => $help),+ }
            }
        }
    };
}

codes! {
    InvalidJson "invalid-json" 400 "The body is not JSON" "The body could not be read as JSON. The detail gives line and column of the first mistake.";
    InvalidParameter "invalid-parameter" 400 "A path or query parameter is not acceptable" "A parameter in the address has a form or value that is not accepted, or is not known at all. `errors` names it and what it accepts.";
    InvalidHeader "invalid-header" 400 "A request header is not acceptable" "A header of the request could not be understood. The detail says which and what is accepted.";
    InvalidBody "invalid-body" 422 "The body has unacceptable values" "The body is JSON but a field is missing, unknown, of the wrong type or outside what is physically possible. `errors` has a JSON pointer and what is accepted for each.";
    InvalidInputs "invalid-inputs" 422 "The inputs do not fit the process" "The inputs of an execution do not satisfy the process description. No job was made. `errors` has a JSON pointer and what is accepted for each.";
    MalformedFile "malformed-file" 422 "The file could not be read" "The uploaded file is not of the stated format. The detail gives the line and, where it can be known, the column.";
    ImportRefused "import-refused" 422 "Rows were refused, so nothing was stored" "At least one row was refused, and an import stores all rows or none. Mend the rows in `errors`, or repeat with `partial=true` to store the others. `report` has a line a row.";
    TrainingWindow "training-window" 422 "The training window cannot train a model" "A model needs at least three seasons and both avalanche days and other days. Widen `from` and `to`, or import more.";
    Unauthorized "unauthorized" 401 "A valid key is needed" "Send `Authorization: Bearer KEY` with a key made by `firn key create` that is neither revoked nor expired.";
    Forbidden "forbidden" 403 "The key may not do this" "The role of the key does not allow this call. Reading needs `reader`, writing observations and starting jobs `forecaster`, activating models, regions and the audit `operator`.";
    CrossOrigin "cross-origin" 403 "A request from another site was refused" "A browser sent this request from a page of another origin. Call the service from its own pages or from a program.";
    NotFound "not-found" 404 "There is nothing at this address" "The address is not one of the service. `/openapi.json` lists all of them.";
    UnknownStation "unknown-station" 404 "No such station" "Create the station first with `PUT /v1/stations/{station}`.";
    UnknownRegion "unknown-region" 404 "No such region" "Create the region first with `PUT /v1/regions/{region}`.";
    NoEarlierModel "no-earlier-model" 409 "There is no earlier model to go back to" "Nothing was active before the active model, or before the one that the last roll-back restored.";
    UnknownProposal "unknown-proposal" 404 "No such proposal" "The station or region has no proposal of that id. `GET .../proposals` lists them.";
    ProposalClosed "proposal-closed" 409 "The proposal is decided" "It was accepted or declined before, or a newer proposal took its place.";
    ProposalOutdated "proposal-outdated" 409 "The active model has changed since" "The proposal was compared with a model that is no longer the active one. Retrain again with `POST /v1/processes/retrain-model/execution`, or activate the model with `PUT .../active-model`.";
    NoObservation "no-observation" 404 "There is no observation of that day" "Nothing was recorded for the day that was asked for.";
    NoForecastWeather "no-forecast-weather" 404 "There is no weather forecast of that day" "A forecast with `weather=forecast` reads the weather forecast of its day. Record it with `PUT /v1/stations/{station}/observations/{date}` and `\"forecast\": true`; once the day is observed, ask for lead 0.";
    AlreadyObserved "already-observed" 409 "The day was observed" "A weather forecast never replaces an observation. Leave `forecast` out to correct what was observed.";
    NoAvalancheRecord "no-avalanche-record" 404 "There is no avalanche record of that day" "Nobody recorded the avalanche activity of that day. That is not the same as none.";
    NoActiveModel "no-active-model" 404 "There is no active model" "Train one with `POST /v1/processes/train-model/execution`; the first model of a station or region becomes active by itself.";
    ModelOutdated "model-outdated" 404 "The active model can no longer forecast" "The model was trained with features that have changed since. Train it again with `POST /v1/processes/train-model/execution`.";
    UnknownModel "unknown-model" 404 "No such model" "The model id is not known. `GET /v1/models` lists the models.";
    InvalidMapping "invalid-mapping" 422 "The mapping of the columns is not acceptable" "`mapping` must be JSON that names the column of the date and, for each other column, a variable and a unit in which it can come. `errors` has a pointer to each name or unit that is not known.";
    NotIssued "not-issued" 404 "No forecast of that day was issued" "A forecast is issued with `PUT /v1/stations/{station}/forecasts/{date}`; what the model would say now is at the same address with GET.";
    ForecastFrozen "forecast-frozen" 409 "What was issued stays as it is" "A forecast that was issued, and a call of a day that has ended, are what the verification judges: neither can be changed afterwards.";
    NoSelection "no-selection" 404 "The model has no selection of features" "The model was trained without the input `selection`, so there is no curve of its features. Run `select-features` and train with its job id.";
    UnknownFeatureSet "unknown-feature-set" 404 "No such feature set" "`GET /v1/feature-sets` lists the feature sets.";
    UnknownDataset "unknown-dataset" 404 "No such data set" "The id of the data set is not known, or it was removed. `GET /v1/datasets` lists the data sets.";
    DatasetRefused "dataset-refused" 422 "The data set was refused" "The file was read but is no good data set: the unit of the amplitudes is not known, a value cannot be, or nothing in it is known. `errors` names the column and the line or row. Nothing was stored.";
    NoSuchProcess "no-such-process" 404 "No such process" "`GET /v1/processes` lists the processes.";
    NoSuchJob "no-such-job" 404 "No such job" "The job id is not known, or the finished job was removed.";
    ResultNotReady "result-not-ready" 404 "The results are not ready" "The job has not ended yet. Poll its status document until `status` is `successful`.";
    JobDismissed "job-dismissed" 404 "The job was dismissed" "A dismissed job has no results.";
    PartOfAnotherJob "part-of-another-job" 409 "The job is part of another one" "The job is a child of the one that `parent` of its status document names. Its results are part of that job's, so it is removed with it and not before.";
    MethodNotAllowed "method-not-allowed" 405 "The method is not allowed here" "The address exists but not with this method. The `Allow` header lists the methods.";
    NotAcceptable "not-acceptable" 406 "None of the accepted formats can be served" "The `Accept` header names no format that this address serves. The detail lists them.";
    RequestTimeout "request-timeout" 408 "The request took too long" "The request was not complete, or not answered, in time. Send it again, in smaller parts if it is large.";
    RequestAtWork "request-at-work" 409 "The same request is being worked on" "A request with the same `Idempotency-Key` has not been answered yet. Repeat it in a moment: the answer will be the same.";
    KeyReused "idempotency-key-reused" 422 "The idempotency key belongs to another request" "The `Idempotency-Key` was sent before with another body or address. Use a new key for a new request; a key is remembered for 24 hours.";
    RangeNotSatisfiable "range-not-satisfiable" 416 "The range lies outside of the output" "`Range` begins beyond the end. The `Content-Range` header has the length.";
    UnknownOutput "unknown-output" 404 "The job has no such output" "The results document lists the outputs.";
    PreconditionFailed "precondition-failed" 412 "The resource is not the one you saw" "`If-Match` or `If-None-Match` does not hold: somebody changed the resource. Read it again and repeat with its new ETag.";
    PayloadTooLarge "payload-too-large" 413 "The body is too large" "The body exceeds the limit in the detail. Send it in several parts.";
    Misdirected "misdirected" 421 "The request was meant for another host" "A service that needs no key answers only to the name of its own machine, so that no page of the web can reach it under a name of its own. Use `localhost` or the address; behind a proxy start with a key or with `--allow-anonymous`.";
    UnsupportedMediaType "unsupported-media-type" 415 "The content type is not supported" "The detail lists the content types that this call accepts.";
    ModelMismatch "model-mismatch" 422 "The model does not fit the station" "The model was trained for another station, region or lead. Name one of this place and lead.";
    Interrupted "interrupted" 500 "The job was interrupted" "The service ended while the job was running. Submit it again.";
    CrashedRepeatedly "crashed-repeatedly" 500 "The job took its worker down" "Several attempts in a row ended without a word. The job is not tried again.";
    Stalled "stalled" 500 "The job stood still" "The computation made no step for longer than the operator allows (`--stall-s`), and was given up. The same inputs would stand still again: change them, or report the job to the operator.";
    JobFailed "job-failed" 422 "The job failed" "The computation ended with an error, which the detail names.";
    Internal "internal" 500 "The service failed" "Something broke that the caller cannot mend. Report the `traceId` to the operator, who finds the cause in the log.";
    Overloaded "overloaded" 503 "The service is too busy" "Too many requests or jobs are waiting. Wait for the time in `Retry-After` and try again.";
    ShuttingDown "shutting-down" 503 "The service is shutting down" "The service takes no new work. Try again in a moment.";
    NotReady "not-ready" 503 "The service is not ready" "A part that the service needs does not answer. The detail names it.";
}

impl Code {
    /// The code of that [`Code::slug`].
    #[must_use]
    pub fn from_slug(slug: &str) -> Option<Self> {
        Self::ALL.iter().copied().find(|code| code.slug() == slug)
    }

    /// The URI of the problem type; the ones that OGC API - Processes fixes are the standard's.
    #[must_use]
    pub fn type_uri(self) -> String {
        match self {
            Self::NoSuchJob | Self::NoSuchProcess | Self::ResultNotReady => {
                format!("http://www.opengis.net/def/exceptions/ogcapi-processes-1/1.0/{}", self.slug())
            }
            _ => format!("/problems/{}", self.slug()),
        }
    }
}

/// One field at fault.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct FieldError {
    /// JSON pointer (RFC 6901) into the body, or `/` and the name of a parameter of the address.
    #[schema(example = "/air_temperature")]
    pub pointer: String,
    /// What is wrong and what would be accepted.
    #[schema(example = "must be a number from -60 to 40 degC, not 300")]
    pub detail: String,
    /// Short name of the rule that was broken.
    #[schema(example = "out_of_range")]
    pub code: String,
}

impl FieldError {
    /// A fault at `pointer`.
    pub fn new(pointer: impl Into<String>, code: impl Into<String>, detail: impl Into<String>) -> Self {
        Self { pointer: pointer.into(), detail: detail.into(), code: code.into() }
    }
}

/// A refusal or failure as the caller sees it.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{}: {detail}", .code.slug())]
pub struct Problem {
    /// Which kind.
    pub code: Code,
    /// This occurrence, for a human.
    pub detail: String,
    /// The fields at fault.
    pub errors: Vec<FieldError>,
    /// Further members of the problem document: an import's report. Boxed, so that a `Result` stays small.
    pub extensions: Box<serde_json::Map<String, serde_json::Value>>,
    /// For [`Code::Internal`]: the cause, for the log and never for the caller.
    pub cause: Option<String>,
}

impl Problem {
    /// A problem without fields at fault.
    pub fn new(code: Code, detail: impl Into<String>) -> Self {
        Self { code, detail: detail.into(), errors: Vec::new(), extensions: Box::default(), cause: None }
    }

    /// A problem with one field at fault; its detail is the problem's.
    pub fn field(code: Code, pointer: impl Into<String>, rule: impl Into<String>, detail: impl Into<String>) -> Self {
        let error = FieldError::new(pointer, rule, detail);
        Self::new(code, format!("{}: {}", error.pointer, error.detail)).with_errors(vec![error])
    }

    /// The same with `errors`.
    #[must_use]
    pub fn with_errors(mut self, errors: Vec<FieldError>) -> Self {
        self.errors = errors;
        self
    }

    /// The same with a further member.
    #[must_use]
    pub fn with(mut self, name: &str, value: serde_json::Value) -> Self {
        self.extensions.insert(name.to_owned(), value);
        self
    }

    /// A failure of ours: `cause` goes to the log, the caller is told nothing of it.
    pub fn internal(cause: impl std::fmt::Display) -> Self {
        let mut problem = Self::new(Code::Internal, "the service failed; the log has the cause under this traceId");
        problem.cause = Some(cause.to_string());
        problem
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_slug_is_unique_and_finds_its_code() {
        for &code in Code::ALL {
            assert_eq!(Code::from_slug(code.slug()), Some(code), "{}", code.slug());
            assert!((400..600).contains(&code.status()));
        }
    }

    #[test]
    fn an_internal_problem_hides_its_cause() {
        let problem = Problem::internal("UNIQUE constraint failed: station.id");
        assert!(!problem.detail.contains("UNIQUE"));
        assert_eq!(problem.cause.as_deref(), Some("UNIQUE constraint failed: station.id"));
    }
}
