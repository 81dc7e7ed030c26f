"""Whatever a body has, it is refused or means something, and reading it holds the event loop for a moment."""

import asyncio
import json
import time

import pytest
from support.hostile_bodies import filled, hostile_requests
from support.rest import FakeControl, app_of, client_of

from service.store import Store

HELD_S = 0.1
"""Longest hold of the event loop by a request of a megabyte, processor seconds of the reference machine."""


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
    asked = list(hostile_requests())[::share]
    async with client_of(app_of(store, control)) as client:
        await client.get("/health")
        await asyncio.sleep(0)
        longest_s[0] = (0.0, "")  # all that was made until now
        for method, path, what, body in asked:
            await asyncio.sleep(0)  # a request that waits for nothing is in one step with the next
            answer = await client.request(
                method, path, content=body, headers={"Content-Type": "application/json"}
            )
            assert answer.status_code < 500, (method, path, what, answer.text[:1000])
            assert len(answer.content) < 100_000, (method, path, what)
    assert longest_s[0][0] < HELD_S * speed(), longest_s
