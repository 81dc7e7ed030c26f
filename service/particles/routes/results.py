"""The feed: every outcome in order, for a client that keeps its own position."""

from dataclasses import replace
from operator import attrgetter
from typing import Annotated

from fastapi import APIRouter, Depends, Query
from fastapi.responses import Response
from pydantic import Field

from service.base.schema import GivenTime
from service.particles.pages import Names, served_after
from service.results.fields import Result, UnknownFieldsError, chosen_fields
from service.store.reads import seq_before
from service.web.auth import READABLE
from service.web.context import Context
from service.web.feeds import MAX_SEQ, page_after, require_within
from service.web.gzipped import TakesGzip
from service.web.pages import CursorPage, Feed
from service.web.problems import invalid_request, problem_responses

router = APIRouter(prefix="/results", tags=["results"], dependencies=READABLE)

RESULTS = Feed(kind="result", find=served_after, is_large=True, last=attrgetter("last_seq"))


class ResultsPage(CursorPage):
    """One page of the feed. Ask again with `after = next_after`; every result is delivered at least once."""

    items: list[Result] = Field(description="In the order of `seq`; empty when there is nothing new")


async def fields_of(
    fields: Annotated[
        str | None,
        Query(
            max_length=2000,
            description="Only these fields of each result, separated by commas; `lean`: those that a MES needs, under"
            " 1 kB. `seq`, `id`, `revision`, `kind`, `outcome`, `is_simulated` and `is_replay` are always there",
            examples=["lean", "sieve_size_mm,mass_g"],
        ),
    ] = None,
) -> Names:
    """Return the fields of a result that a request asks for."""
    try:
        return None if fields is None else chosen_fields(fields)
    except UnknownFieldsError as err:
        raise invalid_request(("query.fields", str(err))) from err


ChosenFields = Annotated[Names, Depends(fields_of)]


@router.get("", response_model=ResultsPage, responses=problem_responses(409, 410))
async def results(
    context: Context,
    names: ChosenFields,
    as_gzip: TakesGzip,
    after: Annotated[
        int, Query(ge=0, le=MAX_SEQ, description="`seq` of the last result you have; 0: from the beginning")
    ] = 0,
    limit: Annotated[int, Query(ge=1, le=1000, description="Results of a page, at most")] = 100,
    wait_s: Annotated[
        float, Query(ge=0, le=30, description="Longest wait for a result when there is none yet, s")
    ] = 0,
    since: Annotated[
        GivenTime | None,
        Query(
            description="Begin with the first result that became durable (`recorded_at`) at or after this time,"
            " RFC 3339, instead of `after`: to find a cursor. Then go on with `next_after`"
        ),
    ] = None,
) -> Response:
    """Follow the results: those after `after`, in order, without gaps, each at least once.

    A stone that was measured again comes again: an item with the same `id`, the next `revision`, and in `revises` the
    `seq` of the item whose place it takes. Store by `id`, and the newest wins.

    410 `cursor-expired`: results after `after` are no longer kept, the feed begins at `first_seq`. 409 `cursor-ahead`:
    the feed has not reached `after`, as when the store was replaced or restored from a backup.
    """
    if since is not None:
        if after > 0:
            raise invalid_request(
                ("query.since", "gives the place that `after` gives: leave out one of them")
            )
        after = await context.store.read(seq_before, since)
    feed = replace(RESULTS, choice=names, as_gzip=as_gzip)
    page = await page_after(context, feed, after, limit, wait_s)
    require_within(page.cursor, after, RESULTS.kind)
    return Response(page.content, media_type="application/json")
