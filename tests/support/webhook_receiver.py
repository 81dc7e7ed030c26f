"""An endpoint of webhooks on loopback, which answers as a test says, and checks signatures as a receiver does."""

import asyncio
import base64
import hashlib
import hmac
import json
import ssl
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from support.eventually import PATIENCE_S

CERTIFICATE = Path(__file__).with_name("localhost.pem")
"""Certificate of `localhost`, signed by itself, with its key: for tests, and no secret."""
KEY, OTHER_KEY = b"k" * 24, b"o" * 32
TAKEN = b"HTTP/1.1 204 No Content\r\n\r\n"
NEVER = b""
"""The answer of an endpoint that does not answer, until `release`."""


def secret_of(key: bytes) -> str:
    return f"whsec_{base64.b64encode(key).decode()}"


SECRET, OTHER_SECRET = secret_of(KEY), secret_of(OTHER_KEY)


def answer(status: int, **headers: str) -> bytes:
    """Return an answer with this status."""
    lines = [f"{name.replace('_', '-')}: {value}\r\n" for name, value in headers.items()]
    return f"HTTP/1.1 {status} x\r\n{''.join(lines)}Content-Length: 0\r\n\r\n".encode()


def is_signed(headers: dict[str, str], body: bytes, key: bytes) -> bool:
    """Return whether one of the signatures is by this key."""
    signed = f"{headers['webhook-id']}.{headers['webhook-timestamp']}.".encode() + body
    wanted = "v1," + base64.b64encode(hmac.digest(key, signed, hashlib.sha256)).decode()
    return wanted in headers["webhook-signature"].split(" ")


@dataclass(frozen=True, slots=True, kw_only=True)
class Request:
    """What was received."""

    line: str
    headers: dict[str, str]
    body: bytes

    @property
    def id(self) -> str:
        return self.headers["webhook-id"]

    @property
    def document(self) -> dict[str, Any]:
        return dict(json.loads(self.body))

    @property
    def event(self) -> int:
        return int(self.document["data"]["seq"])


class Receiver:
    """Answers requests one after the other with `answers`, then with 204; `endless` follows until it is refused."""

    def __init__(
        self, answers: Iterable[bytes] = (), *, endless: bytes = b"", with_tls: bool = False
    ) -> None:
        self._answers = list(answers)
        self._endless = endless
        self._tls: ssl.SSLContext | None = None
        if with_tls:
            self._tls = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
            self._tls.load_cert_chain(CERTIFICATE)
        self._changed = asyncio.Condition()
        self._released = asyncio.Event()
        self._serving: set[asyncio.Task[None]] = set()
        self.requests: list[Request] = []
        self.n_connections = 0
        self.n_refused = 0  # endless answers that were refused

    async def __aenter__(self) -> Self:
        self._server = await asyncio.start_server(self._serve, "127.0.0.1", 0, ssl=self._tls)
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._server.close()
        for task in self._serving:
            task.cancel()
        await asyncio.gather(*self._serving, return_exceptions=True)

    @property
    def port(self) -> int:
        return int(self._server.sockets[0].getsockname()[1])

    @property
    def ids(self) -> list[str]:
        return [request.id for request in self.requests]

    @property
    def events(self) -> list[int]:
        return [request.event for request in self.requests]

    def answer_next(self, *answers: bytes) -> None:
        """Give these answers before any others."""
        self._answers[:0] = answers

    def release(self) -> None:
        """Have requests that are not answered taken now."""
        self._released.set()

    async def received(self, n_requests: int) -> list[Request]:
        """Return the requests once there are so many."""
        return await self.until(lambda: len(self.requests) >= n_requests)

    async def until(self, is_so: Callable[[], bool]) -> list[Request]:
        """Return the requests once it is so."""
        async with asyncio.timeout(PATIENCE_S), self._changed:
            await self._changed.wait_for(is_so)
        return self.requests

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._serving.add(task)
        self.n_connections += 1
        try:
            with suppress(ConnectionError, asyncio.IncompleteReadError):
                await self._answer(reader, writer)
        finally:
            self._serving.discard(task)
            writer.transport.abort()

    async def _answer(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        line, *lines = (await reader.readuntil(b"\r\n\r\n")).decode().splitlines()
        headers = dict(each.split(": ", 1) for each in lines if each)
        body = await reader.readexactly(int(headers["Content-Length"]))
        given = self._answers.pop(0) if self._answers else TAKEN
        async with self._changed:
            self.requests.append(Request(line=line, headers=headers, body=body))
            self._changed.notify_all()
        if given == NEVER:
            await self._released.wait()
            given = TAKEN
        writer.write(given)
        await writer.drain()
        try:
            while self._endless:
                writer.write(self._endless)
                await writer.drain()
        except ConnectionError:
            async with self._changed:
                self.n_refused += 1
                self._changed.notify_all()
