"""A real REST server on loopback, and clients that speak HTTP by hand."""

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import AsyncExitStack, asynccontextmanager, suppress
from dataclasses import dataclass

from fastapi import FastAPI

from service.web.connections import Connection, drop_hindering
from service.web.server import RestServer, listen, server_config
from service.web.settings import ApiSettings

PATIENCE_S = 300.0


@dataclass(frozen=True)
class Client:
    reader: asyncio.StreamReader
    writer: asyncio.StreamWriter

    def send(self, data: bytes) -> None:
        self.writer.write(data)

    async def rest(self) -> bytes:
        """Return what comes until the server closes, and close as well."""
        received = bytearray()
        with suppress(ConnectionError):
            async with asyncio.timeout(PATIENCE_S):
                while chunk := await self.reader.read(65536):
                    received += chunk
        self.writer.close()
        return bytes(received)


@dataclass(frozen=True)
class Served:
    server: RestServer
    port: int
    clients: AsyncExitStack
    began_s: float  # by the clock of the event loop

    @property
    def connections(self) -> set[Connection]:
        return self.server.server_state.connections

    async def connect(self, data: bytes = b"", address: str = "127.0.0.1") -> Client:
        client = Client(*await asyncio.open_connection("127.0.0.1", self.port, local_addr=(address, 0)))
        self.clients.callback(client.writer.close)
        client.send(data)
        return client

    async def until(self, is_so: Callable[[], bool]) -> None:
        async with asyncio.timeout(PATIENCE_S):
            while not is_so():  # noqa: ASYNC110 - the server has no event for it
                await asyncio.sleep(0.005)

    def pass_time(self, seconds: float) -> None:
        """Look after the connections as if so much time had passed."""
        drop_hindering(self.connections, asyncio.get_running_loop().time() + seconds)

    def pass_time_since_start(self, seconds: float) -> None:
        """Look after them as if that were all since the server began: nothing has waited longer, if slowly."""
        drop_hindering(self.connections, self.began_s + seconds)


@asynccontextmanager
async def served_by(app: FastAPI, settings: ApiSettings | None = None) -> AsyncIterator[Served]:
    server = RestServer(server_config(app, settings or ApiSettings()))
    with listen("127.0.0.1", 0) as listener:
        async with AsyncExitStack() as clients:
            serving = asyncio.create_task(server.serve([listener]))
            await server.is_serving.wait()
            yield Served(server, listener.getsockname()[1], clients, asyncio.get_running_loop().time())
        server.should_exit = True
        await serving
