"""Pin results: they and their files are kept at any age."""

import sqlite3

from fastapi import APIRouter
from fastapi.responses import Response
from pydantic import BaseModel, ConfigDict, Field

from service.particles.routes.particles import ParticleKey, find_record, record_response, record_tag
from service.results.fields import Result
from service.store.particle_files import first_seq
from service.store.reads import particle as stored_particle
from service.store.retention import pin
from service.web.auth import OPERABLE, Who
from service.web.context import Context
from service.web.etags import IfMatch, change_if_match
from service.web.problems import existing, problem_responses

router = APIRouter(prefix="/particles", tags=["particles"])


class Pin(BaseModel):
    """Whether a result is pinned, and why."""

    model_config = ConfigDict(extra="forbid")

    is_pinned: bool = Field(
        description="True: keep result and files whatever their age; false: no longer", strict=True
    )
    reason: str = Field(default="", max_length=300, description="For people: why it must be kept")


@router.put(
    "/{particle_id}/pin", response_model=Result, dependencies=OPERABLE, responses=problem_responses(404)
)
async def pin_particle(
    context: Context, particle_id: ParticleKey, wanted: Pin, asking: Who, if_match: IfMatch = None
) -> Response:
    """Pin or unpin a result, and return it. What was removed before does not come back."""
    seq = first_seq((await find_record(context, particle_id))["id"])
    context.store.require_writable()

    def version(connection: sqlite3.Connection) -> str:
        key = int(particle_id) if particle_id.isdecimal() else particle_id
        return record_tag(existing(stored_particle(connection, key), "particle", particle_id))

    reason = wanted.reason if wanted.is_pinned else None
    await context.store.write(change_if_match, if_match, version, pin, seq, reason, asking)
    return record_response(await find_record(context, particle_id))
