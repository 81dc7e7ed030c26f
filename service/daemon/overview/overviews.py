"""The overview: made once for all who look at it, while there are any, and at most every `LEAST_S`.

The main figures are made in the process `stonefall-read`, beside it: an overview never waits for them but at first.
"""

import asyncio
import hashlib
import logging
import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from datetime import UTC, datetime

import numpy as np

from drivers.files.times import utc_now
from pipeline.frames import CameraId
from pipeline.rig.cameras import RigCalibration
from service.base.camera_status import CameraOptics
from service.base.errors import ServiceError, StoreError
from service.base.messages import findings_of
from service.calibration.calibrations import Calibrations
from service.daemon.overview.overview_documents import (
    PASSING,
    OverviewAcquisition,
    OverviewAlarm,
    OverviewAlarms,
    OverviewCamera,
    OverviewDocument,
    OverviewFigures,
    OverviewLatency,
    OverviewQueue,
    OverviewVerification,
)
from service.daemon.overview.overview_rows import Rows, overview_figures, overview_rows
from service.daemon.overview.result_delays import ResultDelays
from service.health.alarms.alarm import ANNOUNCED, Alarm
from service.health.alarms.alarms import Alarms
from service.health.alarms.rules import Priority
from service.health.facts import Facts
from service.lots.shifts import LotsSettings
from service.lots.yardsticks import Request
from service.reports.lot_reports import RigStanding
from service.store import Store, read
from service.web.control import Control
from service.web.reader_process import Reading
from service.web.shared_answers import SharedAnswers

log = logging.getLogger(__name__)

LEAST_S, MOST_S = 0.7, 1.0
"""Between two overviews: after the first time, the next result has another one made; after the second, time has."""
REPEAT_S = 5.0
"""An overview that does not change is sent again after this time: browsers do not show comments to their scripts."""
FIGURES_S = 5.0
"""Least time between two requests for the figures of one lot."""
FIGURES_SHARE = 0.1
"""Most of the time that their making may take: those of 100 000 stones are asked for less often."""
OLD_S = 60.0
"""Figures older than this, as after a time without viewers, are not shown if new ones come within `PATIENCE_S`."""
PATIENCE_S = 2.0
MAX_ALARMS = 20
NO_OPTICS = CameraOptics()


@dataclass(frozen=True, slots=True, kw_only=True)
class Overview:
    """An overview as JSON, and what is the same of two that differ by time alone."""

    content: bytes
    version: str
    made_s: float


class Overviews:
    """Makes overviews while they are asked for. Call it on the event loop."""

    def __init__(self, store: Store, control: Control) -> None:
        self._store = store
        self._control = control
        self._shared = SharedAnswers()
        self._last: Overview | None = None
        self._rows = Rows()
        self._rows_seq = -1  # `last_seq` at the time of the rows

    async def now(self) -> Overview:
        """Return the overview; one that is younger than `MOST_S` is new enough."""
        if self._last is not None and _now_s() - self._last.made_s < MOST_S:
            return self._last
        return await self._shared.get("now", self._make, keep_s=0)

    async def another_than(self, version: str) -> Overview:
        """Return the overview as soon as it is another one; after `REPEAT_S`, or when the daemon stops, anyway."""
        latest_s = _now_s() + REPEAT_S
        while True:
            overview = await self._shared.get("next", self._make_next, keep_s=0)
            if overview.version != version or _now_s() >= latest_s or self._store.is_released:
                return overview

    async def _make_next(self) -> Overview:
        """Make the next overview when it is time; all who wait for it wait for this one."""
        if self._last is not None:
            await asyncio.sleep(self._last.made_s + LEAST_S - _now_s())
        with suppress(TimeoutError):
            async with asyncio.timeout(MOST_S - LEAST_S):
                await self._store.wait_while(lambda: self._store.last_seq <= self._rows_seq)
        return await self._make()

    async def _make(self) -> Overview:
        made_s = _now_s()
        await self._read_rows()
        lot = None if self._rows.lot is None else self._rows.lot.lot
        request = Request(measured=self._control.part(LotsSettings).measured)
        figures = await self._control.part(KeptFigures).now(lot, request)
        document = _document(self._store, self._control, self._rows, self._rows_seq, figures)
        lasting = document.model_dump_json(exclude=PASSING)
        self._last = Overview(
            content=document.model_dump_json().encode(),
            version=hashlib.sha256(lasting.encode()).hexdigest()[:16],
            made_s=made_s,
        )
        return self._last

    async def _read_rows(self) -> None:
        """Read what the store says; while it cannot be read, the overview goes on with what it said last."""
        last_seq = self._store.last_seq
        now = datetime.now(UTC).astimezone()
        with suppress(StoreError):
            self._rows = await self._store.read(
                overview_rows, self._store.session, now, last_seq != self._rows_seq, self._rows
            )
            self._rows_seq = last_seq


