"""Lines in software for gates without a protocol: the test makes the edges."""

import errno
import os
import queue
import threading
import time
from collections.abc import Sequence

from support.eventually import PATIENCE_S

from drivers.gates.gpio import LineEdge
from drivers.gates.modem_line import COUNTS, Look


class FakeLines:
    """Lines of a chip; the test makes the edges, at times of its own."""

    def __init__(self) -> None:
        self.n_edges = 0
        self.driven: list[tuple[int | str, bool]] = []
        self.is_closed = False
        self.echoes = False
        self.drive_s = 0.0
        """For how long the machine is busy with other things before the line is set."""
        self._read: queue.Queue[list[LineEdge] | OSError] = queue.Queue()

    def edge(self, is_closed: bool, at_ns: int) -> None:
        self.edges((is_closed, at_ns))

    def edges(self, *edges: tuple[bool, int]) -> None:
        """Make several edges that are read at once."""
        self._read.put([LineEdge(*edge, self.n_edges + number) for number, edge in enumerate(edges, start=1)])
        self.n_edges += len(edges)

    def vanish(self) -> None:
        self._read.put(OSError(errno.ENODEV, os.strerror(errno.ENODEV)))

    def wait(self, timeout_s: float) -> Sequence[LineEdge]:
        try:
            read = self._read.get(timeout=timeout_s)
        except queue.Empty:
            return []
        if isinstance(read, OSError):
            raise read
        return read

    def drive(self, line: int | str, *, is_active: bool) -> None:
        self.driven.append((line, is_active))
        time.sleep(self.drive_s)
        if self.echoes:
            self.edge(is_active, time.monotonic_ns())

    def close(self) -> None:
        self.is_closed = True


class FakeLine:
    """A line switched by the test; every `look` of the gate sees what was scripted since the last one."""

    def __init__(self, *, counts: bool = True, is_on: bool = False) -> None:
        self.is_on = is_on
        self.n_edges = COUNTS - 3 if counts else None  # about to wrap
        self.is_gone = False
        self.is_closed = False
        self._looked = threading.Condition()
        self._n_looks = 0

    def switch(self, times: int = 1) -> None:
        """Change so often, and wait until the gate has looked again."""
        with self._looked:
            self.is_on ^= times % 2 == 1
            if self.n_edges is not None:
                self.n_edges = (self.n_edges + times) % COUNTS
            seen = self._n_looks
            assert self._looked.wait_for(lambda: self._n_looks > seen + 1, PATIENCE_S)

    def look(self) -> Look:
        with self._looked:
            if self.is_gone:
                raise OSError(errno.EIO, os.strerror(errno.EIO))
            self._n_looks += 1
            self._looked.notify_all()
            return Look(self.is_on, self.n_edges)

    def close(self) -> None:
        self.is_closed = True
