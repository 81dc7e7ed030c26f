"""Verification while measuring: balls of known diameter are measured like stones.

`service.calibration.verification_limits` has the limits.
"""

import asyncio
import logging
import time
from collections.abc import Callable
from dataclasses import asdict, replace
from datetime import datetime, timedelta
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import Annotated

from pydantic import Field, computed_field

from drivers.files.times import utc_now
from pipeline.frames import BundleKind
from service.base.messages import Code, CodedFinding, CodedText, findings_of, joined, message
from service.base.schema import Name, Remark, Time, request_body, served
from service.calibration.drop_files import ObservedDrop
from service.calibration.drops import DropCollector
from service.calibration.files import read_numbered, write_document
from service.calibration.states import DiameterMm
from service.calibration.verification_limits import (
    Summary,
    VerificationParameters,
    VerifiedBall,
    size_refusal,
    summarize,
)
from service.results.fields import Result, Verified

log = logging.getLogger(__name__)

IDLE_S = 600.0
"""A verification without a ball for so long is cancelled: what falls counts as stones again."""


class VerificationState(StrEnum):
    """State of a verification."""

    COLLECTING = "collecting"
    PASSED = "passed"
    FAILED = "failed"
    CANCELLED = "cancelled"
    VOID = "void"
    """It had a verdict, which counts no more: another ball was dropped, or the wrong diameter entered."""


COLLECTING = VerificationState.COLLECTING
VERDICTS = (VerificationState.PASSED, VerificationState.FAILED)


@served
class Verification:
    """A verification: its balls, and its verdict once they are complete."""

    id: str
    """Name of the verification in the addresses."""
    state: VerificationState
    """Its state, or its verdict."""
    diameter_mm: float
    """Diameter of the ball as requested, mm."""
    count: int
    """Number of drops to measure; rejected ones and those of another size do not count."""
    calibration_id: str
    """`calibration_id` of the calibration that is verified."""
    created_at: Time
    """When it was begun, RFC 3339 UTC."""
    changed_at: Time
    """The latest ball, or the end."""
    by: str | None = None
    """Who verifies; null: unknown."""
    note: str | None = None
    """As it was given."""
    balls: tuple[VerifiedBall, ...] = ()
    """In the order in which they fell."""
    problems: tuple[str, ...] = ()
    """Why it failed or was cancelled, with the remedy."""
    problem_findings: tuple[CodedFinding, ...] = ()
    """What `problems` say, as codes with their parameters; empty if it ended before there were codes."""

    @property
    def measured(self) -> tuple[VerifiedBall, ...]:
        """Return the balls that count: neither rejected nor refused."""
        return tuple(ball for ball in self.balls if ball.equivalent_diameter_mm is not None)

    @computed_field(description="Null before the first ball")  # type: ignore[prop-decorator]  # pydantic asks for this order
    @property
    def summary(self) -> Summary | None:
        """Return the averages, None before the first ball."""
        return summarize(self.measured, self.diameter_mm) if self.measured else None


@request_body
class VerificationRequest:
    """Request for a verification with the next balls."""

    diameter_mm: DiameterMm = 15.0
    """Diameter of the ball, mm."""
    count: Annotated[int, Field(ge=2, le=100, strict=True)] = 5
    """Number of drops to measure."""
    note: Remark | None = None
    """Whatever is to be kept with it."""
    by: Name | None = None
    """Who verifies."""


