"""The facts that health is assessed from."""

from collections.abc import Sequence
from dataclasses import dataclass, field

from drivers.interfaces import CameraProcessStatus
from pipeline.views.quality import ViewsParameters
from service.base.status import AcquisitionStatus, CalibrationFacts, CameraStatus, ConfigurationState
from service.health.optical_watch import OpticalFinding
from service.health.refinement_watch import RefinementTrend
from service.health.rig_watch import Suspicion
from service.store.disk_use import RetentionFacts


@dataclass(frozen=True, slots=True, kw_only=True)
class Facts:
    """Everything that the daemon knows about its own state at one moment."""

    acquisition: AcquisitionStatus
    cameras: Sequence[CameraStatus]
    common_cause: str | None = None  # why all cameras are lost
    camera_process: CameraProcessStatus = field(default_factory=CameraProcessStatus)
    blind_triggers: int  # in a row, without any image
    views: ViewsParameters  # how many cameras make which quality

    waiting: int  # bundles in the spool
    without_outcome: int = 0  # these, and losses that are not stored yet
    max_waiting: int
    spool_trouble: str | None = None  # what went wrong with it lately: stones lost, its folder deleted
    workers: int  # processes that run
    slots: int
    worker_restarts: int
    worker_trouble: str | None = None  # how the latest process failed that did so lately
    quarantined: Sequence[str] = ()  # files of bundles that no worker survived
    late: Sequence[str]  # parts without progress, see `service.daemon.heartbeats`
    loop_ms: float  # longest delay of the event loop within a minute
    clock_step_s: float | None  # by which the wall clock was set lately
    clock_is_unset: bool = False  # since the host started, as one without a battery

    has_background: bool
    has_network: bool = False  # which needs no background
    segmentation_warning: str | None = None  # why outlines are not found as configured
    calibration: CalibrationFacts
    suspicions: Sequence[Suspicion] = ()  # cameras that contradict their calibration, see `rig_watch`
    optical_findings: Sequence[OpticalFinding] = ()  # windows, lenses and light to clean or repair
    refinement: RefinementTrend  # what the pixels inside the outlines say of the stones

    last_seq: int  # the newest durable result
    store_trouble: str | None = None  # why nothing can be written now, with the remedy
    store_incidents: Sequence[str] = ()  # what was moved aside at a start, see `service.store.history`
    backup_trouble: str | None = None  # why the last backup failed
    retention: RetentionFacts | None = None  # what the store takes, and what was removed
    free_bytes: int | None  # on the store's file system, None if that does not answer
    key_trouble: str | None = None  # why keys of the store's folder are not accepted
    recording_trouble: str | None = None  # why a recording ended early
    left_out: int = 0  # results whose frames were not archived
    archive_trouble: str | None = None  # why frames were not archived lately
    webhook_troubles: Sequence[str] = ()  # endpoints that take nothing, or are told nothing any more
    file_drop_trouble: str | None = None  # why files of closed lots cannot be written
    configuration: ConfigurationState | None = None  # what became of its file
