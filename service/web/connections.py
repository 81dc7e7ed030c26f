"""The connections of the REST server: each one must get on, and there are never too many.

uvicorn limits neither the time that a client takes to send its request, nor the time that it takes to read the answer,
nor the number of connections; and a process without free descriptors can open no camera and no file.
"""

import json
import resource
from asyncio import Transport
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import cache

import h11
from h11._receivebuffer import ReceiveBuffer
from starlette.requests import Request
from uvicorn.protocols.http.h11_impl import H11Protocol

from service.web.clients import host_of_client, origin_of
from service.web.pace import give_up_turn
from service.web.pieces import UNSENT
from service.web.problems import RETRY_AFTER_S, Problem, problem_document
from service.web.version import BASE

REQUEST_S = 10.0
"""Longest time for a whole request, body included, from its first byte; of the first one from connecting."""
READING_S = 30.0
"""Longest time in which a client may leave unread what it was sent."""
IN_VAIN_BYTES_S = 8_000_000
"""Rate at which the rest of all bodies is read whose requests are refused already; their clients get to the answer."""
MAX_UNREAD_BYTES = 64_000_000
"""Answers that all clients together may leave unread: pages of the feed have megabytes."""
MAX_CONNECTIONS = 256
"""With the daemon's own descriptors they stay below 1024, as the `select` of serial lines needs."""
MAX_REFUSED = 16
"""Connections beyond these that are told so, and have not closed yet."""


