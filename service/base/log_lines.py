"""Non-blocking log: a thread writes the lines, so that a stalled reader of stderr delays nothing else.

The journal may hang, a terminal may be stopped, a pipe may have no reader: then a write to stderr waits, and with it
the event loop, and every stone.
"""

import logging
import os
import queue
import threading
from contextlib import suppress

STDERR = 2
MAX_LINES = 10_000
"""Lines that wait; the newest beyond them are lost, and their number is written."""
CLOSE_S = 2.0
"""Longest wait at the end for lines that are not written yet."""


class LogLines(logging.Handler):
    """Writes each record to stderr, from another thread; never blocks."""

    def __init__(self) -> None:
        super().__init__()
        self._lines: queue.Queue[str | None] = queue.Queue(MAX_LINES)
        self._n_lost = 0
        self._writing = threading.Thread(target=self._write, name="log lines", daemon=True)
        self._writing.start()

    def emit(self, record: logging.LogRecord) -> None:
        """Queue the formatted record, or count it as lost."""
        line = self.format(record)
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

    def _write(self) -> None:
        while (line := self._lines.get()) is not None:
            n_lost, self._n_lost = self._n_lost, 0
            if n_lost:
                line += f"\n{n_lost} lines of the log are lost: they were not read in time"
            left = memoryview(f"{line}\n".encode(errors="replace"))
            with suppress(OSError):  # it is closed
                while left:
                    # not sys.stderr, whose lock the end of the interpreter would wait for
                    left = left[os.write(STDERR, left) :]
