"""The laboratory's sievings of lots, and the correlation study of a product."""

from dataclasses import replace
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Path, Query, Response
from pydantic import Base64Bytes, BaseModel, Field, TypeAdapter

from pipeline.gradation.correlation import MappingForm
from service.base.errors import InvalidRequestError
from service.base.ids import ID
from service.base.messages import Code, message
from service.base.schema import Name, OptionalTime, RequestBody, Time, request_body, served
from service.base.tables.files import tables_of
from service.base.tables.workbook import MAX_BYTES
from service.lots.comparing import ChosenRuns, Conditions, RunsOf, SampleStudy, sample_study
from service.lots.correlations import (
    CorrelationDocument,
    accept_study,
    correlations,
    keep_study,
    study_of,
    withdraw_study,
)
from service.lots.laboratory import (
    MOST_SIEVES,
    Sieving,
    SievingError,
    add_history,
    add_sieving,
    sieving_document,
    sievings_json,
    void_sieving,
)
from service.lots.lots import find_lot
from service.lots.plausibility import (
    SievingReading,
    history_of,
    part_of_history,
    require_plausible,
    sieving_reading,
)
from service.lots.products import find_product
from service.lots.routes.lot_figures import Measuring
from service.lots.routes.lots import LotName, VoidRequest
from service.lots.routes.products import ProductName
from service.lots.shifts import LotsSettings
from service.lots.tables.history import RefusedRow
from service.lots.tables.sievings import read_table
from service.web.auth import CONFIGURABLE, OPERABLE, READABLE, Who
from service.web.context import Context
from service.web.feeds import MAX_SEQ
from service.web.problems import existing, problem_responses

LotId = Annotated[str, Field(pattern=ID)]
READING = TypeAdapter(SievingReading)

router = APIRouter(tags=["laboratory"])


Reason = Annotated[str, Field(min_length=1, max_length=2000)]


class SievingRequest(RequestBody):
    """What a laboratory found: `retained_g` with `pan_g`, or a `table` as it is copied from a spreadsheet."""

    retained_g: dict[Annotated[str, Field(pattern=r"^[0-9]{1,3}(\.[0-9]{1,4})?$")], float] | None = Field(
        default=None, max_length=MOST_SIEVES, description="Grams retained on each sieve, by aperture in mm"
    )
    pan_g: float = Field(default=0.0, description="Grams in the pan")
    table: Annotated[str, Field(max_length=20_000)] | None = Field(
        default=None,
        description="A table as it is copied: its head names aperture in mm or µm; retained in g, kg, lb or %; passing"
        " in %. Without a head: lines of aperture in mm (or `pan`), semicolon or tab, mass in g",
    )
    sample_id: Name | None = Field(default=None, description="Id of the laboratory sample")
    by: Name | None = Field(default=None, description="Who sieved")
    remark: Annotated[str, Field(max_length=2000)] | None = Field(
        default=None, description="Whatever else is to be kept with it"
    )
    dry_mass_g: Annotated[float, Field(gt=0, lt=1e7)] | None = Field(
        default=None,
        description="Dry mass before sieving, g: fractions that miss it by more than 1 % are refused (EN 933-1)",
    )
    reason: Reason | None = Field(
        default=None,
        description="Why it is right though it contradicts the instrument's curve, or why it replaces another; is kept",
    )
    replaces: Annotated[int, Field(ge=1, le=MAX_SEQ)] | None = Field(
        default=None,
        description="Number of the sieving that it corrects, which is void from then on; needs a `reason`",
    )
    dry_run: bool = Field(
        default=False, description="True: nothing is stored, and the answer is the sieving as it was read"
    )


