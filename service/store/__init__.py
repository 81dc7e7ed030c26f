"""Every trigger's outcome, durable before it is visible: SQLite, one writer, files beside it."""

from service.store.reads import ParticleFilter, Record, ResultPage
from service.store.store import KEEP_RAW, Store, open_store
from service.store.writes import rfc3339_ms, utc_now

__all__ = [
    "KEEP_RAW",
    "ParticleFilter",
    "Record",
    "ResultPage",
    "Store",
    "open_store",
    "rfc3339_ms",
    "utc_now",
]
