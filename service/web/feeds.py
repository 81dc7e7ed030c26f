"""What clients follow by a number without gaps: the pages of a feed, the wait for more, and the place of a cursor."""

import asyncio
from contextlib import suppress
from functools import partial
from operator import attrgetter

from service.store import read
from service.store.events import CursorError, events_after
from service.web.context import ApiContext
from service.web.pages import CursorPage, Feed, FeedPage, feed_page

MAX_SEQ = 10**15
"""Beyond any feed, within what a JSON number and SQLite hold exactly."""
MAX_SMALL = 20
"""Results of a page that the daemon itself makes, in 3 ms; bigger ones are made beside it."""
KEEP_S = 1.0
"""Time for which a small page, or a full one of a stream, is the answer to all who ask for it."""

EVENTS = Feed(kind="event", find=events_after, is_large=False, last=attrgetter("last_event"))


async def page_after(context: ApiContext, feed: Feed, after: int, limit: int, wait_s: float = 0) -> FeedPage:
    """Return the page after `after`, as soon as there is something on it or `wait_s` are over.

    All who ask for it at this moment get the same.
    """
    store = context.store
    while True:
        last = feed.last(store)
        if wait_s == 0 or after != last:
            is_big = feed.is_large and min(limit, last - after) > MAX_SMALL
            is_full = feed.is_stream and after + limit <= last  # what follows changes nothing on it
            read_page = partial(context.reading.run, read, store.path) if is_big else store.read
            page: FeedPage = await context.shared.get(
                (feed, after, limit, None if is_full else last),
                partial(read_page, feed_page, feed, store.instance_id, after, limit),
                keep_s=KEEP_S if is_full or not is_big else 0,
            )
            if wait_s == 0 or after != page.cursor.last_seq:
                return page
        with suppress(TimeoutError):
            async with asyncio.timeout(wait_s):
                await feed.wait_beyond(store, after)
        await context.waking.turn()
        wait_s = 0


def require_within(page: CursorPage, after: int, kind: str) -> None:
    """Raise `CursorError` for a cursor that lies beyond the feed's end or before its first item."""
    first_seq, last_seq = page.first_seq, page.last_seq
    if after > last_seq:
        raise CursorError(f"the newest {kind} is {last_seq}, not {after}", after, first_seq, last_seq)
    if after < first_seq - 1:
        removed = f"{kind}s {after + 1} to {first_seq - 1} were removed: go on with after={first_seq - 1}"
        raise CursorError(removed, after, first_seq, last_seq)
