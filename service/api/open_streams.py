"""The number of streams of server-sent events: they last for days, and must leave connections to everything else."""

from collections.abc import Iterator
from contextlib import contextmanager

from service.api.connections import max_connections
from service.api.problems import Problem


class OpenStreams:
    """Counts the streams that are open."""

    def __init__(self) -> None:
        self._n = 0

    def require_room(self) -> None:
        """Raise the problem 503 when a quarter of all connections are streams."""
        if self._n >= max(1, max_connections() // 4):
            raise Problem(503, "too-many-connections", f"{self._n} streams are open already")

    @contextmanager
    def one_more(self) -> Iterator[None]:
        """Count one stream within the block."""
        self._n += 1
        try:
            yield
        finally:
            self._n -= 1
