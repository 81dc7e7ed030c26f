"""Run the bridge: the plant's state, and beside it each outlet, which is started again whenever it fails."""

import asyncio
import fcntl
import logging
import os
import signal
import time
from collections.abc import Awaitable, Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from importlib import import_module
from pathlib import Path

from drivers.errors import DriverError
from service.base.errors import ServiceError, UsageError
from service.base.systemd import ServiceManager, feed_watchdog
from service.bridge.client import BridgeClient
from service.bridge.plant import ANSWER_S, POLL_S, Plant
from service.bridge.settings import OUTLETS, BridgeSettings

log = logging.getLogger(__name__)

Outlet = Callable[[Plant], Awaitable[None]]
"""Serves the plant until it is cancelled: `run(settings, plant)` of a module, with its table of the configuration."""
PAUSES_S = (1.0, 2.0, 5.0, 10.0, 30.0)
"""Pauses before an outlet is started again, after failures in a row."""
LASTED_S = 60.0
"""An outlet that ran for so long was not failing in a row."""
LATE_S = 3 * (ANSWER_S + POLL_S)
END_S = 5.0
"""Longest wait for outlets to end in order."""


def outlets(settings: BridgeSettings) -> Mapping[str, Outlet]:
    """Import what the configuration asks for; raise `UsageError` where a package of the extra is missing."""
    found = {}
    for name in settings.outlets:
        try:
            module = import_module(OUTLETS[name])
        except ModuleNotFoundError as err:
            raise UsageError(
                f"[{name}] needs the extra [bridge], which is not installed ({err}):"
                " pip install --require-hashes -r deploy/requirements-bridge.lock"
            ) from None
        found[name] = partial(module.run, getattr(settings, name))
    return found


async def run(settings: BridgeSettings, manager: ServiceManager) -> None:
    """Serve until SIGTERM or SIGINT; raise `UsageError` without an outlet's package, or if another bridge runs."""
    wanted = outlets(settings)
    settings.dir.mkdir(parents=True, exist_ok=True)
    with _locked(settings.dir):
        await _serve(settings, wanted, manager)


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Have the folder of the cursors to oneself; raise `UsageError` if another bridge has it."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    except BlockingIOError:
        raise UsageError(f"dir: {folder} is that of a bridge that runs") from None
    finally:
        os.close(descriptor)


async def _serve(settings: BridgeSettings, wanted: Mapping[str, Outlet], manager: ServiceManager) -> None:
    daemon = settings.daemon
    plant = Plant(daemon.url, daemon.key_file, settings.dir, daemon.consumer)
    if daemon.key_file is not None and not BridgeClient(daemon.url, daemon.key_file).key():
        log.warning("daemon.key_file: %s cannot be read: the daemon is asked without a key", daemon.key_file)
    stopping = asyncio.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        asyncio.get_running_loop().add_signal_handler(number, stopping.set)

    def late() -> list[str]:
        return ["plant"] if time.monotonic() - plant.looked_s > LATE_S else []

    def status() -> str:
        return plant.state.trouble or f"follows {daemon.url}"

    kept = [
        asyncio.create_task(plant.keep()),
        asyncio.create_task(feed_watchdog(manager, late, status, stopping)),
        *(asyncio.create_task(supervise(name, outlet, plant)) for name, outlet in wanted.items()),
    ]
    stop = asyncio.create_task(stopping.wait())
    manager.notify("READY=1")
    log.info("the bridge serves %s of %s", ", ".join(wanted), daemon.url)
    await asyncio.wait([stop, *kept], return_when=asyncio.FIRST_COMPLETED)
    manager.notify("STOPPING=1")
    for task in (stop, *kept):
        task.cancel()
    done, left = await asyncio.wait(kept, timeout=END_S)
    if left:
        log.warning("%d parts of the bridge do not end", len(left))
    for task in done:
        if not task.cancelled() and (err := task.exception()) is not None:
            raise err


async def supervise(name: str, outlet: Outlet, plant: Plant) -> None:
    """Run an outlet, and start it again whenever it fails, at first soon and then ever later."""
    n_failed = 0
    while True:
        started_s = time.monotonic()
        try:
            await outlet(plant)
            log.error("%s has ended by itself", name)
        except (DriverError, ServiceError, OSError) as err:
            log.error("%s: %s", name, err)
        except Exception:  # a fault of one outlet ends no other
            log.exception("%s failed", name)
        if time.monotonic() - started_s > LASTED_S:
            n_failed = 0
        pause_s = PAUSES_S[min(n_failed, len(PAUSES_S) - 1)]
        n_failed += 1
        log.info("%s is started again in %g s", name, pause_s)
        await asyncio.sleep(pause_s)
