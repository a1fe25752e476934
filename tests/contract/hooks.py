"""Checks of our own beside those of schemathesis, and why some valid requests are refused."""

import atexit
import collections
import json
import os
import pathlib
import re

import schemathesis
from schemathesis.specs.openapi.checks import negative_data_rejection, positive_data_acceptance

PROBLEM_MEMBERS = {"type", "title", "status", "detail", "code", "traceId"}

# Why a request may be refused although each of its parts fits its schema: rules between parts, and names that a schema
# cannot know. By operation, the code of the problem and the fields (by their pointers) that it may blame; "" for none.
EXPLAINED = {
    # a day that no calendar has
    "list_jobs": {"invalid-parameter": {"/datetime"}},
    # the last day before the first, or more days than one answer may have
    "list_observations": {"invalid-parameter": {"/to"}},
    "list_forecasts": {"invalid-parameter": {"/to"}, "model-mismatch": {"/model_id"}},
    # a weather forecast goes with lead 1 alone
    "list_station_forecasts": {"invalid-parameter": {"/weather"}},
    "get_issued_forecast": {"invalid-parameter": {"/weather"}},
    "get_bulletin": {"invalid-parameter": {"/weather"}},
    "list_bulletins": {"invalid-parameter": {"/to", "/weather"}},
    # a model of another station or lead; the first day of the calendar has no day before it
    "get_latest_forecast": {"model-mismatch": {"/model_id"}, "invalid-parameter": {"/weather"}},
    "get_forecast": {"model-mismatch": {"/model_id"}, "invalid-parameter": {"/date", "/weather"}},
    "list_similar_days": {"model-mismatch": {"/model_id"}, "invalid-parameter": {"/date", "/weather"}},
    "put_active_model": {"model-mismatch": {"/model_id"}, "precondition-failed": {""}},
    "put_region_model": {"model-mismatch": {"/model_id"}, "precondition-failed": {""}},
    "roll_back_model": {"precondition-failed": {""}},
    "roll_back_region_model": {"precondition-failed": {""}},
    # stations that are not there, or fewer than an avalanche day of the region needs
    "put_region": {"invalid-body": {"/stations", "/avalanche_day"}, "precondition-failed": {""}},
    # a place is one of the two
    "list_models": {"invalid-parameter": {"/region"}},
    "get_region_forecast": {"invalid-parameter": {"/date"}},
    # a time zone that the IANA database does not have; If-Match of another version
    "put_station": {"invalid-body": {"/timezone"}, "precondition-failed": {""}},
    # the inputs of a process have a schema of their own, in its description; names of labels have rules that a schema of
    # their values cannot say; raw results are of one output; a key belongs to the request that it was first sent with
    "execute_process": {
        "invalid-inputs": {"/inputs"},
        "training-window": {"/inputs"},
        "invalid-body": {"/labels", "/outputs"},
        "idempotency-key-reused": {""},
    },
    # a text has no schema: what is no table of hits is refused, as are waveforms without what makes hits of them; numbers that
    # are none
    "create_dataset": {
        "malformed-file": {""},
        "dataset-refused": {"", "/amplitude_unit", "/threshold_v", "/hit_definition_s", "/hit_lockout_s",
                            "/peak_definition_s", "/sample_rate_hz", "/full_scale_v"},
    },
    "put_dataset": {"precondition-failed": {""}},
    "delete_dataset": {"precondition-failed": {""}},
    # a child goes with its parent
    "dismiss_job": {"part-of-another-job": {""}},
    # an activity that contradicts the count, type, trigger or size
    "put_avalanches": {
        "invalid-body": {"/count", "/type", "/trigger", "/size"},
        "precondition-failed": {""},
    },
    # a model of another station, names of variables and bounds of their values, the order of two ends
    "ask_what_if": {"model-mismatch": {"/model_id"}, "invalid-body": {"/changes", "/response", "/date", "/weather"}},
    "put_forecaster_call": {"precondition-failed": {""}},
    "issue_forecast": {"precondition-failed": {""}, "invalid-parameter": {"/date", "/weather"}},
    "verify_forecasts": {"invalid-parameter": {"/to", "/weather"}},
    "explain_forecast": {"model-mismatch": {"/model_id"}, "invalid-parameter": {"/date", "/weather"}},
    "put_observation": {
        "invalid-body": {
            "/forecast",
            *(f"/avalanche_{name}" for name in ("activity", "count", "type", "trigger", "size")),
        },
        "precondition-failed": {""},
    },
}


