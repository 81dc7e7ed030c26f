"""A light gate on a GPIO line: the kernel dates every edge (to microseconds) and numbers it, which reveals losses.

A second line, an output wired in parallel with the sensor to the cameras' trigger line, makes test pulses.
"""

import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import timedelta
from typing import Any, NamedTuple, Protocol

from drivers.errors import DeviceFault, GateUnavailableError, told
from drivers.gates.line_gate import LineGate

WAIT_S = 0.02
"""Longest wait for edges in one turn of the thread."""
MAX_SETTLING_US = 1_000_000
"""Greatest debounce and glitch time."""
EVENT_BUFFER = 1024
"""How many edges the kernel keeps; when more come it drops the oldest, and their numbers are missing."""
ECHO_NS = 1_000_000
"""Edges on the input until so long after a test pulse belong to it, and are ignored."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GpioGateSettings:
    """The GPIO line that carries the output of the sensor, and the line for test pulses."""

    chip: str  # such as /dev/gpiochip0
    line: int | str  # offset or name
    active_low: bool = False  # the line is low while the beam is closed
    debounce_us: int = 10_000  # edges within this time after the last one belong to the same stone
    glitch_us: int = 0  # the kernel ignores shorter pulses; it dates its edges that much later
    test_line: int | str | None = None
    test_pulse_us: int = 1_000

    def __post_init__(self) -> None:
        if not self.chip:
            raise ValueError("chip must be named, such as /dev/gpiochip0")
        if self.test_line == self.line:
            raise ValueError(f"test_line must be another line than {self.line}")
        for name in ("debounce_us", "glitch_us"):
            if not 0 <= getattr(self, name) <= MAX_SETTLING_US:
                raise ValueError(f"{name} must be in 0..{MAX_SETTLING_US}, not {getattr(self, name)}")
        for line in (self.line, self.test_line):
            if isinstance(line, int) and not 0 <= line < 1 << 16:
                raise ValueError(f"a line's offset must be in 0..65535, not {line}")
        if not 1 <= self.test_pulse_us <= 100_000:
            raise ValueError(f"test_pulse_us must be in 1..100000, not {self.test_pulse_us}")


class LineEdge(NamedTuple):
    """One edge, as the kernel reports it."""

    is_closed: bool
    at_ns: int  # CLOCK_MONOTONIC, the clock of `time.monotonic_ns`
    number: int  # counts all edges of this line, from 1; a gap is a loss


class GpioLines(Protocol):
    """The gate's line and its test line; both calls raise `OSError` when the chip is gone."""

    def wait(self, timeout_s: float) -> Sequence[LineEdge]:
        """Return the edges in order, none when none came in time."""
        ...

    def drive(self, line: int | str, *, is_active: bool) -> None:
        """Switch the test line."""
        ...

    def close(self) -> None: ...


def _gpiod(wanted_for: str) -> Any:
    """Import gpiod; raise `GateUnavailableError` without it."""
    try:
        import gpiod

        _ = gpiod.line.Value, gpiod.EdgeEvent
    except (ImportError, AttributeError) as err:  # the system's package may be 1.x, which has other names
        raise GateUnavailableError(wanted_for, told(DeviceFault.GATE_GPIOD_MISSING)) from err
    return gpiod


class OutputLines(Protocol):
    """Output lines of a chip; `switch` raises `OSError` when it is gone."""

    def switch(self, on: Mapping[int | str, bool]) -> None:
        """Switch lines on and off."""
        ...

    def close(self) -> None: ...


class GpiodOutputs:
    """The output lines of a real chip, off at first; they are no gate's, but this module alone knows gpiod."""

    def __init__(self, chip: str, active_low: Mapping[int | str, bool]) -> None:
        """Take the lines; raise `OSError` if one cannot be had, `GateUnavailableError` without gpiod."""
        gpiod = _gpiod(f"contacts {chip}")
        self._values = gpiod.line.Value
        output, off = gpiod.line.Direction.OUTPUT, gpiod.line.Value.INACTIVE
        lines = {
            line: gpiod.LineSettings(direction=output, output_value=off, active_low=is_low)
            for line, is_low in active_low.items()
        }
        self._request = gpiod.request_lines(chip, config=lines, consumer="stonefall bridge")

    def switch(self, on: Mapping[int | str, bool]) -> None:
        values = self._values
        self._request.set_values(
            {line: values.ACTIVE if is_on else values.INACTIVE for line, is_on in on.items()}
        )

    def close(self) -> None:
        self._request.release()


