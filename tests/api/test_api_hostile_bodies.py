"""Whatever a body has, it is refused or means something, and reading it holds the event loop for a moment."""

import asyncio
import json
import time
from collections.abc import Iterator

import pytest
from support.rest import FakeControl, app_of, client_of

from service.api.body_limit import MOST_PARTS
from service.api.openapi import openapi_text
from service.api.version import BASE
from service.store import Store

N_BYTES = 999_000
HELD_S = 0.1
"""Of processor time at a megabyte, on the reference machine."""
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


@pytest.fixture
def longest_s(monkeypatch: pytest.MonkeyPatch) -> list[tuple[float, str]]:
    """Processor seconds of the longest callback of the event loop, and which it was."""
    run = asyncio.Handle._run  # type: ignore[attr-defined]  # not in its stubs
    longest = [(0.0, "")]

    def timed(handle: asyncio.Handle) -> None:
        start_s = time.thread_time()
        run(handle)
        longest[0] = max(longest[0], (time.thread_time() - start_s, repr(handle)))

    monkeypatch.setattr(asyncio.Handle, "_run", timed)
    return longest


def speed() -> float:
    """Return how much longer this machine takes than the reference, 1 at least: by parsing a megabyte."""
    text = b"[" + filled(b"1,") + b"1]"
    start_s = time.thread_time()
    for _ in range(5):
        json.loads(text)
    return max(1.0, (time.thread_time() - start_s) / 5 / 0.02)


@pytest.mark.parametrize(
    "share", [pytest.param(8, id="an eighth"), pytest.param(1, id="all", marks=pytest.mark.full)]
)
async def test_no_body_holds_the_loop_or_ends_in_an_error_of_ours(
    store: Store, control: FakeControl, longest_s: list[tuple[float, str]], share: int
) -> None:
    asked = [
        (method, path, what, body)
        for method, path, fields in requests()
        for what, body in (
            *WHOLE.items(),
            *(
                (f"{field}: {what}", b"{" + json.dumps(field).encode() + b":" + value + b"}")
                for field in fields
                for what, value in VALUES.items()
            ),
        )
    ]
    async with client_of(app_of(store, control)) as client:
        await client.get("/health")
        await asyncio.sleep(0)
        longest_s[0] = (0.0, "")  # all that was made until now
        for method, path, what, body in asked[::share]:
            for name, value in THERE.items():
                path = path.replace(f"{{{name}}}", value)
            answer = await client.request(
                method, path, content=body[:N_BYTES], headers={"Content-Type": "application/json"}
            )
            assert answer.status_code < 500, (method, path, what, answer.text[:1000])
            assert len(answer.content) < 100_000, (method, path, what)
    assert longest_s[0][0] < HELD_S * speed(), longest_s
