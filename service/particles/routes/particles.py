"""Results as a list with filters, and one by one."""

from typing import Annotated, Literal

from fastapi import APIRouter, Path, Query, Request
from fastapi.responses import JSONResponse, Response
from pydantic import BaseModel, Field

from pipeline.measuring.shape import ZinggClass
from service.base.schema import GivenTime
from service.particles.pages import particles_page
from service.particles.routes.results import ChosenFields
from service.results.fields import QualityCause, Result, completed
from service.store import ParticleFilter, Record, read, reads
from service.web.auth import READABLE
from service.web.context import ApiContext, Context
from service.web.etags import NOT_MODIFIED, etag, unchanged
from service.web.feeds import MAX_SEQ, MAX_SMALL
from service.web.gzipped import TakesGzip
from service.web.problems import existing
from service.web.version import API_VERSION

router = APIRouter(prefix="/particles", tags=["particles"], dependencies=READABLE)

ParticleKey = Annotated[
    str,
    Path(
        pattern=r"^([0-9a-f]{8}-)?[0-9]{1,15}$",
        description="`id` of a result, for its newest revision, or the `seq` of a first or later one",
    ),
]
CHANGING = ("lot", "files_removed", "is_pinned", "pin_reason")
"""Fields of a result that change after it became durable."""
SdPercent = Annotated[
    float | None,
    Field(ge=0, allow_inf_nan=False, description="Standard deviation of the volume, %; inclusive"),
]
SizeMm = Annotated[float | None, Field(ge=0, allow_inf_nan=False, description="Sieve size, mm; inclusive")]


class ParticlesQuery(BaseModel):
    """Filters of a list of results, and its page."""

    outcome: Annotated[
        Literal["measured", "rejected", "lost"] | None, Field(description="Only with this outcome")
    ] = None
    quality: Annotated[
        Literal["good", "reduced", "degraded"] | None, Field(description="Only of this quality")
    ] = None
    kind: Annotated[Literal["particle", "ball"] | None, Field(description="Only of this kind")] = None
    min_sieve_size_mm: SizeMm = None
    max_sieve_size_mm: SizeMm = None
    since: Annotated[GivenTime | None, Field(description="Captured at or after, RFC 3339")] = None
    until: Annotated[GivenTime | None, Field(description="Captured before, RFC 3339")] = None
    lot: Annotated[str | None, Field(max_length=64, description="In this lot now")] = None
    has_frames: Annotated[
        bool | None,
        Field(
            description="True: only stones that are new enough to have their raw frames, by `[store] keep_raw`, or"
            " pinned; false: only others"
        ),
    ] = None
    zingg_class: Annotated[ZinggClass | None, Field(description="Only of this form")] = None
    is_flaky: Annotated[
        bool | None,
        Field(description="Whether it passes the slot of its fraction (EN 933-3); from 4 to 100 mm"),
    ] = None
    is_non_cubical: Annotated[
        bool | None,
        Field(description="Whether it is longer than three times its thickness (EN 933-4); from 4 to 63 mm"),
    ] = None
    min_volume_sd_percent: SdPercent = None
    max_volume_sd_percent: SdPercent = None
    quality_cause: Annotated[
        QualityCause | None, Field(description="Only with this among the causes of its quality")
    ] = None
    algorithm_version: Annotated[
        str | None, Field(max_length=16, description="Only measured by this version of the algorithm")
    ] = None
    body: Annotated[Literal["photo", "estimate", "hull"] | None, Field(description="Only with this body")] = (
        None
    )
    cursor: Annotated[
        str | None, Field(pattern=r"^[0-9]{1,15}$", description="`next_cursor` of the page before")
    ] = None
    limit: Annotated[int, Field(ge=1, le=1000, description="Results of a page, at most")] = 100


class ParticlesPage(BaseModel):
    """Results that pass the filters, newest first."""

    items: list[Result] = Field(description="Newest first")
    next_cursor: str | None = Field(description="Pass as `cursor` for the next page; null on the last")


@router.get("", response_model=ParticlesPage)
async def particles(
    context: Context,
    names: ChosenFields,
    as_gzip: TakesGzip,
    query: Annotated[ParticlesQuery, Query()],
) -> Response:
    """List the results that pass all filters, newest first, each in its newest revision.

    To follow production use the feed, `/results`.
    """
    wanted = ParticleFilter(**query.model_dump(exclude={"cursor", "limit"}))
    before_seq = MAX_SEQ if query.cursor is None else int(query.cursor)
    asked = (wanted, before_seq, query.limit, names, as_gzip)
    if query.limit > MAX_SMALL:
        page = await context.reading.run(read, context.store.path, particles_page, *asked)
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
