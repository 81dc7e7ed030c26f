"""A viewer of the operator's page without a browser: it asks for what the page's scripts ask for."""

import asyncio
import json
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import Any
from urllib.parse import quote, urlsplit

SHEET_S, TRENDS_S = 5.0, 60.0
"""How often the page asks for the contact sheet and a trend."""
MAX_STONES = 12


class Viewer:
    """One stream of the overview, and one connection for everything else."""

    def __init__(
        self, url: str, answer: Callable[[str], Awaitable[bytes]], times_s: dict[str, list[float]]
    ) -> None:
        self._address = urlsplit(url)
        self._answer = answer
        self._times_s = times_s
        self._overview: dict[str, Any] = {}
        self._pictures: list[int] = []  # of stones whose picture is not asked for yet, the newest last
        self._known = 0  # the newest stone that was on the page
        self._due_s = {"sheet": 0.0, "trends": 0.0}
        self._shown: dict[str, Any] = {}

    async def watch(self) -> None:
        """Look at the page until cancelled."""
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self._follow())
            tasks.create_task(self._load())

    async def _follow(self) -> None:
        heard_s = time.monotonic()
        async for overview in self._overviews():
            self._times_s["between overviews"].append(time.monotonic() - heard_s)
            heard_s = time.monotonic()
            self._overview = overview
            new = [stone["seq"] for stone in reversed(overview["newest"]) if stone["has_mesh"]]
            self._pictures = (self._pictures + [seq for seq in new if seq > self._known])[-MAX_STONES:]
            self._known = max(self._known, overview["last_seq"])

    async def _load(self) -> None:
        while True:
            for question in self._questions(time.monotonic()):
                began_s = time.monotonic()
                await self._answer(question)
                self._times_s[question.rsplit(".", 1)[-1].partition("?")[0]].append(
                    time.monotonic() - began_s
                )
            await asyncio.sleep(0.05)

    def _questions(self, now_s: float) -> list[str]:
        """Return what the page asks for now."""
        if not self._overview:
            return []
        questions = []
        figures = self._overview["figures"]
        if figures is not None and self._is_new("curve", figures["version"]):
            lot = figures["lot"]
            questions.append(f"{'/windows/current' if lot is None else f'/lots/{quote(lot)}'}/curve.svg")
        if self._is_new("alarms", self._overview["alarms"]):
            questions.append("/alarms?language=de")
        if self._is_due("sheet", SHEET_S, now_s):
            questions.append("/cameras/contact-sheet.jpg")
        if self._is_due("trends", TRENDS_S, now_s):
            questions += ["/diary/changes?hours=1", "/trends/d50.svg?hours=1"]
        if self._pictures:
            questions.append(f"/particles/{self._pictures.pop()}/preview.png?size_px=240")
        return questions

    def _is_new(self, what: str, value: Any) -> bool:
        is_new = self._shown.get(what) != value
        self._shown[what] = value
        return is_new

    def _is_due(self, what: str, every_s: float, now_s: float) -> bool:
        if now_s < self._due_s[what]:
            return False
        self._due_s[what] = now_s + every_s
        return True

    async def _overviews(self) -> AsyncIterator[dict[str, Any]]:
        """Yield each overview of the stream."""
        reader, writer = await asyncio.open_connection(
            self._address.hostname, self._address.port, limit=1 << 20
        )
        try:
            path = f"{self._address.path}/overview/stream"
            writer.write(f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n".encode())
            await reader.readuntil(b"\r\n\r\n")
            buffer = b""
            while n_bytes := int(await reader.readline(), 16):  # chunked
                buffer += (await reader.readexactly(n_bytes + 2))[:-2]
                *events, buffer = buffer.split(b"\n\n")
                for event in events:
                    if event.startswith(b"event: overview\n"):
                        yield json.loads(event.partition(b"\ndata: ")[2])
        finally:
            writer.close()
