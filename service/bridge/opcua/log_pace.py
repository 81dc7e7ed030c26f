"""A bound on what the OPC UA library logs: a stranger's bytes must not fill the journal."""

import logging
import time
from collections import deque

LINES, PER_S = 20, 60.0


class LibraryLogPace(logging.Filter):
    """Lets so many lines through in a minute, without their tracebacks."""

    def __init__(self) -> None:
        super().__init__()
        self._times: deque[float] = deque(maxlen=LINES)

    def filter(self, record: logging.LogRecord) -> bool:
        """Drop a line of the library when there were too many."""
        if not record.name.startswith("asyncua"):
            return True
        now = time.monotonic()
        if len(self._times) == LINES and self._times[0] > now - PER_S:
            return False
        self._times.append(now)
        return True


PACE = LibraryLogPace()


def bound_library_log() -> None:
    """Log the library's warnings at that pace; its other lines are those of a debugger."""
    logging.getLogger("asyncua").setLevel(logging.ERROR)
    for handler in logging.getLogger().handlers:
        handler.addFilter(PACE)  # once: a filter is added only if it is not there
