"""Pages of results as finished JSON, made on a connection to the store, in any process or thread."""

import sqlite3
from dataclasses import replace

from service.results.fields import served
from service.store import ParticleFilter
from service.store.events import HistoryPage
from service.store.particle_files import first_seq
from service.store.reads import particles, results_after
from service.web.pages import page_json

Names = tuple[str, ...] | None
"""Fields of a result that are wanted; None: all."""


def served_after(connection: sqlite3.Connection, after: int, limit: int, names: Names) -> HistoryPage:
    """Return up to `limit` results after `after`, each with these fields or all."""
    page = results_after(connection, after, limit)
    return replace(page, items=[served(record, names) for record in page.items])


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
    return page_json(head, (served(record, names) for record in items), as_gzip)
