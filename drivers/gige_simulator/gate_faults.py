"""What can go wrong at the simulated gate and on its serial line."""

import random
from dataclasses import dataclass

from drivers.gige_simulator.faults import Switches


@dataclass(slots=True, kw_only=True)
class GateFaults(Switches):
    """What goes wrong, from now on until it is set back; numbers without a unit are probabilities."""

    missed: float = 0.0  # of an edge: no pulse, no line, not counted
    uncounted: float = 0.0  # of an edge: the cameras are pulsed, and that is all
    bounce: float = 0.0  # of a stone: one more edge, which the gate merges
    doubled: float = 0.0  # of a stone: two edges, 3 ms apart, both counted, both pulsed
    lost: float = 0.0  # of a line, on its way to the host
    repeated: float = 0.0  # of a line: sent twice
    garbage: float = 0.0  # of a line: random bytes before it
    halved: float = 0.0  # of a line: breaks off in the middle
    corrupted: float = 0.0  # of a line: one character is another
    jitter_us: float = 0.0  # a line leaves up to so much late; the order stays
    is_silent: bool = False  # no line leaves
    is_blocked: bool = False  # the beam stays closed: no stone is seen


def damaged(line: bytes, faults: GateFaults, dice: random.Random) -> tuple[bytes, bool]:
    """What the serial line makes of a line, maybe nothing, and whether the whole of it is still in there.

    Always takes as many random numbers, so that one fault does not move the others.
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
