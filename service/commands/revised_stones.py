"""The stones of a lot of a running daemon, as two versions of the algorithm or two revisions say."""

import re
from collections.abc import Callable, Iterator
from typing import Any

from service.base.errors import UsageError
from service.commands.daemon_client import all_pages, ask

PAGE = 500
REVISION = re.compile("r([0-9]{1,6})")

Stones = dict[str, dict[str, Any]]


def revisions_of_lot(url: str, key: str | None, lot: str, sides: tuple[str, str]) -> tuple[Stones, Stones]:
    """Return the records by id, of each stone the newest that is of a side: an algorithm version, or rN.

    Raises
    ------
    DaemonError
        The daemon does not answer, or refuses.
    UsageError
        A side has no stone in the lot.
    """
    found: tuple[Stones, Stones] = ({}, {})
    wanted = [_is_of(side) for side in sides]
    for stone in all_pages(url, "/particles", key, {"lot": lot, "kind": "particle", "limit": PAGE}):
        for record in _newest_first(url, key, stone):
            for stones, is_of in zip(found, wanted, strict=True):
                if record["id"] not in stones and is_of(record):
                    stones[record["id"]] = record
            if all(record["id"] in stones for stones in found):
                break
    for side, stones in zip(sides, found, strict=True):
        if not stones:
            raise UsageError(f"no stone of lot {lot} has a result of {side}")
    return found


def _is_of(side: str) -> Callable[[dict[str, Any]], bool]:
    if revision := REVISION.fullmatch(side):
        return lambda record: bool(record["revision"] == int(revision[1]))
    return lambda record: bool(record["algorithm_version"] == side)


def _newest_first(url: str, key: str | None, newest: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield a stone's results, from the newest back to the first that is kept."""
    record = newest
    while True:
        yield record
        if record["revises"] is None:
            return
        record = ask(url, f"/particles/{record['revises']}", key)
