"""What metrics and overview say of the daemon, beside its results."""

from collections.abc import Sequence
from dataclasses import dataclass

from service.base.camera_status import CameraStatus
from service.base.status import AcquisitionStatus, CalibrationFacts, Health
from service.health.refinement_watch import RefinementTrend
from service.store.checks import RetentionFacts


@dataclass(frozen=True, slots=True, kw_only=True)
class Facts:
    """State of the daemon at one moment, in figures."""

    health: Health
    acquisition: AcquisitionStatus
    cameras: Sequence[CameraStatus]
    calibration: CalibrationFacts
    waiting: int  # bundles in the spool
    max_waiting: int
    workers: int  # processes that run
    slots: int
    worker_restarts: int
    left_out: int  # results whose frames were not archived
    refinement: RefinementTrend
    loop_ms: float  # longest delay of the event loop within a minute
    free_bytes: int | None  # free space on the store's file system, None if that does not answer
    retention: RetentionFacts
