"""Pin results: they and their files are kept whatever their age."""

from fastapi import APIRouter, Depends
from fastapi.responses import JSONResponse
from pydantic import BaseModel, ConfigDict, Field

from service.api.auth import Who, require
from service.api.context import Context
from service.api.problems import problem_responses
from service.api.routes.particles import ParticleKey, find_record
from service.api.settings import Scope
from service.results.fields import Result, completed
from service.store.holds import pin

router = APIRouter(prefix="/particles", tags=["particles"])


class Pin(BaseModel):
    """Whether a result is pinned, and why."""

    model_config = ConfigDict(extra="forbid")

    is_pinned: bool = Field(
        description="True: keep result and files whatever their age; false: no longer", strict=True
    )
    reason: str = Field(default="", max_length=300, description="For people: why it must be kept")


@router.put(
    "/{particle_id}/pin",
    response_model=Result,
    dependencies=[Depends(require(Scope.OPERATE))],
    responses=problem_responses(404),
)
async def pin_particle(context: Context, particle_id: ParticleKey, wanted: Pin, asking: Who) -> JSONResponse:
    """Pin a result, or no longer, and return it. What was removed before does not come back."""
    record = await find_record(context, particle_id)
    context.store.require_writable()
    await context.store.write(pin, record["seq"], wanted.reason if wanted.is_pinned else None, asking)
    return JSONResponse(completed(await find_record(context, particle_id)))
