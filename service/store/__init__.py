"""Every trigger's outcome, durable before it is visible: SQLite, one writer, files beside it."""

from service.store.reads import ParticleFilter, Record, ResultPage
from service.store.store import KEEP_RAW, Store, open_store

__all__ = [
    "KEEP_RAW",
    "ParticleFilter",
    "Record",
    "ResultPage",
    "Store",
    "open_store",
]
