"""Pages of feeds as finished JSON, made on a connection to the store, in any process or thread."""

import gzip
import json
import sqlite3
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel, Field

from service.store import Store
from service.store.events import HistoryPage

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


@dataclass(frozen=True, slots=True, kw_only=True)
class Feed:
    """Results, or events, in one form."""

    kind: str
    find: Callable[..., HistoryPage]
    """Takes a connection, `after`, `limit`, and the feed's `choice`."""
    choice: tuple[str, ...] | None = None
    """What the client has chosen of them; None: all."""
    is_large: bool
    """A page of many items takes long."""
    last: Callable[[Store], int]
    is_stream: bool = False
    """Its pages are server-sent events, and say nothing of what follows them."""
    as_gzip: bool = False

    async def wait_beyond(self, store: Store, after: int) -> None:
        """Wait until there is an item after this number, or waiting was ended."""
        await store.wait_while(lambda: self.last(store) <= after)


def feed_page(
    connection: sqlite3.Connection, feed: Feed, instance_id: str, after: int, limit: int
) -> FeedPage:
    """Return the page of up to `limit` items after `after`."""
    page = feed.find(connection, after, limit, feed.choice)
    cursor = CursorPage(
        instance_id=instance_id,
        first_seq=page.first_seq,
        last_seq=page.last_seq,
        next_after=page.items[-1]["seq"] if page.items else after,
    )
    if not feed.is_stream:
        return FeedPage(cursor, page_json(dict(cursor), page.items, feed.as_gzip))
    # an event is sent by its type, of which a result has none
    sent = (server_sent(item.get("type", feed.kind), item, item["seq"]) for item in page.items)
    return FeedPage(cursor, b"".join(sent))


def server_sent(event: str, data: Any, number: int | None = None) -> bytes:
    """Return one server-sent event; one without a number does not move the position of the client."""
    place = "" if number is None else f"id: {number}\n"
    return f"{place}event: {event}\ndata: {_json(data)}\n\n".encode()


def is_gzipped(content: bytes) -> bool:
    """True when JSON is compressed already, by the first bytes of gzip."""
    return content.startswith(b"\x1f\x8b")


def page_json(head: Mapping[str, Any], items: Iterable[Mapping[str, Any]], as_gzip: bool) -> bytes:
    """Return a document with these members and its items, compressed if that is asked for and pays."""
    members = [f"{_json(name)}:{_json(value)}" for name, value in head.items()]
    members.append(f'"items":[{",".join(map(_json, items))}]')
    page = f"{{{','.join(members)}}}".encode()
    return gzip.compress(page, LEVEL, mtime=0) if as_gzip and len(page) >= LEAST_BYTES else page


def _json(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
