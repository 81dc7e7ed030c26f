"""Stones in the table of a store by the thousand, each at its time, without a trigger or a record."""

import sqlite3
from collections.abc import Sequence
from datetime import datetime, timedelta

import numpy as np

from pipeline.frames import rfc3339

COLUMNS = (
    "seq", "id", "lot", "captured_at", "outcome", "quality", "volume_mm3", "sieve_size_mm", "max_feret_mm",
    "min_feret_mm", "length_mm", "width_mm", "thickness_mm", "volume_sd_percent", "surface_sd_mm",
    "calibration_id", "algorithm_version", "is_simulated", "is_replay",
)  # fmt: skip


def fall(
    connection: sqlite3.Connection,
    since: datetime,
    minutes: float,
    *,
    per_min: float = 60.0,
    long_share: float = 0.18,
    median_mm: float = 11.0,
    first_seq: int = 1,
    lot: str | None = None,
    seed: int = 0,
) -> int:
    """Let stones fall evenly, so many of them elongated; every tenth is rejected. Return the next seq."""
    rng = np.random.default_rng(seed)
    n = round(minutes * per_min)
    sizes_mm = np.exp(rng.normal(np.log(median_mm), 0.25, n))
    is_long = rng.random(n) < long_share
    long_mm = sizes_mm * np.where(is_long, 2.1, 1.3)
    short_mm = sizes_mm * np.where(is_long, 0.55, 0.75)
    rows: list[Sequence[object]] = []
    for place in range(n):
        at = rfc3339(since + timedelta(minutes=minutes * (place + rng.random()) / n))
        seq, size_mm = first_seq + place, float(sizes_mm[place])
        identity = (seq, f"s{seq}", lot, at)
        if seq % 10 == 0:
            rows.append((*identity, "rejected", *[None] * (len(COLUMNS) - 5)))
            continue
        lengths = (size_mm, float(long_mm[place]), float(short_mm[place]), size_mm, size_mm, size_mm)
        rows.append(
            (*identity, "measured", "good", 0.5 * size_mm**3, *lengths, 0.5, 0.02, "0001", "10", 1, 1)
        )
    marks = ", ".join("?" * len(COLUMNS))
    connection.executemany(f"INSERT INTO indexed_fields ({', '.join(COLUMNS)}) VALUES ({marks})", rows)  # noqa: S608 - names of our own fields
    return first_seq + n
