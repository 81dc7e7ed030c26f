"""The reports of lots, and their gradation curves as drawings: the very ones of the report, for pages."""

import asyncio
from typing import Annotated

from fastapi import APIRouter, Depends, Path, Query, Response
from fastapi import Request as HttpRequest

from pipeline.gradation.distributions import ShapeMeasure
from service.base.errors import InvalidRequestError
from service.base.ids import ID
from service.base.language import Language
from service.lots.lots import find_lot
from service.lots.routes.lot_figures import Choosing, Figuring, Measuring, Minutes, ProductId, last_minutes
from service.lots.routes.lots import LotName
from service.lots.yardsticks import Request
from service.reports.distribution import stored_distribution_svg
from service.reports.drawing import DRAWING_WIDTH, Canvas
from service.reports.lot_reports import (
    CurveRequest,
    ReportRequest,
    RigStanding,
    issued_report,
    lot_curve_svg,
    lot_report,
    window_curve_svg,
)
from service.reports.report import MEDIA_TYPES, ReportFormat
from service.reports.words import words
from service.web.auth import READABLE
from service.web.context import ApiContext, Context
from service.web.etags import Responses
from service.web.feeds import MAX_SEQ
from service.web.negotiation import negotiated
from service.web.problems import existing, problem_responses
from service.web.shared_documents import SVG, shared, svg_answer

router = APIRouter(tags=["lots"], dependencies=READABLE)

OFFERS = {each: name.partition(";")[0] for each, name in MEDIA_TYPES.items()}
REPORTS: Responses = {200: {"content": {media_type: {} for media_type in OFFERS.values()}}}
REPORT_POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:"
"""What a browser lets the HTML do: it has no scripts and loads nothing."""
ReportLanguage = Annotated[Language, Query(description="Language of the report")]
KEEP_S = 2.0
"""How long a drawing is kept for others who ask for it."""


async def look_of(
    language: Annotated[Language, Query(description="Language of the drawing")] = Language.ENGLISH,
    width_px: Annotated[
        int, Query(ge=240, le=2400, description="Width of the drawing, whose letters are 11 px high")
    ] = int(DRAWING_WIDTH),
    height_px: Annotated[
        int | None,
        Query(ge=120, le=1600, description="Height of the drawing; as much as it takes when absent"),
    ] = None,
) -> Canvas:
    """Return the language of a drawing and its room."""
    return Canvas(language, width_px, height_px)


Looking = Annotated[Canvas, Depends(look_of)]


@router.get("/lots/{lot}/report", response_class=Response, responses={**REPORTS, **problem_responses(406)})
async def report(
    context: Context,
    asked: HttpRequest,
    lot: LotName,
    measuring: Figuring,
    language: ReportLanguage = Language.ENGLISH,
) -> Response:
    """Get the report of a lot: in the format that `Accept` prefers, HTML, PDF, CSV or XLSX."""
    return await _report(context, lot, negotiated(asked, OFFERS, "a report"), language, measuring)


@router.get("/lots/{lot}/report.{report_format}", response_class=Response, responses=REPORTS)
async def report_file(
    context: Context,
    asked: HttpRequest,
    lot: LotName,
    report_format: Annotated[ReportFormat, Path(description="Format of the file")],
    measuring: Figuring,
    language: ReportLanguage = Language.ENGLISH,
    revision: Annotated[
        int | None,
        Query(
            ge=1,
            le=MAX_SEQ,
            description="The PDF that was issued for this revision of a closed lot, as it was then",
        ),
    ] = None,
) -> Response:
    """Download the report of a lot as a file of this format: as of now, or the one that was issued for a revision."""
    if revision is not None:
        if others := asked.query_params.keys() - {"revision"}:
            named = ", ".join(sorted(others))
            raise InvalidRequestError(
                f"query: an issued report stays as it is: revision goes without {named}"
            )
        return await _issued(context, lot, report_format, revision)
    return await _report(context, lot, report_format, language, measuring)


