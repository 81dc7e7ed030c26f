"""What holds for every test: reproducible hypotheses, no leaked task, no leaked thread."""

import asyncio
import threading
import time
from collections.abc import AsyncIterator, Iterator

import hypothesis
import pytest
import pytest_asyncio

hypothesis.settings.register_profile(
    "gate", deadline=None, derandomize=True, suppress_health_check=[hypothesis.HealthCheck.too_slow]
)
hypothesis.settings.load_profile("gate")


@pytest.fixture(autouse=True)
def no_leaked_threads() -> Iterator[None]:
    """Fail a test that leaves a thread of its own behind."""
    before = set(threading.enumerate())
    yield
    deadline = time.monotonic() + 2
    while leaked := [
        thread
        for thread in set(threading.enumerate()) - before
        if thread.is_alive() and not thread.name.startswith(("asyncio_", "AnyIO", "ThreadPoolExecutor"))
    ]:
        if time.monotonic() > deadline:
            pytest.fail(f"threads left behind: {[thread.name for thread in leaked]}")
        time.sleep(0.01)


@pytest_asyncio.fixture
async def no_leaked_tasks() -> AsyncIterator[None]:
    """Fail a test that leaves an asyncio task behind."""
    before = asyncio.all_tasks()
    yield
    leaked = asyncio.all_tasks() - before - {asyncio.current_task()}
    if leaked:
        pytest.fail(f"tasks left behind: {leaked}")
