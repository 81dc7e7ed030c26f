"""The number of streams of server-sent events: they last for days, and must leave connections to everything else."""

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager

from fastapi import Request

from service.web.clients import host_of_client, origin_of
from service.web.connections import max_connections
from service.web.problems import Problem


class OpenStreams:
    """Counts the streams that are open, by the address of their client."""

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
