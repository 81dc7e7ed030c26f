"""The REST interface as one task of the daemon: uvicorn, whose socket is bound first and whose end is the daemon's.

uvicorn gets no say in signals, logging and start-up events.
"""

import asyncio
import socket
from collections.abc import Iterator
from contextlib import contextmanager

import uvicorn
from fastapi import FastAPI

from service.api.settings import ApiSettings
from service.errors import ServiceError


class RestServer(uvicorn.Server):
    """uvicorn without its own ideas about signals, and with an event for the moment it serves."""

    def __init__(self, config: uvicorn.Config) -> None:
        super().__init__(config)
        self.is_serving = asyncio.Event()

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        yield

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        self.is_serving.set()


def listen(host: str, port: int) -> socket.socket:
    """Listen before anything else is started: an address in use is an error of the first second.

    Raises
    ------
    ServiceError
        Naming the address.
    """
    try:
        family, _, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        return socket.create_server(address[:2], family=family)
    except OSError as err:
        raise ServiceError(f"api: cannot listen on {host} port {port}: {err.strerror}") from err


def server_config(app: FastAPI, settings: ApiSettings) -> uvicorn.Config:
    """Give a configuration without uvicorn's own logging, banner and start-up events."""
    return uvicorn.Config(
        app,
        host=settings.host,
        port=settings.port,
        lifespan="off",
        log_config=None,
        access_log=False,
        server_header=False,
        ws="none",
        timeout_keep_alive=30,
        timeout_graceful_shutdown=5,
    )
