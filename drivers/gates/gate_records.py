"""Records of a gate with a clock and a counter of its own, in any protocol."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, NamedTuple, Protocol

SEQUENCES: Final = 1 << 32
"""How many values the counters of a gate have before they start again at 0."""


@dataclass(frozen=True, slots=True)
class Edge:
    """A stone closed the beam."""

    sequence: int
    device_us: int


@dataclass(frozen=True, slots=True)
class TestPulse:
    """The gate triggered the cameras on command."""

    __test__ = False  # not a test of pytest's

    sequence: int
    device_us: int


@dataclass(frozen=True, slots=True)
class Width:
    """The beam that closed with `sequence` is open again."""

    sequence: int
    width_us: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Status:
    """The state of the gate, sent every second."""

    device_us: int
    last_sequence: int  # 0 before the first
    ignored: int  # edges merged since power-on
    is_blocked: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Identity:
    """Name, serial number and firmware version of the gate."""

    name: str
    serial: str
    version: str


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraPulses:
    """How the gate pulses the cameras' trigger line after an edge or a command."""

    delay_us: int  # from the edge to the beginning of its pulse
    pulse_us: int  # width
    places: int  # pulses that can wait at the same time
    unmade: int  # pulses since power-on for which no place was free


Record = Edge | TestPulse | Width | Status | Identity | CameraPulses


class Line(NamedTuple):
    """A line without its line end."""

    text: bytes
    age_bytes: int  # how many bytes came from its first one on, that included


class UnknownRecordError(ValueError):
    """A line that arrived whole, and holds no record that its protocol knows: a limit of the reader, not damage."""


class Splitter(Protocol):
    """Cuts what is read from the port into lines, or whatever holds one record."""

    n_discarded: int
    """Number of pieces of garbage."""

    def feed(self, data: bytes) -> list[Line]:
        """Take more bytes; return the lines that are complete now."""
        ...

    def discard(self) -> None:
        """Forget the bytes of an incomplete line."""
        ...


class GateProtocol(NamedTuple):
    """The language of a gate on a serial line, given to its driver."""

    identify: bytes
    """Command: send identity and status."""
    test_pulse: bytes
    """Command: trigger the cameras once."""
    splitter: Callable[[], Splitter]
    decode: Callable[[bytes], Record]
    """Returns the record of a line; raises `ValueError`, with what is wrong, for a damaged one.

    `UnknownRecordError` for a whole one that is no record.
    """
    set_pulses: Callable[[int, int], bytes] | None = None
    """Returns the command that sets delay and width of the cameras' pulses, in us; None: no gate of it can delay."""
