"""Refuse request bodies that are too large or too fine, announced in the header or not."""

from starlette.requests import Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.web.problems import Problem, problem_response

MOST_PARTS = 5000
"""Most quotes, brackets and braces of a body: it is parsed and checked on the event loop, field by field."""


def with_body_limit(app: ASGIApp, max_body_bytes: int) -> ASGIApp:
    """Answer 413 to bodies above `max_body_bytes`, 422 to those of more than `MOST_PARTS`; the others are for `app`."""
    too_large = f"a request body may have at most {max_body_bytes} bytes"

    async def limited(scope: Scope, receive: Receive, send: Send) -> None:
        request = Request(scope)
        announced = request.headers.get("content-length", "0")
        if not announced.isdecimal() or int(announced) > max_body_bytes:
            problem = Problem(413, "content-too-large", too_large)
            await problem_response(request, problem)(scope, receive, send)
            return
        n_bytes = n_parts = 0

        async def counted() -> Message:
            nonlocal n_bytes, n_parts
            message = await receive()
            piece = message.get("body", b"")
            n_bytes += len(piece)
            if n_bytes > max_body_bytes:
                raise Problem(413, "content-too-large", too_large)
            n_parts += sum(map(piece.count, (b'"', b"[", b"{")))
            if n_parts > MOST_PARTS:
                detail = f"a request body may have at most {MOST_PARTS} quotes, brackets and braces"
                raise Problem(422, "invalid-request", detail)
            return message

        await app(scope, counted, send)

    return limited
