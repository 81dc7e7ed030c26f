"""Stones and lots for tests of gradations."""

from collections.abc import Sequence

import numpy as np

from pipeline.arrays import Values
from pipeline.gradation.stones import MEASURES, OPTIONAL, REQUIRED, UNKNOWN, Lot, Stone, lot_of


def round_stone(size_mm: float, volume_mm3: float | None = None, **others: float) -> Stone:
    """Return a stone as long, as wide and as thick as its sieve size."""
    names = ("max_feret_mm", "min_feret_mm", "length_mm", "width_mm", "thickness_mm")
    volume_mm3 = np.pi / 6 * size_mm**3 if volume_mm3 is None else volume_mm3
    measures = dict.fromkeys(names, size_mm) | {"sieve_size_mm": size_mm, "volume_mm3": volume_mm3}
    return Stone(**(measures | others))


def box(edges_mm: tuple[float, float, float], sieve_size_mm: float) -> Stone:
    """Return a box with edges S x I x L."""
    short, middle, long = edges_mm
    return Stone(
        volume_mm3=short * middle * long,
        sieve_size_mm=sieve_size_mm,
        max_feret_mm=float(np.hypot(np.hypot(short, middle), long)),
        min_feret_mm=short,
        length_mm=long,
        width_mm=middle,
        thickness_mm=short,
    )


def lot_of_masses(sizes_mm: Sequence[float], masses: Sequence[float]) -> Lot:
    """Return stones of these sizes and masses."""
    return lot_of(round_stone(size, mass) for size, mass in zip(sizes_mm, masses, strict=True))


def lot_of_sizes(
    sizes_mm: Values, *, size_sds_mm: Values | float = 0.0, volume_sd: float = 0.0, seed: int = 0
) -> Lot:
    """Return round stones of these true sizes, as an instrument with such errors measures them."""
    rng = np.random.default_rng(seed)
    n = len(sizes_mm)
    seen_mm = sizes_mm + size_sds_mm * rng.standard_normal(n)
    volumes = np.pi / 6 * sizes_mm**3 * (1 + volume_sd * rng.standard_normal(n))
    return lot_with(
        seen_mm,
        volume_mm3=volumes,
        volume_sd=volume_sd,
        sieve_size_sd_mm=size_sds_mm,
        feret_sd_mm=size_sds_mm,
    )


def lot_with(sizes_mm: Values, **measures: Values | float) -> Lot:
    """Return stones with these measures; other required ones are their size, other optional ones unknown."""
    columns = {**dict.fromkeys(REQUIRED, sizes_mm), **dict.fromkeys(OPTIONAL, UNKNOWN), **measures}
    rows = [np.broadcast_to(columns.get(name, 0.0), len(sizes_mm)) for name in MEASURES]
    return Lot(measures=np.array(rows, float))
