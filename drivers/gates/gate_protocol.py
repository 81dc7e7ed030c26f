r"""The protocol of a microcontroller light gate on a serial line, for the driver and for the author of the firmware.

A record is one line of ASCII, ``$<type>,<fields...>*<crc>\r\n``: `crc` is the CRC-16/CCITT-FALSE (polynomial
1021, start FFFF; of "123456789" it is 29B1) of all characters between ``$`` and ``*``, as four upper-case hex
digits. Numbers are decimal without sign or leading zeros. Names are 1 to 32 of ``A-Z a-z 0-9 . _ + -``.

====================================  ========================================================================
from the gate
``$E,<seq>,<us>``                     a stone closed the beam; sent at once, before anything else
``$T,<seq>,<us>``                     the cameras were triggered on command: no stone, the same counter
``$W,<seq>,<width_us>``               the beam of `seq` is open again, after `width_us`
``$S,<us>,<last>,<ignored>,<0|1>``    every second: last sequence number sent, edges merged, beam blocked now
``$I,<name>,<serial>,<version>``      identity of the gate
``$D,<delay>,<pulse>,<n>,<unmade>``   how it pulses the cameras: delay from the edge and width in us, pulses that can
                                      wait at the same time, pulses for which no place was free; sent after `I`,
                                      in answer to the command `D`, and when `unmade` grew
to the gate
``?\n``                               identify: send `I`, `D` and at once an `S`; sent when the port is opened, and
                                      the host ignores all lines until it is answered
``T\n``                               pulse the cameras' trigger line once
``$D,<delay>,<pulse>*<crc>\n``        delay and width of all later pulses, kept over power-off (EEPROM); with the
                                      checksum of a record, because it is kept
====================================  ========================================================================

- `seq` counts what triggered the cameras, edges and test pulses alike: the first after power-on is 1,
  4294967295 is followed by 0. Never repeat, never skip a number: a jump tells the host what it lost, unless it is
  further than stones can have fallen.
- `us` is the gate's own microseconds since power-on, 64 bits, of the edge itself (of the status: of its
  sending); from a crystal (200 ppm), as the host finds the latency of every line by comparing clocks.
- Lines leave in the order of what they tell: a status counts no edge whose line comes after it.
- Debounce in the gate: an edge that follows the opening of the beam within the debounce time belongs to the
  same stone. It triggers no camera, gets no number, and raises `ignored` (32 bits, from 0, wraps).
- A host may open the port at any moment: a board that restarts then (DTR) forgets what it counted meanwhile. The
  host leaves DTR and RTS up when it closes the port, so only the first opening after plugging in can restart it.

- Delay: `us` and the line of `E` and `T` are the edge's (the command's), sent at once; the pulse follows `delay` later,
  of test pulses as well. Pulses that wait keep their own time when another delay is set. A delay or width that
  the gate cannot make changes nothing, and the answer shows what is in effect. `unmade` has 32 bits, from 0, wraps; an
  edge without a pulse keeps its number and line. Kept values that are damaged or absent: delay 0, width 100.
- A gate that never sends `D` pulses at the edge itself and knows no command `D`.
- Lines of other types, whole ones, are left out and reported: they may be of a later version.

The trigger line of the cameras is wired to the gate; nothing here is in that path. 115200 baud, 8N1, no flow
control; a board with native USB has no baud rate, tell the host 4000000.
"""

import re
from binascii import crc_hqx
from dataclasses import astuple
from typing import Any, Final

from drivers.gates.gate_records import (
    SEQUENCES,
    CameraPulses,
    Edge,
    GateProtocol,
    Identity,
    Line,
    Record,
    Status,
    TestPulse,
    UnknownRecordError,
    Width,
)

IDENTIFY: Final = b"?\n"
TEST_PULSE: Final = b"T\n"

FIRMWARE_NAME: Final = "stonefall-gate"
"""Name in the identity of our own gate, drivers/gates/firmware."""
FIRMWARE_VERSION: Final = "1.0"
"""Its version, `VERSION` in gate.c: numbers and dots."""

MAX_LINE_BYTES: Final = 128
"""No record is longer: more bytes without a line end are garbage."""

_LINE = re.compile(rb"\$([^$*]*)\*([0-9A-F]{4})")
_NUMBER = re.compile(r"0|[1-9][0-9]{0,19}", re.ASCII)
_NAME = re.compile(r"[A-Za-z0-9._+-]{1,32}", re.ASCII)


def encode(record: Record) -> bytes:
    """Return the line of a record, with its line end; `ValueError` for a value that the protocol cannot carry."""
    fields = [str(int(value) if isinstance(value, bool) else value) for value in astuple(record)]
    line = _framed(_LETTERS[type(record)], *fields) + b"\r\n"
    if decode(line) != record:
        raise ValueError(f"{record} cannot be sent")
    return line


