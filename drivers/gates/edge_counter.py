"""What a gate's own numbers tell of edges that were never announced.

The counter goes on over wraps of the gate's 32 bits and over its restarts, so that no number comes twice.
"""

from dataclasses import dataclass

from drivers.gates.gate_protocol import SEQUENCES

OUT_OF_ORDER_US = 1_000_000
"""An edge may be told after a status that was made later; a gate whose time goes back by more began anew."""
MAX_RATE_HZ = 50
"""No belt drops so many stones for long: a counter that is further on was not counting stones."""
MAX_BURST = 10
"""So many more may come at once."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """From what was known to what the gate says now."""

    sequence: int  # number of the last edge, continued
    missed: int | None  # edges in between that no line told of; None: nobody knows how many
    is_repeated: bool = False  # this edge was told before
    has_restarted: bool = False  # the gate counts anew: what it counted unheard before is unknown


class EdgeCounter:
    """Follows the numbers of `E`, `T` and `S` lines, in the order the gate sent them."""

    def __init__(self) -> None:
        self._last: int | None = None  # as the gate counts
        self._last_edge_us = -1
        self._device_us = 0
        self._sequence: int | None = None

    def forget(self) -> None:
        """Follow another gate from now on; what it counted so far is nobody's loss."""
        self._last = None

    def edge(self, sequence: int, device_us: int) -> Step:
        """Take the number of an edge or test pulse."""
        is_told = device_us == self._last_edge_us or device_us >= self._device_us
        if self._sequence is not None and sequence == self._last and is_told:
            return Step(sequence=self._sequence, missed=0, is_repeated=True)
        step = self._advance(sequence, device_us, n_told=1)
        self._last_edge_us = device_us
        return step

    def status(self, last_sequence: int, device_us: int) -> Step:
        """Take the last number of a status."""
        return self._advance(last_sequence, device_us, n_told=0)

    def _advance(self, sequence: int, device_us: int, *, n_told: int) -> Step:
        n_new, elapsed_us, has_restarted = n_told, 0, False
        if self._last is not None:
            n_new, elapsed_us = (sequence - self._last) % SEQUENCES, device_us - self._device_us
            has_restarted = elapsed_us < -OUT_OF_ORDER_US or n_new >= SEQUENCES // 2
        if has_restarted:
            n_new, elapsed_us = max(sequence, n_told), device_us
        missed: int | None = max(n_new - n_told, 0)
        if n_new - n_told > MAX_BURST + max(elapsed_us, 0) * MAX_RATE_HZ // 1_000_000:
            n_new, missed, has_restarted = n_told, None, True
        self._sequence = sequence if self._sequence is None else self._sequence + n_new
        self._last = sequence
        self._device_us = device_us
        return Step(sequence=self._sequence, missed=missed, has_restarted=has_restarted)
