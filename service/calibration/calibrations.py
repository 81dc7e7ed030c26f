"""Calibration while measuring: collect drops, solve, review, accept; activate accepted calibrations.

An accepted calibration can be activated at any time, which is also how to roll back. An open calibration survives a
restart of the daemon, with its drops. An idle one is cancelled, because as long as it is open what falls in a live rig
counts as a ball and not as a stone.
"""

import asyncio
import logging
import time
from collections.abc import Awaitable, Callable
from dataclasses import asdict, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

from drivers.errors import RecordingError
from drivers.files.times import utc_now
from pipeline.frames import BundleKind
from pipeline.rig.cameras import RigCalibration
from service.base.errors import StoreError
from service.base.messages import Code, CodedText, findings_of, message
from service.base.status import (
    AcquisitionState,
    CalibrationFacts,
    Checks,
    health_check,
    trouble_check,
)
from service.calibration.drop_files import (
    CalibrationDocument,
    ObservedDrop,
    calibration_document,
    keep_drop,
    outline_paths,
)
from service.calibration.drops import DropCollector, Solved, SolveJob, Solver, solve_apart
from service.calibration.files import (
    Activation,
    CalibrationRecord,
    CalibrationSummary,
    fields_of,
    image_sizes_px,
)
from service.calibration.startup import CalibrationsAtStart
from service.calibration.states import (
    OPEN,
    CalibrationAction,
    CalibrationConflictError,
    CalibrationRequest,
    CalibrationState,
    Method,
    next_state,
)
from service.calibration.verifications import Verification, VerificationRequest, Verifications
from service.processing.measure_job import RigFile
from service.processing.processing import CalibrationInUse
from service.processing.worker_slot import JobLostError, WorkerStartError
from service.results.fields import Result, Verified

log = logging.getLogger(__name__)

IDLE_S = 600.0
"""An open calibration without a drop or a request for so long is cancelled."""
IDLE_CHECK_S = 5.0
STATES_WITHOUT_DROPS = (AcquisitionState.HELD, AcquisitionState.DISARMING, AcquisitionState.STOPPING)
"""A calibration cannot be opened in these. It can in a disarmed rig, which is armed afterwards."""


