"""Gradation curves as drawings: the very ones of the report, for pages."""

from typing import Annotated

from fastapi import APIRouter, Depends, Query, Response
from fastapi import Request as HttpRequest

from service.base.ids import ID
from service.base.language import Language
from service.lots.lots import find_lot
from service.lots.routes.lot_figures import Choosing, Measuring, Minutes, ProductId, last_minutes
from service.lots.routes.lots import LotName
from service.reports.drawings import CurveRequest, lot_curve_svg, window_curve_svg
from service.reports.words import words
from service.web.auth import READABLE
from service.web.context import Context
from service.web.problems import existing, problem_responses
from service.web.shared_documents import SVG, shared, svg_answer

router = APIRouter(tags=["lots"], dependencies=READABLE)

KEEP_S = 2.0
"""How long a drawing is kept for others who ask for it."""
DrawingLanguage = Annotated[Language, Query(description="Language of the drawing")]


async def curve_request_of(
    context: Context,
    measuring: Measuring,
    language: DrawingLanguage = Language.ENGLISH,
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
        language=language,
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


@router.get(
    "/windows/current/curve.svg", response_class=Response, responses={**SVG, **problem_responses(404)}
)
async def current_curve(
    context: Context, asked: HttpRequest, wanted: Drawing, minutes: Minutes = 60.0, product: ProductId = None
) -> Response:
    """Draw the gradation curve of the last minutes: of all that fell, in any lot or in none."""
    name = words(wanted.language)("curve.last_minutes", minutes=f"{minutes:g}")
    since, until = last_minutes(minutes)
    text = await shared(context, window_curve_svg, since, until, product, name, wanted, keep_s=KEEP_S)
    return svg_answer(asked, existing(text, "product", str(product)))
