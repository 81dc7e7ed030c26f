"""Lots of the plant: opened, closed, voided; their stones, and the figures that these make up."""

import re
import sqlite3
from collections.abc import Callable
from dataclasses import asdict, replace
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Path, Query, Response
from fastapi import Request as HttpRequest
from pydantic import BaseModel, ConfigDict, Field

from service.api.auth import Who, require
from service.api.context import ApiContext, Context
from service.api.etags import NOT_MODIFIED, IfMatch, change_if_match, etag, unchanged
from service.api.lot_reports import lot_report
from service.api.pages import lot_figures_json
from service.api.problems import Problem, existing, problem_responses
from service.api.report_requests import report_request
from service.api.routes.particle_files import best_match
from service.api.routes.products import Text
from service.api.routes.results import Time
from service.api.settings import Scope
from service.api.version import BASE
from service.language import Language
from service.lots.evaluation import lot_document
from service.lots.figures import LotDocument, LotFigures
from service.lots.lots import (
    LotDefinition,
    LotRecord,
    LotState,
    UnknownProductError,
    assign,
    close_lot,
    find_lot,
    lots,
    open_lot,
    void_lot,
)
from service.lots.products import find_product
from service.lots.stored_stones import stones_behind
from service.lots.yardsticks import Request, yardstick_of
from service.reports.report import ReportFormat
from service.results.fields import TIME
from service.store import read

router = APIRouter(prefix="/lots", tags=["lots"])

LotName = Annotated[str, Path(pattern=r"^[A-Za-z0-9_.-]{1,64}$", description="Id of the lot")]
Id = Annotated[str, Field(pattern=r"^[A-Za-z0-9_.-]{1,64}$")]
Tonnage = Annotated[float | None, Field(ge=0, le=1e6, description="Of the whole lot, t")]
STONES = re.compile('-[0-9]+(?=")')
"""The number of stones in the tag of a lot."""
READABLE = [Depends(require(Scope.READ))]
OPERABLE = [Depends(require(Scope.OPERATE))]


REPORTS: dict[int | str, dict[str, Any]] = {
    200: {"content": {each.media_type.partition(";")[0]: {} for each in ReportFormat}}
}
REPORT_POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:"
"""What a browser lets the HTML do: it has no scripts and loads nothing."""


class LotRequest(BaseModel):
    """A lot to open, in the words of ISA-95."""

    model_config = ConfigDict(extra="forbid")

    lot: Id = Field(description="Material lot")
    product: Id = Field(description="Material definition")
    product_version: int | None = Field(default=None, ge=1, strict=True, description="The newest when absent")
    equipment: Text | None = Field(default=None, description="The crusher or belt that it comes from")
    sublot: Text | None = Field(default=None, description="Material sublot, ISA-95")
    sample_id: Text | None = Field(
        default=None,
        description="Id of the laboratory sample; lots with the same one are compared by `/repeatability`",
    )
    sampler: Text | None = Field(default=None, description="Who took the sample")
    tonnage_t: Tonnage = None
    remark: Annotated[str, Field(max_length=2000)] | None = Field(
        default=None, description="Whatever else the plant says of it"
    )


class CloseRequest(BaseModel):
    """What is known of a lot at its end."""

    model_config = ConfigDict(extra="forbid")

    tonnage_t: Tonnage = None


class VoidRequest(BaseModel):
    """Why a lot counts no more."""

    model_config = ConfigDict(extra="forbid")

    reason: Annotated[str, Field(min_length=1, max_length=2000)] = Field(
        description="Why it counts no more; kept with the lot and in the audit"
    )


class AssignRequest(BaseModel):
    """A time, whose stones outside of any lot are to be in this one."""

    model_config = ConfigDict(extra="forbid")

    since: Annotated[Time, Field(description="Captured at or after", json_schema_extra=TIME)]
    until: Annotated[Time, Field(description="Captured before", json_schema_extra=TIME)]


class LotsPage(BaseModel):
    """Lots, newest first."""

    items: list[LotDocument] = Field(description="Newest first")
    next_before: str | None = Field(description="Pass as `before` for the next page; null on the last")


class Assigned(BaseModel):
    """What an assignment changed."""

    lot: LotDocument = Field(description="The lot as it is now")
    n_assigned: int = Field(description="Stones that are in the lot now and were in none")


class StoneBehindStep(BaseModel):
    """A stone between two neighbouring sieves of the curve."""

    seq: int = Field(description="`seq` of the result")
    id: str = Field(description="`id` of the result")
    captured_at: str = Field(description="When the stone was exposed, RFC 3339 UTC", json_schema_extra=TIME)
    quality: str = Field(
        description="How far from the truth the result may be: `good`, `reduced` or `degraded`"
    )
    sieve_size_mm: float = Field(
        description="Smallest square aperture the body passes (EN 933-2 square holes), mm"
    )
    volume_mm3: float = Field(description="Corrected volume, mm³")
    influence_percent: float = Field(description="Its share of the lot's mass")


