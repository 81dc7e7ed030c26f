"""Waiting for what another thread does."""

import time
from collections.abc import Callable


def eventually(is_so: Callable[[], bool], timeout_s: float = 10.0) -> None:
    """Wait until it is so; fails when it takes too long."""
    deadline_s = time.monotonic() + timeout_s
    while not is_so():
        assert time.monotonic() < deadline_s, "never came true"
        time.sleep(0.005)