class Calibrations:
    """All calibrations and verifications of the daemon. Call it on the event loop; `run` is its task."""

    def __init__(
        self,
        at_start: CalibrationsAtStart,
        verifications: Verifications,
        *,
        on_activated: Callable[[RigCalibration, Activation], Awaitable[None]],
        solver: Solver = solve_apart,
    ) -> None:
        """Continue with what the start has loaded; await `on_activated` before another calibration is used."""
        self._files, self._records = at_start.files, at_start.records
        self._activations, self._trouble = at_start.activations, at_start.trouble
        self._solver, self._on_activated = solver, on_activated
        self._to_solve: asyncio.Queue[str] = asyncio.Queue()
        self._writing = asyncio.Lock()
        self._last_activity_s = time.monotonic()
        self.verifications = verifications
        self.active = at_start.active
        self.rig = at_start.rig
        """The rig of the calibration in use."""
        self.rig_file = at_start.files.rig_file(at_start.active)
        """The rig file that the next bundle is measured with."""

    @property
    def open_calibration(self) -> CalibrationRecord | None:
        """Return the calibration that collects drops, None while there is none."""
        return next((record for record in self._records.values() if record.state in OPEN), None)

    @property
    def collector(self) -> DropCollector | None:
        """Return the collector of the next drop, for the open calibration or verification; None without one."""
        current = self.open_calibration
        if current is None:
            return self.verifications.collector
        kind = BundleKind.PARTICLE if current.method == Method.STONES else BundleKind.BALL
        add = partial(self._add_drop, current.id)
        return DropCollector(kind=kind, diameters_mm=current.ball_diameters_mm, add=add)

    def in_use(self) -> CalibrationInUse:
        """Return the calibration that the next bundle is measured with, with its verdict and collector."""
        return CalibrationInUse(self.rig_file, self.collector, self.verified)

    @property
    def verified(self) -> Verified:
        """Return the result of the last verification of the calibration in use."""
        return self.verifications.verified(self.rig_file.calibration_id, datetime.now(UTC))

    @property
    def wants_balls(self) -> bool:
        """True while the bodies that fall are balls of an open calibration or verification."""
        return self.collector is not None and self.collector.kind is BundleKind.BALL

    @property
    def activations(self) -> list[Activation]:
        """Return all activations, newest first."""
        return list(reversed(self._activations.items))

    @property
    def activated(self) -> Activation:
        """Return the activation of the calibration in use."""
        return next(item for item in self.activations if item.id == self.active.id)

    def checks(self) -> Checks:
        return calibration_checks(self.facts())

    def facts(self) -> CalibrationFacts:
        """Return the facts about calibrations that health is assessed from."""
        now, calibration_id, at_work = datetime.now(UTC), self.rig_file.calibration_id, None
        if self.wants_balls and (current := self.open_calibration) is not None:
            at_work = message(Code.CALIBRATION_OPEN, calibration=current.id, state=str(current.state))
        elif (verification := self.verifications.current) is not None:
            at_work = message(Code.VERIFICATION_OPEN, verification=verification.id)
        return CalibrationFacts(
            calibration_id=calibration_id,
            method=self.rig.method,
            used_since=self.activated.at,
            at_work=at_work,
            trouble=self._trouble or self.verifications.trouble(calibration_id, now),
        )

    def all(self) -> list[CalibrationRecord]:
        """Return all calibrations, newest first."""
        return [self._records[name] for name in sorted(self._records, key=int, reverse=True)]

    def summary(self, record: CalibrationRecord) -> CalibrationSummary:
        """Return a calibration, with the fact whether it is in use."""
        return CalibrationSummary(**fields_of(record), is_active=record.id == self.active.id)

    async def find(self, name: str) -> CalibrationDocument | None:
        """Return the details of one calibration, None when there is none of that name."""
        record = self._records.get(name)
        if record is None:
            return None
        try:
            return await asyncio.to_thread(calibration_document, self._files, self.summary(record), self.rig)
        except RecordingError as err:
            raise StoreError(str(err)) from err

    def rig_path(self, name: str) -> Path | None:
        """Return the rig file of one calibration, None while there is none."""
        record = self._records.get(name)
        return None if record is None or record.calibration_id is None else self._files.rig_file(record).path

    def rig_file_of(self, calibration_id: str | None) -> RigFile | None:
        """Return the rig file that results with this calibration were measured with, None if it is not kept."""
        found = (self._files.rig_file(record) for record in self.all() if record.calibration_id is not None)
        return next((file for file in found if file.calibration_id == calibration_id), None)

    # --- requests; each raises `CalibrationConflictError` where its state forbids it ---

    async def start(self, plan: CalibrationRequest, acquisition: AcquisitionState) -> CalibrationRecord:
        """Open a calibration, which collects drops."""
        async with self._writing:
            self._require_none_open(acquisition)
            now = utc_now()
            record = CalibrationRecord(
                id=await asyncio.to_thread(self._files.next_name),
                origin="session",
                state=CalibrationState.COLLECTING,
                created_at=now,
                changed_at=now,
                initial_calibration_id=self.rig_file.calibration_id,
                **asdict(plan),
            )
            await asyncio.to_thread(self._files.create, record)
            self._records[record.id] = record
            self._last_activity_s = time.monotonic()
        log.info("calibration opened calibration=%s by=%s", record.id, plan.by)
        return record

    async def verify(self, plan: VerificationRequest, acquisition: AcquisitionState) -> Verification:
        """Begin to verify the calibration in use with balls."""
        async with self._writing:
            self._require_none_open(acquisition)
            return await self.verifications.start(plan, self.rig_file.calibration_id)

    async def act(
        self, name: str, action: CalibrationAction, by: str | None = None
    ) -> CalibrationRecord | None:
        """Carry out an action durably and return the new record; None when there is no calibration of that name."""
        async with self._writing:
            record = self._records.get(name)
            if record is None:
                return None
            state = next_state(name, record.state, action)
            self._last_activity_s = time.monotonic()
            if action is CalibrationAction.ACTIVATE:
                await self._activate(record, by)
            elif state is not record.state:
                if action is CalibrationAction.ACCEPT and record.detail:
                    detail = f"calibration {name} must not be used: {record.detail}"
                    raise CalibrationConflictError(detail, state=record.state)
                if action is CalibrationAction.SOLVE:
                    record = await self._change_state(record, state, calibration_id=None, detail=None)
                    self._to_solve.put_nowait(name)
                else:
                    record = await self._change_state(record, state, decided_by=by)
                log.info("calibration %s calibration=%s by=%s", state, name, by)
            return record

    async def run(self) -> None:
        """Solve calibrations on request, and cancel idle calibrations and verifications."""
        while True:
            try:
                async with asyncio.timeout(IDLE_CHECK_S):
                    name = await self._to_solve.get()
            except TimeoutError:
                try:
                    await self._cancel_idle()
                    await self.verifications.cancel_idle()
                except OSError as err:
                    log.error("cannot cancel an idle calibration or verification: %s", err)
            else:
                await self._solve(name)

    async def _solve(self, name: str) -> None:
        record = self._records[name]
        if record.state is not CalibrationState.SOLVING:  # cancelled before its turn came
            return
        job = SolveJob(
            outline_paths=tuple(await asyncio.to_thread(outline_paths, self._files.drops(name))),
            initial_path=self.rig_file.path,
            diameters_mm=record.ball_diameters_mm,
            method=Method(record.method),  # as it was planned
            name=self.rig.name,
            created_at=utc_now(),
            folder=self._files.folder / name,
        )
        try:
            solved = await self._solver(job)
        except (JobLostError, WorkerStartError) as err:
            solved = Solved(
                calibration_id=None, refusal=message(Code.CALIBRATION_NOT_COMPUTED, reported=str(err))
            )
        except OSError as err:
            solved = Solved(calibration_id=None, refusal=_not_written(err))
        async with self._writing:
            record = self._records[name]
            if record.state is not CalibrationState.SOLVING:  # cancelled meanwhile
                return
            state = CalibrationState.COLLECTING if solved.calibration_id is None else CalibrationState.SOLVED
            try:
                record = await self._change_state(
                    record, state, calibration_id=solved.calibration_id, detail=solved.refusal
                )
            except OSError as err:  # as after a restart, where an unfinished solution collects again
                detail = _not_written(err)
                record = replace(
                    record,
                    state=CalibrationState.COLLECTING,
                    calibration_id=None,
                    detail=detail,
                    findings=findings_of(detail),
                )
                self._records[name] = record
            self._last_activity_s = time.monotonic()
        log.info("calibration %s calibration=%s %s", record.state, name, record.detail or "")

    async def _cancel_idle(self) -> None:
        async with self._writing:
            current = self.open_calibration
            if current is not None and time.monotonic() - self._last_activity_s > IDLE_S:
                detail = message(Code.CALIBRATION_IDLE, idle_min=IDLE_S / 60)
                await self._change_state(current, CalibrationState.CANCELLED, detail=detail)
                log.warning("calibration cancelled: %s calibration=%s", detail, current.id)

    def _require_none_open(self, acquisition: AcquisitionState) -> None:
        """Refuse when no drop would be seen, or another calibration or verification is open."""
        if acquisition in STATES_WITHOUT_DROPS:
            raise CalibrationConflictError(f"acquisition is {acquisition}: no drop would be seen")
        if (current := self.open_calibration) is not None:
            detail = f"calibration {current.id} is {current.state}: accept, reject or cancel it first"
            raise CalibrationConflictError(detail, state=current.state)
        if (verification := self.verifications.current) is not None:
            raise CalibrationConflictError(f"verification {verification.id} waits for balls: cancel it first")

    async def _activate(self, record: CalibrationRecord, by: str | None) -> None:
        if record.id == self._activations.items[-1].id == self.active.id:
            return
        if (current := self.open_calibration) is not None:
            detail = (
                f"calibration {current.id} is {current.state} and starts from {self.active.id}:"
                " accept, reject or cancel it first"
            )
            raise CalibrationConflictError(detail, state=current.state)
        try:
            rig = await asyncio.to_thread(self._files.rig, record)
        except RecordingError as err:
            log.error("calibration %s cannot be activated: %s", record.id, err)
            detail = (
                f"calibration {record.id}: its rig file cannot be used: {err.problem}; activate another one"
            )
            raise CalibrationConflictError(detail, state=record.state) from err
        if differing := image_sizes_px(rig).items() ^ image_sizes_px(self.rig).items():
            cameras = ", ".join(sorted({name for name, _ in differing}))
            detail = f"calibration {record.id} was made with other cameras: {cameras}"
            raise CalibrationConflictError(detail, state=record.state)
        rig_file = self._files.rig_file(record)
        chosen = Activation(id=record.id, calibration_id=rig_file.calibration_id, at=utc_now(), by=by)
        activations = replace(self._activations, items=(*self._activations.items, chosen))
        await asyncio.to_thread(self._files.write_activations, activations)
        self._activations = activations
        if (verification := self.verifications.current) is not None:
            await self.verifications.cancel(verification.id, f"calibration {record.id} was activated")
        await self._on_activated(rig, chosen)
        self.active, self.rig, self.rig_file, self._trouble = record, rig, rig_file, None
        log.info("calibration in use calibration=%s id=%s by=%s", record.id, rig_file.calibration_id, by)

    async def _change_state(
        self, record: CalibrationRecord, state: CalibrationState, **changes: Any
    ) -> CalibrationRecord:
        if "detail" in changes:
            changes["findings"] = findings_of(changes["detail"])
        record = replace(record, state=state, changed_at=utc_now(), **changes)
        await asyncio.to_thread(self._files.write, record)
        self._records[record.id] = record
        return record

    async def _add_drop(self, name: str, drop: ObservedDrop, record: Result, outlines: Path | None) -> None:
        if self._records[name].state not in OPEN:
            return
        await asyncio.to_thread(keep_drop, self._files.drops(name), drop, outlines)
        if drop.views:
            self._last_activity_s = time.monotonic()


def _not_written(error: OSError) -> CodedText:
    return message(Code.CALIBRATION_NOT_WRITTEN, reported=str(error.strerror))


def calibration_checks(facts: CalibrationFacts) -> Checks:
    """Check that results of the calibration in use are to be trusted, and that what falls is a stone."""
    in_use = message(Code.CALIBRATION_IN_USE, method=facts.method, since=facts.used_since)
    detail = facts.trouble or in_use
    calibration = health_check(detail, facts.calibration_id, warn=facts.trouble is not None)
    return {"calibration": calibration, "drops": trouble_check(facts.at_work)}