class SievingDocument(BaseModel):
    """A sieving of a lot."""

    sieving: int = Field(description="Number of the sieving")
    at: Time = Field(description="When it was entered, RFC 3339 UTC")
    retained_g: dict[str, float] = Field(
        description="Mass retained on each sieve (EN 933-1), g, by aperture in mm; empty where only percents are known"
    )
    pan_g: float | None = Field(description="Mass in the pan, g; null where only percents are known")
    mass_g: float | None = Field(description="Mass of all fractions, g; null where only percents are known")
    passing_percent: dict[str, float] = Field(description="By aperture in mm")
    sample_id: str | None = Field(description="Id of the laboratory sample")
    by: str | None = Field(description="Who sieved")
    remark: str | None = Field(description="As it was given")
    dry_mass_g: float | None = Field(description="Dry mass before sieving, g, as it was given")
    sieved_on: str | None = Field(
        default=None, description="Date of the sieving, such as 2026-03-02; null: not given"
    )
    reason: str | None = Field(description="Why it is right, or why it replaced another, as it was given")
    voided_at: OptionalTime = Field(
        description="When it was declared void, RFC 3339 UTC; null while it counts"
    )
    void_reason: str | None = Field(description="Why it counts no more; null while it counts")
    replaced_by: int | None = Field(
        description="Number of the sieving that corrects it; null if there is none"
    )


class HistoryRequest(RequestBody):
    """Sievings of many lots in one table."""

    table: Annotated[str, Field(max_length=500_000)] = Field(
        description="A table as of one sieving, with a column `lot`, `Los` or `Charge`: a sieving of each lot"
    )
    by: Name | None = Field(default=None, description="Who sieved")
    reason: Reason | None = Field(
        default=None, description="Why they are right where they contradict the instrument's curve"
    )
    dry_run: bool = Field(
        default=False, description="True: nothing is stored, and the answer is the sievings as they were read"
    )
    skip_refused: bool = Field(
        default=False,
        description="True: each sieving is taken or refused by itself, as one that is stored already; a line may be"
        " a whole sieving, with columns such as `Lot`, `Date`, `Passing % 31.5 mm`. False: all or none",
    )