@cache
def max_connections() -> int:
    """Return the number of connections at a time: at most a quarter of the descriptors that the process may have."""
    n_descriptors, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return max(1, min(MAX_CONNECTIONS, n_descriptors // 4))


def max_of_address() -> int:
    """Return the number of connections of one client address: an eighth of all is left to the others."""
    return max_connections() - max_connections() // 8


class StrictHead(ReceiveBuffer):
    """The lines of a head, each of which ends with CR LF and begins with no blank (RFC 9112 2.2 and 5.2).

    h11 takes others too: a proxy that reads them otherwise may see another request than this server.
    """

    def maybe_extract_lines(self) -> list[bytearray] | None:
        """Return the lines up to the first blank one; raise `h11.RemoteProtocolError` for other ends of lines."""
        there = bytes(self)
        lines: list[bytearray] | None = super().maybe_extract_lines()
        head = there[: len(there) - len(self)]
        if head.count(b"\n") > head.count(b"\r\n") or b"\n " in head or b"\n\t" in head:
            raise h11.RemoteProtocolError("lines of a head end with CR LF and are not folded")
        return lines


class Connection(H11Protocol):
    """uvicorn's connection, with an end for clients that do not get on and for those that are too many."""

    def connection_made(self, transport: Transport) -> None:  # type: ignore[override]  # as uvicorn has it
        """Begin; when there are too many, the one that has waited longest without a request has to go.

        Too many of one address make room among themselves.
        """
        super().connection_made(transport)
        self.conn._receive_buffer = StrictHead()  # h11 has no other way to it
        self._began_s = self._read_all_s = self.loop.time()
        self._is_refused = False
        others = [each for each in self.connections if isinstance(each, Connection) and each is not self]
        served = [each for each in others if not each._is_refused]
        own = [each for each in served if each.address == self.address]
        if len(own) >= max_of_address():
            served = own
        elif len(served) < max_connections():
            return
        idle = [each for each in served if not each.is_being_answered]
        if idle:
            _oldest(idle).drop()
            return
        refused = [each for each in others if each._is_refused]
        if len(refused) >= MAX_REFUSED:
            _oldest(refused).drop()
        self._refuse(len(served))

    def data_received(self, data: bytes) -> None:
        if self._is_refused:
            return
        if self.timeout_keep_alive_task is not None:  # this is the first of another request
            self._began_s = self.loop.time()
        super().data_received(data)
        if self.is_sending_in_vain:
            n_such = sum(
                isinstance(each, Connection) and each.is_sending_in_vain for each in self.connections
            )
            self.flow.pause_reading()
            self.loop.call_later(len(data) * n_such / IN_VAIN_BYTES_S, self.flow.resume_reading)

    def connection_lost(self, exc: Exception | None) -> None:
        if self.cycle is not None:
            give_up_turn(self.cycle.scope["state"])
        super().connection_lost(exc)

    def on_response_complete(self) -> None:
        self._began_s = self.loop.time()
        super().on_response_complete()

    def send_400_response(self, msg: str) -> None:
        """Refuse a request that cannot be read to its end; what answers it already must not answer as well."""
        if self.conn.our_state in (h11.IDLE, h11.SEND_RESPONSE):
            super().send_400_response(msg)
        else:  # its answer was begun
            self.transport.close()
        if self.cycle is not None:
            self.cycle.disconnected = True

    def resume_writing(self) -> None:
        self._read_all_s = self.loop.time()
        super().resume_writing()

    def _unsupported_upgrade_warning(self) -> None:
        """Say nothing: clients in Java offer HTTP/2 with each request, and are content with HTTP/1.1."""

    @property
    def address(self) -> str | None:
        """Return the address of the client, None if it is gone already."""
        return None if self.client is None else self.client[0]

    @property
    def is_being_answered(self) -> bool:
        """True when the request is complete and its answer is not: a long poll may be so for long."""
        return self.cycle is not None and not (self.cycle.more_body or self.cycle.response_complete)

    @property
    def is_sending_in_vain(self) -> bool:
        """True when the request is answered although its body still comes."""
        return self.conn.our_state is h11.DONE and self.conn.their_state is h11.SEND_BODY

    @property
    def n_unread(self) -> int:
        """Return the bytes of the answer that wait for the client, beyond those in the kernel's buffers."""
        n_unsent = 0 if self.cycle is None else self.cycle.scope["state"].get(UNSENT, 0)
        return int(self.transport.get_write_buffer_size() + n_unsent)

    def is_overdue(self, now_s: float) -> bool:
        """True when the client has not sent its request, or not read its answer, in time; to be asked often."""
        if self.n_unread == 0:
            self._read_all_s = now_s
        is_idle = self.timeout_keep_alive_task is not None  # uvicorn ends it
        is_sending = not (self.is_being_answered or is_idle)
        return now_s - self._read_all_s > READING_S or (is_sending and now_s - self._began_s > REQUEST_S)

    def drop(self) -> None:
        """Close at once, without a word."""
        self.connections.discard(self)  # as uvicorn does, but only in the next round of the loop
        self.transport.abort()

    def _refuse(self, n_answered: int) -> None:
        # not closed: with its request unread that would take the answer from the client, which closes, or is overdue
        self._is_refused = True
        self.transport.write(_refusal(n_answered))
        self.transport.write_eof()


class OpenStreams:
    """Counts the streams of server-sent events by client: they last for days, and must leave room for others."""

    def __init__(self) -> None:
        self._open: Counter[str] = Counter()

    def require_room(self, request: Request) -> None:
        """Raise the problem 503 when a quarter of all connections are streams, or an address has too many of these.

        An eighth of them is left to other addresses; all may have the same one behind a proxy.
        """
        most = max(1, max_connections() // 4)
        n_own = self._open[origin_of(host_of_client(request))]
        if self._open.total() >= most or n_own >= most - most // 8:
            raise Problem(
                503,
                "too-many-connections",
                f"{self._open.total()} streams are open already, {n_own} of these of your address",
            )

    @contextmanager
    def one_more(self, request: Request) -> Iterator[None]:
        """Count one stream within the block."""
        address = origin_of(host_of_client(request))
        self._open[address] += 1
        try:
            yield
        finally:
            self._open[address] -= 1
            self._open = +self._open  # without addresses that have none


def _oldest(connections: Iterable[Connection]) -> Connection:
    return min(connections, key=lambda each: each._began_s)


def drop_hindering(connections: Iterable[object], now_s: float) -> None:
    """Drop the connections that are overdue, and the slowest readers as long as too much is unread."""
    alive = [each for each in connections if isinstance(each, Connection)]
    n_unread = 0
    for connection in sorted(alive, key=lambda each: each._read_all_s, reverse=True):
        n_unread += connection.n_unread
        if connection.is_overdue(now_s) or n_unread > MAX_UNREAD_BYTES:
            n_unread -= connection.n_unread
            connection.drop()


@cache
def _refusal(n_answered: int) -> bytes:
    """Return the answer to a connection that is one too many, whose request is not read."""
    problem = Problem(503, "too-many-connections", f"{n_answered} requests are being answered already")
    body = json.dumps(problem_document(problem, BASE)).encode()
    head = (
        "HTTP/1.1 503 Service Unavailable",
        "Content-Type: application/problem+json",
        f"Content-Length: {len(body)}",
        f"Retry-After: {RETRY_AFTER_S}",
        "Connection: close",
    )
    return "\r\n".join([*head, "", ""]).encode() + body
