"""Everything that an operator's page shows at a glance, once and as server-sent events."""

from collections.abc import AsyncGenerator
from typing import Annotated

from fastapi import APIRouter, Depends, Request, Response

from service.daemon.overview.overview_documents import OverviewDocument
from service.daemon.overview.overviews import Overviews
from service.web.auth import READABLE
from service.web.context import ApiContext, Context
from service.web.streams import EventStream, OpenStream, may_read

router = APIRouter(prefix="/overview", tags=["overview"], dependencies=READABLE)


async def _overviews(request: Request) -> Overviews:
    made: Overviews = request.app.state.overviews
    return made


Made = Annotated[Overviews, Depends(_overviews)]


@router.get("", response_model=OverviewDocument)
async def overview(overviews: Made) -> Response:
    """Get the overview: state, lot, main figures, counts, cameras, alarms and the newest stones in one document.

    It is made once for all who ask within a second, and what takes long in it beside the measuring.
    """
    found = await overviews.now()
    return Response(found.content, media_type="application/json", headers={"Cache-Control": "no-store"})


@router.get("/stream", response_class=EventStream)
async def overview_stream(request: Request, context: Context, overviews: Made) -> OpenStream:
    """Stream the overview as server-sent events: an `overview` at once, then whenever it is another one.

    At most one comes in 0.7 s; one that does not change comes again after 5 s, so hear nothing for 10 s, and connect
    again. Ages and temperatures alone are no change. What goes wrong later is an event `problem`, the last one.
    """
    context.streams.require_room(request)
    return OpenStream(context, _chunks(context, overviews, request), request)


async def _chunks(context: ApiContext, overviews: Overviews, request: Request) -> AsyncGenerator[bytes, None]:
    await may_read(request, context)
    found = await overviews.now()
    while True:
        yield b"event: overview\ndata: " + found.content + b"\n\n"
        if context.store.is_released:
            return
        found = await overviews.another_than(found.version)
        await may_read(request, context)
        await context.waking.turn()
