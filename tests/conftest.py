"""What holds for every test: how much of it is tried, and that no task or thread is left behind."""

import asyncio
import functools
import gc
import inspect
import multiprocessing
import os
import threading
import time
from collections.abc import Generator, Iterator

import pytest
from support.eventually import PATIENCE_S
from support.extents import extent_of, is_beyond, use_profile
from support.renewed import HAS_FAILED

from service.processing.compiled_code import isolate_numba_cache

gc.disable()  # until all tests are imported: a third of the time was spent on walking what stays
# as systemd/stonefall.service has it; before NumPy is imported: its threads only spin on matrices as small as ours
os.environ.setdefault("OMP_NUM_THREADS", "1")
isolate_numba_cache()  # before numba is; with the daemons that the tests start
# what the daemon's worker processes are forked from, and what its reading process imports
multiprocessing.set_forkserver_preload(
    [
        "service.processing.worker_imports",
        "service.processing.measure_job",
        "service.web.pages",
        "service.particles.renditions",
    ]
)

pytest_plugins = ["support.stores"]


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--full", action="store_true", help="also tests marked `full`")
    parser.addoption("--night", action="store_true", help="also tests marked `full` and `night`")


def pytest_configure(config: pytest.Config) -> None:
    use_profile(extent_of(config))


def pytest_report_header(config: pytest.Config) -> str:
    return f"extent: {extent_of(config)} of quick, full, night"


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out what is marked for a wider extent than the options ask for."""
    extent = extent_of(config)
    config.hook.pytest_deselected(items=[item for item in items if is_beyond(item, extent)])
    items[:] = [item for item in items if not is_beyond(item, extent)]


def pytest_collection_finish() -> None:
    """Let the collector walk only what the tests make."""
    gc.freeze()
    gc.enable()


@pytest.fixture(autouse=True)
def no_leaked_threads(request: pytest.FixtureRequest) -> Iterator[None]:
    """Fail a test that leaves a thread of its own behind."""
    before = set(threading.enumerate())
    yield
    if request.node.get_closest_marker("restarts_cameras") or request.node.stash.get(HAS_FAILED, False):
        return
    deadline = time.monotonic() + PATIENCE_S
    while leaked := [
        thread
        for thread in set(threading.enumerate()) - before
        if thread.is_alive() and not thread.name.startswith(("asyncio_", "AnyIO", "ThreadPoolExecutor"))
    ]:
        if time.monotonic() > deadline:
            pytest.fail(f"threads left behind: {[thread.name for thread in leaked]}")
        time.sleep(0.01)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Note that a test has failed, for those who hand on what it has used."""
    report = yield
    if report.failed:
        item.stash[HAS_FAILED] = True
    return report


@pytest.hookimpl(wrapper=True)
def pytest_pyfunc_call(pyfuncitem: pytest.Function) -> Generator[None, object, object]:
    """Fail an async test that leaves a task behind."""
    if inspect.iscoroutinefunction(pyfuncitem.obj):
        test = pyfuncitem.obj

        @functools.wraps(test)
        async def checked(*args: object, **kwargs: object) -> None:
            before = asyncio.all_tasks()
            await test(*args, **kwargs)
            if leaked := asyncio.all_tasks() - before:
                pytest.fail(f"tasks left behind: {leaked}")

        pyfuncitem.obj = checked
    return (yield)
