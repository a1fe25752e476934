"""Checks of our own beside those of schemathesis, and why some valid requests are refused."""

import json

import schemathesis

PROBLEM_MEMBERS = {"type", "title", "status", "detail", "code", "traceId"}


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
