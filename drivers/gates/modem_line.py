"""A light gate on a modem line of a serial port: the sensor's output on CTS, DSR, RI or CD, no protocol.

The line is polled every millisecond. Waiting for it in the kernel (TIOCMIWAIT) would be finer, but only an edge or
a signal ends that wait, and many USB converters cannot do it at all; a millisecond is 2.4 mm of fall in an image
that shows 45, and the cameras are triggered by the wire, not by this. Edges between two polls are counted by the
kernel (TIOCGICOUNT): no stone is missed, only its time and width are less accurate. Of RI the kernel counts only
one of two edges, so that line is only polled.

A pseudo-terminal has no modem lines: tests use a `ModemLine` of their own.
"""

import errno
import fcntl
import os
import sys
import termios
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple, Protocol

from drivers.errors import DeviceFault, told
from drivers.gates.line_gate import LineGate
from drivers.gates.port import keep_port, port_problem

LOOK_S = 0.001
"""Interval of polling."""
COUNTS = 1 << 32
"""How many values the kernel's counters have before they start again at 0."""
NO_MODEM_LINES = (errno.ENOTTY, errno.EINVAL, errno.EOPNOTSUPP)
"""Answers of ports without modem lines; those of USB gadgets say EINVAL."""
CDC_NAME = "ttyACM"
"""Ports of USB's own class, CDC ACM: it transmits DSR, CD and RI, and its driver reports CTS as always on."""
COUNTER_WORDS = 20
"""Length of the kernel's `serial_icounter_struct` in 32-bit words; the first four are cts, dsr, rng, dcd."""

ModemLineName = Literal["CTS", "DSR", "RI", "CD"]

_COUNTER_WORD: dict[ModemLineName, int] = {"CTS": 0, "DSR": 1, "CD": 3}
_BITS: dict[ModemLineName, int] = {
    "CTS": termios.TIOCM_CTS,
    "DSR": termios.TIOCM_DSR,
    "RI": termios.TIOCM_RI,
    "CD": termios.TIOCM_CD,
}


@dataclass(frozen=True, slots=True, kw_only=True)
class ModemLineSettings:
    """The modem line that carries the output of the sensor."""

    port: str  # a name that outlives replugging: /dev/serial/by-id/...
    line: ModemLineName = "CTS"
    is_inverted: bool = False  # the line is off while the beam is closed
    debounce_us: int = 10_000  # edges within this time after the last one belong to the same stone

    def __post_init__(self) -> None:
        if not self.port:
            raise ValueError("port must be named, as under /dev/serial/by-id/")
        if self.line not in _BITS:
            raise ValueError(f"line must be one of {', '.join(_BITS)}, not {self.line!r}")
        if self.debounce_us < 0:
            raise ValueError(f"debounce_us must not be negative, not {self.debounce_us}")


class Look(NamedTuple):
    """The line at one moment."""

    is_on: bool
    n_edges: int | None  # the kernel's 32-bit count of both directions; None: not counted


class ModemLine(Protocol):
    """A line that can be polled; `look` raises `OSError` when it is gone."""

    def look(self) -> Look: ...

    def close(self) -> None: ...


class TtyLine:
    """The line of a real port, locked against other programs."""

    def __init__(self, settings: ModemLineSettings) -> None:
        self._bit = _BITS[settings.line]
        self._word = _COUNTER_WORD.get(settings.line)
        self._fd = os.open(settings.port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        try:
            fcntl.flock(self._fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
            self._last = self._read(self._count_if_it_can())
            keep_port(self._fd)  # a sensor may be fed by DTR or RTS
        except BaseException:
            self.close()
            raise

    def look(self) -> Look:
        n_edges = self._count()
        if n_edges is None or n_edges != self._last.n_edges:
            # with some converters reading the level costs a USB transfer, reading the count none
            self._last = self._read(n_edges)
        return self._last

    def close(self) -> None:
        os.close(self._fd)

    def _count_if_it_can(self) -> int | None:
        """Return the count; notes when the port cannot count."""
        try:
            return self._count()
        except OSError:
            self._word = None
            return None

    def _count(self) -> int | None:
        if self._word is None:
            return None
        counters = fcntl.ioctl(self._fd, termios.TIOCGICOUNT, bytes(4 * COUNTER_WORDS))
        return int.from_bytes(counters[4 * self._word :][:4], sys.byteorder)

    def _read(self, n_edges: int | None) -> Look:
        bits = int.from_bytes(fcntl.ioctl(self._fd, termios.TIOCMGET, bytes(4)), sys.byteorder)
        return Look(bool(bits & self._bit), n_edges)


class EdgesBetween:
    """Counts the edges between two looks, from level and count, each of which may be ahead of the other."""

    def __init__(self, first: Look) -> None:
        self._last = first
        self._ahead = 0  # edges returned that the kernel had not yet counted

    def step(self, look: Look) -> int:
        """Return the number of edges since the last look."""
        has_changed = look.is_on != self._last.is_on
        n_edges = int(has_changed)
        if look.n_edges is not None and self._last.n_edges is not None:
            n_counted = (look.n_edges - self._last.n_edges) % COUNTS - self._ahead
            n_edges = max(n_counted + (n_counted % 2 != has_changed), n_edges)
            self._ahead = n_edges - n_counted
        self._last = look
        return n_edges


class ModemLineGate(LineGate):
    """A gate on a modem line; it cannot trigger the cameras, so test pulses need a `FiringGate` around it."""

    def __init__(
        self, settings: ModemLineSettings, open_line: Callable[[ModemLineSettings], ModemLine] = TtyLine
    ) -> None:
        super().__init__(f"{settings.port} {settings.line}", settings.debounce_us)
        self._settings = settings
        self._open_line = open_line

    def test_pulse(self) -> None:
        """Raise `GateUnavailableError`: the line is an input."""
        raise self._thread.error("cannot trigger the cameras")

    def _connect(self) -> Callable[[], None]:
        if self._settings.line == "CTS" and Path(self._settings.port).resolve().name.startswith(CDC_NAME):
            raise self._thread.error(told(DeviceFault.GATE_NO_CTS))
        try:
            line = self._held = self._open_line(self._settings)
            first = line.look()
        except (OSError, ValueError) as err:
            if isinstance(err, OSError) and err.errno in NO_MODEM_LINES:
                raise self._thread.error(told(DeviceFault.GATE_NO_MODEM_LINES)) from err
            raise self._thread.error(port_problem(err, self._settings.port)) from err
        between = EdgesBetween(first)
        return lambda: self._turn(line, between)

    def _turn(self, line: ModemLine, between: EdgesBetween) -> None:
        time.sleep(LOOK_S)
        look = line.look()
        now_ns = time.monotonic_ns()
        for n_later in reversed(range(between.step(look))):
            is_on = look.is_on ^ bool(n_later % 2)
            self._pulses.edge(is_closed=is_on != self._settings.is_inverted, at_ns=now_ns)
        self._pulses.settle(now_ns)
