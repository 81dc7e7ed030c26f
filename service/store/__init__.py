"""The result store: every trigger's outcome, durable before it is visible; SQLite with one writer, and files."""

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
