"""Other people's carving, meshing and integrating, each on what ours is given: tests/benchmarks/carving.py."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import trimesh
from numpy.typing import NDArray
from skimage.measure import marching_cubes


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Task:
    """What every peer is given; voxel (i, j, k) is centred at `low_mm` + `pitch_mm` (i, j, k)."""

    masks: NDArray[np.uint8]  # (V, H, W), 1 inside
    K: NDArray[np.float64]  # (V, 3, 3)
    pose: NDArray[np.float64]  # (V, 3, 4) world mm to camera mm
    n: int
    size_mm: float
    count: NDArray[np.float32]  # (n, n, n) silhouettes that contain a voxel, exact beside the surface

    @property
    def P(self) -> NDArray[np.float64]:
        """(V, 3, 4) world mm to pixels."""
        return self.K @ self.pose

    @property
    def pitch_mm(self) -> float:
        return self.size_mm / self.n

    @property
    def low_mm(self) -> float:
        return (self.pitch_mm - self.size_mm) / 2

    @property
    def level(self) -> float:
        return len(self.masks) - 0.5

    @property
    def axis_mm(self) -> NDArray[np.float64]:
        return self.low_mm + self.pitch_mm * np.arange(self.n)

    def box(self) -> tuple[slice, ...]:
        """The voxels that the body reaches, and one more on each side."""
        inside = self.count > self.level
        extents = (np.flatnonzero(inside.any(axis=axes)) for axes in ((1, 2), (0, 2), (0, 1)))
        return tuple(slice(extent[0] - 1, extent[-1] + 2) for extent in extents)


Work = Callable[[], Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class Peer:
    """`work` prepares what is then timed; the answer is a hull (n, n, n), or vertices in voxels and faces."""

    stage: str
    what: str
    work: Callable[[Task], Work]
    is_same_hull: bool = False  # by definition


# --- hulls ---


def numpy_plain(task: Task) -> Work:
    """As one writes it: the whole grid in homogeneous coordinates, one matrix product a view."""

    def work() -> NDArray[np.bool_]:
        points = np.stack(np.meshgrid(*[task.axis_mm] * 3, indexing="ij")).reshape(3, -1)
        points = np.vstack([points, np.ones(points.shape[1])])
        count = np.zeros(points.shape[1], np.uint8)
        height, width = task.masks.shape[1:]
        for P, mask in zip(task.P, task.masks, strict=True):
            x, y, w = P @ points
            u, v = np.rint(x / w).astype(np.int32), np.rint(y / w).astype(np.int32)
            seen = (u >= 0) & (u < width) & (v >= 0) & (v < height)
            count[seen] += mask[v[seen], u[seen]]
        return np.asarray(count == len(task.masks)).reshape((task.n,) * 3)

    return work


def numpy_slabs(task: Task) -> Work:
    """As well as numpy can: slabs that fit the cache, sums instead of products, padding instead of bounds."""

    def work() -> NDArray[np.bool_]:
        n_views, height, width = task.masks.shape
        axis_mm = task.axis_mm.astype(np.float32)
        count = np.zeros((task.n,) * 3, np.uint8)
        for P, mask in zip(task.P.astype(np.float32), task.masks, strict=True):
            pixels = np.pad(mask, 1).ravel()
            of_slab = [row[1] * axis_mm[:, None] + row[2] * axis_mm + row[3] for row in P]
            for slab, x_mm in zip(count, axis_mm, strict=True):
                per_depth = 1 / (of_slab[2] + P[2, 0] * x_mm)
                u = np.clip(np.rint((of_slab[0] + P[0, 0] * x_mm) * per_depth), -1, width).astype(np.int32)
                v = np.clip(np.rint((of_slab[1] + P[1, 0] * x_mm) * per_depth), -1, height).astype(np.int32)
                slab += pixels[(v + 1) * (width + 2) + u + 1]
        return np.asarray(count == n_views)

    return work


def opencv_sweep(task: Task) -> Work:
    """Plane sweep: a homography from each layer of voxels to each image."""

    def work() -> NDArray[np.bool_]:
        count = np.zeros((task.n,) * 3, np.uint8)
        for z_mm, layer in zip(task.axis_mm, count, strict=True):
            for P, mask in zip(task.P, task.masks, strict=True):
                x, y, z, one = P.T
                corner = (x + y) * task.low_mm + z * z_mm + one
                homography = np.column_stack([x * task.pitch_mm, y * task.pitch_mm, corner])
                layer += cv2.warpPerspective(
                    mask, homography, layer.shape, flags=cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
                )
        return np.asarray(count.transpose(2, 1, 0) == len(task.masks))

    return work


def open3d_carve(task: Task) -> Work:
    """`VoxelGrid.carve_silhouette`: keeps a voxel while any of its corners is inside."""
    import open3d

    height, width = task.masks.shape[1:]
    images = [open3d.geometry.Image(mask.astype(np.float32)) for mask in task.masks]
    cameras = []
    for K, pose in zip(task.K, task.pose, strict=True):
        camera = open3d.camera.PinholeCameraParameters()
        camera.intrinsic = open3d.camera.PinholeCameraIntrinsic(
            width, height, K[0, 0], K[1, 1], K[0, 2], K[1, 2]
        )
        camera.extrinsic = np.vstack([pose, [0, 0, 0, 1]])
        cameras.append(camera)

    def work() -> Any:
        grid = open3d.geometry.VoxelGrid.create_dense(
            origin=[-task.size_mm / 2] * 3,
            color=[0, 0, 0],
            voxel_size=task.pitch_mm,
            width=task.size_mm,
            height=task.size_mm,
            depth=task.size_mm,
        )
        for image, camera in zip(images, cameras, strict=True):
            grid.carve_silhouette(image, camera)
        return grid

    return work


def voxels_of(answer: Any, n: int) -> NDArray[np.bool_]:
    if isinstance(answer, np.ndarray):
        return answer
    inside = np.zeros((n,) * 3, bool)
    index = np.array([voxel.grid_index for voxel in answer.get_voxels()])
    inside[tuple(index.T)] = True
    return inside


# --- surfaces ---


def skimage_whole(task: Task) -> Work:
    return lambda: marching_cubes(task.count, task.level, allow_degenerate=False)[:2]


def skimage_cropped(task: Task) -> Work:
    cropped = np.ascontiguousarray(task.count[task.box()])
    return lambda: marching_cubes(cropped, task.level, allow_degenerate=False)[:2]


def pymcubes_whole(task: Task) -> Work:
    import mcubes

    return lambda: mcubes.marching_cubes(task.count, task.level)


def pymcubes_cropped(task: Task) -> Work:
    import mcubes

    cropped = np.ascontiguousarray(task.count[task.box()])
    return lambda: mcubes.marching_cubes(cropped, task.level)


def trimesh_integrals(task: Task) -> Work:
    """Volume, area, centroid, inertia and whether the mesh is closed."""
    vertices, faces = skimage_cropped(task)()

    def work() -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        mesh = trimesh.Trimesh(vertices, faces, process=False)
        _ = mesh.volume, mesh.area, mesh.center_mass, mesh.moment_inertia, mesh.is_watertight
        return vertices, faces

    return work


CARVE, CARVE_FINE, MESH, INTEGRATE, ALL = (
    "carve, voxels", "carve, sub-voxel", "mesh", "integrals", "silhouettes to mesh with integrals"
)  # fmt: skip
PEERS = {
    "numpy": Peer(stage=CARVE, what="numpy, whole grid, float64", work=numpy_plain, is_same_hull=True),
    "slabs": Peer(stage=CARVE, what="numpy, by slabs, float32", work=numpy_slabs, is_same_hull=True),
    "opencv": Peer(
        stage=CARVE, what="OpenCV plane sweep, warpPerspective", work=opencv_sweep, is_same_hull=True
    ),
    "open3d": Peer(stage=CARVE, what="Open3D carve_silhouette (any corner)", work=open3d_carve),
    "skimage": Peer(stage=MESH, what="scikit-image, whole grid", work=skimage_whole),
    "skimage-box": Peer(stage=MESH, what="scikit-image, box of the stone", work=skimage_cropped),
    "pymcubes": Peer(stage=MESH, what="PyMCubes, whole grid", work=pymcubes_whole),
    "pymcubes-box": Peer(stage=MESH, what="PyMCubes, box of the stone", work=pymcubes_cropped),
    "trimesh": Peer(stage=INTEGRATE, what="trimesh", work=trimesh_integrals),
}
