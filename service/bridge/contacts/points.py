"""The contacts and registers: what each of them says of the plant, described once for lines, Modbus and the guide."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum

from pipeline.gradation.estimates import Estimate
from pipeline.gradation.specification import Verdict
from service.base.status import AcquisitionState, Ne107
from service.bridge.plant_state import PlantState

VERSION = 1
"""Raised when a point changes its meaning or place; new ones are added at the end."""
UNKNOWN = 0xFFFF
"""Value of a register that is not known or was not measured, which is never 0; of one of two words both are so."""
LOT_WORDS = 32
"""Registers of a lot's name: two ASCII characters each, the first in the upper byte, NUL after the end."""


class Contact(StrEnum):
    """A contact: one bit, also on a line. Off while it is not known to be true: of a dead bridge all are off."""

    HEARTBEAT = "heartbeat"
    DAEMON_ANSWERS = "daemon_answers"
    RIG_READY = "rig_ready"
    LOT_OPEN = "lot_open"
    LOT_CONFORMS = "lot_conforms"
    OUT_OF_LIMITS = "out_of_limits"
    ALARM = "alarm"
    ALARM_UNACKNOWLEDGED = "alarm_unacknowledged"
    SIMULATED = "simulated"


def is_rig_good(state: PlantState) -> bool:
    """True while the rig is known to measure the next stone as specified."""
    return state.ready and state.ne107 in (Ne107.GOOD, Ne107.MAINTENANCE_REQUIRED)


@dataclass(frozen=True, slots=True)
class Bit:
    """A contact, and when it is on; its address is its place in `BITS`."""

    name: Contact
    meaning: str
    is_on: Callable[[PlantState, int], bool]
    """From the state and the number of answers of the daemon so far."""


BITS: Sequence[Bit] = (
    Bit(
        Contact.HEARTBEAT,
        "changes with every answer of the daemon, about once a second",
        lambda _, n: n % 2 == 1,
    ),
    Bit(Contact.DAEMON_ANSWERS, "the daemon answers", lambda state, _: state.daemon_answers),
    Bit(
        Contact.RIG_READY,
        "the next stone will be measured; NE 107 `good` or `maintenance_required`",
        lambda state, _: is_rig_good(state),
    ),
    Bit(Contact.LOT_OPEN, "a lot is open", lambda state, _: state.lot is not None),
    Bit(
        Contact.LOT_CONFORMS,
        "`rig_ready`, and the open lot conforms so far",
        lambda state, _: is_rig_good(state) and state.verdict is Verdict.CONFORMS,
    ),
    Bit(
        Contact.OUT_OF_LIMITS,
        "`rig_ready`, and the open lot does not conform so far",
        lambda state, _: is_rig_good(state) and state.verdict is Verdict.DOES_NOT_CONFORM,
    ),
    Bit(Contact.ALARM, "there is an alarm", lambda state, _: bool(state.alarms)),
    Bit(
        Contact.ALARM_UNACKNOWLEDGED,
        "there is one that was not acknowledged",
        lambda state, _: any(alarm.acknowledged_by is None for alarm in state.alarms),
    ),
    Bit(
        Contact.SIMULATED,
        "no stone falls: the images are synthetic, or a recording is played",
        lambda state, _: state.is_simulated or state.is_replay,
    ),
)

