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


def gzipping(app: ASGIApp, reading: Reading) -> ASGIApp:
    """Compress the JSON of a few kB and more that `app` answers, unless it is compressed already."""

    async def compressing(scope: Scope, receive: Receive, send: Send) -> None:
        if not accepts_gzip(Headers(scope=scope)):
            await app(scope, receive, send)
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
                body = (
                    b"" if message.get("more_body") else await _compressed(message.get("body", b""), reading)
                )
                if body:
                    headers = MutableHeaders(scope=first)
                    headers["Content-Encoding"] = "gzip"
                    headers["Content-Length"] = str(len(body))
                    headers.add_vary_header("Accept-Encoding")
                    message = {**message, "body": body}
                await send(first)
                await send(message)

        await app(scope, receive, send_compressed)

    return compressing


async def _compressed(body: bytes, reading: Reading) -> bytes:
    """Return the body compressed, empty if it is to be sent as it is."""
    if is_gzipped(body):
        return body
    if len(body) < LEAST_BYTES:
        return b""
    if len(body) <= MAX_ON_LOOP_BYTES:
        return gzip.compress(body, LEVEL, mtime=0)
    try:
        return await reading.run(gzip.compress, body, LEVEL)
    except BusyError:
        return b""


def _is_json(start: Message) -> bool:
    return JSON.match(Headers(raw=start["headers"]).get("content-type", "")) is not None
