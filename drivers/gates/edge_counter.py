"""Detect edges that a gate counted and never announced, from the gaps in its sequence numbers.

The numbers and times returned go on over wraps of the gate's counters of 32 bits and over its restarts, so that none
comes twice. A clock of 32 bits begins again at 0 as after a loss of power: of the two it is the wrap if the gate
counts on, and if its clock then advanced as the host's did. A clock that went back to a time longer ago than the latest
line is no restart either: since then the gate cannot have been switched on.
"""

from dataclasses import dataclass

from drivers.gates.gate_records import SEQUENCES

OUT_OF_ORDER_US = 1_000_000
"""An edge may be sent after a status with a later time; one whose time goes back by more was restarted, or is wrong."""
SHORT_CLOCK_US = 1 << 32
"""After so long, 71.6 minutes, a clock of 32 bits begins again at 0."""
UNREAD_US = 100_000_000
"""Age that a line may have when the host reads it: what its buffer of 4 KB holds of one status a second."""
MAX_RATE_HZ = 50
"""Highest plausible rate of stones: a counter that is further on has not counted stones."""
MAX_BURST = 10
"""How many more edges may come at once."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CountedStep:
    """The progress of the counter with one line of the gate."""

    sequence: int  # of the last edge, counted on over wraps and restarts
    device_us: int  # time of the line by the gate's clock, counted on over wraps
    missed: int | None  # edges in between that no line announced; None: unknown how many
    is_repeated: bool = False  # this edge was announced before
    has_restarted: bool = False  # the gate counts anew: edges that it had not announced before are unknown
    has_wrapped: bool = False  # the gate's clock has 32 bits, and began again at 0
    has_stepped_back: bool = False  # the gate's clock was set back, or told wrongly before; it counts on


class EdgeCounter:
    """Follows the numbers of `E`, `T` and `S` lines, in the order the gate sent them.

    `host_ns` is the host's monotonic time of a line; without it no wrap of the clock is told from a restart.
    """

    def __init__(self) -> None:
        self._last: int | None = None  # as the gate counts
        self._last_edge_us = -1
        self._sent_us = 0
        self._host_ns: int | None = None
        self._turns = 0  # wraps of the gate's clock since it was switched on
        self._sequence: int | None = None

    def forget(self) -> None:
        """Follow another gate from now on; what it counted so far is not missed."""
        self._last, self._turns = None, 0

    def resume(self, sequence: int, sent_us: int, host_ns: int | None = None) -> None:
        """Go on from what was known of the same gate earlier; its numbers are not counted on."""
        self._last, self._sent_us, self._host_ns, self._turns = sequence, sent_us, host_ns, 0

    def sent_us(self, device_us: int) -> int:
        """Return a time as the gate sent it, before it was counted on."""
        return device_us - self._turns * SHORT_CLOCK_US

    def edge(self, sequence: int, sent_us: int, host_ns: int | None = None) -> CountedStep:
        """Note the number of an edge or test pulse."""
        is_not_older = sent_us == self._last_edge_us or sent_us >= self._sent_us
        if self._sequence is not None and sequence == self._last and is_not_older:
            device_us = sent_us + self._turns * SHORT_CLOCK_US
            return CountedStep(sequence=self._sequence, device_us=device_us, missed=0, is_repeated=True)
        step = self._advance(sequence, sent_us, host_ns, n_announced=1)
        self._last_edge_us = sent_us
        return step

    def status(self, last_sequence: int, sent_us: int, host_ns: int | None = None) -> CountedStep:
        """Note the last number of a status."""
        return self._advance(last_sequence, sent_us, host_ns, n_announced=0)

    def _advance(self, sequence: int, sent_us: int, host_ns: int | None, *, n_announced: int) -> CountedStep:
        n_new, elapsed_us, turns = n_announced, 0, 0
        has_restarted = has_stepped_back = False
        if self._last is not None:
            n_new, turns = (sequence - self._last) % SEQUENCES, self._turns_until(sent_us, host_ns)
            elapsed_us = sent_us - self._sent_us + turns * SHORT_CLOCK_US
            has_stepped_back = elapsed_us < -OUT_OF_ORDER_US
            has_restarted = n_new >= SEQUENCES // 2 or (
                has_stepped_back and self._may_be_new(sent_us, host_ns)
            )
        if has_restarted:
            n_new, elapsed_us = max(sequence, n_announced), sent_us
        missed: int | None = max(n_new - n_announced, 0)
        if n_new - n_announced > MAX_BURST + max(elapsed_us, 0) * MAX_RATE_HZ // 1_000_000:
            n_new, missed, has_restarted = n_announced, None, True
        self._turns = 0 if has_restarted else self._turns + turns
        self._sequence = sequence if self._sequence is None else self._sequence + n_new
        self._last, self._sent_us, self._host_ns = sequence, sent_us, host_ns
        return CountedStep(
            sequence=self._sequence,
            device_us=sent_us + self._turns * SHORT_CLOCK_US,
            missed=missed,
            has_restarted=has_restarted,
            has_wrapped=turns > 0 and not has_restarted,
            has_stepped_back=has_stepped_back and not has_restarted,
        )

    def _may_be_new(self, sent_us: int, host_ns: int | None) -> bool:
        """True when the gate can have been switched on after the latest line; where the host's time is unknown, too."""
        if host_ns is None or self._host_ns is None:
            return True
        host_us = (host_ns - self._host_ns) // 1000
        return sent_us <= host_us + host_us // 1000 + OUT_OF_ORDER_US + UNREAD_US

    def _turns_until(self, sent_us: int, host_ns: int | None) -> int:
        """Return the wraps of a clock of 32 bits by which it advanced as the host's did; 0 if none explain it.

        -1 for an edge of before a wrap that is sent after a status of after it.
        """
        if host_ns is None or self._host_ns is None or max(sent_us, self._sent_us) >= SHORT_CLOCK_US:
            return 0
        host_us = (host_ns - self._host_ns) // 1000
        turns = round((host_us - sent_us + self._sent_us) / SHORT_CLOCK_US)
        behind_us = host_us - sent_us + self._sent_us - turns * SHORT_CLOCK_US
        drift_us = OUT_OF_ORDER_US + max(host_us, 0) // 1000
        is_explained = -drift_us <= behind_us <= drift_us + UNREAD_US
        return turns if is_explained and self._turns + turns >= 0 else 0
