"""The start of the daemon, before its parts exist."""

import asyncio
import errno
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from service.base.errors import StoreError
from service.base.systemd import ServiceManager
from service.configuration.settings import Settings
from service.daemon import run
from service.daemon.stopping import StopRequests
from service.store import Store

SETTINGS = cast(Settings, SimpleNamespace(store=SimpleNamespace(dir=Path("state"), keep_raw=1)))
STORE = cast(Store, object())


class Told(ServiceManager):
    """Keeps what the service manager is told."""

    def __init__(self) -> None:
        super().__init__()
        object.__setattr__(self, "assignments", [])

    def notify(self, *assignments: str) -> None:
        cast(Any, self).assignments.extend(assignments)


def failing(*errors: OSError, then: Callable[[], None] = lambda: None) -> Callable[..., Store]:
    """Open the store after so many errors; `then` is called at the last one."""
    left = list(errors)

    def open_store(state_dir: Path, *, keep_raw: int) -> Store:
        if not left:
            return STORE
        error = left.pop(0)
        if not left:
            then()
        raise StoreError(f"{state_dir}: {error}") from error

    return open_store


@pytest.fixture(autouse=True)
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run, "FULL_S", 0.001)


async def test_while_its_disk_is_full_the_daemon_waits_for_the_store(monkeypatch: pytest.MonkeyPatch) -> None:
    full = OSError(errno.ENOSPC, "No space left on device")
    monkeypatch.setattr(run, "open_store", failing(full, full))
    manager = Told()
    assert await run._opened_store(SETTINGS, manager, StopRequests()) is STORE
    told = cast(Any, manager).assignments
    assert sum("make room" in each for each in told) == 2
    assert sum(each.startswith("EXTEND_TIMEOUT_USEC=") for each in told) == 2


async def test_it_can_be_stopped_while_it_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    requests, loop = StopRequests(), asyncio.get_running_loop()
    full = OSError(errno.ENOSPC, "No space left on device")

    def stopping() -> None:
        loop.call_soon_threadsafe(requests.stop.set)

    stop = failing(full, full, then=stopping)
    monkeypatch.setattr(run, "open_store", stop)
    monkeypatch.setattr(run, "FULL_S", 0.05)
    assert await run._opened_store(SETTINGS, Told(), requests) is None


async def test_what_does_not_pass_by_itself_ends_the_start(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run, "open_store", failing(PermissionError(errno.EACCES, "Permission denied")))
    with pytest.raises(StoreError, match="Permission denied"):
        await run._opened_store(SETTINGS, Told(), StopRequests())
