"""Stones that the gate did not announce, or late: which of them the cameras showed, and which nobody saw.

Frames without an announcement come some 0.3 s after the edge, the gap in the gate's counter is told with its
next line: before the two are compared all frames must have had time to come.
"""

from collections import deque
from typing import NamedTuple

from pipeline.frames import Trigger


class _Gap(NamedTuple):
    due_ns: int  # when all frames of its triggers have come
    received_ns: int
    n_triggers: int


class MissedTriggers:
    """Offsets orphans against what the gate announces late and the gaps of its counter, one by one."""

    def __init__(self, tolerance_ns: int) -> None:
        """`tolerance_ns`: by how much the time of an orphan, which is that of its frames, may be off."""
        self._tolerance_ns = tolerance_ns
        self._gaps: deque[_Gap] = deque()
        self._orphans_ns: list[int] = []  # that neither gap nor announcement has explained yet
        self._last_announced = 0

    def has_adopted(self, trigger: Trigger) -> bool:
        """Whether the line of an announcement comes so late that its frames have been adopted."""
        return any(
            abs(orphan_ns - trigger.received_ns) <= self._tolerance_ns for orphan_ns in self._orphans_ns
        )

    def announced(self, trigger: Trigger) -> None:
        """Note an announcement: if the gate missed nothing before it, earlier orphans were no stones of its."""
        is_next = trigger.sequence == self._last_announced + 1 and not self._gaps
        self._last_announced = trigger.sequence
        orphans_ns, at_ns = self._orphans_ns, trigger.received_ns
        earlier_ns = [orphan_ns for orphan_ns in orphans_ns if orphan_ns < at_ns - self._tolerance_ns]
        later_ns = [orphan_ns for orphan_ns in orphans_ns if orphan_ns > at_ns + self._tolerance_ns]
        self._orphans_ns = later_ns if is_next else earlier_ns + later_ns

    def adopted(self, received_ns: int) -> None:
        """Note frames that got a trigger of their own, of this time."""
        self._orphans_ns.append(received_ns)

    def missed(self, n_triggers: int, received_ns: int, due_ns: int) -> None:
        """Note a gap, to be looked at when its frames are due."""
        self._gaps.append(_Gap(due_ns, received_ns, n_triggers))

    def unseen(self, now_ns: int | None = None) -> list[int]:
        """When the gaps that are due (all without `now_ns`) were told, once for each stone that nobody saw."""
        told_ns: list[int] = []
        while self._gaps and (now_ns is None or now_ns >= self._gaps[0].due_ns):
            gap = self._gaps.popleft()
            n_explained = min(len(self._orphans_ns), gap.n_triggers)
            del self._orphans_ns[:n_explained]
            told_ns += [gap.received_ns] * (gap.n_triggers - n_explained)
        return told_ns
