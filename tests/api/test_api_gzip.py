"""JSON is compressed for clients that ask for it, big answers beside the daemon, files never."""

import asyncio
import gzip
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import httpx
import pytest
from support.outcomes import add, measured
from support.rest import FakeControl, ReadingThread, app_of, client_of, particle_files

from service.store import Store
from service.web import gzipped
from service.web.reader_process import BusyError

T = TypeVar("T")
GZIP = {"Accept-Encoding": "gzip"}
PLAIN = {"Accept-Encoding": "identity"}


async def raw(client: httpx.AsyncClient, path: str, headers: dict[str, str]) -> tuple[httpx.Response, bytes]:
    """Return an answer, and its bytes as they were sent."""
    async with client.stream("GET", path, headers=headers) as answer:
        sent = b"".join([chunk async for chunk in answer.aiter_raw()])
    return answer, sent


@pytest.mark.parametrize(
    "path",
    ["/results", "/results?fields=lean", "/results?limit=1000", "/particles", "/openapi.json", "/lots/none"],
)
async def test_compressed_or_not_it_is_the_same(
    client: httpx.AsyncClient, store: Store, session: int, path: str
) -> None:
    for number in range(1, 31):
        await add(store, session, number, measured())
    plain, content = await raw(client, path, {**PLAIN, "X-Request-Id": "one"})
    assert "Content-Encoding" not in plain.headers
    answer, sent = await raw(client, path, {**GZIP, "X-Request-Id": "one"})
    assert int(answer.headers["Content-Length"]) == len(sent)
    if len(content) < 2000:
        assert ("Content-Encoding" in answer.headers, sent) == (False, content)
    else:
        assert (answer.headers["Content-Encoding"], answer.headers["Vary"]) == ("gzip", "Accept-Encoding")
        assert len(sent) < 0.5 * len(content)
        assert gzip.decompress(sent) == content


@pytest.mark.parametrize(
    ("accepted", "is_gzip"),
    [("gzip", True), ("br, GZIP;q=0.5", True), ("*", True), ("gzip;q=0", False), ("br", False), ("", False)],
)
async def test_only_those_who_ask_for_it_get_it(
    client: httpx.AsyncClient, accepted: str, is_gzip: bool
) -> None:
    answer, _ = await raw(client, "/openapi.json", {"Accept-Encoding": accepted})
    assert ("Content-Encoding" in answer.headers) == is_gzip


async def test_files_are_not_compressed_again(
    client: httpx.AsyncClient, store: Store, session: int, tmp_path: Path
) -> None:
    await add(store, session, 1, measured(), await asyncio.to_thread(particle_files, tmp_path / "out"))
    for path in ("/particles/1/mesh.ply", "/particles/1/preview.png", "/docs"):
        answer, _ = await raw(client, path, GZIP)
        assert (answer.status_code, "Content-Encoding" in answer.headers) == (200, False)


class Recording(ReadingThread):
    """A place to read that notes what it is asked for; busy on request."""

    def __init__(self) -> None:
        self.asked: list[Callable[..., Any]] = []
        self.is_busy = False

    async def run(self, function: Callable[..., T], *arguments: object) -> T:
        self.asked.append(function)
        if self.is_busy:
            raise BusyError("too many")
        return await super().run(function, *arguments)


async def test_what_is_big_is_compressed_beside_the_daemon_or_not_at_all(
    store: Store, control: FakeControl, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gzipped, "MAX_ON_LOOP_BYTES", 10_000)
    reading = Recording()
    async with client_of(app_of(store, control, reading=reading)) as client:
        answer, _ = await raw(client, "/openapi.json", GZIP)
        assert (answer.headers["Content-Encoding"], reading.asked) == ("gzip", [gzip.compress])
        reading.is_busy = True
        answer, sent = await raw(client, "/openapi.json", GZIP)
        assert ("Content-Encoding" in answer.headers, sent[:1]) == (False, b"{")
