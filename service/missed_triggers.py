"""Stones that the gate counted and did not announce: which of them the cameras showed, and which nobody saw.

Frames without an announcement come some 0.3 s after the edge, the gap in the gate's counter is told with its
next line: before the two are compared all frames must have had time to come.
"""

from collections import deque
from typing import NamedTuple


class _Gap(NamedTuple):
    due_ns: int  # when all frames of its triggers have come
    received_ns: int
    n_triggers: int


class MissedTriggers:
    """Offsets orphans against the gaps of the gate's counter, one by one."""

    def __init__(self) -> None:
        self._gaps: deque[_Gap] = deque()
        self._n_orphans = 0  # that no gap has explained yet
        self._last_announced = 0

    def announced(self, sequence: int) -> None:
        """Note an announcement: if the gate missed nothing before it, earlier orphans were no stones of its."""
        if sequence == self._last_announced + 1 and not self._gaps:
            self._n_orphans = 0
        self._last_announced = sequence

    def adopted(self) -> None:
        """Note frames that got a trigger of their own."""
        self._n_orphans += 1

    def missed(self, n_triggers: int, received_ns: int, due_ns: int) -> None:
        """Note a gap, to be looked at when its frames are due."""
        self._gaps.append(_Gap(due_ns, received_ns, n_triggers))

    def unseen(self, now_ns: int | None = None) -> list[int]:
        """When the gaps that are due (all without `now_ns`) were told, once for each stone that nobody saw."""
        told_ns: list[int] = []
        while self._gaps and (now_ns is None or now_ns >= self._gaps[0].due_ns):
            gap = self._gaps.popleft()
            n_explained = min(self._n_orphans, gap.n_triggers)
            self._n_orphans -= n_explained
            told_ns += [gap.received_ns] * (gap.n_triggers - n_explained)
        return told_ns
