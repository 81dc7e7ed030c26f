"""The parts of the running daemon, and what the REST interface, the watchdog and `systemctl status` ask of them."""

import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, fields
from functools import partial
from typing import TypeVar, cast

from service.acquisition.acquisition import Acquisition
from service.base.camera_status import CameraStatus
from service.base.status import AcquisitionStatus, ConfigurationState, Health
from service.calibration.calibrations import Calibrations
from service.configuration.settings import Settings
from service.daemon.diagnostics.archive import Inputs
from service.daemon.diagnostics.diagnostic_inputs import diagnostic_inputs
from service.daemon.heartbeats import Heartbeats, Watched
from service.daemon.loop_watch import LoopWatch
from service.daemon.overview.overviews import KeptFigures
from service.daemon.overview.result_delays import ResultDelays
from service.daemon.part import Part
from service.daemon.reloading import Configuration
from service.daemon.retaining import Retaining
from service.daemon.session import Session
from service.delivery.webhooks import Webhooks
from service.health.alarms.alarms import Alarms
from service.health.assessment import assess
from service.health.facts import Facts
from service.health.findings import camera_ne107, rig_ne107
from service.health.optical_watch import OpticalWatch
from service.health.refinement_watch import RefinementWatch
from service.health.rig_watch import CameraScore, RigWatch
from service.health.segmentation_watch import SegmentationWatch
from service.lots.plant import PlantSettings
from service.lots.shifts import LotsSettings
from service.processing.processing import Processing
from service.processing.spool import Spool
from service.processing.worker_pool import WorkerPool
from service.recording.raw_archive import RawArchive
from service.recording.recordings import Recordings
from service.remeasuring.remeasuring import Remeasuring
from service.reports.lot_reports import RigStanding
from service.reports.report import EndedVerification, VerificationOutcome
from service.results.fields import Verified
from service.store.checks import free_bytes
from service.web.key_ring import KeyRing

T = TypeVar("T")


@dataclass(frozen=True, slots=True, kw_only=True)
class Watches:
    """The observers of loop and progress, of the rig's geometry and optics, of segmentation and refinement."""

    loop: LoopWatch
    progress: Heartbeats
    rig: RigWatch
    optics: OpticalWatch
    segmentation: SegmentationWatch
    refinement: RefinementWatch


@dataclass(frozen=True, slots=True, kw_only=True)
class Daemon:
    """What REST, metrics and the watchdog ask of the parts; implements `service.web.control.Control`."""

    configured: Configuration
    session: Session
    watches: Watches
    keys: KeyRing
    recordings: Recordings
    calibrations: Calibrations
    acquisition: Acquisition
    spool: Spool
    archive: RawArchive
    pool: WorkerPool
    processing: Processing
    remeasuring: Remeasuring
    retaining: Retaining
    alarms: Alarms
    webhooks: Webhooks
    delays: ResultDelays
    figures: KeptFigures
    parts: list[Part] = field(default_factory=list)
    """In the order in which they start."""

    @property
    def settings(self) -> Settings:
        return self.configured.settings

    def part(self, kind: type[T]) -> T:
        states: Mapping[type, Callable[[], object]] = {
            AcquisitionStatus: self.acquisition.status,
            ConfigurationState: lambda: self.configured.state,
            Facts: self.facts,
            Health: self.health,
            Inputs: partial(diagnostic_inputs, self.settings),
            LotsSettings: lambda: self.settings.lots,
            PlantSettings: lambda: self.settings.plant,
            RigStanding: lambda: rig_standing(
                self.calibrations, self.settings.plant, self.settings.measuring.density_kg_m3
            ),
            Settings: lambda: self.settings,
        }
        if kind in states:
            return cast("T", states[kind]())
        parts = (getattr(self, each.name) for each in fields(self))
        return next(part for part in parts if isinstance(part, kind))

    async def apply(self, old: Settings, new: Settings) -> None:
        """Put the settings that need no restart into the parts that work with them; `lots` is read from the settings.

        Raises `StoreError` when the store cannot note new endpoints; nothing is changed then.
        """
        if new.webhooks != old.webhooks:  # first, as no other part can refuse
            await self.webhooks.use(new.webhooks)
        for part in self.parts:
            part.use(new)

    def cameras(self) -> list[CameraStatus]:
        scores, optics = self.watches.rig.scores(), self.watches.optics.optics()
        findings = (*self.watches.rig.findings(), *self.watches.optics.findings())
        return [
            status.model_copy(
                update=asdict(scores.get(status.id, CameraScore()))
                | {"optics": optics.get(status.id), "ne107": camera_ne107(status, findings)}
            )
            for status in self.acquisition.cameras.statuses()
        ]

    def health(self) -> Health:
        return assess(
            (part.checks() for part in self.parts),
            acquisition=self.acquisition.status(),
            views=self.settings.views,
            rig_ne107=rig_ne107(
                (*self.watches.rig.findings(), *self.watches.optics.findings()), self.calibrations.facts()
            ),
        )

    def facts(self) -> Facts:
        return Facts(
            health=self.health(),
            acquisition=self.acquisition.status(),
            cameras=self.cameras(),
            calibration=self.calibrations.facts(),
            waiting=self.spool.n_queued,
            max_waiting=self.spool.max_bundles,
            workers=len(self.pool.pids),
            slots=self.pool.size,
            worker_restarts=self.pool.restarts,
            left_out=self.archive.left_out,
            refinement=self.watches.refinement.trend,
            loop_ms=self.watches.loop.worst_ms(),
            free_bytes=free_bytes(self.session.store.dir),
            retention=self.retaining.facts,
        )

    def watch(self) -> list[Watched]:
        """Record that idle parts are not late, and return those that are; to be called often."""
        if not self.acquisition.is_active:
            self.watches.progress.beat(Watched.ACQUISITION, time.monotonic())
        # a store that is held is named by its own check
        if self.spool.n_queued == 0 or self.session.store.trouble is not None:
            self.watches.progress.beat(Watched.PROCESSING, time.monotonic())
        return self.watches.progress.late(time.monotonic())

    def status(self) -> str:
        """Return one line for `systemctl status`."""
        last_seq = self.session.store.last_seq
        return f"{self.acquisition.state}, {self.spool.n_queued} bundles waiting, last result {last_seq}"


def rig_standing(
    calibrations: Calibrations, plant: PlantSettings, density_kg_m3: float | None = None
) -> RigStanding:
    """Return the last verification of the rig file in use, whether another one is overdue, plant and density."""
    is_asked = calibrations.verifications.parameters.every_h > 0
    last = calibrations.verifications.last(calibrations.rig_file.calibration_id)
    return RigStanding(
        verification=None
        if last is None
        else EndedVerification(
            id=last.id,
            at=last.changed_at,
            outcome=VerificationOutcome(last.state),
            diameter_mm=last.diameter_mm,
            error_mm=None if last.summary is None else last.summary.error_mm,
        ),
        is_overdue=is_asked and calibrations.verified in (Verified.OVERDUE, Verified.NEVER),
        plant=plant,
        density_kg_m3=density_kg_m3,
    )
