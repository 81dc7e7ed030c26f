"""Stones that the gate announced late or not at all: which of them the cameras showed, and which nothing showed.

Frames without an announcement arrive some 0.3 s after the beam closes; a gap in the gate's counter is reported with
the gate's next line. The two are compared only when all frames have had time to arrive.
"""

from collections import deque
from typing import NamedTuple

from pipeline.frames import MissingReason, Trigger

MAX_SINGLE = 100
"""Most stones of a gap in the gate's counter that are told one by one; those of a longer one are told as a number."""
MAX_ORPHANS = 1000
"""Most orphans whose times are kept, until the gate speaks again; of those before them their number is."""


class CounterGap(NamedTuple):
    """Triggers that only the gate's counter knows, as they were reported."""

    received_ns: int
    n_triggers: int
    reason: MissingReason
    due_ns: int  # when all frames of its triggers have come


class MissedTriggers:
    """Offsets orphans against late announcements and gaps of the gate's counter, one by one."""

    def __init__(self, tolerance_ns: int) -> None:
        """`tolerance_ns`: largest error of an orphan's time, which is derived from its frames."""
        self._tolerance_ns = tolerance_ns
        self._gaps: deque[CounterGap] = deque()
        self._orphans_ns: list[int] = []  # not yet explained by a gap or an announcement, the newest
        self._n_earlier_orphans = 0  # and how many before them, too long ago to be announced
        self._last_announced = 0

    def has_orphan_of(self, trigger: Trigger) -> bool:
        """True when an announcement comes so late that its frames have become an orphan's."""
        return any(abs(at_ns - trigger.received_ns) <= self._tolerance_ns for at_ns in self._orphans_ns)

    def note_announced(self, trigger: Trigger) -> None:
        """Register an announcement: if the gate missed nothing before it, earlier orphans were not its stones."""
        is_next = trigger.sequence == self._last_announced + 1 and not self._gaps
        self._last_announced = trigger.sequence
        earlier_ns = [at_ns for at_ns in self._orphans_ns if at_ns < trigger.received_ns - self._tolerance_ns]
        later_ns = [at_ns for at_ns in self._orphans_ns if at_ns > trigger.received_ns + self._tolerance_ns]
        self._orphans_ns = later_ns if is_next else earlier_ns + later_ns
        if is_next:
            self._n_earlier_orphans = 0

    def note_orphan(self, received_ns: int) -> None:
        """Register frames that got a trigger of their own, at this time."""
        self._orphans_ns.append(received_ns)
        if len(self._orphans_ns) > MAX_ORPHANS:
            del self._orphans_ns[0]
            self._n_earlier_orphans += 1

    @property
    def has_gap(self) -> bool:
        """Whether triggers that the gate counted have no bundle yet, and may not get one."""
        return bool(self._gaps)

    def note_gap(self, gap: CounterGap) -> None:
        """Register a gap in the gate's counter, to be compared with the orphans when its frames are due."""
        self._gaps.append(gap)

    def take_unseen(self, now_ns: int | None = None) -> list[CounterGap]:
        """Settle the gaps that are due (all without `now_ns`); return the triggers that no orphan explains."""
        unseen: list[CounterGap] = []
        while self._gaps and (now_ns is None or now_ns >= self._gaps[0].due_ns):
            gap = self._gaps.popleft()
            n_earlier = min(self._n_earlier_orphans, gap.n_triggers)
            n_explained = n_earlier + min(len(self._orphans_ns), gap.n_triggers - n_earlier)
            self._n_earlier_orphans -= n_earlier
            del self._orphans_ns[: n_explained - n_earlier]
            n_unseen = gap.n_triggers - n_explained
            if n_unseen <= MAX_SINGLE:
                unseen += [gap._replace(n_triggers=1)] * n_unseen
            else:
                unseen.append(gap._replace(n_triggers=n_unseen))
        return unseen
