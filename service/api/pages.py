"""Pages of results as finished JSON, made on a connection to the store, in whichever process or thread."""

import json
import sqlite3
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel

from service.lots.evaluation import lot_figures, window_figures
from service.lots.yardsticks import Request
from service.results.fields import completed
from service.store import ParticleFilter, Record
from service.store.events import events_after
from service.store.reads import particles, results_after


@dataclass(frozen=True, slots=True)
class FeedPage:
    """A page of the feed, and what decides whether it is the answer."""

    first_seq: int
    last_seq: int
    next_after: int
    content: bytes


def feed_page(connection: sqlite3.Connection, instance_id: str, after: int, limit: int) -> FeedPage:
    """Return the page of up to `limit` results after `after`."""
    page = results_after(connection, after, limit)
    next_after = page.items[-1]["seq"] if page.items else after
    head = {
        "instance_id": instance_id,
        "first_seq": page.first_seq,
        "last_seq": page.last_seq,
        "next_after": next_after,
    }
    return FeedPage(page.first_seq, page.last_seq, next_after, _page_json(head, page.items))


def result_stream(connection: sqlite3.Connection, instance_id: str, after: int, limit: int) -> FeedPage:
    """Return the same results as server-sent events."""
    page = results_after(connection, after, limit)
    items = [completed(record) for record in page.items]
    content = b"".join(server_sent("result", item, item["seq"]) for item in items)
    return FeedPage(page.first_seq, page.last_seq, items[-1]["seq"] if items else after, content)


def event_page(connection: sqlite3.Connection, instance_id: str, after: int, limit: int) -> FeedPage:
    """Return the page of up to `limit` events after `after`."""
    page = events_after(connection, after, limit)
    next_after = page.items[-1]["seq"] if page.items else after
    head = {
        "instance_id": instance_id,
        "first_seq": page.first_seq,
        "last_seq": page.last_seq,
        "next_after": next_after,
    }
    items = ",".join(_json(item) for item in page.items)
    content = f'{_json(head)[:-1]},"items":[{items}]}}'.encode()
    return FeedPage(page.first_seq, page.last_seq, next_after, content)


def event_stream(connection: sqlite3.Connection, instance_id: str, after: int, limit: int) -> FeedPage:
    """Return the same events as server-sent events."""
    page = events_after(connection, after, limit)
    content = b"".join(server_sent(item["type"], item, item["seq"]) for item in page.items)
    return FeedPage(page.first_seq, page.last_seq, page.items[-1]["seq"] if page.items else after, content)


def server_sent(event: str, data: Any, number: int | None = None) -> bytes:
    """Return one server-sent event; one without a number does not move the position of the client."""
    place = "" if number is None else f"id: {number}\n"
    return f"{place}event: {event}\ndata: {_json(data)}\n\n".encode()


def particles_page(
    connection: sqlite3.Connection, wanted: ParticleFilter, before_seq: int, limit: int
) -> bytes:
    """Return the page of the newest `limit` results that fit and are older than `before_seq`."""
    records = particles(connection, wanted, before_seq, limit + 1)
    items = records[:limit]
    return _page_json({"next_cursor": str(items[-1]["seq"]) if len(records) > limit else None}, items)


def lot_figures_json(connection: sqlite3.Connection, lot: str, request: Request) -> bytes | None:
    """Return the figures of a lot, None if there is none."""
    return _model_json(lot_figures(connection, lot, request))


def window_figures_json(
    connection: sqlite3.Connection, since: str, until: str, request: Request, product: str | None
) -> bytes | None:
    """Return the figures of a time, None if the product is unknown."""
    return _model_json(window_figures(connection, since, until, request, product))


def _model_json(model: BaseModel | None) -> bytes | None:
    return None if model is None else model.model_dump_json().encode()


def _page_json(head: Mapping[str, Any], items: Sequence[Record]) -> bytes:
    members = [f"{_json(name)}:{_json(value)}" for name, value in head.items()]
    records = [_json(completed(record)) for record in items]
    members.append(f'"items":[{",".join(records)}]')
    return f"{{{','.join(members)}}}".encode()


def _json(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
