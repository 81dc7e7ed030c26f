"""Whether the network runs where and as it should, from what workers say of each result.

A provider can fail while the daemon runs: the GPU is out of memory, its driver is gone. Results go on, on the CPU
or without the network, and say so; here somebody is told.
"""

from collections import deque
from collections.abc import Mapping
from typing import Any

from pipeline.segmentation.network import NetworkTrouble
from pipeline.segmentation.silhouette import FoundBy
from service.processing.segmenters import SegmenterPlan

WINDOW = 20
"""Results for which a network was asked: so many without trouble, from whichever worker, and it is over."""


class SegmentationWatch:
    """Fed with all results, in their order."""

    def __init__(self, plan: SegmenterPlan) -> None:
        self._plan = plan
        self._troubles: deque[str | None] = deque(maxlen=WINDOW)

    def feed(self, record: Mapping[str, Any]) -> None:
        """Learn from one result."""
        flags = record.get("segmentation_flags", {}).values()
        parts = (part for flag in flags for part in flag.split("; "))
        trouble = next((part for part in parts if any(kind in part for kind in NetworkTrouble)), None)
        if trouble is not None or set(record.get("segmenters", {}).values()) - {FoundBy.BACKGROUND}:
            self._troubles.append(trouble)

    @property
    def warning(self) -> str | None:
        """What is worse than was asked for: known from the start, or found since."""
        latest = next((trouble for trouble in reversed(self._troubles) if trouble is not None), None)
        return "; ".join(each for each in (self._plan.warning, latest) if each is not None) or None
