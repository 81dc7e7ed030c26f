"""The feed of results, in the form that a client has chosen."""

from dataclasses import replace
from operator import attrgetter

from service.particles.pages import Names, feed_page, result_stream
from service.web.feeds import Feed

RESULTS = Feed(kind="result", query=feed_page, is_large=True, last=attrgetter("last_seq"))
RESULT_STREAM = replace(RESULTS, query=result_stream, is_stream=True)


def choosing(feed: Feed, *more: Names | bool) -> Feed:
    """Return a feed of results in the form that a client has chosen: with some fields of each, as gzip."""
    return replace(feed, more=more)