@request_body
class WorkbookRequest:
    """A file of a spreadsheet."""

    workbook: Annotated[Base64Bytes, Field(min_length=1, max_length=MAX_BYTES * 4 // 3 + 4)]
    """The file in Base64, at most 700 kB: .xlsx, or text (CSV) of any encoding."""


@served
class SheetTable:
    """A sheet of a workbook as a table."""

    sheet: str
    """Name of the sheet; empty for the table of a text."""
    table: str
    """Its cells as a spreadsheet copies them, tabs between them: to be sent as `table` of a sieving."""


@served
class SheetTables:
    """The sheets of a workbook that are not empty."""

    items: list[SheetTable]
    """In the order of the workbook."""


class LotSieving(SievingDocument):
    """A sieving with the name of its lot."""

    lot: str = Field(description="Name of the lot")


class LotSievings(BaseModel):
    """Sievings that were stored together."""

    items: list[LotSieving] = Field(description="In the order of the table")
    refused: list[RefusedRow] = Field(default=[], description="Those that were refused, with `skip_refused`")


class SievingReadings(BaseModel):
    """Sievings of a table as they were read; nothing of it is stored."""

    items: list[SievingReading] = Field(description="In the order of the table")
    refused: list[RefusedRow] = Field(default=[], description="Those that are refused, with `skip_refused`")


class Sievings(BaseModel):
    """All sievings of a lot, in their order."""

    items: list[SievingDocument] = Field(description="In the order in which they were entered")


class StudyRequest(RequestBody):
    """A correlation study over all lots of a product that were sieved."""

    form: MappingForm = Field(
        default=MappingForm.FACTOR, description="One factor for all sizes, or a rising mapping"
    )


class WithdrawRequest(RequestBody):
    """Why a correlation study is used no more."""

    reason: Reason = Field(description="Why; kept with the study and in the audit")


StudyVersion = Annotated[int, Path(ge=1, le=MAX_SEQ, description="Number of the study")]


class Correlations(BaseModel):
    """All versions of a product's study, the newest first; the newest accepted one is in use."""

    items: list[CorrelationDocument] = Field(description="Newest first")


@router.post(
    "/lots/{lot}/sieving",
    status_code=201,
    response_model=SievingDocument,
    dependencies=OPERABLE,
    responses={200: {"model": SievingReading, "description": "With `dry_run`: the sieving as it was read"}},
)
async def post_sieving(context: Context, lot: LotName, wanted: SievingRequest, asking: Who) -> Any:
    """Store a sieving of the laboratory: of a portion of a lot, to be shown beside the instrument's curve.

    409 `implausible-sieving` if its passing is more than 15 points from the instrument's, and outside of the 95 %
    interval of that, unless there is a `reason`.
    """
    existing(await context.store.read(find_lot, lot), "lot", lot)
    sieving, understood = _sieving(wanted)
    measured = context.part(LotsSettings).measured
    reading = await context.read_beside(sieving_reading, lot, sieving, understood, measured)
    if wanted.dry_run:
        return Response(READING.dump_json(reading), media_type="application/json")
    require_plausible(reading, sieving.reason)
    return sieving_document(await context.write(add_sieving, lot, sieving, asking, wanted.replaces))


@router.post(
    "/lots/{lot}/sieving/{sieving}/void",
    response_model=SievingDocument,
    dependencies=OPERABLE,
    responses=problem_responses(404),
)
async def post_void_sieving(
    context: Context,
    lot: LotName,
    sieving: Annotated[int, Path(ge=1, le=MAX_SEQ, description="Number of the sieving")],
    wanted: VoidRequest,
    asking: Who,
) -> dict[str, Any]:
    """Declare a sieving void: it stays listed, and counts in no study, chart or report."""
    existing(await context.store.read(find_lot, lot), "lot", lot)
    return sieving_document(await context.write(void_sieving, lot, sieving, wanted.reason, asking))


@router.get("/lots/{lot}/sieving", response_model=Sievings, dependencies=READABLE)
async def list_sievings(context: Context, lot: LotName) -> Response:
    """List a lot's sievings of the laboratory."""
    existing(await context.store.read(find_lot, lot), "lot", lot)
    content = await context.read_beside(sievings_json, lot)
    return Response(content, media_type="application/json")


@router.post("/products/{product}/correlations", status_code=201, dependencies=CONFIGURABLE)
async def post_correlation(
    context: Context, product: ProductName, wanted: StudyRequest, asking: Who
) -> CorrelationDocument:
    """Correlate the instrument with a product's sievings: a draft, which no figure uses until it is accepted."""
    existing(await context.store.read(find_product, product), "product", product)
    context.store.require_writable()
    found = await context.read_beside(study_of, product, wanted.form)
    return await context.store.write(keep_study, product, found, asking)


@router.get("/products/{product}/correlations", dependencies=READABLE)
async def list_correlations(context: Context, product: ProductName) -> Correlations:
    """List the correlation studies of a product, newest first."""
    existing(await context.store.read(find_product, product), "product", product)
    return Correlations(items=await context.store.read(correlations, product))


@router.post("/tables", dependencies=OPERABLE)
async def read_workbook(context: Context, wanted: WorkbookRequest) -> SheetTables:
    """Read a workbook (.xlsx) or a text (CSV) as tables; nothing is stored. 422 says why it cannot be read."""
    found = await context.reading.run(tables_of, wanted.workbook)
    return SheetTables(items=[SheetTable(sheet=sheet, table=table) for sheet, table in found.items()])


@router.post(
    "/sievings",
    status_code=201,
    response_model=LotSievings,
    dependencies=OPERABLE,
    responses={
        200: {"model": SievingReadings, "description": "With `dry_run`: the sievings as they were read"}
    },
)
async def post_sievings(context: Context, wanted: HistoryRequest, asking: Who) -> Any:
    """Store sievings of many lots from one table: all of them or, if a line is wrong, none; or those that are right."""
    measured = context.part(LotsSettings).measured
    given = (wanted.table, wanted.reason, wanted.by, measured)
    refused: list[RefusedRow] = []
    if wanted.skip_refused:
        found, refused = await context.read_beside(part_of_history, *given)
    else:
        found = await context.read_beside(history_of, *given)
    if wanted.dry_run:
        items = SievingReadings(items=[reading for _, reading in found], refused=refused)
        return Response(items.model_dump_json(), media_type="application/json")
    for sieving, reading in found:
        require_plausible(reading, sieving.reason)
    pairs = [(reading.lot, sieving) for sieving, reading in found]
    return {"items": await context.write(add_history, pairs, asking), "refused": refused}


@router.post(
    "/products/{product}/correlations/{version}/accept",
    dependencies=CONFIGURABLE,
    responses=problem_responses(404),
)
async def post_accepted_correlation(
    context: Context, product: ProductName, version: StudyVersion, asking: Who
) -> CorrelationDocument:
    """Accept a correlation study: lots show both curves from now on. 409 while it has obstacles."""
    existing(await context.store.read(find_product, product), "product", product)
    return await context.write(accept_study, product, version, asking)


@router.post(
    "/products/{product}/correlations/{version}/withdraw",
    dependencies=CONFIGURABLE,
    responses=problem_responses(404),
)
async def post_withdrawn_correlation(
    context: Context, product: ProductName, version: StudyVersion, wanted: WithdrawRequest, asking: Who
) -> CorrelationDocument:
    """Withdraw a correlation study: the next older accepted one is in use again, or raw curves alone."""
    existing(await context.store.read(find_product, product), "product", product)
    return await context.write(withdraw_study, product, version, wanted.reason, asking)


async def runs_of(
    sample_id: Annotated[
        str | None, Query(min_length=1, max_length=200, description="Of the lots to compare")
    ] = None,
    lot: Annotated[
        list[LotId] | None, Query(min_length=2, max_length=50, description="These lots instead, 2 at least")
    ] = None,
    of: Annotated[RunsOf, Query(description="Measurements to compare")] = RunsOf.INSTRUMENT,
) -> ChosenRuns:
    """Return the runs that are asked for; raise `InvalidRequestError` unless one way names them."""
    if (sample_id is None) == (lot is None):
        raise InvalidRequestError("query: sample_id, lot: give one of them")
    return ChosenRuns(sample_id=sample_id, lots=tuple(lot or ()), of=of)


@router.get("/repeatability", dependencies=READABLE, responses=problem_responses(404, 409))
async def get_repeatability(
    context: Context,
    measuring: Measuring,
    chosen: Annotated[ChosenRuns, Depends(runs_of)],
    conditions: Annotated[
        Conditions, Query(description="What runs under equal conditions have in common")
    ] = Conditions.DAY,
) -> SampleStudy:
    """Get the repeatability of a sample: of the same stones dropped, or sieved, again; by others, elsewhere.

    Runs are the closed lots of a `sample_id`, or lots that are named; or all sievings of these that count.
    """
    found = await context.read_beside(sample_study, chosen, conditions, measuring)
    return existing(found, "sample", chosen.sample_id or ", ".join(chosen.lots))


def _sieving(wanted: SievingRequest) -> tuple[Sieving, str]:
    """Return the sieving of a request, and how its table was read."""
    words = wanted.model_dump(include={"sample_id", "by", "remark", "dry_mass_g", "reason"})
    if wanted.replaces is not None and wanted.reason is None:
        raise SievingError(f"reason: say why sieving {wanted.replaces} is replaced")
    if (wanted.retained_g is None) == (wanted.table is None):
        raise SievingError("retained_g, table: give one of them")
    if wanted.table is not None:
        read = read_table(wanted.table)
        return replace(read.sieving, **words), read.understood
    given = wanted.retained_g or {}
    retained_g = {float(aperture): grams for aperture, grams in given.items()}
    if len(retained_g) < len(given):
        raise SievingError("retained_g: a sieve is there twice")
    return Sieving(retained_g=retained_g, pan_g=wanted.pan_g, **words), message(Code.RETAINED_BY_APERTURE)
