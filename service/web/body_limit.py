"""Refuse request bodies that are too large or too fine, announced in the header or not."""

from starlette.requests import Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.web.problems import Problem, problem_response

MOST_PARTS = 5000
"""Most quotes, brackets and braces of a body: it is parsed and checked on the event loop, field by field."""


class BodyLimit:
    """ASGI middleware that answers 413 to bodies above `max_body_bytes`, 422 to those of more than `MOST_PARTS`."""

    def __init__(self, app: ASGIApp, max_body_bytes: int) -> None:
        self._app = app
        self._max_body_bytes = max_body_bytes

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        request = Request(scope)
        announced = request.headers.get("content-length", "0")
        if not announced.isdecimal() or int(announced) > self._max_body_bytes:
            await problem_response(request, self._too_large())(scope, receive, send)
            return
        n_bytes = n_parts = 0

        async def counted() -> Message:
            nonlocal n_bytes, n_parts
            message = await receive()
            piece = message.get("body", b"")
            n_bytes += len(piece)
            if n_bytes > self._max_body_bytes:
                raise self._too_large()
            n_parts += sum(map(piece.count, (b'"', b"[", b"{")))
            if n_parts > MOST_PARTS:
                raise Problem(
                    422,
                    "invalid-request",
                    f"a request body may have at most {MOST_PARTS} quotes, brackets and braces",
                )
            return message

        await self._app(scope, counted, send)

    def _too_large(self) -> Problem:
        return Problem(
            413, "content-too-large", f"a request body may have at most {self._max_body_bytes} bytes"
        )
