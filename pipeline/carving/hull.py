"""The visual hull as a field on the voxel grid, and the parameters of carving it."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from pipeline.arrays import Singles, Vector
from pipeline.carving.octree import LEAF, Blocks

N_VIEWS = 16
"""Views that `CarvingParameters.isolevel` counts on: those of the paper's rig."""

CarvingField = Literal["sub_voxel", "view_count"]
"""What the surface is taken from: signed distances, or the paper's count of the views that see a voxel inside."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CarvingParameters:
    """Grid and field of the visual hull."""

    size_mm: float = 50.0  # edge of the cube around the rig's centre
    n: int = 256  # samples an edge
    field: CarvingField = "sub_voxel"
    max_disagreeing_views: int = 0  # views that may exclude a voxel without carving it
    isolevel: float = 15.5  # of `view_count`, by 16 views, from 15 to 16; by fewer as far below their number

    def __post_init__(self) -> None:
        if self.n % LEAF or not 16 <= self.n <= 1024:
            raise ValueError(f"n must be a multiple of {LEAF} between 16 and 1024")
        if not 0 < self.size_mm < 1000:
            raise ValueError("size_mm must be between 0 and 1000")
        if self.max_disagreeing_views < 0:
            raise ValueError("max_disagreeing_views must not be negative")
        if not N_VIEWS - 1 <= self.isolevel < N_VIEWS:
            raise ValueError(f"isolevel must be from {N_VIEWS - 1} to less than {N_VIEWS}")

    @property
    def bounds_by_edges(self) -> bool:
        """Whether the hull ends where the edges of all silhouettes do: what its excess is derived for."""
        return self.field == "sub_voxel" and self.max_disagreeing_views == 0

    @property
    def pitch_mm(self) -> float:
        """Spacing of the samples."""
        return self.size_mm / self.n


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class VisualHull:
    """The field around the body: above `level` inside it, and outside at its outermost samples.

    `field[i, j, k]` belongs to the point `origin_mm + pitch_mm (i, j, k)`. A cell of marching cubes, between
    samples i and i + 1, j and j + 1, k and k + 1, is cut only if its lowest sample lies in a leaf. At the ends of
    cut edges of cells the field is exact, elsewhere only the side is.
    """

    field: Singles  # (nx, ny, nz)
    leaves: Blocks  # (L, 3) first samples of the blocks of LEAF^3 that may be cut
    level: float
    origin_mm: Vector  # of the first sample
    pitch_mm: float
    touches_border: bool  # the body leaves the carved volume


def all_leaves(shape: tuple[int, ...]) -> Blocks:
    """Return the leaves (L, 3) of a field (nx, ny, nz) that may be cut anywhere."""
    counts = [-(-size // LEAF) for size in shape]
    return (LEAF * np.indices(counts).reshape(3, -1).T).astype(np.int32)
