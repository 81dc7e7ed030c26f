"""A client of server-sent events that reads them one by one."""

import asyncio
import json
from dataclasses import dataclass
from typing import Any

from support.served import PATIENCE_S, Client, Served

HEAD = "Host: localhost\r\n"


@dataclass(frozen=True)
class SentEvent:
    event: str
    data: dict[str, Any]
    id: int | None


class Stream:
    """A client of server-sent events that can be read one by one."""

    def __init__(self, client: Client) -> None:
        self.client = client
        self._lines: list[str] = []

    async def head(self) -> str:
        async with asyncio.timeout(PATIENCE_S):
            return (await self.client.reader.readuntil(b"\r\n\r\n")).decode()

    async def _line(self) -> str | None:
        """Return the next line, None at the end; chunks of HTTP/1.1 may end anywhere."""
        while len(self._lines) < 2:
            size = int((await self.client.reader.readline()).strip() or b"0", 16)
            chunk = await self.client.reader.readexactly(size + 2)
            if size == 0:
                return None
            *whole, rest = ("".join(self._lines) + chunk[:-2].decode()).split("\n")
            self._lines = [*whole, rest]
        return self._lines.pop(0)

    async def comment_or_event(self) -> SentEvent | str | None:
        """Return the next event, or comment, None at the end."""
        fields: dict[str, str] = {}
        async with asyncio.timeout(PATIENCE_S):
            while True:
                line = await self._line()
                if line is None:
                    return None
                if line.startswith(":"):
                    assert await self._line() == ""
                    return line
                if line == "":
                    number = fields.get("id")
                    return SentEvent(
                        fields["event"], json.loads(fields["data"]), None if number is None else int(number)
                    )
                name, _, value = line.partition(": ")
                fields[name] = value

    async def next(self) -> SentEvent | None:
        while isinstance(found := await self.comment_or_event(), str):
            pass
        return found

    async def numbers(self, n: int) -> list[int | None]:
        found = [await self.next() for _ in range(n)]
        return [None if each is None else each.id for each in found]


async def opened(
    served: Served, path: str = "/results/stream", more: str = "", address: str = "127.0.0.1"
) -> Stream:
    client = await served.connect(f"GET /api/v1{path} HTTP/1.1\r\n{HEAD}{more}\r\n".encode(), address)
    return Stream(client)