class Verifications:
    """All verifications. Call it on the event loop, but make it on a thread: that reads their files."""

    def __init__(
        self,
        folder: Path,
        parameters: VerificationParameters,
        on_ended: Callable[[Verification], None] = lambda _: None,
    ) -> None:
        """Read all verifications, and cancel one that was open when the daemon ended.

        `on_ended` is told each that ends, on whichever thread.
        """
        self._folder = folder
        self._known: dict[str, Verification] = {}
        self.parameters = parameters
        self._on_ended = on_ended
        self._writing = asyncio.Lock()
        self._last_ball_s = time.monotonic()
        folder.mkdir(parents=True, exist_ok=True)
        paths = {path.stem: path for path in folder.glob("*.json")}
        for verification in read_numbered("verification", paths, Verification):
            if verification.state is COLLECTING:
                verification = _cancelled(verification, message(Code.DAEMON_RESTARTED))
                write_document(paths[verification.id], verification)
                on_ended(verification)
            self._known[verification.id] = verification

    def use(self, parameters: VerificationParameters) -> None:
        """Judge by other parameters from now on."""
        self.parameters = parameters

    @property
    def current(self) -> Verification | None:
        """Return the verification that waits for balls, None while there is none."""
        return next((each for each in self._known.values() if each.state is COLLECTING), None)

    @property
    def collector(self) -> DropCollector | None:
        """Return the collector of the next ball, None while no verification is open."""
        if (current := self.current) is None:
            return None
        add = partial(self._add, current.id)
        return DropCollector(kind=BundleKind.BALL, diameters_mm=(current.diameter_mm,), add=add)

    def all(self) -> list[Verification]:
        """Return all verifications, newest first."""
        return [self._known[name] for name in sorted(self._known, key=int, reverse=True)]

    def find(self, name: str) -> Verification | None:
        """Return one verification, None when there is none of that name."""
        return self._known.get(name)

    def last(self, calibration_id: str) -> Verification | None:
        """Return the latest verification of this calibration that passed or failed, None without one."""
        found = (each for each in self.all() if each.calibration_id == calibration_id)
        return next((each for each in found if each.state in VERDICTS), None)

    def verified(self, calibration_id: str, now: datetime) -> Verified:
        """Return the result of the last verification of a calibration, or that one is overdue."""
        if (last := self.last(calibration_id)) is None:
            return Verified.NEVER
        if last.state is VerificationState.FAILED:
            return Verified.FAILED
        every = timedelta(hours=self.parameters.every_h)
        return Verified.OVERDUE if every and _age(last, now) > every else Verified.PASSED

    def trouble(self, calibration_id: str, now: datetime) -> CodedText | None:
        """Return the reason to distrust results of this calibration: it failed, or its verification is overdue."""
        last, every = self.last(calibration_id), timedelta(hours=self.parameters.every_h)
        match self.verified(calibration_id, now):
            case Verified.FAILED if last is not None:
                said = "; ".join(last.problems)
                return message(Code.VERIFICATION_FAILED, verification=last.id, reported=said)
            case Verified.OVERDUE if last is not None:
                age = _age(last, now)
                return message(
                    Code.VERIFICATION_OVERDUE,
                    age_h=age / timedelta(hours=1),
                    every_h=every / timedelta(hours=1),
                    reported=f"{_in_words(age)} ago, and one is due every {_in_words(every)}",
                )
            case Verified.NEVER if every:
                return message(Code.VERIFICATION_MISSING)
        return None

    def series(self, diameter_mm: float) -> list[Verification]:
        """Return the verifications with balls of a diameter that have a verdict, oldest first, for a control chart."""
        oldest_first = reversed(self.all())
        return [each for each in oldest_first if each.state in VERDICTS and each.diameter_mm == diameter_mm]

    async def start(self, plan: VerificationRequest, calibration_id: str) -> Verification:
        """Open a verification; the caller makes sure that neither another one nor a calibration is open."""
        name = f"{max(map(int, self._known), default=0) + 1:04d}"
        verification = Verification(
            id=name,
            state=COLLECTING,
            calibration_id=calibration_id,
            created_at=utc_now(),
            changed_at=utc_now(),
            **asdict(plan),
        )
        await self._keep(verification)
        self._last_ball_s = time.monotonic()
        return verification

    async def cancel(self, name: str, reason: str) -> Verification | None:
        """Cancel a verification and return it; one that has ended stays as it is. None when there is none."""
        if (verification := self._known.get(name)) is not None and verification.state is COLLECTING:
            verification = _cancelled(verification, reason)
            await self._keep(verification)
            log.warning("verification cancelled: %s verification=%s", reason, name)
        return verification

    async def void(self, name: str, reason: str) -> Verification | None:
        """Declare a verdict void and return the verification, as it is without a verdict; None when there is none."""
        if (verification := self._known.get(name)) is not None and verification.state in VERDICTS:
            told = message(Code.VERDICT_VOID, reason=reason)
            verification = replace(
                verification,
                state=VerificationState.VOID,
                problems=(*verification.problems, told),
                problem_findings=(*verification.problem_findings, *findings_of(told)),
            )
            await self._keep(verification)
            log.warning("verification void: %s verification=%s", reason, name)
        return verification

    async def cancel_idle(self) -> None:
        """Cancel the open verification when no ball has fallen for `IDLE_S`."""
        if (current := self.current) is not None and time.monotonic() - self._last_ball_s > IDLE_S:
            reason = message(Code.BALLS_MISSING, diameter_mm=current.diameter_mm, idle_min=IDLE_S / 60)
            await self.cancel(current.id, reason)

    async def _add(self, name: str, drop: ObservedDrop, record: Result, outlines: Path | None) -> None:
        verification = self._known[name]
        measured_with_it = record.calibration_id == verification.calibration_id
        if verification.state is not COLLECTING or not measured_with_it:
            return
        diameter_mm, detail = record.equivalent_diameter_mm, record.detail
        findings: tuple[CodedFinding, ...] = ()
        if diameter_mm is not None and (refusal := size_refusal(diameter_mm, verification.diameter_mm)):
            log.warning("verification: %s verification=%s bundle=%s", refusal, name, drop.bundle)
            diameter_mm, detail, findings = None, refusal, findings_of(refusal)
        seen = VerifiedBall(
            bundle=drop.bundle,
            equivalent_diameter_mm=diameter_mm,
            vertical_minus_horizontal_mm=None if diameter_mm is None else drop.vertical_minus_horizontal_mm,
            detail=detail,
            findings=findings,
        )
        verification = replace(verification, balls=(*verification.balls, seen), changed_at=utc_now())
        if diameter_mm is not None:
            self._last_ball_s = time.monotonic()
        if len(verification.measured) == verification.count:
            problems = self.parameters.problems(verification.measured, verification.diameter_mm)
            state = VerificationState.FAILED if problems else VerificationState.PASSED
            verification = replace(
                verification,
                state=state,
                problems=tuple(problems),
                problem_findings=findings_of(joined(problems)),
            )
            level = logging.ERROR if problems else logging.INFO
            log.log(level, "verification %s verification=%s %s", state, name, "; ".join(problems))
        await self._keep(verification)

    async def _keep(self, verification: Verification) -> None:
        self._known[verification.id] = verification
        async with self._writing:  # a ball may arrive during a cancellation
            await asyncio.to_thread(write_document, self._folder / f"{verification.id}.json", verification)
        if verification.state is not COLLECTING:
            self._on_ended(verification)


def _in_words(span: timedelta) -> str:
    """Return a span in the largest unit of which it has two."""
    for unit, name in ((timedelta(hours=1), "hours"), (timedelta(minutes=1), "minutes")):
        if span >= 2 * unit:
            return f"{span / unit:.0f} {name}"
    return f"{span.total_seconds():.0f} seconds"


def _age(verification: Verification, now: datetime) -> timedelta:
    return now - datetime.fromisoformat(verification.changed_at)


def _cancelled(verification: Verification, reason: str) -> Verification:
    return replace(
        verification,
        state=VerificationState.CANCELLED,
        problems=(reason,),
        problem_findings=findings_of(reason),
        changed_at=utc_now(),
    )
