"""Run the daemon: each part is a context manager that starts and ends it; they end in reverse order.

The first SIGTERM or SIGINT stops the rig, measures what it has seen and exits 0; the second one gives up
what is not measured yet. An exception that a part does not handle ends the task group, and with it the process.
"""

import asyncio
import logging
import shutil
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import AsyncExitStack, asynccontextmanager, suppress
from pathlib import Path
from socket import socket

from service.api.app import create_app
from service.api.reader_process import ReaderProcess, Reading
from service.api.report_requests import files_maker
from service.api.server import RestServer, listen, server_config
from service.base.addresses import is_loopback
from service.base.errors import StoreError
from service.base.status import AcquisitionTarget
from service.configuration.settings import Settings
from service.daemon.build import build, lose_crashed
from service.daemon.reloading import Configuration
from service.daemon.running_daemon import Daemon
from service.daemon.stopping import StopRequests
from service.daemon.systemd import EXTENSION_US, ServiceManager, feed_watchdog, reloading
from service.processing.process_memory import freeze_gc, keep_freed_memory
from service.store import Store, open_store
from service.store.trouble import Cause, trouble_of

log = logging.getLogger(__name__)

DRAIN_S = 30.0
"""Longest wait for the results of bundles already seen, after which they are lost, reason `shutdown`."""
DISARM_S = 15.0
"""Longest wait for the rig to disarm, the last stone's frames included, before its devices are abandoned."""
FULL_S = 2.0
"""Pause before the store is opened again while its disk is full."""
HELD_S = 2.0
"""Last wait for a store that is held; triggers without an outcome then are lost, reason `crash`, at the next start."""
LOST_EVERY_S = 0.5
"""Pause between two steps of recording what a killed daemon left open: processor and disk are for what falls now."""
ARCHIVE_S = 5.0
"""Longest wait for frames that are still to be archived, which no result needs."""


async def run(settings: Settings, manager: ServiceManager, file: Path) -> None:
    """Measure stones until a signal asks to stop; on SIGHUP read the configuration `file` again.

    Raises
    ------
    ServiceError, DriverError
        A part cannot be started.
    ExceptionGroup
        A part failed beyond what it handles itself.
    """
    keep_freed_memory()
    requests = StopRequests()
    requests.listen()
    async with AsyncExitStack() as resources:
        listener = resources.enter_context(listen(settings.api.host, settings.api.port))
        store = await _opened_store(settings, manager, requests)
        if store is None:
            return
        resources.push_async_callback(asyncio.to_thread, store.close)
        daemon = await build(Configuration(settings, file), store)
        resources.push_async_callback(asyncio.to_thread, daemon.devices.close)
        resources.push_async_exit(_end_of_spool(daemon))
        resources.callback(daemon.pool.close)
        resources.push_async_callback(daemon.recordings.close)
        reading = ReaderProcess()
        resources.callback(reading.close)
        server = await _warmed_up(daemon, reading, manager)
        async with asyncio.TaskGroup() as tasks, AsyncExitStack() as parts:
            for part in (
                _serving(daemon, tasks, server, listener),
                _watching(daemon, tasks, manager, requests),
                _alarming(daemon, tasks),
                _archiving(daemon, tasks, requests),
                _backing_up(daemon, tasks),
                _retaining(daemon, tasks),
                _delivering(daemon, reading, tasks),
                _losing_crashed(daemon, tasks),
                _processing(daemon, tasks, requests),
                _remeasuring(daemon),
                _calibrating(daemon, tasks),
                _acquiring(daemon, tasks, manager, requests),
                _reloading(daemon, tasks, manager, requests),
            ):
                await parts.enter_async_context(part)
            await requests.stop.wait()


