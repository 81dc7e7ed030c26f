"""uvicorn as one task of the daemon, which keeps signals, logging, and the moment of start and stop to itself."""

import asyncio
import socket
from collections.abc import Iterator
from contextlib import contextmanager

import uvicorn
from fastapi import FastAPI

from service.base.errors import ServiceError
from service.web.connections import Connection, drop_hindering, max_connections
from service.web.settings import ApiSettings

MAX_ACCEPTED_AT_ONCE = 64
"""Connections accepted in one round of the loop: these come on top of the limit, and hold the loop meanwhile."""
MAX_WAITING = 1024
"""Connections that wait in the kernel to be accepted; a burst of clients is slowed down, not turned away."""
TICKS_A_SECOND = 10


class RestServer(uvicorn.Server):
    """uvicorn without signal handlers of its own, with an event that is set once it serves, and with time-outs."""

    def __init__(self, config: uvicorn.Config) -> None:
        super().__init__(config)
        self.is_serving = asyncio.Event()

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        yield

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        for listener in sockets or ():
            listener.listen(MAX_WAITING)  # asyncio's `backlog` is both, accepted at once and waiting
        self.is_serving.set()

    async def on_tick(self, counter: int) -> bool:
        if counter % TICKS_A_SECOND == 0:
            drop_hindering(self.server_state.connections, asyncio.get_running_loop().time())
        return await super().on_tick(counter)


def listen(host: str, port: int) -> socket.socket:
    """Return a listening socket; bound before anything else starts, so that an address in use shows at once.

    Raises `ServiceError`, which names the address, when it cannot be listened on.
    """
    try:
        family, _, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        return socket.create_server(address[:2], family=family)
    except OSError as err:
        raise ServiceError(f"api: cannot listen on {host} port {port}: {err.strerror}") from err


def server_config(app: FastAPI, settings: ApiSettings) -> uvicorn.Config:
    """Return uvicorn's configuration, without its own logging, banner and start-up events."""
    return uvicorn.Config(
        app,
        host=settings.host,
        port=settings.port,
        lifespan="off",
        log_config=None,
        access_log=False,
        server_header=False,
        proxy_headers=bool(
            settings.trusted_proxies
        ),  # uvicorn's default is to believe every peer on loopback
        forwarded_allow_ips=list(settings.trusted_proxies),
        http=Connection,
        ws="none",
        backlog=max(1, min(MAX_ACCEPTED_AT_ONCE, max_connections() // 4)),
        timeout_keep_alive=30,
        timeout_graceful_shutdown=5,
    )
