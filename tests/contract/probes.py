"""Requests that no generator sends, byte for byte over a socket: what a service answers to them is part of its contract."""

import gzip
import json
import socket
import sys
import urllib.parse

DAY = "/v1/stations/lochaber/observations/2018-01-15"
MANY = "/v1/stations/lochaber/observations"
JSON = "Content-Type: application/json"

# method, target, headers, body, status, code of the problem (none: no problem document is expected)
PROBES = [
    # methods
    ("HEAD", "/v1/stations/lochaber", [], b"", 200, None),
    ("HEAD", "/v1/stations/nowhere", [], b"", 404, None),
    ("OPTIONS", "/v1/stations", [], b"", 405, "method-not-allowed"),
    ("TRACE", "/v1/stations", [], b"", 405, "method-not-allowed"),
    ("PATCH", "/v1/stations/lochaber", [JSON], b"{}", 405, "method-not-allowed"),
    ("BREW", "/v1/stations/lochaber", [], b"", 405, "method-not-allowed"),
    ("POST", "/openapi.json", [], b"", 405, "method-not-allowed"),
    # addresses
    ("GET", "/v1/stations/%00", [], b"", 400, "invalid-parameter"),
    ("GET", "/v1/stations/%FF%FE", [], b"", 400, "invalid-parameter"),
    ("GET", "/v1/stations/..%2F..%2Fetc%2Fpasswd", [], b"", 400, "invalid-parameter"),
    ("GET", "/v1/stations/%", [], b"", 400, "invalid-parameter"),
    ("GET", "/v1/stations/", [], b"", 404, "not-found"),
    ("GET", "/v1//stations", [], b"", 404, "not-found"),
    ("GET", "/v1/stations?limit=%00", [], b"", 400, "invalid-parameter"),
    ("GET", "/v1/stations?limit=99999999999999999999", [], b"", 400, "invalid-parameter"),
    ("GET", "/v1/stations?limit=1&limit=2", [], b"", 400, "invalid-parameter"),
    ("GET", "/v1/stations?unknown=1", [], b"", 400, "invalid-parameter"),
    ("GET", "/v1/stations?cursor=%00", [], b"", 200, None),
    ("GET", "/v1/stations?cursor=%FF", [], b"", 200, None),
    ("GET", "/v1/stations/lochaber/observations/2018-02-30", [], b"", 400, "invalid-parameter"),
    ("GET", "/v1/jobs/" + "9" * 5000, [], b"", 400, "invalid-parameter"),
    # bodies
    ("PUT", DAY, [JSON], b"", 400, "invalid-json"),
    ("PUT", DAY, [JSON], b"{", 400, "invalid-json"),
    ("PUT", DAY, [JSON], b"\xff\xfe", 400, "invalid-json"),
    ("PUT", DAY, [JSON], b"{} {}", 400, "invalid-json"),
    ("PUT", DAY, [JSON], b"[" * 100_000, 400, "invalid-json"),
    ("PUT", DAY, [JSON], b"null", 422, "invalid-body"),
    ("PUT", DAY, [JSON], b"[]", 422, "invalid-body"),
    ("PUT", DAY, [JSON], b'{"air_temperature": 1e999}', 400, "invalid-json"),
    ("PUT", DAY, [JSON], b'{"air_temperature": 99999999999999999999999}', 422, "invalid-body"),
    ("PUT", DAY, [JSON], b'{"air_temperature": NaN}', 400, "invalid-json"),
    ("PUT", DAY, [JSON], b'{"air_temperature": "-3"}', 422, "invalid-body"),
    ("PUT", DAY, [JSON], b'{"air_temperature": 1, "air_temperature": 2}', 422, "invalid-body"),
    ("PUT", DAY, [JSON], b'{"air_temperature": 1, "\\u0000": 2}', 422, "invalid-body"),
    ("PUT", DAY, [], b"{}", 415, "unsupported-media-type"),
    ("PUT", DAY, ["Content-Type: text/plain"], b"{}", 415, "unsupported-media-type"),
    ("PUT", DAY, ["Content-Type: application/json; charset=utf-8"], b'{"wind_speed": 3}', 200, None),
    ("PUT", DAY, ["Content-Type: APPLICATION/JSON"], b'{"wind_speed": 3}', 200, None),
    ("PUT", DAY, [JSON, "Content-Encoding: gzip"], gzip.compress(b"{}"), 415, "unsupported-media-type"),
    ("POST", MANY, [JSON], b"[]", 200, None),
    ("POST", MANY, [JSON], b"", 400, "invalid-json"),
    ("POST", MANY, ["Content-Type: text/csv"], b"", 422, "malformed-file"),
    ("POST", MANY, ["Content-Type: text/csv"], b"date\n\xff\n", 422, "import-refused"),
    ("POST", MANY, ["Content-Type: application/x-ndjson"], b"", 200, None),
    ("POST", MANY, ["Content-Type: application/x-ndjson"], b"{\n", 422, "import-refused"),
    ("POST", MANY, [JSON], b"[" + b" " * (33 << 20) + b"]", 413, "payload-too-large"),
    # headers
    # what has one form only is served in it, which RFC 9110, section 12.4.1, leaves to the server
    ("GET", "/v1/stations", ["Accept: image/png"], b"", 200, None),
    ("GET", MANY, ["Accept: image/png"], b"", 406, "not-acceptable"),
    ("GET", MANY, ["Accept: \xff"], b"", 406, "not-acceptable"),
    ("GET", MANY, ["Accept: text/csv"], b"", 200, None),
    ("GET", MANY, ["Accept: */*;q=0.1, text/csv;q=0.0"], b"", 200, None),
    ("GET", "/v1/stations", ["If-None-Match: *"], b"", 304, None),
    ("GET", "/v1/stations", ["If-None-Match: abc"], b"", 400, "invalid-header"),
    ("GET", "/v1/stations", ["If-None-Match: \xff"], b"", 400, "invalid-header"),
    ("PUT", DAY, [JSON, 'If-Match: "no"'], b"{}", 412, "precondition-failed"),
    ("PUT", DAY, [JSON, "If-None-Match: *"], b"{}", 412, "precondition-failed"),
    ("GET", "/v1/stations", ["X-Request-Id: " + "x" * 500], b"", 200, None),
    ("GET", "/v1/stations", ["X-Request-Id: \xff"], b"", 200, None),
    ("GET", "/v1/stations", ["Authorization: Bearer nonsense"], b"", 401, "unauthorized"),
    ("GET", "/v1/stations", ["Accept-Encoding: gzip"], b"", 200, None),
    ("PUT", DAY, [JSON, "Origin: https://elsewhere.example", "Sec-Fetch-Site: cross-site"], b"{}", 403, "cross-origin"),
]


