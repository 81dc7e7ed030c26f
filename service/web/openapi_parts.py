"""Parts of the OpenAPI document that many operations share: described once in `components`, and referred to."""

import json
from collections import Counter
from collections.abc import Iterable, Sequence
from http import HTTPStatus
from typing import Any

from service.web.idempotency import REPLAYED
from service.web.problems import WAIT, all_problems

SCALARS = ("boolean", "integer", "number", "string")
HEADERS = {
    "ETag": {
        "description": "Version of the representation, for `If-None-Match` and `If-Match`",
        "schema": {"type": "string"},
    },
    REPLAYED: {
        "description": "True when this repeats the first answer to the same `Idempotency-Key`; absent otherwise."
        " Repeated problems have it, too",
        "schema": {"type": "boolean"},
    },
    "Location": {"description": "Path of the new resource", "schema": {"type": "string"}},
    "Retry-After": {
        "description": "Seconds to wait before the next attempt: always with 429 and 503, and with the problem"
        " `request-in-progress`",
        "schema": {"type": "integer", "minimum": 0},
    },
}
PROBLEM_HEADERS = {
    HTTPStatus.CONFLICT: ("Retry-After",),
    HTTPStatus.PRECONDITION_FAILED: ("ETag",),
    **dict.fromkeys(WAIT, ("Retry-After",)),
}


def header_references(names: Iterable[str]) -> dict[str, Any]:
    """Return the headers of an answer as references to `HEADERS`."""
    return {name: {"$ref": f"#/components/headers/{name}"} for name in names}


def shared_answer(status: str) -> dict[str, str]:
    """Return the reference to the answer with this status, or to that of any other problem for `default`."""
    return {"$ref": f"#/components/responses/{_name_of(status)}"}


def shared_answers() -> dict[str, Any]:
    """Return 304, and the answers of problems by status, each with the types that it may carry."""
    unchanged = "Unchanged: the client has this version already"
    answers = {
        "NotModified": {"description": unchanged, "headers": header_references(["ETag"])},
        "OtherProblem": _problem_answer("Any other error"),
    }
    for status, titles in all_problems().items():
        types = ", ".join(f"`{slug}` ({title})" for slug, title in titles.items())
        answer = _problem_answer(
            f"{HTTPStatus(status).phrase}. `type` is `urn:stonefall:problem:` and {types}"
        )
        if status in PROBLEM_HEADERS:
            answer["headers"] = header_references(PROBLEM_HEADERS[HTTPStatus(status)])
        answers[_name_of(str(int(status)))] = answer
    return answers


def _problem_answer(description: str) -> dict[str, Any]:
    content = {"application/problem+json": {"schema": {"$ref": "#/components/schemas/Problem"}}}
    return {"description": description, "content": content}


def _name_of(status: str) -> str:
    return "OtherProblem" if status == "default" else HTTPStatus(int(status)).phrase.replace(" ", "")


def shorten(document: dict[str, Any]) -> None:
    """Leave out of the document what repeats itself; its meaning stays, and so do the clients made of it."""
    for name, schema in document["components"]["schemas"].items():
        if schema.get("title") == name:
            del schema["title"]
    _shorten_schemas(document)
    operations = [each for methods in document["paths"].values() for each in methods.values()]
    document["components"]["parameters"] = _share_parameters(operations)


def _shorten_schemas(part: Any) -> None:
    """Write optional scalars as a list of types, and drop titles that repeat the name of a property or parameter."""
    if isinstance(part, list):
        for inner in part:
            _shorten_schemas(inner)
    elif isinstance(part, dict):
        for inner in part.values():
            _shorten_schemas(inner)
        match part:
            case {"anyOf": [{"type": kind, **limits}, {"type": "null"}]} if (
                kind in SCALARS and "enum" not in limits and "format" not in part
            ):
                del part["anyOf"]
                part |= limits | {"type": [kind, "null"]}
        for inner in (*part.get("properties", {}).values(), part.get("schema", {})):
            if "anyOf" not in inner:  # generators name the class of a union by its title
                inner.pop("title", None)


def _share_parameters(operations: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Replace parameters that several operations have by references, and return the parameters by name."""
    n_uses = Counter(json.dumps(each) for operation in operations for each in operation.get("parameters", ()))
    shared: dict[str, Any] = {}
    names: dict[str, str] = {}
    for operation in operations:
        for i, parameter in enumerate(operation.get("parameters", ())):
            text = json.dumps(parameter)
            if n_uses[text] == 1:
                continue
            if text not in names:
                name = parameter["name"]
                names[text] = f"{name}-{operation['operationId']}" if name in shared else name
                shared[names[text]] = parameter
            operation["parameters"][i] = {"$ref": f"#/components/parameters/{names[text]}"}
    return shared
