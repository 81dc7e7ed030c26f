"""Detect edges that a gate counted and never announced, from the gaps in its sequence numbers.

The numbers returned go on over wraps of the gate's 32 bits and over its restarts, so that none comes twice.
"""

from dataclasses import dataclass

from drivers.gates.gate_records import SEQUENCES

OUT_OF_ORDER_US = 1_000_000
"""An edge may be sent after a status with a later time; a gate whose time goes back by more was restarted."""
MAX_RATE_HZ = 50
"""Highest plausible rate of stones: a counter that is further on has not counted stones."""
MAX_BURST = 10
"""How many more edges may come at once."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CountedStep:
    """The progress of the counter with one line of the gate."""

    sequence: int  # of the last edge, counted on over wraps and restarts
    missed: int | None  # edges in between that no line announced; None: unknown how many
    is_repeated: bool = False  # this edge was announced before
    has_restarted: bool = False  # the gate counts anew: edges that it had not announced before are unknown


class EdgeCounter:
    """Follows the numbers of `E`, `T` and `S` lines, in the order the gate sent them."""

    def __init__(self) -> None:
        self._last: int | None = None  # as the gate counts
        self._last_edge_us = -1
        self._device_us = 0
        self._sequence: int | None = None

    def forget(self) -> None:
        """Follow another gate from now on; what it counted so far is not missed."""
        self._last = None

    def resume(self, sequence: int, device_us: int) -> None:
        """Go on from what was known of the same gate earlier; its numbers are not counted on."""
        self._last, self._device_us = sequence, device_us

    def edge(self, sequence: int, device_us: int) -> CountedStep:
        """Note the number of an edge or test pulse."""
        is_not_older = device_us == self._last_edge_us or device_us >= self._device_us
        if self._sequence is not None and sequence == self._last and is_not_older:
            return CountedStep(sequence=self._sequence, missed=0, is_repeated=True)
        step = self._advance(sequence, device_us, n_announced=1)
        self._last_edge_us = device_us
        return step

    def status(self, last_sequence: int, device_us: int) -> CountedStep:
        """Note the last number of a status."""
        return self._advance(last_sequence, device_us, n_announced=0)

    def _advance(self, sequence: int, device_us: int, *, n_announced: int) -> CountedStep:
        n_new, elapsed_us, has_restarted = n_announced, 0, False
        if self._last is not None:
            n_new, elapsed_us = (sequence - self._last) % SEQUENCES, device_us - self._device_us
            has_restarted = elapsed_us < -OUT_OF_ORDER_US or n_new >= SEQUENCES // 2
        if has_restarted:
            n_new, elapsed_us = max(sequence, n_announced), device_us
        missed: int | None = max(n_new - n_announced, 0)
        if n_new - n_announced > MAX_BURST + max(elapsed_us, 0) * MAX_RATE_HZ // 1_000_000:
            n_new, missed, has_restarted = n_announced, None, True
        self._sequence = sequence if self._sequence is None else self._sequence + n_new
        self._last = sequence
        self._device_us = device_us
        return CountedStep(sequence=self._sequence, missed=missed, has_restarted=has_restarted)
