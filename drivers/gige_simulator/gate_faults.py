"""The faults of the simulated gate and its serial line."""

import random
from dataclasses import dataclass

from drivers.gige_simulator.faults import FaultSwitches


@dataclass(slots=True, kw_only=True)
class GateFaults(FaultSwitches):
    """Faults of a gate, in force until they are cleared; numbers without a unit are probabilities."""

    missed: float = 0.0  # a stone is not seen: no pulse, no line, not counted
    uncounted: float = 0.0  # a stone pulses the cameras, but is neither counted nor announced
    bounce: float = 0.0  # a stone has one more edge, which the gate merges
    doubled: float = 0.0  # a stone has two edges, 3 ms apart, both counted, both pulsed
    lost: float = 0.0  # a line does not arrive
    repeated: float = 0.0  # a line is sent twice
    garbage: float = 0.0  # random bytes come before a line
    halved: float = 0.0  # a line breaks off in the middle
    corrupted: float = 0.0  # one character of a line is wrong
    jitter_us: float = 0.0  # a line leaves late, by at most so much; lines keep their order
    is_silent: bool = False  # no line leaves
    is_blocked: bool = False  # the beam stays closed: no stone is seen


def damaged(line: bytes, faults: GateFaults, dice: random.Random) -> tuple[bytes, bool]:
    """Return the bytes of a line that arrive, and True when they still contain the whole of it.

    Always draws the same number of random numbers, so that one fault does not shift the others.
    """
    lost, repeated, garbage, halved, corrupted = (
        dice.random() < probability
        for probability in (faults.lost, faults.repeated, faults.garbage, faults.halved, faults.corrupted)
    )
    place, noise = dice.randrange(1, 5), dice.randbytes(32)
    if lost or faults.is_silent:
        return b"", False
    if halved:
        line = line[: len(line) // 2]
    if corrupted:
        line = line[:place] + bytes([line[place] ^ 0x05]) + line[place + 1 :]
    if repeated:
        line += line
    if garbage:
        line = noise + line
    return line, not (halved or corrupted)
