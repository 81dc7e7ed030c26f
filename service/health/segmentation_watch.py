"""Watch whether the network runs as configured, by what workers report of each bundle.

A provider can fail while the daemon runs: the GPU is out of memory, its driver is gone. Stones are still measured, on
the CPU or without the network, and health warns.
"""

from collections import deque

from pipeline.segmentation.silhouette import FoundBy
from service.base.messages import Code, joined, message
from service.base.status import Checks, trouble_check
from service.processing.measure_job import MeasuredBundle
from service.processing.segmenters import SegmenterPlan

WINDOW = 20
"""Bundles measured with the network but without trouble, by any worker, after which the warning ends."""


class SegmentationWatch:
    """Watches the network: `feed` it every measured bundle."""

    def __init__(self, plan: SegmenterPlan) -> None:
        self._plan = plan
        self._troubles: deque[str | None] = deque(maxlen=WINDOW)

    def feed(self, measured: MeasuredBundle) -> None:
        """Take one measured bundle into account, unless it was measured without the network."""
        trouble, found_by = measured.network_trouble, measured.record.segmenters.values()
        if trouble is not None or any(segmenter != FoundBy.BACKGROUND for segmenter in found_by):
            self._troubles.append(trouble)

    def checks(self, *, has_background: bool) -> Checks:
        """Check what outlines are found with: the background, which a network does without, and the network."""
        alone = [] if self._plan.model is None else [message(Code.NETWORK_ALONE)]
        problem = joined([message(Code.BACKGROUND_MISSING), *alone])
        latest = next((trouble for trouble in reversed(self._troubles) if trouble is not None), None)
        told = [] if latest is None else [message(Code.NETWORK_TROUBLED, reported=latest)]
        return {
            "background": trouble_check(None if has_background else problem, has_background),
            "segmentation": trouble_check(
                joined([*([self._plan.warning] if self._plan.warning else []), *told])
            ),
        }