async def _opened_store(settings: Settings, manager: ServiceManager, requests: StopRequests) -> Store | None:
    """Open the store, as soon as its disk has room; return None if the daemon is to stop before."""
    told = ""
    while not requests.stop.is_set():
        try:
            return await asyncio.to_thread(open_store, settings.store.dir, keep_raw=settings.store.keep_raw)
        except StoreError as err:
            trouble = trouble_of(err.__cause__) if isinstance(err.__cause__, Exception) else None
            if trouble is None or trouble.cause is not Cause.FULL:
                raise
            if told != (told := str(trouble)):
                log.error("waiting for the store: %s", told)
            manager.notify(f"STATUS=waiting for the store: {told}", f"EXTEND_TIMEOUT_USEC={EXTENSION_US}")
        with suppress(TimeoutError):
            await asyncio.wait_for(requests.stop.wait(), FULL_S)
    return None


def _end_of_spool(daemon: Daemon) -> Callable[..., Awaitable[None]]:
    """Return the exit callback that removes the spool, unless the daemon fails: then the next one measures it."""

    async def remove(kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            await asyncio.to_thread(shutil.rmtree, daemon.folder, ignore_errors=True)
            with suppress(OSError):  # the folder of the store, unless something else is in it
                daemon.folder.parent.rmdir()

    return remove


async def _warmed_up(daemon: Daemon, reading: ReaderProcess, manager: ServiceManager) -> RestServer:
    """Start all processes and return the REST server, with everything prepared that would hold the loop for 0.3 s."""
    app = create_app(daemon.store, daemon, daemon.settings.api, reading, daemon.keys)
    manager.notify("STATUS=warming up the workers")
    await asyncio.gather(
        daemon.pool.start(),
        reading.start(),
        asyncio.to_thread(app.openapi),  # FastAPI's routes and their description
        asyncio.to_thread(daemon.calibrations.rig.cameras[0].rays, [[0, 0]]),  # numba's tables
    )
    freeze_gc()
    return RestServer(server_config(app, daemon.settings.api))


@asynccontextmanager
async def _serving(
    daemon: Daemon, tasks: asyncio.TaskGroup, server: RestServer, listener: socket
) -> AsyncIterator[None]:
    """Answer REST requests, as the last part to end, so that clients can follow the stop."""
    serving = tasks.create_task(server.serve([listener]))
    await server.is_serving.wait()
    log.info("serving url=http://%s:%d", *listener.getsockname()[:2])
    daemon.keys.refresh()
    if daemon.keys.is_empty and not is_loopback(daemon.settings.api.host):
        log.warning(
            "every host that reaches %s may read everything: there is no key", daemon.settings.api.host
        )
    yield
    daemon.store.release_waiters()
    server.should_exit = True
    await serving


@asynccontextmanager
async def _watching(
    daemon: Daemon, tasks: asyncio.TaskGroup, manager: ServiceManager, requests: StopRequests
) -> AsyncIterator[None]:
    """Feed the service manager's watchdog with progress, and watch the event loop."""
    watching = tasks.create_task(feed_watchdog(manager, daemon.watch, daemon.status, requests.stop))
    watching_loop = tasks.create_task(daemon.watches.loop.run())
    yield
    with suppress(StoreError):  # of a store that is damaged, which health has told
        log.info("stopped %s", await daemon.store.accounting(daemon.session))
    watching.cancel()
    watching_loop.cancel()


@asynccontextmanager
async def _alarming(daemon: Daemon, tasks: asyncio.TaskGroup) -> AsyncIterator[None]:
    """Evaluate the alarms; at the end write the events of the stop."""
    alarming = tasks.create_task(daemon.alarming.run(daemon.health))
    yield
    alarming.cancel()
    await daemon.alarming.events.written(HELD_S)


@asynccontextmanager
async def _archiving(daemon: Daemon, tasks: asyncio.TaskGroup, requests: StopRequests) -> AsyncIterator[None]:
    """Archive the frames of the newest stones."""
    archiving = tasks.create_task(daemon.archive.run())
    yield
    daemon.archive.finish()
    await requests.wait_for(archiving, ARCHIVE_S)
    archiving.cancel()


@asynccontextmanager
async def _backing_up(daemon: Daemon, tasks: asyncio.TaskGroup) -> AsyncIterator[None]:
    """Back the store up every hour; a backup that is being made at the end is given up."""
    backing_up = tasks.create_task(daemon.backing_up.run())
    yield
    backing_up.cancel()


@asynccontextmanager
async def _retaining(daemon: Daemon, tasks: asyncio.TaskGroup) -> AsyncIterator[None]:
    """Remove what need not be kept; what is half removed at the end is removed at the next start."""
    retaining = tasks.create_task(daemon.retaining.run())
    yield
    retaining.cancel()


@asynccontextmanager
async def _delivering(daemon: Daemon, reading: Reading, tasks: asyncio.TaskGroup) -> AsyncIterator[None]:
    """Send webhooks and write files of lots; what is not delivered at the end is at the next start."""
    telling = tasks.create_task(daemon.webhooks.run())
    dropping = tasks.create_task(daemon.file_drop.run(files_maker(daemon.store, daemon, reading)))
    yield
    telling.cancel()
    dropping.cancel()


@asynccontextmanager
async def _losing_crashed(daemon: Daemon, tasks: asyncio.TaskGroup) -> AsyncIterator[None]:
    """Record what a killed daemon did not measure, a step at a time; the next start goes on with what is left."""

    async def run() -> None:
        while n_stones := await lose_crashed(daemon.store, daemon.left):
            log.error("the daemon had crashed triggers_lost=%d", n_stones)
            await asyncio.sleep(LOST_EVERY_S)

    losing = tasks.create_task(run())
    yield
    losing.cancel()


@asynccontextmanager
async def _processing(
    daemon: Daemon, tasks: asyncio.TaskGroup, requests: StopRequests
) -> AsyncIterator[None]:
    """Measure the bundles of the spool; those without a result in time are lost, reason `shutdown`."""
    tasks.create_task(daemon.spool.write())
    processing = tasks.create_task(daemon.processing.run())
    yield
    daemon.spool.finish()
    await requests.wait_for(processing, DRAIN_S)
    daemon.processing.abandon()
    while not processing.done():
        await asyncio.wait([processing], timeout=HELD_S)
        if (trouble := daemon.store.trouble) is not None:
            log.error("outcomes are given up bundles=%d: %s", daemon.spool.n_waiting, trouble)
            processing.cancel()
    daemon.pool.close()


@asynccontextmanager
async def _remeasuring(daemon: Daemon) -> AsyncIterator[None]:
    """Measure stones again on request; a request that is being measured at the end must be repeated."""
    yield
    daemon.remeasuring.close()


@asynccontextmanager
async def _calibrating(daemon: Daemon, tasks: asyncio.TaskGroup) -> AsyncIterator[None]:
    """Solve calibrations on request; one that is being solved at the end must be requested again."""
    calibrating = tasks.create_task(daemon.calibrations.run())
    yield
    calibrating.cancel()


@asynccontextmanager
async def _acquiring(
    daemon: Daemon, tasks: asyncio.TaskGroup, manager: ServiceManager, requests: StopRequests
) -> AsyncIterator[None]:
    """Arm the rig and notify the service manager; at the end disarm it and hand over what it has seen."""
    acquiring = tasks.create_task(daemon.acquisition.run())
    if not requests.stop.is_set():
        daemon.acquisition.request(AcquisitionTarget.ARMED)
        await requests.unless_stopped(daemon.acquisition.settled)
    if not requests.stop.is_set():
        manager.notify("READY=1")
    renewing = tasks.create_task(daemon.pool.renew())
    yield
    renewing.cancel()
    manager.notify("STOPPING=1", "STATUS=disarming")
    daemon.acquisition.stop()
    await requests.wait_for(acquiring, DISARM_S)
    if not acquiring.done():
        log.error("the rig did not disarm in time: its devices are abandoned")
        daemon.acquisition.abandon()
        await acquiring


@asynccontextmanager
async def _reloading(
    daemon: Daemon, tasks: asyncio.TaskGroup, manager: ServiceManager, requests: StopRequests
) -> AsyncIterator[None]:
    """Read the configuration again whenever SIGHUP asks for it, also while the rig was being armed."""

    async def run() -> None:
        while True:
            await requests.reload.wait()
            requests.reload.clear()
            manager.notify(*reloading())
            await daemon.configured.reload(daemon.apply, daemon.store)
            manager.notify("READY=1")

    reloads = tasks.create_task(run())
    yield
    reloads.cancel()
