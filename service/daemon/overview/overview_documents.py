"""What an operator's page shows at a glance: the fields of the overview."""

from collections.abc import Mapping
from typing import Any, Literal

from pydantic import BaseModel, Field

from pipeline.frames import CameraId
from pipeline.gradation.estimates import Estimate
from pipeline.gradation.specification import Decision, Verdict
from service.base.messages import CodedFinding
from service.base.schema import OptionalTime, Time
from service.base.status import DeviceState, Ne107
from service.health.alarms.alarm import AlarmState
from service.health.alarms.rules import Priority
from service.lots.lots import ClosedLot
from service.lots.trends.trend import PassingEnd
from service.results.fields import Outcome, Verified


class OverviewAcquisition(BaseModel):
    """State of the rig, in short."""

    state: str = Field(description="As of `/acquisition`: `disarmed`, `arming`, `armed`, `held` ...")
    trouble: str | None = Field(description="Why it is held; null when it is not")
    activity: str = Field(description="`idle`, `measuring`, or `suspended`: armed, and no stone for a minute")


class OverviewLot(BaseModel):
    """The open lot, in short."""

    lot: str = Field(description="Material lot")
    product: str = Field(description="Id of its product")
    title: str = Field(description="Name of the product for people")
    opened_at: Time = Field(description="When it was opened, RFC 3339 UTC")
    n_stones: int = Field(description="Stones that fell, whatever became of them")


class OverviewDecision(BaseModel):
    """The verdict on one figure of the specification."""

    sieve_mm: float | None = Field(description="Sieve whose passing is judged, mm; null: an index is")
    index: Literal["FI", "SI"] | None = Field(
        description="Flakiness index (EN 933-3) or shape index (EN 933-4); null: a sieve is judged"
    )
    percent: Estimate = Field(description="Passing by mass, or the index, %")
    decision: Decision = Field(description="The verdict, and what would decide it")


class OverviewPassing(BaseModel):
    """Passing at the sieve of d or D of the product."""

    end: PassingEnd = Field(description="`lower`: d; `upper`: D")
    sieve_mm: float = Field(description="The sieve nearest to it, mm")
    percent: Estimate = Field(description="Passing by mass, %")


class OverviewFigures(BaseModel):
    """The main figures of the open lot, else of the last hour."""

    lot: str | None = Field(description="Lot that they are of; null: of the last hour")
    verdict: Verdict | None = Field(description="Null without a specification")
    is_partial: bool = Field(description="True when some figures of the specification were not measured")
    passing: list[OverviewPassing] = Field(
        description="Passing at the sieves of d and D of the lot's product; empty without these"
    )
    countdown: str | None = Field(description="What is decided and what is not, in words")
    decisions: list[OverviewDecision] = Field(
        description="The same figure by figure: sieves from the coarsest, then the indices"
    )
    d50_mm: Estimate = Field(
        description="Size that half of the mass is smaller than, from the stones themselves, mm"
    )
    flakiness_percent: Estimate = Field(description="FI, EN 933-3")
    shape_percent: Estimate = Field(description="SI, EN 933-4")
    measured: int = Field(description="Stones with a body and its measures")
    n_effective: float = Field(
        description="Effective sample size: number of equal-mass stones with the same sampling error"
    )
    version: str = Field(description="Changes whenever the curve, its intervals or its verdicts do")


class OverviewCounts(BaseModel):
    """`triggers = measured + rejected + lost + in_progress`."""

    triggers: int = Field(description="Stones and balls that the light gate reported")
    measured: int = Field(description="Triggers whose stone has a body and its measures")
    rejected: int = Field(description="Triggers whose views were looked at and found unfit")
    lost: int = Field(description="Triggers whose views were never looked at")
    in_progress: int = Field(description="Triggers without an outcome yet")


class OverviewQueue(BaseModel):
    """Bundles that wait for a worker."""

    waiting: int = Field(description="How many wait")
    max: int = Field(description="How many may wait; what comes then is lost")


class OverviewLatency(BaseModel):
    """From the light gate's trigger to the durable outcome."""

    median_ms: float = Field(description="Median of the latest 100 outcomes, ms")
    p99_ms: float = Field(description="99th percentile of the same, ms")


class OverviewVerification(BaseModel):
    """What the last balls said of the calibration."""

    verdict: Verified = Field(description="`passed`, `failed`, `overdue` or `never`")
    age_h: float | None = Field(description="Hours since the last verdict; null without one")


class OverviewAlarm(BaseModel):
    """An alarm, in short; `/alarms` says what to do."""

    id: int = Field(description="Number of the alarm")
    subject: str = Field(description="Its check, such as `gate` or `camera:c01`")
    priority: Priority = Field(description="The highest since it was raised")
    state: AlarmState = Field(description="In the words of ISA-18.2")
    detail: str | None = Field(description="What the check says")
    findings: list[CodedFinding] = Field(description="The same, as codes with their parameters")


