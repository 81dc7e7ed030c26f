"""The figures of a lot, of the last minutes or of a shift, and the stones behind each step of a curve."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta
from math import inf
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Query, Response
from pydantic import BaseModel, Field

from pipeline.frames import rfc3339
from service.base.ids import ID
from service.lots.distributions import LotDistributions, lot_distributions
from service.lots.evaluation import as_json, lot_figures, window_figures
from service.lots.figures import LotFigures
from service.lots.lots import find_lot
from service.lots.products import find_product
from service.lots.routes.lots import LotName
from service.lots.shifts import LotsSettings, shift_at
from service.lots.stones import Choice, StoneBehindStep, stones_behind, versions_of_lot
from service.lots.yardsticks import Request, percents_in, yardstick_of
from service.web.auth import READABLE
from service.web.context import ApiContext, Context
from service.web.problems import existing, problem_responses

router = APIRouter(prefix="/lots", tags=["lots"], dependencies=READABLE)
windows = APIRouter(prefix="/windows", tags=["lots"], dependencies=READABLE)
"""Lots without an MES."""

Minutes = Annotated[float, Query(gt=0, le=10_080, description="How far back")]
ProductId = Annotated[str | None, Query(pattern=ID, description="Judge by this product's newest version")]


class StonesBehindStep(BaseModel):
    """The stones of a lot, or those that pass one sieve and not the next smaller one, the heaviest first."""

    above_mm: float = Field(
        description="Aperture of the next smaller sieve of the set, mm; 0 below the smallest, and of all stones"
    )
    up_to_mm: float | None = Field(description="Aperture of the upper sieve, mm; null: all stones of the lot")
    items: list[StoneBehindStep] = Field(description="The heaviest first")


class LotVersion(BaseModel):
    """A version of the algorithms, and how much of a lot it has measured."""

    algorithm_version: str = Field(description="As results name it")
    n_stones: int = Field(description="Stones of the lot that have a revision by it")


class LotVersions(BaseModel):
    """All versions that have measured stones of a lot, as far as results are kept."""

    items: list[LotVersion] = Field(description="By name")


async def request_of(
    context: Context,
    sieve_set: Annotated[
        str | None,
        Query(
            max_length=1000,
            description="Another than the product's: a name of `/products/standards`, or apertures in mm, rising, such"
            " as `4,5.6,8,11.2`",
        ),
    ] = None,
    specification: Annotated[
        str | None, Query(max_length=200, description="Another than the product's")
    ] = None,
) -> Request:
    """Return the yardsticks of a request: sieve set, specification and measured sizes."""
    return Request(
        sieve_set=sieve_set, specification=specification, measured=context.part(LotsSettings).measured
    )


async def choice_of(
    without: Annotated[
        list[Annotated[str, Field(max_length=100)]] | None,
        Query(
            max_length=100,
            description="Ids of stones to leave out, as if they had not fallen; nothing of it is stored",
        ),
    ] = None,
    algorithm_version: Annotated[
        str | None,
        Query(
            max_length=200,
            description="Of each stone the newest revision by this version, the others not at all",
        ),
    ] = None,
) -> Choice:
    """Return the choice of stones: those left out, and the algorithm version."""
    return Choice(without=tuple(sorted(set(without or ()))), algorithm_version=algorithm_version)


Measuring = Annotated[Request, Depends(request_of)]


async def figures_request_of(
    measuring: Measuring,
    quantiles: Annotated[
        str | None,
        Query(max_length=200, description="Sizes D_p to give, in the place of the product's: `5,16,84,95`"),
    ] = None,
) -> Request:
    """Return the yardsticks of a request for figures; raise `UnknownYardstickError` for percents that are none."""
    return measuring if quantiles is None else replace(measuring, percents=percents_in(quantiles))


Figuring = Annotated[Request, Depends(figures_request_of)]
Choosing = Annotated[Choice, Depends(choice_of)]


@router.get("/{lot}/gradation", response_model=LotFigures)
async def gradation(context: Context, lot: LotName, measuring: Figuring, choosing: Choosing) -> Response:
    """Get the gradation of a lot: through the sieves and specification of its product, or through any other.

    `without` and `algorithm_version` ask what they would be of other stones; the document repeats what was asked.
    """
    content = await context.read_beside(as_json, lot_figures, lot, measuring, choosing)
    return Response(existing(content, "lot", lot), media_type="application/json")


@router.get("/{lot}/distributions", response_model=LotDistributions)
async def distributions(context: Context, lot: LotName, choosing: Choosing) -> Response:
    """Get the distributions of shape over a lot: b/a, c/b, sphericity, convexity, angularity, by mass and by number.

    The measures are those of a result. Each has its mean, its 10th, 50th and 90th percentile with 95 % intervals, and
    the share of each class.
    """
    content = await context.read_beside(as_json, lot_distributions, lot, choosing)
    return Response(existing(content, "lot", lot), media_type="application/json")


@router.get("/{lot}/algorithm-versions", response_model=LotVersions)
async def algorithm_versions(context: Context, lot: LotName) -> dict[str, Any]:
    """List the algorithm versions that have measured stones of a lot, each with the number of stones."""
    existing(await context.store.read(find_lot, lot), "lot", lot)
    found = await context.read_beside(versions_of_lot, lot)
    return {"items": [{"algorithm_version": version, "n_stones": n} for version, n in found.items()]}


@router.get("/{lot}/particles")
async def particles_behind_step(
    context: Context,
    lot: LotName,
    measuring: Measuring,
    sieve: Annotated[
        float | None,
        Query(gt=0, le=1000, description="Aperture of the upper sieve, mm; all stones when absent"),
    ] = None,
    limit: Annotated[int, Query(ge=1, le=1000, description="Stones of the answer, at most")] = 100,
) -> StonesBehindStep:
    """List the heaviest stones of a lot, or those behind a step of its curve.

    Behind a step are the stones that pass this sieve and not the next smaller one of the set.
    """
    record = existing(await context.store.read(find_lot, lot), "lot", lot)
    product = await context.store.read(find_product, record.product, record.product_version)
    apertures_mm = yardstick_of(product, measuring).apertures_mm
    above_mm = max((each for each in apertures_mm if sieve is not None and each < sieve), default=0.0)
    up_to_mm = inf if sieve is None else sieve
    items = await context.store.read(stones_behind, lot, above_mm, up_to_mm, limit)
    return StonesBehindStep(above_mm=above_mm, up_to_mm=sieve, items=items)


@windows.get("/current", response_model=LotFigures, responses=problem_responses(404))
async def current_window(
    context: Context, measuring: Figuring, minutes: Minutes = 60.0, product: ProductId = None
) -> Response:
    """Get the figures of the last minutes: of all that fell, in any lot or in none."""
    return await _figures(context, *last_minutes(minutes), product, measuring)


@windows.get("/shift", response_model=LotFigures, responses=problem_responses(404))
async def shift(
    context: Context,
    measuring: Figuring,
    ago: Annotated[int, Query(ge=0, le=1000, description="0: the present shift, 1: the one before")] = 0,
    product: ProductId = None,
) -> Response:
    """Get the figures of a shift; `[lots] shift_starts` says when they begin, by the host's local time."""
    found = shift_at(datetime.now(UTC).astimezone(), context.part(LotsSettings).shift_starts, ago)
    return await _figures(context, rfc3339(found.since), rfc3339(found.until), product, measuring)


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
    content = await context.read_beside(as_json, *given)
    return Response(existing(content, "product", str(product)), media_type="application/json")
