"""Rules for the OpenAPI document that `firn openapi` prints: valid 3.1, self-contained, nothing left unnamed."""

import json
import subprocess
import sys

from openapi_spec_validator import validate

METHODS = ("get", "put", "post", "delete", "options", "head", "patch", "trace")


def references(node):
    """Every `$ref` below `node`."""
    if isinstance(node, dict):
        yield from [node["$ref"]] if isinstance(node.get("$ref"), str) else []
        for value in node.values():
            yield from references(value)
    elif isinstance(node, list):
        for value in node:
            yield from references(value)


def target_exists(document, reference):
    node = document
    for part in reference.removeprefix("#/").split("/"):
        node = node.get(part.replace("~1", "/").replace("~0", "~")) if isinstance(node, dict) else None
    return node is not None


def operations(document):
    for path, item in document["paths"].items():
        for method in METHODS:
            if method in item:
                yield f"{method.upper()} {path}", item[method]


def faults(document):
    """What is wrong with the document, one sentence each."""
    if not document["openapi"].startswith("3.1"):
        yield f"is OpenAPI {document['openapi']}, not 3.1"
    for reference in set(references(document)):
        if not reference.startswith("#/"):
            yield f"refers to something outside of it: {reference}"
        elif not target_exists(document, reference):
            yield f"refers to something that is not there: {reference}"
    tags = {tag["name"] for tag in document["tags"]}
    ids = set()
    for name, operation in operations(document):
        if not operation.get("operationId") or operation["operationId"] in ids:
            yield f"{name} has no operationId of its own"
        ids.add(operation.get("operationId"))
        if not operation.get("tags") or not set(operation["tags"]) <= tags:
            yield f"{name} has no tag that is explained"
        if not operation.get("summary"):
            yield f"{name} says nothing of what it does"
        for parameter in operation.get("parameters", []):
            if not parameter.get("description"):
                yield f"{name}: parameter {parameter['name']} says nothing of what it is"
        for status, response in operation["responses"].items():
            if not response.get("description"):
                yield f"{name}: answer {status} says nothing of what it is"


def main():
    document = json.loads(subprocess.run([sys.argv[1], "openapi"], check=True, stdout=subprocess.PIPE).stdout)
    validate(document)
    found = list(faults(document))
    print(*found or [f"{len(list(operations(document)))} operations, all sound"], sep="\n")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
