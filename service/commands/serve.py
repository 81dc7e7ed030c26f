"""`stonefall serve` and `compile`: run the daemon; compile the loops that its first start would compile."""

import asyncio
import logging
import os
import resource
import sys
import threading
from dataclasses import replace
from typing import Annotated, NoReturn

import typer

from service.acquisition.device_keeper import CONTROL_THREAD_SUFFIX
from service.base.errors import SettingsError
from service.base.log_level import LogLevel
from service.base.systemd import configure_logging, service_manager
from service.commands.options import Config
from service.host.machine import FILES
from service.processing.worker_process import import_for_workers

log = logging.getLogger(__name__)

LEAST_FILES = 512
"""Open files and connections of sixteen cameras, the workers, and a few clients."""


def command(
    config: Config,
    log_level: Annotated[
        LogLevel | None,
        typer.Option(help="In the place of the configuration's [log] level, until that is read again."),
    ] = None,
) -> None:
    """Run the daemon: measure the stones of a rig, store the results and serve them, until SIGTERM."""
    open_standard_files()
    allow_files()
    import_for_workers("service.processing.worker_imports")
    # imported here, while the server of worker processes does its own imports
    from service.configuration.settings import load_settings, problems
    from service.daemon.run import run

    settings = load_settings(config)
    if log_level is not None:
        settings = settings.model_copy(update={"log": replace(settings.log, level=log_level)})
    if wrong := "; ".join(problems(settings)):
        raise SettingsError(f"{config}: {wrong}")
    configure_logging(os.environ, settings.log.level)
    try:
        asyncio.run(run(settings, service_manager(os.environ, os.getpid()), config))
    except BaseExceptionGroup:
        log.critical("fatal, the daemon ends", exc_info=True)
        _exit(1)
    _exit(0)


def compile_command(config: Config) -> None:
    """Compile all loops ahead of the first start, into the cache that the daemon uses (NUMBA_CACHE_DIR).

    Run it after every installation, as the user that the daemon runs as.
    """
    from service.configuration.segmentation_settings import plan_segmenter  # here: as above
    from service.configuration.settings import load_settings
    from service.processing.measure_job import WorkerContext, prepare
    from service.processing.worker_pool import WorkerPool

    settings = load_settings(config)
    segmentation = plan_segmenter(settings.segmentation)
    context = WorkerContext(parameters=settings.pipeline, is_simulated=False, segmentation=segmentation)
    slots, deadline_s = settings.workers.slots, settings.workers.deadline_s

    async def warm_up() -> None:
        async with WorkerPool(slots=slots, deadline_s=deadline_s, prepare=prepare, context=context):
            pass

    asyncio.run(warm_up())


def open_standard_files() -> None:
    """Put /dev/null in the place of standard files that are closed, which sockets and the spool would get otherwise."""
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # the lowest that is free


def allow_files() -> None:
    """Allow this process as many open files as the host lets it have; raise `SettingsError` if these are too few.

    A worker without a descriptor would fail over one stone after the other.
    """
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    n_files = FILES if most == resource.RLIM_INFINITY else min(most, FILES)
    if n_files < LEAST_FILES:
        raise SettingsError(
            f"only {n_files} files may be open at a time, and {LEAST_FILES} are needed: set LimitNOFILE={FILES} in the"
            f" unit, or ulimit -Hn {FILES} in a shell"
        )
    resource.setrlimit(resource.RLIMIT_NOFILE, (n_files, most))


def _exit(code: int) -> NoReturn:
    """Exit, even if a device driver still blocks a thread; everything else is closed by now."""
    others = [thread for thread in threading.enumerate() if thread is not threading.main_thread()]
    if any(CONTROL_THREAD_SUFFIX in thread.name for thread in others):
        logging.shutdown()
        os._exit(code)
    sys.exit(code)
