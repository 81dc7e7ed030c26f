"""Documents and drawings of the reading process: made once for all who ask the same."""

from collections.abc import Callable, Hashable
from functools import partial

from fastapi import Request, Response

from service.web.context import ApiContext
from service.web.etags import NOT_MODIFIED, Responses, etag, unchanged

MEDIA_TYPE = "image/svg+xml"
SVG: Responses = {200: {"content": {MEDIA_TYPE: {}}}, **NOT_MODIFIED}
"""How routes describe their drawing."""
POLICY = "default-src 'none'; style-src 'unsafe-inline'"
"""What a browser lets a drawing do that is opened by itself: it has no scripts and loads nothing."""


async def shared(
    context: ApiContext, function: Callable[..., str | None], *arguments: Hashable, keep_s: float
) -> str | None:
    """Return `function(connection, *arguments)`, made in the reading process, once for all who ask the same.

    It is kept for a time, as long as there is no new result and no new event.
    """
    question = (function, arguments, context.store.last_seq, context.store.last_event)
    make = partial(context.read_beside, function, *arguments)
    return await context.shared.get(question, make, keep_s=keep_s)


def svg_answer(asked: Request, text: str) -> Response:
    """Return the answer with a drawing, or that the client has it."""
    tag = etag(text)
    headers = {"ETag": tag, "Cache-Control": "private, no-cache", "Content-Security-Policy": POLICY}
    return unchanged(asked, tag) or Response(text, media_type=MEDIA_TYPE, headers=headers)