async def _report(
    context: ApiContext, lot: str, report_format: ReportFormat, language: Language, measuring: Request
) -> Response:
    wanted = ReportRequest(figures=measuring, language=language, rig=context.part(RigStanding))
    content = await context.read_beside(lot_report, context.store.particles_dir, lot, wanted, report_format)
    return _answer(existing(content, "lot", lot), lot, report_format)


def _answer(content: bytes, name: str, report_format: ReportFormat) -> Response:
    shown = f'inline; filename="{name}.{report_format}"'
    headers = {"Content-Disposition": shown, "Vary": "Accept", "Content-Security-Policy": REPORT_POLICY}
    return Response(content, media_type=MEDIA_TYPES[report_format], headers=headers)


async def _issued(context: ApiContext, lot: str, report_format: ReportFormat, revision: int) -> Response:
    existing(await context.store.read(find_lot, lot), "lot", lot)
    is_issued = report_format is ReportFormat.PDF
    content = await asyncio.to_thread(issued_report, context.store.dir, lot, revision) if is_issued else None
    found = existing(content, "report", f"{lot}-{revision}.{report_format}")
    return _answer(found, f"{lot}-{revision}", report_format)


async def curve_request_of(
    context: Context,
    measuring: Measuring,
    look: Looking,
    beside_lot: Annotated[
        str | None, Query(pattern=ID, description="Draw the curve of this lot beside it, at the same sieves")
    ] = None,
    beside_algorithm_version: Annotated[
        str | None,
        Query(
            max_length=200,
            description="The curve beside it as this version measured it: of `beside_lot`, or of the same lot",
        ),
    ] = None,
) -> CurveRequest:
    """Return the request for a drawing; raise the problem 404 for an unknown lot beside it."""
    if beside_lot is not None:
        existing(await context.store.read(find_lot, beside_lot), "lot", beside_lot)
    return CurveRequest(
        figures=measuring,
        look=look,
        beside_lot=beside_lot,
        beside_algorithm_version=beside_algorithm_version,
    )


Drawing = Annotated[CurveRequest, Depends(curve_request_of)]


@router.get("/lots/{lot}/curve.svg", response_class=Response, responses=SVG)
async def lot_curve(
    context: Context, asked: HttpRequest, lot: LotName, wanted: Drawing, choosing: Choosing
) -> Response:
    """Draw the gradation curve of a lot: as in the report, with its limits, interval and verdicts.

    A page sets its colours by the CSS variables `--sf-ink`, `--sf-paper`, `--sf-curve` ...; it says in words what it
    shows.
    """
    text = await shared(context, lot_curve_svg, lot, choosing, wanted, keep_s=KEEP_S)
    return svg_answer(asked, existing(text, "lot", lot))


@router.get("/lots/{lot}/distributions/{measure}.svg", response_class=Response, responses=SVG)
async def lot_distribution(
    context: Context,
    asked: HttpRequest,
    lot: LotName,
    measure: Annotated[ShapeMeasure, Path(description="Field of a result")],
    choosing: Choosing,
    look: Looking,
) -> Response:
    """Draw the distribution of a measure of shape over a lot, by mass."""
    text = await shared(context, stored_distribution_svg, lot, choosing, measure, look, keep_s=KEEP_S)
    return svg_answer(asked, existing(text, "lot", lot))


@router.get(
    "/windows/current/curve.svg", response_class=Response, responses={**SVG, **problem_responses(404)}
)
async def current_curve(
    context: Context, asked: HttpRequest, wanted: Drawing, minutes: Minutes = 60.0, product: ProductId = None
) -> Response:
    """Draw the gradation curve of the last minutes: of all that fell, in any lot or in none."""
    name = words(wanted.look.language)("curve.last_minutes", minutes=f"{minutes:g}")
    since, until = last_minutes(minutes)
    text = await shared(context, window_curve_svg, since, until, product, name, wanted, keep_s=KEEP_S)
    return svg_answer(asked, existing(text, "product", str(product)))
