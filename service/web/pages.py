"""Pages of feeds as finished JSON, made on a connection to the store, in any process or thread."""

import gzip
import json
import sqlite3
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel, Field

from service.store.events import HistoryPage, events_after

LEAST_BYTES = 2000
"""Smaller answers are not worth compressing."""
LEVEL = 1
"""Level of gzip: 20 results of 170 kB become 70 kB in 2 ms; level 6 takes five times that for 7 % less."""


class CursorPage(BaseModel):
    """One page of a feed. Ask again with `after = next_after`; each item is delivered at least once."""

    instance_id: str = Field(description="Identity of the history; when it changes, start again from 0")
    first_seq: int = Field(description="`seq` of the oldest item kept; `last_seq + 1` when there is none")
    last_seq: int = Field(description="`seq` of the newest item; 0 before the first")
    next_after: int = Field(description="The cursor: pass it as `after` of the next request")


@dataclass(frozen=True, slots=True)
class FeedPage:
    """A page of the feed, and the cursor, which decides whether it is the answer."""

    cursor: CursorPage
    content: bytes


def event_page(connection: sqlite3.Connection, instance_id: str, after: int, limit: int) -> FeedPage:
    """Return the page of up to `limit` events after `after`."""
    page = events_after(connection, after, limit)
    return page_of(page, after, instance_id, page.items)


def event_stream(connection: sqlite3.Connection, instance_id: str, after: int, limit: int) -> FeedPage:
    """Return the same events as server-sent events."""
    page = events_after(connection, after, limit)
    return stream_of(
        page, after, instance_id, (server_sent(item["type"], item, item["seq"]) for item in page.items)
    )


def server_sent(event: str, data: Any, number: int | None = None) -> bytes:
    """Return one server-sent event; one without a number does not move the position of the client."""
    place = "" if number is None else f"id: {number}\n"
    return f"{place}event: {event}\ndata: {_json(data)}\n\n".encode()


def is_gzipped(content: bytes) -> bool:
    """True when JSON is compressed already, by the first bytes of gzip."""
    return content.startswith(b"\x1f\x8b")


def page_of(
    page: HistoryPage, after: int, instance_id: str, items: Iterable[Mapping[str, Any]], as_gzip: bool = False
) -> FeedPage:
    """Return the page as JSON."""
    cursor = _cursor_of(page, after, instance_id)
    return FeedPage(cursor, page_json(dict(cursor), items, as_gzip))


def stream_of(page: HistoryPage, after: int, instance_id: str, items: Iterable[bytes]) -> FeedPage:
    """Return the page as server-sent events."""
    return FeedPage(_cursor_of(page, after, instance_id), b"".join(items))


def _cursor_of(page: HistoryPage, after: int, instance_id: str) -> CursorPage:
    next_after = page.items[-1]["seq"] if page.items else after
    return CursorPage(
        instance_id=instance_id, first_seq=page.first_seq, last_seq=page.last_seq, next_after=next_after
    )


def page_json(head: Mapping[str, Any], items: Iterable[Mapping[str, Any]], as_gzip: bool) -> bytes:
    """Return a document with these members and its items, compressed if that is asked for and pays."""
    members = [f"{_json(name)}:{_json(value)}" for name, value in head.items()]
    members.append(f'"items":[{",".join(map(_json, items))}]')
    page = f"{{{','.join(members)}}}".encode()
    return gzip.compress(page, LEVEL, mtime=0) if as_gzip and len(page) >= LEAST_BYTES else page


def _json(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
