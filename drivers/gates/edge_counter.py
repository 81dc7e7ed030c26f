"""What a gate's own numbers tell of edges that were never announced.

The counter goes on over wraps of the gate's 32 bits and over its restarts, so that no number comes twice.
"""

from dataclasses import dataclass

from drivers.gates.gate_protocol import SEQUENCES

OUT_OF_ORDER_US = 1_000_000
"""An edge may be told after a status that was made later; a gate whose time goes back by more began anew."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """From what was known to what the gate says now."""

    sequence: int  # number of the last edge, continued
    missed: int  # edges in between that no line told of
    is_repeated: bool = False  # this edge was told before
    has_restarted: bool = False  # the gate counts anew: what it counted unheard before is unknown


class EdgeCounter:
    """Follows the numbers of `E`, `T` and `S` lines, in the order the gate sent them."""

    def __init__(self) -> None:
        self._last: int | None = None  # as the gate counts
        self._last_edge_us = -1
        self._device_us = 0
        self._sequence = 0

    def edge(self, sequence: int, device_us: int) -> Step:
        """Take the number of an edge or test pulse."""
        is_same = sequence == self._last
        if is_same and (device_us == self._last_edge_us or device_us >= self._device_us):
            return Step(sequence=self._sequence, missed=0, is_repeated=True)
        step = self._advance(sequence, device_us, n_told=1)
        self._last_edge_us = device_us
        return step

    def status(self, last_sequence: int, device_us: int) -> Step:
        """Take the last number of a status."""
        return self._advance(last_sequence, device_us, n_told=0)

    def _advance(self, sequence: int, device_us: int, *, n_told: int) -> Step:
        n_new = n_told if self._last is None else (sequence - self._last) % SEQUENCES
        has_restarted = self._last is not None and (
            device_us < self._device_us - OUT_OF_ORDER_US or n_new >= SEQUENCES // 2
        )
        if has_restarted:
            n_new = max(sequence, n_told)
        self._sequence = sequence if self._last is None else self._sequence + n_new
        self._last = sequence
        self._device_us = device_us
        return Step(sequence=self._sequence, missed=max(n_new - n_told, 0), has_restarted=has_restarted)
