"""Bodies of requests that mean nothing, as large as they may be: whole ones, and values of single fields."""

import json
from collections.abc import Iterator

from service.daemon.rest.openapi import openapi_text
from service.web.body_limit import MOST_PARTS
from service.web.version import BASE

N_BYTES = 999_000
THERE = {"lot": "L1", "product": "basalt", "alarm": "1", "particle_id": "1", "camera": "c01"}


def filled(pattern: bytes, n_bytes: int = N_BYTES) -> bytes:
    return pattern * (n_bytes // len(pattern))


WHOLE = {
    "nested lists": filled(b"["),
    "nested objects": filled(b'{"a":'),
    "closed lists": filled(b"[", N_BYTES // 2) + filled(b"]", N_BYTES // 2),
    "unknown fields": json.dumps({f"field {i}": i for i in range(45_000)}).encode(),
    "a long number": filled(b"1"),
    "a long text": b'"' + filled(b"a") + b'"',
    "a list of numbers": b"[" + filled(b"1,") + b"1]",
    "escapes": b'"' + filled(b"\\u0000") + b'"',
    "blanks": filled(b" "),
    "no UTF-8": filled(b"\xff"),
    "no number": b"NaN",
}
VALUES = {
    "a long number": filled(b"1"),
    "a great exponent": b"1e" + filled(b"9", 400),
    "a list": b"[" + filled(b"1,") + b"1]",
    "lists": b"[" + filled(b"[],") + b"1]",
    "a map": json.dumps({f"{i}": i for i in range(MOST_PARTS // 2 - 10)}).encode(),
    "a long text": b'"' + filled(b"a") + b'"',
    "blanks": b'"1' + filled(b" ", 20_000) + b'x"',
    "digits": b'"' + filled(b"8", 20_000) + b'"',
    "brackets": b'"' + filled(b"(", 20_000) + b'"',
    "lines of cells": b'"' + filled(b"8;\\n", 20_000) + b'"',
    "as long as it may be": b'"' + filled(b"8", 200) + b'"',
    "nested": filled(b"[", 2000) + filled(b"]", 2000),
    "not a number": b"NaN",
    "infinite": b"-Infinity",
    "a zero": b'"\\u0000"',
    "half a character": b'"\\ud800"',
}


def requests() -> Iterator[tuple[str, str, list[str]]]:
    """Yield method, path and fields of each operation that takes a body."""
    document = json.loads(openapi_text())
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            for content in operation.get("requestBody", {}).get("content", {}).values():
                schema = content["schema"]
                while "$ref" in schema:
                    schema = document["components"]["schemas"][schema["$ref"].rpartition("/")[2]]
                yield method, path.removeprefix(BASE), list(schema.get("properties", ()))


def hostile_requests() -> Iterator[tuple[str, str, str, bytes]]:
    """Yield method, path, what is hostile and the body, of each operation that takes one and of each of its fields."""
    for method, path, fields in requests():
        for name, value in THERE.items():
            path = path.replace(f"{{{name}}}", value)
        for what, body in WHOLE.items():
            yield method, path, what, body
        for field in fields:
            for what, value in VALUES.items():
                body = b"{" + json.dumps(field).encode() + b":" + value + b"}"
                yield method, path, f"{field}: {what}", body[:N_BYTES]
