"""Results as a list with filters, and one by one; those that are pinned are kept at any age."""

import sqlite3
from typing import Annotated

from fastapi import APIRouter, Path, Query, Request
from fastapi.responses import JSONResponse, Response
from pydantic import BaseModel, Field

from service.base.schema import RequestBody
from service.particles.pages import particles_page
from service.particles.routes.results import ChosenFields
from service.results.fields import Result, completed
from service.store import ParticleFilter, Record, reads
from service.store.particle_files import first_seq
from service.store.retention import pin
from service.web.auth import OPERABLE, READABLE, Who
from service.web.context import ApiContext, Context
from service.web.etags import NOT_MODIFIED, IfMatch, change_if_match, etag, unchanged
from service.web.feeds import MAX_SEQ, MAX_SMALL
from service.web.gzipped import TakesGzip
from service.web.problems import existing, problem_responses
from service.web.version import API_VERSION

router = APIRouter(prefix="/particles", tags=["particles"], dependencies=READABLE)
pins = APIRouter(prefix="/particles", tags=["particles"], dependencies=OPERABLE)
"""What needs another scope than `read`."""

ParticleKey = Annotated[
    str,
    Path(
        pattern=r"^([0-9a-f]{8}-)?[0-9]{1,15}$",
        description="`id` of a result, for its newest revision, or the `seq` of a first or later one",
    ),
]
CHANGING = ("lot", "files_removed", "is_pinned", "pin_reason")
"""Fields of a result that change after it became durable."""


class ParticlesQuery(ParticleFilter):
    """Filters of a list of results, and its page."""

    cursor: Annotated[
        str | None, Field(pattern=r"^[0-9]{1,15}$", description="`next_cursor` of the page before")
    ] = None
    limit: Annotated[int, Field(ge=1, le=1000, description="Results of a page, at most")] = 100


class ParticlesPage(BaseModel):
    """Results that pass the filters, newest first."""

    items: list[Result] = Field(description="Newest first")
    next_cursor: str | None = Field(description="Pass as `cursor` for the next page; null on the last")


class Pin(RequestBody):
    """Whether a result is pinned, and why."""

    is_pinned: bool = Field(
        description="True: keep result and files whatever their age; false: no longer", strict=True
    )
    reason: str = Field(default="", max_length=300, description="For people: why it must be kept")


@router.get("", response_model=ParticlesPage)
async def particles(
    context: Context, names: ChosenFields, as_gzip: TakesGzip, query: Annotated[ParticlesQuery, Query()]
) -> Response:
    """List the results that pass all filters, newest first, each in its newest revision.

    To follow production use the feed, `/results`.
    """
    before_seq = MAX_SEQ if query.cursor is None else int(query.cursor)
    asked = (query, before_seq, query.limit, names, as_gzip)
    if query.limit > MAX_SMALL:
        page = await context.read_beside(particles_page, *asked)
    else:
        page = await context.store.read(particles_page, *asked)
    return Response(page, media_type="application/json")


@router.get("/{particle_id}", response_model=Result, responses=NOT_MODIFIED)
async def particle(context: Context, request: Request, particle_id: ParticleKey) -> Response:
    """Get a result; its `ETag` changes with its revision, its lot, its pin and the removal of its files."""
    record = await find_record(context, particle_id)
    return unchanged(request, record_tag(record)) or record_response(record)


def record_tag(record: Record) -> str:
    """Return the version of a result: a record never changes, but for its revisions and what happens to it later."""
    return etag(API_VERSION, record["id"], record.get("revision", 1), [record[name] for name in CHANGING])


def record_response(record: Record) -> JSONResponse:
    """Return the answer with a result and its version."""
    return JSONResponse(completed(record), headers={"ETag": record_tag(record)})


async def find_record(context: ApiContext, key: str) -> Record:
    """Return the record with this `id` or `seq`; raise the problem 404 where there is none."""
    record = await context.store.read(reads.particle, int(key) if key.isdecimal() else key)
    return existing(record, "particle", key)


@pins.put("/{particle_id}/pin", response_model=Result, responses=problem_responses(404))
async def pin_particle(
    context: Context, particle_id: ParticleKey, wanted: Pin, asking: Who, if_match: IfMatch = None
) -> Response:
    """Pin or unpin a result, and return it. What was removed before does not come back."""
    seq = first_seq((await find_record(context, particle_id))["id"])

    def version(connection: sqlite3.Connection) -> str:
        key = int(particle_id) if particle_id.isdecimal() else particle_id
        return record_tag(existing(reads.particle(connection, key), "particle", particle_id))

    reason = wanted.reason if wanted.is_pinned else None
    await context.write(change_if_match, if_match, version, pin, seq, reason, asking)
    return record_response(await find_record(context, particle_id))
