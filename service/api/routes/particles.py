"""Results as a list with filters, and one by one."""

from typing import Annotated, Literal

from fastapi import APIRouter, Path, Query, Request
from fastapi.responses import JSONResponse, Response
from pydantic import BaseModel, Field

from pipeline.measuring.shape import ZinggClass
from service.api.context import ApiContext, Context
from service.api.etags import NOT_MODIFIED, etag, unchanged
from service.api.feeds import MAX_SEQ, MAX_SMALL
from service.api.gzipped import TakesGzip
from service.api.pages import particles_page
from service.api.problems import existing, problem_responses
from service.api.routes.results import ChosenFields
from service.api.version import API_VERSION
from service.base.schema import GivenTime
from service.results.fields import QualityCause, Result, completed
from service.store import ParticleFilter, Record, read

router = APIRouter(prefix="/particles", tags=["particles"])

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
    Query(ge=0, allow_inf_nan=False, description="Standard deviation of the volume, %; inclusive"),
]
SizeMm = Annotated[float | None, Query(ge=0, allow_inf_nan=False, description="Sieve size, mm; inclusive")]


class ParticlesPage(BaseModel):
    """Results that pass the filters, newest first."""

    items: list[Result] = Field(description="Newest first")
    next_cursor: str | None = Field(description="Pass as `cursor` for the next page; null on the last")


@router.get("", response_model=ParticlesPage)
async def particles(
    context: Context,
    names: ChosenFields,
    as_gzip: TakesGzip,
    outcome: Annotated[
        Literal["measured", "rejected", "lost"] | None, Query(description="Only with this outcome")
    ] = None,
    quality: Annotated[
        Literal["good", "reduced", "degraded"] | None, Query(description="Only of this quality")
    ] = None,
    kind: Annotated[Literal["particle", "ball"] | None, Query(description="Only of this kind")] = None,
    min_sieve_size_mm: SizeMm = None,
    max_sieve_size_mm: SizeMm = None,
    since: Annotated[GivenTime | None, Query(description="Captured at or after, RFC 3339")] = None,
    until: Annotated[GivenTime | None, Query(description="Captured before, RFC 3339")] = None,
    lot: Annotated[str | None, Query(max_length=64, description="In this lot now")] = None,
    has_frames: Annotated[
        bool | None,
        Query(
            description="True: only stones that are new enough to have their raw frames, by `[store] keep_raw`, or"
            " pinned; false: only others"
        ),
    ] = None,
    zingg_class: Annotated[ZinggClass | None, Query(description="Only of this form")] = None,
    is_flaky: Annotated[
        bool | None,
        Query(description="Whether it passes the slot of its fraction (EN 933-3); from 4 to 100 mm"),
    ] = None,
    is_non_cubical: Annotated[
        bool | None,
        Query(description="Whether it is longer than three times its thickness (EN 933-4); from 4 to 63 mm"),
    ] = None,
    min_volume_sd_percent: SdPercent = None,
    max_volume_sd_percent: SdPercent = None,
    quality_cause: Annotated[
        QualityCause | None, Query(description="Only with this among the causes of its quality")
    ] = None,
    algorithm_version: Annotated[
        str | None, Query(max_length=16, description="Only measured by this version of the algorithm")
    ] = None,
    body: Annotated[
        Literal["photo", "estimate", "hull"] | None, Query(description="Only with this body")
    ] = None,
    cursor: Annotated[
        str | None, Query(pattern=r"^[0-9]{1,15}$", description="`next_cursor` of the page before")
    ] = None,
    limit: Annotated[int, Query(ge=1, le=1000, description="Results of a page, at most")] = 100,
) -> Response:
    """List the results that pass all filters, newest first, each in its newest revision.

    To follow production use the feed, `/results`.
    """
    wanted = ParticleFilter(
        outcome=outcome,
        quality=quality,
        kind=kind,
        min_sieve_size_mm=min_sieve_size_mm,
        max_sieve_size_mm=max_sieve_size_mm,
        since=since,
        until=until,
        lot=lot,
        has_frames=has_frames,
        zingg_class=zingg_class,
        is_flaky=is_flaky,
        is_non_cubical=is_non_cubical,
        min_volume_sd_percent=min_volume_sd_percent,
        max_volume_sd_percent=max_volume_sd_percent,
        quality_cause=quality_cause,
        algorithm_version=algorithm_version,
        body=body,
    )
    before_seq = MAX_SEQ if cursor is None else int(cursor)
    if limit > MAX_SMALL:
        path = context.store.path
        page = await context.reading.run(
            read, path, particles_page, wanted, before_seq, limit, names, as_gzip
        )
    else:
        page = await context.store.read(particles_page, wanted, before_seq, limit, names, as_gzip)
    return Response(page, media_type="application/json")


@router.get("/{particle_id}", response_model=Result, responses={**NOT_MODIFIED, **problem_responses(404)})
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
    record = await context.store.particle(int(key) if key.isdecimal() else key)
    return existing(record, "particle", key)
