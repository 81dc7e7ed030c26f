"""Read the stones of a lot from the records of results."""

from collections.abc import Iterable, Mapping
from math import sqrt
from typing import Any

from pipeline.frames import BundleKind
from pipeline.gradation.stones import DEVIATIONS, MEASURES, Fate, Lot, Stone, UnmeasuredStone, lot_of

SURFACES = sqrt(2.0)
"""Standard deviation of a distance between two surfaces by that of one: their errors are taken for independent."""


def stone_of(record: Mapping[str, Any]) -> Stone | UnmeasuredStone:
    """Return the stone of a record; whether a replay counts is for the caller: in a store of replays it does."""
    fate = Fate(record["outcome"])
    if fate is not Fate.MEASURED:
        return UnmeasuredStone(fate=fate, reason=record["reason"])
    size_sd_mm = SURFACES * (record["surface_sd_mm"] or 0.0)
    return Stone(
        **{name: record[name] for name in MEASURES if name not in DEVIATIONS},
        volume_sd=(record["volume_sd_percent"] or 0.0) / 100,
        sieve_size_sd_mm=size_sd_mm,
        feret_sd_mm=size_sd_mm,
        quality=record["quality"],
    )


def lot_of_records(records: Iterable[Mapping[str, Any]]) -> Lot:
    """Return the lot of all stones in these records; balls are none."""
    return lot_of(stone_of(record) for record in records if record["kind"] != BundleKind.BALL)
