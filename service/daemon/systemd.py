"""The service manager's side door: sd_notify datagrams, the watchdog's interval, journal priorities.

The protocol is that of sd_notify(3): assignments separated by newlines, one datagram to the socket in
`NOTIFY_SOCKET`; a leading `@` stands for the NUL byte of an abstract socket.
"""

import asyncio
import logging
import os
import socket
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

log = logging.getLogger(__name__)

REPORT_S = 1.0
"""How often the status is reported; more often when the watchdog asks for it."""
EXTENSION_US = 15_000_000
"""While stopping makes progress, it may take so much longer."""


@dataclass(frozen=True, slots=True)
class ServiceManager:
    """systemd, or nobody (`address` None, every notification goes nowhere)."""

    address: str | None = None
    watchdog_s: float | None = None  # within this time it wants to hear of progress

    def notify(self, *assignments: str) -> None:
        """Tell, for example, `READY=1`, `STATUS=armed`; never blocks, an unreachable listener is logged."""
        if self.address is None:
            return
        path = "\0" + self.address[1:] if self.address.startswith("@") else self.address
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender:
            sender.setblocking(False)
            try:
                sender.sendto("\n".join(assignments).encode(), path)
            except OSError as err:
                log.warning("the service manager did not hear us: %s notification=%s", err, assignments)


def service_manager(environ: Mapping[str, str], pid: int) -> ServiceManager:
    """Who started us, from the variables systemd sets; the watchdog counts only if it means this process."""
    watchdog_us = environ.get("WATCHDOG_USEC", "")
    is_ours = environ.get("WATCHDOG_PID", str(pid)) == str(pid)
    return ServiceManager(
        address=environ.get("NOTIFY_SOCKET") or None,
        watchdog_s=int(watchdog_us) / 1e6 if watchdog_us.isdigit() and is_ours else None,
    )


async def feed_watchdog(
    manager: ServiceManager,
    late: Callable[[], Sequence[str]],
    status: Callable[[], str],
    stopping: asyncio.Event,
) -> None:
    """Tell of progress, not of time: as long as a part is `late`, nothing is sent.

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


PRIORITIES = {logging.DEBUG: 7, logging.INFO: 6, logging.WARNING: 4, logging.ERROR: 3, logging.CRITICAL: 2}


class JournalFormatter(logging.Formatter):
    """`<3>`-style prefixes on every line, so that journald knows the priority (sd-daemon(3))."""

    def format(self, record: logging.LogRecord) -> str:
        prefix = f"<{PRIORITIES.get(record.levelno, 6)}>"
        return "\n".join(prefix + line for line in super().format(record).splitlines())


def configure_logging(environ: Mapping[str, str], level: int = logging.INFO) -> None:
    """Log to stderr: for people with the time, for the journal (which has the time) with priorities."""
    handler = logging.StreamHandler()
    if _is_journal(environ.get("JOURNAL_STREAM", "")):
        handler.setFormatter(JournalFormatter("%(name)s: %(message)s"))
    else:
        handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)-7s %(name)s: %(message)s"))
    logging.basicConfig(level=level, handlers=[handler], force=True)
    logging.getLogger("uvicorn").setLevel(logging.WARNING)  # its start and end are told by the daemon


def _is_journal(stream: str) -> bool:
    """Whether stderr is the very stream `device:inode` that the journal reads (systemd.exec(5))."""
    status = os.fstat(2)
    return stream == f"{status.st_dev}:{status.st_ino}"
