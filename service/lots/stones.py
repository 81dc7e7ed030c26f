"""Read the stones of a lot from the records of results."""

from collections.abc import Iterable, Mapping, Sequence
from math import sqrt
from typing import Any

import numpy as np

from pipeline.frames import BundleKind
from pipeline.gradation.stones import DEVIATIONS, MEASURES, Fate, Lot, Stone, UnmeasuredStone, lot_of

SURFACES = sqrt(2.0)
"""Standard deviation of a distance between two surfaces by that of one: their errors are taken for independent."""
SIZES = tuple(name for name in MEASURES if name not in DEVIATIONS)
"""Fields that every measured stone has."""
MEASURED_COLUMNS = (*SIZES, "volume_sd_percent", "surface_sd_mm")
"""Fields of a measured stone that a gradation needs, in the order of `lot_of_columns`."""


def stone_of(record: Mapping[str, Any]) -> Stone | UnmeasuredStone:
    """Return the stone of a record; whether a replay counts is for the caller: in a store of replays it does."""
    fate = Fate(record["outcome"])
    if fate is not Fate.MEASURED:
        return UnmeasuredStone(fate=fate, reason=record["reason"], n_stones=record.get("n_stones") or 1)
    size_sd_mm = SURFACES * (record["surface_sd_mm"] or 0.0)
    return Stone(
        **{name: record[name] for name in SIZES},
        volume_sd=(record["volume_sd_percent"] or 0.0) / 100,
        sieve_size_sd_mm=size_sd_mm,
        feret_sd_mm=size_sd_mm,
        quality=record["quality"],
    )


def lot_of_records(records: Iterable[Mapping[str, Any]]) -> Lot:
    """Return the lot of all stones in these records; balls are none."""
    return lot_of(stone_of(record) for record in records if record["kind"] != BundleKind.BALL)


def lot_of_columns(rows: Sequence[Sequence[float | None]]) -> Lot:
    """Return the lot of many measured stones, each a row of `MEASURED_COLUMNS`, in their order.

    Stones that lack a measure, as those of a version that measured less, are left out.
    """
    columns = np.array(rows, float).reshape(-1, len(MEASURED_COLUMNS)).T
    columns = columns[:, np.all(columns[:-2] > 0, axis=0)]
    volume_sd, surface_sd_mm = np.nan_to_num(columns[-2]) / 100, np.nan_to_num(columns[-1])
    deviations = {
        "volume_sd": volume_sd,
        "sieve_size_sd_mm": SURFACES * surface_sd_mm,
        "feret_sd_mm": SURFACES * surface_sd_mm,
    }
    measures = dict(zip(MEASURED_COLUMNS, columns, strict=True)) | deviations
    return Lot(measures=np.array([measures[name] for name in MEASURES]))
