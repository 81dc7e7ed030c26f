"""Pass durable results on to the watches of health."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

from service.processing.processing import ResultSink


class Watch(Protocol):
    """An observer of all results, in their order."""

    def feed(self, record: Mapping[str, Any]) -> None: ...


class WatchedResults:
    """A sink of results that feeds them to watches as well."""

    def __init__(self, results: ResultSink, *watches: Watch) -> None:
        self._results = results
        self._watches = watches

    async def finish(
        self, session: int, bundle: str, record: Mapping[str, Any], files: Mapping[str, Path] | None = None
    ) -> int:
        """Make a result durable, then feed it to the watches: what they report of the rig rests on durable results."""
        seq = await self._results.finish(session, bundle, record, files)
        for watch in self._watches:
            watch.feed(record)
        return seq
