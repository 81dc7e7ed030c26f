"""The stones that passed the light gate so near in time to another that they may be in its picture."""

from collections import deque
from collections.abc import Callable
from dataclasses import replace

from pipeline.frames import BundleKind, NearStone, Trigger
from service.bundling.window import IN_VIEW_NS

REMEMBERED = 64
"""Latest triggers that are remembered: many times those within `IN_VIEW_NS` of a stone that still falls."""


class NearStones:
    """Remembers the latest triggers of the light gate, those in its dead time included."""

    def __init__(self, spacing_ns: Callable[[Trigger, Trigger], int]) -> None:
        """`spacing_ns`: time from one trigger to another, by the gate's clock where it has one."""
        self._spacing_ns = spacing_ns
        self._latest: deque[Trigger] = deque(maxlen=REMEMBERED)

    def note(self, trigger: Trigger) -> None:
        """Register a trigger as it is announced; an exposure of the empty rig is no stone."""
        if trigger.kind is not BundleKind.BACKGROUND:
            self._latest.append(trigger)

    def note_pulse(self, sequence: int, width_ns: int) -> None:
        """Register how long a stone closed the beam."""
        for at, trigger in enumerate(self._latest):
            if trigger.sequence == sequence:
                self._latest[at] = replace(trigger, pulse_width_ns=width_ns)

    def told(self, trigger: Trigger) -> Trigger:
        """Return the trigger with the stones near in time.

        That of a recording keeps those it was recorded with: replayed, other stones come near that are not in its
        pictures. One without an announcement has no time exact enough.
        """
        if trigger.name is not None or not trigger.is_announced or trigger.kind is BundleKind.BACKGROUND:
            return trigger
        others = [other for other in self._latest if other.sequence != trigger.sequence]
        near = [
            NearStone(later_ns, other.pulse_width_ns)
            for other in others
            if abs(later_ns := self._spacing_ns(trigger, other)) <= IN_VIEW_NS
        ]
        return (
            replace(trigger, near_stones=tuple(sorted(near, key=lambda stone: stone.later_ns)))
            if near
            else trigger
        )