class OverviewAlarms(BaseModel):
    """The alarms that are announced: neither shelved, nor suppressed, nor ended."""

    unacknowledged: int = Field(description="Not acknowledged, their cause still there")
    acknowledged: int = Field(description="Acknowledged, their cause still there")
    returned: int = Field(description="Their cause is gone, and they were not acknowledged")
    urgent: int = Field(description="How many of all of these are urgent")
    items: list[OverviewAlarm] = Field(description="The most urgent first, 20 at most")


class OverviewCamera(BaseModel):
    """State of one camera, in short."""

    id: CameraId = Field(description="Place of the camera in the rig, such as `c01`")
    state: DeviceState = Field(description="Whether it exposes, is closed, or does not answer")
    azimuth_deg: float = Field(
        description="Direction from the rig's centre to it, about the vertical, 0..360"
    )
    elevation_deg: float = Field(description="The same, above the horizontal")
    ne107: Ne107 = Field(description="Its state in the terms of NAMUR NE 107")
    brightness: float | None = Field(description="Light on the wall beside the stone, 1: as in the clean rig")
    dust: float | None = Field(description="Share of the light lost in patches, 0..1")
    edge_width_px: float | None = Field(description="Width of outlines from 10 to 90 %, px")
    lost: int = Field(description="Frames reported lost since the daemon started")
    temperature_c: float | None = Field(
        description="Temperature of the camera, °C; null when it reports none"
    )
    last_frame_age_s: float | None = Field(description="Seconds since the last frame; null before it")
    warnings: list[str] = Field(description="What works but needs attention, with the remedy")
    findings: list[CodedFinding] = Field(description="The same, as codes with their parameters")


class OverviewStone(BaseModel):
    """One of the newest stones, in short."""

    seq: int = Field(description="`seq` of its newest revision")
    id: str = Field(description="Of the stone, as in `/particles/{id}`")
    outcome: Outcome = Field(description="`measured`, `rejected` or `lost`")
    reason: str | None = Field(description="Why rejected or lost, one word; null when measured")
    quality: str | None = Field(description="`good`, `reduced` or `degraded`; null unless measured")
    sieve_size_mm: float | None = Field(description="Smallest square aperture that it passes, mm")
    zingg_class: str | None = Field(description="Zingg's form: `equant`, `disc`, `rod` or `blade`")
    captured_at: OptionalTime = Field(description="When the stone was exposed, RFC 3339 UTC")
    has_mesh: bool = Field(description="Whether there is a mesh, and so a picture of it")


class OverviewDocument(BaseModel):
    """Everything that an operator's page shows at a glance, at one moment; made once for all who look."""

    at: Time = Field(description="The moment, RFC 3339 UTC")
    instance_id: str = Field(description="Identity of the history of results, as in `/results`")
    rig: str | None = Field(
        description="Plant, line and serial number of `[plant]`; null where none is given"
    )
    is_simulated: bool = Field(description="True when the images of this run of the daemon are synthetic")
    is_replay: bool = Field(description="True when no stone falls: a recording is played, or simulated")
    acquisition: OverviewAcquisition = Field(description="State of the rig")
    ne107: Ne107 = Field(description="Device state in the terms of NAMUR NE 107")
    gate_ne107: Ne107 = Field(description="The light gate alone")
    rig_ne107: Ne107 = Field(description="Geometry and optics of the rig: is all as it was calibrated")
    ready: bool = Field(description="Whether the next stone will be measured")
    reasons: list[str] = Field(description="Why it is not ready, or not `good`; empty when it is both")
    findings: list[CodedFinding] = Field(
        description="Why it is held, and what the reasons say, as codes with their parameters"
    )
    lot: OverviewLot | None = Field(description="The open lot; null when none is open")
    last_lot: ClosedLot | None = Field(
        description="The lot of those closed, and not void, that was closed last; null: none yet"
    )
    figures: OverviewFigures | None = Field(
        description="Renewed every 5 s at most; null before the first time, and while nothing was measured"
    )
    stones_per_min: int = Field(
        description="Stones that fell within the last minute, whatever became of them"
    )
    accounting: OverviewCounts = Field(description="Since the beginning of the history, as `/accounting`")
    today: OverviewCounts = Field(description="The same since midnight, of the host's local time")
    queue: OverviewQueue = Field(description="Bundles that wait for a worker")
    latency: OverviewLatency | None = Field(
        description="From trigger to durable outcome; null before the first outcome of this run, and in replay"
    )
    disk_days: float | None = Field(description="Days until the disk is full; null while that is unknown")
    verification: OverviewVerification = Field(description="What the last balls said of the calibration")
    calibration_id: str = Field(description="Calibration that stones are measured with now")
    alarms: OverviewAlarms = Field(description="Alarms that need an operator now")
    cameras: list[OverviewCamera] = Field(description="By place in the rig")
    newest: list[OverviewStone] = Field(description="The newest stones, the newest first, 12 at most")
    last_seq: int = Field(description="`seq` of the newest result; 0 before the first")
    last_event: int = Field(description="`seq` of the newest event; 0 before the first")


PASSING: Mapping[str, Any] = {
    "at": True,
    "verification": {"age_h": True},
    "cameras": {"__all__": {"last_frame_age_s": True, "temperature_c": True}},
}
"""Fields that time alone changes: they make no new overview."""