class Answer:
    def __init__(self, raw):
        head, _, self.body = raw.partition(b"\r\n\r\n")
        lines = head.decode("latin-1").split("\r\n")
        self.status = int(lines[0].split()[1])
        pairs = [line.split(":", 1) for line in lines[1:]]
        self.headers = {name.strip().lower(): value.strip() for name, value in pairs}


def send(address, method, target, headers, body):
    lines = [f"{method} {target} HTTP/1.1", "Host: localhost", "Connection: close", *headers]
    if body or method in ("PUT", "POST"):
        lines.append(f"Content-Length: {len(body)}")
    with socket.create_connection(address, timeout=60) as connection:
        connection.sendall(("\r\n".join(lines) + "\r\n\r\n").encode("latin-1"))
        try:
            connection.sendall(body)
        except OSError:
            pass  # refused before it was read: the answer says why
        raw = b""
        while chunk := connection.recv(1 << 16):
            raw += chunk
    return Answer(raw)


def faults(method, answer, status, code):
    """What is wrong with an answer, one sentence each."""
    if answer.status >= 500:
        yield f"is {answer.status}"
    if status is not None and answer.status != status:
        yield f"is {answer.status}, not {status}"
    if answer.status == 405 and "allow" not in answer.headers:
        yield "has no Allow"
    if "x-request-id" not in answer.headers:
        yield "has no X-Request-Id"
    if answer.status >= 400 and method != "HEAD":
        media = answer.headers.get("content-type")
        if media != "application/problem+json":
            yield f"is a refusal of the type {media}"
            return
        problem = json.loads(answer.body)
        if problem["status"] != answer.status or code not in (None, problem["code"]):
            yield f"is the problem {problem['code']} of {problem['status']}"
    if method == "HEAD" and answer.body:
        yield "has a body"


def main():
    url = urllib.parse.urlsplit(sys.argv[1])
    found = 0
    for method, target, headers, body, status, code in PROBES:
        answer = send((url.hostname, url.port), method, target, headers, body)
        for fault in faults(method, answer, status, code):
            found += 1
            print(f"{method} {target[:80]} {headers} {body[:60]}: the answer {fault}\n    {answer.body[:300]}")
    print(f"{len(PROBES)} requests, {found} findings")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
