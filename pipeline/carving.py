"""Shape from silhouette: the visual hull as a field on the voxel grid.

Two fields, both on 256^3 samples over 50 mm:

- `view_count`, the paper's: S = number of views whose silhouette contains the projection of the
  voxel's centre, nearest pixel; the surface lies between N - 1 and N, its eq. (11) interpolates.
- `sub_voxel` (default): f(x) = min over views of d_k(pi_k(x)) z_k / f_k, the signed distance in px of
  the projection to the silhouette's edge, in mm at the voxel's depth z_k. The minimum of signed
  distances is the implicit intersection of the viewing cones (Ricci 1973); f = 0 is the surface, so
  marching cubes places its vertices on the edges of the silhouettes instead of on a staircase.

With m disagreeing views allowed, the (m + 1)-th smallest distance, or N - m views, take their place.

Only voxels near the surface are evaluated: a block of voxels whose centre lies further from the
surface than its corners cannot be cut. Elsewhere the field only has the right sign.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.frames import CameraId
from pipeline.rig import CameraCalibration, RigCalibration
from pipeline.segmentation.silhouette import MARGIN_PX, UNKNOWN, Silhouette

Array = NDArray[np.float32]
CHUNK = 1 << 16
"""Voxels evaluated at a time: the temporary arrays stay in the cache, and the allocator reuses them."""
ROW = 1 << 12
"""Longest row OpenCV's `remap` is given (its images end at 32767)."""
BLOCKS = (8, 4)
"""Edges of the blocks, in voxels, from coarse to fine."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CarvingParameters:
    """Grid and field of the visual hull."""

    size_mm: float = 50.0  # edge of the cube around the rig's centre
    n: int = 256  # samples an edge
    field: Literal["sub_voxel", "view_count"] = "sub_voxel"
    max_disagreeing_views: int = 0  # views that may exclude a voxel without carving it

    def __post_init__(self) -> None:
        if self.n % BLOCKS[0] or not 16 <= self.n <= 1024:
            raise ValueError(f"n must be a multiple of {BLOCKS[0]} between 16 and 1024")
        if not 0 < self.size_mm < 1000:
            raise ValueError("size_mm must be between 0 and 1000")
        if self.max_disagreeing_views < 0:
            raise ValueError("max_disagreeing_views must not be negative")

    @property
    def pitch_mm(self) -> float:
        return self.size_mm / self.n


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class VisualHull:
    """The field around the body, above `level` inside it and never on it; its outermost samples are outside.

    `field[i, j, k]` belongs to the point `origin_mm + pitch_mm (i, j, k)`.
    """

    field: Array  # (nx, ny, nz)
    level: float
    origin_mm: NDArray[np.float64]  # (3,) centre of voxel (0, 0, 0)
    pitch_mm: float
    touches_border: bool  # the body leaves the carved volume


def carve(
    silhouettes: Mapping[CameraId, Silhouette], rig: RigCalibration, parameters: CarvingParameters
) -> VisualHull:
    """Largest body consistent with every usable silhouette but `max_disagreeing_views`.

    Unknown pixels, and views without a usable silhouette, carve nothing.

    Raises
    ------
    ValueError
        Fewer than two usable silhouettes, or a camera that the rig does not know.
    """
    views = usable_views(silhouettes, rig)
    if len(views) < 2 + parameters.max_disagreeing_views:
        raise ValueError(f"{len(views)} usable silhouettes are too few to carve")
    grid = _Grid(parameters)
    blocks, solid = _cut_blocks(views, grid, parameters)
    if len(blocks) == 0:
        return VisualHull(
            field=np.zeros((0, 0, 0), np.float32),
            level=0.0,
            origin_mm=np.zeros(3),
            pitch_mm=grid.pitch_mm,
            touches_border=False,
        )
    # the box of the cut blocks in a shell of outside, so that its surface is closed
    low, high = blocks.min(axis=0) - 1, blocks.max(axis=0) + BLOCKS[-1] + 1
    if parameters.field == "view_count":
        level = len(views) - parameters.max_disagreeing_views - 0.5
        inside, outside = float(len(views)), 0.0
    else:
        level, inside, outside = 0.0, grid.pitch_mm, -grid.pitch_mm
    field = np.full(high - low, outside, np.float32)
    for corner, edge in solid:
        i, j, k = corner - low
        field[i : i + edge, j : j + edge, k : k + edge] = inside
    offsets = _block_offsets(BLOCKS[-1])
    for first in range(0, len(blocks), CHUNK // len(offsets)):
        index = (blocks[first : first + CHUNK // len(offsets), None] + offsets).reshape(-1, 3)
        values = _evaluate(views, grid.points(index), parameters)
        field[tuple((index - low).T)] = values
    return VisualHull(
        field=field,
        level=level,
        origin_mm=grid.points(low[None])[0].astype(np.float64),
        pitch_mm=grid.pitch_mm,
        touches_border=_touches_border(field > level, low, high, parameters.n),
    )


View = tuple[CameraCalibration, Silhouette]


def usable_views(silhouettes: Mapping[CameraId, Silhouette], rig: RigCalibration) -> list[View]:
    """Cameras with their usable silhouettes, in the rig's order."""
    unknown = sorted(set(silhouettes) - set(rig.camera_ids))
    if unknown:
        raise ValueError(f"the rig has no camera {', '.join(unknown)}")
    return [
        (camera, silhouettes[camera.id])
        for camera in rig.cameras
        if camera.id in silhouettes and silhouettes[camera.id].is_usable
    ]


