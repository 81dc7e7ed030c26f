"""Liveness, readiness for stones, and every check in detail."""

from dataclasses import fields
from importlib.metadata import version
from typing import Any, Literal

from fastapi import APIRouter
from pydantic import BaseModel, Field

from service.base.status import CheckStatus, HealthCheck, Ne107
from service.results.version import ALGORITHM_VERSION
from service.web.auth import READABLE
from service.web.context import Context
from service.web.problems import Problem
from service.web.version import API_VERSION

router = APIRouter(prefix="/health", tags=["health"])

OVERALL_STATUS = {Ne107.GOOD: CheckStatus.PASS, Ne107.FAILURE: CheckStatus.FAIL}
"""Status of the whole device; a warning in all other states."""


class HealthDocument(BaseModel):
    """Health in detail, modelled on the expired Internet draft health+json."""

    status: CheckStatus = Field(
        description="In the words of health+json: `pass` for NE 107 good, `fail` for failure, else `warn`"
    )
    ne107: Ne107 = Field(description="Device state in the terms of NAMUR NE 107")
    gate_ne107: Ne107 = Field(description="The light gate alone; each camera has its own in `/cameras`")
    rig_ne107: Ne107 = Field(description="Geometry and optics of the rig: is all as it was calibrated")
    ready: bool = Field(description="Whether the next stone will be measured")
    reasons: list[str] = Field(description="Why it is not ready, or not `good`; empty when it is both")
    version: str = Field(description="As `api_version`, which says of what")
    release: str = Field(description="Version of the installed package")
    api_version: str = Field(description="Version of this interface, by semver")
    algorithm_version: str = Field(
        description="Version of the algorithm, as new results name it; raised whenever results may change"
    )
    instance_id: str = Field(description="Identity of the history of results, as in `/results`")
    checks: dict[str, HealthCheck] = Field(
        description="By name, such as `gate`, `cameras`, `camera:c01`, `calibration`, `disk`"
    )


class Live(BaseModel):
    """The process answers."""

    status: Literal["pass"] = Field(default="pass", description="Always `pass`: the process answers")


class Ready(BaseModel):
    """Stones can be measured."""

    ready: bool = Field(
        default=True, description="Always true; otherwise the answer is the problem `not-ready`"
    )


@router.get("/live", response_model=Live)
async def live() -> Live:
    """Check that the process answers; asks no other part and needs no key."""
    return Live()


@router.get("/ready", response_model=Ready)
async def ready(context: Context) -> Ready:
    """Check that stones can be measured: 200, otherwise 503 with the reasons. Needs no key."""
    health = context.control.health()
    if not health.ready:
        detail = "; ".join(health.reasons) or "no reason given"
        raise Problem(503, "not-ready", detail, reasons=list(health.reasons))
    return Ready()


@router.get("", response_model=HealthDocument, dependencies=READABLE)
async def health(context: Context) -> dict[str, Any]:
    """Get the health: every check of cameras, gate, queue, workers, calibration, store, disk and more; always 200."""
    state = context.control.health()
    return {
        **{each.name: getattr(state, each.name) for each in fields(state)},
        "status": OVERALL_STATUS.get(state.ne107, CheckStatus.WARN),
        "version": API_VERSION,
        "release": version("stonefall"),
        "api_version": API_VERSION,
        "algorithm_version": ALGORITHM_VERSION,
        "instance_id": context.store.instance_id,
    }
