"""Run the daemon: its parts start one after the other and end in reverse order.

The first SIGTERM or SIGINT stops the rig, measures what it has seen and exits 0; the second one gives up
what is not measured yet. An exception that a part does not handle ends the task group, and with it the process.
"""

import asyncio
import logging
import shutil
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager, suppress
from functools import partial
from pathlib import Path
from socket import socket

from service.base.addresses import is_loopback
from service.base.errors import StoreError
from service.base.log_lines import SESSION
from service.base.status import AcquisitionTarget
from service.base.systemd import EXTENSION_US, ServiceManager, feed_watchdog, reloading
from service.configuration.settings import Settings
from service.daemon.build import build
from service.daemon.part import Part, Running, started
from service.daemon.reloading import Configuration
from service.daemon.rest.app import create_app
from service.daemon.running_daemon import Daemon
from service.daemon.session import Session
from service.daemon.stopping import StopRequests
from service.processing.worker_process import freeze_gc, keep_freed_memory
from service.store import Store, open_store
from service.store.accounting import accounting
from service.store.trouble import TroubleCause, trouble_of
from service.web.reader_process import DRAWING, ReaderProcess
from service.web.server import RestServer, listen, server_config

log = logging.getLogger(__name__)

READER_IMPORTS, DRAWER_IMPORTS = ("service.particles.pages",), ("service.particles.renditions",)
"""Modules whose import would hold the first page, mesh or picture that is asked for."""
FULL_S = 2.0
"""Pause before the store is opened again while its disk is full."""


async def run(settings: Settings, manager: ServiceManager, file: Path) -> None:
    """Measure stones until a signal asks to stop; on SIGHUP read the configuration `file` again.

    Raises `ServiceError` or `DriverError` when a part cannot be started, `ExceptionGroup` when one fails beyond what it
    handles itself.
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
        reading, drawing = ReaderProcess(READER_IMPORTS), ReaderProcess(DRAWER_IMPORTS, DRAWING)
        daemon = await build(Configuration(settings, file), store, reading, requests)
        SESSION.set(daemon.session.number)
        resources.push_async_callback(asyncio.to_thread, daemon.session.devices.close)
        resources.push_async_exit(partial(_end_spool, daemon.session.folder))
        resources.callback(daemon.pool.close)
        resources.push_async_callback(daemon.recordings.close)
        resources.callback(reading.close)
        resources.callback(drawing.close)
        server = await _warmed_up(daemon, reading, drawing, manager)
        watchdog = Part(
            run=partial(feed_watchdog, manager, daemon.watch, daemon.status, requests.stop),
            close=partial(_tell_accounting, daemon.session),
        )
        async with asyncio.TaskGroup() as tasks, AsyncExitStack() as running:
            await running.enter_async_context(_serving(daemon, tasks, server, listener))
            for part in (watchdog, *daemon.parts):
                await running.enter_async_context(started(part, tasks))
            await running.enter_async_context(_measuring(daemon, tasks, manager, requests))
            await requests.stop.wait()


async def _opened_store(settings: Settings, manager: ServiceManager, requests: StopRequests) -> Store | None:
    """Open the store, as soon as its disk has room; return None if the daemon is to stop before."""
    told = ""
    while not requests.stop.is_set():
        try:
            return await asyncio.to_thread(open_store, settings.store.dir, keep_raw=settings.store.keep_raw)
        except StoreError as err:
            trouble = trouble_of(err.__cause__) if isinstance(err.__cause__, Exception) else None
            if trouble is None or trouble.cause is not TroubleCause.FULL:
                raise
            if told != (told := str(trouble)):
                log.error("waiting for the store: %s", told)
            manager.notify(f"STATUS=waiting for the store: {told}", f"EXTEND_TIMEOUT_USEC={EXTENSION_US}")
        with suppress(TimeoutError):
            await asyncio.wait_for(requests.stop.wait(), FULL_S)
    return None


async def _end_spool(folder: Path, kind: type[BaseException] | None, *_: object) -> None:
    """Remove the spool, unless the daemon fails: then the next one measures it."""
    if kind is None:
        await asyncio.to_thread(shutil.rmtree, folder, ignore_errors=True)
        with suppress(OSError):  # the folder of the store, unless something else is in it
            folder.parent.rmdir()


async def _warmed_up(
    daemon: Daemon, reading: ReaderProcess, drawing: ReaderProcess, manager: ServiceManager
) -> RestServer:
    """Start all processes and return the REST server, with everything prepared that would hold the loop for 0.3 s."""
    app = create_app(daemon.session.store, daemon, daemon.settings.api, reading, drawing, daemon.keys)
    manager.notify("STATUS=warming up the workers")
    await asyncio.gather(
        daemon.pool.start(),
        reading.start(),
        drawing.start(),
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
    daemon.session.store.release_waiters()
    server.should_exit = True
    await serving


async def _tell_accounting(session: Session, running: Running) -> None:
    with suppress(StoreError):  # of a store that is damaged, which health has told
        log.info("stopped %s", await session.store.read(accounting, session.number))


@asynccontextmanager
async def _measuring(
    daemon: Daemon, tasks: asyncio.TaskGroup, manager: ServiceManager, requests: StopRequests
) -> AsyncIterator[None]:
    """Arm the rig and notify the service manager; then read the configuration again whenever SIGHUP asks for it."""

    async def reload() -> None:
        while True:
            await requests.reload.wait()
            requests.reload.clear()
            manager.notify(*reloading())
            await daemon.configured.reload(daemon.apply, daemon.session.store)
            manager.notify("READY=1")

    if not requests.stop.is_set():
        daemon.acquisition.request(AcquisitionTarget.ARMED)
        await requests.unless_stopped(daemon.acquisition.settled)
    if not requests.stop.is_set():
        manager.notify("READY=1")
    meanwhile = [tasks.create_task(daemon.pool.renew()), tasks.create_task(reload())]
    yield
    for task in meanwhile:
        task.cancel()
    manager.notify("STOPPING=1", "STATUS=disarming")
