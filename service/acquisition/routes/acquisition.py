"""Arm and disarm the rig."""

from fastapi import APIRouter
from pydantic import BaseModel, ConfigDict, Field

from service.base.status import AcquisitionStatus, AcquisitionTarget
from service.web.auth import OPERABLE, READABLE, Who
from service.web.context import Context
from service.web.problems import problem_responses

router = APIRouter(prefix="/acquisition", tags=["acquisition"])


class AcquisitionAnswer(AcquisitionStatus):
    """State of the rig; counters begin when it is armed."""


class AcquisitionRequest(BaseModel):
    """Request for a state of the rig."""

    model_config = ConfigDict(extra="forbid")

    state: AcquisitionTarget = Field(description="`armed`: measure every stone; `disarmed`: ignore them")


@router.get("", response_model=AcquisitionAnswer, dependencies=READABLE)
async def acquisition(context: Context) -> AcquisitionStatus:
    """Get the state of the rig: are stones being measured, and if not, why."""
    return context.control.acquisition_status()


@router.put("", response_model=AcquisitionAnswer, dependencies=OPERABLE, responses=problem_responses(409))
async def set_acquisition(context: Context, wanted: AcquisitionRequest, asking: Who) -> AcquisitionStatus:
    """Arm or disarm the rig. Repeating a request changes nothing; 409 when the current state forbids it."""
    before = context.control.acquisition_status().state
    state = await context.control.set_acquisition(wanted.state)
    await context.store.note_change(
        asking, f"acquisition {wanted.state}", "rig", before={"state": before}, after={"state": state}
    )
    return context.control.acquisition_status()
