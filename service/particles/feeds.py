"""The feed of results, in the form that a client has chosen."""

from dataclasses import replace

from service.particles.pages import Names, feed_page, result_stream
from service.store import Store
from service.web.feeds import Feed


def _last_seq(store: Store) -> int:
    return store.last_seq


async def _beyond_result(store: Store, after: int) -> None:
    await store.wait_beyond(after)


RESULTS = Feed(kind="result", query=feed_page, is_large=True, last=_last_seq, wait_beyond=_beyond_result)
RESULT_STREAM = Feed(
    kind="result",
    query=result_stream,
    is_large=True,
    last=_last_seq,
    wait_beyond=_beyond_result,
    is_stream=True,
)


def choosing(feed: Feed, *more: Names | bool) -> Feed:
    """Return a feed of results in the form that a client has chosen: with some fields of each, as gzip."""
    return replace(feed, more=more)
