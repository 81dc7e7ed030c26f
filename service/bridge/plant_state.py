"""The plant at one moment, as the daemon tells it: what all outlets show."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from pydantic import TypeAdapter, ValidationError

from pipeline.gradation.estimates import Estimate
from pipeline.gradation.specification import Verdict
from service.base.status import Ne107


@dataclass(frozen=True, slots=True, kw_only=True)
class PlantAlarm:
    """An alarm that needs an operator: its cause is there, or it was not acknowledged."""

    id: int
    """Number of the alarm, by which it is acknowledged"""
    check: str
    """Its check of `/health`, such as `gate` or `camera:c01`"""
    priority: str
    """`urgent`, `high`, `medium` or `low`"""
    state: str
    """`unacknowledged`, `acknowledged` or `returned`: its cause is gone, and it was not acknowledged"""
    detail: str | None
    """Finding of the check, in English"""
    raised_at: str
    """RFC 3339 UTC"""
    acknowledged_by: str | None
    """Name of the key that acknowledged it"""
    cause: str
    """Causes of such an alarm, in English"""
    action: str
    """Remedy, in English"""


@dataclass(frozen=True, slots=True, kw_only=True)
class PlantState:
    """The plant at one moment. While the daemon does not answer it is as `PlantState()`: nothing old is shown as good.

    The words are those of `GET /overview` and `GET /alarms`; what is None is unknown, or there is none of it.
    """

    daemon_answers: bool = False
    trouble: str | None = "not asked yet"
    """Why it does not answer: no connection, a wrong key; None when it does"""
    at: str | None = None
    """The moment, RFC 3339 UTC, by the daemon's clock"""
    instance_id: str | None = None
    """Identity of the history of results"""
    rig: str | None = None
    """Plant, line and serial number, as configured at the daemon"""
    is_simulated: bool = False
    """True when the images are synthetic"""
    is_replay: bool = False
    """True when no stone falls: a recording is played, or simulated"""
    calibration_id: str | None = None

    ready: bool = False
    """True when the next stone will be measured"""
    ne107: Ne107 | None = None
    """The device in the terms of NAMUR NE 107"""
    components: Mapping[str, Ne107] = field(default_factory=dict)
    """The same of its parts: `gate`, `rig` (geometry and optics), and each camera, such as `c01`"""
    reasons: tuple[str, ...] = ()
    """Why it is not ready, or not `good`"""
    acquisition: str | None = None
    """`disarmed`, `arming`, `armed`, `held` ..."""
    activity: str | None = None
    """`idle`, `measuring`, or `suspended`: armed, and no stone for a minute"""
    alarms: tuple[PlantAlarm, ...] = ()
    """The most urgent first"""

    lot: str | None = None
    """The open lot"""
    product: str | None = None
    product_title: str | None = None
    opened_at: str | None = None
    n_stones: int | None = None
    """Stones that fell in the open lot, whatever became of them"""
    verdict: Verdict | None = None
    """On the open lot, so far; None without one, without a specification, or before the first figures"""
    is_partial: bool = False
    """True when some figures of the specification were not measured"""
    d50_mm: Estimate | None = None
    """Size that half of the mass is smaller than, mm, of the open lot, else of the last hour; renewed every 5 s"""
    flakiness_percent: Estimate | None = None
    """FI, EN 933-3, % of the same"""
    shape_percent: Estimate | None = None
    """SI, EN 933-4, % of the same"""
    last_lot: str | None = None
    """The lot that was closed last, and is not void"""
    last_verdict: Verdict | None = None
    """Its final verdict; None until its figures are final, and without a specification"""

    stones_per_min: int | None = None
    triggers: int | None = None
    """Stones since the beginning of the history, as `measured`, `rejected` and `lost`, and those in progress"""
    measured: int | None = None
    rejected: int | None = None
    lost: int | None = None
    last_seq: int | None = None
    """`seq` of the newest result"""
    last_event: int | None = None
    """`seq` of the newest event"""


STATE, ALARMS = TypeAdapter(PlantState), TypeAdapter(tuple[PlantAlarm, ...])


def state_of(overview: Mapping[str, Any], alarms: tuple[PlantAlarm, ...]) -> PlantState:
    """Return the state that an overview tells; raise `ValueError` if it is not understood."""
    try:
        lot, last, figures = (overview[name] or {} for name in ("lot", "last_lot", "figures"))
        if figures.get("lot") != lot.get("lot"):  # those of a lot that has just been opened are not made yet
            figures = {}
        parts = {"gate": overview["gate_ne107"], "rig": overview["rig_ne107"]}
        told = {
            **overview,
            **figures,
            **overview["accounting"],
            "daemon_answers": True,
            "trouble": None,
            "components": parts | {camera["id"]: camera["ne107"] for camera in overview["cameras"]},
            "acquisition": overview["acquisition"]["state"],
            "activity": overview["acquisition"]["activity"],
            "alarms": alarms,
            "lot": lot.get("lot"),
            "product": lot.get("product"),
            "product_title": lot.get("title"),
            "opened_at": lot.get("opened_at"),
            "n_stones": lot.get("n_stones"),
            "verdict": figures.get("verdict") if lot else None,
            "last_lot": last.get("lot"),
            "last_verdict": (last.get("completion") or {}).get("verdict"),
        }
        return STATE.validate_python(told)
    except (AttributeError, KeyError, TypeError, ValidationError) as err:
        raise ValueError(f"the overview is not understood: {err!r}") from err


def alarms_of(document: Mapping[str, Any]) -> tuple[PlantAlarm, ...]:
    """Return the alarms of `GET /alarms`; raise `ValueError` if they are not understood."""
    try:
        return ALARMS.validate_python(document.get("items"))
    except ValidationError as err:
        raise ValueError(f"the alarms are not understood: {err.errors()[0]}") from err
