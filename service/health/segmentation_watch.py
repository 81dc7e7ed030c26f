"""Watch whether the network runs as configured, by the flags of each result.

A provider can fail while the daemon runs: the GPU is out of memory, its driver is gone. Stones are still measured, on
the CPU or without the network, and flagged; this watch turns the flags into a warning for the operator.
"""

from collections import deque
from collections.abc import Mapping
from typing import Any

from pipeline.segmentation.network import NetworkTrouble
from pipeline.segmentation.silhouette import FoundBy
from service.processing.segmenters import SegmenterPlan

WINDOW = 20
"""Results with the network but without trouble, from any worker, after which the warning ends."""


class SegmentationWatch:
    """Watches the network: `feed` it all results, in their order."""

    def __init__(self, plan: SegmenterPlan) -> None:
        self._plan = plan
        self._troubles: deque[str | None] = deque(maxlen=WINDOW)

    def feed(self, record: Mapping[str, Any]) -> None:
        """Take one result into account."""
        flags = record.get("segmentation_flags", {}).values()
        reasons = (reason for flag in flags for reason in flag.split("; "))
        trouble = next((reason for reason in reasons if any(kind in reason for kind in NetworkTrouble)), None)
        if trouble is not None or set(record.get("segmenters", {}).values()) - {FoundBy.BACKGROUND}:
            self._troubles.append(trouble)

    @property
    def warning(self) -> str | None:
        """Why outlines are not found as configured, known from the start or found since; None if they are."""
        latest = next((trouble for trouble in reversed(self._troubles) if trouble is not None), None)
        return "; ".join(text for text in (self._plan.warning, latest) if text is not None) or None
