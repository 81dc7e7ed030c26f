"""Whether the network runs where and as it should, from what workers say of each bundle.

A provider can fail while the daemon runs: the GPU is out of memory, its driver is gone. Measuring goes on, on the CPU
or without the network, and health warns.
"""

from collections import deque

from service.processing.measure_job import NetworkUse
from service.processing.segmenters import SegmenterPlan

WINDOW = 20
"""Bundles for which a network was asked: after so many without trouble, from whichever worker, it is over."""


class SegmentationWatch:
    """Remembers the trouble of the network over the latest bundles."""

    def __init__(self, plan: SegmenterPlan) -> None:
        self._plan = plan
        self._troubles: deque[str | None] = deque(maxlen=WINDOW)

    def note(self, use: NetworkUse) -> None:
        """Learn from one measured bundle; one without the network teaches nothing."""
        if use.trouble is not None or use.is_source:
            self._troubles.append(use.trouble)

    @property
    def warning(self) -> str | None:
        """Return what is worse than was asked for: known from the start, or found since."""
        latest = next((trouble for trouble in reversed(self._troubles) if trouble is not None), None)
        return "; ".join(text for text in (self._plan.warning, latest) if text is not None) or None
