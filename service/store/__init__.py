"""The result store: every trigger's outcome, durable before it is visible; SQLite with one writer, and files."""

from service.store.particle_filter import ParticleFilter
from service.store.reads import Record
from service.store.schema import read
from service.store.store import KEEP_RAW, Store, open_store
from service.store.trouble import StoreTrouble

__all__ = ["KEEP_RAW", "ParticleFilter", "Record", "Store", "StoreTrouble", "open_store", "read"]