def set_pulses(delay_us: int, pulse_us: int) -> bytes:
    """Return the command that sets delay and width of the pulses to the cameras."""
    return _framed("D", str(delay_us), str(pulse_us)) + b"\n"


def read_set_pulses(line: bytes) -> tuple[int, int]:
    """Return delay and width in us of the command `set_pulses`; `ValueError` for any other line."""
    match _fields(line):
        case ["D", delay_us, pulse_us]:
            return _count(delay_us), _count(pulse_us)
    raise ValueError(f"no command: {line!r}")


def decode(line: bytes) -> Record:
    """Return the record of one line, with or without its line end.

    Raises
    ------
    ValueError
        The line is damaged; says what is wrong with it.
    UnknownRecordError
        Its checksum is right, and it is no record.
    """
    letter, *fields = _fields(line)
    try:
        return _record(letter, fields)
    except ValueError as err:
        raise UnknownRecordError(f"{err}: {line!r}") from err


def _framed(*fields: str) -> bytes:
    body = ",".join(fields).encode("ascii", "replace")
    return b"$%b*%04X" % (body, checksum(body))


def _fields(line: bytes) -> list[str]:
    found = _LINE.fullmatch(line.removesuffix(b"\n").removesuffix(b"\r"))
    if found is None:
        raise ValueError(f"not of the form $...*CRC: {line[:MAX_LINE_BYTES]!r}")
    body, crc = found.groups()
    if b"%04X" % checksum(body) != crc:
        raise ValueError(f"checksum is {crc.decode()}, should be {checksum(body):04X}: {line!r}")
    return str(body, "ascii", "replace").split(",")


def _record(letter: str, fields: list[str]) -> Record:
    match letter, fields:
        case "E", [sequence, us]:
            return Edge(_count(sequence), _microseconds(us))
        case "T", [sequence, us]:
            return TestPulse(_count(sequence), _microseconds(us))
        case "W", [sequence, width]:
            return Width(_count(sequence), _microseconds(width))
        case "S", [us, last, ignored, ("0" | "1") as blocked]:
            return Status(
                device_us=_microseconds(us),
                last_sequence=_count(last),
                ignored=_count(ignored),
                is_blocked=blocked == "1",
            )
        case "I", [name, serial, version]:
            return Identity(name=_name(name), serial=_name(serial), version=_name(version))
        case "D", [delay, pulse, places, unmade]:
            return CameraPulses(
                delay_us=_count(delay),
                pulse_us=_count(pulse),
                places=_count(places),
                unmade=_count(unmade),
            )
    raise ValueError("unknown record")


def is_outdated(identity: Identity) -> bool:
    """Return True for our own firmware, of an older version than the one of this release."""
    return identity.name == FIRMWARE_NAME and _version(identity.version) < _version(FIRMWARE_VERSION)


def _version(text: str) -> list[int]:
    return [int(number) for number in re.findall(r"[0-9]+", text)]


def checksum(body: bytes) -> int:
    """CRC-16/CCITT-FALSE."""
    return crc_hqx(body, 0xFFFF)


class LineSplitter:
    """Cuts a stream of bytes into lines; each begins at its last ``$``, so that half a line does not spoil the next."""

    def __init__(self) -> None:
        self._rest = b""
        self.n_discarded = 0
        """Number of pieces of garbage: half lines, and bytes without a line end."""

    def discard(self) -> None:
        """Forget the bytes of an incomplete line."""
        self._rest = b""

    def feed(self, data: bytes) -> list[Line]:
        """Take more bytes; returns the lines that are complete now."""
        *texts, self._rest = (self._rest + data).split(b"\n")
        age_bytes = len(self._rest)
        lines = []
        for text in reversed(texts):
            start = max(text.rfind(b"$"), 0)
            self.n_discarded += start > 0
            lines.append(Line(text[start:], age_bytes + len(text) + 1 - start))
            age_bytes += len(text) + 1
        if len(self._rest) > MAX_LINE_BYTES:
            self._rest = b""
            self.n_discarded += 1
        return lines[::-1]


_LETTERS: dict[type[Any], str] = {
    Edge: "E",
    TestPulse: "T",
    Width: "W",
    Status: "S",
    Identity: "I",
    CameraPulses: "D",
}


def _count(field: str) -> int:
    return _number(field, SEQUENCES)


def _microseconds(field: str) -> int:
    return _number(field, 1 << 64)


def _number(field: str, limit: int) -> int:
    if not _NUMBER.fullmatch(field) or int(field) >= limit:
        raise ValueError(f"not a number below {limit}: {field!r}")
    return int(field)


def _name(field: str) -> str:
    if not _NAME.fullmatch(field):
        raise ValueError(f"not a name: {field!r}")
    return field


STONEFALL = GateProtocol(
    identify=IDENTIFY, test_pulse=TEST_PULSE, splitter=LineSplitter, decode=decode, set_pulses=set_pulses
)
"""This protocol, for the driver."""
