"""JSON is compressed for clients that ask for it: what is small on the event loop, what is big where it is made."""

import gzip
import re
from typing import Annotated

from fastapi import Depends, Request
from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.web.pages import LEAST_BYTES, LEVEL, is_gzipped
from service.web.reader_process import BusyError, Reading

MAX_ON_LOOP_BYTES = 64_000
"""Beyond, the reading process compresses: this much takes the loop 0.9 ms."""
JSON = re.compile(r"application/(problem\+)?json\b")


def accepts_gzip(headers: Headers) -> bool:
    """True when a client accepts gzip."""
    for part in headers.get("accept-encoding", "").lower().split(","):
        coding, _, weight = part.partition(";")
        if coding.strip() in ("gzip", "*"):
            return re.fullmatch(r"\s*q=0(\.0*)?\s*", weight) is None
    return False


async def takes_gzip(request: Request) -> bool:
    """True when the client of a request accepts gzip."""
    return accepts_gzip(request.headers)


TakesGzip = Annotated[bool, Depends(takes_gzip)]


class GzippedJson:
    """ASGI middleware that compresses JSON of a few kB and more, unless it is compressed already."""

    def __init__(self, app: ASGIApp, reading: Reading) -> None:
        self._app = app
        self._reading = reading

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http" or not accepts_gzip(Headers(scope=scope)):
            await self._app(scope, receive, send)
            return
        start: Message | None = None

        async def send_compressed(message: Message) -> None:
            nonlocal start
            if message["type"] == "http.response.start" and _is_json(message):
                start = message
            elif start is None:
                await send(message)
            else:
                first, start = start, None
                body = b"" if message.get("more_body") else await self._compressed(message.get("body", b""))
                if body:
                    _announce(first, len(body))
                    message = {**message, "body": body}
                await send(first)
                await send(message)

        await self._app(scope, receive, send_compressed)

    async def _compressed(self, body: bytes) -> bytes:
        """Return the body compressed, empty if it is to be sent as it is."""
        if is_gzipped(body):
            return body
        if len(body) < LEAST_BYTES:
            return b""
        if len(body) <= MAX_ON_LOOP_BYTES:
            return gzip.compress(body, LEVEL, mtime=0)
        try:
            return await self._reading.run(gzip.compress, body, LEVEL)
        except BusyError:
            return b""


def _is_json(start: Message) -> bool:
    return JSON.match(Headers(raw=start["headers"]).get("content-type", "")) is not None


def _announce(start: Message, n_bytes: int) -> None:
    headers = MutableHeaders(scope=start)
    headers["Content-Encoding"] = "gzip"
    headers["Content-Length"] = str(n_bytes)
    headers.add_vary_header("Accept-Encoding")
