"""Shape from silhouette: the visual hull as a field on the voxel grid.

There are two fields, by default both on 256^3 samples over 50 mm:

- `view_count`, the paper's: S = number of views whose silhouette contains the projection of the
  voxel's centre, nearest pixel; the surface lies between N - 1 and N, its eq. (11) interpolates.
- `sub_voxel` (default): f(x) = min over views of d_k(pi_k(x)) z_k / f_k, the signed distance in px of
  the projection to the silhouette's edge, in mm at the voxel's depth z_k. The minimum of signed
  distances is the implicit intersection of the viewing cones (Ricci 1973); f = 0 is the surface, so
  marching cubes places its vertices on the edges of the silhouettes instead of on a staircase.

With m disagreeing views allowed, the (m + 1)-th smallest distance, or N - m views, take their place.

`reference` defines it in numpy, for every voxel and every view. What runs does as much only near the surface:
an octree finds where that is (`octree`), `samples` evaluates there. Elsewhere only the field's side is right.
"""

from pipeline.carving.hull import CarvingField, CarvingParameters, VisualHull, all_leaves
from pipeline.carving.octree import LEAF
from pipeline.carving.sparse import carve, warm_up

__all__ = [
    "LEAF",
    "CarvingField",
    "CarvingParameters",
    "VisualHull",
    "all_leaves",
    "carve",
    "warm_up",
]