class StonesBehindStep(BaseModel):
    """The stones that pass one sieve and not the next smaller one, the heaviest first."""

    above_mm: float = Field(
        description="Aperture of the next smaller sieve of the set, mm; 0 below the smallest"
    )
    up_to_mm: float = Field(description="Aperture of the upper sieve, mm")
    items: list[StoneBehindStep] = Field(description="The heaviest first")


async def request_of(
    context: Context,
    sieve_set: Annotated[str | None, Query(max_length=200, description="Another than the product's")] = None,
    specification: Annotated[
        str | None, Query(max_length=200, description="Another than the product's")
    ] = None,
) -> Request:
    """Return what the figures of a request are to be measured by."""
    return Request(sieve_set=sieve_set, specification=specification, measured=context.control.lots.measured)


Measuring = Annotated[Request, Depends(request_of)]
ReportLanguage = Annotated[Language, Query(description="Language of the report")]


@router.post(
    "",
    status_code=201,
    response_model=LotDocument,
    dependencies=OPERABLE,
    responses=problem_responses(404, 409),
)
async def post_lot(context: Context, wanted: LotRequest, response: Response, asking: Who) -> LotDocument:
    """Open a lot: what falls from now on is in it, whenever it is measured.

    The same request again returns the open lot. 409 `lot-conflict` while another is open, or if this one was.
    """
    given = wanted.model_dump(exclude={"product", "product_version"})
    definition = LotDefinition(**given)
    context.store.require_writable()
    try:
        record = await context.store.write(
            open_lot, definition, wanted.product, wanted.product_version, asking
        )
    except UnknownProductError as err:
        raise Problem(404, "unknown-product", f"there is no product {err}") from err
    response.headers["Location"] = f"{BASE}/lots/{wanted.lot}"
    return _served(response, record)


@router.get("", response_model=LotsPage, dependencies=READABLE, responses=problem_responses())
async def list_lots(
    context: Context,
    state: Annotated[LotState | None, Query(description="Only lots in this state")] = None,
    product: Annotated[str | None, Query(max_length=64, description="Only lots of this product")] = None,
    before: Annotated[Time | None, Query(description="Opened before, RFC 3339")] = None,
    limit: Annotated[int, Query(ge=1, le=1000, description="Lots of a page, at most")] = 100,
) -> LotsPage:
    """Return lots, newest first."""
    found = await context.store.read(lots, state, product, before, limit + 1)
    items = [lot_document(each) for each in found[:limit]]
    return LotsPage(items=items, next_before=items[-1].opened_at if len(found) > limit else None)


@router.get(
    "/{lot}",
    response_model=LotDocument,
    dependencies=READABLE,
    responses={**NOT_MODIFIED, **problem_responses(404)},
)
async def get_lot(context: Context, asked: HttpRequest, response: Response, lot: LotName) -> Any:
    """Return a lot; its `ETag` is for `If-Match` of a change."""
    record = existing(await context.store.read(find_lot, lot), "lot", lot)
    return unchanged(asked, _tag(record)) or _served(response, record)


@router.post(
    "/{lot}/close",
    response_model=LotDocument,
    dependencies=OPERABLE,
    responses=problem_responses(404, 409, 412),
)
async def post_close(
    context: Context,
    lot: LotName,
    wanted: CloseRequest,
    asking: Who,
    response: Response,
    if_match: IfMatch = None,
) -> LotDocument:
    """Close a lot; what fell before stays in it, though it is measured later. A closed one stays as it is."""
    context.store.require_writable()
    return _served(response, await _changed(context, lot, if_match, close_lot, wanted.tonnage_t, asking))


@router.post(
    "/{lot}/void", response_model=LotDocument, dependencies=OPERABLE, responses=problem_responses(404, 412)
)
async def post_void(
    context: Context,
    lot: LotName,
    wanted: VoidRequest,
    asking: Who,
    response: Response,
    if_match: IfMatch = None,
) -> LotDocument:
    """Declare a lot void: it counts no more, and is kept."""
    context.store.require_writable()
    return _served(response, await _changed(context, lot, if_match, void_lot, wanted.reason, asking))


@router.post(
    "/{lot}/assign", response_model=Assigned, dependencies=OPERABLE, responses=problem_responses(404, 409)
)
async def post_assign(context: Context, lot: LotName, wanted: AssignRequest, asking: Who) -> Assigned:
    """Put the stones of a time that are in no lot into this one; the audit keeps who did it."""
    context.store.require_writable()
    done = await context.store.write(assign, lot, wanted.since, wanted.until, asking)
    record, n_assigned = existing(done, "lot", lot)
    return Assigned(lot=lot_document(record), n_assigned=n_assigned)


