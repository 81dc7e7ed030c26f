"""What is learnt from results as they become durable: the watches of health read along."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

from service.processing.processing import ResultSink


class Watch(Protocol):
    """Whoever learns from results."""

    def feed(self, record: Mapping[str, Any]) -> None: ...


class WatchedResults:
    """The sink of all results, and the watches that read along."""

    def __init__(self, results: ResultSink, *watches: Watch) -> None:
        self._results = results
        self._watches = watches

    async def finish(
        self, session: int, bundle: str, record: Mapping[str, Any], files: Mapping[str, Path] | None = None
    ) -> int:
        """Pass a result on, then learn from it: what is said about the rig is durable."""
        seq = await self._results.finish(session, bundle, record, files)
        for watch in self._watches:
            watch.feed(record)
        return seq
