"""A light gate on a modem line of a serial port: its output on CTS, DSR, RI or CD, no protocol.

The line is looked at every millisecond. Waiting for it in the kernel (TIOCMIWAIT) would be finer, but nothing
but an edge or a signal ends that wait, and many USB converters cannot do it at all; a millisecond is 2.4 mm
of fall in a picture that shows 45, and the cameras are triggered by the wire, not by this. What the looks
miss the kernel has counted (TIOCGICOUNT): no stone passes unseen, only its time and width suffer. RI is
counted by half (its end only), so that line is only looked at.

A pseudo-terminal has no modem lines: tests bring a line of their own.
"""

import errno
import fcntl
import os
import sys
import termios
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NamedTuple, Protocol

from drivers.gates.gate_thread import port_problem
from drivers.gates.line_gate import LineGate

LOOK_S = 0.001
COUNTS = 1 << 32
COUNTER_WORDS = 20
"""Of the kernel's `serial_icounter_struct`: cts, dsr, rng, dcd, and what does not matter here."""

ModemLineName = Literal["CTS", "DSR", "RI", "CD"]

_COUNTED: dict[ModemLineName, int] = {"CTS": 0, "DSR": 1, "CD": 3}
_BITS: dict[ModemLineName, int] = {
    "CTS": termios.TIOCM_CTS,
    "DSR": termios.TIOCM_DSR,
    "RI": termios.TIOCM_RI,
    "CD": termios.TIOCM_CD,
}


@dataclass(frozen=True, slots=True, kw_only=True)
class ModemLineSettings:
    """Which line of which port says that the beam is closed."""

    port: str  # a name that outlives replugging: /dev/serial/by-id/...
    line: ModemLineName = "CTS"
    is_inverted: bool = False  # the line is off while the beam is closed
    debounce_us: int = 10_000  # what follows the last edge within this is the same stone

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
    n_edges: int | None  # counted by the kernel, both directions, 32 bits; None: not counted


class ModemLine(Protocol):
    """A line that can be looked at; `OSError` when it is gone."""

    def look(self) -> Look: ...

    def close(self) -> None: ...


class TtyLine:
    """The line of a real port, for us alone."""

    def __init__(self, settings: ModemLineSettings) -> None:
        self._bit = _BITS[settings.line]
        self._word = _COUNTED.get(settings.line)
        self._fd = os.open(settings.port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        try:
            fcntl.flock(self._fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
            self._last = self._read(self._count_if_it_can())
        except BaseException:
            self.close()
            raise

    def look(self) -> Look:
        n_edges = self._count()
        if n_edges is None or n_edges != self._last.n_edges:
            # the level costs a USB transfer with some converters, the count none
            self._last = self._read(n_edges)
        return self._last

    def close(self) -> None:
        os.close(self._fd)

    def _count_if_it_can(self) -> int | None:
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
    """How many edges lie between two looks, from the level and the count: each may be ahead of the other."""

    def __init__(self, first: Look) -> None:
        self._last = first
        self._ahead = 0  # edges told that the kernel had not counted when it was asked

    def step(self, look: Look) -> int:
        has_changed = look.is_on != self._last.is_on
        n_told = int(has_changed)
        if look.n_edges is not None and self._last.n_edges is not None:
            n_counted = (look.n_edges - self._last.n_edges) % COUNTS - self._ahead
            n_told = max(n_counted + (n_counted % 2 != has_changed), n_told)
            self._ahead = n_told - n_counted
        self._last = look
        return n_told


class ModemLineGate(LineGate):
    """It has no way to trigger the cameras: put `FiringGate` around it for test pulses."""

    def __init__(
        self, settings: ModemLineSettings, open_line: Callable[[ModemLineSettings], ModemLine] = TtyLine
    ) -> None:
        super().__init__(f"{settings.port} {settings.line}", settings.debounce_us)
        self._settings = settings
        self._open_line = open_line

    def test_pulse(self) -> None:
        """Never: the line is an input; raises `GateUnavailableError`."""
        raise self._thread.error("cannot trigger the cameras")

    def _connect(self) -> Callable[[], None]:
        try:
            line = self._held = self._open_line(self._settings)
            first = line.look()
        except (OSError, ValueError) as err:
            is_no_port = isinstance(err, OSError) and err.errno == errno.ENOTTY
            raise self._thread.error("has no modem lines" if is_no_port else port_problem(err)) from err
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
