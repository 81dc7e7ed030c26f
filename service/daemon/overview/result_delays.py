"""Time from each trigger to its durable outcome, and of each stage of the measuring, for metrics and overview."""

from collections import deque
from collections.abc import Mapping

from prometheus_client import Histogram, disable_created_metrics

N_LATEST = 100
"""Outcomes whose delays are remembered one by one."""
LIMITS_S = (0.3, 0.35, 0.4, 0.45, 0.5, 0.6, 0.8, 1.0, 1.5, 2.0, 5.0, 10.0, 30.0)
"""Limits of the histogram; 0.26 s pass before the frames of a stone are there."""
STAGES = (
    "load", "segment", "optics", "check", "carve", "mesh", "estimate", "refine", "measure", "texture", "write", "store"
)  # fmt: skip
"""Stages of a result, as its `timings_ms` names them, and the store."""
STAGE_LIMITS_S = (0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0)


# the time at which each metric was made says no more than the daemon's start
disable_created_metrics()  # type: ignore[no-untyped-call]  # of a library that lacks it


class ResultDelays:
    """The delays of all outcomes as a histogram, and the latest; none in replay, which has a clock of its own."""

    def __init__(self) -> None:
        self.latest_s = deque[float](maxlen=N_LATEST)
        self.histogram = Histogram(
            "stonefall_result_delay_seconds",
            "From the light gate's trigger to the durable outcome",
            registry=None,
            buckets=LIMITS_S,
        )
        self.stages = Histogram(
            "stonefall_stage_seconds",
            "Time of each stage of a result",
            ["stage"],
            registry=None,
            buckets=STAGE_LIMITS_S,
        )
        for stage in STAGES:  # seen from the beginning
            self.stages.labels(stage)

    def note(self, delay_s: float) -> None:
        """Add the delay of another outcome."""
        self.histogram.observe(delay_s)
        self.latest_s.append(delay_s)

    def note_stages(self, timings_ms: Mapping[str, float]) -> None:
        """Add the stages of another result."""
        for stage in STAGES:
            if stage in timings_ms:
                self.stages.labels(stage).observe(timings_ms[stage] / 1e3)
