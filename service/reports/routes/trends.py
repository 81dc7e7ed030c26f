"""How rate, size and shape went over the last hours, as numbers and as drawings."""

from collections.abc import Sequence
from typing import Annotated

from fastapi import APIRouter, Path, Query, Response
from fastapi import Request as HttpRequest
from pydantic import Field

from pipeline.frames import rfc3339
from service.base.ids import ID
from service.base.language import Language
from service.lots.comparing import LotComparison, Side, compare_lots
from service.lots.evaluation import as_json
from service.lots.lots import find_lot
from service.lots.overlay import MAX_LOTS, Overlay, ReferenceKind, overlay
from service.lots.routes.lot_figures import Measuring, next_second
from service.lots.routes.products import ProductName
from service.lots.shifts import LotsSettings
from service.lots.trends.changes import Changes
from service.lots.trends.trend import Trend, trend
from service.reports.changes import told_changes
from service.reports.control import stored_control_svg
from service.reports.overlay import stored_overlay_svg
from service.reports.routes.lot_reports import Looking
from service.reports.trend import TrendFigure, stored_trend_svg
from service.web.auth import READABLE
from service.web.context import ApiContext, Context
from service.web.problems import existing, problem_responses
from service.web.shared_documents import SVG, shared, svg_answer

router = APIRouter(tags=["trends"], dependencies=READABLE)
diary = APIRouter(tags=["diary"], dependencies=READABLE)

KEEP_S = 5.0
"""How long a trend is kept for others who ask for it; a new result ends it."""
Hours = Annotated[float, Query(ge=1, le=720, description="How far back, h")]
LotId = Annotated[str, Query(pattern=ID, description="Id of the first lot")]


@router.get("/trends", response_model=Trend)
async def get_trends(context: Context, hours: Hours = 12.0) -> Response:
    """Get the trends of the last hours: rate, D50, flakiness and shape index, in buckets of a minute to a day.

    With them come the entries of the crusher's diary and the lots of that time. A replay's stones fell long ago: they
    count when their results came. Of a bucket with more than 2000
    measured stones every so many are looked at; `n_effective` and the intervals say so.
    """
    now, measured = rfc3339(next_second()), context.part(LotsSettings).measured
    content = await shared(context, as_json, trend, now, hours, measured, keep_s=KEEP_S)
    return Response(content, media_type="application/json")


@router.get("/trends/{figure}.svg", response_class=Response, responses=SVG)
async def get_trend_drawing(
    context: Context,
    asked: HttpRequest,
    figure: Annotated[
        TrendFigure,
        Path(
            description="`rate` of stones, `d50`, `flakiness` index FI (EN 933-3), `shape` index SI (EN 933-4),"
            " `passing_lower` and `passing_upper`: passing at the sieves of d and D of `product`"
        ),
    ],
    look: Looking,
    hours: Hours = 12.0,
    product: Annotated[
        str | None, Query(pattern=ID, description="Product whose control limits are drawn; none when absent")
    ] = None,
) -> Response:
    """Draw the trend of a figure: its line and 95 % interval over the last hours, the diary's marks, the lots.

    Points of few stones are not joined. Alarms of the product, and with `product` the control limits of its lots, are
    drawn where there are any.
    """
    now, measured = rfc3339(next_second()), context.part(LotsSettings).measured
    given = (stored_trend_svg, now, hours, measured, figure, look, product)
    text = await shared(context, *given, keep_s=KEEP_S)
    return svg_answer(asked, text or "")


@router.get(
    "/products/{product}/control/{figure}.svg",
    response_class=Response,
    responses={**SVG, **problem_responses(404)},
    tags=["lots"],
)
async def get_control_drawing(
    context: Context,
    asked: HttpRequest,
    product: ProductName,
    figure: Annotated[
        str, Path(max_length=100, description="Such as `d50_mm`; `/products/{product}/control` names all")
    ],
    look: Looking,
) -> Response:
    """Draw the control chart of a figure: the newest 60 lots, limits, weighted mean, and entries of the diary."""
    measured = context.part(LotsSettings).measured
    text = await context.read_beside(stored_control_svg, product, figure, measured, look)
    return svg_answer(asked, existing(text, "chart", f"{product}, {figure}"))


