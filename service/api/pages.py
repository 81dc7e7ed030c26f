"""Pages of results as finished JSON, made on a connection to the store, in any process or thread."""

import gzip
import json
import sqlite3
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

from pydantic import BaseModel

from service.lots.evaluation import lot_figures, window_figures
from service.lots.laboratory import StoredSieving, sievings
from service.lots.stored_stones import Choice
from service.lots.yardsticks import Request
from service.results.selection import served
from service.store import ParticleFilter
from service.store.events import HistoryPage, events_after
from service.store.particle_files import first_seq
from service.store.reads import particles, results_after

Names = tuple[str, ...] | None
"""Fields of a result that are wanted; None: all."""


LEAST_BYTES = 2000
"""Smaller answers are not worth compressing."""
LEVEL = 1
"""Level of gzip: 20 results of 170 kB become 70 kB in 2 ms; level 6 takes five times that for 7 % less."""


@dataclass(frozen=True, slots=True)
class FeedPage:
    """A page of the feed, and what decides whether it is the answer."""

    first_seq: int
    last_seq: int
    next_after: int
    content: bytes


def feed_page(
    connection: sqlite3.Connection,
    instance_id: str,
    after: int,
    limit: int,
    names: Names = None,
    as_gzip: bool = False,
) -> FeedPage:
    """Return the page of up to `limit` results after `after`, each with these fields or all."""
    page = results_after(connection, after, limit)
    return _feed_page(page, after, instance_id, (served(record, names) for record in page.items), as_gzip)


def result_stream(
    connection: sqlite3.Connection, instance_id: str, after: int, limit: int, names: Names = None
) -> FeedPage:
    """Return the same results as server-sent events."""
    page = results_after(connection, after, limit)
    items = (served(record, names) for record in page.items)
    return _sent(page, after, (server_sent("result", item, item["seq"]) for item in items))


def event_page(connection: sqlite3.Connection, instance_id: str, after: int, limit: int) -> FeedPage:
    """Return the page of up to `limit` events after `after`."""
    page = events_after(connection, after, limit)
    return _feed_page(page, after, instance_id, page.items)


def event_stream(connection: sqlite3.Connection, instance_id: str, after: int, limit: int) -> FeedPage:
    """Return the same events as server-sent events."""
    page = events_after(connection, after, limit)
    return _sent(page, after, (server_sent(item["type"], item, item["seq"]) for item in page.items))


def server_sent(event: str, data: Any, number: int | None = None) -> bytes:
    """Return one server-sent event; one without a number does not move the position of the client."""
    place = "" if number is None else f"id: {number}\n"
    return f"{place}event: {event}\ndata: {_json(data)}\n\n".encode()


def particles_page(
    connection: sqlite3.Connection,
    wanted: ParticleFilter,
    before_seq: int,
    limit: int,
    names: Names = None,
    as_gzip: bool = False,
) -> bytes:
    """Return the page of the newest `limit` results that fit and are older than `before_seq`."""
    records = particles(connection, wanted, before_seq, limit + 1)
    items = records[:limit]
    head = {"next_cursor": str(first_seq(items[-1]["id"])) if len(records) > limit else None}
    return _page_json(head, (served(record, names) for record in items), as_gzip)


def is_gzipped(content: bytes) -> bool:
    """True when JSON is compressed already, by the first bytes of gzip."""
    return content.startswith(b"\x1f\x8b")


def lot_figures_json(
    connection: sqlite3.Connection, lot: str, request: Request, choice: Choice
) -> bytes | None:
    """Return the figures of a lot, or of a choice of its stones; None if there is none."""
    return _model_json(lot_figures(connection, lot, request, choice))


def window_figures_json(
    connection: sqlite3.Connection, since: str, until: str, request: Request, product: str | None
) -> bytes | None:
    """Return the figures of a time, None if the product is unknown."""
    return _model_json(window_figures(connection, since, until, request, product))


def sievings_json(connection: sqlite3.Connection, lot: str) -> bytes:
    """Return the sievings of a lot as JSON."""
    return json.dumps({"items": [sieving_document(each) for each in sievings(connection, lot)]}).encode()


def sieving_document(stored: StoredSieving) -> dict[str, Any]:
    """Return a sieving as its document says it."""
    sieving = stored.document
    return {
        **asdict(sieving),
        "sieving": stored.sieving,
        "at": stored.at,
        "mass_g": sieving.mass_g,
        "retained_g": {f"{sieve_mm:g}": grams for sieve_mm, grams in sieving.retained_g.items()},
        "passing_percent": {f"{sieve_mm:g}": share for sieve_mm, share in sieving.passing_percent.items()},
    }


def _model_json(model: BaseModel | None) -> bytes | None:
    return None if model is None else model.model_dump_json().encode()


def _feed_page(
    page: HistoryPage,
    after: int,
    instance_id: str,
    items: Iterable[Mapping[str, Any]],
    as_gzip: bool = False,
) -> FeedPage:
    next_after = _last_of(page, after)
    head = {
        "instance_id": instance_id,
        "first_seq": page.first_seq,
        "last_seq": page.last_seq,
        "next_after": next_after,
    }
    return FeedPage(page.first_seq, page.last_seq, next_after, _page_json(head, items, as_gzip))


def _sent(page: HistoryPage, after: int, items: Iterable[bytes]) -> FeedPage:
    return FeedPage(page.first_seq, page.last_seq, _last_of(page, after), b"".join(items))


def _last_of(page: HistoryPage, after: int) -> int:
    return int(page.items[-1]["seq"]) if page.items else after


def _page_json(head: Mapping[str, Any], items: Iterable[Mapping[str, Any]], as_gzip: bool) -> bytes:
    members = [f"{_json(name)}:{_json(value)}" for name, value in head.items()]
    members.append(f'"items":[{",".join(map(_json, items))}]')
    page = f"{{{','.join(members)}}}".encode()
    return gzip.compress(page, LEVEL, mtime=0) if as_gzip and len(page) >= LEAST_BYTES else page


def _json(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