class GpiodLines:
    """The lines of a real chip."""

    def __init__(self, settings: GpioGateSettings) -> None:
        gpiod = _gpiod(f"light gate {settings.chip}")
        self._values = gpiod.line.Value
        self._rising = gpiod.EdgeEvent.Type.RISING_EDGE
        lines = {
            settings.line: gpiod.LineSettings(
                direction=gpiod.line.Direction.INPUT,
                edge_detection=gpiod.line.Edge.BOTH,
                active_low=settings.active_low,
                debounce_period=timedelta(microseconds=settings.glitch_us),
                event_clock=gpiod.line.Clock.MONOTONIC,
            )
        }
        if settings.test_line is not None:
            lines[settings.test_line] = gpiod.LineSettings(direction=gpiod.line.Direction.OUTPUT)
        self._request = gpiod.request_lines(
            settings.chip, config=lines, consumer="stonefall", event_buffer_size=EVENT_BUFFER
        )

    def wait(self, timeout_s: float) -> list[LineEdge]:
        if not self._request.wait_edge_events(timeout_s):
            return []
        return [
            LineEdge(event.event_type is self._rising, event.timestamp_ns, event.line_seqno)
            for event in self._request.read_edge_events()
        ]

    def drive(self, line: int | str, *, is_active: bool) -> None:
        self._request.set_value(line, self._values.ACTIVE if is_active else self._values.INACTIVE)

    def close(self) -> None:
        self._request.release()


class GpioGate(LineGate):
    """A gate on a GPIO line; `received_ns` is the kernel's time of the edge, losses are `TriggersLost`."""

    def __init__(
        self, settings: GpioGateSettings, open_lines: Callable[[GpioGateSettings], GpioLines] = GpiodLines
    ) -> None:
        super().__init__(f"{settings.chip} {settings.line}", settings.debounce_us)
        self._settings = settings
        self._open_lines = open_lines
        self._lines: GpioLines | None = None
        self._last: LineEdge | None = None
        self._echo_ns = range(0)  # edges then are a test pulse's own

    def _connect(self) -> Callable[[], None]:
        try:
            lines = self._held = self._lines = self._open_lines(self._settings)
        except (OSError, ValueError) as err:
            raise self._thread.error(told(DeviceFault.GATE_GPIO_UNUSABLE, reported=str(err))) from err
        self._last = None
        return lambda: self._turn(lines)

    def test_pulse(self) -> None:
        """Pulse the test line and deliver a `BACKGROUND` trigger; raises `GateUnavailableError`."""
        test_line = self._settings.test_line
        if test_line is None:
            raise self._thread.error("has no test line to trigger the cameras with")
        if self._lines is None or not self._thread.is_armed:
            raise self._thread.error("is not armed")
        at_ns = time.monotonic_ns()
        self._echo_ns = range(at_ns, sys.maxsize)  # however long a busy machine takes for it
        try:
            self._lines.drive(test_line, is_active=True)
            time.sleep(self._settings.test_pulse_us / 1e6)
            self._lines.drive(test_line, is_active=False)
        except OSError as err:
            raise self._thread.error(f"cannot set test line {test_line}: {err}") from err
        finally:
            self._echo_ns = range(at_ns, time.monotonic_ns() + ECHO_NS)
        self._pulses.test_pulse(at_ns)

    def close(self) -> None:
        super().close()
        self._lines = None

    def _turn(self, lines: GpioLines) -> None:
        now_ns = time.monotonic_ns()  # before the call: every edge up to now is among those it returns
        for edge in lines.wait(WAIT_S):
            self._take(edge)
        self._pulses.settle(now_ns)

    def _take(self, edge: LineEdge) -> None:
        last, self._last = self._last, edge
        if last is not None and (n_missed := edge.number - last.number - 1) > 0:
            # edges alternate, so every second one closed the beam
            n_closed = (n_missed + (not last.is_closed)) // 2
            self._pulses.lose(n_closed, f"{n_missed} edges dropped by the kernel")
        at_ns = edge.at_ns - self._settings.glitch_us * 1000
        if at_ns in self._echo_ns:
            return
        if self._is_opened_twice(last, edge):
            self._pulses.settle(edge.at_ns)
            self._pulses.lose(1, "the beam closed and opened within one interrupt of this machine")
        self._pulses.edge(is_closed=edge.is_closed, at_ns=at_ns)

    def _is_opened_twice(self, last: LineEdge | None, edge: LineEdge) -> bool:
        """True when a stone fell between two openings with consecutive numbers.

        The kernel takes an edge's direction from the line's level, which it reads late on a busy machine: open again.
        """
        return (
            last is not None
            and edge.number == last.number + 1
            and not (last.is_closed or edge.is_closed)
            and edge.at_ns - last.at_ns >= self._settings.debounce_us * 1000
        )
