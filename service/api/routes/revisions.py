"""Measure a stone again from its archived frames; its result gets a revision."""

from http import HTTPStatus

from fastapi import APIRouter, Depends
from pydantic import BaseModel, Field

from service.api.auth import Who, require
from service.api.context import Context
from service.api.problems import Problem, problem_responses
from service.api.routes.particles import ParticleKey, find_record
from service.api.settings import Scope
from service.remeasuring.remeasuring import Hindrance, RemeasureError
from service.results.fields import Result, completed

router = APIRouter(prefix="/particles", tags=["particles"])

STATUS = {Hindrance.NO_FRAMES: HTTPStatus.NOT_FOUND}
"""Status of a hindrance; without one 409."""


class Remeasured(BaseModel):
    """What came of measuring a stone again."""

    is_new: bool = Field(
        description="False: the newest result is of today's algorithm already; nothing was done"
    )
    result: Result = Field(description="The newest result")


@router.post(
    "/{particle_id}/revisions",
    response_model=Remeasured,
    dependencies=[Depends(require(Scope.OPERATE))],
    responses=problem_responses(404, 409),
)
async def remeasure_particle(context: Context, particle_id: ParticleKey, asking: Who) -> Remeasured:
    """Measure a stone again, from its archived frames, with the calibration of its result and today's algorithm.

    The answer comes when the revision is durable: a moment later or, while stones fall, some seconds. 404 `not-kept`:
    it has no frames any more. 409: `calibration-gone`, `no-background` (the empty rig was not exposed yet) or
    `not-measured`, with the reason; its result stays as it is.
    """
    name = (await find_record(context, particle_id))["id"]
    context.store.require_writable()
    try:
        is_new = await context.control.remeasuring.measure(name, asking)
    except RemeasureError as err:
        raise Problem(STATUS.get(err.why, HTTPStatus.CONFLICT), err.why, str(err)) from err
    return Remeasured(is_new=is_new, result=Result(**completed(await find_record(context, name))))