@router.get(
    "/comparisons/lots", response_model=LotComparison, responses=problem_responses(404), tags=["lots"]
)
async def compare(
    context: Context,
    measuring: Measuring,
    a: LotId,
    b: Annotated[
        str | None, Query(pattern=ID, description="Id of the second lot; the first when absent")
    ] = None,
    a_algorithm_version: Annotated[
        str | None, Query(max_length=200, description="The first as this version measured it")
    ] = None,
    b_algorithm_version: Annotated[
        str | None, Query(max_length=200, description="The second as this version measured it")
    ] = None,
) -> Response:
    """Compare two lots, or one as two algorithm versions measured it: by the product of the first.

    Each figure comes with its difference, the 95 % interval of that, and whether it is more than chance.
    """
    await _all_exist(context, (a, b or a))
    sides = Side(a, a_algorithm_version), Side(b or a, b_algorithm_version)
    content = await shared(context, as_json, compare_lots, *sides, measuring, keep_s=KEEP_S)
    return Response(existing(content, "lot", a), media_type="application/json")


Overlaid = Annotated[
    list[Annotated[str, Field(pattern=ID)]],
    Query(alias="lot", min_length=1, max_length=MAX_LOTS, description="Ids of the lots, `lot=` for each"),
]
Banded = Annotated[ReferenceKind | None, Query(description="Band to see them against; none when absent")]


@router.get("/comparisons/curves", response_model=Overlay, responses=problem_responses(404), tags=["lots"])
async def compare_curves(
    context: Context, measuring: Measuring, lots: Overlaid, reference: Banded = None
) -> Response:
    """Get the curves of many lots, twelve at most: at the sieves of the first one's product, or at any others.

    A band can come with them: the limits of the specification, or the product's other closed lots, at most 30 and at
    least 5, their median with two standard deviations to either side.
    """
    await _all_exist(context, lots)
    content = await shared(
        context, as_json, overlay, tuple(dict.fromkeys(lots)), reference, measuring, keep_s=KEEP_S
    )
    return Response(existing(content, "lot", lots[0]), media_type="application/json")


@router.get(
    "/comparisons/curves.svg",
    response_class=Response,
    responses={**SVG, **problem_responses(404)},
    tags=["lots"],
)
async def draw_curves(
    context: Context,
    asked: HttpRequest,
    measuring: Measuring,
    lots: Overlaid,
    look: Looking,
    reference: Banded = None,
) -> Response:
    """Draw the curves of many lots, twelve at most, with the band."""
    await _all_exist(context, lots)
    given = (stored_overlay_svg, tuple(dict.fromkeys(lots)), reference, measuring, look)
    text = await shared(context, *given, keep_s=KEEP_S)
    return svg_answer(asked, existing(text, "lot", lots[0]))


async def _all_exist(context: ApiContext, names: Sequence[str]) -> None:
    for lot in names:
        existing(await context.store.read(find_lot, lot), "lot", lot)


@diary.get("/diary/changes", response_model=Changes)
async def get_changes(
    context: Context,
    hours: Hours = 24.0,
    language: Annotated[Language, Query(description="Language of the sentences")] = Language.ENGLISH,
) -> Response:
    """List the changes since each diary entry of the last hours: D50, FI, SI and stones a minute, before and after.

    Each side reaches to the neighbouring entry, at most 12 h. Stones that fall soon after each other are alike, which
    the intervals allow for. Clock times in sentences are the host's.
    """
    now, measured = rfc3339(next_second()), context.part(LotsSettings).measured
    content = await shared(context, as_json, told_changes, now, hours, measured, language, keep_s=KEEP_S)
    return Response(content, media_type="application/json")