def distances_mm(views: list[View], points_mm: Array) -> Array:
    """Signed distances (V, N) of points (N, 3) to the viewing cones of V views, positive within."""
    distances = np.empty((len(views), len(points_mm)), np.float32)
    for row, (camera, silhouette) in zip(distances, views, strict=True):
        u, v, depth_mm = _project(camera, silhouette, points_mm)
        distance_px = _sample(silhouette.distance_px, u, v, cv2.INTER_LINEAR, -MARGIN_PX)
        np.multiply(distance_px, depth_mm / np.float32(camera.focal_px), out=row)
    return distances


def count_views(views: list[View], points_mm: Array) -> Array:
    """The paper's S (N,): how many silhouettes contain the nearest pixel of each point's projection."""
    count = np.zeros(len(points_mm), np.float32)
    for camera, silhouette in views:
        u, v, _ = _project(camera, silhouette, points_mm)
        count += _sample(silhouette.labels, u, v, cv2.INTER_NEAREST, 0) >= UNKNOWN
    return count


def smallest(distances: Array, rank: int) -> Array:
    """The (rank + 1)-th smallest distance (N,) of (V, N): `rank` views are overruled."""
    if rank == 0:
        return np.asarray(distances.min(axis=0))
    return np.asarray(np.partition(distances, rank, axis=0)[rank])


def _evaluate(views: list[View], points_mm: Array, parameters: CarvingParameters) -> Array:
    if parameters.field == "view_count":
        return count_views(views, points_mm)
    values = smallest(distances_mm(views, points_mm), parameters.max_disagreeing_views)
    values[values == 0] = 1e-4  # a sample exactly on the surface would make triangles without area
    return values


@dataclass(frozen=True, slots=True)
class _Grid:
    parameters: CarvingParameters

    @property
    def pitch_mm(self) -> float:
        return self.parameters.pitch_mm

    def points(self, index: NDArray[np.int64], offset: float = 0.0) -> Array:
        """World points (N, 3) of voxel indices (N, 3), shifted by `offset` voxels along each axis."""
        low_mm = (self.pitch_mm - self.parameters.size_mm) / 2
        return (low_mm + self.pitch_mm * (index + offset)).astype(np.float32)


def _cut_blocks(
    views: list[View], grid: _Grid, parameters: CarvingParameters
) -> tuple[NDArray[np.int64], list[tuple[NDArray[np.int64], int]]]:
    """First voxels (B, 3) of the finest blocks that the surface may cut, and (first voxel, edge) of solid blocks.

    The radius of a block includes one voxel beyond it, so that no cell of marching cubes between a
    cut block and its neighbour is cut unseen.
    """
    edge = BLOCKS[0]
    candidates = edge * np.indices((parameters.n // edge,) * 3).reshape(3, -1).T
    solid: list[tuple[NDArray[np.int64], int]] = []
    for level, edge in enumerate(BLOCKS):
        if level > 0:
            half = _block_offsets(2) * edge
            candidates = (candidates[:, None] + half).reshape(-1, 3)
        radius_mm = (edge + 1) / 2 * grid.pitch_mm * np.sqrt(3)
        centre = (
            np.concatenate(
                [
                    smallest(
                        distances_mm(views, grid.points(candidates[first : first + CHUNK], (edge - 1) / 2)),
                        parameters.max_disagreeing_views,
                    )
                    for first in range(0, len(candidates), CHUNK)
                ]
            )
            if len(candidates)
            else np.zeros(0, np.float32)
        )
        solid += [(corner, edge) for corner in candidates[centre > radius_mm]]
        candidates = candidates[np.abs(centre) <= radius_mm]
    return candidates, solid


def _block_offsets(edge: int) -> NDArray[np.int64]:
    return np.indices((edge,) * 3).reshape(3, -1).T


def _touches_border(
    inside: NDArray[np.bool_], low: NDArray[np.int64], high: NDArray[np.int64], n: int
) -> bool:
    """Whether a voxel of a face of the whole grid, just within the shell, is inside."""
    return any(
        bool(inside.take(position, axis=axis).any())
        for axis in range(3)
        for position, at_border in ((1, low[axis] < 0), (-2, high[axis] > n))
        if at_border
    )


def _project(
    camera: CameraCalibration, silhouette: Silhouette, points_mm: Array
) -> tuple[Array, Array, Array]:
    """Region pixels u, v and depths (N,) in single precision (1e-4 px), as `CameraCalibration.project`."""
    R, K = camera.R.astype(np.float32), camera.K
    t_mm = camera.t_mm.astype(np.float32)
    x, y, depth_mm = (points_mm @ R[i] + t_mm[i] for i in range(3))
    x /= depth_mm
    y /= depth_mm
    if camera.distortion.any():
        k1, k2, p1, p2, k3 = (np.float32(k) for k in camera.distortion)
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        if p1 or p2:
            x, y = (
                x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
                y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
            )
        else:
            x, y = x * radial, y * radial
    u = np.float32(K[0, 0]) * x + np.float32(K[0, 2] - silhouette.offset_uv[0])
    if K[0, 1]:
        u += np.float32(K[0, 1]) * y
    v = np.float32(K[1, 1]) * y + np.float32(K[1, 2] - silhouette.offset_uv[1])
    return u, v, depth_mm


def _sample(
    image: NDArray[np.float32] | NDArray[np.uint8], u: Array, v: Array, interpolation: int, border: float
) -> Array:
    """Values (N,) of an image at pixels u, v."""
    n = len(u)
    if n == 0:
        return np.zeros(0, np.float32)
    rows = -(-n // ROW)
    width = min(n, ROW)
    if rows * width != n:
        padding = rows * width - n
        u, v = np.pad(u, (0, padding)), np.pad(v, (0, padding))
    sampled = cv2.remap(
        image,
        u.reshape(rows, width),
        v.reshape(rows, width),
        interpolation,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=border,
    )
    return sampled.reshape(-1)[:n].astype(np.float32, copy=False)
