"""Non-blocking log: a thread writes the lines, so that a stalled reader of stderr delays nothing else.

The journal may hang, a terminal may be stopped, a pipe may have no reader: then a write to stderr waits, and with it
the event loop, and every stone.
"""

import logging
import os
import queue
import re
import socket
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from contextvars import ContextVar
from pathlib import Path

STDERR = 2
MAX_LINES = 10_000
"""Lines that wait; the newest beyond them are lost, and their number is written."""
CLOSE_S = 2.0
"""Longest wait at the end for lines that are not written yet."""
JOURNAL = Path("/run/systemd/journal/socket")
PRIORITIES = {logging.DEBUG: 7, logging.INFO: 6, logging.WARNING: 4, logging.ERROR: 3, logging.CRITICAL: 2}
NAMED = re.compile(r"\b(session|trigger|bundle|camera|stone_id)=([^\s,;:]+)")
"""What a message names as `name=value` is a field of the journal, `STONEFALL_NAME`."""

SESSION: ContextVar[int | None] = ContextVar("session", default=None)
"""Number of the session that bundles are of, where the message names no other."""


class LogLines(logging.Handler):
    """Writes each record, from another thread; never blocks."""

    def __init__(self, encode: Callable[[logging.LogRecord], bytes], write: Callable[[bytes], None]) -> None:
        super().__init__()
        self._encode, self._write = encode, write
        self._lines: queue.Queue[bytes | None] = queue.Queue(MAX_LINES)
        self._n_lost = 0
        self._writing = threading.Thread(target=self._write_all, name="log lines", daemon=True)
        self._writing.start()

    def emit(self, record: logging.LogRecord) -> None:
        """Queue the encoded record, or count it as lost."""
        line = self._encode(record)
        try:
            self._lines.put_nowait(line)
        except queue.Full:
            self._n_lost += 1

    def close(self) -> None:
        """Write what is left, as far as it is read."""
        with suppress(queue.Full):
            self._lines.put(None, timeout=CLOSE_S)
            self._writing.join(CLOSE_S)
        super().close()

    def _write_all(self) -> None:
        while (line := self._lines.get()) is not None:
            n_lost, self._n_lost = self._n_lost, 0
            self._write(line)
            if n_lost:
                text = f"{n_lost} lines of the log are lost: they were not read in time"
                told = {"name": __name__, "levelno": logging.WARNING, "levelname": "WARNING", "msg": text}
                self._write(self._encode(logging.makeLogRecord(told)))


def to_stderr(line: bytes) -> None:
    """Write all of a line to stderr, unless it is closed."""
    left = memoryview(line)
    with suppress(OSError):
        while left:
            # not sys.stderr, whose lock the end of the interpreter would wait for
            left = left[os.write(STDERR, left) :]


def encoded(formatter: logging.Formatter, record: logging.LogRecord) -> bytes:
    """Return a record as lines of text."""
    return f"{formatter.format(record)}\n".encode(errors="replace")


class Journal:
    """The socket of journald, which takes entries with fields; what it does not take goes to stderr, without them."""

    def __init__(self, path: Path = JOURNAL) -> None:
        self._path = str(path)
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._formatter = logging.Formatter("%(name)s: %(message)s")

    def encode(self, record: logging.LogRecord) -> bytes:
        """Return a record as an entry of the journal's native protocol."""
        message = self._formatter.format(record)
        head = f"PRIORITY={PRIORITIES.get(record.levelno, 6)}\nSYSLOG_IDENTIFIER=stonefall\n"
        fields = {"LOGGER": record.name, **stone_fields(message)} | {
            "MESSAGE": message
        }  # the last, for `write`
        return head.encode() + b"".join(_field(name, value) for name, value in fields.items())

    def write(self, entry: bytes) -> None:
        """Send an entry, its message at least."""
        try:
            self._socket.sendto(entry, self._path)
        except OSError:  # too long for a datagram, or journald is not there
            priority = entry.removeprefix(b"PRIORITY=")[:1]
            message = entry[entry.index(b"\nMESSAGE\n") + 17 : -1]
            to_stderr(b"".join(b"<%b>%b\n" % (priority, line) for line in message.splitlines()))


def stone_fields(message: str) -> Mapping[str, str]:
    """Return the fields of the journal that a message names; `STONEFALL_STONE` is SESSION-BUNDLE."""
    named = dict(NAMED.findall(message))
    if (session := SESSION.get()) is not None:
        named.setdefault("session", str(session))
    if {"session", "bundle"} <= named.keys():
        named["stone"] = f"{named['session']}-{named['bundle']}"
    return {f"STONEFALL_{name.upper()}": value for name, value in named.items()}


def _field(name: str, value: str) -> bytes:
    """Return a field in the form that allows every byte (systemd, Native Journal Protocol)."""
    data = value.encode(errors="replace")
    return b"%b\n%b%b\n" % (name.encode(), len(data).to_bytes(8, "little"), data)