class KeptFigures:
    """The main figures of one lot or of the last hour, made anew beside those who ask: overviews and `ProductWatch`."""

    def __init__(self, store: Store, reading: Reading) -> None:
        self._store = store
        self._reading = reading
        self._figures: OverviewFigures | None = None
        self._lot: str | None = None
        self._making: asyncio.Task[None] | None = None
        self._made_s = self._due_s = -math.inf
        self._made_seq = -1

    async def with_new_results(self, lot: str, request: Request) -> OverviewFigures | None:
        """Return the figures of a lot as `now` does, but have new ones made only if there is a new result."""
        if lot == self._lot and self._made_seq == self._store.last_seq:
            return self._figures
        return await self.now(lot, request)

    async def now(self, lot: str | None, request: Request) -> OverviewFigures | None:
        """Return the figures made last, and have new ones made if it is time; old ones wait for these."""
        if (self._making is None or self._making.done()) and (_now_s() >= self._due_s or lot != self._lot):
            self._making = asyncio.create_task(self._make(lot, request))
            if _now_s() - self._made_s > OLD_S:
                await asyncio.wait([self._making], timeout=PATIENCE_S)
        return self._figures if lot == self._lot else None

    async def _make(self, lot: str | None, request: Request) -> None:
        begun_s, last_seq = _now_s(), self._store.last_seq
        try:
            self._figures = await self._reading.run(
                read, self._store.path, overview_figures, lot, datetime.now(UTC), request
            )
            self._lot, self._made_s, self._made_seq = lot, _now_s(), last_seq
        except (
            ServiceError
        ) as err:  # the process is busy, the store cannot be read, or a specification is gone
            log.warning("the overview keeps its figures: %s", err)
        finally:
            took_s = _now_s() - begun_s
            self._due_s = max(begun_s + FIGURES_S, _now_s() + took_s * (1 / FIGURES_SHARE - 1))


def _document(
    store: Store, control: Control, rows: Rows, rows_seq: int, figures: OverviewFigures | None
) -> OverviewDocument:
    facts, calibrations = control.part(Facts), control.part(Calibrations)
    health, use = facts.health, facts.retention.use
    directions = _directions(calibrations.rig)
    return OverviewDocument(
        at=utc_now(),
        instance_id=store.instance_id,
        rig=control.part(RigStanding).plant.rig,
        is_simulated=rows.is_simulated,
        is_replay=rows.is_replay,
        acquisition=OverviewAcquisition(**dict(facts.acquisition)),
        **{name: getattr(health, name) for name in ("ne107", "gate_ne107", "rig_ne107", "ready", "reasons")},
        findings=[*findings_of(facts.acquisition.trouble), *health.findings],
        lot=rows.lot,
        last_lot=rows.last_lot,
        figures=figures,
        stones_per_min=rows.stones_per_min,
        accounting=rows.accounting,
        today=rows.accounting_today,
        queue=OverviewQueue(waiting=facts.waiting, max=facts.max_waiting),
        latency=_latency(control.part(ResultDelays).latest_s),
        disk_days=None if use is None or use.days_left is None else round(use.days_left, 1),
        verification=_verification(calibrations),
        calibration_id=calibrations.rig_file.calibration_id,
        alarms=_alarms(control.part(Alarms).within(*ANNOUNCED)),
        cameras=[
            OverviewCamera(
                **{**dict(each.optics or NO_OPTICS), **dict(each), **directions[each.id]},
                findings=[found for warning in each.warnings for found in findings_of(warning)],
            )
            for each in facts.cameras
        ],
        newest=list(rows.newest),
        last_seq=max(rows_seq, 0),  # as far as the rows reach
        last_event=store.last_event,
    )


def _directions(rig: RigCalibration) -> Mapping[CameraId, Mapping[str, float]]:
    """Return azimuth and elevation of each camera about the rig's centre, in whole degrees."""
    places = {camera.id: camera.center_mm for camera in rig.cameras}
    return {
        name: {
            "azimuth_deg": round(float(np.rad2deg(np.arctan2(y, x)))) % 360,
            "elevation_deg": round(float(np.rad2deg(np.arctan2(z, np.hypot(x, y))))),
        }
        for name, (x, y, z) in places.items()
    }


def _latency(delays_s: Sequence[float]) -> OverviewLatency | None:
    if not delays_s:
        return None
    median_ms, p99_ms = np.percentile(np.multiply(delays_s, 1e3), [50, 99])
    return OverviewLatency(median_ms=round(median_ms, 1), p99_ms=round(p99_ms, 1))


def _verification(calibrations: Calibrations) -> OverviewVerification:
    last = calibrations.verifications.last(calibrations.rig_file.calibration_id)
    age = None if last is None else datetime.now(UTC) - datetime.fromisoformat(last.changed_at)
    return OverviewVerification(
        verdict=calibrations.verified,
        age_h=None if age is None else round(max(0.0, age.total_seconds() / 3600), 2),
    )


def _alarms(announced: Sequence[Alarm]) -> OverviewAlarms:
    states = [alarm.state for alarm in announced]
    return OverviewAlarms(
        **{state.value: states.count(state) for state in ANNOUNCED},
        urgent=sum(alarm.priority is Priority.URGENT for alarm in announced),
        items=[OverviewAlarm(subject=alarm.check, **asdict(alarm)) for alarm in announced[:MAX_ALARMS]],
    )


def _now_s() -> float:
    return asyncio.get_running_loop().time()