NE107 = (
    None,
    Ne107.GOOD,
    Ne107.MAINTENANCE_REQUIRED,
    Ne107.OUT_OF_SPECIFICATION,
    Ne107.CHECK_FUNCTION,
    Ne107.FAILURE,
)
ACQUISITION = (None, *AcquisitionState)
VERDICTS = (
    None, Verdict.INSUFFICIENT, Verdict.UNDECIDED, Verdict.CONFORMS, Verdict.DOES_NOT_CONFORM, Verdict.NOT_MEASURED,
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Register:
    """One or more words that follow each other; the address is that of what is before and its words."""

    name: str
    meaning: str
    words: Callable[[PlantState, int], tuple[int, ...]]
    """From the state and the number of answers of the daemon so far."""
    n_words: int = 1


def _number(name: str, meaning: str, of: Callable[[PlantState], int | None]) -> Register:
    return Register(name, meaning, lambda state, _: (_bounded(of(state), UNKNOWN),))


def _count(name: str, meaning: str, of: Callable[[PlantState], int | None]) -> Register:
    return Register(name, meaning, lambda state, _: divmod(_bounded(of(state), 0xFFFF_FFFF), 1 << 16), 2)


def _estimate(name: str, meaning: str, of: Callable[[PlantState], Estimate | None], steps: int) -> Register:
    def value(state: PlantState) -> int | None:
        estimate = of(state)
        return None if estimate is None or estimate.value is None else round(estimate.value * steps)

    return _number(name, meaning, value)


def _code(
    name: str, meaning: str, codes: Sequence[str | None], of: Callable[[PlantState], str | None]
) -> Register:
    listed = ", ".join(
        f"{code} {'unknown or none' if word is None else word}" for code, word in enumerate(codes)
    )

    def value(state: PlantState) -> int:
        word = of(state)
        return codes.index(word) if word in codes else 0

    return _number(name, f"{meaning}: {listed}", value)


def _bounded(value: int | None, unknown: int) -> int:
    """Return a value as the words hold it: what is above is the highest that is known."""
    return unknown if value is None else max(0, min(value, unknown - 1))


def _lot(state: PlantState, _: int) -> tuple[int, ...]:
    name = (state.lot or "").encode("ascii", "replace").ljust(2 * LOT_WORDS, b"\0")
    return tuple(int.from_bytes(name[i : i + 2]) for i in range(0, 2 * LOT_WORDS, 2))


REGISTERS: Sequence[Register] = (
    _number("map_version", "version of this table", lambda _: VERSION),
    Register("heartbeat", "answers of the daemon so far, modulo 65 536", lambda _, n: (n % (1 << 16),)),
    _code("ne107", "state of the device", NE107, lambda state: state.ne107),
    _code("acquisition", "state of the rig", ACQUISITION, lambda state: state.acquisition),
    _code("verdict", "on the open lot, so far", VERDICTS, lambda state: state.verdict),
    _code("last_verdict", "on the lot that was closed last, final", VERDICTS, lambda state: state.last_verdict),
    _number("alarms", "alarms", lambda state: len(state.alarms) if state.daemon_answers else None),
    _number("stones_per_min", "stones that fell within the last minute", lambda state: state.stones_per_min),
    _estimate("d50", "D50 of the open lot, else of the last hour, 0.01 mm", lambda state: state.d50_mm, 100),
    _estimate("flakiness", "FI of the same (EN 933-3), 0.1 %", lambda state: state.flakiness_percent, 10),
    _estimate("shape", "SI of the same (EN 933-4), 0.1 %", lambda state: state.shape_percent, 10),
    _count("lot_stones", "stones that fell in the open lot", lambda state: state.n_stones),
    _count("measured", "stones measured since the beginning of the history", lambda state: state.measured),
    _count("rejected", "stones rejected since then", lambda state: state.rejected),
    _count("lost", "stones lost since then", lambda state: state.lost),
    _count("last_seq", "`seq` of the newest result of the feed", lambda state: state.last_seq),
    Register("lot", "name of the open lot in ASCII, NUL after its end", _lot, LOT_WORDS),
)  # fmt: skip


def bits(state: PlantState, n_answers: int) -> list[bool]:
    """Return all contacts, by address."""
    return [bit.is_on(state, n_answers) and state.daemon_answers for bit in BITS]


def registers(state: PlantState, n_answers: int) -> list[int]:
    """Return the words of all registers, by address."""
    return [word for register in REGISTERS for word in register.words(state, n_answers)]


def as_markdown() -> str:
    """Return both tables as the guide has them."""
    lines = ["| bit | contact | on while |", "|---|---|---|"]
    lines += [f"| {address} | `{bit.name}` | {bit.meaning} |" for address, bit in enumerate(BITS)]
    lines += ["", "| register | name | value |", "|---|---|---|"]
    address = 0
    for register in REGISTERS:
        last = address + register.n_words - 1
        place = f"{address}" if last == address else f"{address}-{last}"
        lines.append(f"| {place} | `{register.name}` | {register.meaning} |")
        address = last + 1
    return "\n".join(lines)