@schemathesis.serializer(
    "application/x-ndjson",
    "text/csv",
    "text/x-smet",
    "text/tab-separated-values",
    "application/octet-stream",
    "application/vnd.apache.parquet",
    "application/vnd.sqlite3",
    "audio/wav",
)
def as_text(ctx, value):
    """Text goes out as it is; what a negative test puts in its place goes out as JSON."""
    if isinstance(value, bytes):
        return value
    return (value if isinstance(value, str) else json.dumps(value)).encode("utf-8", "surrogatepass")


@schemathesis.hook
def before_call(ctx, case, kwargs):
    """Makes requests reach what they are meant to test.

    `format=sais` belongs to CSV: beside JSON it is 415 whatever the body says. Entity tags that were meant to be valid
    and are not are left out: the coverage phase knows no quotes in headers.
    """
    if case.media_type != "text/csv" and (case.query or {}).get("format") == "sais":
        del case.query["format"]
    if not case.meta or not case.meta.generation.mode.is_positive:
        return
    if case.operation.definition.raw["operationId"] == "put_region" and isinstance(case.body, dict) and case.body.get("stations"):
        # no schema knows which stations exist
        case.body["stations"] = ["lochaber"]
    for parameter in case.operation.definition.raw.get("parameters", []):
        value = (case.headers or {}).get(parameter["name"]) if parameter["in"] == "header" else None
        pattern = parameter["schema"].get("pattern")
        if value is not None and pattern and not re.search(pattern, value):
            del case.headers[parameter["name"]]


STATUSES = collections.defaultdict(collections.Counter)


@schemathesis.hook
def after_call(ctx, case, response):
    """Counts the answers, so that `run` sees whether every operation was reached."""
    STATUSES[case.operation.definition.raw["operationId"]][response.status_code] += 1


@atexit.register
def write_statuses():
    if path := os.environ.get("CONTRACT_STATUSES"):
        pathlib.Path(path).write_text(json.dumps(STATUSES, indent=1))


def explained(case, problem):
    """Whether the refusal of a valid request is one that a schema cannot foresee."""
    operation = case.operation.definition.raw["operationId"]
    if operation == "import_observations":
        return import_explained(case, problem)
    fields = EXPLAINED.get(operation, {}).get(problem["code"])
    if fields is None:
        return False
    pointers = [error["pointer"] for error in problem.get("errors", [])] or [""]
    return all(any(pointer == field or pointer.startswith(field + "/") for field in fields) for pointer in pointers)


def import_explained(case, problem):
    """A text has no schema: CSV, SMET, NDJSON and the mapping of columns are refused for what they say. JSON is refused for contradictions only."""
    if problem["code"] == "invalid-mapping":
        return "mapping" in (case.query or {})
    if problem["code"] == "unsupported-media-type":
        return "format" in (case.query or {}) and case.media_type != "text/csv"
    if case.media_type != "application/json":
        return problem["code"] in ("malformed-file", "import-refused")
    rules = {error["code"] for error in problem.get("errors", [])}
    return problem["code"] == "invalid-body" and rules <= {"contradiction", "duplicate_day"}


@schemathesis.check
def valid_requests_are_accepted(ctx, response, case):
    """The check `positive_data_acceptance` without the refusals that EXPLAINED explains."""
    if response.status_code in (400, 412, 415, 422) and explained(case, json.loads(response.content)):
        return None
    return positive_data_acceptance(ctx, response, case)


@schemathesis.check
def invalid_requests_are_refused(ctx, response, case):
    """The check `negative_data_rejection`; an import with `partial=true` refuses row by row, in a report that is 200."""
    if case.operation.definition.raw["operationId"] == "import_observations" and response.status_code == 200:
        report = json.loads(response.content)
        if report["rows"] and not report["accepted"]:
            return None
    return negative_data_rejection(ctx, response, case)


@schemathesis.check
def refusal_explains_itself(ctx, response, case):
    """Every 4xx and 5xx is a problem document that agrees with its own status and request."""
    if response.status_code < 400 or response.request.method == "HEAD":
        return
    problem = json.loads(response.content)
    missing = PROBLEM_MEMBERS - problem.keys()
    assert not missing, f"the problem has no {missing}"
    assert problem["status"] == response.status_code, "the problem is of another status than its answer"
    assert [problem["traceId"]] == response.headers.get("x-request-id"), "the problem is of another request"
    if problem["code"] in ("invalid-parameter", "invalid-body", "invalid-inputs"):
        assert problem.get("errors"), "nothing says which field is at fault"
        for error in problem["errors"]:
            assert error["pointer"] == "" or error["pointer"].startswith("/"), f"no JSON pointer: {error}"
