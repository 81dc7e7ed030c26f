"""Lots without an MES: the gradation of the last minutes, and of a shift."""

from datetime import UTC, datetime, timedelta
from typing import Annotated

from fastapi import APIRouter, Query, Response

from pipeline.frames import rfc3339
from service.base.ids import ID
from service.lots.evaluation import as_json, window_figures
from service.lots.figures import LotFigures
from service.lots.routes.lot_figures import Measuring
from service.lots.shifts import LotsSettings, shift_at
from service.lots.yardsticks import Request
from service.store import read
from service.web.auth import READABLE
from service.web.context import ApiContext, Context
from service.web.problems import existing, problem_responses

router = APIRouter(prefix="/windows", tags=["lots"], dependencies=READABLE)

Minutes = Annotated[float, Query(gt=0, le=10_080, description="How far back")]
ProductId = Annotated[str | None, Query(pattern=ID, description="Judge by this product's newest version")]


@router.get("/current", response_model=LotFigures, responses=problem_responses(404))
async def current_window(
    context: Context, measuring: Measuring, minutes: Minutes = 60.0, product: ProductId = None
) -> Response:
    """Get the figures of the last minutes: of all that fell, in any lot or in none."""
    return await _figures(context, *last_minutes(minutes), product, measuring)


@router.get("/shift", response_model=LotFigures, responses=problem_responses(404))
async def shift(
    context: Context,
    measuring: Measuring,
    ago: Annotated[int, Query(ge=0, le=1000, description="0: the present shift, 1: the one before")] = 0,
    product: ProductId = None,
) -> Response:
    """Get the figures of a shift; `[lots] shift_starts` says when they begin, by the host's local time."""
    since, until = shift_at(datetime.now(UTC).astimezone(), context.part(LotsSettings).shift_starts, ago)
    return await _figures(context, rfc3339(since), rfc3339(until), product, measuring)


def last_minutes(minutes: float) -> tuple[str, str]:
    """Return the time of the last minutes."""
    until = next_second()
    return rfc3339(until - timedelta(minutes=minutes)), rfc3339(until)


def next_second() -> datetime:
    """Return the next whole second: an end of a time that holds all that fell, and that many requests share."""
    return datetime.now(UTC).replace(microsecond=0) + timedelta(seconds=1)


async def _figures(
    context: ApiContext, since: str, until: str, product: str | None, measuring: Request
) -> Response:
    given = (window_figures, since, until, measuring, product)
    content = await context.reading.run(read, context.store.path, as_json, *given)
    return Response(existing(content, "product", str(product)), media_type="application/json")
