"""The interface to systemd: sd_notify datagrams, the watchdog's interval, journal priorities.

The protocol is that of sd_notify(3): assignments separated by newlines, one datagram to the socket in
`NOTIFY_SOCKET`; a leading `@` stands for the NUL byte of an abstract socket.
"""

import asyncio
import logging
import os
import socket
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from service.base.log_level import LogLevel
from service.base.log_lines import JOURNAL, STDERR, Journal, LogLines, encoded, to_stderr

log = logging.getLogger(__name__)

OWN = ("service", "drivers")
"""Loggers whose level is set."""
REPORT_S = 1.0
"""Interval between reports of the status; shorter if the watchdog asks for it."""
EXTENSION_US = 15_000_000
"""Time by which the stop time-out is extended while stopping makes progress."""


@dataclass(frozen=True, slots=True)
class ServiceManager:
    """systemd; without an `address` notifications are dropped, because another process started the daemon."""

    address: str | None = None
    watchdog_s: float | None = None  # longest time between two reports of progress

    def notify(self, *assignments: str) -> None:
        """Send assignments such as `READY=1`, `STATUS=armed`; never blocks, an unreachable manager is logged."""
        if self.address is None:
            return
        path = "\0" + self.address[1:] if self.address.startswith("@") else self.address
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender:
                sender.setblocking(False)
                sender.sendto("\n".join(assignments).encode(), path)
        except OSError as err:  # no descriptor is free, no manager listens
            log.warning("the service manager was not notified: %s notification=%s", err, assignments)


def service_manager(environ: Mapping[str, str], pid: int) -> ServiceManager:
    """Return the service manager from the variables that systemd sets; its watchdog only if it is for this process."""
    watchdog_us = environ.get("WATCHDOG_USEC", "")
    is_ours = environ.get("WATCHDOG_PID", str(pid)) == str(pid)
    return ServiceManager(
        address=environ.get("NOTIFY_SOCKET") or None,
        watchdog_s=int(watchdog_us) / 1e6 if watchdog_us.isdigit() and is_ours else None,
    )


def reloading() -> tuple[str, str]:
    """Return the assignments that announce a reload, which `READY=1` ends; as `Type=notify-reload` wants them, too."""
    return "RELOADING=1", f"MONOTONIC_USEC={time.clock_gettime_ns(time.CLOCK_MONOTONIC) // 1000}"


async def feed_watchdog(
    manager: ServiceManager,
    late: Callable[[], Sequence[str]],
    status: Callable[[], str],
    stopping: asyncio.Event,
) -> None:
    """Report to the watchdog periodically, except while a part is `late`: it is fed by progress, not by time.

    Runs until it is cancelled. While `stopping` makes progress it asks for more time.
    """
    pause_s = min(REPORT_S, (manager.watchdog_s or 3 * REPORT_S) / 3)
    while True:
        if parts := late():
            log.error("no progress of %s", ", ".join(parts))
        else:
            extension = [f"EXTEND_TIMEOUT_USEC={EXTENSION_US}"] if stopping.is_set() else []
            manager.notify("WATCHDOG=1", f"STATUS={status()}", *extension)
        await asyncio.sleep(pause_s)


def configure_logging(environ: Mapping[str, str], level: LogLevel, journal: Path = JOURNAL) -> None:
    """Log to the journal, with fields, if it reads stderr; else to stderr, with the time."""
    status = os.fstat(STDERR)
    # the stream `device:inode` that the journal reads (systemd.exec(5))
    if environ.get("JOURNAL_STREAM", "") == f"{status.st_dev}:{status.st_ino}":
        reader = Journal(journal)
        handler = LogLines(reader.encode, reader.write)
    else:
        formatter = logging.Formatter("%(asctime)s %(levelname)-7s %(name)s: %(message)s")
        handler = LogLines(partial(encoded, formatter), to_stderr)
    logging.basicConfig(level=logging.INFO, handlers=[handler], force=True)
    logging.getLogger("uvicorn").setLevel(logging.WARNING)  # the daemon logs its start and end
    use_level(level)


def use_level(level: LogLevel) -> None:
    """Log what is of a level or above; of libraries nothing below `info`."""
    for name in OWN:
        logging.getLogger(name).setLevel(level.upper())