@router.get(
    "/{lot}/gradation",
    response_model=LotFigures,
    dependencies=READABLE,
    responses=problem_responses(404, 422),
)
async def gradation(
    context: Context,
    lot: LotName,
    measuring: Measuring,
) -> Response:
    """Return the figures of a lot through the sieves and the specification of its product, or through any other."""
    content = await context.reading.run(read, context.store.path, lot_figures_json, lot, measuring)
    return Response(existing(content, "lot", lot), media_type="application/json")


@router.get(
    "/{lot}/report",
    response_class=Response,
    dependencies=READABLE,
    responses={**REPORTS, **problem_responses(404, 406, 422)},
)
async def report(
    context: Context,
    asked: HttpRequest,
    lot: LotName,
    measuring: Measuring,
    language: ReportLanguage = Language.ENGLISH,
) -> Response:
    """Return the report of a lot in the format that `Accept` prefers: HTML, PDF, CSV or XLSX."""
    offers = [each.media_type.partition(";")[0] for each in ReportFormat]
    choice = best_match(asked.headers.get("accept"), offers)
    if choice is None:
        raise Problem(
            406, "not-acceptable", "a report comes as " + ", ".join(offers), headers={"Vary": "Accept"}
        )
    return await _report(context, lot, list(ReportFormat)[choice], language, measuring)


@router.get(
    "/{lot}/report.{report_format}",
    response_class=Response,
    dependencies=READABLE,
    responses={**REPORTS, **problem_responses(404, 422)},
)
async def report_file(
    context: Context,
    lot: LotName,
    report_format: Annotated[ReportFormat, Path(description="Format of the file")],
    measuring: Measuring,
    language: ReportLanguage = Language.ENGLISH,
) -> Response:
    """Return the report of a lot as a file of this format."""
    return await _report(context, lot, report_format, language, measuring)


@router.get(
    "/{lot}/particles",
    response_model=StonesBehindStep,
    dependencies=READABLE,
    responses=problem_responses(404, 422),
)
async def particles_behind_step(
    context: Context,
    lot: LotName,
    sieve: Annotated[float, Query(gt=0, le=1000, description="Aperture of the upper sieve, mm")],
    measuring: Measuring,
    limit: Annotated[int, Query(ge=1, le=1000, description="Stones of the answer, at most")] = 100,
) -> dict[str, Any]:
    """Return the stones behind a step of the curve: that pass this sieve and not the next smaller one of the set."""
    record = existing(await context.store.read(find_lot, lot), "lot", lot)
    product = await context.store.read(find_product, record.product, record.version)
    definition = None if product is None else product.definition
    apertures_mm = yardstick_of(definition, measuring).apertures_mm
    above_mm = max((each for each in apertures_mm if each < sieve), default=0.0)
    items = await context.store.read(stones_behind, lot, above_mm, sieve, limit)
    return {"above_mm": above_mm, "up_to_mm": sieve, "items": [asdict(each) for each in items]}


def _served(response: Response, record: LotRecord) -> LotDocument:
    response.headers["ETag"] = _tag(record)
    return lot_document(record)


def _tag(record: LotRecord) -> str:
    """Return the version of a lot: what the plant says of it, and how many stones it has."""
    return f'{_tag_of_facts(record)[:-1]}-{record.n_stones}"'


def _tag_of_facts(record: LotRecord) -> str:
    return etag(asdict(replace(record, n_stones=0)))


async def _changed(
    context: ApiContext,
    lot: str,
    if_match: str | None,
    change: Callable[..., LotRecord | None],
    *given: object,
) -> LotRecord:
    """Return the lot after a change; for `If-Match`, stones that fell meanwhile are no change."""

    def version(connection: sqlite3.Connection) -> str | None:
        record = find_lot(connection, lot)
        return None if record is None else _tag_of_facts(record)

    facts = None if if_match is None else STONES.sub("", if_match)
    return existing(
        await context.store.write(change_if_match, facts, version, change, lot, *given), "lot", lot
    )


async def _report(
    context: ApiContext,
    lot: str,
    report_format: ReportFormat,
    language: Language,
    measuring: Request,
) -> Response:
    wanted = report_request(context.control, measuring, report_format, language)
    store = context.store
    content = await context.reading.run(read, store.path, lot_report, store.particles_dir, lot, wanted)
    name = f'inline; filename="{lot}.{report_format}"'
    headers = {"Content-Disposition": name, "Vary": "Accept", "Content-Security-Policy": REPORT_POLICY}
    return Response(existing(content, "lot", lot), media_type=report_format.media_type, headers=headers)
