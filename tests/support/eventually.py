"""Waiting for what another thread does."""

import asyncio
import time
from collections.abc import Awaitable, Callable
from inspect import isawaitable

PATIENCE_S = 300.0
"""Longest wait; nothing takes as long unless the machine is busy with other things."""


def eventually(is_so: Callable[[], bool], timeout_s: float = PATIENCE_S) -> None:
    """Wait until it is so; fails when it takes too long."""
    deadline_s = time.monotonic() + timeout_s
    while not is_so():
        assert time.monotonic() < deadline_s, "never came true"
        time.sleep(0.005)


async def soon(is_so: Callable[[], bool | Awaitable[bool]], timeout_s: float = PATIENCE_S) -> None:
    """Wait on the event loop until it is so; fails when it takes too long."""
    deadline_s = time.monotonic() + timeout_s
    while not (await found if isawaitable(found := is_so()) else found):
        assert time.monotonic() < deadline_s, "never came true"
        await asyncio.sleep(0.005)
