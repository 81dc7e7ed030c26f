"""Whether the process is alive, whether it can accept stones, and how it is."""

from typing import Any

from fastapi import APIRouter, Depends

from service.api.auth import require
from service.api.context import Context
from service.api.problems import Problem, documented
from service.api.schemas import HealthDocument, Live, Ready
from service.api.settings import Scope
from service.api.version import API_VERSION
from service.status import CheckStatus, Ne107

router = APIRouter(prefix="/health", tags=["health"])

STATUS = {Ne107.GOOD: CheckStatus.PASS, Ne107.FAILURE: CheckStatus.FAIL}


@router.get("/live", response_model=Live, responses=documented())
async def live() -> Live:
    """Answer, as long as the process does; asks nothing of any other part and needs no key."""
    return Live()


@router.get("/ready", response_model=Ready, responses=documented(503))
async def ready(context: Context) -> Ready:
    """Answer 200 when stones can be accepted, otherwise 503 with the reasons. Needs no key."""
    health = context.control.health()
    if not health.ready:
        detail = "; ".join(health.reasons) or "no reason given"
        raise Problem(
            503,
            "not-ready",
            detail,
            headers={"Retry-After": "5"},
            reasons=list(health.reasons),
            retry_after_s=5,
        )
    return Ready()


@router.get(
    "", response_model=HealthDocument, dependencies=[Depends(require(Scope.READ))], responses=documented()
)
async def health(context: Context) -> dict[str, Any]:
    """Look at cameras, gate, progress, queue, workers, background, calibration, store and disk; always 200."""
    state = context.control.health()
    return {
        "status": STATUS.get(state.ne107, CheckStatus.WARN),
        "ne107": state.ne107,
        "ready": state.ready,
        "reasons": state.reasons,
        "version": API_VERSION,
        "instance_id": context.store.instance_id,
        "checks": state.checks,
    }
